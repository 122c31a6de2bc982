"""The closed loop by diffrax: Tsit5 at a fixed step, the law at samples in a scan.

A sample is `PARTS` of diffrax's own steps, taken one by one; plant and law are
hydrojax's functions, the spool an equation of its own. A batch is a `vmap`.
"""

from __future__ import annotations

from collections.abc import Callable

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from hydrojax.control.base import Measured
from hydrojax.control.loop import Loop, Scenario
from hydrojax.control.loop import start_loop as at_rest
from hydrojax.control.simulation import PARTS
from hydrojax.effects.valve import ValveLag
from hydrojax.plant.chambers import Point
from hydrojax.plant.friction import Sliding

from .numbers import delay


def _rates(t, y, args):
    """The plant's rates at `t`, 0 to 1 over a part; everything per part."""
    rig, h, u, (a, b, c), P_s, P_r = args
    P_1, P_2, z, speed, place, rate = y
    # The motion over a part is the parabola through its start, middle and end.
    x = a + t * (4 * b - 3 * a - c + t * 2 * (a - 2 * b + c))
    v = (4 * b - 3 * a - c + 4 * t * (a - 2 * b + c)) / h
    line = (p[0] + t * (p[1] - p[0]) for p in (P_s, P_r))
    at = Point(P_1, P_2, *line, (place,), x=x, v=v)
    lag = next(c for c in rig.command if isinstance(c, ValveLag))
    friction = rig.mechanics
    rates = (
        *rig.pressure_rates(at),
        friction.z_rate(z, v),
        friction.L_rate * (jnp.abs(v) - speed),
        rate / lag.tau,
        (u - place - 2 * lag.zeta * rate) / lag.tau,
    )
    return tuple(h * r for r in rates)


def _part(loop, tick, part, u, y, solver):
    """The plant's state after one part under the command `u`."""

    def ends(p):
        return tuple(p[0] + (part + i) / PARTS * (p[1] - p[0]) for i in (0, 1))

    x = tuple(tick.environment.x[part, i] for i in range(3))
    args = (loop.rig, loop.h / PARTS, u, x, ends(tick.P_s), ends(tick.P_r))
    term, start = diffrax.ODETerm(_rates), jnp.zeros_like(loop.h)
    state = solver.init(term, start, start + 1, y, args)
    return solver.step(term, start, start + 1, y, args, state, False)[0]


def _force(rig, y, tick):
    """The true output force at the end of a sample, N."""
    v, x = tick.environment.v[-1], tick.environment.x[-1, 2]
    at = Sliding(tick.t, x, v, v, y[2], v, y[3], y[0], y[1], tick.P_s[1])
    return rig.output_force(at)


def run(loop: Loop, scenario: Scenario, whole: int) -> jax.Array:
    """True F at every sample [N], N; commands are `whole` parts late."""
    solver = diffrax.Tsit5()
    ahead = -(-whole // PARTS)  # samples of command to remember
    begun = at_rest(loop, scenario)

    def sample(carry, tick):
        y, F, memory, queue = carry
        truth = Measured(y[0], y[1], tick.P_s[0], F, tick.environment.x[0, 0])
        seen = loop.sensors.read(truth, tick.noise)
        memory, u, _ = loop.law.step(memory, seen, tick.F_d, loop.h)
        queue = (u, *queue[:ahead])
        for part in range(PARTS):
            late = queue[-((part - whole) // PARTS)]
            y = _part(loop, tick, part, late, y, solver)
        return (y, _force(loop.rig, y, tick), memory, queue), F

    zero = jnp.zeros_like(loop.h)
    plant = begun.plant
    y = (*plant.P, plant.z, plant.speed, zero, zero)
    carry = (y, begun.F, begun.law, (zero,) * (ahead + 1))
    return jax.lax.scan(sample, carry, scenario)[1]


def prepare(
    loop: Loop, scenario: Scenario, signals: bool = False
) -> Callable[[], np.ndarray]:
    """A closed loop in diffrax, compiled and ready to be run.

    `loop` has leaves that are scalars or [B]. What is returned runs it: RMS of F_d - F
    [B], N, or with `signals` the true F [B, N].

    Raises:
        ValueError: no valve_lag, or a delay that is no whole number of parts.
    """
    whole, share = delay(loop.rig, float(loop.h) / PARTS)
    if share or not any(isinstance(c, ValveLag) for c in loop.rig.command):
        raise ValueError("this peer wants a valve_lag, and a delay of whole parts")
    axes = jax.tree.map(lambda a: 0 if jnp.ndim(a) else None, loop)
    many = any(jnp.ndim(a) for a in jax.tree.leaves(loop))

    def found(loop, scenario):
        F = run(loop, scenario, whole)
        return F if signals else jnp.sqrt(jnp.mean((scenario.F_d - F) ** 2))

    each = jax.vmap(found, in_axes=(axes, None)) if many else found
    compiled = jax.jit(each).lower(loop, scenario).compile()
    return lambda: np.atleast_1d(np.asarray(compiled(loop, scenario)))
