"""What gives between piston and encoder: where the piston stands, and under what force.

The piston is ahead of the encoder by `stretch(F)`. A log says what F was; a simulation
solves for it (`hydrojax.plant.step`), since the stretch takes from the very force that
makes it.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.plant.state import StepInput


def ahead(stretches: tuple, F: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """How far the piston stands ahead of the encoder under `F`, m."""
    return sum((e.stretch(F) for e in stretches), start=jnp.zeros_like(F))


def along(ends: Float[Array, "*batch 2"], parts: int) -> Float[Array, "*batch parts+1"]:
    """Values at `parts + 1` even points of a line, [..., parts + 1]; its `ends`."""
    start, end = ends[..., :1], ends[..., 1:]
    return start + jnp.linspace(0.0, 1.0, parts + 1) * (end - start)


def rate(
    F: Float[Array, "segments n"], h: Float[Array, "segments n-1"]
) -> Float[Array, "segments n"]:
    """Rate of `F` [S, N] at every tick, from both neighbours; `h` [S, N-1]."""
    t = jnp.pad(jnp.cumsum(h, axis=1), ((0, 0), (1, 0)))

    def wide(y):
        y = jnp.pad(y, ((0, 0), (1, 1)), mode="edge")
        return y[:, 2:] - y[:, :-2]

    return wide(F) / wide(t)


def place(stretches: tuple, inputs: StepInput) -> Float[Array, "*batch n"]:
    """The piston's place where the encoder says `inputs.x`, m."""
    if not stretches or inputs.F is None:
        return inputs.x
    return inputs.x + ahead(stretches, along(inputs.F, inputs.x.shape[-1] - 1))


def moves(stretches: tuple, inputs: StepInput) -> Float[Array, "*batch m"]:
    """The piston's displacement where the encoder says `inputs.dx`, m."""
    dx = jnp.diff(inputs.x[..., ::2]) if inputs.dx is None else inputs.dx
    if not stretches or inputs.F is None:
        return dx
    F = along(inputs.F, dx.shape[-1])
    return dx + jnp.diff(ahead(stretches, F), axis=-1)


def ahead_rate(
    stretches: tuple, F: Float[Array, "*batch"], F_rate: Float[Array, "*batch"]
) -> Float[Array, "*batch"]:
    """The piston's velocity beyond the encoder's while `F` changes at `F_rate`, m/s."""
    return jax.jvp(lambda F: ahead(stretches, F), (F,), (F_rate,))[1]


def velocity(stretches: tuple, inputs: StepInput) -> Float[Array, "*batch"]:
    """The piston's velocity at the tick's end, m/s.

    Without a logged force it is the encoder's: the piston is massless, and friction
    that falls with its own speed (k_v > 0) would make it chatter.
    """
    if not stretches or inputs.F is None or inputs.F_rate is None:
        return inputs.v
    return inputs.v + ahead_rate(stretches, inputs.F[..., 1], inputs.F_rate)
