"""When, and how far ago, the piston turned."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.plant.friction import run_stop

TURN = 1e-5
"""Half the way (m) back after which the piston has turned: a coarse encoder's step is
half as long, so that its noise at rest is no turn."""


class Turned(NamedTuple):
    """What is remembered of the piston's last turn.

    `slip` is the deflection (m) of a stop that slides at `TURN`, `side` the side at
    which it slid last (1, -1, 0 before it did): the piston has turned where it slides
    at the other one. `since` and `way` as in `Sliding`.
    """

    slip: Float[Array, "*batch"]
    side: Float[Array, "*batch"]
    since: Float[Array, "*batch"]
    way: Float[Array, "*batch"]

    def moved(self, dx: Float[Array, "*batch"], h: Float[Array, "*batch"]) -> Turned:
        """The same after a tick of length `h` (s) that moves the piston by `dx` (m)."""
        slip = jnp.clip(self.slip + dx, -TURN, TURN)
        side = jnp.where(jnp.abs(slip) < TURN, self.side, jnp.sign(slip))
        new = side != self.side
        since = jnp.where(new, 0.0, self.since + h)
        return Turned(slip, side, since, jnp.where(new, 0.0, self.way + jnp.abs(dx)))


def run_turned(dx: Float[Array, "segments n"], h: Float[Array, "segments n"]) -> Turned:
    """`Turned` at the n+1 ticks of segments that begin with none, [S, n+1] each."""
    start = jnp.zeros_like(dx[:, 0])

    def whole(first, rest):
        return jnp.concatenate([first[:, None], rest], axis=1)

    def held_from(here):
        """The last tick up to each at which `here` was so; the first before it was."""
        return jax.lax.cummax(jnp.where(here, jnp.arange(here.shape[1]), 0), axis=1)

    slip = whole(start, run_stop(dx, jnp.asarray(TURN), start))
    slid = jnp.where(jnp.abs(slip) < TURN, 0.0, jnp.sign(slip))
    side = jnp.take_along_axis(slid, held_from(slid != 0), axis=1)
    turn = held_from(jnp.diff(side, axis=1, prepend=0.0) != 0)

    def after(steps):
        run = whole(start, jnp.cumsum(steps, axis=1))
        return run - jnp.take_along_axis(run, turn, axis=1)

    return Turned(slip, side, after(h), after(jnp.abs(dx)))
