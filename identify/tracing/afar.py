"""Effects far from where they are absent: a scan of their whole range on a few windows.

A delay longer than the command's own period, a play wider than its swing: what these
do is not predicted by their derivative at zero, along which a fit goes the wrong way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from hydrojax.identify.estimation.columns import Batch, basis, slot_names
from hydrojax.identify.estimation.problem import Problem
from hydrojax.identify.estimation.starts import thinned
from hydrojax.identify.tracing.score import Score
from hydrojax.identify.tracing.state import Tracing, free_names, placed
from hydrojax.parameters import specs
from hydrojax.plant.effect import Effect

Values = Float[np.ndarray, "n"]


class _Local(NamedTuple):
    """Chi-square on a few windows about some values, along what is free.

    Attributes:
        values: of all parameters.
        where: places of what is free among them.
        gram: of [sensitivities, residual], priors among its rows.
        left: chi-square where a linear step would end.
    """

    values: Values
    where: np.ndarray
    gram: np.ndarray
    left: float


def from_afar(
    state: Tracing,
    scores: Mapping[str, Score],
    effects: Mapping[str, Effect],
    noise: Float[np.ndarray, "3"],
) -> dict[str, tuple[float, tuple[Values, ...]]]:
    """What effects would gain that are put in with the strengths of their grids.

    Each value of a grid is put in on a few windows, with the rig's own parameters back
    at their starts (a model that lacks an effect drives them far off), and rated by the
    chi-square that a linear step of all that is free leaves. From the best minima along
    the grids a few steps of a fit follow on these windows. Nothing is asked where
    nothing stands above the noise, or where a candidate's score at zero accounts for
    all of it.

    Returns:
        By effect the gain, in units of its score's, and where it may be fitted from,
        the best first.
    """
    grids = {n: starts for n, e in effects.items() if (starts := nonlocal_starts(e))}
    if not grids or _accounted(state, scores, noise):
        return {}
    own, problem = state.criteria, state.problem
    weights = np.where(np.isfinite(noise), state.point.weights, np.inf)
    few = thinned(problem.batch, own.start_windows)._replace(noise=weights)
    whole = next(iter(scores.values())).left
    here = _local(problem, few, state.point.values, state.free).left
    added = {n for a in state.added for n in free_names(state.effects[a.name])}
    back = {n: problem.free[n].start for n in state.free if n not in added}
    start = placed(problem, state.point.values, back)
    found = []
    for name, grid in grids.items():
        free = (*state.free, *free_names(effects[name]))
        at = [_local(problem, few, placed(problem, start, far), free) for far in grid]
        left = np.array([a.left for a in at])
        around = np.r_[np.inf, left, np.inf]
        (low,) = np.nonzero((left <= around[:-2]) & (left <= around[2:]))
        best = sorted(low, key=lambda i: left[i])[: own.far_starts]
        found += [(left[i], name, at[i], free) for i in best]
    out: dict[str, list[tuple[float, Values]]] = {}
    found.sort(key=lambda f: f[0])
    for _, name, at, free in found[: own.far_fits]:
        done = _descend(problem, few, at, free, own.far_steps)
        out.setdefault(name, []).append(done)
    return {
        name: (
            float(whole * (1 - min(f[0] for f in fits) / here)),
            tuple(values for _, values in sorted(fits, key=lambda f: f[0])),
        )
        for name, fits in out.items()
    }


def _accounted(state: Tracing, scores: Mapping[str, Score], noise: np.ndarray) -> bool:
    """Whether nothing is left, or would be by the score of one candidate at zero."""
    seen, weights = np.isfinite(noise), state.point.weights
    rms = state.problem.rms(state.problem.errors_at(state.point.values))
    # What is far from zero shows: half way to what counts as above the noise.
    if not np.any((rms > (1 + state.criteria.at_noise) / 2 * noise)[seen]):
        return True
    windows, ticks, _ = state.problem.batch.windows.measured.shape
    floor = windows * ticks * float(np.sum((noise[seen] / weights[seen]) ** 2))
    left = next(iter(scores.values())).left
    above = (state.criteria.at_noise**2 - 1) * floor
    above = min(above, state.criteria.fair_share * max(left - floor, 0.0))
    return left - max(s.gain for s in scores.values()) <= floor + above


def _local(problem: Problem, few: Batch, values: Values, free: Sequence[str]) -> _Local:
    model, slots = problem.model, problem.slots(free)
    columns = slot_names(model, tuple(free), slots)
    keep, names = zip(*[(i, n) for i, n in enumerate(columns) if n], strict=True)
    index = np.array([model.names.index(n) for n in names])
    gram = problem.evaluate(values, basis(model, tuple(free), slots), few).gram
    gram = np.sum(gram, axis=0)[np.ix_([*keep, -1], [*keep, -1])]
    for i, f in enumerate(problem.free[n] for n in names):
        if f.prior:
            row = (
                model.scale[index[i]] / f.prior,
                (values[index[i]] - f.start) / f.prior,
            )
            at = np.ix_([i, -1], [i, -1])
            gram[at] += np.outer(row, row)
    move = _move(problem, values, index, gram, 1e-6)
    full = np.append(move, 1.0)
    return _Local(values, index, gram, float(full @ gram @ full))


def _move(
    problem: Problem,
    values: Values,
    index: np.ndarray,
    gram: np.ndarray,
    damping: float,
) -> Float[np.ndarray, "free"]:
    """The damped step to the least chi-square inside the ranges, in scales."""
    k, names = len(index), problem.model.names
    scale = problem.model.scale[index]
    ends = np.array(
        [(problem.free[names[i]].lower, problem.free[names[i]].upper) for i in index]
    )
    box = (ends - values[index, None]) / scale[:, None]
    size = np.sqrt(np.maximum(np.diag(gram)[:k], 1e-12 * np.max(np.diag(gram)[:k])))
    H = gram[:k, :k] / np.outer(size, size) + damping * np.eye(k)
    R = np.linalg.cholesky(H + 1e-9 * np.eye(k)).T
    aim = np.linalg.solve(R.T, -gram[:k, -1] / size)
    low, high = (box * size[:, None]).T
    ends = np.minimum(low, -1e-9), np.maximum(high, 1e-9)
    return lsq_linear(R, aim, ends, method="bvls").x / size


def _descend(
    problem: Problem, few: Batch, at: _Local, free: Sequence[str], steps: int
) -> tuple[float, Values]:
    """Chi-square after a few damped steps of a fit on these windows, and the values."""
    damping, names = 1e-3, problem.model.names
    for _ in range(steps):
        move = _move(problem, at.values, at.where, at.gram, damping)
        moved = at.values[at.where] + move * problem.model.scale[at.where]
        given = {names[i]: v for i, v in zip(at.where, moved, strict=True)}
        there = _local(problem, few, placed(problem, at.values, given), free)
        if there.gram[-1, -1] < at.gram[-1, -1]:
            settled = there.gram[-1, -1] > 0.99 * at.gram[-1, -1]
            at, damping = there, damping / 10
            if settled:
                break
        else:
            damping *= 100
    return float(at.gram[-1, -1]), at.values


def nonlocal_starts(effect: Effect) -> list[dict[str, float]]:
    """Strengths at which an effect is tried as it stands, along its grid: what it does
    there is not predicted by its derivative at zero.
    """
    grids = {
        f"{effect.name}.{f}": s.grid for f, s in specs(effect).items() if s.strength
    }
    length = max((len(g) for g in grids.values()), default=0)
    return [{n: g[i] for n, g in grids.items() if i < len(g)} for i in range(length)]
