"""`hydrojax.simulate` and the values that it takes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from jaxtyping import Array

import hydrojax as hj
from hydrojax.cli.scenario import read_inputs
from hydrojax.control import inputs
from hydrojax.control.simulation import Trajectory
from hydrojax.effects import FrictionForce, param
from hydrojax.effects.valve import ValveLag
from hydrojax.logs.log import Log
from hydrojax.plant.friction import Sliding
from hydrojax.rigfile.build import build_rig


class Drag(FrictionForce):
    """Not registered."""

    name = "drag"
    residual_axis = "v"
    c: Array = param("N*s/m", 0.0, -1e4, 1e4, "drag", strength=True, size=100.0)

    def force(self, at: Sliding) -> Array:
        """N."""
        return self.c * at.v


@pytest.fixture(scope="module")
def rig() -> hj.RigFile:
    return hj.paper.reference_rig()


RUN = {"reference": inputs.sine("300 N", "2 Hz"), "seconds": 0.6, "seed": 3}


@pytest.fixture(scope="module")
def run(rig):
    return hj.simulate(rig, motion=hj.to_and_fro("30 mm", "3 s"), **RUN)


def test_the_log_is_the_file_read(rig, run, tmp_path):
    run.save(tmp_path / "log.parquet")
    want, got = Log.load(tmp_path / "log.parquet", rig.channels), run.to_log()
    assert got.units == want.units
    assert list(got.signals) == list(want.signals)
    assert np.array_equal(got.time, want.time)
    for name, values in want.signals.items():
        assert np.array_equal(got.signals[name], values), name
    assert got.segments == want.segments


def test_the_frame_holds_readings_and_truth(run):
    frame = run.to_frame()
    names = ["u", "x", "P_a1", "P_a2", "P_s", "F", "F_d"]
    assert list(frame.columns[:7]) == names
    assert {"true_x", "true_v", "true_P_a1", "true_P_a2", "true_F"} <= set(frame)
    assert frame.index.name == "time"
    assert frame.attrs["units"]["P_a1"] == "Pa"
    assert "P" not in frame.attrs["units"]  # the controller's, a force
    assert np.array_equal(frame["F"], run["F"])
    assert np.array_equal(frame["F_d"], run["F_d"])
    assert np.array_equal(frame.index, run.t)
    again = Log.from_frame(frame[["u", "x", "P_a1", "F"]])
    assert np.array_equal(again.signals["F"], run["F"])


def test_a_run_shows_itself(run, tmp_path):
    assert repr(run).startswith("<simulation of 'reference rig': 0.6 s, F_d - F ")
    assert "600 samples" in run.summary() and "600 samples" in run._repr_html_()
    axes = run.plot().axes
    assert [ax.get_ylabel() for ax in axes] == [
        "force (kN)", "pressure (MPa)", "command (V)", "position (mm)",
    ]  # fmt: skip
    assert np.array_equal(axes[0].lines[1].get_ydata(), run["F_d"] / 1e3)
    with pytest.raises(hj.InputError, match="not a kind of log"):
        run.save(tmp_path / "log.txt")


def test_a_stroke_is_the_way_from_end_to_end(run):
    path = hj.to_and_fro("30 mm", "3 s").path(np.random.default_rng(0))
    t = np.linspace(0, 3, 3001)
    assert np.ptp(path(t, 0)) == pytest.approx(0.03, rel=1e-6)
    assert path(t, 0)[0] == pytest.approx(-0.015)
    assert np.max(path(t, 1)) == pytest.approx(np.pi * 0.03 / 3, rel=1e-6)


def test_effects_are_added_as_they_are(rig, run):
    """Also one that nobody registered; at zero nothing changes."""
    motion = hj.to_and_fro("30 mm", "3 s")
    plain = hj.simulate(rig, motion=motion, effects=[Drag()], **RUN)
    assert np.array_equal(plain["F"], run["F"])
    dragged = hj.simulate(rig, motion=motion, effects=[Drag(c=4000.0)], **RUN)
    assert np.ptp(dragged["true_F"] - run["true_F"]) > 1.0
    with pytest.raises(hj.InputError, match="has 'valve_lag' already; give it once"):
        hj.simulate(rig, effects=[ValveLag()])
    with pytest.raises(hj.InputError, match="expected an instance of an effect"):
        hj.simulate(rig, effects=[Drag])  # pyright: ignore


def test_added_effects_stand_in_the_order_of_the_vocabulary(rig):
    """The order on the command's path is not the order of the call."""
    bare = rig.from_text(rig.text.split("[effects.valve_lag]")[0])
    built = build_rig(bare, added=[Drag(), ValveLag(), *build_rig(rig).command[:1]])
    assert [c.name for c in built.command] == ["valve_delay", "valve_lag"]
    assert [c.name for c in built.friction] == ["drag"]


def test_gains_and_out(rig, tmp_path):
    out = tmp_path / "log.csv"
    run = hj.simulate(rig, gains={"k_p": "0.5 V/kN"}, out=out, **RUN)
    assert Log.load(out).time.size == 600
    assert float(run.loop.law.k_p) < 1e-7
    with pytest.raises(hj.InputError, match="gains: unknown key 'kp'"):
        hj.simulate(rig, gains={"kp": 1}, **RUN)
    with pytest.warns(RuntimeWarning, match="a pressure left"):
        gains = {"k_p": 1e9, "k_f": 1e9, "u_max": 1e9}
        hj.simulate(rig, gains=gains, **RUN)


def test_an_array_is_a_reference(rig):
    F_d = 100 * np.sin(np.arange(400) / 50)
    run = hj.simulate(rig, reference=F_d, motion=hj.locked("2 mm"))
    assert np.array_equal(run["F_d"], F_d)  # and the run ends with it
    assert np.all(run["true_x"] == 2e-3)
    assert any("does not move" in note for note in run.notes)


def test_a_log_is_reference_and_motion(rig, run, tmp_path):
    run.save(tmp_path / "log.csv")
    log = run.to_log()
    one = hj.simulate(rig, reference=log, motion=log)
    two = hj.simulate(rig, reference=tmp_path / "log.csv", motion=tmp_path / "log.csv")
    n = one.t.size
    assert 599 <= n <= 600
    assert np.allclose(one["F_d"], run["F_d"][:n], atol=1e-3)
    assert np.allclose(two["x"], one["x"], atol=1e-6)


class Step(inputs.AbstractReference):
    """A reference of a user's own."""

    def force(self, n, h, rng):
        """N."""
        return np.where(np.arange(n) * h < 0.1, 0.0, 200.0)


class Ramp(inputs.AbstractMotion):
    """A motion of a user's own."""

    def path(self, rng) -> Trajectory:
        """m."""
        return lambda t, nu: 0.01 * t if nu == 0 else 0.01 * np.ones_like(t) * (nu == 1)


def test_own_references_and_motions(rig):
    run = hj.simulate(rig, reference=Step(), motion=Ramp(), seconds=0.3)
    assert run["F_d"][-1] == 200.0 and run["F_d"][50] == 0.0
    assert run["true_x"][-1] == pytest.approx(0.00299)


WORDS = {
    "sine:250 N,2 Hz": inputs.sine("250 N", "2 Hz"),
    "sine": inputs.sine(),
    "sines:0.3 kN": inputs.sines(300.0),
    "noise:100 N,20 Hz": inputs.noise("100 N", 20),
    "noise": inputs.noise(),
}
MOTIONS = {
    "to-and-fro:3 cm/s,2 s": inputs.to_and_fro("30 mm/s", "2 s"),
    "to-and-fro": inputs.to_and_fro(0.03),
    "wander": inputs.wander(),
    "wander:1 cm/s": inputs.wander("10 mm/s"),
    "locked:5 mm": inputs.locked(5e-3),
}


def test_the_command_line_writes_the_same_values(rig):
    for word, value in WORDS.items():
        assert read_inputs(rig, word, "wander")[0] == value, word
    for word, value in MOTIONS.items():
        assert read_inputs(rig, "sines", word)[1] == value, word


INVALID: dict[str, tuple[Callable[[], object], str]] = {
    "unit": (lambda: hj.sine("300 Pa"), "sine: amplitude: unit 'Pa' does not fit"),
    "no unit": (lambda: hj.sine("300"), "sine: amplitude: '300' has no unit"),
    "sign": (lambda: hj.noise(-3.0), "noise: rms: '-3.0' must be above 0"),
    "period": (lambda: hj.to_and_fro("3 cm", 0.0), "period: '0.0' must be above 0"),
    "force": (lambda: hj.to_and_fro("3 N", 1.0), "speed_or_stroke: unit 'N' does not"),
    "nan": (lambda: hj.sines(float("nan")), "is not a quantity"),
    "bool": (lambda: hj.locked(True), "is not a quantity"),
}


@pytest.mark.parametrize("case", INVALID)
def test_invalid_quantities(case):
    make, said = INVALID[case]
    with pytest.raises(hj.InputError, match=said):
        make()


def test_invalid_references_and_motions(rig):
    for given, said in (
        ("sine:300 N", r"no such log; give a log's path, or a value such as hydrojax"),
        (object(), "reference: invalid object: expected a reference"),
        (np.zeros((3, 2)), "reference: invalid array"),
        (np.array([np.nan] * 100), "reference: invalid array"),
        (hj.noise(100, 600), "invalid band 600 Hz: expected less than half"),
    ):
        with pytest.raises(hj.InputError, match=said):
            hj.simulate(rig, reference=given, seconds=1.0)
    with pytest.raises(hj.InputError, match="motion: invalid int: expected a motion"):
        hj.simulate(rig, motion=3, seconds=1.0)  # pyright: ignore
    with pytest.raises(hj.InputError, match="motion: x from .* mm is beyond"):
        hj.simulate(rig, motion=hj.locked("3 m"), seconds=1.0)


def test_pint_quantities_and_numpy_numbers():
    pint = pytest.importorskip("pint")
    unit = pint.UnitRegistry()
    made = hj.sine(0.25 * unit.kN, np.float64(2.0), offset=-100)
    assert made == inputs.Sine(250.0, 2.0, -100.0)
    assert hj.to_and_fro(30 * unit.mm, 3 * unit.s) == hj.to_and_fro("30 mm", "3 s")
    t = np.arange(100) * 1e-3
    assert np.allclose(
        made.force(100, 1e-3, np.random.default_rng(0)),
        -100 + 250 * np.sin(4 * np.pi * t),
    )
