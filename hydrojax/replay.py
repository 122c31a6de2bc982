"""A log drives the plant: the pieces of the one step, run in windows.

Motion is known in a replay and the piston is massless, so nothing feeds back from
force to pressure. The step's pieces are therefore run one after the other: bristle and
filtered speed once over each whole segment (in parallel, they are linear in their
state); the command and the pressures in windows, each from its own initial pressures;
force and sensors last. `Rig.step` scanned over the same log gives the same signals.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.signal import savgol_filter

from .friction import Sliding, run_linear
from .rig import Rig, Tick

SMOOTH = 15
"""Ticks over which a logged force is smoothed before it stretches anything: flat to
some 40 Hz on a log at 1 kHz."""


class Motion(NamedTuple):
    """Motion of S segments of N ticks, padded at the end with standstill; SI.

    `dx` [S, N-1, 4] displacement over each quarter of a tick; `h` [S, N-1] its length;
    `speed0` [S] the filtered speed to start from.
    """

    dx: Array
    h: Array
    speed0: Array


class Windows(NamedTuple):
    """W windows of `lead + T` ticks, cut from S segments; SI.

    The first `lead` ticks let memories settle and are not compared. `before` [W, pre]
    is the command that precedes, `before_h` its tick lengths. `u`, `h`, `P_s`, `P_r`,
    `t`, `x`, `v`, `a`, `P_a1`, `P_a2` are [W, lead+T], at the ticks; `h` is the tick
    that follows. `x_fine` is [W, lead+T-1, 2n+1], `measured` [W, T, 3]
    (P_a1, P_a2, F), `seg` and `first` say where each window lies in its segment.
    """

    seg: Array
    first: Array
    before: Array
    before_h: Array
    u: Array
    h: Array
    P_s: Array
    P_r: Array
    t: Array
    x: Array
    v: Array
    a: Array
    x_fine: Array
    P_a1: Array
    P_a2: Array
    measured: Array

    @property
    def scored(self) -> int:
        """Ticks of each window that are compared."""
        return self.measured.shape[1]


def friction_memory(rig: Rig, motion: Motion) -> tuple[Array, Array]:
    """Bristle deflection (m) and filtered speed (m/s) at every tick, [S, N] each.

    With an effect that asks for them, the speed has the velocity's lags behind it on a
    last axis.
    """
    s, n, quarters = motion.dx.shape
    dx = motion.dx.reshape(s, n * quarters)
    h = jnp.repeat(motion.h / quarters, quarters, axis=1)
    zero = jnp.zeros((s, 1))
    z = run_linear(*rig.mechanics.bristle_map(dx), zero[:, 0])
    speed = run_linear(*rig.mechanics.speed_map(dx, h), motion.speed0)
    start = motion.speed0
    if rig.velocity:
        v_0 = dx[:, 0] / h[:, 0]
        lags = rig.mechanics.past_map(dx, h)
        past = run_linear(*lags, jnp.broadcast_to(v_0, (len(lags[0]), s)))
        speed = jnp.stack([speed, *past], axis=-1)
        start = jnp.stack([start, *[v_0] * len(past)], axis=-1)
    at_ticks = slice(quarters - 1, None, quarters)
    return (
        jnp.concatenate([zero, z[:, at_ticks]], axis=1),
        jnp.concatenate([start[:, None], speed[:, at_ticks]], axis=1),
    )


def pressures(rig: Rig, w: Windows, P_0: Array) -> tuple[Array, Array]:
    """Both chamber pressures at every tick, [W, lead+T] each, from `P_0` [W, 2]; Pa."""

    def warm(memory, tick):
        return rig.command_step(memory, *tick)[0], None

    def advance(carry, tick):
        memory, P = carry
        memory, opening = rig.command_step(memory, tick.u, tick.h)
        P = rig.pressure_step(P, opening, tick)
        return (memory, P), P

    memory = rig.command_init(w.before[:, 0])
    memory, _ = jax.lax.scan(warm, memory, (w.before.T, w.before_h.T))

    def ends(p):
        return jnp.stack([p[:, :-1], p[:, 1:]], axis=-1)

    ticks = Tick(
        h=w.h[:, :-1],
        u=w.u[:, :-1],
        P_s=ends(w.P_s),
        P_r=ends(w.P_r),
        x=w.x_fine,
        dx=w.x_fine[..., :0],
        v=w.v[:, 1:],
        a=w.a[:, 1:],
        t=w.t[:, 1:],
        F=ends(_rod_force(w)) if rig.stretch else None,
    )
    ticks = jax.tree.map(lambda a: jnp.moveaxis(a, 1, 0), ticks)
    start = (P_0[:, 0], P_0[:, 1])
    _, (P_a1, P_a2) = jax.lax.scan(advance, (memory, start), ticks)
    return (
        jnp.concatenate([P_0[:, :1], P_a1.T], axis=1),
        jnp.concatenate([P_0[:, 1:], P_a2.T], axis=1),
    )


def _rod_force(w: Windows) -> Array:
    """The logged output force, [W, lead+T], N; in the lead, that of its end.

    What it stretched in the lead is a shift of the initial pressures. Cubics over
    `SMOOTH` ticks take most of its noise away, which the pressures would follow.
    """
    F = w.measured[..., 2]
    F = jnp.where(jnp.isfinite(F), F, 0.0)
    if w.scored >= SMOOTH:
        F = F @ savgol_filter(np.eye(w.scored), SMOOTH, 3, axis=0).T
    lead = w.x.shape[1] - w.scored
    return jnp.concatenate([jnp.repeat(F[:, :1], lead, axis=1), F], axis=1)


def _sense(rig: Rig, channels: tuple, y: Array, h: Array) -> Array:
    """A sensor's reading of `y` [W, n] along its second axis."""
    if not channels:
        return y
    slope = (y[:, 1] - y[:, 0]) / h[:, 0]
    memory, first = rig.sense_init(channels, y[:, 0], slope)

    def step(memory, tick):
        return rig.sense(channels, memory, *tick)

    _, rest = jax.lax.scan(step, memory, (y[:, 1:].T, h[:, :-1].T))
    return jnp.concatenate([first[:, None], rest.T], axis=1)


def readings(
    rig: Rig, w: Windows, P_a1: Array, P_a2: Array, z: Array, speed: Array
) -> Array:
    """What the sensors read, [W, T, 3] (P_a1, P_a2 in Pa, F in N).

    `P_a1`, `P_a2` [W, lead+T] from `pressures` or the log; `z`, `speed` [S, N].
    """
    index = w.first[:, None] + jnp.arange(w.x.shape[1])
    z, speed = z[w.seg[:, None], index], speed[w.seg[:, None], index]
    rate = rig.mechanics.z_rate(z, w.v)
    speed, v = rig.slip(speed, w.v)
    F = rig.output_force(Sliding(w.t, w.x, v, w.a, z, rate, speed, P_a1, P_a2, w.P_s))
    lead = w.x.shape[1] - w.scored
    y = [
        _sense(rig, rig.gauge(0), P_a1, w.h),
        _sense(rig, rig.gauge(1), P_a2, w.h),
        _sense(rig, rig.sensor_F, F, w.h),
    ]
    return jnp.stack([c[:, lead:] for c in y], axis=-1)
