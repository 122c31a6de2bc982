"""The step of the pressures where it is stiff, and where a chamber is drawn empty."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hydrojax.effects import FlowEffect
from hydrojax.parameters import put
from hydrojax.plant.chambers import P_VAPOUR
from hydrojax.plant.hydraulics import pressure_step
from hydrojax.plant.layout import LAYOUTS
from hydrojax.plant.load import Inertia
from hydrojax.plant.rig import add, bare_rig
from hydrojax.plant.state import StepInput
from hydrojax.plant.step import start, step

A, BETA, C, LENGTH = 1.18e-3, 8.5e8, 2.2e-9, 0.2
NOISE = 9e3
CORE = 2e3


@pytest.fixture(scope="module")
def cylinder():
    return bare_rig(LAYOUTS["pull-pull"], {"area": A, "chamber_length": LENGTH})


def tick_inputs(t, h, u, place, supply, substeps=1):
    """One tick from `t` s, lanes as `u` has them; `place` gives [..., times]."""
    x = jnp.asarray(place(t + h * np.linspace(0, 1, 2 * substeps + 1)))
    lanes = np.shape(u)
    x = jnp.broadcast_to(x, (*lanes, x.shape[-1]))
    ends = jnp.asarray([supply(t), supply(t + h)])
    return StepInput(
        h=jnp.full(lanes, h),
        u=jnp.asarray(u),
        P_s=jnp.broadcast_to(ends, (*lanes, 2)),
        P_r=jnp.full((*lanes, 2), 0.25e6),
        x=x,
        dx=jnp.diff(x[..., ::2], axis=-1),
        v=(x[..., -1] - x[..., -2]) * 2 * substeps / h,
        a=jnp.zeros(lanes),
        t=jnp.full(lanes, t + h),
    )


def edge(drop):
    """An orifice with its laminar core, Pa^0.5."""
    return drop / (drop**2 + CORE**2) ** 0.25


def solved(u, P, times, place, speed, supply):
    """(12)-(15) by an implicit solver, at `times`."""

    def rates(t, P):
        x, v = place(t), speed(t)
        if u > 0:
            q = C * u * np.array([edge(supply(t) - P[0]), -edge(P[1] - 0.25e6)])
        else:
            q = C * u * np.array([edge(P[0] - 0.25e6), -edge(supply(t) - P[1])])
        length = np.array([LENGTH / 2 - x, LENGTH / 2 + x])
        return BETA / (A * length) * (q + A * v * np.array([1, -1]))

    out = solve_ivp(
        rates, (times[0], times[-1]), P, method="Radau", t_eval=times,
        rtol=1e-9, atol=1.0, max_step=1e-3,
    )  # fmt: skip
    return out.y.T


COMMANDS = np.array([0.1, 1.0, 3.0, 10.0, -0.1, -1.0, -3.0, -10.0])


@pytest.mark.parametrize(
    ("h", "substeps", "drop"), [(1e-3, 1, 0.0), (1e-2, 7, 0.0), (1e-3, 8, 2e5)]
)
@pytest.mark.parametrize(
    "short", [0.01, pytest.param(0.03, marks=pytest.mark.slow), 0.1]
)
def test_pressures_settle_next_to_supply_and_return(cylinder, short, h, substeps, drop):
    """Within a tenth of the sensors' noise of what an implicit solver finds.

    One chamber is `short` m long, and the supply walks. The piston is locked, or goes
    to and fro so fast that the edges' drops reach `drop` both ways.
    """
    ticks, turn = 100, 2 * np.pi / (60 * h)
    fast = C * np.abs(COMMANDS) * np.sqrt(drop) / A

    def place(t, lane=...):
        return (
            LENGTH / 2 - short + np.multiply.outer(fast[lane] / turn, np.sin(turn * t))
        )

    def supply(t):
        return 14e6 + 1e5 * t / (ticks * h)

    up = COMMANDS > 0
    P = (np.where(up, 13.9e6, 0.3e6), np.where(up, 0.3e6, 13.9e6))
    P = tuple(map(jnp.asarray, P))
    one = jax.jit(lambda P, inputs: pressure_step(cylinder, P, (inputs.u,), inputs)[0])
    got = [np.stack(P, axis=-1)]
    for k in range(ticks):
        P = one(P, tick_inputs(k * h, h, COMMANDS, place, supply, substeps))
        got.append(np.stack(P, axis=-1))
    got, times = np.array(got), h * np.arange(ticks + 1)
    off = []
    for i, u in enumerate(COMMANDS):
        want = solved(
            u, got[0, i], times,
            lambda t, i=i: place(t, i), lambda t, i=i: fast[i] * np.cos(turn * t),
            supply,
        )  # fmt: skip
        off.append(np.abs(got[:, i] - want)[31:].max())
    assert max(off) < NOISE / 10


def test_a_chamber_drawn_empty_is_filled_before_its_pressure_rises(cylinder):
    """Valve shut: pulled past a vacuum and back, it meets its pressure on the way.

    In closed form: `P = P_0 + beta ln(L_0 / L)` while full, and a vacuum while the
    chamber is longer than where it reached that.
    """
    h, ticks, P_0 = 1e-3, 200, 2e6
    L_0 = LENGTH / 2

    def place(t):
        return -1e-3 * np.sin(np.pi * t / (h * ticks)) ** 2

    zero = jnp.zeros(())
    shut = put(cylinder, ["beta"], [BETA])
    inputs = tick_inputs(0.0, h, np.zeros(()), place, lambda t: 14e6)
    state, _ = start(shut, inputs, (zero + P_0, zero + P_0))
    advance = jax.jit(lambda state, inputs: step(shut, state, inputs))
    got = []
    for k in range(ticks):
        state, signals = advance(
            state, tick_inputs(k * h, h, np.zeros(()), place, lambda t: 14e6)
        )
        got.append((signals["P_a1"], signals["P_a2"]))
    x = place(h * np.arange(1, ticks + 1))
    for i, L in enumerate((L_0 - x, L_0 + x)):
        want = np.maximum(P_0 + BETA * np.log(L_0 / L), P_VAPOUR)
        assert np.max(np.abs(np.array(got)[:, i] - want)) < 2e3
    assert np.min(got) == P_VAPOUR


def test_what_flows_in_fills_an_empty_chamber_first(cylinder):
    """The volume that was drawn out is back after as much has come in from supply."""
    h, u, lacks = 1e-3, 0.5, -3e6  # Pa of BETA, on the whole chamber's length
    place, supply = (lambda t: 0.0 * t + 0.05), (lambda t: 14e6)
    flow = C * u * np.sqrt(14e6 - P_VAPOUR)
    volume = -lacks * A * LENGTH / BETA
    P = (jnp.asarray([P_VAPOUR + lacks]), jnp.asarray([5e6]))
    one = jax.jit(lambda P, inputs: pressure_step(cylinder, P, (inputs.u,), inputs)[0])
    full = []
    for k in range(300):
        P = one(P, tick_inputs(k * h, h, np.array([u]), place, supply))
        full.append(float(P[0][0]) >= P_VAPOUR)
    assert abs(full.index(True) * h - volume / flow) <= h


@pytest.mark.parametrize("u", [0.5, 10.0])
def test_the_step_has_its_derivative_where_it_is_stiff(cylinder, u):
    place, supply = (lambda t: 0.0 * t + 0.09), (lambda t: 14e6)
    inputs = tick_inputs(0.0, 1e-3, np.array([u]), place, supply)

    def end(p):
        rig = put(cylinder, ["beta", "c_p1", "c_n2"], p[:3])
        P = (p[3:4], p[4:5])
        for _ in range(3):
            P, _ = pressure_step(rig, P, (inputs.u,), inputs)
        return jnp.concatenate(P)

    at = np.array([BETA, C, C, 13.6e6, 0.6e6])
    got = np.asarray(jax.jit(jax.jacfwd(end))(jnp.asarray(at)))
    end = jax.jit(end)
    for i in range(at.size):
        d = 1e-5 * at[i] * np.eye(at.size)[i]
        want = np.asarray(end(at + d) - end(at - d)) / (2 * d[i])
        assert np.allclose(got[:, i] * at[i], want * at[i], rtol=1e-4, atol=1.0)


def test_a_moving_load_is_held_at_the_end_of_its_stroke(cylinder):
    """Driven at full command it rests on the stop: nothing of the drive comes out."""
    load = Inertia(mass=150.0, stiffness=0.0, damping=4e3)
    zero, parts, h = jnp.zeros(()), 4, 1e-3
    inputs = StepInput(
        h=zero + h, u=zero - 10.0, P_s=jnp.full(2, 14e6), P_r=jnp.full(2, 0.25e6),
        x=jnp.full((parts, 3), 0.09), dx=None, v=jnp.zeros(parts), a=jnp.zeros(parts),
        t=zero,
    )  # fmt: skip
    state, _ = start(cylinder, inputs, (zero + 7e6, zero + 7e6), load)

    @jax.jit
    def one(state, _):
        state, read = step(cylinder, state, inputs, load)
        return state, (state.motion.x, state.P, read["true_F"])

    _, (x, P, F) = jax.lax.scan(one, state, None, length=1500)
    drive = A * (P[1][-1] - P[0][-1])
    assert drive > 0.9 * A * 13.5e6
    # Contact begins where the shorter chamber is all but gone, and gives by 1e-8 m/N.
    rest = LENGTH / 2 * (1 - 8e-3) + drive / 1e8
    assert float(x[-1] - rest) == pytest.approx(0.0, abs=1e-5)
    assert abs(F[-1]) < 0.01 * drive and np.max(x) < LENGTH / 2


def test_a_flow_that_grows_with_time_is_one(cylinder):
    """Into shut chambers at rest: a pressure rises by the square of the time."""

    class Growing(FlowEffect):
        name = "growing"
        residual_axis = "t"

        def flow(self, at):
            q = jnp.asarray(1e-7 * at.t)
            return q, -q

    own, P = add(cylinder, [Growing()]), (6e6, 7e6)
    for i in range(20):
        inputs = tick_inputs(
            i * 1e-3, 1e-3, 0.0, lambda t: 0.01 + 0 * t, lambda t: 14e6
        )
        P, _ = pressure_step(own, P, (jnp.zeros(()),), inputs)
    lengths = LENGTH / 2 + np.array([-0.01, 0.01])
    rise = np.array([1, -1]) * BETA * 1e-7 * 0.02**2 / 2 / (A * lengths)
    np.testing.assert_allclose(P, [6e6, 7e6] + rise, rtol=1e-9)
