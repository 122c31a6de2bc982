"""The search for curves: scores of all terms, refits of the best, validation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy import stats

from hydrojax.identify.discovery.free_form import (
    FORMS,
    FreeLevel,
)
from hydrojax.identify.discovery.laid import Laid
from hydrojax.identify.discovery.smooth import Columns, Smooth, directions, smoothed
from hydrojax.identify.discovery.with_curves import (
    Search,
    columns_of,
    fitted,
    of_the_level,
    refitted,
    relaid,
    with_errors,
)
from hydrojax.identify.estimation.fit import only
from hydrojax.identify.estimation.problem import PRESSURES
from hydrojax.identify.tracing.judge import chance, cost, judge, may_rise, worse
from hydrojax.identify.tracing.score import (
    Score,
    family,
    worth_a_refit,
)
from hydrojax.identify.tracing.screen import size_that_matters
from hydrojax.identify.tracing.state import Tracing
from hydrojax.plant.places import PLACES

ANEW = (relaid,) * 3
"""How often the knots of a curve are drawn anew, each time from a better fit."""


def search(begun: Search, every: Sequence[Laid]) -> Search:
    """Look for curves until none is left that matters: pressures first, then all."""
    state = begun.state
    if state.problem.sees_pressures:
        upstream = [one for one in every if PLACES[one.term.place].hydraulic]
        begun = _stage(begun, upstream, only(state.noise, PRESSURES))
    if np.isfinite(state.noise[2]):
        if begun.curves:
            # A force shows of an upstream curve what the pressures do not.
            begun = with_errors(refitted(begun, state.noise))
            begun = sharpened(begun, state.noise)
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
        knots = {one.term.name: np.asarray(one.effect.knots) for one in laid}
        for name, columns in columns_of(at, laid, weights).items():
            curves[name] = smoothed(columns, knots[name])
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
        if not worse(h.curves[-1].after, best.curves[-1].after, noise, criteria)
    )
    found = best.curves[-1]
    p_value = min(found.p_value, len(scores) * chance(before, found.after, noise))
    curves = (*best.curves[:-1], replace(found, alike=alike, p_value=p_value))
    state.progress(f"kept {curves[-1].laid.term.name}")
    return sharpened(replace(best, curves=curves), noise)


def sharpened(at: Search, noise: Float[np.ndarray, "3"]) -> Search:
    """The last curve as a share of the Coulomb level, where it is one of that, and over
    other knots: each where that helps and more is left.
    """
    term = at.curves[-1].laid.term
    share = term.form is FreeLevel and not term.factor
    for other in (of_the_level, *ANEW) if share else ANEW:
        if at_noise(at.state, noise):
            break
        there = other(at, noise)
        one, now = at.curves[-1], there.curves[-1]
        by = may_rise(there.state, [now.laid.effect], noise)
        verdict = judge(there.state, one.after, now.after, noise, by)
        at.state.progress(f"{now.laid.term.name} {other.__name__}: {verdict}")
        if verdict == "helps":
            at = there
        elif other is relaid:
            break
    return at
