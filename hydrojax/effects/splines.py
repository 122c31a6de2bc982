"""A curve through a signal as cubic B-splines: linear in its coefficients."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

DEGREE = 3


def bspline(
    s: Float[ArrayLike, "*batch"], knots: Float[ArrayLike, "n+4"]
) -> Float[Array, "*batch n"]:
    """The n cubic B-splines of a knot vector at `s` (Cox and de Boor's recursion).

    Beyond the ends, which stand four times each in `knots`, they are held.
    """
    t = jnp.asarray(knots, float)
    at = jnp.clip(jnp.asarray(s, float), t[DEGREE], t[-1 - DEGREE])[..., None]
    last = jnp.arange(t.size - 1) == t.size - 2 - DEGREE
    inside = (at >= t[:-1]) & ((at < t[1:]) | (last & (at <= t[1:])))
    b = jnp.where(inside & (t[1:] > t[:-1]), 1.0, 0.0)
    for d in range(1, DEGREE + 1):
        n = t.size - 1 - d
        up, down = t[d : d + n] - t[:n], t[d + 1 : d + 1 + n] - t[1 : 1 + n]
        rise = (at - t[:n]) / jnp.where(up > 0, up, 1.0)
        fall = (t[d + 1 : d + 1 + n] - at) / jnp.where(down > 0, down, 1.0)
        b = rise * b[..., :-1] + fall * b[..., 1:]
    return b


def curve(
    s: Float[ArrayLike, "*batch"],
    knots: Float[ArrayLike, "n+4"],
    coefficients: Float[ArrayLike, "n"],
) -> Float[Array, "*batch"]:
    """A cubic spline at `s`: held at its end values beyond the ends of its knots.

    Args:
        s: the signal.
        knots: in the signal's unit, rising; the first and the last stand four times.
        coefficients: of the n B-splines, in the unit of the curve.
    """
    return bspline(s, knots) @ jnp.asarray(coefficients, float)


def knots_over(
    samples: Float[np.ndarray, "rows"], count: int
) -> Float[np.ndarray, "count+4"]:
    """Knots of `count` B-splines over what was sampled of a signal.

    Half way between even steps and equal shares of the samples: close where the signal
    often is, and never far apart. The outermost 0.2 % of the samples lie beyond them.
    """
    inner = count - DEGREE + 1
    share = np.linspace(0.002, 0.998, inner)
    quantiles = np.quantile(samples, share)
    even = np.linspace(quantiles[0], quantiles[-1], inner)
    breaks = (quantiles + even) / 2
    return np.r_[[breaks[0]] * DEGREE, breaks, [breaks[-1]] * DEGREE]
