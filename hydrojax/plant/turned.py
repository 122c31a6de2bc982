"""When, and how far ago, friction turned, and how old the seal's contact is."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.plant.friction import run_linear

AGES = (1e-4, 1e-3, 1e-2)
"""Ways (m) over which a contact is renewed: of asperities, and of seals that creep."""


class Turned(NamedTuple):
    """What is remembered of the last turn, and of the contact.

    Friction turns where the bristle passes its middle, where it holds nothing: the
    force does not jump there. A swing that does not bend the bristle to the other side
    is no turn, nor is a fine encoder's noise at rest; a coarse one's may be.
    `side` is the side to which it bent last (1, -1, 0 before it did), `since` and `way`
    as in `Sliding`, and `ages` those (s) of the contact for each way `D` of `AGES`: at
    rest it ages by a second a second, and sliding renews it, `dA/dt = 1 - abs(v) A / D`
    (Dieterich's law of friction by rate and state; Ruina, 1983).
    """

    side: Float[Array, "*batch"]
    since: Float[Array, "*batch"]
    way: Float[Array, "*batch"]
    ages: tuple[Float[Array, "*batch"], ...]

    def moved(
        self,
        z: Float[Array, "*batch"],
        dx: Float[Array, "*batch"],
        h: Float[Array, "*batch"],
    ) -> Turned:
        """The same after a tick of length `h` (s) that moves the piston by `dx` (m) and
        leaves the bristle at a deflection `z` (m).
        """
        side = jnp.where(z == 0, self.side, jnp.sign(z))
        new = side != self.side
        since = jnp.where(new, 0.0, self.since + h)
        way = jnp.where(new, 0.0, self.way + jnp.abs(dx))
        ages = []
        for age, D in zip(self.ages, AGES, strict=True):
            keep, add = _age_map(dx, h, D)
            ages.append(keep * age + add)
        return Turned(side, since, way, tuple(ages))

    def seen(self) -> dict[str, Any]:
        """What of it `Sliding` has, by field."""
        return {"since": self.since, "way": self.way, "ages": self.ages}


def at_rest(like: Float[Array, "*batch"]) -> Turned:
    """Before the first tick, of the shape of `like`."""
    none = jnp.zeros_like(like)
    return Turned(none, none, none, (none,) * len(AGES))


def _age_map(
    dx: Float[Array, "*batch"], h: Float[Array, "*batch"], D: float
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """The step of an age as `A -> keep A + add`, exact for an even speed."""
    share = jnp.abs(dx) / D
    rest = share == 0
    part = jnp.where(rest, 1.0, -jnp.expm1(-share) / jnp.where(rest, 1.0, share))
    return jnp.exp(-share), h * part


def run_turned(
    z: Float[Array, "segments n+1"],
    dx: Float[Array, "segments n"],
    h: Float[Array, "segments n"],
) -> Turned:
    """`Turned` at the n+1 ticks of segments that begin at rest, [S, n+1] each.

    `z` is the bristle's deflection (m) at the ticks; `dx` (m) and `h` (s) are of the
    ticks between.
    """
    start = jnp.zeros_like(dx[:, 0])

    def whole(first, rest):
        return jnp.concatenate([first[:, None], rest], axis=1)

    def held_from(here):
        """The last tick up to each at which `here` was so; the first before it was."""
        return jax.lax.cummax(jnp.where(here, jnp.arange(here.shape[1]), 0), axis=1)

    side = jnp.take_along_axis(jnp.sign(z), held_from(z != 0), axis=1)
    turn = held_from(jnp.diff(side, axis=1, prepend=0.0) != 0)

    def after(steps):
        run = whole(start, jnp.cumsum(steps, axis=1))
        return run - jnp.take_along_axis(run, turn, axis=1)

    ages = tuple(whole(start, run_linear(*_age_map(dx, h, D), start)) for D in AGES)
    return Turned(side, after(h), after(jnp.abs(dx)), ages)
