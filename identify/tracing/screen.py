"""Every candidate's score at the present fit: at zero strength, each at its best shape,
and at a given strength where its derivative at zero does not predict it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

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
    seen = np.isfinite(noise)
    grown = 1 + state.criteria.matters * noise[seen] / state.point.weights[seen]
    return float(np.min(grown**2 - 1)) * windows * ticks


def scores_of(
    state: Tracing, effects: Mapping[str, Effect], noise: Float[np.ndarray, "3"]
) -> dict[str, Score]:
    """Every candidate's score at the present fit, each at its best shape."""
    names = list(state.problem.model.names)
    weights = np.where(np.isfinite(noise), state.point.weights, np.inf)
    matters = size_that_matters(state, noise)
    free = [names.index(n) for n in state.free]
    prior = np.zeros(len(names))
    for i in free:
        known = state.problem.free[names[i]].prior
        prior[i] = state.problem.model.scale[i] / known if known else 0.0
    grids = [
        len(s.grid)
        for e in effects.values()
        for s in specs(e).values()
        if not s.strength
    ]
    best: dict[str, Score] = {}

    def projected(values: np.ndarray, fitted: Sequence[int]) -> Projection:
        gram = np.array(state.problem.sums_at(values, weights).gram)
        return Projection(gram, fitted, prior)

    for g in range(max([1, *grids])):
        values, shapes = _shaped(state, effects, g)
        projection = projected(values, free)
        for name, effect in effects.items():
            if g > 0 and name not in shapes:
                continue
            columns = [names.index(n) for n in strengths(effect)]
            ends = np.array(
                [
                    (s.lower / s.scale, s.upper / s.scale)
                    for s in specs(effect).values()
                    if s.strength
                ]
            )
            s = score(projection, name, columns, ends, matters, state.criteria.level)
            if name not in best or s.gain > best[name].gain:
                best[name] = replace(s, shape=shapes.get(name, {}))
    for name, (gain, starts) in from_afar(state, best, effects, noise).items():
        far = gain > best[name].gain
        gain = max(gain, best[name].gain)
        best[name] = replace(best[name], gain=gain, starts=starts, far=far)
    return best


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
