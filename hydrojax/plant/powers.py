"""Logarithm and powers of positive numbers that a processor works out several at once.

XLA's CPU compiler calls the C library for each number by itself, and for the
derivatives of a power twice more.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

_HALF_ROOT = 0x3FE6A09E667F3BCD
"""The bits of the square root of 1/2: mantissas are taken from it to twice as much."""

_SERIES = tuple(1 / k for k in range(21, 1, -2))
"""Of the artanh of what is at most 0.172, over its argument and less 1."""

_LN_2 = 0.6931471805599453


@jax.custom_jvp
def log(x: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Natural logarithm of x > 0, within some units of the last place of 1 or of
    itself, whichever is larger; of 0 it is finite.
    """
    if x.dtype != jnp.float64:
        return jnp.log(x)
    bits = jax.lax.bitcast_convert_type(x, jnp.int64)
    exponent = (bits - _HALF_ROOT) >> 52
    mantissa = jax.lax.bitcast_convert_type(bits - (exponent << 52), x.dtype)
    s = (mantissa - 1) / (mantissa + 1)
    square, rest = s * s, jnp.zeros_like(s)
    for part in _SERIES:
        rest = (rest + part) * square
    out = exponent.astype(x.dtype) * _LN_2 + (2 * s + 2 * s * rest)
    return jnp.where(x < jnp.inf, out, x)


log.defjvps(lambda dx, y, x: dx / x)


@jax.custom_jvp
def power(x: Float[Array, "*batch"], a: ArrayLike) -> Float[Array, "*batch"]:
    """`x**a` for x > 0; see `log`, whose error counts `a` times."""
    return jnp.exp(a * log(x))


power.defjvps(
    lambda dx, y, x, a: y * (a / x) * dx,
    lambda da, y, x, a: y * log(x) * da,
)
