"""Chambers of fluid: volumes (10)(11) and pressure rates (14)(15).

Pushes add: effects hand in flows into the chambers and compliances beside 1/beta; each
is zero when the effect is absent.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.parameters import param

P_VAPOUR = -101_325.0
"""Gauge pressure (Pa) of a vacuum: oil's own vapour adds less than 1 kPa. Below it a
chamber is not full."""

SHORTEST = 2e-3
"""Share of a chamber's length below which its volume is held: a piston that overruns
the stroke would turn it negative."""


LONGEST = 0.9
"""Share of what a chamber and its line hold that the line takes at most."""

STOP_STIFFNESS = 1e8
"""Of the stroke's ends, N/m: 0.2 mm under 20 kN."""


def refilled(P: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """The pressure of a chamber that may lack volume, Pa; see `pressure_step`."""
    # `maximum` shares its derivative where both are equal: a closed loop of many
    # instances then takes four times as long.
    return jnp.where(P < P_VAPOUR, P_VAPOUR, P)


class Lines(NamedTuple):
    """What stands in the lines between chambers and metering edges.

    `memory` is that of each effect; `drop` says by how much the pressure at the edges
    is below that of chambers 1 and 2 (Pa).
    """

    memory: tuple
    drop: tuple[Float[Array, "*batch"], Float[Array, "*batch"]]


class Losses(NamedTuple):
    """What a flow Q loses in the line of a chamber, over Q^2, Pa s^2/m^6.

    `out` holds for what leaves the chamber, `into` for what enters it: there the loss
    is laminar below a flow of `laminar`, m^3/s: `into Q sqrt(Q^2 + laminar^2)`.
    """

    out: Float[Array, "*batch"]
    into: Float[Array, "*batch"]
    laminar: Float[Array, "*batch"]


class Point(NamedTuple):
    """Where the hydraulics stand at one instant; SI, every field of one shape.

    `opening` is `(spool,)` where the spool stays on one side, or the means over the
    tick of its opening toward either side, both >= 0: a spool that crosses zero inside
    a tick opens both. Where the edges to the return open elsewhere, these two are of
    the edges from the supply, and behind them stand those of the edges from chamber 2,
    and from chamber 1, to the return. `line` is what stands in the lines, where
    anything does, `t` the time since the log began.
    """

    P_a1: Float[Array, "*batch"]
    P_a2: Float[Array, "*batch"]
    P_s: Float[Array, "*batch"]
    P_r: Float[Array, "*batch"]
    opening: tuple[Float[Array, "*batch"], ...]
    x: Float[Array, "*batch"]
    v: Float[Array, "*batch"]
    line: Lines | None = None
    t: Float[Array, "*batch"] | float = 0.0


class Chambers(eqx.Module):
    """Two chambers of fluid: volumes (10)(11) and pressure rates (14)(15)."""

    area_1: Float[Array, ""]
    area_2: Float[Array, ""]
    length: Float[Array, ""]
    beta: Float[Array, ""] = param("Pa", 8.5e8, 1e7, 1e10, "bulk modulus")
    delta_1: Float[Array, ""] = param(
        "m", 0.0, -0.5, 0.5, "assembly offset of chamber 1"
    )
    delta_2: Float[Array, ""] = param(
        "m", 0.0, -0.5, 0.5, "assembly offset of chamber 2"
    )

    def lengths(
        self, x: Float[Array, "*batch"]
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Lengths of chambers 1 and 2 at piston position `x`, m; (10)(11)."""
        half = self.length / 2
        return half + self.delta_1 - x, half + self.delta_2 + x

    def end_stop(self, x: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Force of the stroke's ends on a piston at `x`, N.

        It begins half a length from the middle, or where a chamber is all but gone.
        """
        least = 2 * SHORTEST * self.length
        short = (jnp.minimum(d - least, 0.0) for d in (self.delta_1, self.delta_2))
        ahead, behind = (self.length / 2 + s for s in short)
        return STOP_STIFFNESS * (
            jnp.maximum(-x - behind, 0.0) - jnp.maximum(x - ahead, 0.0)
        )

    def rates(
        self,
        at: Point,
        q_1: Float[Array, "*batch"],
        q_2: Float[Array, "*batch"],
        softness: tuple = (),
        volumes: tuple = (),
        lines: tuple = (),
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Pressure rates (Pa/s) for flows into the chambers; (14)(15).

        `softness` are effects that add compliance (1/Pa) beside 1/beta, `volumes`
        those that add to what the chambers hold (m^3), `lines` those behind which a
        part of it lies; with them the rates are of the mean pressure of both parts.

        A pressure below `P_VAPOUR` stands for a chamber that is not full: it lacks
        `A length / beta` of volume per Pa, whatever room it has, so that the same
        volume fills it up.
        """
        x_1, x_2 = self._filled(at, volumes)
        if lines:
            parts = self.capacities(at, softness, volumes, lines)
            stiff_1, stiff_2 = (
                area * x / (chamber + line)
                for area, x, (chamber, line) in zip(
                    (self.area_1, self.area_2), (x_1, x_2), parts, strict=True
                )
            )
        else:
            stiff_1 = 1 / self._compliance(at.P_a1, softness)
            stiff_2 = 1 / self._compliance(at.P_a2, softness)
        # Divisions by what instances of a sweep have in common are done once.
        return (
            stiff_1 * (1 / x_1) * (q_1 * (1 / self.area_1) + at.v),
            stiff_2 * (1 / x_2) * (q_2 * (1 / self.area_2) - at.v),
        )

    def capacities(
        self, at: Point, softness: tuple, volumes: tuple, lines: tuple
    ) -> tuple[tuple[Float[Array, "*batch"], Float[Array, "*batch"]], ...]:
        """What chambers 1 and 2 take up, and what their lines do, m^3/Pa.

        Arguments as those of `rates`. A line holds at most `LONGEST` of what both hold.
        """
        parts, drops = [], at.line.drop if at.line is not None else (0.0, 0.0)
        behind = [sum(v) for v in zip(*(e.volume() for e in lines), strict=True)]
        for area, x, P, lower, more in zip(
            (self.area_1, self.area_2),
            self._filled(at, volumes),
            (at.P_a1, at.P_a2),
            drops,
            behind,
            strict=True,
        ):
            line = jnp.minimum(more, LONGEST * area * x)
            parts.append(
                (
                    (area * x - line) * self._compliance(P, softness),
                    line * self._compliance(P - lower, softness),
                )
            )
        return tuple(parts)

    def _filled(
        self, at: Point, volumes: tuple
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Volumes over areas, m."""
        x_1, x_2 = (jnp.maximum(x, SHORTEST * self.length) for x in self.lengths(at.x))
        for effect in volumes:
            more_1, more_2 = effect.volume()
            x_1, x_2 = x_1 + more_1 / self.area_1, x_2 + more_2 / self.area_2
        return (
            jnp.where(at.P_a1 < P_VAPOUR, self.length, x_1),
            jnp.where(at.P_a2 < P_VAPOUR, self.length, x_2),
        )

    def _compliance(
        self, P: Float[Array, "*batch"], softness: tuple
    ) -> Float[Array, "..."]:
        return 1 / self.beta + sum(s.compliance(P) for s in softness)
