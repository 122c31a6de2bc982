"""Both pressures over one tick: stable next to P_s and P_r and in a short chamber."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.plant import stretch
from hydrojax.plant.chambers import Lines, Losses, Point, refilled
from hydrojax.plant.rig import Rig
from hydrojax.plant.state import StepInput
from hydrojax.plant.valve import sides

NEWTON = 3
"""Steps in which the flow through a line is found."""

LEAKS = 1e-3
"""Opening at which a spool that is shut passes as much as leaks along it: it drains a
line behind a valve that is shut too."""


def pressure_step(
    rig: Rig,
    P: tuple[Float[Array, "*batch"], Float[Array, "*batch"]],
    opening: tuple[Float[Array, "*batch"], ...],
    inputs: StepInput,
    line: Lines | None = None,
) -> tuple[tuple[Float[Array, "*batch"], Float[Array, "*batch"]], Lines | None]:
    """Both pressures over one tick, in n substeps of an exponential midpoint rule.

    With them what stands in the lines, its drops after the tick; see `_drops`.

    Each substep moves the piston by its exact displacement, so what is left of
    the error is the pressures' own, of second order. Next to P_s or P_r, and in a
    short chamber, a pressure settles within a fraction of a substep; there
    `_relax` settles it where flow and motion balance. Of second order whatever the
    rates of settling are: they only need be large enough.

    A chamber that is drawn empty holds `P_VAPOUR`, and is filled up before its
    pressure rises again: what is carried from step to step goes below `P_VAPOUR`
    by what it lacks, and `refilled` is the pressure.

    Source: M. Hochbruck, A. Ostermann, Exponential integrators, Acta Numerica 19
    (2010), sections 2.3 and 2.4.
    """
    n = (inputs.x.shape[-1] - 1) // 2
    h, x = inputs.h / n, stretch.place(rig.stretch, inputs)

    def at(P, part, x, v, line):
        p_s, p_r = (
            p[..., 0] + part * (p[..., 1] - p[..., 0]) for p in (inputs.P_s, inputs.P_r)
        )
        t = inputs.t - (1 - part) * inputs.h
        return Point(P[0], P[1], p_s, p_r, opening, x, v, line, t)

    def substep(begun, along):
        (P, line), (part, x_0, x_1, x_2) = begun, along
        v = (x_2 - x_0) / h
        slope, settling, edges = _settling_rates(rig, at(P, part, x_0, v, line))
        moved = tuple(
            h / 2 * _relax(b * h / 2) * r for r, b in zip(slope, settling, strict=True)
        )
        middle = (P[0] + moved[0], P[1] + moved[1])
        slope = rig.pressure_rates(at(middle, part + 0.5 / n, x_1, v, line))
        moved = tuple(
            h * _relax(b * h) * (r + b * m)
            for r, b, m in zip(slope, settling, moved, strict=True)
        )
        if line is not None:
            start = at(P, part, x_0, v, line)
            line = rig.line_step(line, refilled(middle[0]), refilled(middle[1]), h)
            more, line = _drops(rig, start, line, h, moved, edges)
            moved = (moved[0] + more[0], moved[1] + more[1])
        P = (P[0] + moved[0], P[1] + moved[1])
        return (P, line), None

    if n == 1:
        return substep((P, line), (0.0, x[..., 0], x[..., 1], x[..., 2]))[0]
    # A loop, not a chain: a program of one substep compiles n times as fast.
    ends = [jnp.moveaxis(x[..., i : i + 2 * n : 2], -1, 0) for i in range(3)]
    return jax.lax.scan(substep, (P, line), (jnp.arange(n) / n, *ends))[0]


def _drops(
    rig: Rig,
    at: Point,
    line: Lines,
    h: Float[Array, "*batch"],
    moved: tuple,
    edges: tuple,
) -> tuple[tuple, Lines]:
    """By how much both chambers' pressures move on as oil passes between them and their
    lines in a substep, Pa, and the lines after it.

    `moved` is by how much the mean pressure of chamber and line has moved, `edges` as
    `_edges` has them. Implicit: either may settle within a fraction of the substep.
    """
    (q, beside), slopes = edges
    loss = rig.line_losses(line)
    swept = (rig.chambers.area_1 * at.v, -rig.chambers.area_2 * at.v)
    more, drops = [], []
    for i, (C, C_l) in enumerate(_capacities(rig, at)):
        d, share = line.drop[i], C / (C + C_l)
        taken = q[i] + slopes[i] * (moved[i] + share * d)
        goal = d + h * ((beside[i] + swept[i]) / C - taken / C_l)
        slower = 1 - h * slopes[i] * share / C_l
        drops.append(_lost(loss[i], h * (1 / C + 1 / C_l) / slower, goal / slower))
        more.append((1 - share) * (drops[i] - d))
    return tuple(more), line._replace(drop=tuple(drops))


def follow_drops(
    rig: Rig, at: Point, line: Lines, h: Float[Array, "*batch"], moved: tuple
) -> Lines:
    """The lines after a tick over which the chambers' pressures rise by `moved`, Pa."""
    at = at._replace(line=line)
    (q, _), slopes = _edges(rig, at)
    loss, drops = rig.line_losses(line), []
    for i, (_, C_l) in enumerate(_capacities(rig, at)):
        b = h / (C_l - h * slopes[i])
        goal = moved[i] + line.drop[i] - b * q[i]
        drops.append(_lost(loss[i], b, goal))
    return line._replace(drop=tuple(drops))


def settled_drops(rig: Rig, at: Point, line: Lines) -> Lines:
    """The lines where what leaves the chambers has long left through the edges."""
    drops = []
    opening = sides(*at.opening) if len(at.opening) == 1 else at.opening
    least = tuple(jnp.maximum(o, LEAKS) for o in opening)
    q = rig.flows(at._replace(opening=least))[0]
    for P, Q, r in zip((at.P_a1, at.P_a2), q, rig.line_losses(line), strict=True):
        leaves = Q < 0
        into = r.into * abs(Q) * _rounded(Q, r.laminar)
        lost = jnp.where(leaves, r.out * Q**2, into)
        head = jnp.maximum(jnp.where(leaves, P - at.P_r, at.P_s - P), 1.0)
        drops.append(jnp.where(leaves, 1, -1) * lost / (1 + lost / head))
    return line._replace(drop=tuple(drops))


def _lost(
    losses: Losses, b: Float[Array, "*batch"], goal: Float[Array, "*batch"]
) -> Float[Array, "*batch"]:
    """The drop `r Q sqrt(Q^2 + q^2)` of what leaves at which `drop + b Q = goal`, Pa;
    negative where oil enters.

    Newton's method from the answer for `r Q (Q + q)`, which is near it, and exact where
    q is 0: the drop is right to 1e-6 of itself.
    """
    leaves = goal > 0
    r, size = jnp.where(leaves, losses.out, losses.into), jnp.where(leaves, goal, -goal)
    q = jnp.where(leaves, 0.0, losses.laminar)
    a = r * q + b
    Q = 2 * size / (a + jnp.sqrt(a * a + 4 * r * size))
    for _ in range(NEWTON):
        root = _rounded(Q, q)
        slope = r * (root + Q * Q / root) + b
        Q = Q - (r * Q * root + b * Q - size) / slope
    return jnp.where(leaves, 1, -1) * r * Q * _rounded(Q, q)


def _rounded(
    Q: Float[Array, "*batch"], q: Float[Array, "*batch"]
) -> Float[Array, "*batch"]:
    """`sqrt(Q^2 + q^2)`; its derivative exists at no flow too."""
    return jnp.sqrt(Q * Q + q * q + 1e-24)


def _edges(rig: Rig, at: Point) -> tuple[tuple, tuple]:
    """Flows as `Rig.flows` has them, and slopes of those through the edges by the
    pressure at them: an edge knows no other chamber's.
    """

    def flows(P_1, P_2):
        return rig.flows(at._replace(P_a1=P_1, P_a2=P_2))

    found, (up, _) = _apart(flows, at)
    return found, _falling(up)


def _capacities(rig: Rig, at: Point) -> tuple:
    return rig.chambers.capacities(at, rig.compliance, rig.volume, rig.line)


def _settling_rates(rig: Rig, at: Point) -> tuple[tuple, tuple, tuple]:
    """Rates of both pressures, Pa/s, those at which each would settle, 1/s; `_edges`.

    Twice the slope, since a turbulent flow's falls off as a root does: on a line of
    the slope itself a pressure would go as far beyond its rest as it was before it.
    """

    def rates(P_1, P_2):
        here = at._replace(P_a1=P_1, P_a2=P_2)
        flows = rig.flows(here)
        return rig.rates_of(here, flows), flows

    (found, flows), (up, (edges, _)) = _apart(rates, at)
    settling = (jnp.maximum(-2 * up[0], 0.0), jnp.maximum(2 * up[1], 0.0))
    return found, settling, (flows, _falling(edges))


def _falling(up: tuple) -> tuple:
    """Slopes of the edges' flows by the pressure at them, as they move apart.

    A compensator that takes more than the drop lets a flow rise with the pressure
    behind it: an implicit step along that may have no answer, so it takes none.
    """
    own = (up[0], -up[1])
    return tuple(jnp.where(s < 0, s, 0.0) for s in own)


def _apart(f: Callable, at: Point) -> tuple:
    """A function of both pressures, and how it moves as they move apart.

    What belongs to chamber 2 falls with its pressure then. What passes between the
    chambers counts twice.
    """
    own = (at.P_a1, at.P_a2)
    return jax.jvp(f, own, (jnp.ones_like(own[0]), -jnp.ones_like(own[1])))


@jax.custom_jvp
def _relax(z: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """`(1 - e^-z) / z` for z >= 0, the share of a slope that is run along it.

    Of third order and never beyond rest: `e^-z` as `1 / (1 + z + z^2/2 + z^3/6)`.
    """
    beyond = z * (1 / 2 + z / 6)
    return (1 + beyond) / (1 + z * (1 + beyond))


@_relax.defjvp
def _relax_slope(at, along):
    (z,), (dz,) = at, along
    over, rise = 1 + z * (1 / 2 + z / 6), 1 / 2 + z / 3
    under = 1 / (1 + z * over)
    share = over * under
    return share, (rise - share * (over + z * rise)) * under * dz
