"""The misfit: windows' residuals and sensitivities, summed to small Gram matrices.

Everything that is asked later (a Gauss-Newton step, a covariance, a score, what two
effects have in common) needs only sums of products of the columns. So each window is
reduced to the Gram matrix of [sensitivities, residual], with the window's two initial
pressures eliminated, and the large Jacobian is never stored beyond that.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from hydrojax.identify.estimation.columns import (
    HANDFUL,
    NUISANCE,
    SUPPLY_BLOCKS,
    Basis,
    Batch,
    ParametricRig,
)
from hydrojax.identify.estimation.sensitivity import (
    driven_pressures,
    recall,
    sensitivities,
)
from hydrojax.identify.estimation.solve import Fit, minimise
from hydrojax.parameters import put
from hydrojax.plant.replay import pressures
from hydrojax.programs.compiled import program_of_pytrees

START_SPREAD = 3e5
"""Prior on a window's initial pressure about its first guess, Pa: wide, it only keeps
a chamber that no channel sees in place."""

PIECE = 96
"""Windows whose pressures are run side by side, at most: with 256 a step of a fit takes
40 % longer where windows are short (28 ticks), and as long where they have 250."""


def _own_prior(white: Float[Array, "3"]) -> Float[Array, "unknowns unknowns"]:
    """What is known beforehand of what each window has of its own; `white` [3] is 1
    over the channels' noise, which the first readings have too, or 0.
    """
    wide = 1 / START_SPREAD
    readings = jnp.maximum(white[:2], wide) ** 2
    rest = np.array([wide**2] * 2 + [1.0] * SUPPLY_BLOCKS)
    return jnp.diag(jnp.concatenate([rest, readings, jnp.ones(2)]))


class Sums(NamedTuple):
    """Per window, on W windows and k columns.

    Attributes:
        gram: products of [sensitivities, residual], whitened, with what the window has
            of its own eliminated; no rows where they are summed already.
        start: solution of what was eliminated, of `NUISANCE` unknowns (of the residual,
            with the sign turned).
        sse: squared residuals by channel, SI.
    """

    gram: Float[Array | np.ndarray, "windows rows columns"]
    start: Float[Array | np.ndarray, "windows unknowns columns"]
    sse: Float[Array | np.ndarray, "windows 3"]


def in_pieces(part: Callable, size: int, real: Array | int, *windows: PyTree) -> PyTree:
    """`part` of arrays with the windows first, in pieces of `size`, one after the other
    if they are many: memory then does not grow with the logs' length.

    Only pieces with some of the first `real` windows in them are run, so that one
    program serves batches that fill it by much and by little: rows of the others are 0.
    `part` is given how many of its windows are real, and the windows.
    """
    count = jax.tree.leaves(windows)[0].shape[0]
    if count <= size:
        return part(real, *windows)
    pieces = -(-count // size)

    def cut(a):
        # The last piece is filled with copies of the last window.
        index = np.minimum(np.arange(pieces * size), count - 1)
        return a[index].reshape(pieces, size, *a.shape[1:])

    cuts = jax.tree.map(cut, windows)

    def piece(i):
        left = jnp.clip(real - i * size, 0, size)
        return part(left, *jax.tree.map(lambda a: a[i], cuts))

    def put_in(i, out):
        return jax.tree.map(lambda a, b: a.at[i].set(b), out, piece(i))

    none = jax.tree.map(
        lambda a: jnp.zeros((pieces, *a.shape), a.dtype), jax.eval_shape(piece, 0)
    )
    out = jax.lax.fori_loop(0, -(-real // size), put_in, none)
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:])[:count], out)


def _of_windows(
    model: ParametricRig,
    values: Array,
    directions: Basis,
    batch: Batch,
    simulate: bool,
    reduce: Callable[[Batch, Array, Array], PyTree],
) -> PyTree:
    """`reduce` of a batch, its predictions and their derivatives, window by window."""
    recalled = recall(model, values, directions, batch.motion)

    def side_by_side(real, windows, P_0, weight):
        own = batch._replace(windows=windows, P_0=P_0, weight=weight)
        pressure = driven_pressures(model, values, directions, own, simulate)
        # Windows first, as all that is cut into handfuls has them.
        by = jax.tree.map(lambda a: jnp.moveaxis(a, 0, 1), pressure.by)

        def handful(_, windows, P_0, weight, P, by):
            few = batch._replace(windows=windows, P_0=P_0, weight=weight)
            by = jax.tree.map(lambda a: jnp.moveaxis(a, 1, 0), by)
            own = pressure._replace(P=P, by=by)
            y, dy = sensitivities(model, values, directions, windows, own, recalled)
            return reduce(few, y, dy)

        return in_pieces(handful, HANDFUL, real, windows, P_0, weight, pressure.P, by)

    real = jnp.sum(batch.weight > 0)  # what only fills a batch up stands at its end
    return in_pieces(side_by_side, PIECE, real, batch.windows, batch.P_0, batch.weight)


def sums(
    model: ParametricRig,
    values: Float[Array, "n"],
    directions: Basis,
    batch: Batch,
    simulate: bool,
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
    start = jnp.linalg.solve(full[:, own, own] + _own_prior(white), cross)
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
    B = jnp.einsum("iwtc,jwtc->wij", seen, seen) + _own_prior(white)
    cross = jnp.einsum("iwtc,wtc->wi", seen, residual * white)
    by_themselves = jnp.linalg.solve(B, -cross[..., None])[..., 0]
    own = residual + jnp.einsum("iwtc,wi->wtc", dy, by_themselves)
    left = residual + jnp.einsum("iwtc,wi->wtc", dy, start)
    return jnp.concatenate([own[..., :2], left[..., 2:]], axis=-1)


def leftover(
    model: ParametricRig, values: Float[Array, "n"], batch: Batch, simulate: bool
) -> tuple[Float[Array, "windows ticks 3"], Float[Array, "windows 2"]]:
    """Measured minus replayed, SI, and the error of the initial pressures, Pa.

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
    B = jnp.einsum("iwtc,jwtc->wij", scaled, scaled) + _own_prior(white)
    cross = jnp.einsum("iwtc,wtc->wi", scaled, -residual * white)
    start = jnp.linalg.solve(B, cross[..., None])[..., 0]
    return _leftover(residual, dy, white, start), start[:, :2]


def _gram(
    model: ParametricRig,
    values: Array,
    directions: Basis,
    prior: tuple[Array, Array],
    batch: Batch,
    simulate: bool,
    d: Array,
) -> tuple[Array, Sums]:
    """Gram matrix at `values` moved by `d` along the directions, with priors; and the
    sums there, without the matrices of the single windows.
    """
    k_1 = directions.hydraulic.shape[1]
    move = jnp.concatenate([directions.hydraulic @ d[:k_1], directions.other @ d[k_1:]])
    at = sums(model, values + move, directions, batch, simulate)
    total = jnp.sum(at.gram, 0)
    slope, at_zero = prior  # what is known beforehand is more residual rows
    rows = jnp.concatenate([slope, (slope @ d + at_zero)[:, None]], axis=1)
    return total + rows.T @ rows, at._replace(gram=at.gram[:, :0])


@program_of_pytrees
def run_fit(
    model: ParametricRig,
    values: Float[Array, "n"],
    directions: Basis,
    prior: tuple[Float[Array, "rows k"], Float[Array, "rows"]],
    lower: Float[Array, "k"],
    upper: Float[Array, "k"],
    batch: Batch,
    simulate: bool,
) -> Fit:
    """The best fit from `values`, in units of the directions; compiled.

    `prior` are residual rows of what is known beforehand: their derivative by the
    coordinates, and their value at `values`.
    """
    gram = partial(_gram, model, values, directions, prior, batch, simulate)
    return minimise(gram, jnp.zeros_like(lower), lower, upper)


@program_of_pytrees
def run_sums(
    model: ParametricRig,
    values: Float[Array, "n"],
    directions: Basis,
    batch: Batch,
    simulate: bool,
) -> Sums:
    """`sums`, compiled."""
    return sums(model, values, directions, batch, simulate)


@program_of_pytrees
def run_leftover(
    model: ParametricRig, values: Float[Array, "n"], batch: Batch, simulate: bool
) -> tuple[Float[Array, "windows ticks 3"], Float[Array, "windows 2"]]:
    """`leftover`, compiled."""
    return leftover(model, values, batch, simulate)


@program_of_pytrees
def run_pressures(
    model: ParametricRig, values: Float[Array, "n"], batch: Batch
) -> tuple[Float[Array, "windows n"], Float[Array, "windows n"]]:
    """Both pressures of the windows as the model has them, Pa; compiled."""
    rig = put(model.rig, model.names, values)
    return pressures(rig, batch.windows, jnp.asarray(batch.P_0))


@program_of_pytrees
def run_starts(
    model: ParametricRig,
    values: Float[Array, "n"],
    starts: Float[Array, "starts k"],
    directions: Basis,
    lower: Float[Array, "k"],
    upper: Float[Array, "k"],
    batch: Batch,
    simulate: bool,
) -> Fit:
    """Fits from several starts at once, vmapped; in units of the directions."""
    none = (jnp.zeros((0, lower.size)), jnp.zeros(0))

    def one(start):
        gram = partial(_gram, model, values, directions, none, batch, simulate)
        return minimise(gram, start, lower, upper)

    return jax.vmap(one)(starts)
