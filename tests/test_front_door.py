"""The front door: what a notebook writes, run as written, and what importing costs.

The first block is the one that the design of the project shows to its users.
"""

import json
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import hydrojax as hj
from hydrojax.effects import EFFECTS

AS_SHOWN = """
import hydrojax as hj

rig  = hj.RigFile.load("rig.toml")                    # or .from_dict({...})
log  = hj.Log.load("fit_1.csv"); other = hj.Log.from_frame(frame, units={"P_a1": "bar"})
fit  = hj.fit(rig, [log], validate=[other])           # a Result
out  = hj.trace(rig, [log], validate=[other], test=[third], criteria=hj.Criteria(matters=0.02))
out.verdict; out.summary(); out.parameters            # a DataFrame
out.rig; out.model; out.predict(log)                  # RigFile, Rig (a pytree), DataFrame
run  = hj.simulate(out.rig, reference=hj.sine("300 N", "0.5 Hz"), motion=hj.to_and_fro("30 mm", "3 s"))
data = hj.sweep(out.rig, {"k_p": np.linspace(.2, 4, 48), "k_f": np.linspace(.2, 6, 48)})
best = hj.tune_gains(out.rig, free=("k_p", "k_f"), limits=hj.Limits(peak_dB=3))
"""  # noqa: E501


@pytest.fixture(scope="module")
def shown(recorded):
    """What the block above leaves behind, run beside a recorded case."""
    case = recorded(6, {"stribeck": {}})
    frame = pd.read_csv(case / "validate.csv")
    frame = frame.rename(columns={"P_a1 [bar]": "P_a1"})
    assert "P_a1" in frame  # without its unit, which the code shown names
    third = hj.Log.load(case / "fit_2.csv")
    names = {"np": np, "frame": frame, "third": third}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(case)
        exec(compile(AS_SHOWN, "front door", "exec"), names)  # noqa: S102
    return names


@pytest.mark.slow
def test_what_is_shown_runs(shown):
    out = shown["out"]
    assert out.verdict in ("explained", "nothing missing", "unknown")
    assert {e.name for e in out.effects} == {"stribeck"}
    shown_columns = ["value", "std", "low", "high", "unit", "identified"]
    assert list(out.parameters.columns[:6]) == shown_columns
    assert "stribeck" in out.summary() and len(repr(out).splitlines()) < 10
    predicted = out.predict(shown["log"])
    assert {"P_a1", "P_a2", "F"} <= set(predicted.columns)
    frame = shown["run"].to_frame()
    assert len(frame) == shown["run"].t.size
    assert np.sqrt(np.mean((frame["F"] - frame["F_d"]) ** 2)) < 100
    assert shown["data"].sizes["k_p"] == shown["data"].sizes["k_f"] == 48
    assert set(shown["best"].gains) == {"k_p", "k_f"}


@pytest.mark.slow
def test_a_run_becomes_a_log(shown, tmp_path):
    log = shown["run"].to_log()
    assert isinstance(log, hj.Log)
    assert np.allclose(np.diff(log.time), 1e-3)


def python(code: str, folder: Path) -> str:
    """What a fresh interpreter prints."""
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        capture_output=True, text=True, cwd=folder, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_importing_loads_nothing_heavy(tmp_path):
    code = """
    import sys, json
    import hydrojax
    heavy = ("jax", "numpy", "pandas", "matplotlib", "xarray", "scipy")
    print(json.dumps([m for m in heavy if m in sys.modules]))
    """
    assert json.loads(python(code, tmp_path)) == []


def test_an_effect_made_first_is_of_double_precision(tmp_path):
    """Before any function of the front door has run."""
    code = """
    import hydrojax as hj

    class Drag(hj.effects.FrictionForce):
        name, residual_axis = "drag", "v"
        c: hj.effects.Array = hj.param("N*s/m", 0.1, 0.0, 1.0, "drag", strength=True)

        def force(self, at):
            return self.c * at.v

    print(Drag().c.dtype)
    """
    assert python(code, tmp_path).strip() == "float64"


def test_every_name_is_there(tmp_path):
    missing = [name for name in hj.__all__ if getattr(hj, name, None) is None]
    assert not missing
    undocumented = [n for n in hj.__all__ if not getattr(hj, n).__doc__]
    assert not undocumented


def test_an_effect_of_a_cell_replaces_the_one_before(monkeypatch):
    known = dict(EFFECTS)
    for size in (2e4, 3e4):

        @hj.effect
        class QuadraticDrag(hj.effects.FrictionForce):
            """Drag of oil: c v abs(v)."""

            name = "quadratic_drag_of_a_cell"
            residual_axis = "v"
            c: hj.effects.Array = hj.param(
                "N*s^2/m^2", 0.0, 0.0, 1e8, "drag", strength=True, size=size
            )

            def force(self, at):
                return self.c * at.v * abs(at.v)

    try:
        assert EFFECTS["quadratic_drag_of_a_cell"] is QuadraticDrag
        assert len(EFFECTS) == len(known) + 1
    finally:
        del EFFECTS["quadratic_drag_of_a_cell"]
