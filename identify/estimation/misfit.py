"""The misfit: windows' residuals and sensitivities, summed to small Gram matrices.

Everything that is asked later (a Gauss-Newton step, a covariance, a score, what two
effects have in common) needs only sums of products of the columns. So each window is
reduced to the Gram matrix of [sensitivities, residual], with the window's two initial
pressures eliminated, and the large Jacobian is never stored beyond that.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from hydrojax.identify.estimation.columns import (
    NUISANCE,
    SUPPLY_BLOCKS,
    Basis,
    Batch,
    Model,
    driven,
    recall,
    sensitivities,
)

START_SPREAD = 3e5
"""Prior on a window's initial pressure about its first guess, Pa: wide, it only keeps
a chamber that no channel sees in place."""

PIECE = 256
"""Windows whose pressures are run side by side."""

HANDFUL = 32
"""Windows whose columns are summed side by side: they stay in the processor's cache."""

_OWN_PRIOR = np.diag([1 / START_SPREAD**2] * 2 + [1.0] * SUPPLY_BLOCKS)


class Sums(NamedTuple):
    """Per window: `gram` [W, k+1, k+1] of [sensitivities, residual], whitened, what
    the window has of its own eliminated; `start` [W, NUISANCE, k+1] its solution (of
    the residual, with the sign turned); `sse` [W, 3] squared residuals, SI.
    """

    gram: Array
    start: Array
    sse: Array


def _in_pieces(part: Callable, size: int, *windows: PyTree) -> PyTree:
    """`part` of arrays with the windows first, in pieces of `size` one after the other
    if they are many: memory then does not grow with the length of the logs.
    """
    count = jax.tree.leaves(windows)[0].shape[0]
    if count <= size:
        return part(*windows)
    pieces = -(-count // size)

    def cut(a):
        # The last piece is filled with copies of the last window.
        index = np.minimum(np.arange(pieces * size), count - 1)
        return a[index].reshape(pieces, size, *a.shape[1:])

    out = jax.lax.map(lambda piece: part(*piece), jax.tree.map(cut, windows))
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:])[:count], out)


def _of_windows(
    model: Model,
    values: Array,
    directions: Basis,
    batch: Batch,
    simulate: bool,
    reduce: Callable[[Batch, Array, Array], PyTree],
) -> PyTree:
    """`reduce` of a batch, its predictions and their derivatives, window by window."""
    recalled = recall(model, values, batch.motion)

    def side_by_side(windows, P_0, weight):
        own = batch._replace(windows=windows, P_0=P_0, weight=weight)
        pressure = driven(model, values, directions, own, simulate)
        # Windows first, as all that is cut into handfuls has them.
        by = jax.tree.map(lambda a: jnp.moveaxis(a, 0, 1), pressure.by)

        def handful(windows, P_0, weight, P, by):
            few = batch._replace(windows=windows, P_0=P_0, weight=weight)
            by = jax.tree.map(lambda a: jnp.moveaxis(a, 1, 0), by)
            own = pressure._replace(P=P, by=by)
            y, dy = sensitivities(model, values, directions, windows, own, recalled)
            return reduce(few, y, dy)

        return _in_pieces(handful, HANDFUL, windows, P_0, weight, pressure.P, by)

    return _in_pieces(side_by_side, PIECE, batch.windows, batch.P_0, batch.weight)


def sums(
    model: Model, values: Array, directions: Basis, batch: Batch, simulate: bool
) -> Sums:
    """The windows' Gram matrices at `values` along `directions`; see `Sums`."""
    return _of_windows(model, values, directions, batch, simulate, _sums)


def _sums(batch: Batch, y: Array, dy: Array) -> Sums:
    """Reduce predictions and their derivatives to each window's sums."""
    seen = jnp.isfinite(batch.noise)
    white = jnp.where(seen, 1 / jnp.where(seen, batch.noise, 1.0), 0.0)
    residual = jnp.where(seen, batch.windows.measured - y, 0.0)
    k = dy.shape[0] - NUISANCE
    stack = jnp.concatenate([-dy, residual[None]]) * white  # [k+NUISANCE+1, W, T, 3]
    stack = jnp.moveaxis(stack, 1, 0).reshape(*residual.shape[:1], len(stack), -1)
    full = jnp.einsum("wit,wjt->wij", stack, stack)
    keep = np.r_[0:k, k + NUISANCE]
    own = slice(k, k + NUISANCE)
    cross = full[:, own, keep]
    start = jnp.linalg.solve(full[:, own, own] + _OWN_PRIOR, cross)
    gram = full[:, keep[:, None], keep] - jnp.einsum("wia,wib->wab", cross, start)
    left = _leftover(residual, dy[k:], white, start[:, :, -1])
    weight = batch.weight
    return Sums(
        gram * weight[:, None, None],
        start,
        jnp.sum(left**2, axis=1) * weight[:, None],
    )


def _leftover(residual: Array, dy: Array, white: Array, start: Array) -> Array:
    """Residuals without what each window has of its own, [W, T, 3], SI.

    The force is judged with the initial state that all channels together give; the
    pressures with those that they give themselves, so that a force which the model
    cannot follow is not held against them.
    """
    seen = dy * white * jnp.array([1.0, 1.0, 0.0])
    B = jnp.einsum("iwtc,jwtc->wij", seen, seen) + _OWN_PRIOR
    cross = jnp.einsum("iwtc,wtc->wi", seen, residual * white)
    by_themselves = jnp.linalg.solve(B, -cross[..., None])[..., 0]
    own = residual + jnp.einsum("iwtc,wi->wtc", dy, by_themselves)
    left = residual + jnp.einsum("iwtc,wi->wtc", dy, start)
    return jnp.concatenate([own[..., :2], left[..., 2:]], axis=-1)


def leftover(
    model: Model, values: Array, batch: Batch, simulate: bool
) -> tuple[Array, Array]:
    """Measured minus replayed, [W, T, 3], SI, and the initial pressures' error [W, 2].

    Each window's own initial pressures are estimated from it.
    """
    n = len(model.names)
    none = Basis(jnp.zeros((model.hydraulic, 0)), jnp.zeros((n - model.hydraulic, 0)))
    return _of_windows(model, values, none, batch, simulate, _leftover_of)


def _leftover_of(batch: Batch, y: Array, dy: Array) -> tuple[Array, Array]:
    seen = jnp.isfinite(batch.noise)
    white = jnp.where(seen, 1 / jnp.where(seen, batch.noise, 1.0), 0.0)
    residual = jnp.where(seen, batch.windows.measured - y, 0.0)
    scaled = dy * white
    B = jnp.einsum("iwtc,jwtc->wij", scaled, scaled) + _OWN_PRIOR
    cross = jnp.einsum("iwtc,wtc->wi", scaled, -residual * white)
    start = jnp.linalg.solve(B, cross[..., None])[..., 0]
    return _leftover(residual, dy, white, start), start[:, :2]
