"""What the flow balances of a log lack, tick by tick, without a simulation."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.plant import stretch
from hydrojax.plant.chambers import Point, refilled
from hydrojax.plant.replay import Windows, follow_lines, lines_before, openings
from hydrojax.plant.rig import Rig


def imbalance(
    rig: Rig, w: Windows
) -> tuple[Float[Array, "windows ticks"], Float[Array, "windows ticks"]]:
    """What each chamber's flow balance lacks over every tick, at the measured
    pressures, as a displacement of the piston, [W, lead+T-1] each; m.

    Nothing is integrated but the command's path: `dP = h rate` is solved for the motion
    at which it would hold (equation error; L. Ljung, System Identification, 1999,
    section 7.2). What the measured pressures' noise brings into it biases a fit; what
    the model lacks does not run on in it, as it does in a replay.
    """
    return imbalance_behind(rig, w, openings(rig, w))


def imbalance_behind(
    rig: Rig, w: Windows, opened: tuple[Float[Array, "ticks windows"], ...]
) -> tuple[Float[Array, "windows ticks"], Float[Array, "windows ticks"]]:
    """The same with the spool where `openings` has it."""

    def middle(a):
        return (a[:, :-1] + a[:, 1:]) / 2

    h, n, x = w.h[:, :-1], w.x_fine.shape[-1], w.x_fine
    if rig.stretch:
        F = jnp.stack([w.F[:, :-1], w.F[:, 1:]], axis=-1)
        x = x + stretch.ahead(rig.stretch, stretch.along(F, n - 1))
    at = Point(
        refilled(middle(w.P_a1)),
        refilled(middle(w.P_a2)),
        middle(w.P_s),
        middle(w.P_r),
        tuple(o.T for o in opened),
        x=x[..., n // 2],
        v=(x[..., -1] - x[..., 0]) / h,
        line=_lines(rig, w),
    )
    rates, per_speed = jax.jvp(
        lambda v: rig.pressure_rates(at._replace(v=v)), (at.v,), (jnp.ones_like(at.v),)
    )
    measured = (jnp.diff(w.P_a1, axis=1), jnp.diff(w.P_a2, axis=1))
    one, two = (
        (dP - h * rate) / slope
        for dP, rate, slope in zip(measured, rates, per_speed, strict=True)
    )
    return one, two


def _lines(rig: Rig, w: Windows) -> tuple:
    """What stands in the lines over the windows' ticks, by the measured pressures."""
    ticks = (w.P_a1.T[:-1], w.P_a2.T[:-1], w.h.T[:-1])
    memories = jax.lax.scan(follow_lines(rig), lines_before(rig, w), ticks)[1]
    return jax.tree.map(lambda a: a.T, memories)
