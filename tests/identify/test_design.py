"""The next experiment: its gradient, its limits, and that it comes true."""

from dataclasses import replace
from importlib import resources

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hydrojax.control.simulation import simulate_loop
from hydrojax.errors import InputError
from hydrojax.identify import api
from hydrojax.identify.case import open_case
from hydrojax.identify.design import design, design_problem
from hydrojax.identify.experiment import (
    FORCE_HZ,
    MOTION_HZ,
    ExcitationLimits,
    waves,
)
from hydrojax.rigfile import recording
from hydrojax.rigfile.build import build_loop, build_rig
from hydrojax.rigfile.scenarios import rig_scenario
from hydrojax.rigfile.schema import RigFile

LIMITS = ExcitationLimits(force=600.0, speed=0.02, travel=0.015, seconds=3.0)
FREE = {"beta": ("Pa", 8.5e8), "k_cp": ("N", 1250.0), "z_ss": ("m", 60e-6)}
COUNT = len(FORCE_HZ) + len(MOTION_HZ)


@pytest.fixture(scope="module")
def rig_file(tmp_path_factory):
    """The reference rig with three parameters to be found, at their values."""
    text = (resources.files("hydrojax") / "paper" / "reference.toml").read_text()
    for name, (unit, value) in FREE.items():
        old = next(x for x in text.splitlines() if x.startswith(f"{name} ="))
        ends = f'["{value / 3:g} {unit}", "{value * 3:g} {unit}"]'
        new = f'{name} = {{ start = "{value:g} {unit}", range = {ends} }}'
        text = text.replace(old, new, 1)
    path = tmp_path_factory.mktemp("excite") / "rig.toml"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def problem(rig_file):
    return design_problem(RigFile.load(rig_file), LIMITS)


@pytest.fixture(scope="module")
def found(rig_file):
    return design(RigFile.load(rig_file), LIMITS, steps=4)


@pytest.mark.parametrize("seed", [0, 1])
def test_any_amplitudes_keep_the_limits(seed):
    """Whatever the phases: the sums of amplitudes bound force, speed and travel."""
    at = jnp.asarray(np.random.default_rng(seed).normal(size=COUNT) * 4)
    force, motion = waves(at, LIMITS)
    w = 2 * np.pi * np.array(MOTION_HZ)
    assert np.sum(force) < LIMITS.force
    assert np.sum(motion * w) <= LIMITS.speed * (1 + 1e-12)
    assert np.sum(motion) <= LIMITS.travel * (1 + 1e-12)
    reached = max(
        np.sum(motion * w) / LIMITS.speed, np.sum(motion) / LIMITS.travel
    )  # one of the two is used up
    assert reached == pytest.approx(1.0)


@pytest.mark.slow
def test_the_gradient_is_that_of_differences(problem):
    cost = jax.jit(problem.cost)
    at = jnp.asarray(np.random.default_rng(2).normal(size=COUNT) * 0.3)
    slope = jax.jit(lambda at, d: jax.jvp(problem.cost, (at,), (d,))[1])
    for k in (0, 4, len(FORCE_HZ) + 2):
        d = jnp.zeros(COUNT).at[k].set(1.0)
        step = 1e-4
        by_difference = (cost(at + step * d) - cost(at - step * d)) / (2 * step)
        assert float(slope(at, d)) == pytest.approx(float(by_difference), rel=2e-3)


@pytest.mark.slow
def test_the_design_identifies_better(found):
    assert set(found.before) == set(FREE)
    gain = np.array([found.before[n] / found.after[n] for n in FREE])
    assert np.exp(np.mean(np.log(gain))) > 1.3
    assert np.max(np.abs(found.F_d)) < LIMITS.force
    assert np.max(np.abs(found.x)) < LIMITS.travel


@pytest.mark.study
def test_what_it_foresees_is_what_identify_finds(rig_file, found, tmp_path):
    """The design run in closed loop, logged and identified: the same spreads."""
    spec = RigFile.load(rig_file)
    scenario = tmp_path / "scenario.csv"
    recording.write_log(
        scenario, recording.scenario_columns(found.t, found.F_d, found.x, spec)
    )
    rig = build_rig(spec)
    loop = build_loop(spec, rig)
    again = rig_scenario(spec, loop, str(scenario), str(scenario), 60.0, seed=3)
    log = tmp_path / "log.csv"
    recording.write_log(log, recording.log_columns(simulate_loop(loop, again), spec))
    away = tmp_path / "away.toml"
    text = rig_file.read_text()
    for unit, value in FREE.values():
        text = text.replace(
            f'start = "{value:g} {unit}"', f'start = "{0.8 * value:g} {unit}"'
        )
    away.write_text(text)
    assert text.count("start") == len(FREE) and text != rig_file.read_text()
    state = api.fit_case(open_case(away, [log]), 1)
    gram = np.asarray(state.problem.sums_at(state.point.values).gram).sum(axis=0)
    at = [state.problem.model.names.index(n) for n in FREE]
    scale = state.problem.model.scale[at]
    spread = np.sqrt(np.diag(np.linalg.inv(gram[np.ix_(at, at)]))) * scale
    for name, std in zip(FREE, spread, strict=True):
        # The log's windows begin half a second in: a sixth of it is not used.
        assert std == pytest.approx(found.after[name], rel=0.25)
        value = state.point.values[state.problem.model.names.index(name)]
        assert abs(value - FREE[name][1]) < 5 * std


@pytest.mark.study
def test_two_effects_are_designed_for_together(rig_file):
    """Each strength is harder to identify beside the other effect than without it."""
    spec = RigFile.load(rig_file)
    both = design_problem(spec, LIMITS, ("internal_leakage", "external_leakage"))
    alone = design_problem(spec, LIMITS, ("internal_leakage",))
    assert both.setup.wanted == ("internal_leakage.c_il", "external_leakage.c_el")
    start = jnp.zeros(COUNT)
    beside, own = both.spreads(start)[0], alone.spreads(start)[0]
    assert float(beside) >= float(own) > 0


def test_what_cannot_be_designed(rig_file):
    spec = RigFile.load(rig_file)
    with pytest.raises(InputError, match="did you mean 'internal_leakage'"):
        design(spec, LIMITS, ("internal_leak", "stribeck"))
    with pytest.raises(InputError, match="two different effects"):
        design(spec, LIMITS, ("stribeck", "stribeck"))
    with pytest.raises(InputError, match="noise of F"):
        design(replace(spec, sensors={"P_a1": 9e3, "P_a2": 9e3}), LIMITS)
    with pytest.raises(InputError, match="nothing to identify"):
        design(replace(spec, parameters={}), LIMITS)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--separate", "stribeck"), "name two effects"),
        (("--separate", "stribeck", "stribek"), "stribek"),
        (("--force", "8"), 'write "8 N"'),
        (("--speed", "-1 mm/s"), "above 0"),
        (("--out", "scenario.txt"), "not a kind of log"),
    ],
)
def test_the_command_refuses_in_one_line(call, rig_file, tmp_path, words, said):
    out = () if "--out" in words else ("--out", tmp_path / "scenario.csv")
    got = call("excite", rig_file, *words, *out)
    assert got.code == 2 and said in got.err and got.err.count("\n") == 1
    assert not list(tmp_path.iterdir())
