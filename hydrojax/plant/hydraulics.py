"""Both pressures over one tick: stable next to P_s and P_r and in a short chamber."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.plant import stretch
from hydrojax.plant.chambers import Point
from hydrojax.plant.rig import Rig
from hydrojax.plant.state import StepInput


def pressure_step(
    rig: Rig,
    P: tuple[Float[Array, "*batch"], Float[Array, "*batch"]],
    opening: tuple[Float[Array, "*batch"], ...],
    inputs: StepInput,
    line: tuple = (),
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """Both pressures over one tick, in n substeps of an exponential midpoint rule.

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

    def at(P, part, x, v):
        p_s, p_r = (
            p[..., 0] + part * (p[..., 1] - p[..., 0]) for p in (inputs.P_s, inputs.P_r)
        )
        return Point(P[0], P[1], p_s, p_r, opening, x, v, line)

    def substep(P, along):
        part, x_0, x_1, x_2 = along
        v = (x_2 - x_0) / h
        slope, settling = _settling_rates(rig, at(P, part, x_0, v))
        moved = tuple(
            h / 2 * _relax(b * h / 2) * r for r, b in zip(slope, settling, strict=True)
        )
        middle = (P[0] + moved[0], P[1] + moved[1])
        slope = rig.pressure_rates(at(middle, part + 0.5 / n, x_1, v))
        P = tuple(
            p + h * _relax(b * h) * (r + b * m)
            for p, r, b, m in zip(P, slope, settling, moved, strict=True)
        )
        return P, None

    if n == 1:
        return substep(P, (0.0, x[..., 0], x[..., 1], x[..., 2]))[0]
    # A loop, not a chain: a program of one substep compiles n times as fast.
    ends = [jnp.moveaxis(x[..., i : i + 2 * n : 2], -1, 0) for i in range(3)]
    return jax.lax.scan(substep, P, (jnp.arange(n) / n, *ends))[0]


def _settling_rates(rig: Rig, at: Point) -> tuple[tuple, tuple]:
    """Rates of both pressures, Pa/s, and rates at which each would settle, 1/s.

    Twice the slope, since a turbulent flow's falls off as a root does: on a line of
    the slope itself a pressure would go as far beyond its rest as it was before it.
    """

    def one(i):
        def rate(p):
            here = at._replace(P_a1=p) if i == 0 else at._replace(P_a2=p)
            return rig.pressure_rates(here)[i]

        p = (at.P_a1, at.P_a2)[i]
        return jax.jvp(rate, (p,), (jnp.ones_like(p),))

    (r_1, s_1), (r_2, s_2) = one(0), one(1)
    return (r_1, r_2), (jnp.maximum(-2 * s_1, 0.0), jnp.maximum(-2 * s_2, 0.0))


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
