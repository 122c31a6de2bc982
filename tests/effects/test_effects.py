"""One test over all effects: absent at zero, alive there, declared in full."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pint
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from hydrojax.effects import EFFECTS as KNOWN
from hydrojax.identify.estimation.columns import (
    NUISANCE,
    READINGS,
    SUPPLY_BLOCKS,
    Batch,
    ParametricRig,
    basis,
)
from hydrojax.identify.estimation.drive import driven_pressures
from hydrojax.identify.estimation.memory import recalled
from hydrojax.identify.estimation.sensitivity import (
    SLOPE_SPREAD,
    sensitivities,
)
from hydrojax.parameters import get, parameter_specs, put, specs
from hydrojax.plant.chambers import Point
from hydrojax.plant.friction import Sliding, run_linear, run_stop
from hydrojax.plant.places import PLACES
from hydrojax.plant.replay import at_start, friction_memory, pressures, readings
from hydrojax.plant.rig import add
from hydrojax.plant.state import StepInput
from hydrojax.plant.step import act, start
from hydrojax.plant.valve import MeteringEdges
from hydrojax.programs.compiled import program

EFFECTS: dict[str, Any] = KNOWN
"""Each class with the method of its own place."""

SHAPES = {
    "gravity_load": {"radius": 0.085},
    "position_friction": {"x_from": 1.7e-3, "x_to": 2.3e-3},
}
"""What an effect takes from the rig and the logs: here, of the synthetic ones."""

REACHED = {"port_relief.P_set1": 5e6, "port_relief.P_set2": 6e6}
"""Settings that the synthetic logs reach, where those of the declaration are beyond."""

ALL = (0, 1, 2)
REACH = {
    "command": ALL,
    "returns": ALL,
    "orifice": ALL,
    "line": ALL,
    "supply": ALL,
    "flow": ALL,
    "volume": ALL,
    "compliance": ALL,
    "stretch": ALL,
    "velocity": (2,),
    "level": (2,),
    "friction": (2,),
    "switch": (2,),
    "hysteresis": (2,),
    "force": (2,),
    "sensor_P": (0, 1),
    "sensor_F": (2,),
}
"""Which of P_a1, P_a2, F an effect at each place can move in a replay."""

NOISE = np.array([9e3, 9e3, 2.5])

STRENGTHS = [
    (name, field)
    for name, effect in EFFECTS.items()
    for field, spec in specs(effect).items()
    if spec.strength
]


def make(name):
    return EFFECTS[name](**SHAPES.get(name, {}))


class Replay:
    """The replay and its derivative to some parameters, compiled once and counted."""

    def __init__(self, drive, names=()):
        self.names, self.traces = list(names), 0
        motion, w, P_0 = jax.tree.map(jnp.asarray, drive[:3])

        def replay(rig):
            P = pressures(rig, motion, w, P_0)
            return readings(rig, w, *P, friction_memory(rig, motion).within(w))

        def both(rig, along):
            self.traces += 1
            if not self.names:
                return replay(rig), None
            here = get(rig, self.names)
            return jax.jvp(lambda p: replay(put(rig, self.names, p)), (here,), (along,))

        self._both = program(both)

    def __call__(self, rig, name=None):
        """Readings [W, T, 3] and their derivative to the named parameter."""
        return self._both(rig, np.array([float(n == name) for n in self.names]))


OF_RIG = ("beta", "c_p1", "c_n2", "delta", "k_cp", "k_fn")
"""Parameters of a rig without effects."""

ONE_SENSOR = {
    "pressure_sensor_bias.b_1": (0,),
    "pressure_sensor_bias.b_2": (1,),
    "pressure_sensor_gain.eps_1": (0,),
    "pressure_sensor_gain.eps_2": (1,),
}
"""Strengths that stand on one sensor only."""

ONE_CHAMBER = {
    "dead_volume.V_01": (0, 2),
    "dead_volume.V_02": (1, 2),
    "return_overlap.o_n1": (0, 2),
    "return_overlap.o_n2": (1, 2),
    "counterbalance.k_1": (0, 2),
    "counterbalance.k_2": (1, 2),
    "port_relief.g_1": (0, 2),
    "port_relief.g_2": (1, 2),
}

LOGGER = {"signal_filter.tau": ALL}
"""Strengths of what filters the logged supply too, by which the pressures go."""


@pytest.fixture(scope="module")
def log(drive):
    return drive()


@pytest.fixture(scope="module")
def without(rig, log):
    return np.asarray(Replay(log)(rig)[0])


@pytest.fixture(scope="module")
def replays(log):
    """One compiled replay for every set of effects, shared by the tests below."""

    @functools.cache
    def of(*names):
        own = [f"{name}.{field}" for name in names for field in specs(EFFECTS[name])]
        return Replay(log, [*own, *OF_RIG])

    return of


@pytest.fixture(params=[False, pytest.param(True, marks=pytest.mark.slow)])
def beside(request):
    """Which effects stand in the rig beside the one that is tested: all, or none.

    Of each alone a program is compiled, of all together one.
    """
    return lambda name: (name,) if request.param else tuple(EFFECTS)


def test_the_synthetic_log_wakes_every_mechanism(rig, log, without):
    """What the tests below rest on: both ways of everything, and mixed friction."""
    w = log.windows
    past = jax.jit(friction_memory)(rig, log.motion)
    z, speed = np.asarray(past.z), np.asarray(past.speed)
    switch = np.asarray(rig.mechanics.switch(speed))
    for signal in (w.u, w.v, z, without[..., 2]):
        assert signal.min() < 0 < signal.max()
    assert switch.min() < 0.3 and switch.max() > 0.7
    assert without[..., :2].min() > 1e6 and without[..., :2].max() < 13e6


# -- absent, alive, and nothing compiled twice --


def test_dormant_effects_are_absent(rig, without, replays):
    dormant = add(rig, [make(name) for name in EFFECTS])
    assert np.allclose(replays(*EFFECTS)(dormant)[0], without, rtol=1e-12, atol=1e-9)
    for name in OF_RIG:  # nor do they change what anything else does
        (_, alone), (_, among) = replays()(rig, name), replays(*EFFECTS)(dormant, name)
        assert np.any(alone) and np.allclose(among, alone, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", EFFECTS)
def test_dormant_effect_is_absent(rig, without, replays, name):
    assert np.allclose(
        replays(name)(add(rig, [make(name)]))[0], without, rtol=1e-12, atol=1e-9
    )


@pytest.mark.parametrize(("name", "field"), STRENGTHS)
def test_dormant_effect_is_alive(rig, without, replays, beside, name, field):
    """The derivative at zero is the one-sided difference, and is not zero."""
    names = beside(name)
    rig, replay = add(rig, [make(n) for n in names]), replays(*names)
    reached = {n: v for n, v in REACHED.items() if n in parameter_specs(rig)}
    rig = put(rig, list(reached), list(reached.values()))
    strength = f"{name}.{field}"
    spec = parameter_specs(rig)[strength]
    got = np.asarray(replay(rig, strength)[1]) * spec.scale / NOISE

    def difference(step):
        at = put(rig, [strength], [spec.default + step * spec.scale])
        return (replay(at)[0] - without) / step / NOISE

    want = 2 * difference(5e-4) - difference(1e-3)  # free of the first-order error
    reach = REACH[EFFECTS[name].place]
    reach = (ONE_SENSOR | ONE_CHAMBER | LOGGER).get(strength, reach)
    for channel in ALL:
        if channel in reach:
            size = np.linalg.norm(want[..., channel])
            assert np.linalg.norm(got[..., channel]) > 1e-3
            assert np.linalg.norm((got - want)[..., channel]) < 1e-3 * size
        else:
            assert not np.any(got[..., channel])


@pytest.mark.parametrize("name", EFFECTS)
def test_new_value_compiles_nothing(rig, replays, beside, name):
    """A default, a Python float, an integer, NumPy's and JAX's: one program."""
    names = beside(name)
    replay, dormant = replays(*names), add(rig, [make(n) for n in names])
    replay(dormant)
    before = replay.traces
    fields = {
        field: 0.5 * spec.scale if spec.strength else spec.default
        for field, spec in specs(EFFECTS[name]).items()
    }
    own, values = [f"{name}.{f}" for f in fields], list(fields.values())
    for new in (values, np.array(values), jnp.array(values), [0] * len(values)):
        replay(put(dormant, own, new))
    given = EFFECTS[name](**SHAPES.get(name, {}), **fields)
    replay(add(rig, [given if n == name else make(n) for n in names]))
    assert replay.traces == before


# -- what each effect is, in plain NumPy --

AT = Point(
    *np.array([5e6, 6.5e6, 14e6, 0.25e6]),
    (0.4, 0.1),
    np.float64(0.02),
    np.float64(0.01),
)
SLIDING = Sliding(
    t=np.float64(7.0),
    x=np.float64(0.02),
    v=np.float64(0.004),
    a=np.float64(0.6),
    z=np.float64(5e-5),
    z_rate=np.float64(-0.002),
    speed=np.float64(0.003),
    P_a1=np.float64(5e6),
    P_a2=np.float64(6.5e6),
    P_s=np.float64(14e6),
    P_seal=np.float64(5.75e6),
)


def test_leakages_are_laminar():
    got = EFFECTS["internal_leakage"](c_il=3e-13).flow(AT)
    assert np.allclose(got, (4.5e-7, -4.5e-7), rtol=1e-12)  # from high to low
    got = EFFECTS["external_leakage"](c_el=2e-13).flow(AT)
    assert np.allclose(got, (-2e-13 * 4.75e6, -2e-13 * 6.25e6), rtol=1e-12)


def test_a_relief_valve_opens_above_its_setting():
    """Of chamber 2 alone, whose pressure over the return is above it."""
    relief = EFFECTS["port_relief"](g_1=1e-11, g_2=2e-11, P_set1=5e6, P_set2=6e6)
    assert np.allclose(relief.flow(AT), (0.0, -2e-11 * 0.25e6), rtol=1e-12)
    low = EFFECTS["port_relief"](g_1=1e-11, g_2=2e-11, P_set1=4e6, P_set2=7e6)
    assert np.allclose(low.flow(AT), (-1e-11 * 0.75e6, 0.0), rtol=1e-12)


def test_supply_line_drop_is_the_root_of_its_equation():
    """The flow through edge and line in series, found by bracketing."""
    k_s, edge, available = 5e14, 3e-9, 9e6
    q = brentq(
        lambda q: q - edge * np.sqrt(available - k_s * q**2), 0, 1e-4, xtol=1e-20
    )
    drop = EFFECTS["supply_line_drop"](k_s=k_s).drop(edge, available)
    assert drop == pytest.approx(k_s * q**2, rel=1e-9)


@pytest.mark.parametrize("up", [True, False])
@pytest.mark.parametrize("orifices", [(), (EFFECTS["underlap"](),)])
def test_return_line_drop_is_the_root_of_its_equation(up, orifices):
    """Of what drains, and of nothing that fills."""
    valve = MeteringEdges(c_p1=3e-9, c_n1=2e-9, c_p2=2.5e-9, c_n2=3.5e-9)
    u, k_r = (0.8 if up else -0.8), 4e14
    at = AT._replace(opening=(np.float64(u),))
    line = EFFECTS["return_line_drop"](k_r=k_r)
    free = valve.flows(at, (), orifices)
    lost = valve.flows(at, (line,), orifices)
    fills, drains = (0, 1) if up else (1, 0)
    assert lost[fills] == free[fills]
    edge = 0.8 * (3.5e-9 if up else 2e-9)
    available = (at.P_a2 if up else at.P_a1) - at.P_r
    q = brentq(
        lambda q: q - edge * np.sqrt(available - k_r * q**2), 0, 1e-4, xtol=1e-20
    )
    assert lost[drains] == pytest.approx(-q, rel=1e-6)  # the laminar core: 4e-8


@pytest.mark.parametrize("n", [1.0, 1.4])
def test_entrained_air_is_a_polytropic_gas(n):
    """Compliance is the rate at which the free gas shrinks, `-dV/dp` per volume."""
    alpha, P, atm = 5e-3, 3e6, 101325.0
    step = 1.0

    def gas(P):
        return alpha * (atm / (P + atm)) ** (1 / n)

    want = -(gas(P + step) - gas(P - step)) / (2 * step)
    got = EFFECTS["entrained_air"](alpha=alpha, n=n).compliance(P)
    assert got == pytest.approx(want, rel=1e-8)


def position_wave(x, s, c, waves):
    angle = 2 * np.pi * waves * (x - 0.01) / 0.06
    return sum(
        a * np.sin((i + 1) * angle) + b * np.cos((i + 1) * angle)
        for i, (a, b) in enumerate(zip(s, c, strict=True))
    )


@pytest.mark.parametrize(
    ("name", "fields", "want"),
    [
        ("stribeck", {"k_st": 80.0, "v_s": 3e-3}, 80 * np.exp(-((4 / 3) ** 2))),
        (
            "pressure_friction",
            {"kappa": 8e-6, "kappa_v": 3e-4},
            8e-6 * 5.75e6 + 3e-4 * 0.004 * 5.75e6,
        ),
        ("friction_drift", {"a": 0.3, "tau": 5.0}, 150 * (np.exp(-7 / 5) - 1)),
        (
            "position_friction",
            {
                "x_from": -0.02,
                "x_to": 0.04,
                "waves": 1.3,
                **dict(zip(("s_1", "s_2", "s_3"), (0.1, -0.2, 0.3), strict=True)),
                **dict(zip(("c_1", "c_2", "c_3"), (-0.05, 0.15, 0.25), strict=True)),
            },
            500 * position_wave(0.02, (0.1, -0.2, 0.3), (-0.05, 0.15, 0.25), 1.3),
        ),
    ],
)
def test_level_effect_is_its_formula(name, fields, want):
    got = EFFECTS[name](**fields).level(SLIDING, np.float64(500.0))
    assert got == pytest.approx(want, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "fields", "want"),
    [
        ("viscous_friction", {"b": 400.0}, 1.6),
        ("bristle_damping", {"sigma_1": 5e3}, -10.0),
        (
            "film_friction",
            {"k_h": 30.0, "kappa_h": 4e-6, "n": 0.5},
            0.4 * (0.4**2 + 0.01**2) ** -0.25 * (30 + 4e-6 * 5.75e6),
        ),
        ("payload_inertia", {"m": 8.0}, -4.8),
        (
            "gravity_load",
            {
                "w_s": 90 * np.cos(0.4),
                "w_c": 90 * np.sin(0.4),
                "radius": 0.085,
            },
            90 * np.sin(0.02 / 0.085 + 0.4),
        ),
    ],
)
def test_force_effect_is_its_formula(name, fields, want):
    assert EFFECTS[name](**fields).force(SLIDING) == pytest.approx(want, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "fields", "want"),
    [
        ("rod_compliance", {"give": 2e-8}, 2e-8 * 400.0),
        ("backlash", {"b": 1e-4, "F_w": 200.0}, 0.5e-4 * np.tanh(2.0)),
    ],
)
def test_stretch_effect_is_its_formula(name, fields, want):
    assert EFFECTS[name](**fields).stretch(400.0) == pytest.approx(want, rel=1e-12)


# -- friction's lag --


def film_of(tau, speed, h):
    """The film's speed at every tick, from the speed there."""
    follow = EFFECTS["frictional_lag"](tau_h=tau).follow
    speed = jnp.asarray(speed)
    return np.asarray(run_linear(*follow(speed[:-1], speed[1:], h), speed[0]))


@pytest.mark.parametrize("tau", [1e-4, 2e-3, 0.08, 0.3])
def test_the_film_follows_its_equation(tau):
    """For a speed that runs straight from tick to tick, of uneven length."""
    rng = np.random.default_rng(2)
    h = 1e-3 * rng.uniform(0.5, 2.0, 60)
    t = np.r_[0.0, np.cumsum(h)]
    speed = np.abs(np.cumsum(rng.normal(0, 2e-3, t.size)))
    w, want = speed[0], []
    for i in range(h.size):
        w = solve_ivp(
            lambda s, w, i=i: (np.interp(s, t[i : i + 2], speed[i : i + 2]) - w) / tau,
            (t[i], t[i + 1]),
            [w],
            rtol=1e-10,
            atol=1e-14,
            method="LSODA",
        ).y[0, -1]
        want.append(w)
    assert np.allclose(film_of(tau, speed, h), want, rtol=0, atol=1e-9)


def test_a_film_that_is_not_late_is_the_speed_itself():
    speed = np.abs(np.random.default_rng(0).normal(0, 0.02, 300))
    assert np.array_equal(film_of(0.0, speed, np.full(299, 1e-3)), speed[1:])


# -- friction's hysteresis --


def slipping(moves, reach, w):
    """The stop operator, step by step."""
    out = []
    for move in moves:
        w = min(max(w + move, -reach), reach)
        out.append(w)
    return np.array(out)


@pytest.mark.parametrize("n", [1, 17, pytest.param(400, marks=pytest.mark.slow)])
@pytest.mark.parametrize("reach", [2e-5, 3e-4, 1.0])
def test_the_stop_operator_is_clipped_step_by_step(n, reach):
    rng = np.random.default_rng(n)
    moves = np.cumsum(rng.normal(0, 3e-5, (3, n)), axis=1) * rng.choice([1, -1], (3, n))
    first = reach * np.array([-1.0, 0.2, 1.0])
    want = np.stack(
        [slipping(*row) for row in zip(moves, [reach] * 3, first, strict=True)]
    )
    assert np.allclose(run_stop(moves[None], reach, first), want, rtol=0, atol=1e-15)
    # Two moves to a step: the states after every second one.
    pairs = np.moveaxis(np.pad(moves, ((0, 0), (0, n % 2))).reshape(3, -1, 2), -1, 0)
    every = np.pad(want, ((0, 0), (0, n % 2)), "edge")[:, 1::2]
    assert np.allclose(run_stop(pairs, reach, first), every, rtol=0, atol=1e-15)

    def last(reach):
        return run_stop(moves[None], reach, 0.2 * first)[:, -1]

    step = 1e-7 * reach
    by, ahead, behind = jax.jacfwd(last)(reach), last(reach + step), last(reach - step)
    assert np.allclose(by, (ahead - behind) / (2 * step), rtol=0, atol=1e-5)


def test_a_slip_element_holds_nothing_in_its_play_and_its_force_beyond():
    slip = EFFECTS["maxwell_slip"](f_p=900.0, f_n=600.0, z_m=4e-3, gap=0.25)
    w = 1e-3 * np.array([-4.0, -2.5, -1.0, -0.3, 0.0, 0.9, 1.0, 1.6, 4.0])
    want = [-600.0, -300.0, 0.0, 0.0, 0.0, 0.0, 0.0, 180.0, 900.0]
    assert np.allclose(slip.force(w), want, rtol=1e-12, atol=1e-9)
    held = np.array([-2000.0, -600.0, -150.0, 60.0, 450.0, 900.0, 5000.0])
    kept = slip.force(slip.deflection(held))
    assert np.allclose(kept, np.clip(held, -600, 900), rtol=1e-12)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("v", [0.012, 1e-4, -1e-4, -0.02])
@pytest.mark.parametrize("turn", [-1.0, -0.4, 0.0, 0.7, 1.0])
def test_all_that_depends_on_speed_sees_the_film(rig, v, turn, share):
    """Along the bristle, when the motion turns, or by a share along the velocity."""
    film, friction = 9e-3, rig.mechanics
    k, s = EFFECTS["frictional_lag"](tau_h=0.1, k=0.8, s=share).turns()
    late = film - abs(v)
    at = SLIDING._replace(
        v=np.float64(v),
        z=turn * friction.z_ss,
        lag=late,
        lag_z=k * late,
        lag_v=s * late,
    )
    rise = EFFECTS["stribeck"](k_st=80.0, v_s=6e-3)
    drag = EFFECTS["viscous_friction"](b=700.0)
    got = float(friction.sliding_force(at, (rise,), (drag,)))
    seen = v + 0.8 * ((1 - share) * turn + share * v / np.hypot(v, 1e-4)) * late
    level = (900.0 if turn > 0 else 1200.0) + 80 * np.exp(-((film / 6e-3) ** 2))
    fall = 3e3 if seen > 0 else -2e3
    assert got == pytest.approx(turn * level + 100.0 + (700.0 - fall) * seen, rel=1e-12)


# -- a rod that gives, in a replay --


@pytest.mark.parametrize(
    ("name", "fields"),
    [("rod_compliance", {"give": 6e-8}), ("backlash", {"b": 4e-5, "F_w": 60.0})],
)
def test_friction_sees_the_piston(rig, drive, name, fields):
    """A log whose encoder is the piston itself, moved by hand, gives the same."""
    effect, log = EFFECTS[name](**fields), drive()
    soft = jax.jit(friction_memory)(add(rig, [effect]), log.motion)
    m = log.motion
    quarters = np.arange(5) / 4
    F = m.F[:, :-1, None] + quarters * np.diff(m.F, axis=1)[..., None]
    s = np.asarray(effect.stretch(F))
    t = np.r_[0.0, np.cumsum(m.h[0])]
    rate = np.gradient(np.asarray(effect.stretch(m.F)), t, axis=1)
    moved = m._replace(dx=m.dx + np.diff(s, axis=-1))
    stiff = jax.jit(friction_memory)(rig, moved)
    assert np.allclose(soft.z, stiff.z, rtol=0, atol=1e-12)
    assert np.allclose(soft.speed, stiff.speed, rtol=0, atol=1e-12)
    assert np.max(np.abs(soft.z - friction_memory(rig, m).z)) > 2e-6
    off = np.abs(np.asarray(soft.v) - m.v - rate)[:, 1:-1]
    assert np.max(off) < 0.1 * np.ptp(rate)


# -- a rod that gives, in simulation --


@pytest.mark.slow
def test_what_stretches_gives_way_as_the_force_rises(rig):
    """Joint locked, valve open: against the same plant in scipy, with its own force.

    The oil's stiffness is twice the rod's: an explicit coupling would not stand.
    """
    k, h, ticks = 1e7, 2.5e-4, 240
    for effect in (
        EFFECTS["rod_compliance"](give=1 / k),
        EFFECTS["backlash"](b=1e-4, F_w=40.0),
    ):
        soft = add(rig, [effect])
        lane = jnp.zeros(1)
        inputs = StepInput(
            h=lane + h,
            u=lane,
            P_s=jnp.full((1, 2), 14e6),
            P_r=jnp.full((1, 2), 0.25e6),
            x=jnp.full((1, 3), 2e-3),
            dx=jnp.zeros((1, 4)),
            v=lane,
            a=lane,
            t=lane,
        )
        state, _ = start(soft, inputs, (lane + 7e6, lane + 6.9e6))

        def one(state, i, soft=soft, inputs=inputs, lane=lane):
            opening = (lane, lane + 1.0)
            state = act(soft, state, opening, inputs)
            F = soft.output_force(soft.sliding(state, inputs))
            return state, jnp.stack([*state.P, F])

        got = np.asarray(jax.lax.scan(one, state, jnp.arange(ticks))[1])[..., 0]

        def force(P_1, P_2, soft=rig):
            at = SLIDING._replace(
                x=2e-3, v=0.0, a=0.0, z=0.0, z_rate=0.0, speed=0.0, P_a1=P_1, P_a2=P_2
            )
            return float(soft.output_force(at))

        def rates(t, P, effect=effect):
            at = AT._replace(P_a1=P[0], P_a2=P[1], opening=(0.0, 1.0), x=2e-3, v=0.0)
            still = np.array(rig.pressure_rates(at))
            moving = np.array(rig.pressure_rates(at._replace(v=1.0)))
            here, d = force(*P), 20.0
            follow = (force(P[0], P[1] + d) - here) / (1.18e-3 * d)
            steep = float(effect.stretch(here + 1e-3) - effect.stretch(here - 1e-3))
            c = follow * steep / 2e-3
            area = np.array([-1.18e-3, 1.18e-3])
            v = c * area @ still / (1 - c * area @ (moving - still))
            return still + (moving - still) * v

        out = solve_ivp(
            rates, (0, h * ticks), [7e6, 6.9e6], rtol=1e-8, max_step=1e-3,
            t_eval=h * np.arange(1, ticks + 1),
        )  # fmt: skip
        want = out.y.T
        moved = np.ptp(want[:, 1])
        assert np.max(np.abs(got[:, :2] - want)) < 0.01 * moved
        assert got[0, 2] < -50 and got[-1, 2] > 200


@pytest.mark.parametrize(
    ("name", "fields"),
    [("rod_compliance", {"give": 6e-8}), ("backlash", {"b": 5e-5, "F_w": 40.0})],
)
def test_force_stretch_and_bristle_agree_while_it_slides(rig, name, fields):
    """What the rod was solved for is what the plant then puts out, without chatter.

    The bristle is about as stiff as the rod: it cannot lag a step behind.
    """
    soft, h, n = add(rig, [EFFECTS[name](**fields)]), 2.5e-4, 1200
    t = h * jnp.arange(n + 1)
    x = 2e-3 + 4e-4 * jnp.sin(2 * jnp.pi * 9.0 * t)

    def inputs_at(i):
        return StepInput(
            h=jnp.asarray(h),
            u=0.6 * jnp.sin(2 * jnp.pi * 17.0 * t[i]),
            P_s=jnp.full(2, 14e6),
            P_r=jnp.full(2, 0.25e6),
            x=jnp.stack([x[i], (x[i] + x[i + 1]) / 2, x[i + 1]]),
            dx=(x[i + 1] - x[i])[None],
            v=(x[i + 1] - x[i]) / h,
            a=jnp.zeros(()),
            t=t[i + 1],
        )

    def one(state, i):
        inputs = inputs_at(i)
        opening = jnp.maximum(inputs.u, 0.0), jnp.maximum(-inputs.u, 0.0)
        state = act(soft, state, opening, inputs)
        at = soft.sliding(state, inputs)
        return state, jnp.stack([soft.output_force(at), state.rod[0], at.speed])

    zero = jnp.zeros(())
    begun, _ = start(soft, inputs_at(0), (zero + 7e6, zero + 7.2e6))
    F, solved, speed = np.asarray(jax.lax.scan(one, begun, jnp.arange(n))[1]).T
    assert np.ptp(F) > 500 and speed[-1] > 5e-3
    assert np.max(np.abs(F - solved)) < 0.005 * np.ptp(F)
    assert np.std(np.diff(F, 4)) < 0.01 * np.ptp(F)


# -- what is declared --


@pytest.fixture(scope="module")
def declared(rig):
    return parameter_specs(add(rig, map(make, EFFECTS)))


@pytest.fixture(scope="module")
def units():
    return pint.UnitRegistry()


def test_every_parameter_is_declared_in_full(declared, units):
    for name, spec in declared.items():
        units.parse_units(spec.unit.replace("{u}", "V"))
        stored = spec.unit.replace("{u}", "V")
        if spec.outside:
            inverse = 1 / units.Quantity(1, spec.outside[1].replace("{u}", "V"))
            assert inverse.check(units.Quantity(1, stored).dimensionality), name
        assert np.isfinite([spec.lower, spec.upper]).all(), name
        assert spec.lower < spec.upper, name
        assert spec.lower <= spec.default <= spec.upper, name
        assert all(spec.lower <= value <= spec.upper for value in spec.grid), name
        assert spec.scale > 0, name
        assert spec.prior is None or spec.prior > 0, name
        assert spec.description.strip(), name


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_has_its_place_and_a_zero(name):
    effect, spec = EFFECTS[name], specs(EFFECTS[name])
    assert effect.name == name
    assert effect.place in PLACES
    assert issubclass(effect, PLACES[effect.place].base)
    assert effect.needs and effect.residual_axis
    strengths = [s for s in spec.values() if s.strength]
    assert strengths and all(s.default == 0 for s in strengths)
    held = make(name)
    for field, s in spec.items():
        assert getattr(held, field) == s.default
        assert getattr(held, field).dtype == jnp.float64


def test_parameters_are_got_and_put_by_name(rig, declared):
    full = add(rig, map(make, EFFECTS))
    names = list(declared)
    rng = np.random.default_rng(0)
    values = rng.uniform(size=len(names))
    assert np.array_equal(get(put(full, names, values), names), values)
    some = [names[i] for i in rng.permutation(len(names))[:7]]
    changed = put(full, some, np.arange(7.0))
    assert np.array_equal(get(changed, some), np.arange(7.0))
    rest = [n for n in names if n not in some]
    assert np.array_equal(get(changed, rest), get(full, rest))
    with pytest.raises(KeyError):
        put(full, ["no_such.thing"], [1.0])


# -- every derivative of the full rig --


@pytest.fixture(scope="module")
def full(rig):
    """Every effect at once, at a random strength of a typical size."""
    rng = np.random.default_rng(4)
    rig = add(rig, map(make, EFFECTS))
    new = {
        name: spec.default + spec.scale * rng.uniform(0.3, 1.0)
        for name, spec in parameter_specs(rig).items()
        if spec.strength
    }
    # Half open at these pressures, ahead of lines that these small chambers can hold.
    new["counterbalance.P_set"] = 1.9e7
    new["counterbalance.dP_full"] = 5e6  # wholly open at times
    new["counterbalance.V_line"] = 2e-5
    new["counterbalance.check_loss"] = 0.2
    new |= REACHED
    # Slower than the spool that it limits would move at times, behind such a ramp.
    new["valve_rate_limit.slew"] = 0.011
    new["valve_rate_limit.s"] = 0.6
    return put(rig, list(new), list(new.values()))


@pytest.fixture(scope="module")
def batch(log):
    motion, windows, P_0 = jax.tree.map(jnp.asarray, log[:3])
    ones = jnp.ones(len(P_0))
    return Batch(motion, windows, P_0, jnp.asarray(NOISE), jnp.asarray(9e3), ones)


def moved(model, values, directions, b, simulate):
    """Predictions and columns, as a fit makes them."""
    at = np.asarray(values)
    common = recalled(model, at, directions, b.motion, simulate, ({}, {}))

    @program
    def run(values, b, common):
        pressure = driven_pressures(model, values, directions, b, common.spool)
        own = (directions, b.windows, pressure, common)
        return sensitivities(model, values, *own)

    return [np.asarray(out) for out in run(values, b, common)]


@pytest.fixture(scope="module")
def columns(full, batch):
    """Predictions, and their derivative to every parameter and nuisance."""
    model = ParametricRig.of(full)
    slots = (model.hydraulic, len(model.names) - model.hydraulic)
    directions = basis(model, model.names, slots)
    return model, *moved(model, model.values, directions, batch, True)


@pytest.fixture(scope="module")
def plain():
    @program
    def predict(rig, b):
        w, past = b.windows, friction_memory(rig, b.motion).within(b.windows)
        P = pressures(rig, b.motion, w, at_start(rig, w, b.P_0))
        return readings(rig, w, *P, past)

    return predict


def off(got, want):
    """Relative error of a column, in units of each channel's noise."""
    assert np.any(want)
    return np.linalg.norm((got - want) / NOISE) / np.linalg.norm(want / NOISE)


def test_sensitivities_come_with_the_prediction(full, batch, columns, plain):
    assert np.allclose(columns[1], plain(full, batch), rtol=1e-12)


def test_every_parameter_has_its_derivative(full, batch, columns, plain):
    model, _, dy = columns
    spec = parameter_specs(full)
    assert len(dy) == len(model.names) + NUISANCE
    wrong = {}
    for i, name in enumerate(model.names):
        at = get(full, [name])[0]

        def error_by(share, i=i, name=name, at=at):
            step = share * spec[name].scale
            rigs = (put(full, [name], [at + d]) for d in (step, -step))
            ahead, back = (plain(rig, batch) for rig in rigs)
            return off(dy[i], np.asarray(ahead - back) / (2 * share))

        # What moves little is lost in rounding by the smaller step.
        if not (error := min(map(error_by, (1e-5, 1e-4)))) < 1e-4:
            wrong[name] = error
    assert not wrong


@pytest.mark.slow
@pytest.mark.parametrize("found", [{}, {"valve_hysteresis.u_h": 0.03}])
def test_every_dormant_effect_has_its_derivative_among_all(rig, batch, plain, found):
    """Of what a trace takes its scores from: one-sided, all others absent at once."""
    rig = add(rig, map(make, EFFECTS))
    here = REACHED | found
    rig = put(rig, list(here), list(here.values()))
    model = ParametricRig.of(rig)
    slots = (model.hydraulic, len(model.names) - model.hydraulic)
    directions = basis(model, model.names, slots)
    _, dy = moved(model, model.values, directions, batch, True)
    here, spec = np.asarray(plain(rig, batch)), parameter_specs(rig)
    wrong = {}
    for name, field in STRENGTHS:
        one = f"{name}.{field}"

        def by(share, one=one):
            at = put(rig, [one], [get(rig, [one])[0] + share * spec[one].scale])
            return (np.asarray(plain(at, batch)) - here) / share

        error = off(dy[model.names.index(one)], 2 * by(5e-4) - by(1e-3))
        if not error < 2e-3:
            wrong[one] = error
    assert not wrong


@pytest.mark.slow
@pytest.mark.parametrize(
    "some",
    [
        ("c_p1", "k_cp"),  # neither memory nor command moves
        ("backlash.b", "L_rate"),  # of the memory some
        ("beta", "valve_delay.tau_u"),  # of the command some
    ],
)
def test_columns_of_a_few_are_those_of_all(full, batch, columns, some):
    """What no direction moves is not run; what it leaves is the same."""
    model, y, dy = columns
    at = [model.names.index(name) for name in some]
    hydraulic = sum(i < model.hydraulic for i in at)
    directions = basis(model, some, (hydraulic, len(at) - hydraulic))
    few_y, few = moved(model, model.values, directions, batch, True)
    own = [*at, *range(len(model.names), len(dy))]
    assert np.allclose(few_y, y, rtol=1e-12)
    for got, want in zip(few, dy[own], strict=True):
        assert off(got, want) < 1e-9


def test_initial_pressures_have_their_derivative(full, batch, columns, plain):
    model, _, dy = columns
    for i in range(2):
        shift = 10.0 * np.eye(2)[i]
        ahead, back = (
            plain(full, batch._replace(P_0=batch.P_0 + d)) for d in (shift, -shift)
        )
        got = dy[len(model.names) + i]
        assert off(got, np.asarray(ahead - back) / 20.0) < 1e-4


def test_supply_errors_have_their_derivative(full, batch, columns):
    """One standard deviation of each block's mean, as the pressures see it."""
    model, _, dy = columns
    w = batch.windows
    run = jax.jit(
        lambda P_s: readings(
            full,
            w,
            *pressures(
                full,
                batch.motion,
                w._replace(P_s=P_s),
                at_start(full, w, batch.P_0),
            ),
            friction_memory(full, batch.motion).within(w),
        )
    )
    ticks = w.P_s.shape[1]
    blocks = np.array_split(np.arange(ticks), SUPPLY_BLOCKS)
    for i, block in enumerate(blocks):
        shift = np.zeros(ticks)
        shift[block] = 100.0
        want = np.asarray(run(w.P_s + shift) - run(w.P_s - shift)) / 200.0
        got = dy[len(model.names) + 2 + i]
        assert off(got, want * 9e3 / np.sqrt(len(block))) < 1e-4


@pytest.mark.slow
def test_first_readings_have_their_derivative(full, batch, columns):
    """By 100 Pa, and by a tenth of the slope's spread: what filters remembers them, and
    the pressures themselves do not know.
    """
    model, _, dy = columns
    w = batch.windows
    P = pressures(full, batch.motion, w, at_start(full, w, batch.P_0))
    past = friction_memory(full, batch.motion).within(w)
    read = jax.jit(lambda w: readings(full, w, *P, past))

    def shifted(i: int, sign: float):
        name = ("P_a1", "P_a2")[i % 2]
        logged, dP = np.array(getattr(w, name)), np.array(w.dP)
        if i < 2:
            logged[:, 0] += sign * 100.0
        else:
            dP[:, 0, i - 2, 0] += sign * SLOPE_SPREAD / 10
        return np.asarray(read(w._replace(dP=dP, **{name: logged})))

    for i in range(READINGS):
        want = np.asarray(shifted(i, 1.0) - shifted(i, -1.0)) / 2
        got = dy[len(model.names) + 2 + SUPPLY_BLOCKS + i] * (100.0 if i < 2 else 0.1)
        assert off(got, want) < 1e-4


def test_driven_by_logged_pressures_only_friction_has_derivatives(full, batch):
    model = ParametricRig.of(full)
    slots = (model.hydraulic, len(model.names) - model.hydraulic)
    directions = basis(model, model.names, slots)
    _, dy = moved(model, model.values, directions, batch, False)
    # What stretches moves the piston, and friction with it; a logger's filter reads.
    moves = tuple(f"{e.name}." for e in (*full.stretch, EFFECTS["signal_filter"]()))
    for i, name in enumerate(model.names):
        seen = i >= model.hydraulic or name.startswith(moves)
        seen &= name != "signal_filter.s"  # of the supply, from which nothing flows
        assert np.any(dy[i]) == seen, name
    # First readings are of pressures, which are not compared then.
    assert not np.any(dy[len(model.names) :, ..., 2])
    assert not np.any(dy[len(model.names) : -READINGS])
