"""What gives between piston and encoder: where the piston stands, and under what force.

The piston is ahead of the encoder by `stretch(F)`. A log says what F was; a simulation
has to solve for it, since the stretch takes from the very force that makes it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jaxtyping import Array

from hydrojax.plant.chambers import Point
from hydrojax.plant.state import State, StepInput

if TYPE_CHECKING:
    from hydrojax.plant.rig import Rig

HALVINGS = 24
"""Of the bracket that holds the force: to 1e-7 of a tick's change."""


def ahead(stretches: tuple, F: Array) -> Array:
    """How far the piston stands ahead of the encoder under `F`, m."""
    return sum((e.stretch(F) for e in stretches), start=jnp.zeros_like(F))


def along(ends: Array, parts: int) -> Array:
    """Values at `parts + 1` even points of a line, [..., parts + 1]; its `ends`."""
    start, end = ends[..., :1], ends[..., 1:]
    return start + jnp.linspace(0.0, 1.0, parts + 1) * (end - start)


def rate(F: Array, h: Array) -> Array:
    """Rate of `F` [S, N] at every tick, from both neighbours; `h` [S, N-1]."""
    t = jnp.pad(jnp.cumsum(h, axis=1), ((0, 0), (1, 0)))

    def wide(y):
        y = jnp.pad(y, ((0, 0), (1, 1)), mode="edge")
        return y[:, 2:] - y[:, :-2]

    return wide(F) / wide(t)


def place(rig: Rig, tick: StepInput) -> Array:
    """The piston's place where the encoder says `tick.x`, m."""
    if not rig.stretch or tick.F is None:
        return tick.x
    return tick.x + ahead(rig.stretch, along(tick.F, tick.x.shape[-1] - 1))


def moves(rig: Rig, tick: StepInput) -> Array:
    """The piston's displacement where the encoder says `tick.dx`, m."""
    if not rig.stretch or tick.F is None:
        return tick.dx
    F = along(tick.F, tick.dx.shape[-1])
    return tick.dx + jnp.diff(ahead(rig.stretch, F), axis=-1)


def ahead_rate(stretches: tuple, F: Array, F_rate: Array) -> Array:
    """The piston's velocity beyond the encoder's while `F` changes at `F_rate`, m/s."""
    return jax.jvp(lambda F: ahead(stretches, F), (F,), (F_rate,))[1]


def velocity(rig: Rig, tick: StepInput) -> Array:
    """The piston's velocity at the tick's end, m/s.

    Without a logged force it is the encoder's: the piston is massless, and friction
    that falls with its own speed (k_v > 0) would make it chatter.
    """
    if not rig.stretch or tick.F is None or tick.F_rate is None:
        return tick.v
    return tick.v + ahead_rate(rig.stretch, tick.F[..., 1], tick.F_rate)


def force(rig: Rig, state: State, opening: tuple[Array, ...], tick: StepInput) -> Array:
    """The output force at the end of a tick that starts in `state`, N.

    What stretches gives way as the force rises; pressures fall and the bristle bends
    with it. So F lies between the force at the tick's start and that of a rod which
    does not give. Solved by halving, and by one of Newton's steps for the derivative.
    """
    F_0 = state.rod[0]
    held = tick._replace(F=jnp.stack([F_0, F_0], axis=-1))
    P = rig.pressure_step(state.P, opening, held)

    def rates(v):
        ends = (tick.P_s[..., 1], tick.P_r[..., 1])
        return rig.pressure_rates(Point(*P, *ends, opening, tick.x[..., -1], v))

    still, moving = rates(jnp.zeros_like(F_0)), rates(jnp.ones_like(F_0))
    per_metre = tuple(b - a for a, b in zip(still, moving, strict=True))
    start = (state, tick, P, per_metre)

    def follows(F, rig, start):
        state, tick, P, per_metre = start
        moved = ahead(rig.stretch, F) - ahead(rig.stretch, state.rod[0])
        P = tuple(p + d * moved for p, d in zip(P, per_metre, strict=True))
        tick = tick._replace(F=jnp.stack([state.rod[0], F], axis=-1))
        state = rig.slide(state, tick)._replace(P=P)
        return rig.output_force(rig.sliding(state, tick))

    def over(F, rig, start):
        return F - follows(F, rig, start)

    free = follows(F_0, rig, start)
    fixed = jax.lax.stop_gradient((rig, start))

    def halve(_, bracket):
        low, high = bracket
        middle = (low + high) / 2
        above = over(middle, *fixed) > 0
        return jnp.where(above, low, middle), jnp.where(above, middle, high)

    ends = jax.lax.stop_gradient((jnp.minimum(F_0, free), jnp.maximum(F_0, free)))
    low, high = jax.lax.fori_loop(0, HALVINGS, halve, ends)
    F = (low + high) / 2
    value, slope = jax.jvp(lambda F: over(F, rig, start), (F,), (jnp.ones_like(F),))
    return F - value / jax.lax.stop_gradient(slope)
