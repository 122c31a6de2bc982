"""The peers of the speed benchmark, held to the simulator before they are timed."""

from __future__ import annotations

from collections.abc import Callable
from importlib import resources
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.speed import build_c, generated, peers_c, peers_scipy, replay_c
from benchmarks.speed.numbers import KEEP, KEPT, numbers
from benchmarks.speed.replays import NAMES, Replay
from hydrojax.control.loop import Loop, Scenario, run
from hydrojax.control.simulation import make_scenario
from hydrojax.control.waveforms import random_sines, sinusoidal_path
from hydrojax.effects import EFFECTS
from hydrojax.parameters import get, put
from hydrojax.plant.load import Inertia
from hydrojax.plant.replay import friction_memory, pressures, readings
from hydrojax.plant.rig import add
from hydrojax.plant.valve import metering_edges
from hydrojax.rigfile.build import build_loop
from hydrojax.rigfile.schema import RigFile

pytestmark = pytest.mark.slow

H, SAMPLES, LANES = 1e-3, 2000, 19

needs_c = pytest.mark.skipif(build_c.compiler() is None, reason="no C compiler")

C_PEERS = [("double", 1), ("double", 8), ("double", 32)]


@pytest.fixture(scope="module", autouse=True)
def cache(cache_home):
    """Compiled C is kept with the tests' other programs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(cache_home))
        yield


class Case(NamedTuple):
    """A loop, its course, and what the simulator makes of them, [..., N, 13]."""

    loop: Loop
    scenario: Scenario
    want: np.ndarray


@pytest.fixture(scope="module")
def loop() -> Loop:
    """The reference rig in closed loop: delay, spool, noise, encoder, adaptation."""
    file = resources.files("hydrojax") / "paper" / "reference.toml"
    with resources.as_file(file) as path:
        return build_loop(RigFile.load(path))


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    """Two seconds of noise, motion through standstill, and a supply that swings."""
    t = H * np.arange(SAMPLES + 1)
    F_d = random_sines(np.random.default_rng(1), t[:-1], 250.0)
    F_d += 250 * np.sin(2 * np.pi * 12 * t[:-1])
    P_s = 14e6 + 3e5 * np.sin(2 * np.pi * 5 * t)
    P_r = 0.25e6 + 2e4 * np.sin(2 * np.pi * 3 * t)
    return make_scenario(F_d, sinusoidal_path(0.03, 0.7), H, P_s, P_r, seed=0)


def simulated(loop: Loop, scenario: Scenario) -> np.ndarray:
    axes = jax.tree.map(lambda a: 0 if jnp.ndim(a) else None, loop)
    if any(jnp.ndim(a) for a in jax.tree.leaves(loop)):
        each = jax.vmap(lambda a, b: run(a, b, KEEP), in_axes=(axes, None))
        return np.asarray(jax.jit(each)(loop, scenario))
    return np.asarray(eqx.filter_jit(run)(loop, scenario, KEEP))


@pytest.fixture(scope="module")
def reference(loop, scenario) -> Case:
    return Case(loop, scenario, simulated(loop, scenario))


def instances(loop: Loop, scenario: Scenario, reach: Callable[[Loop], list]) -> Case:
    """Instances that differ in what is reached."""
    rng = np.random.default_rng(3)
    new = [a * jnp.asarray(rng.uniform(0.7, 1.2, LANES)) for a in reach(loop)]
    loop = eqx.tree_at(reach, loop, new)
    scenario = jax.tree.map(lambda a: a[:400], scenario)
    return Case(loop, scenario, simulated(loop, scenario))


@pytest.fixture(scope="module")
def swept(loop, scenario) -> Case:
    """Instances with gains of their own: the motion is worked out once in C."""
    return instances(
        loop,
        scenario,
        lambda o: [o.law.k_p, o.law.k_f, o.law.rate.A_a, o.law.rate.k_cp],
    )


@pytest.fixture(scope="module")
def many(loop, scenario) -> Case:
    """Instances with gains, rates, bounds and a plant of their own."""

    def reach(loop: Loop) -> list[Any]:
        law, rig, valve = loop.law, loop.rig, metering_edges(loop.rig.valve)
        return [
            law.k_p, law.k_f, *law.rate[1:], law.upper.k_cp, law.lower.k_fn,
            rig.chambers.beta, valve.c_n2, rig.mechanics.k_cn, rig.mechanics.z_ss,
            law.nominal.chambers.delta_1, law.nominal.mechanics.z_ss,
        ]  # fmt: skip

    return instances(loop, scenario, reach)


@pytest.fixture(scope="module")
def odd(loop, scenario) -> Case:
    """What the reference rig leaves out: filters, delay between parts, saturation."""
    path = ("valve_delay.tau_u", "valve_lag.tau", "valve_lag.zeta")
    rig = put(loop.rig, path, [1.33e-3, 1 / 1000, 0.5])
    law = loop.law
    law = eqx.tree_at(
        lambda law: [law.k_p, law.k_f, law.tau_d, law.tau_v, law.u_max, law.rate.k_1,
                     law.lower.k_1],
        law,
        [law.k_p / 2, law.k_f / 2, *map(jnp.asarray, (5e-4, 5e-4, 6.3, 1e-17, 1e-9))],
    )  # fmt: skip
    loop = eqx.tree_at(lambda o: [o.rig, o.law, o.sensors.step], loop,
                       [rig, law, jnp.asarray(0.0)])  # fmt: skip
    scenario = jax.tree.map(lambda a: a[:1200], scenario)
    return Case(loop, scenario, simulated(loop, scenario))


def off(got: np.ndarray, want: np.ndarray) -> float:
    """The largest error over the largest value of each signal, of all signals."""
    axes = tuple(range(want.ndim - 1))
    return float(np.max(np.abs(got - want).max(axes) / np.abs(want).max(axes)))


def rms(case: Case) -> np.ndarray:
    F = case.want[..., KEPT.index("F")]
    return np.sqrt(np.mean((np.asarray(case.scenario.F_d) - F) ** 2, axis=-1))


def test_the_cases_are_alive(reference, many, odd):
    """Every estimate that is adapted moves, spools and lanes differ, u saturates."""
    moves = np.ptp(reference.want, axis=0) > 0
    assert moves[:4].all() and moves[[5, 6, 7, 8]].all()
    assert (np.ptp(odd.want, axis=0) > 0).all()
    u = odd.want[:, 0]
    assert np.sum(np.abs(u) == 6.3) > 3 and np.sum(u > 0) > 50 and np.sum(u < 0) > 50
    assert (np.ptp(many.want[:, -1, 1:4], axis=0) > 0).all() and np.ptp(rms(many)) > 1


# -- closed loops --


@needs_c
@pytest.mark.parametrize(("real", "lanes"), C_PEERS)
@pytest.mark.parametrize("name", ["reference", "swept", "many", "odd"])
def test_c_is_the_simulator(request, name, real, lanes):
    case = request.getfixturevalue(name)
    found, got = peers_c.prepare(case.loop, case.scenario, real, lanes, 2, True)()
    assert off(got, np.atleast_3d(case.want).reshape(got.shape)) < 1e-9
    assert np.allclose(found, rms(case), rtol=1e-9)


@needs_c
@pytest.mark.parametrize("name", ["swept", "many"])
def test_generated_lanes_are_the_simulator(request, name):
    """A group and a part of one; gains alone differ, and the plant with them."""
    case = request.getfixturevalue(name)
    found, got = generated.prepare(case.loop, case.scenario, 2, True)()
    assert got.shape == case.want.shape
    assert off(got, case.want) < 1e-9
    assert np.allclose(found, rms(case), rtol=1e-9)


def test_lanes_for_a_batch():
    assert [peers_c.lanes_for(n) for n in (1, 8, 9, 16, 4096)] == [8, 8, 16, 16, 32]
    assert [peers_c.lanes_for(n, "float") for n in (1, 17, 4096)] == [16, 32, 64]


@needs_c
@pytest.mark.parametrize("lanes", [1, 64])
def test_c_in_single_precision(reference, lanes):
    """Encoder counts turn at ties, one step (64 nm) is 64 um/s: so much is u off."""
    case = reference
    found, got = peers_c.prepare(case.loop, case.scenario, "float", lanes, 1, True)()
    assert off(got[0], case.want) < 1e-2
    F = got[0, :, KEPT.index("F")] - case.want[:, KEPT.index("F")]
    assert np.sqrt(np.mean(F**2)) < 1e-3 * case.want[:, 3].std()
    assert np.allclose(found, rms(case), rtol=3e-3)


@needs_c
@pytest.mark.parametrize("source", ["loop.c", "replay.c"])
def test_lanes_become_vectors(source):
    if "gcc" not in str(build_c.compiler()):
        pytest.skip("gcc says which loops it vectorised")
    said = build_c.vectorised(source, "double", 16)
    assert len({line for line, _ in said}) >= 4
    assert max(size for _, size in said) >= 16


def test_numba_is_the_simulator(reference, many, odd):
    pytest.importorskip("numba")
    from benchmarks.speed import peers_numba

    for case in (reference, many, odd):
        found, got = peers_numba.prepare(case.loop, case.scenario, 2, True)()
        assert off(got, np.atleast_3d(case.want).reshape(got.shape)) < 1e-9
        assert np.allclose(found, rms(case), rtol=1e-9)


def apart(F: np.ndarray, want: np.ndarray) -> float:
    """RMS of an error of F over F's standard deviation."""
    return float(np.sqrt(np.mean((F - want) ** 2)) / want.std())


def test_scipy_is_near(reference, odd):
    """The plant in continuous time: what is apart is both schemes' own error."""
    for case, samples in ((reference, 400), (odd, 200)):
        scenario = jax.tree.map(lambda a, n=samples: a[:n], case.scenario)
        F = peers_scipy.prepare(case.loop, scenario)()
        assert apart(F, case.want[:samples, KEPT.index("F")]) < 1e-3


def test_diffrax_is_near(reference, many):
    pytest.importorskip("diffrax")
    from benchmarks.speed import peers_diffrax

    F = peers_diffrax.prepare(reference.loop, reference.scenario, signals=True)()
    assert apart(F, reference.want[:, KEPT.index("F")]) < 1e-4
    found = peers_diffrax.prepare(many.loop, many.scenario)()
    assert np.allclose(found, rms(many), rtol=1e-3)


def test_what_the_peers_have_not_is_refused(loop, odd):
    with pytest.raises(ValueError, match="driven"):
        numbers(eqx.tree_at(lambda o: o.load, loop, Inertia()))
    leaky = add(loop.rig, [EFFECTS["internal_leakage"]()])
    with pytest.raises(ValueError, match="internal_leakage"):
        numbers(eqx.tree_at(lambda o: o.rig, loop, leaky))
    late = put(loop.rig, ["valve_lag.tau"], [0.0])
    with pytest.raises(ValueError, match="valve_lag"):
        peers_scipy.prepare(eqx.tree_at(lambda o: o.rig, loop, late), odd.scenario)


# -- replays --


def predicted(rig: Any, log: Any) -> Callable[[jax.Array], jax.Array]:
    motion, w, P_0 = jax.tree.map(jnp.asarray, log[:3])

    def replay(params):
        moved = put(rig, NAMES, params)
        past = friction_memory(moved, motion).within(w)
        return readings(moved, w, *pressures(moved, motion, w, P_0), past)

    return replay


@pytest.fixture(scope="module", params=["bare", "spool", "uneven, substeps"])
def replayed(request, rig, drive):
    """A rig with its log, its parameters, and the simulator's replay and Jacobian."""
    log = drive(2, 0.3) if request.param.startswith("uneven") else drive()
    if request.param == "spool":
        rig = put(add(rig, [EFFECTS["valve_lag"]()]), ["valve_lag.tau"], [1 / 1257])
    replay, params = predicted(rig, log), get(rig, NAMES)
    want = jax.jit(replay)(params), jax.jit(jax.jacfwd(replay))(params)
    given = Replay(rig, log.motion, log.windows, log.P_0)
    return given, np.asarray(params), *map(np.asarray, want)


def hold(got: np.ndarray, J: np.ndarray, within: float):
    """Both in units of the noise, each column to its largest entry."""
    noise = np.array([9e3, 9e3, 2.5])[:, None]
    most = np.abs(J / noise).max((0, 1, 2))
    assert got.shape == J.shape and np.all(most > 0)
    assert np.all(np.abs((got - J) / noise).max((0, 1, 2)) < within * most)


@needs_c
@pytest.mark.parametrize("lanes", [1, 8])
def test_c_is_the_replay(replayed, lanes):
    given, params, want, J = replayed
    peer = replay_c.prepare(given, lanes, 2)
    assert off(peer.replay(params), want) < 1e-9
    hold(peer.jacobian(params), J, 1e-5)


def test_numba_is_the_replay(replayed):
    pytest.importorskip("numba")
    from benchmarks.speed import replay_numba

    given, params, want, J = replayed
    peer = replay_numba.prepare(given, 2)
    assert off(peer.replay(params), want) < 1e-9
    hold(peer.jacobian(params), J, 1e-5)


def test_casadi_is_the_replay(replayed):
    pytest.importorskip("casadi")
    from benchmarks.speed import replay_casadi

    given, params, want, J = replayed
    for threads in (1, 2):
        peer = replay_casadi.prepare(given, threads)
        assert off(peer.replay(params), want) < 1e-9
        hold(peer.jacobian(params), J, 1e-9)


def test_replays_that_the_peers_have_not_are_refused(rig, drive):
    log = drive()
    late = add(rig, [EFFECTS["valve_delay"]()])
    with pytest.raises(ValueError, match="valve_lag"):
        _ = Replay(late, log.motion, log.windows, log.P_0).lag
    uneven = drive(1, 0.3)
    slow = add(rig, [EFFECTS["valve_lag"]()])
    with pytest.raises(ValueError, match="even ticks"):
        _ = Replay(slow, uneven.motion, uneven.windows, uneven.P_0).lag
