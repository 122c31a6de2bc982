"""The fit with a candidate free: from where its score points, and from elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from hydrojax.identify.estimation.fit import (
    FitPoint,
    fit_jointly,
    fit_pressures,
    reweighted,
)
from hydrojax.identify.estimation.problem import Problem
from hydrojax.identify.estimation.starts import placed, stuck
from hydrojax.identify.tracing.judge import cost
from hydrojax.identify.tracing.score import Score
from hydrojax.identify.tracing.screen import scores_of
from hydrojax.identify.tracing.state import Tracing, free_names, strengths
from hydrojax.plant.effect import Effect

FRICTION = ("velocity", "level", "friction", "switch", "hysteresis")
"""Places of effects for which friction's own parameters can compensate."""


def refit(
    state: Tracing, effect: Effect, s: Score, noise: Float[np.ndarray, "3"]
) -> tuple[Problem, FitPoint]:
    """Fit again with the effect free, from part of the step that its score predicts;
    and, as long as that leaves something or ends at an end of the effect's ranges, from
    where else it may lie.
    """
    problem, at_noise = state.problem, state.criteria.at_noise
    added = free_names(effect)
    free = (*state.free, *added)
    seen, own = np.isfinite(noise), state.fitted_noise(noise)

    def one(values: np.ndarray) -> tuple[Problem, FitPoint, np.ndarray]:
        done, point = fit_from(state, values, free, noise)
        return done, point, done.errors_at(point.values)

    part = state.criteria.first_step
    near = _stepped(problem, state.point.values, effect, s, part)
    starts = _elsewhere(state, effect, s, near, noise)
    best = one(next(starts))
    while np.any((problem.rms(best[2]) > at_noise * own)[seen]) or stuck(
        problem, best[1].values, added
    ):
        start = next(starts, None)
        if start is None:
            break
        other = one(start)
        if s.far and cost(other[2], own) > 0.99 * cost(best[2], own):
            break  # a start that was searched for is not likely to be outdone
        best = min(best, other, key=lambda f: cost(f[2], own))
    return best[:2]


def fit_from(
    state: Tracing,
    values: Float[np.ndarray, "n"],
    free: tuple[str, ...],
    noise: Float[np.ndarray, "3"],
) -> tuple[Problem, FitPoint]:
    """Fit what is free from `values`: on the pressures alone where no more is seen, and
    there no further than tells one effect from another.
    """
    if np.isfinite(noise[2]):
        return fit_jointly(state.problem, values, free, state.point.weights)
    enough = state.criteria.enough_in_search
    done, values = fit_pressures(state.problem, values, free, enough)
    # As what is left earns them now: by weights of a model that lacked more, what is
    # still missing would seem too small to matter.
    above = state.criteria.reweighted_above
    rms = done.rms(done.errors_at(values))
    earned = reweighted(state.fitted_noise(noise), rms, above)
    weights = np.where(np.isfinite(noise), earned, state.point.weights)
    return done, replace(state.point, values=values, weights=weights)


def _elsewhere(
    state: Tracing, effect: Effect, s: Score, near: np.ndarray, noise: np.ndarray
) -> Iterator[np.ndarray]:
    """Values from which to fit an effect, found as they are asked for."""
    problem, here = state.problem, state.point.values
    yield from (*s.starts[:1], near)[:: 1 if s.far else -1]
    yield from s.starts[1:]
    if effect.place in ("sensor_P", "sensor_F"):
        return
    for back in _brought_back(problem, here, state.free, effect.place in FRICTION):
        # What the score predicts from there is another step, often of another sign.
        there = replace(state, point=replace(state.point, values=back))
        other = scores_of(there, {effect.name: effect}, noise)[effect.name]
        yield _stepped(problem, back, effect, other, state.criteria.first_step)


def _stepped(
    problem: Problem, values: np.ndarray, effect: Effect, s: Score, part: float
) -> np.ndarray:
    """The values with a part of the step of an effect's score, at the shape scored."""
    names = problem.model.names
    steps = {
        n: part * step * problem.model.scale[names.index(n)]
        for n, step in zip(strengths(effect), s.step, strict=True)
    }
    return placed(problem, values, {**steps, **s.shape})


def _brought_back(
    problem: Problem, values: np.ndarray, free: tuple[str, ...], friction: bool
) -> Iterator[np.ndarray]:
    """The values with mechanical ones back at their start: those at an end of their
    range, if any are, and with `friction` all of them.

    A model that lacks an effect drives its own parameters far off to compensate for it,
    and from there a fit may not find back.
    """
    mechanical = problem.side(free, False)
    at_ends = stuck(problem, values, mechanical)
    for names in filter(None, (at_ends, mechanical if friction else ())):
        yield placed(problem, values, {n: problem.free[n].start for n in names})
