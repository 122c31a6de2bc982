"""The loop: fit, residual, the effect behind it, refit, error before and after."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from math import comb

import numpy as np

from hydrojax.identify.estimation.columns import HANDFUL, thinned
from hydrojax.identify.estimation.fit import FitPoint, fit_force, only
from hydrojax.identify.estimation.problem import PRESSURES, Problem
from hydrojax.identify.tracing.in_balances import elsewhere, together
from hydrojax.identify.tracing.judge import (
    as_good,
    better,
    chance,
    cost,
    judge,
    may_rise,
    negligible,
    worse,
)
from hydrojax.identify.tracing.refit import fit_from, refit
from hydrojax.identify.tracing.rivals import (
    at_other_ends,
    exchanged,
    pruned,
    shed,
    unspoilt,
    with_look_alikes,
    without,
)
from hydrojax.identify.tracing.score import Score, family, worth_a_refit
from hydrojax.identify.tracing.screen import scores_of, size_that_matters
from hydrojax.identify.tracing.state import Added, Tracing, free_names, strengths
from hydrojax.plant.effect import Effect
from hydrojax.plant.places import place_of


def search_effects(state: Tracing) -> Tracing:
    """Look for effects until none is left that matters: pressures first, then all.

    Force stands downstream of pressure, so what the pressures lack is found on them
    alone; what is then left in the force cannot be the hydraulics' fault. `state` has
    its pressures fitted (`fit_pressures`).
    """
    if state.problem.sees_pressures:
        upstream = {
            n: e for n, e in state.effects.items() if place_of(e).shows_in_pressures
        }
        state = _stage(state, upstream, only(state.noise, PRESSURES))
    if np.isfinite(state.noise[2]):
        problem, point = fit_force(state.problem, state.point.values, state.free)
        state = replace(state, problem=problem, point=point)
        state = _stage(state, state.effects, state.noise)
        if state.problem.sees_pressures:
            state = unspoilt(state)
    # An effect may have been kept by a fit that had not converged: all are questioned.
    return with_look_alikes(pruned(shed(state), state.noise, fresh=0))


def _stage(state: Tracing, effects: Mapping[str, Effect], noise: np.ndarray) -> Tracing:
    """What is found one by one; or, where that leaves something of the force, without
    the first of it, if others helped then and that leaves less.

    The first may have stood in for two: friction of another kind for friction that does
    not fade at rest and changes with the position.
    """
    found, first = _one_by_one(state, effects, noise)
    above = found.check.rms(found.errors) > found.criteria.at_noise * noise
    if not first or not (np.isfinite(noise[2]) and above[2]):
        return found
    found.progress(f"look again without {first}")
    rest = {n: e for n, e in effects.items() if n != first}
    other, _ = _one_by_one(state, rest, noise)
    by = found.criteria.beyond_chance
    if not better(other.errors, found.errors, noise, by):
        return found
    scores = {first: found.scores[first], **other.scores}
    return replace(other, scores=scores, tried={**other.tried, first: "exchanged"})


def _one_by_one(
    state: Tracing, effects: Mapping[str, Effect], noise: np.ndarray
) -> tuple[Tracing, str]:
    """Effects one by one, until none is left that helps, nor does better than one that
    was added while others were still missing. Several at once take the place of the
    first. And the name of the first, if others helped beside it; else nothing.
    """
    begun = state
    rounds, first = state.criteria.rounds, ""
    for left in reversed(range(rounds + 1)):
        more = _scored_round(state, effects, noise) if left else state
        added = len(more.added) > len(state.added)
        if left == rounds:
            known = {a.name for a in begun.added}
            helped = [n for n, how in more.tried.items() if how == "helps"]
            others = added and len(set(helped) - known) > 1
            first = more.added[-1].name if others else ""
            several = _or_several(begun, more, effects, noise)
            if several is not more:
                # Each was chosen before the others were there.
                several = pruned(_from_elsewhere(several, noise), noise, fresh=0)
                state = _in_steps(several, begun, noise)
                state.question(state)
                continue
        if added:
            state = pruned(more, noise)
            state.question(state)
            continue
        state = exchanged(more, effects, noise)
        if state is more:
            state = at_other_ends(more, noise)
        if state is more:
            break
    return state, first


def _or_several(
    begun: Tracing, found: Tracing, effects: Mapping[str, Effect], noise: np.ndarray
) -> Tracing:
    """What was found one by one; or, where that leaves much of the pressures, several
    that the flow balances want together from where it began, if these leave less.
    """
    if np.isfinite(noise[2]):
        return found  # the pressures by themselves come first
    if not _lacks_much(found, noise):
        return found
    left = found.errors
    several = _several(replace(begun, scores=found.scores), effects, noise)
    if len(several.added) < len(begun.added) + 2:
        return found
    by = found.criteria.beyond_chance
    return several if better(several.errors, left, noise, by) else found


def _lacks_much(state: Tracing, noise: np.ndarray) -> bool:
    """Whether much is left of a pressure: more than one effect may be missing."""
    much = state.check.rms(state.errors) > state.criteria.much * noise
    return bool(np.any(much[PRESSURES]))


def _scored_round(
    state: Tracing, effects: Mapping[str, Effect], noise: np.ndarray
) -> Tracing:
    """The state with one effect more, if one of those not yet added helps."""
    known = {a.name for a in state.added}
    rest = {n: e for n, e in effects.items() if n not in known}
    scores = scores_of(state, rest, noise)
    state = replace(state, scores={**state.scores, **scores})
    return _round(state, rest, scores, noise)


def _several(
    state: Tracing, effects: Mapping[str, Effect], noise: np.ndarray
) -> Tracing:
    """Add two effects or more that the flow balances want together, as many as help;
    none of them may help alone. Each has the p-value and the errors of the whole set.
    """
    check, before = state.check, state.errors
    sets = []
    for there in together(state, effects):
        state.progress(f"the flow balances want {there.added[-1].name}")
        state.question(there)
        sets.append(there)
        if not _lacks_much(there, noise):
            break

    def fitted(there: Tracing) -> Tracing:
        names = [a.name for a in there.added[len(state.added) :]]
        state.progress(f"refit with {', '.join(names)}")
        problem, point = fit_from(there, there.point.values, there.free, noise)
        return replace(there, problem=problem, point=point, tried=state.tried)

    for last in reversed(range(1, len(sets))):
        found = fitted(sets[last])
        after = found.errors
        there = [state.effects[a.name] for a in found.added[len(state.added) :]]
        by = may_rise(state, there, noise)
        if judge(state, before, after, noise, by) != "helps":
            continue
        ways = comb(len(state.effects), last + 1)
        p_value = min(ways * chance(before, after, noise), 1.0)
        ends = check.rms(before), check.rms(after)
        names = [a.name for a in found.added[len(state.added) :]]
        for name in names:
            state.progress(f"added {name}")
        added = (Added(name, p_value, *ends, ()) for name in names)
        return replace(found, added=(*state.added, *added))
    return state


def _from_elsewhere(state: Tracing, noise: np.ndarray) -> Tracing:
    """The state fitted from where else it may be, if that leaves less: a fit to
    pressures ends in one of many minima, and models that lacked what was added since
    drove the rig's own parameters far off.
    """
    values = elsewhere(state)
    if values is None:
        return state
    state.progress("fit what was found from the rig's own starts")
    problem, point = fit_from(state, values, state.free, noise)
    own = state.fitted_noise(noise)
    after = cost(problem.errors_at(point.values), own)
    if after < cost(state.problem.errors_at(state.point.values), own):
        return replace(state, problem=problem, point=point)
    return state


def _in_steps(state: Tracing, begun: Tracing, noise: np.ndarray) -> Tracing:
    """The state with the errors before and after each of the effects that it has and
    `begun` has not: of fits without those that were added after it, to some of the
    windows, for nothing is decided by them.
    """
    known = {a.name for a in begun.added}
    old = [a for a in state.added if a.name in known]
    new = [a for a in state.added if a.name not in known]
    some = thinned(state.problem.batch, 2 * HANDFUL)  # fewer want programs of their own
    less = replace(state, problem=replace(state.problem, batch=some))
    errors = [state.errors] if new else []
    for a in reversed(new[1:]):
        less = without(less, a.name, noise)
        errors.append(less.errors)
    steps = map(state.check.rms, (begun.errors, *reversed(errors)))
    added = (
        replace(a, before=before, after=after)
        for a, (before, after) in zip(new, pairwise(steps), strict=True)
    )
    return replace(state, added=(*old, *added))


def _round(
    state: Tracing,
    effects: Mapping[str, Effect],
    scores: Mapping[str, Score],
    noise: np.ndarray,
) -> Tracing:
    """Refit the best few candidates and add the one that helps most, if one does."""
    criteria = state.criteria
    p = family(scores, criteria)
    worth = _worth(state, scores, p, noise)
    before = state.errors
    tried = dict(state.tried)
    helped: list[tuple[float, str, Problem, FitPoint, np.ndarray]] = []
    tries = criteria.tries
    least_left = worth[0].left - worth[0].gain if worth else 0.0
    # What spoils another channel says nothing of what stands behind it, nor does what
    # acts ahead of pressures that are explained.
    spent, ahead = 0, _ahead_of_explained(state, effects, before, noise)
    for i, s in enumerate(worth):
        enough = max(spent, i - criteria.tries) >= tries
        if enough and s.gain < criteria.near_best * worth[0].gain:
            break
        if helped and s.left - s.gain > criteria.outdone * least_left:
            break
        state.progress(f"refit with {s.name}")
        problem, point = refit(state, effects[s.name], s, noise)
        after = state.check.errors_at(point.values)
        by = may_rise(state, [effects[s.name]], noise)
        tried[s.name] = judge(state, before, after, noise, by)
        if negligible(problem, point.values, effects[s.name]):
            tried[s.name] = "too small"
        spoils = tried[s.name] == "spoils another channel"
        spent += tried[s.name] == "helps" or not (spoils or s.name in ahead)
        quiet = state.check.rms(after) <= (1 + criteria.matters) * noise
        if tried[s.name] == "helps" and np.all(quiet[np.isfinite(noise)]):
            tries = 1  # nothing is left: only what comes as near may be the cause
        if tried[s.name] == "helps":
            helped.append((cost(after, noise), s.name, problem, point, after))
    if not helped:
        return replace(state, tried=tried)
    helped.sort(key=lambda h: h[0])
    # Of those that do as well the simplest: a constant force, not a weight that turns.
    near = [h for h in helped if as_good(state, h[4], helped[0][4], noise)]
    first = min(near, key=lambda h: len(strengths(effects[h[1]])))
    _, name, problem, point, after = first
    p_value = min(p[name], len(scores) * chance(before, after, noise))
    others = (h for h in helped if h is not first)
    alike = tuple(h[1] for h in others if not worse(h[4], after, noise, criteria))
    ends = state.check.rms(before), state.check.rms(after)
    state.progress(f"added {name}")
    return replace(
        state,
        problem=problem,
        point=point,
        free=(*state.free, *free_names(effects[name])),
        added=(*state.added, Added(name, p_value, *ends, alike)),
        tried=tried,
    )


def _worth(
    state: Tracing,
    scores: Mapping[str, Score],
    p: Mapping[str, float],
    noise: np.ndarray,
) -> list[Score]:
    """The candidates that are worth a refit, those first that promise most."""
    least = state.criteria.smallest_gain * size_that_matters(state, noise)
    return [
        s
        for s in sorted(scores.values(), key=lambda s: -s.gain)
        if s.gain > least and worth_a_refit(p[s.name], s, state.criteria)
    ]


def _ahead_of_explained(
    state: Tracing,
    effects: Mapping[str, Effect],
    before: np.ndarray,
    noise: np.ndarray,
) -> frozenset[str]:
    """Effects that act on the pressures, where the force is sought and these are at
    their noise: a force that lacks something else lends them much of its gain.
    """
    at_noise = state.check.rms(before) <= state.criteria.at_noise * noise
    if not (
        state.problem.sees_pressures
        and np.isfinite(noise[2])
        and np.all(at_noise[PRESSURES])
    ):
        return frozenset()
    return frozenset(n for n, e in effects.items() if place_of(e).shows_in_pressures)


def status(state: Tracing, name: str, p_value: float) -> str:
    """`added`, `rejected`, `absent` or `cannot tell`; by its family-wise p-value."""
    if any(a.name == name for a in state.added):
        return "added"
    if any(name in a.cannot_tell_from for a in state.added):
        return "cannot tell"
    s = state.scores.get(name)
    if s is None:
        return "cannot tell"
    if p_value < state.criteria.level:
        return "rejected"
    if s.share > state.criteria.promising:  # much is left that it might explain
        return "rejected" if name in state.tried else "cannot tell"
    return "absent" if s.power >= state.criteria.power else "cannot tell"
