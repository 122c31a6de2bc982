"""Quantities by name, axes in words, sweeps in chunks, NetCDF, maps, the command."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from types import ModuleType
from typing import Any

import jax.numpy as jnp
import numpy as np
import pint
import pytest
import xarray as xr

from hydrojax import cli
from hydrojax.cli.words import read_axes
from hydrojax.effects import EFFECTS, load_effects
from hydrojax.effects.valve import ValveDelay
from hydrojax.errors import InputError
from hydrojax.paper.records import reference
from hydrojax.parameters import get
from hydrojax.rigfile.quantities import open_setting, quantities
from hydrojax.tune import (
    api,
    maps,
    measure,
    metrics,
    plan,
    plots,
    report,
    selection,
    sweep,
)
from hydrojax.tune.axes import make_axes
from hydrojax.tune.ensemble import ensemble, from_findings
from hydrojax.tune.findings import Findings

SPEC, _ = reference()
RIG = SPEC.path


@pytest.fixture(scope="module")
def setting():
    return open_setting(SPEC)


@pytest.fixture(scope="module")
def known(setting):
    return quantities(SPEC, setting)


def plan_of(setting, known, words, methods=("linear",), **more):
    given = {"multisine": measure.multisine(1000.0, period=0.5, lines=12)}
    return plan.with_excitations(
        plan.Plan(setting, make_axes(read_axes(words), known), known, methods,
                  excitations=given, rig="reference rig", **more)
    )  # fmt: skip


# -- excitations and quantities --


def test_the_noise_of_a_multisine_lies_between_its_sines():
    given = measure.multisine(1000.0, lines=40)
    n = given.skip
    once, again = given.noise[:n], given.noise[n:]
    np.testing.assert_array_equal(once, again)
    power = np.abs(np.fft.rfft(once, axis=0)) ** 2 / n
    sines = np.abs(np.fft.rfft(given.shape[:n])) > 1e-6 * n
    assert sines.sum() == given.hertz.size
    assert power[sines].max() < 1e-20
    assert power[~sines].mean() == pytest.approx(1.0, rel=0.1)


def test_every_quantity_is_read_as_it_was_set(setting, known):
    for q in known.values():
        value = 0.5 * float(q.get(setting)) + 0.25
        assert float(q.get(q.put(setting, value))) == pytest.approx(value, rel=1e-12)


def test_the_paper_s_units(setting, known):
    kappa = 1.18e-4
    assert float(known["k_p"].get(setting)) == pytest.approx(1.2)
    assert float(setting.loop.law.k_p) == pytest.approx(1.2e-3 * kappa)
    assert float(known["valve_lag.omega"].get(setting)) == pytest.approx(1257)
    assert float(known["rate"].get(setting)) == pytest.approx(1000)
    assert known["beta"].number("0.9 GPa", "") == pytest.approx(9e8)
    assert known["k_p"].number("1.5e-3 V/N", "") == pytest.approx(1.5)


def test_a_plant_s_parameter_leaves_the_law_alone(setting, known):
    other = known["k_cp"].put(setting, 2000.0)
    assert float(other.loop.rig.mechanics.k_cp) == 2000
    assert float(other.loop.law.nominal.mechanics.k_cp) == 1250
    both = known["k_cp_hat"].put(setting, 0.9)
    assert float(both.loop.law.lower.k_cp) == float(both.loop.law.upper.k_cp) == 900


def test_an_effect_the_rig_has_not_is_put_in_absent():
    s = open_setting(SPEC, extra=("internal_leakage.c_il",))
    known = quantities(SPEC, s)
    assert float(known["internal_leakage.c_il"].get(s)) == 0


@pytest.mark.parametrize(
    ("word", "says"),
    [
        ("k_pp=1:2:3", "did you mean 'k_p'"),
        ("k_p", "write NAME=START:STOP:COUNT"),
        ("k_p=1:2", "START:STOP:COUNT"),
        ("k_p=1:2:1", "count of 2 or more"),
        ("k_p=-1:2:4:log", "above 0"),
        ("k_p=1,1", "twice"),
        ("k_p=1:2:²", "count of 2 or more"),
        ("k_p=1:2:100000000", "more than 10000"),
        (f"k_p=1:2:{'9' * 5000}", "more than 10000"),
        ("k_p=1 Pa*9^(9*9*9*9*9*9*9):2 Pa:3", "does not fit"),
        ("beta=1 kg:2 kg:3", "kg"),
        ("load.mass=1:2:3", "under [load]"),
        ("rate=0:1000:3", "above 0"),
    ],
)
def test_bad_axes_are_refused_in_one_line(known, word, says):
    with pytest.raises(InputError, match=says.replace("[", r"\[")) as err:
        make_axes(read_axes([word]), known)
    assert "\n" not in str(err.value)


def test_more_cells_than_can_be_held_are_refused(known):
    axes = read_axes([f"{name}=1:2:9999" for name in ("k_p", "k_f", "beta", "x")])
    with pytest.raises(InputError, match="cells are more than"):
        make_axes(axes, known)


def test_axes(known):
    def values(word):
        return make_axes(read_axes([word]), known)[0].values

    assert values("k_p=1:3:3").tolist() == [1, 2, 3]
    np.testing.assert_allclose(values("beta=1e8 Pa:1e10 Pa:3:log"), [1e8, 1e9, 1e10])
    np.testing.assert_allclose(values("beta=0.5 GPa:900 MPa:3"), [5e8, 7e8, 9e8])
    assert values("v=0,1 cm/s").tolist() == [0, 0.01]
    assert values("v=0:1 cm/s:2").tolist() == [0, 0.01]
    with pytest.raises(InputError, match="1 to 4"):
        make_axes({n: [1, 2] for n in ("k_p", "k_f", "x", "v", "F_0")}, known)
    with pytest.raises(InputError, match="given twice"):
        read_axes(["k_p=1,2", "k_p=3,4"])


def test_axes_as_a_notebook_gives_them(known):
    pascal = pint.UnitRegistry().pascal
    given = {
        "k_p": np.linspace(1, 3, 3),
        "beta": np.array([8e8, 9e8]) * pascal,
        "v": ["0", "1 cm/s"],
        "x": 0.01,
    }
    found = {a.name: a.values.tolist() for a in make_axes(given, known)}
    assert found == {"k_p": [1, 2, 3], "beta": [8e8, 9e8], "v": [0, 0.01], "x": [0.01]}


# -- sweeps --


@pytest.mark.slow
def test_chunks_change_nothing(setting, known):
    words = ["k_p=0.5:3:3", "k_f=1:4:3"]
    methods = ("linear", "multisine")
    whole = sweep.run_sweep(plan_of(setting, known, words, methods, chunk=9))
    parts = sweep.run_sweep(plan_of(setting, known, words, methods, chunk=4))
    for name, table in whole.data_vars.items():
        scale = float(np.nanmax(np.abs(table))) or 1.0
        np.testing.assert_allclose(parts[name], table, rtol=1e-12, atol=1e-12 * scale)


ON_TWO = """
import sys
from pathlib import Path
import jax
from hydrojax.jax_setup import set_up_jax
set_up_jax(Path(sys.argv[1]))
from tests.tune import test_sweep as t
setting = t.open_setting(t.SPEC)
known = t.quantities(t.SPEC, setting)
asked = t.plan_of(setting, known, ["k_p=0.5:3:5"], ("linear", "multisine"))
assert jax.local_device_count() == 2 and t.plan.chunk_size(asked, "multisine") == 6
t.sweep.run_sweep(asked, Path(sys.argv[2]))
"""


@pytest.mark.slow
def test_devices_share_a_sweep_and_change_nothing(setting, known, tmp_path, cache_home):
    """An odd number of cells on two devices of the processor."""
    flags = os.environ.get("XLA_FLAGS", "")
    two = f"{flags} --xla_force_host_platform_device_count=2"
    subprocess.run(
        [sys.executable, "-c", ON_TWO, cache_home / "hydrojax", tmp_path],
        env=os.environ | {"XLA_FLAGS": two}, check=True, timeout=300,
    )  # fmt: skip
    shared = xr.load_dataset(tmp_path / "sweep.nc")
    alone = sweep.run_sweep(
        plan_of(setting, known, ["k_p=0.5:3:5"], ("linear", "multisine"))
    )
    assert shared.data_vars.keys() == alone.data_vars.keys()
    for name, table in alone.data_vars.items():
        scale = float(np.nanmax(np.abs(table))) or 1.0
        np.testing.assert_allclose(shared[name], table, rtol=1e-12, atol=1e-12 * scale)


@pytest.mark.slow
def test_other_values_compile_nothing(setting, known, compiled):
    def swept(words):
        return sweep.run_sweep(plan_of(setting, known, words, ("linear", "multisine")))

    swept(["k_p=0.5:1:2", "k_f=1:2:2"])
    compiled.clear()
    swept(["k_p=0.6:1.3:2", "k_f=0.9:2.2:2"])
    assert compiled == []


@pytest.mark.slow
def test_a_cell_is_the_rig_with_its_values(setting, known):
    """The map's cell at the rig's own gains, alone."""
    data = sweep.run_sweep(plan_of(setting, known, ["k_p=0.6,1.2", "k_f=2.4,4.8"]))
    alone = sweep.run_sweep(plan_of(setting, known, ["x=0,0.01"]))
    for name in metrics.UNITS:
        here = float(data[f"linear_{name}"].sel(k_p=1.2, k_f=2.4))
        assert here == pytest.approx(float(alone[f"linear_{name}"].sel(x=0)), rel=1e-9)
    assert 14 < float(data.linear_within_1dB.sel(k_p=1.2, k_f=2.4)) < 20


@pytest.mark.slow
def test_a_stopped_sweep_goes_on_and_a_done_one_does_nothing(
    setting, known, tmp_path, monkeypatch
):
    asked = plan_of(setting, known, ["k_p=0.5:3:6"], chunk=2)

    def stop(done, total):
        assert total == 6
        if done >= 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep.run_sweep(asked, tmp_path, stop)
    kept = sorted((tmp_path / "parts").iterdir())
    assert len(kept) == 2 and not (tmp_path / "sweep.nc").exists()
    old = [p.stat().st_mtime_ns for p in kept]
    seen = []
    data = sweep.run_sweep(asked, tmp_path, lambda *a: seen.append(a))
    assert [p.stat().st_mtime_ns for p in kept] == old and seen[-1] == (6, 6)
    monkeypatch.setattr(sweep, "_Work", None)  # nothing is worked out again
    again = sweep.run_sweep(asked, tmp_path)
    xr.testing.assert_identical(again, xr.load_dataset(tmp_path / "sweep.nc"))
    np.testing.assert_array_equal(again.linear_peak, data.linear_peak)
    with pytest.raises(InputError, match="another sweep"):
        sweep.run_sweep(plan_of(setting, known, ["k_p=0.5:3:5"]), tmp_path)


def test_a_sweep_is_not_resumed_with_adaptation_frozen_or_freed(
    setting, known, tmp_path
):
    words, methods = ["k_p=0.6,1.2"], ("multisine",)
    runs, stands = (
        plan_of(setting, known, words, methods, frozen=frozen)
        for frozen in (False, True)
    )
    assert runs.key() != stands.key()
    for i, (kept, other) in enumerate([(runs, stands), (stands, runs)]):
        folder = tmp_path / str(i)
        todo = sweep.left(kept, folder)
        assert todo == [("multisine", 0)] == sweep.left(kept, folder)
        for resume in (sweep.run_sweep, sweep.left):
            with pytest.raises(InputError, match="another sweep"):
                resume(other, folder)


DRAG = """
from hydrojax.effects import Array, FrictionForce, param

SHARE = 1.0

def helper(c, v):
    return {helper} * c * v

class OwnDrag(FrictionForce):
    name = "own_drag"
    residual_axis = "v"
    c: Array = param("N*s/m", 0.0, 0.0, 1e6, "drag", strength=True, size=1e3)

    def force(self, at):
        return {share} * SHARE * helper(self.c, at.v)
"""


@pytest.fixture
def own_effect(tmp_path):
    """What writes and loads a user's effect; the vocabulary is restored afterwards."""
    before = dict(EFFECTS)

    def load(share="1.0", helper="1.0"):
        path = tmp_path / "own.py"
        path.write_text(DRAG.format(share=share, helper=helper))
        load_effects(path)
        return open_setting(SPEC, extra=("own_drag.c",))

    yield load
    EFFECTS.clear()
    EFFECTS.update(before)


@pytest.mark.slow
def test_a_sweep_resumed_after_an_effect_s_code_changed_is_of_the_new_code(
    own_effect, tmp_path
):
    words, out = ["own_drag.c=1e3,2e4"], tmp_path / "sweep"

    def swept(setting, folder=None):
        asked = plan_of(setting, quantities(SPEC, setting), words)
        return sweep.run_sweep(asked, folder)

    swept(own_effect(), out)
    kept = {p.name for p in (out / "parts").iterdir()}
    changed = own_effect(share="9.0")
    resumed, anew = swept(changed, out), swept(changed)
    assert kept.isdisjoint(p.name for p in (out / "parts").iterdir())
    xr.testing.assert_identical(resumed, xr.load_dataset(out / "sweep.nc"))
    for name, table in anew.data_vars.items():
        np.testing.assert_array_equal(resumed[name], table)


def test_the_key_holds_the_code_of_an_effect_and_of_what_it_calls(own_effect):
    def key(setting):
        return plan_of(setting, quantities(SPEC, setting), ["own_drag.c=1,2"]).key()

    first = key(own_effect())
    assert key(own_effect()) == first
    others = [key(own_effect(share="2.0")), key(own_effect(helper="2.0"))]
    assert len({first, *others}) == 3


LAW = """
import jax.numpy as jnp
from jaxtyping import Array
from hydrojax.control.base import AbstractController
from hydrojax.parameters import param

class OwnP(AbstractController):
    k: Array = param("V/N", 1e-3, 0.0, 1.0, "proportional gain")
    u_max: Array = param("V", 10.0, 0.0, 10.0, "saturation")

    def init(self, measured, F_d):
        return jnp.zeros_like(F_d)

    def step(self, memory, measured, F_d, h):
        u = jnp.clip({sign}self.k * (F_d - measured.F), -self.u_max, self.u_max)
        return memory, u, {{}}
"""


def test_the_key_holds_the_code_of_a_controller(monkeypatch):
    def asked(sign):
        module: Any = ModuleType("own_law")
        monkeypatch.setitem(sys.modules, module.__name__, module)
        exec(LAW.format(sign=sign), vars(module))
        file = replace(SPEC, law=module.OwnP())
        setting = open_setting(file)
        return plan_of(setting, quantities(file, setting), ["k=1e-3,2e-3"])

    first, again, other = asked("-"), asked("-"), asked("+")
    assert first.key() == again.key() != other.key()
    assert first.question() == other.question()


@pytest.mark.slow
def test_the_ensemble_and_what_95_percent_reach(setting, known):
    plants = ensemble(setting, 5)
    assert np.all(np.abs(plants.values / plants.values[0] - 1) <= 0.2)
    asked = plan_of(setting, known, ["k_p=0.6,1.2"], plants=plants)
    data = sweep.run_sweep(asked)
    assert data.linear_within_1dB.dims == ("plant", "k_p")
    least = np.quantile(np.nan_to_num(data.linear_within_1dB), 0.05, axis=0)
    np.testing.assert_allclose(data.linear_within_1dB_95, least)


def test_a_report_s_ensemble(setting, tmp_path):
    report = {
        "format": "hydrojax-report/1",
        "parameters": {
            "beta": {"value": 8e8, "std": 8e6, "unit": "Pa"},
            "k_cp": {"value": 1e3, "std": 50.0, "unit": "N"},
            "z_ss": {"value": 6e-5, "std": None, "unit": "m"},
        },
        "effects": [],
    }  # fmt: skip
    (tmp_path / "report.json").write_text(json.dumps(report))
    findings = Findings.load(tmp_path)
    plants = from_findings(setting, findings, 4000)
    assert plants.names[:2] == ("beta", "k_cp")
    assert "without correlations" in plants.description
    np.testing.assert_allclose(plants.values[0, :2], [8e8, 1e3])
    # A uniform factor of the model's own error comes on top, on all that matters.
    model = findings.residual * np.array([8e8, 1e3]) / np.sqrt(3)
    spread = np.hypot([8e6, 50], model)
    np.testing.assert_allclose(plants.values[:, :2].std(0), spread, rtol=0.05)
    rest = plants.values[:, 2:] / plants.values[0, 2:]
    assert np.max(np.abs(rest - 1)) <= findings.residual
    matrix = [[64e12, -0.9 * 8e6 * 50], [-0.9 * 8e6 * 50, 2500]]
    report["covariance"] = {"names": ["beta", "k_cp"], "matrix": matrix}
    (tmp_path / "report.json").write_text(json.dumps(report))
    values = from_findings(setting, Findings.load(tmp_path), 4000).values
    less = 8e6 * 50 / np.prod(spread)
    assert np.corrcoef(values.T)[0, 1] == pytest.approx(-0.9 * less, abs=0.05)
    with pytest.raises(InputError, match="no report"):
        Findings.load(tmp_path / "none")


def test_plants_of_a_covariance_keep_every_scale(setting, tmp_path):
    """From pascals to flows: the small parameters are not drowned in the large."""
    std = {"beta": 5e6, "c_p1": 6e-14, "z_ss": 1.2e-7}
    value = {"beta": 8.5e8, "c_p1": 2.24e-9, "z_ss": 6e-5}
    both = np.diag([s**2 for s in std.values()])
    both[0, 1] = both[1, 0] = 0.5 * std["beta"] * std["c_p1"]
    units = {"beta": "Pa", "c_p1": "m^3/(s*V*Pa^0.5)", "z_ss": "m"}
    report = {
        "format": "hydrojax-report/1",
        "parameters": {
            n: {"value": value[n], "std": std[n], "unit": units[n]} for n in std
        },
        "effects": [],
        "covariance": {"names": list(std), "matrix": both.tolist()},
    }
    (tmp_path / "report.json").write_text(json.dumps(report))
    findings = Findings.load(tmp_path)
    drawn = from_findings(setting, findings, 4000).values[:, :3]
    own = np.array(list(std.values()))
    model = findings.residual * np.array(list(value.values())) / np.sqrt(3)
    np.testing.assert_allclose(drawn.std(axis=0), np.hypot(own, model), rtol=0.05)
    less = np.prod(own[:2] / np.hypot(own, model)[:2])
    assert abs(np.corrcoef(drawn.T)[0, 1] - 0.5 * less) < 0.05


@pytest.mark.slow
def test_moving_points_settle(setting, known):
    """A joint that is moved has its valve open, and friction that slides."""
    data = sweep.run_sweep(plan_of(setting, known, ["v=-0.01,0,0.01"]))
    assert np.all(data.linear_radius < 1)
    still, moved = (float(data.linear_within_1dB.sel(v=v)) for v in (0.0, 0.01))
    assert moved > still > 14  # presliding lowers the loop's gain; sliding does not


@pytest.mark.slow
def test_friction_makes_bandwidth_depend_on_amplitude(setting, known):
    data = sweep.run_sweep(
        plan_of(setting, known, ["amplitude=2,4000"], ("linear", "multisine"))
    )
    off = data.multisine_within_1dB / data.linear_within_1dB
    assert (
        float(data.multisine_saturation[0]) == 0 < float(data.multisine_saturation[1])
    )
    assert abs(float(off[0]) - 1) > 0 and float(off[1]) < 0.9


# -- what is put in over the rig file --


def late(setting):
    """Ticks until a step of the command is out of the setting's delay."""
    (delay,) = (c for c in setting.loop.rig.command if isinstance(c, ValveDelay))
    memory, h = delay.init(jnp.zeros(())), setting.loop.h
    for tick in range(200):
        memory, out = delay.step(memory, jnp.ones(()), h)
        if float(out) > 1 - 1e-6:
            return tick
    raise AssertionError("it never comes out")


def test_a_swept_delay_is_as_long_as_it_says():
    """The rig file's own has room for 15 ticks of 1 ms."""
    asked = api.plan_sweep(SPEC, {"valve_delay.tau_u": ["0 ms", "15 ms", "40 ms"]})
    assert [late(asked.at(row)) for row in asked.table()] == [0, 15, 40]
    at = api.plan_sweep(SPEC, {"k_p": [1, 2]}, at={"valve_delay.tau_u": "40 ms"})
    assert late(at.at(at.table()[0])) == 40
    fast = api.plan_sweep(
        SPEC, {"rate": [1000, 4000]}, at={"valve_delay.tau_u": "7 ms"}
    )
    assert [late(fast.at(row)) for row in fast.table()] == [7, 28]


def test_a_tuned_delay_is_as_long_as_it_says(monkeypatch):
    monkeypatch.setattr(api, "Objective", lambda setting, *_: setting)
    at = {"valve_delay.tau_u": "40 ms"}
    assert late(api.plan_tuning(SPEC, at=at, plants=1).objective) == 40


def test_a_swept_plant_is_that_of_the_findings(tmp_path):
    """Of one plant or more, with the effects that were added; none is an error."""
    tau_u = {"value": 0.03, "std": 1e-3, "unit": "s"}
    leak = {"value": 2e-12, "std": 1e-14, "unit": "m^3/(s*Pa)"}
    report = {
        "format": "hydrojax-report/1",
        "parameters": {"beta": {"value": 8.3e8, "std": 8e6, "unit": "Pa"}},
        "effects": [
            {"name": "internal_leakage", "parameters": {"c_il": leak}},
            {"name": "valve_delay", "parameters": {"tau_u": tau_u}},
        ],
    }
    (tmp_path / "report.json").write_text(json.dumps(report))
    for plants in (1, 3):
        asked = api.plan_sweep(SPEC, {"k_p": [1, 2]}, plants=plants, findings=tmp_path)
        first = asked.at(asked.table()[0])
        found = get(first.loop.rig, ("beta", "internal_leakage.c_il"))
        np.testing.assert_allclose(found, [8.3e8, 2e-12])
        assert late(first) == 30
    last = asked.at(asked.table()[-1])
    assert float(get(last.loop.rig, ("internal_leakage.c_il",))[0]) != 2e-12
    with pytest.raises(InputError, match="no report"):
        api.plan_sweep(SPEC, {"k_p": [1, 2]}, findings=tmp_path / "none")


# -- the command and its pictures --


@pytest.mark.slow
def test_the_command(tmp_path, monkeypatch, capsys):
    out = tmp_path / "sweep"
    words = ["hydrojax", "sweep", RIG, "--over", "k_p=0.2:4:5", "k_f=0.2:6:5",
             "--at", "F_0=100", "--out", str(out)]  # fmt: skip
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as done:
        cli.main()
    assert done.value.code in (0, None)
    data = xr.load_dataset(out / "sweep.nc")
    assert data.linear_within_1dB.dims == ("k_p", "k_f")
    assert data.k_p.attrs["units"] == "V/kN" and data.attrs["F_0"] == 100
    assert data.linear_gain_margin.attrs["units"] == "dB"
    assert "frozen" in data.attrs["adaptation"]
    names = {p.name for p in out.glob("*.png")}
    assert names == {"map_within_1dB.png", "map_peak.png", "bode.png"}
    said = capsys.readouterr().out
    assert "linear: widest band within 1 dB" in said and "report.html" in said
    page = (out / "report.html").read_text()
    assert said.splitlines()[0] in page and "hydrojax sweep " in page
    assert page.count("data:image/png") == 3 and "://" not in page
    band = data.linear_within_1dB
    first, *rest = report.best_cells(data, "linear")
    best = band.isel(band.argmax(dim=["k_p", "k_f"]))
    assert first["within_1dB"] == float(best) and first["k_p"] == float(best.k_p)
    assert all(a["within_1dB"] <= float(best) for a in rest)
    ax = plots.map_figure(data).axes[0]
    (mark,) = (line for line in ax.lines if line.get_marker() == "D")
    at = np.column_stack([mark.get_xdata(), mark.get_ydata()])
    np.testing.assert_array_equal(at, [[float(best.k_p), float(best.k_f)]])
    assert f"{float(best):.1f} Hz" in [t.get_text() for t in ax.texts]
    r = data.linear_radius.values
    assert np.any(r > 1) and np.all(np.isnan(data.linear_within_1dB.values[r > 1]))
    text = [t.get_text() for t in plots.map_figure(data).legends[0].get_texts()]
    assert {"the paper's gains", "edge of stability"} <= set(text)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--over", "k_q=1:2:3"], "unknown quantity 'k_q'"),
        (["--over", "k_p=1:2:3", "--by", "sines"], "invalid method 'sines'"),
        (["--over", "k_p=1:2:3", "--at", "v=fast"], "--at 'v=fast'"),
        (["--over", "rate=500,1000", "--by", "multisine"], "--by linear"),
    ],
)
def test_bad_words_exit_with_2(tmp_path, monkeypatch, capsys, words, says):
    argv = ["hydrojax", "sweep", RIG, *words, "--out", str(tmp_path / "o")]
    monkeypatch.setattr(sys, "argv", argv)
    with pytest.raises(SystemExit) as done:
        cli.main()
    assert done.value.code == 2
    said = capsys.readouterr().err
    assert says in said and said.count("\n") == 1


def test_a_cell_far_above_all_others_has_a_colour_of_its_own():
    """137 Hz in one corner, where all else is below 24 Hz."""
    edges = maps.colour_edges(np.append(np.linspace(0, 24, 500), [137.4, np.nan]))
    assert edges[0] == 0 and edges[-1] > 137.4 and np.all(np.diff(edges) > 0)
    assert np.digitize(137.4, edges) > np.digitize(24.0, edges) + 2
    assert np.sum(edges < 24) >= 8


@pytest.mark.slow
def test_disagreement_and_saturation_are_on_the_map(setting, known):
    words = ["k_f=1:6:3", "amplitude=10:3000:3:log"]
    data = sweep.run_sweep(plan_of(setting, known, words, ("linear", "multisine")))
    fig = plots.map_figure(data)
    titles = [ax.get_title() for ax in fig.axes]
    assert "where they disagree" in titles
    assert "linearised, adaptation frozen" in titles
    text = [t.get_text() for t in fig.legends[0].get_texts()]
    assert "saturates > 1 %" in text
    assert set(plots.sweep_figures(data)) >= {"map_within_1dB", "map_rms_error", "bode"}


@pytest.mark.slow
def test_an_axis_of_one_value_is_no_axis_of_a_picture(setting, known):
    """Two axes, one of a single value: lines over the other, and its Bode plots."""
    data = sweep.run_sweep(plan_of(setting, known, ["k_p=1.2", "k_f=1,2.4"]))
    assert selection.axes_of(data) == ["k_p", "k_f"]
    assert set(plots.sweep_figures(data)) == {"lines", "bode"}
    alone = sweep.run_sweep(plan_of(setting, known, ["k_p=1.2"]))
    assert set(plots.sweep_figures(alone)) == {"lines", "bode"}
