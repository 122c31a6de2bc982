"""Every notebook runs from top to bottom, and keeps what is fit to be kept."""

import ast
import os
import re
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("plotly", reason="plotly is not installed: [full]")
nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed: [full]")
nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed: [full]")
pytest.importorskip("ipykernel", reason="ipykernel is not installed: [full]")

from benchmarks.notebooks import ALIVE  # noqa: E402

Notebook = Any
"""`nbformat.NotebookNode`, of a package that may be missing."""

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))

SMALL = {"03_the_paper": "seconds = 12.0", "04_your_own_effect": "seconds = 4.0"}
"""What stands in the tests in place of the cell that is tagged `parameters`."""

MEASURED = Path(os.environ.get("HYDROJAX_DATA", "") or "no-such-folder")
"""Logs that are not part of this repository, where a reader has them."""

MOST_BYTES = 1_000_000


def read(stem: str) -> Notebook:
    """A notebook by its name."""
    (path,) = (p for p in NOTEBOOKS if p.stem == stem)
    return nbformat.read(path, as_version=4)


def assigned(code: str) -> set[str]:
    """The names that a cell gives values."""
    nodes = ast.walk(ast.parse(code))
    return {
        n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)
    }


def made_small(notebook: Notebook, code: str) -> Notebook:
    """The notebook with its parameters replaced by those of the tests."""
    (cell,) = (c for c in notebook.cells if "parameters" in c.metadata.get("tags", ()))
    assert assigned(cell.source) == assigned(code)
    cell.source = code
    return notebook


def outputs(notebook: Notebook) -> list[Notebook]:
    """Every output of every cell."""
    return [o for c in notebook.cells if c.cell_type == "code" for o in c.outputs]


def drawn(notebook: Notebook) -> int:
    """How many pictures there are."""
    return sum("image/png" in o.get("data", {}) for o in outputs(notebook))


def printed(notebook: Notebook) -> str:
    """All that was printed and shown as text or tables."""
    parts = []
    for output in outputs(notebook):
        data = output.get("data", {})
        parts += [output.get("text", ""), data.get("text/plain", "")]
        parts.append(data.get("text/html", ""))
    return "\n".join(parts)


def written(notebook: Notebook) -> list[str]:
    """What was printed, and tables as text, output by output."""
    shown = [o for o in outputs(notebook) if not set(ALIVE) & set(o.get("data", {}))]
    texts = [o.get("text", "") or o.get("data", {}).get("text/plain", "")
             for o in shown if o.get("name") != "stderr"]  # fmt: skip
    return [t for t in texts if t and "<Figure" not in t]


def run(stem: str) -> Notebook:
    """Run a notebook, at a small size where it has one."""
    notebook = read(stem)
    return executed(made_small(notebook, SMALL[stem]) if stem in SMALL else notebook)


def executed(notebook: Notebook) -> Notebook:
    """Run a notebook as it stands."""
    for output in (c for c in notebook.cells if c.cell_type == "code"):
        output.outputs = []
    nbclient.NotebookClient(notebook, timeout=900).execute()
    return notebook


NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def stale(kept: str, ran: str, close: float = 0.03) -> list[str]:
    """Numbers and words that a notebook keeps and does not print any more.

    Machines differ in the last figures of a deviation: numbers may by 3 %, and words
    may not.
    """
    words = (" ".join(NUMBER.sub("#", text).split()) for text in (kept, ran))
    if len(set(words)) > 1:
        return [kept, ran]
    pairs = zip(NUMBER.findall(kept), NUMBER.findall(ran), strict=True)
    return [
        f"{a} is printed as {b}"
        for a, b in pairs
        if abs(float(a) - float(b)) > close * abs(float(a)) + 1e-12
    ]


def test_what_went_stale_is_seen():
    shown = "P_a1  9000.0  8986.88\nc_p1 2.24e-09  1.2e-12"
    assert stale(shown, shown.replace("8986.88", "8990.10")) == []
    assert stale(shown, shown.replace("8986.88", "8000.00")) != []
    assert stale(shown, shown.replace("2.24e-09", "2.44e-09")) != []
    assert stale(shown, shown.replace("P_a1", "P_a2")) != []


@pytest.mark.parametrize("stem", [path.stem for path in NOTEBOOKS])
def test_notebook_runs(stem, monkeypatch, cache_home):
    """It draws as many pictures as it keeps, and prints the figures that it keeps."""
    monkeypatch.delenv("HYDROJAX_DATA", raising=False)
    # What other tests have compiled is not compiled again.
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache_home))
    kept = drawn(read(stem))
    done = run(stem)
    if stem not in SMALL:
        before, after = (written(n) for n in (read(stem), done))
        for shown, ran in zip(before, after, strict=True):
            assert stale(shown, ran) == [], f"run python -m benchmarks.notebooks {stem}"
    assert drawn(done), "no picture was drawn"
    if stem == "05_measured_data":
        assert "demo rig" in printed(done)
    else:
        assert drawn(done) == kept
    if stem == "04_your_own_effect":
        assert "quadratic_drag: added" in printed(done)


@pytest.mark.slow
@pytest.mark.parametrize("stem", SMALL)
def test_a_long_notebook_keeps_what_it_prints(stem, monkeypatch, cache_home):
    """At full size: the suite has it small, and cannot compare its figures."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache_home))
    done = executed(read(stem))
    for shown, ran in zip(written(read(stem)), written(done), strict=True):
        assert stale(shown, ran) == [], f"run python -m benchmarks.notebooks {stem}"


@pytest.mark.skipif(
    not MEASURED.is_dir(), reason="HYDROJAX_DATA names no folder of measured logs"
)
def test_measured_data(monkeypatch):
    """EMPS as published: least squares by its authors, to 2 %."""
    text = printed(run("05_measured_data"))
    for name in ("payload_inertia.m", "viscous_friction.b", "k_0"):
        (line,) = (x for x in text.splitlines() if x.startswith(f"{name} "))
        assert abs(float(line.split()[-2])) < 2.5, line


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_what_a_notebook_keeps(path):
    """Run to the end, small, and without a word of the machine it was run on."""
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    code = [c for c in notebook.cells if c.cell_type == "code"]
    assert [c.execution_count for c in code] == list(range(1, len(code) + 1))
    assert drawn(notebook)
    assert path.stat().st_size < MOST_BYTES
    assert not [o for o in outputs(notebook) if o.get("name") == "stderr"]
    text = printed(notebook)
    for root in ("/work", "/home", "/root", "/tmp", "/Users", "C:\\", str(Path.cwd())):
        assert root not in text
    assert notebook.metadata.kernelspec.name == "python3"


def test_every_small_size_is_used():
    assert set(SMALL) <= {path.stem for path in NOTEBOOKS}
    for stem, code in SMALL.items():
        made_small(read(stem), code)


def test_parameters_by_other_names_are_refused():
    with pytest.raises(AssertionError):
        made_small(read("03_the_paper"), "minutes = 1")
