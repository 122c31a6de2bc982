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
from jaxtyping import Array, Float, PyTree

from hydrojax.identify.estimation.columns import (
    NUISANCE,
    SUPPLY_BLOCKS,
    Basis,
    Batch,
    ParametricRig,
)
from hydrojax.identify.estimation.drive import (
    SpoolPath,
    driven_pressures,
    openings_by,
    rows_of,
)
from hydrojax.identify.estimation.pieces import PIECE, PIECES, Span, in_pieces
from hydrojax.identify.estimation.sensitivity import (
    Recalled,
    memory_along,
    recall,
    recall_along,
    sensitivities,
)
from hydrojax.parameters import put
from hydrojax.plant.replay import (
    Opened,
    Past,
    at_start,
    opened_in,
    pressures_behind,
)
from hydrojax.programs.compiled import program_of_pytrees

START_SPREAD = 3e5
"""Prior on a window's initial pressure about its first guess, Pa: wide, it only keeps
a chamber that no channel sees in place."""

FEW = 8
"""Windows whose columns are summed side by side: they stay in the processor's cache."""

RUNS_AWAY = 1e3
"""Growth of an error of the initial pressures, RMS over a window, from which its
derivatives say nothing of the model, 1. Where a run settles it is 0.1 to 3; along a
limit cycle it grew to 2e10 (machine 06 of `benchmarks.recorded`, runs of 3 s), and
products of such derivatives left no digit of what all other windows say."""


def _of_use(dy: Array) -> Array:
    """Derivatives [k + NUISANCE, W, T, 3]; 0 in windows whose run has run away."""
    start = dy[dy.shape[0] - NUISANCE :][:2, ..., :2]
    grown = jnp.mean(jnp.sum(start**2, axis=(0, 3)), axis=1)
    return jnp.where((grown <= RUNS_AWAY**2)[:, None, None], dy, 0.0)


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
            of its own eliminated.
        start: solution of what was eliminated, of `NUISANCE` unknowns (of the residual,
            with the sign turned).
        sse: squared residuals by channel, SI.
    """

    gram: Float[Array | np.ndarray, "windows rows columns"]
    start: Float[Array | np.ndarray, "windows unknowns columns"]
    sse: Float[Array | np.ndarray, "windows 3"]


def _of_windows(
    model: ParametricRig,
    values: Array,
    directions: Basis,
    batch: Batch,
    recalled: Recalled,
    size: int,
    span: Span,
    reduce: Callable[[Batch, Array, Array], PyTree],
) -> PyTree:
    """`reduce` of a batch, its predictions and their derivatives, window by window."""

    def side_by_side(i, windows, P_0, weight):
        own = batch._replace(windows=windows, P_0=P_0, weight=weight)
        pressure = driven_pressures(model, values, directions, own, recalled.spool)
        # Windows first, as all that is cut into groups has them.
        by = jax.tree.map(lambda a: jnp.moveaxis(a, 0, 1), pressure.by)

        def some(_, windows, P_0, weight, P, by):
            few = batch._replace(windows=windows, P_0=P_0, weight=weight)
            by = jax.tree.map(lambda a: jnp.moveaxis(a, 1, 0), by)
            own = pressure._replace(P=P, by=by)
            y, dy = sensitivities(model, values, directions, windows, own, recalled)
            return reduce(few, y, dy)

        # What only fills a batch up stands at its end.
        real = jnp.clip(jnp.sum(batch.weight > 0) - i * size, 0, len(P_0))
        groups = Span(0, -(-real // FEW))
        each = (windows, P_0, weight, pressure.P, by)
        out = in_pieces(some, FEW, groups, *each, most=len(P_0))
        return jax.tree.map(lambda a: a[: len(P_0)], out)

    return in_pieces(side_by_side, size, span, batch.windows, batch.P_0, batch.weight)


def sums_of_some(
    model: ParametricRig,
    values: Float[Array, "n"],
    directions: Basis,
    batch: Batch,
    recalled: Recalled,
    size: int,
    span: Span,
) -> Sums:
    """The windows' Gram matrices at `values` along `directions`; see `Sums`.

    `recalled` is what all windows have in common at `values`; only the pieces of
    `span`, of `size` windows each, are summed.
    """
    return _of_windows(model, values, directions, batch, recalled, size, span, _sums)


def sums(
    model: ParametricRig,
    values: Float[Array, "n"],
    directions: Basis,
    batch: Batch,
    simulate: bool,
) -> Sums:
    """`sums_of_some` of all windows, and what they have in common with them: to be
    compiled, and differentiated, as a part of more. Where `batch` is filled up its last
    rows are 0.
    """
    along = memory_along(model, directions)
    past = recall(model, values, batch.motion)

    def still() -> Past:
        return jax.tree.map(jnp.zeros_like, past)

    def by(which: int) -> Past:
        def moved() -> Past:
            return recall_along(model, values, which, batch.motion)

        return jax.lax.cond(jnp.any(along[which] != 0), moved, still)

    each = [by(which) for which in range(len(along))]
    stacked, spool = jax.tree.map(lambda *a: jnp.stack(a), *each), None
    if simulate:
        rows = rows_of(model, directions.hydraulic)
        moves = jnp.eye(len(rows))
        spool = SpoolPath(*openings_by(model, values, moves, batch.motion), rows)
    recalled = Recalled(past, stacked, along, spool)
    count = len(batch.P_0)
    size = min(count, max(PIECE, -(-count // PIECES)))
    pieces = (size, Span(0, -(-count // size)))
    out = sums_of_some(model, values, directions, batch, recalled, *pieces)
    return jax.tree.map(lambda a: a[:count], out)


def _sums(batch: Batch, y: Array, dy: Array) -> Sums:
    """Reduce predictions and their derivatives to each window's sums."""
    seen = jnp.isfinite(batch.noise)
    white = jnp.where(seen, 1 / jnp.where(seen, batch.noise, 1.0), 0.0)
    residual = jnp.where(seen, batch.windows.measured - y, 0.0)
    dy = _of_use(dy)
    k = dy.shape[0] - NUISANCE
    stack = jnp.concatenate([-dy, residual[None]]) * white  # [k+NUISANCE+1, W, T, 3]
    stack = jnp.moveaxis(stack, 1, 0).reshape(*residual.shape[:1], len(stack), -1)
    full = jnp.einsum("wit,wjt->wij", stack, stack)
    keep = np.r_[0:k, k + NUISANCE]
    own = slice(k, k + NUISANCE)
    cross = full[:, own, keep]
    start = _solved(full[:, own, own] + _own_prior(white), cross)
    gram = full[:, keep[:, None], keep] - jnp.einsum("wia,wib->wab", cross, start)
    left = _leftover(residual, dy[k:], white, start[:, :, -1])
    weight = batch.weight
    return Sums(
        gram * weight[:, None, None],
        start,
        jnp.sum(left**2, axis=1) * weight[:, None],
    )


def _solved(B: Array, given: Array) -> Array:
    """Solve `B @ x = given` of each window, [W, n, n] positive definite and [W, n, m].

    By elimination along the diagonal, side by side. JAX's own solver hands a stack of
    some size to LAPACK piece by piece, on the threads that run the program itself, and
    waits for them: where both of two cores wait, nothing goes on, for ever.
    """
    n = B.shape[-1]

    def eliminated(i: Array, table: Array) -> Array:
        row = table[:, i] / table[:, i, i, None]
        others = table - table[:, :, i, None] * row[:, None]
        return others.at[:, i].set(row)

    table = jnp.concatenate([B, given], axis=-1)
    return jax.lax.fori_loop(0, n, eliminated, table)[..., n:]


def _leftover(residual: Array, dy: Array, white: Array, start: Array) -> Array:
    """Residuals without what each window has of its own, [W, T, 3], SI.

    The force is judged with the initial state that all channels together give; the
    pressures with those that they give themselves, so that a force which the model
    cannot follow is not held against them.
    """
    seen = dy * white * jnp.array([1.0, 1.0, 0.0])
    B = jnp.einsum("iwtc,jwtc->wij", seen, seen) + _own_prior(white)
    cross = jnp.einsum("iwtc,wtc->wi", seen, residual * white)
    by_themselves = _solved(B, -cross[..., None])[..., 0]
    own = residual + jnp.einsum("iwtc,wi->wtc", dy, by_themselves)
    left = residual + jnp.einsum("iwtc,wi->wtc", dy, start)
    return jnp.concatenate([own[..., :2], left[..., 2:]], axis=-1)


def leftover(
    model: ParametricRig,
    values: Float[Array, "n"],
    batch: Batch,
    recalled: Recalled,
    size: int,
    span: Span,
) -> tuple[Float[Array, "windows ticks 3"], Float[Array, "windows 2"]]:
    """Measured minus replayed, SI, and the error of the initial pressures, Pa.

    Each window's own initial pressures are estimated from it.
    """
    n = len(model.names)
    none = Basis(jnp.zeros((model.hydraulic, 0)), jnp.zeros((n - model.hydraulic, 0)))
    return _of_windows(model, values, none, batch, recalled, size, span, _leftover_of)


def _leftover_of(batch: Batch, y: Array, dy: Array) -> tuple[Array, Array]:
    seen = jnp.isfinite(batch.noise)
    white = jnp.where(seen, 1 / jnp.where(seen, batch.noise, 1.0), 0.0)
    residual = jnp.where(seen, batch.windows.measured - y, 0.0)
    dy = _of_use(dy)
    scaled = dy * white
    B = jnp.einsum("iwtc,jwtc->wij", scaled, scaled) + _own_prior(white)
    cross = jnp.einsum("iwtc,wtc->wi", scaled, -residual * white)
    start = _solved(B, cross[..., None])[..., 0]
    return _leftover(residual, dy, white, start), start[:, :2]


@program_of_pytrees
def run_sums(
    model: ParametricRig,
    values: Float[Array, "n"],
    directions: Basis,
    batch: Batch,
    recalled: Recalled,
    size: int,
    span: Span,
) -> Sums:
    """`sums_of_some`, compiled."""
    return sums_of_some(model, values, directions, batch, recalled, size, span)


@program_of_pytrees
def run_leftover(
    model: ParametricRig,
    values: Float[Array, "n"],
    batch: Batch,
    recalled: Recalled,
    size: int,
    span: Span,
) -> tuple[Float[Array, "windows ticks 3"], Float[Array, "windows 2"]]:
    """`leftover`, compiled."""
    return leftover(model, values, batch, recalled, size, span)


@program_of_pytrees
def run_pressures(
    model: ParametricRig, values: Float[Array, "n"], batch: Batch, opened: Opened
) -> tuple[Float[Array, "windows n"], Float[Array, "windows n"]]:
    """Both pressures of the windows as the model has them, Pa; compiled.

    `opened` is the spool's opening over whole segments.
    """
    rig, w = put(model.rig, model.names, values), batch.windows
    P_0 = at_start(rig, w, jnp.asarray(batch.P_0))
    return pressures_behind(rig, w, P_0, opened_in(rig, opened, w))
