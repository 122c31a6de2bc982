"""Effects that were added, questioned again with all the others present."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hydrojax.identify.estimation.fit import FitPoint
from hydrojax.identify.estimation.problem import Problem
from hydrojax.identify.estimation.starts import other_ends, placed
from hydrojax.identify.preparation.resolution import NoiseBy
from hydrojax.identify.tracing.grids import bases
from hydrojax.identify.tracing.in_balances import near_in_balances
from hydrojax.identify.tracing.judge import (
    better,
    chance,
    judge,
    may_rise,
    negligible,
    worse,
)
from hydrojax.identify.tracing.refit import fit_from, refit
from hydrojax.identify.tracing.score import Projection
from hydrojax.identify.tracing.screen import scores_of, size_that_matters
from hydrojax.identify.tracing.state import Tracing, free_names, strengths
from hydrojax.plant.effect import Effect
from hydrojax.plant.places import place_of


def pruned(state: Tracing, noise: Float[np.ndarray, "3"], fresh: int = 1) -> Tracing:
    """Let go of effects that the last ones made needless: an early pick was made while
    the others were still missing. The last `fresh` are not questioned, nor those
    without which the fit would plainly be worse.
    """
    names = [a.name for a in state.added[: len(state.added) - fresh]]
    if not names:
        return state
    plain = state.criteria.plainly_needed * size_that_matters(state, noise)
    gram = _gram(state, noise)
    for name in names:
        if _contribution(state, name, gram).rise > plain:
            continue
        less = without(state, name, noise)
        own, gone = (_rms(s) for s in (state, less))
        if np.all(gone <= own + state.criteria.matters * noise):
            state.progress(f"let go of {name}")
            state = replace(less, tried={**less.tried, name: "needless"})
            gram = _gram(state, noise)
    return state


def shed(state: Tracing) -> Tracing:
    """The state without effects that a later fit has brought to less than their least;
    fitted again where that is seen, for what was found beside one may go by it.
    """
    noise = state.noise
    for name in [a.name for a in state.added]:
        if negligible(state.problem, state.point.values, state.effects[name]):
            state.progress(f"let go of {name}")
            less = taken_out(state, name)
            if np.any(_rms(less) > _rms(state) + state.criteria.matters * noise):
                less = without(state, name, noise)
            state = replace(less, tried={**less.tried, name: "too small"})
    return state


def unspoilt(state: Tracing) -> Tracing:
    """The state without effects on the pressures by which the force is further off than
    the pressures come nearer, where something is left in both: they were found before
    the force was looked at, and what they take from one they bring into the other.
    """
    noise, own = state.noise, state.criteria
    for name in [a.name for a in reversed(state.added)]:
        above = _rms(state) > own.at_noise * noise
        if not (above[2] and np.any(above[:2])):
            break
        if not place_of(state.effects[name]).shows_in_pressures:
            continue
        less = without(state, name, noise)
        bare, errors = (s.errors for s in (less, state))
        if better(bare, errors, noise, own.beyond_chance):
            state.progress(f"let go of {name}")
            spoils = {name: "spoils another channel"}
            state = replace(less, tried={**less.tried, **spoils})
    return state


def beyond_position(state: Tracing, noise_by: NoiseBy) -> Tracing:
    """The state without effects that only change how the model answers the position's
    noise: a mass times an acceleration that is mostly noise takes some of it away.

    What counts is the mean square above the noise that the model with the effect, and
    that without it, is left with.
    """
    own, seen = state.criteria, np.isfinite(state.noise)

    def noise_of(state: Tracing) -> Float[np.ndarray, "c"]:
        return noise_by(state.problem, state.point.values).check[seen]

    for name in [a.name for a in reversed(state.added)]:
        noise, bare = noise_of(state), noise_of(taken_out(state, name))
        if not np.any(bare > (1 + own.matters) * noise):
            continue
        less = without(state, name, state.noise)
        bare = noise_of(less)
        fall = (_rms(less)[seen] / bare) ** 2 - 1
        fall -= ((_rms(state)[seen] / noise) ** 2 - 1) * (noise / bare) ** 2
        if np.all(fall <= 2 * own.matters):
            state.progress(f"let go of {name}")
            state = replace(less, tried={**less.tried, name: "answers noise"})
    return state


def exchanged(
    state: Tracing, effects: Mapping[str, Effect], noise: Float[np.ndarray, "3"]
) -> Tracing:
    """The state, or with rivals in the place of effects that they do better than; where
    all is at its noise already none is tried. Nor is the last effect questioned, if a
    round added it: it was compared there with all others present; nor one that no other
    takes the place of in the flow balances, which are fitted in a moment.
    """
    names = [a.name for a in state.added]
    if names and state.tried.get(names[-1]) == "helps":
        names.pop()
    for name in names:
        above = _rms(state) > state.criteria.at_noise * noise
        if not np.any(above[np.isfinite(noise)]):
            break
        known = {a.name for a in state.added}
        rivals = {n: e for n, e in effects.items() if n not in known}
        state = _exchanged(state, name, rivals, noise)
    return state


def at_other_ends(state: Tracing, noise: Float[np.ndarray, "3"]) -> Tracing:
    """The state fitted from the other end of shares between two shapes of an effect,
    where that leaves less, with all else where it stands or at the rig's own starts:
    between the two lies a hill that no fit comes over, and an effect may have been
    found before what tells its shapes apart.
    """
    seen = np.isfinite(noise)
    for name, end in other_ends(state.problem, state.point.values, state.free):
        errors = state.errors
        above = state.check.rms(errors) > state.criteria.at_noise * noise
        if not np.any(above[seen]):
            break
        here, back = (placed(state.problem, v, {name: end}) for v in bases(state))
        if np.allclose(state.check.errors_at(here), errors, rtol=1e-3):
            continue  # nothing tells the shapes apart
        state.progress(f"refit from the other end of {name}")
        # The one shape may have driven what else delays to its ends.
        for values in (here, back):
            problem, point = fit_from(state, values, state.free, noise)
            after = state.check.errors_at(point.values)
            if better(after, state.errors, noise, state.criteria.beyond_chance):
                state = replace(state, problem=problem, point=point)
    return state


def _rms(state: Tracing) -> Float[np.ndarray, "3"]:
    return state.check.rms(state.errors)


def without(state: Tracing, name: str, noise: Float[np.ndarray, "3"]) -> Tracing:
    """The state with one effect taken out and the rest fitted again."""
    less = taken_out(state, name)
    state.progress(f"refit without {name}")
    problem, point = fit_from(less, less.point.values, less.free, noise)
    return replace(less, problem=problem, point=point)


def taken_out(state: Tracing, name: str) -> Tracing:
    """The state with one effect's strengths at zero and nothing of it free."""
    effect = state.effects[name]
    own = set(free_names(effect))
    free = tuple(n for n in state.free if n not in own)
    values = state.point.values.copy()
    for n in strengths(effect):
        values[state.problem.model.names.index(n)] = 0.0
    added = tuple(a for a in state.added if a.name != name)
    point = replace(state.point, values=values)
    return replace(state, point=point, free=free, added=added)


def _exchanged(
    state: Tracing,
    name: str,
    rivals: Mapping[str, Effect],
    noise: Float[np.ndarray, "3"],
) -> Tracing:
    """The state, or with a rival in an effect's place: the first of them that lowers
    the validation error by as much as an effect that is added has to. Of two models
    that are both far off, the better one need not be nearer to the truth.
    """
    own = state.errors
    for rival, problem, point in _in_place_of(state, name, rivals, noise):
        after = state.check.errors_at(point.values)
        by = may_rise(state, [rivals[rival]], noise)
        if negligible(problem, point.values, rivals[rival]):
            continue
        if judge(state, own, after, noise, by) != "helps":
            continue
        state.progress(f"{rival} takes the place of {name}")
        rms = state.check.rms
        # Against the effect that it displaces, as one of all that were candidates.
        p = min(len(rivals) * chance(own, after, noise), 1.0)
        added = tuple(
            replace(a, name=rival, p_value=p, after=rms(after), cannot_tell_from=())
            if a.name == name
            else a
            for a in state.added
        )
        free = (*taken_out(state, name).free, *free_names(rivals[rival]))
        return replace(
            state,
            problem=problem,
            point=point,
            free=free,
            added=added,
            tried={**state.tried, name: "exchanged", rival: "helps"},
        )
    return state


def _in_place_of(
    state: Tracing,
    name: str,
    rivals: Mapping[str, Effect],
    noise: Float[np.ndarray, "3"],
) -> Iterator[tuple[str, Problem, FitPoint]]:
    """The few most likely rivals, each fitted in an effect's place: from where the flow
    balances put them, which takes a moment, or by scores where these do not show them.
    """
    criteria = state.criteria
    less = taken_out(state, name)
    near = near_in_balances(state, less, rivals)
    if near is not None:
        for rival, values in near[: criteria.rivals]:
            state.progress(f"refit with {rival} in place of {name}")
            free = (*less.free, *free_names(rivals[rival]))
            yield rival, *fit_from(less, values, free, noise)
        return
    less = without(state, name, noise)
    scores = scores_of(less, {**rivals, name: state.effects[name]}, noise)
    order = sorted(scores.values(), key=lambda s: -s.gain)
    enough = max(criteria.rival * scores[name].gain, 0.0)
    best = [s for s in order if s.name != name and s.gain > enough]
    for s in best[: criteria.rivals]:
        state.progress(f"refit with {s.name} in place of {name}")
        yield s.name, *refit(less, rivals[s.name], s, noise)


def with_look_alikes(state: Tracing) -> Tracing:
    """Each effect's `cannot_tell_from`, with all that was found present.

    A rival whose columns are nearly parallel to the effect's, off all that is fitted,
    is put in the effect's place and fitted; the two cannot be told apart where its
    validation error is not larger beyond chance.
    """
    if not state.added:
        return state
    noise, criteria = state.noise, state.criteria
    own, gram = state.errors, _gram(state, noise)
    known = {a.name for a in state.added}
    # What was tried in the round of the one effect there is was compared with it.
    others = not {"exchanged", "needless"}.isdisjoint(state.tried.values())
    told = set(state.tried) if len(state.added) == 1 and not others else set()
    added = []
    for a in state.added:
        near = _near_parallel(state, a.name, gram)
        near = [n for n in near if n not in {*known, *told, *a.cannot_tell_from}]
        # What looked like it before it was found is no look-alike beside it.
        alike = [n for n in a.cannot_tell_from if n not in known]
        less = without(state, a.name, noise) if near else state
        for name in near[: criteria.rivals]:
            state.progress(f"refit with {name} in place of {a.name}")
            s = scores_of(less, {name: state.effects[name]}, noise)[name]
            problem, point = refit(less, state.effects[name], s, noise)
            after = less.check.errors_at(point.values)
            small = negligible(problem, point.values, state.effects[name])
            if not small and not worse(after, own, noise, criteria):
                alike.append(name)
        added.append(replace(a, cannot_tell_from=tuple(alike)))
    return replace(state, added=tuple(added))


class _Contribution(NamedTuple):
    """What an effect does at the present fit, off all else that is fitted.

    Attributes:
        rise: of chi-square without it, were everything linear.
        columns: of its strengths.
        amount: how far these stand from zero, in units of the columns.
        projection: the windows' Gram matrices with all else projected out.
    """

    rise: float
    columns: list[int]
    amount: Float[np.ndarray, "columns"]
    projection: Projection


Gram = Float[np.ndarray, "windows rows rows"]


def _gram(state: Tracing, noise: Float[np.ndarray, "3"]) -> Gram:
    """The windows' Gram matrices at the present fit."""
    weights = np.where(np.isfinite(noise), state.point.weights, np.inf)
    return np.array(state.problem.sums_at(state.point.values, weights).gram)


def _contribution(state: Tracing, name: str, gram: Gram) -> _Contribution:
    problem, names = state.problem, list(state.problem.model.names)
    own = set(free_names(state.effects[name]))
    fitted = [names.index(n) for n in state.free if n not in own]
    projection = Projection(gram, fitted, np.zeros(len(names)))
    mine = [names.index(n) for n in strengths(state.effects[name])]
    amount = state.point.values[mine] / problem.model.scale[mine]
    rise = float(amount @ projection.curvature(mine, mine) @ amount)
    return _Contribution(rise, mine, amount, projection)


def _near_parallel(state: Tracing, name: str, gram: Gram) -> list[str]:
    """Candidates whose columns, off all else that is fitted, can follow an effect's
    own at the present fit: the closest first.
    """
    names = list(state.problem.model.names)
    size, mine, amount, projection = _contribution(state, name, gram)
    follows = {}
    for other, effect in state.effects.items():
        theirs = [names.index(n) for n in strengths(effect)]
        H = projection.curvature(theirs, theirs)
        seen = np.diag(H) > 1e-9 * projection.total[theirs, theirs]
        if other == name or not size > 0 or not np.all(seen):
            continue
        cross = projection.curvature(theirs, mine) @ amount
        H = H + 1e-9 * np.diag(np.diag(H))
        follows[other] = float(cross @ np.linalg.solve(H, cross)) / size
    order = sorted(follows, key=lambda n: -follows[n])
    return [n for n in order if follows[n] > state.criteria.near_parallel**2]
