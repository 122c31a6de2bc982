"""What a type checker sees of the package from a user's script outside the checkout."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import hydrojax as hj

pytestmark = pytest.mark.skipif(
    find_spec("pyright") is None, reason="pyright is not installed: [test]"
)

SCRIPT = """
import hydrojax as hj
from hydrojax.control.base import Measured
from hydrojax.identify.results.outcome import Outcome

rig = hj.RigFile.load("rig.toml")
log = hj.Log.load("fit_1.csv")
result = hj.trace(rig, [log], validate=[log], criteria=hj.Criteria(matters=0.02))
text: str = result.summary()
value: float = float(result.parameters.value["beta"])
outcome: Outcome = result.outcome
reveal_type(result)
reveal_type(hj.tune_gains)
reveal_type(hj.sweep(rig, {"k_p": [0.2, 4.0]}))


class Mine(hj.AbstractController):
    u_max: hj.effects.Array = hj.param("V", 10.0, 0.0, 100.0, "saturation")

    def init(self, measured: Measured, F_d):
        return 0.0 * measured.F

    def step(self, memory, measured: Measured, F_d, h):
        return memory, F_d - measured.F, {}


loop = hj.simulate(rig, seconds=1.0)
wrong: int = result.summary()
hj.fit(rig)
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> list[dict]:
    """What pyright says of the script, in a folder of its own."""
    folder = tmp_path_factory.mktemp("user")
    (folder / "script.py").write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, "-m", "pyright", "--outputjson", "--pythonpath",
         sys.executable, "script.py"],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return json.loads(done.stdout)["generalDiagnostics"]


def test_every_import_is_resolved(found):
    rules = {d.get("rule") for d in found}
    assert not {r for r in rules if r and "Import" in r}


def test_only_what_is_wrong_is_an_error(found):
    """The checker reads signatures, not `Any`: it finds the two mistakes, no more."""
    wrong = [d for d in found if d["severity"] == "error"]
    lines = {SCRIPT.splitlines()[d["range"]["start"]["line"]] for d in wrong}
    assert lines == {"wrong: int = result.summary()", "hj.fit(rig)"}


def test_signatures_are_whole(found):
    revealed = [d["message"] for d in found if d["severity"] == "information"]
    assert len(revealed) == 3
    assert "Result" in revealed[0]
    assert "Limits" in revealed[1] and "Tuned" in revealed[1]
    assert "Dataset" in revealed[2]
    assert not [m for m in revealed if "Unknown" in m]


def test_the_package_says_that_it_is_typed():
    assert (Path(hj.__file__).parent / "py.typed").is_file()
