"""The free motion of a damped second-order system, below critical damping and above."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

NEAR = 1e-3
"""Distance of `zeta^2` from 1 within which both ways of motion are one power series."""


def free_motion(
    zeta: Float[Array, ""], s: Float[Array, "*batch"]
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """`e^(-zeta s) cos(w s)` and `e^(-zeta s) sin(w s) / w` with `w^2 = 1 - zeta^2`, of
    `y'' + 2 zeta y' + y = 0` after a time `s`, times the natural frequency (1);
    hyperbolic where the damping ratio `zeta` (1) is above 1.
    """
    d = 1 - zeta**2
    near, over = jnp.abs(d) < NEAR, d < 0
    w = jnp.sqrt(jnp.where(near, 1.0, jnp.abs(d)))
    fade = jnp.exp(-zeta * s)
    cos, sin = fade * jnp.cos(w * s), fade * jnp.sin(w * s) / w
    # Neither grows, so that a fast system has no infinity times zero in it.
    slow = jnp.exp(-(zeta - jnp.where(over, w, 0.0)) * s)
    fast = jnp.exp(-(zeta + w) * s)
    cos = jnp.where(over, (slow + fast) / 2, cos)
    sin = jnp.where(over, (slow - fast) / (2 * w), sin)
    # Longer than this nothing is left of it.
    t = jnp.minimum(s, 40.0)
    q = d * t * t
    series = 1 - q / 2 * (1 - q / 12 * (1 - q / 30 * (1 - q / 56)))
    linear = t * (1 - q / 6 * (1 - q / 20 * (1 - q / 42 * (1 - q / 72))))
    return (
        jnp.where(near, fade * series, cos),
        jnp.where(near, fade * linear, sin),
    )
