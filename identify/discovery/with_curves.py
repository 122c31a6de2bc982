"""A fit with curves in it: their sums, their smoothing and their knots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline

from hydrojax.effects.splines import DEGREE, bspline
from hydrojax.identify.discovery.free_form import coefficients, share_of_level
from hydrojax.identify.discovery.laid import STRAIGHT, Laid, with_laid
from hydrojax.identify.discovery.smooth import Columns, Smooth, smoothed
from hydrojax.identify.estimation.fit import fit_jointly, fit_pressures
from hydrojax.identify.estimation.known import COULOMB, Known
from hydrojax.identify.estimation.problem import Problem
from hydrojax.identify.tracing.score import Projection
from hydrojax.identify.tracing.state import Tracing

FINE, DRAWN = 2001, 6
"""Points of a signal's range over which knots are drawn anew, and how often they are:
what a curve bends is seen the better the closer they are.
"""


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

    @property
    def coefficients(self) -> set[str]:
        """Names of what the curves are made of."""
        return {n for c in self.curves for n in coefficients(c.laid.effect)}


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
        beside = without_line(state.free, one)
        fitted = [names.index(n) for n in beside if n not in own]
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


def fitted(
    at: Search,
    one: Laid,
    smooth: Smooth,
    p_value: float,
    before: Float[np.ndarray, "windows 3"],
    noise: Float[np.ndarray, "3"],
) -> Search:
    """The search with one more curve, fitted with all that is free, but for an effect
    that is the curve's straight line: it is absent from there on.
    """
    state, kept = at.state, without_line(at.state.free, one)
    values = state.point.values.copy()
    for name in set(state.free) - set(kept):
        values[state.problem.model.names.index(name)] = 0.0
    free = (*kept, *coefficients(one.effect))
    state = replace(state, free=free, point=replace(state.point, values=values))
    curve = Curve(one, smooth, p_value, before, before)
    return _settled(replace(at, state=state), at.curves, curve, noise)


def without_line(free: Sequence[str], one: Laid) -> tuple[str, ...]:
    """Free parameters without those of the effect that is a curve's straight line."""
    effect = STRAIGHT.get(one.term.name)
    return tuple(n for n in free if n.rpartition(".")[0] != effect)


def relaid(at: Search, noise: Float[np.ndarray, "3"]) -> Search:
    """The same with the last curve over knots drawn to where it bends: a corner or a
    step between knots is none that the curve can follow.
    """
    *others, curve = at.curves
    names = at.state.problem.model.names
    own = [names.index(n) for n in coefficients(curve.laid.effect)]
    weights = np.where(np.isfinite(noise), at.state.point.weights, np.inf)
    knots, c = np.asarray(curve.laid.effect.knots), at.state.point.values[own]
    best = None
    for _ in range(DRAWN):
        drawn = drawn_knots(knots, c)
        s = np.linspace(knots[0], knots[-1], FINE)
        old, new = (np.asarray(bspline(s, k)) for k in (knots, drawn))
        laid = replace(curve.laid, effect=curve.laid.term.laid(drawn))
        there = _placed(at, laid, np.linalg.lstsq(new, old @ c)[0])
        smooth = smoothed(columns_of(there, [laid], weights)[laid.term.name], drawn)
        if best and smooth.gain <= best.smooth.gain:
            break
        best = replace(curve, laid=laid, smooth=smooth)
        knots, c = drawn, smooth.c
    assert best is not None
    return _settled(at, tuple(others), best, noise)


def of_the_level(at: Search, noise: Float[np.ndarray, "3"]) -> Search:
    """The same with the last curve as a share of the Coulomb level: what changes a
    friction changes it in either direction, and by as much where these have one level.
    """
    *others, curve = at.curves
    state, laid, smooth = at.state, curve.laid, curve.smooth
    names = state.problem.model.names
    level = np.mean([state.point.values[names.index(n)] for n in COULOMB])
    term = share_of_level(laid.term)
    ratio = laid.term.size / (max(level, 1.0) * term.size)
    own = [names.index(n) for n in coefficients(laid.effect)]
    smooth = replace(
        smooth,
        c=ratio * state.point.values[own],
        penalty=smooth.penalty / ratio**2,
        rough=smooth.rough / ratio**2,
    )
    laid = Laid(term, term.laid(np.asarray(laid.effect.knots)))
    return _settled(at, tuple(others), replace(curve, laid=laid, smooth=smooth), noise)


def _placed(at: Search, one: Laid, c: Float[np.ndarray, "n"]) -> Search:
    """The search where a term has these coefficients."""
    state = with_terms(at.state, [one])
    names, values = state.problem.model.names, state.point.values.copy()
    values[[names.index(n) for n in coefficients(one.effect)]] = c
    return replace(at, state=replace(state, point=replace(state.point, values=values)))


def drawn_knots(
    knots: Float[np.ndarray, "n+4"], c: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n+4"]:
    """Knots, as many, of which a quarter lie where those of a curve do, and the rest by
    equal shares of how far its slope turns: close at corners and steps.
    """
    breaks = knots[DEGREE:-DEGREE]
    s = np.linspace(breaks[0], breaks[-1], FINE)
    bend = np.abs(BSpline(knots, c, DEGREE).derivative(2)(s))
    bent = np.concatenate([[0.0], np.cumsum(bend[1:] + bend[:-1])])
    if bent[-1] == 0:
        return knots
    share = np.linspace(0.0, 1.0, len(breaks))
    every = 0.75 * bent / bent[-1] + 0.25 * np.interp(s, breaks, share)
    inner = np.interp(share, every, s)
    return np.r_[[inner[0]] * DEGREE, inner, [inner[-1]] * DEGREE]


def _settled(
    at: Search,
    others: tuple[Curve, ...],
    curve: Curve,
    noise: Float[np.ndarray, "3"],
) -> Search:
    """The fit with the curve beside others, from the coefficients of its smoothing on:
    that is found again where the fit ends, and the fit goes on from there.
    """
    one = curve.laid
    there = replace(_placed(at, one, curve.smooth.c), curves=(*others, curve))
    for again in (True, False):
        there = refitted(there, noise)
        if again:
            weights = np.where(np.isfinite(noise), there.state.point.weights, np.inf)
            columns = columns_of(there, [one], weights)[one.term.name]
            knots = np.asarray(one.effect.knots)
            curve = replace(curve, smooth=smoothed(columns, knots))
            there = replace(there, curves=(*others, curve))
    return with_errors(there)


def with_errors(at: Search) -> Search:
    """The search with the validation errors after its last curve as they stand."""
    *others, curve = at.curves
    after = at.state.check.errors_at(at.state.point.values)
    return replace(at, curves=(*others, replace(curve, after=after)))


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
