"""Every candidate's score at the present fit: at zero strength, each at its best shape,
and at a given strength where its derivative at zero does not predict it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from hydrojax.identify.estimation.problem import Problem
from hydrojax.identify.tracing.afar import from_afar
from hydrojax.identify.tracing.score import Projection, Score, score
from hydrojax.identify.tracing.state import Tracing, strengths
from hydrojax.parameters import specs
from hydrojax.plant.effect import Effect


def size_that_matters(state: Tracing, noise: Float[np.ndarray, "3"]) -> float:
    """Chi-square of an RMS error that grows by `matters` of one channel's noise.

    In the channels' present weights, and of the channel where it is least.
    """
    windows, ticks, _ = state.problem.batch.windows.measured.shape
    seen, own = np.isfinite(noise), state.fitted_noise(noise)
    grown = 1 + state.criteria.matters * own[seen] / state.point.weights[seen]
    return float(np.min(grown**2 - 1)) * windows * ticks


def scores_of(
    state: Tracing, effects: Mapping[str, Effect], noise: Float[np.ndarray, "3"]
) -> dict[str, Score]:
    """Every candidate's score at the present fit, each at its best shape."""
    weights = np.where(np.isfinite(noise), state.point.weights, np.inf)
    matters = size_that_matters(state, noise)
    grids = [
        len(s.grid)
        for e in effects.values()
        for s in specs(e).values()
        if not s.strength
    ]
    best: dict[str, Score] = {}

    # Those of the first values last: they are kept, and asked for where a search ends.
    for g in reversed(range(max([1, *grids]))):
        values, shapes = _shaped(state, effects, g)
        here = effects if g == 0 else {n: effects[n] for n in shapes}
        names, projection = projected(state, here, values, weights)
        for name, effect in here.items():
            own = strength_columns(names, effect)
            s = score(projection, name, *own, matters, state.criteria.level)
            if name not in best or s.gain >= best[name].gain:
                best[name] = replace(s, shape=shapes.get(name, {}))
    for name, (gain, starts) in from_afar(state, best, effects, noise).items():
        far = gain > best[name].gain
        gain = max(gain, best[name].gain)
        best[name] = replace(best[name], gain=gain, starts=starts, far=far)
    return best


def projected(
    state: Tracing,
    effects: Mapping[str, Effect],
    values: Float[np.ndarray, "n"],
    weights: Float[np.ndarray, "3"],
) -> tuple[Sequence[str | None], Projection]:
    """The sums at `values` with the effects' columns beside the fitted ones, which are
    projected out, and what each column stands for.
    """
    problem = state.problem
    along = (*state.free, *(n for e in effects.values() for n in strengths(e)))
    # Another program than the fit's takes longer to compile than it saves.
    if problem.fits_alike(values, along, state.free):
        names, sums = problem.sums_along(values, along, weights)
    else:
        names, sums = problem.model.names, problem.sums_at(values, weights)
    free = [names.index(n) for n in state.free]
    prior = _known(problem, names, state.free)
    return names, Projection(np.array(sums.gram), free, prior)


def strength_columns(
    names: Sequence[str | None], effect: Effect
) -> tuple[list[int], Float[np.ndarray, "columns 2"]]:
    """The columns of an effect's strengths, and the ends of their ranges in units of
    these.
    """
    ends = [
        (s.lower / s.scale, s.upper / s.scale)
        for s in specs(effect).values()
        if s.strength
    ]
    return [names.index(n) for n in strengths(effect)], np.array(ends)


def _known(
    problem: Problem, names: Sequence[str | None], free: Sequence[str]
) -> Float[np.ndarray, "columns"]:
    """What is known beforehand of the free columns, as rows' slopes; 0 of others."""
    out, own = np.zeros(len(names)), problem.model
    for name in free:
        known = problem.free[name].prior
        scale = own.scale[own.names.index(name)]
        out[names.index(name)] = scale / known if known else 0.0
    return out


def _shaped(
    state: Tracing, effects: Mapping[str, Effect], g: int
) -> tuple[np.ndarray, dict[str, dict[str, float]]]:
    """The present values with shapes at their g-th grid value, and those shapes."""
    values = state.point.values.copy()
    names = state.problem.model.names
    shapes: dict[str, dict[str, float]] = {}
    for name, effect in effects.items():
        for f, s in specs(effect).items():
            if not s.strength and g < len(s.grid):
                values[names.index(f"{name}.{f}")] = s.grid[g]
                shapes.setdefault(name, {})[f"{name}.{f}"] = s.grid[g]
    return values, shapes
