"""Valves: from the spool's opening to flows into the chambers, (8)(12)(13).

Pushes add: effects hand in pressure drops ahead of the valve and openings of its edges;
each is zero when the effect is absent.
"""

from __future__ import annotations

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, ArrayLike, Float

from hydrojax.parameters import param
from hydrojax.plant.chambers import Point

LAMINAR_CORE = 2.0e3
"""Width (Pa) of the laminar core of `root_flow`: it lowers the turbulent flow by
`(core / drop)^2 / 4`, 4e-8 of it at a drop of 5 MPa, and 1 % at 10 kPa."""

_C_UNIT = "m^3/(s*{u}*Pa^0.5)"


def root_flow(
    drop: ArrayLike, core: float = LAMINAR_CORE, wider: ArrayLike = 0.0
) -> Float[Array, "*batch"]:
    """Signed square root of a pressure drop with a laminar core, in Pa^0.5.

    `drop / (drop^2 + core^2)^(1/4)`: odd, smooth, slope `core^-0.5` at zero, and
    sqrt(drop) as `core` goes to 0 (the paper's (8)). `wider` is added to the square
    of the core, Pa^2.
    """
    d = jnp.asarray(drop)
    return _root(d, jnp.asarray(core * core + wider, d.dtype))


# Derivatives of their own: the step of the pressures takes the slope, and a fit the
# derivative of that. Each is then one product with what is known at the point.
@jax.custom_jvp
def _root(
    d: Float[Array, "*batch"], square: Float[Array, "..."]
) -> Float[Array, "..."]:
    return d * per_fourth_root(d * d + square)


@jax.custom_jvp
def _root_slope(
    d: Float[Array, "*batch"], square: Float[Array, "..."]
) -> Float[Array, "..."]:
    y = per_fourth_root(d * d + square)
    return y * (0.5 + 0.5 * square * (y * y) * (y * y))


def _set_derivatives(function, by_d, by_square) -> None:
    """Set both partial derivatives; the second is left out where the core is fixed."""

    def rule(at, along):
        (d, square), (d_d, d_square) = at, along
        y = per_fourth_root(d * d + square)
        out = jnp.zeros(jnp.broadcast_shapes(d.shape, square.shape), d.dtype)
        if not isinstance(d_d, SymbolicZero):
            out = out + by_d(d, square, y) * d_d
        if not isinstance(d_square, SymbolicZero):
            out = out + by_square(d, square, y) * d_square
        return function(d, square), out

    function.defjvp(rule, symbolic_zeros=True)


def _bend(square, y):
    return 0.5 + 2.5 * square * (y * y) * (y * y)


_set_derivatives(
    _root,
    lambda d, square, y: _root_slope(d, square),
    lambda d, square, y: -0.25 * d * y * (y * y) * (y * y),
)
_set_derivatives(
    _root_slope,
    lambda d, square, y: -0.5 * d * y * (y * y) * (y * y) * _bend(square, y),
    lambda d, square, y: y * (y * y) * (y * y) * (0.5 - 0.25 * _bend(square, y)),
)


@jax.custom_jvp
def per_fourth_root(a: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """`a**(-1/4)` for a > 0, within 4 units of the last place.

    By a guess from the bits and two steps of the series of (1 - t)^(-1/4): roots and
    divisions queue for one unit of a processor, and a loop takes 32 of these a tick.
    The derivative needs neither.
    """
    if a.dtype == jnp.float64:
        whole, magic = jnp.int64, 0x4FEB000000000000
    else:
        whole, magic = jnp.int32, 0x4F580000
    bits = jax.lax.bitcast_convert_type(a, whole)
    y = jax.lax.bitcast_convert_type(magic - (bits >> 2), a.dtype)

    def left(y):  # 1 - a y^4
        return 1 - a * ((y * y) * (y * y))

    t = left(y)
    more = 0.25 + t * (5 / 32 + t * (15 / 128 + t * (195 / 2048 + t * (663 / 8192))))
    y = y + y * (t * more)
    t = left(y)
    return y + y * (t * (0.25 + t * (5 / 32)))


@per_fourth_root.defjvp
def _slope(at, along):
    (a,), (da,) = at, along
    y = per_fourth_root(a)
    y_2 = y * y
    return y, (-0.25 * (y * y_2 * y_2)) * da


def sides(
    spool: Float[Array, "*batch"],
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """The spool's opening toward either side, both >= 0."""
    return jnp.where(spool > 0, spool, 0.0), -jnp.where(spool > 0, 0.0, spool)


class AbstractValve(eqx.Module):
    """What turns the spool's opening into flows: derive from it for another valve.

    Declare its constants with `hydrojax.parameters.param`; they are then identified,
    swept and exported by name as the paper's are. Effects on the command's path move
    the spool of any valve; those of the supply line and of the edges act where `flows`
    applies them.
    """

    @abstractmethod
    def flows(
        self, at: Point, drops: tuple = (), orifices: tuple = ()
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Flows into chambers 1 and 2, m^3/s.

        Args:
            at: pressures, opening and motion; every field has one shape, `*batch`.
                `sides(*at.opening)`, or `at.opening` if it holds two, is the opening
                toward either side, in the command's unit. It holds more only under
                effects of the return edges, which no other than `MeteringEdges` has.
            drops: effects ahead of the valve and behind it, each with
                `drop(conductance, available)` and `back(conductance, available)`.
            orifices: effects of the edges, each with `opening(spool)` and `core()`.
        """


class MeteringEdges(AbstractValve):
    """Four metering edges, each with a constant of its own, (12)(13)."""

    c_p1: Float[Array, ""] = param(_C_UNIT, 2.2e-9, 1e-10, 1e-6, "supply to chamber 1")
    c_n1: Float[Array, ""] = param(_C_UNIT, 2.2e-9, 1e-10, 1e-6, "chamber 1 to return")
    c_p2: Float[Array, ""] = param(_C_UNIT, 2.2e-9, 1e-10, 1e-6, "supply to chamber 2")
    c_n2: Float[Array, ""] = param(_C_UNIT, 2.2e-9, 1e-10, 1e-6, "chamber 2 to return")

    def flows(
        self, at: Point, drops: tuple = (), orifices: tuple = ()
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Flows into chambers 1 and 2, m^3/s.

        `drops` are effects ahead of the valve and behind it: each maps the conductance
        of the edge that draws on the supply, or drains (m^3/(s Pa^0.5)), and the
        pressure available across it to a pressure drop. `orifices` are effects of the
        edges themselves: what they add to the openings and to the square of the
        laminar core.
        """
        if len(at.opening) == 1 and not orifices:
            return self._on_one_side(at, drops)
        opening = sides(*at.opening) if len(at.opening) == 1 else at.opening
        open_p, open_n, *back = opening
        back_p, back_n = back or (open_p, open_n)
        for edge in orifices:
            more_p, more_n = edge.opening(open_p - open_n)
            open_p, open_n = open_p + more_p, open_n + more_n
            back_p, back_n = back_p + more_p, back_n + more_n
        wider = sum(edge.core() for edge in orifices)

        def root(drop):
            return root_flow(drop, wider=wider)

        def drawn(edge, chamber):
            available = at.P_s - chamber
            return edge * root(available - sum(d.drop(edge, available) for d in drops))

        def drained(edge, chamber):
            available = chamber - at.P_r
            return edge * root(available - sum(d.back(edge, available) for d in drops))

        q_1 = drawn(self.c_p1 * open_p, at.P_a1)
        q_2 = drawn(self.c_p2 * open_n, at.P_a2)
        q_1 = q_1 - drained(self.c_n1 * back_n, at.P_a1)
        q_2 = q_2 - drained(self.c_n2 * back_p, at.P_a2)
        return q_1, q_2

    def _on_one_side(
        self, at: Point, drops: tuple
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """The same where two of the four edges are shut: half of the roots."""
        (spool,) = at.opening
        up = spool > 0
        size = jnp.where(up, spool, -spool)

        def flow(draws, c_p, c_n, chamber):
            edge = jnp.where(draws, c_p, c_n) * size
            across = jnp.where(draws, at.P_s, at.P_r) - chamber
            ahead = sum(d.drop(edge, across) for d in drops)
            behind = sum(d.back(edge, across) for d in drops)
            return edge * root_flow(across - jnp.where(draws, ahead, behind))

        return (
            flow(up, self.c_p1, self.c_n1, at.P_a1),
            flow(~up, self.c_p2, self.c_n2, at.P_a2),
        )


class NoValve(AbstractValve):
    """No valve, and so no constants: what drives the axis is an input."""

    def flows(
        self, at: Point, drops: tuple = (), orifices: tuple = ()
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """No flow into either chamber."""
        none = jnp.zeros_like(at.P_a1)
        return none, none


def metering_edges(valve: AbstractValve) -> MeteringEdges:
    """The valve as four metering edges, which is what the paper's law inverts, (18).

    Raises:
        TypeError: it is a valve of another kind.
    """
    if not isinstance(valve, MeteringEdges):
        raise TypeError(
            f"invalid valve {type(valve).__name__}: expected MeteringEdges; the "
            "adaptive law inverts their flow equations"
        )
    return valve
