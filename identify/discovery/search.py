"""The search for curves: scores of all terms, refits of the best, validation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from scipy import stats

from hydrojax.identify.discovery.free_form import (
    FORMS,
    coefficients,
)
from hydrojax.identify.discovery.laid import Laid, with_laid
from hydrojax.identify.discovery.smooth import Columns, Smooth, directions, smoothed
from hydrojax.identify.estimation.fit import fit_jointly, fit_pressures, only
from hydrojax.identify.estimation.known import Known
from hydrojax.identify.estimation.problem import PRESSURES, Problem
from hydrojax.identify.tracing.judge import chance, cost, judge, may_rise, worse
from hydrojax.identify.tracing.score import (
    Projection,
    Score,
    family,
    worth_a_refit,
)
from hydrojax.identify.tracing.screen import size_that_matters
from hydrojax.identify.tracing.state import Tracing
from hydrojax.plant.places import PLACES


@dataclass(frozen=True)
class Curve:
    """A curve that was kept: how smooth it is, and how validation errors fell.

    `before` and `after` are squared errors by window and channel; `alike` the terms
    that did as well.
    """

    laid: Laid
    smooth: Smooth
    p_value: float
    before: Float[np.ndarray, "windows 3"]
    after: Float[np.ndarray, "windows 3"]
    alike: tuple[str, ...] = ()


@dataclass(frozen=True)
class Search:
    """Where a search stands: the fit, the curves in it, and, where it has ended, the
    sums of their columns by name.
    """

    state: Tracing
    curves: tuple[Curve, ...] = ()
    columns: Mapping[str, Columns] = field(default_factory=dict)

    @property
    def taken(self) -> set[str]:
        """Places that have a curve."""
        return {c.laid.term.place for c in self.curves}


def search(begun: Search, every: Sequence[Laid]) -> Search:
    """Look for curves until none is left that matters: pressures first, then all."""
    state = begun.state
    if state.problem.sees_pressures:
        upstream = [one for one in every if PLACES[one.term.place].hydraulic]
        begun = _stage(begun, upstream, only(state.noise, PRESSURES))
    if np.isfinite(state.noise[2]):
        if begun.curves:
            begun = refitted(begun, state.noise)
        begun = _stage(begun, every, state.noise)
    state = begun.state
    weights = np.where(np.isfinite(state.noise), state.point.weights, np.inf)
    laid = [curve.laid for curve in begun.curves]
    columns = columns_of(begun, laid, weights) if laid else {}
    return replace(begun, columns=columns)


def _stage(at: Search, every: Sequence[Laid], noise: np.ndarray) -> Search:
    for _ in range(at.state.criteria.rounds):
        if at_noise(at.state, noise):
            return at
        rest = [one for one in every if one.term.place not in at.taken]
        if not rest:
            return at
        more = _round(at, rest, noise)
        if more is at:
            return at
        at = more
    return at


def at_noise(state: Tracing, noise: Float[np.ndarray, "3"]) -> bool:
    """Whether no channel stands above its noise, so that nothing is left to explain."""
    rms = state.check.rms(state.check.errors_at(state.point.values))
    return bool(np.all((rms <= state.criteria.at_noise * noise)[np.isfinite(noise)]))


def above_noise(state: Tracing, inflation: float, chances: float = 1.0) -> float:
    """Chi-square, in the present weights, that is left above the noise: that of the
    validation errors, over as many rows as are fitted, and `chances` standard
    deviations of its chance: with one, what may lie unseen under it counts.

    `inflation` is the variance of the scores over that of white residuals.
    """
    seen = np.isfinite(state.noise)
    rms = state.check.rms(state.check.errors_at(state.point.values))[seen]
    noise, weights = state.noise[seen], state.point.weights[seen]
    batch = state.problem.batch
    rows = float(np.sum(batch.weight)) * batch.windows.measured.shape[1]
    over = np.maximum(rms**2 - noise**2, 0.0) / weights**2
    spread = np.sum((noise / weights) ** 4)
    chance = np.sqrt(2 * rows * inflation * spread)
    return max(float(rows * np.sum(over) + chances * chance), 0.0)


def columns_of(
    at: Search, laid: Sequence[Laid], weights: Float[np.ndarray, "3"]
) -> dict[str, Columns]:
    """The sums of terms at the present fit, by name, at most one for each place."""
    state = with_terms(at.state, laid)
    problem = state.problem
    names, values = list(problem.model.names), state.point.values
    gram = np.array(problem.sums_at(values, weights).gram)
    out = {}
    for one in laid:
        own = coefficients(one.effect)
        fitted = [names.index(n) for n in state.free if n not in own]
        # The penalties of what is fitted already are one more window's sums.
        known = known_of(problem, at.curves, [names[i] for i in fitted])
        index = [names.index(n) for n in known.names]
        scale = problem.model.scale[index]
        own_gram = np.zeros((1, *gram.shape[1:]))
        own_gram[0][np.ix_(index, index)] = known.curvature
        away = known.curvature @ ((values[index] - known.values) / scale)
        own_gram[0, index, -1] = own_gram[0, -1, index] = away
        every = np.concatenate([gram, own_gram])
        projection = Projection(every, fitted, np.zeros(len(names)))
        columns = [names.index(n) for n in own]
        out[one.term.name] = Columns.of(projection, columns, values[columns])
    return out


def with_terms(state: Tracing, laid: Sequence[Laid]) -> Tracing:
    """The state with terms in the places of the free forms."""
    effects = [one.effect for one in laid]
    return replace(
        state,
        problem=with_laid(state.problem, effects),
        check=with_laid(state.check, effects),
    )


def known_of(problem: Problem, curves: Sequence[Curve], names: Sequence[str]) -> Known:
    """Priors of the parameters among `names`, and the curves' smoothing, as one."""
    model, held, values, blocks = problem.model, [], [], []
    for name in names:
        f = problem.free[name]
        if f.prior and not any(name in coefficients(c.laid.effect) for c in curves):
            held.append(name)
            values.append(f.start)
            blocks.append((model.scale[model.names.index(name)] / f.prior) ** 2)
    curvature = np.diag(np.array(blocks, float))
    for c in curves:
        own = coefficients(c.laid.effect)
        if set(own) <= set(names):
            k, n = len(own), len(held)
            held, values = [*held, *own], [*values, *[0.0] * k]
            curvature = np.block(
                [[curvature, np.zeros((n, k))], [np.zeros((k, n)), c.smooth.penalty]]
            )
    return Known(tuple(held), np.array(values), curvature)


def _score(name: str, columns: Columns, smooth: Smooth) -> Score:
    """The test of a term, in the directions that are its own."""
    own = directions(columns.H, columns.whole)
    by_window = columns.by_window @ own
    none = Score(name, 0.0, smooth.c, 1.0, 0.0, columns.left, 0.0)
    if not own.shape[1]:
        return none
    g = by_window.sum(axis=0)
    spread = by_window.T @ by_window
    spread = spread + np.diag(1e-9 * np.diag(spread) + 1e-300)
    p = float(stats.chi2.sf(g @ np.linalg.solve(spread, g), own.shape[1]))
    return replace(none, gain=smooth.gain, p_value=p, by_window=by_window)


def scored(
    at: Search, every: Sequence[Laid], noise: Float[np.ndarray, "3"]
) -> tuple[dict[str, Score], dict[str, Smooth]]:
    """Every term's score and smoothing at the present fit."""
    weights = np.where(np.isfinite(noise), at.state.point.weights, np.inf)
    by_place = [[one for one in every if one.term.form is form] for form in FORMS]
    scores, curves = {}, {}
    for turn in range(max(map(len, by_place))):
        laid = [own[turn] for own in by_place if turn < len(own)]
        for name, columns in columns_of(at, laid, weights).items():
            curves[name] = smoothed(columns)
            scores[name] = _score(name, columns, curves[name])
    return scores, curves


def _round(at: Search, every: Sequence[Laid], noise: np.ndarray) -> Search:
    """Refit the best few terms, and keep the one that helps most, if one does."""
    state, criteria = at.state, at.state.criteria
    state.progress(f"scores of {len(every)} curves")
    scores, smooth = scored(at, every, noise)
    p = family(scores, criteria)
    least = criteria.smallest_gain * size_that_matters(state, noise)
    by_name = {one.term.name: one for one in every}
    order = sorted(scores.values(), key=lambda s: -s.gain)
    worth = [
        s for s in order if s.gain > least and worth_a_refit(p[s.name], s, criteria)
    ]
    before = state.check.errors_at(state.point.values)
    helped = []
    for s in worth[: criteria.tries]:
        if helped and s.gain < criteria.rival * worth[0].gain:
            break
        state.progress(f"refit with a curve: {s.name}")
        one = by_name[s.name]
        there = fitted(at, one, smooth[s.name], p[s.name], before, noise)
        by = may_rise(there.state, [one.effect], noise)
        verdict = judge(there.state, before, there.curves[-1].after, noise, by)
        state.progress(f"{s.name}: {verdict}")
        if verdict == "helps":
            helped.append(there)
    if not helped:
        return at
    helped.sort(key=lambda h: cost(h.curves[-1].after, noise))
    best, *others = helped
    alike = tuple(
        h.curves[-1].laid.term.name
        for h in others
        if not worse(h.curves[-1].after, best.curves[-1].after, noise,
                     criteria.worse_by)
    )  # fmt: skip
    found = best.curves[-1]
    p_value = min(found.p_value, len(scores) * chance(before, found.after, noise))
    curves = (*best.curves[:-1], replace(found, alike=alike, p_value=p_value))
    state.progress(f"kept {curves[-1].laid.term.name}")
    return replace(best, curves=curves)


def fitted(
    at: Search,
    one: Laid,
    smooth: Smooth,
    p_value: float,
    before: Float[np.ndarray, "windows 3"],
    noise: Float[np.ndarray, "3"],
) -> Search:
    """The search with one more curve, fitted with all that is free; its smoothing is
    found again where the fit ends, and the fit goes on from there.
    """
    state = with_terms(at.state, [one])
    own = coefficients(one.effect)
    names = state.problem.model.names
    index = [names.index(n) for n in own]
    values = state.point.values.copy()
    values[index] = smooth.c
    free = (*state.free, *own)
    state = replace(state, free=free, point=replace(state.point, values=values))
    curve = Curve(one, smooth, p_value, before, before)
    there = Search(state, (*at.curves, curve))
    for again in (True, False):
        there = refitted(there, noise)
        if again:
            weights = np.where(np.isfinite(noise), there.state.point.weights, np.inf)
            columns = columns_of(there, [one], weights)[one.term.name]
            curve = replace(curve, smooth=smoothed(columns))
            there = replace(there, curves=(*at.curves, curve))
    state = there.state
    after = state.check.errors_at(state.point.values)
    curve = replace(curve, after=after)
    return replace(there, curves=(*at.curves, curve))


def refitted(at: Search, noise: Float[np.ndarray, "3"]) -> Search:
    """The fit of all that is free, on the pressures alone where no more is seen."""
    state, problem = at.state, at.state.problem
    sides = (len(problem.side(state.free, hydraulic)) for hydraulic in (True, False))
    problem = replace(problem, declared=tuple(sides))
    if np.isfinite(noise[2]):
        known = known_of(problem, at.curves, state.free)
        problem, point = fit_jointly(
            replace(problem, known=known),
            state.point.values,
            state.free,
            state.point.weights,
        )
    else:
        seen = problem.side(state.free, True)
        known = known_of(problem, at.curves, seen)
        problem, values = fit_pressures(
            replace(problem, known=known), state.point.values, state.free
        )
        point = replace(state.point, values=values)
    problem = replace(problem, known=None)
    return replace(at, state=replace(state, problem=problem, point=point))
