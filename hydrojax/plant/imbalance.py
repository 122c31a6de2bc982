"""What the flow balances of a log lack, tick by tick, without a simulation."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.plant import stretch
from hydrojax.plant.chambers import Lines, Point, refilled
from hydrojax.plant.replay import (
    Motion,
    Opened,
    Windows,
    before_filters,
    follow_line,
    line_start,
    opened_in,
    openings,
)
from hydrojax.plant.rig import Rig
from hydrojax.plant.scan import in_one_kernel


def imbalance(
    rig: Rig, motion: Motion, w: Windows
) -> tuple[Float[Array, "windows ticks"], Float[Array, "windows ticks"]]:
    """What each chamber's flow balance lacks over every tick, at the measured
    pressures, as a displacement of the piston, [W, lead+T-1] each; m.

    Nothing is integrated but the command's path: `dP = h rate` is solved for the motion
    at which it would hold (equation error; L. Ljung, System Identification, 1999,
    section 7.2). What the measured pressures' noise brings into it biases a fit; what
    the model lacks does not run on in it, as it does in a replay.
    """
    return imbalance_behind(rig, w, opened_in(rig, openings(rig, motion), w))


def imbalance_behind(
    rig: Rig, w: Windows, opened: Opened
) -> tuple[Float[Array, "windows ticks"], Float[Array, "windows ticks"]]:
    """The same with the spool where `opened_in` has it."""

    def middle(a):
        return (a[:, :-1] + a[:, 1:]) / 2

    w = before_filters(rig, w)
    h, n, x = w.h[:, :-1], w.x_fine.shape[-1], w.x_fine
    if rig.stretch:
        F = jnp.stack([w.F[:, :-1], w.F[:, 1:]], axis=-1)
        x = x + stretch.ahead(rig.stretch, stretch.along(F, n - 1))
    lines = _lines_along(rig, w, opened)
    at = Point(
        refilled(middle(w.P_a1)),
        refilled(middle(w.P_a2)),
        middle(w.P_s),
        middle(w.P_r),
        tuple(o[-w.x_fine.shape[1] :].T for o in opened),
        x=x[..., n // 2],
        v=(x[..., -1] - x[..., 0]) / h,
        line=None if lines is None else lines[0],
        t=middle(w.t),
    )
    rates, per_speed = jax.jvp(
        lambda v: rig.pressure_rates(at._replace(v=v)), (at.v,), (jnp.ones_like(at.v),)
    )
    measured = (jnp.diff(w.P_a1, axis=1), jnp.diff(w.P_a2, axis=1))
    if lines is not None:
        # Of the mean of chamber and line.
        parts = rig.chambers.capacities(at, rig.compliance, rig.volume, rig.line)
        measured = tuple(
            dP - C_l / (C + C_l) * change
            for dP, (C, C_l), change in zip(measured, parts, lines[1], strict=True)
        )
    one, two = (
        (dP - h * rate) / slope
        for dP, rate, slope in zip(measured, rates, per_speed, strict=True)
    )
    return one, two


def _lines_along(rig: Rig, w: Windows, opened: Opened) -> tuple[Lines, tuple] | None:
    """What stands in the lines in the middle of every tick, [W, lead+T-1], and by how
    much its drops change over it; by the measured pressures.
    """
    start = line_start(rig, w, opened)
    if start is None:
        return None

    def middle(line, tick):
        after = follow_line(rig, line, *tick)
        pairs = list(zip(line.drop, after.drop, strict=True))
        drop = tuple((a + b) / 2 for a, b in pairs)
        return after, (after._replace(drop=drop), tuple(b - a for a, b in pairs))

    P_1, P_2, P_s, P_r, v, t = (
        a.T[:-1] for a in (w.P_a1, w.P_a2, w.P_s, w.P_r, w.v, w.t)
    )
    own, x = tuple(o[-len(P_1) :] for o in opened), w.x_fine
    at = Point(P_1, P_2, P_s, P_r, own, x[..., x.shape[-1] // 2].T, v, t=t)
    moved = (jnp.diff(w.P_a1, axis=1).T, jnp.diff(w.P_a2, axis=1).T)
    along = jax.lax.scan(in_one_kernel(middle), start, (at, w.h.T[:-1], moved))[1]
    return jax.tree.map(lambda a: a.T, along)
