"""Effects far from where they are absent: a scan of their whole range on a few windows.

A delay longer than the command's own period, a play wider than its swing: what these
do is not predicted by their derivative at zero, along which a fit goes the wrong way.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import product, repeat
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hydrojax.identify.estimation.balance import (
    Evaluate,
    Linear,
    balance_at,
    descend,
    in_brief,
)
from hydrojax.identify.estimation.columns import slot_names, thinned
from hydrojax.identify.estimation.problem import PRESSURES, Problem
from hydrojax.identify.estimation.starts import placed
from hydrojax.identify.tracing.score import Score
from hydrojax.identify.tracing.state import Added, Tracing, free_names
from hydrojax.jax_setup import cores
from hydrojax.parameters import specs
from hydrojax.plant.effect import Effect
from hydrojax.plant.places import place_of

Values = Float[np.ndarray, "n"]


class _Search(NamedTuple):
    """How starts of some effects are rated.

    Attributes:
        problem: on a few windows.
        evaluate: the sum of squares that rates them.
        here: that of the model without them, once its own parameters follow: the least
            from each of `begin`, as effects are tried from there.
        effects: with the strengths from which each is tried, by effect.
        begin: values that all else has then.
        steps: of the fits that follow, at most.
    """

    problem: Problem
    evaluate: Evaluate
    here: float
    effects: Mapping[str, Sequence[Mapping[str, float]]]
    begin: Sequence[Values]
    steps: int


def from_afar(
    state: Tracing,
    scores: Mapping[str, Score],
    effects: Mapping[str, Effect],
    noise: Float[np.ndarray, "3"],
) -> dict[str, tuple[float, tuple[Values, ...]]]:
    """What effects would gain that are put in with the strengths of their grids.

    Each value of a grid is put in on a few windows, with the rig's own parameters where
    they are and back at their starts (a model that lacks an effect drives them far
    off), and rated by what a linear step of all that is free leaves. From the best
    along the grids a few steps of a fit follow. What acts on the pressures is rated by
    the flow balances at the measured ones, whatever its grid; the rest by force and
    sensors at the pressures that are replayed. What acts on the command is rated by
    replays, too, where something that acts there is free already and a force is
    compared, which shows more than the noise of pressures lets through to balances: of
    a spool and a dead time the first to be found does nearly all of the other's work,
    and from zero the other has no slope left.
    Nothing is asked where nothing stands above the noise, or where a candidate's score
    at zero accounts for all of it; and the balances only of pressures that do.

    Returns:
        By effect the gain, in units of its score's, and where it may be fitted from,
        the best first.
    """
    above = _above(state, noise)
    if not effects or not np.any(above) or _accounted(state, scores, noise):
        return {}
    whole = next(iter(scores.values())).left
    searches = [_replays(state, effects, noise)]
    if np.any(above & PRESSURES):
        steps = state.criteria.far_steps
        searches.insert(0, _balances(state, effects, _bases(state), steps))
    if state.problem.sees_force and state.problem.sees_pressures:
        # Last, so that it counts where the balances rate the same effects.
        searches.append(_commands(state, effects, noise))
    out = {}
    for search in filter(None, searches):
        for name, fits in _found(state, effects, search).items():
            gain = whole * (1 - min(f.left for f in fits) / search.here)
            fits = sorted(fits, key=lambda f: f.left)
            out[name] = (float(gain), tuple(f.values for f in fits))
    return out


def together(state: Tracing, effects: Mapping[str, Effect]) -> Iterator[Tracing]:
    """Sets of effects that the flow balances want together, each of one more.

    Where several are missing, none may help a replay that lacks the others: a balance
    knows its own tick only, and tells them apart one after the other.

    Yields:
        The state with the set among what is free and added, at the values to fit from.
    """
    own = state.criteria
    for sought in range(own.together):
        known = {a.name for a in state.added}
        rest = {n: e for n, e in effects.items() if n not in known}
        # The rig's own parameters come along with what is found first.
        begin = _bases(state)[: 1 if sought else None]
        search = _balances(state, rest, begin, own.together_steps)
        if search is None:
            return
        found = _found(state, effects, search)
        fits = [(name, fit) for name, own_fits in found.items() for fit in own_fits]
        if not fits:
            return
        name, fit = min(fits, key=lambda f: f[1].left)
        if not fit.left < (1 - own.wanted) * search.here:
            return
        none = np.full(3, np.nan)
        state = replace(
            state,
            point=replace(state.point, values=fit.values),
            free=(*state.free, *free_names(effects[name])),
            added=(*state.added, Added(name, 1.0, none, none, ())),
        )
        yield state


def elsewhere(state: Tracing) -> Values | None:
    """Where else to fit what is free from: where a few steps of a fit of the flow
    balances lead with the rig's own parameters back at their starts, if to plainly less
    than from where they are.
    """
    own, few = state.criteria, in_brief(state.problem)
    if not few.sees_pressures:
        return None
    evaluate = partial(balance_at, few)
    here, back = _own_fits(state, few, evaluate, _bases(state), own.far_steps)
    return back.values if back.left < (1 - own.wanted) * here.left else None


def near_in_balances(
    state: Tracing, less: Tracing, rivals: Mapping[str, Effect]
) -> list[tuple[str, Values]] | None:
    """Which `rivals` of the effect that `less` lacks come near it in the flow balances,
    each with the values from which it may be fitted, the nearest first.

    Returns:
        None where the effect does not act on the pressures, or none is measured.
    """
    gone = [n for n in state.free if n not in less.free]
    if len(state.problem.side(gone, True)) < len(gone):
        return None
    own = state.criteria
    # Not from the starts too: with either the rig's own parameters are where they are.
    search = _balances(less, rivals, _bases(less)[:1], own.far_steps)
    if search is None:
        return None
    problem, evaluate = search.problem, search.evaluate
    here = evaluate(state.point.values, state.free)
    here = descend(problem, evaluate, here, state.free, own.far_steps)
    best = {
        name: min(fits, key=lambda f: f.left)
        for name, fits in _found(less, rivals, search).items()
    }
    enough = here.left + own.plainly_lacks * (search.here - here.left)
    order = sorted(best, key=lambda n: best[n].left)
    return [(n, best[n].values) for n in order if best[n].left < enough]


def _balances(
    state: Tracing,
    effects: Mapping[str, Effect],
    begin: Sequence[Values],
    steps: int,
) -> _Search | None:
    """Effects that act on the pressures, where these are measured."""
    few = in_brief(state.problem)
    upstream = {
        name: [*shape_starts(e), *nonlocal_starts(e)]
        for name, e in effects.items()
        if len(few.side(free_names(e), True)) == len(free_names(e))
    }
    if not upstream or not few.sees_pressures:
        return None

    evaluate = partial(balance_at, few)
    here = min(f.left for f in _own_fits(state, few, evaluate, begin, steps))
    return _Search(few, evaluate, here, upstream, begin, steps)


def _own_fits(
    state: Tracing,
    few: Problem,
    evaluate: Evaluate,
    begin: Sequence[Values],
    steps: int,
) -> list[Linear]:
    """Fits of what is free already, a few steps from each of some values."""
    free = state.free
    return [descend(few, evaluate, evaluate(at, free), free, steps) for at in begin]


def _replays(
    state: Tracing, effects: Mapping[str, Effect], noise: Float[np.ndarray, "3"]
) -> _Search | None:
    """Effects whose strengths have a grid, and that the balances do not show."""
    problem = state.problem
    grids = {
        name: starts
        for name, e in effects.items()
        if (starts := nonlocal_starts(e))
        and not (problem.sees_pressures and problem.side(free_names(e), True))
    }
    if not grids:
        return None
    few = _thinned(state, noise)
    if problem.sees_pressures:
        few = few.behind(state.point.values)
    return _by_replays(state, few, grids, _bases(state))


def _commands(
    state: Tracing, effects: Mapping[str, Effect], noise: Float[np.ndarray, "3"]
) -> _Search | None:
    """Effects on the command whose strengths have a grid, where another is free."""
    own = state.problem.model.rig.command
    if not {e.name for e in own} & {n.split(".")[0] for n in state.free}:
        return None
    grids = {
        name: starts
        for name, e in effects.items()
        if place_of(e).name == "command" and (starts := nonlocal_starts(e))
    }
    if not grids:
        return None
    # What was found with the first is where the second is looked for.
    return _by_replays(state, _thinned(state, noise), grids, _bases(state)[:1])


def _thinned(state: Tracing, noise: Float[np.ndarray, "3"]) -> Problem:
    """The problem on a few windows, in the state's weights of what is compared."""
    weights = np.where(np.isfinite(noise), state.point.weights, np.inf)
    batch = thinned(state.problem.batch, state.criteria.start_windows)
    return replace(state.problem, batch=batch._replace(noise=weights))


def _by_replays(
    state: Tracing,
    few: Problem,
    grids: Mapping[str, Sequence[Mapping[str, float]]],
    begin: Sequence[Values],
) -> _Search:
    """A search of effects from their grids by replays of a few windows."""
    own, batch = state.criteria, few.batch

    def evaluate(values: Values, free: Sequence[str]) -> Linear:
        slots = few.slots(free)
        if not few.simulate:
            slots, free = (0, slots[1]), few.side(free, False)
        columns = slot_names(few.model, tuple(free), slots)
        gram = few.evaluate(values, tuple(free), slots, batch).gram
        return Linear.of(few, values, columns, np.sum(gram, axis=0))

    # The present values are a fit's: one linear step says where it would end.
    at, *others = begin
    fits = _own_fits(state, few, evaluate, others, own.far_steps)
    left = evaluate(at, state.free).predicted(few)
    here = min([left, *(f.left for f in fits)])
    return _Search(few, evaluate, here, grids, begin, own.far_steps)


def _bases(state: Tracing) -> tuple[Values, Values]:
    """The values as they stand, and with the rig's own parameters at their starts."""
    added = {n for a in state.added for n in free_names(state.effects[a.name])}
    back = {n: state.problem.free[n].start for n in state.free if n not in added}
    here = state.point.values
    return here, placed(state.problem, here, back)


def _found(
    state: Tracing, effects: Mapping[str, Effect], search: _Search
) -> dict[str, list[Linear]]:
    """The best fits of each effect on a few windows, from the deepest minima of all.

    A few steps from each; more, where the search asks for them, from the best of these.
    """
    problem, evaluate, _, grids, begin, steps = search
    own = state.criteria
    with ThreadPoolExecutor(cores()) as pool:
        found = []
        for name, grid in grids.items():
            free = (*state.free, *free_names(effects[name]))
            for base in begin:
                far = [placed(problem, base, values) for values in grid]
                at = list(pool.map(evaluate, far, repeat(free)))
                left = np.array([a.predicted(problem) for a in at])
                around = np.r_[np.inf, left, np.inf]
                (low,) = np.nonzero((left <= around[:-2]) & (left <= around[2:]))
                best = sorted(low, key=lambda i: left[i])[: own.far_starts]
                found += [(left[i], name, at[i], free) for i in best]
        found.sort(key=lambda f: f[0])
        chosen: dict[str, list] = {}
        for _, name, at, free in found:
            if len(chosen.get(name, ())) < own.far_starts and (
                name in chosen or len(chosen) < own.far_fits
            ):
                chosen.setdefault(name, []).append((at, free))

        def fitted(steps, of):
            name, at, free = of
            return name, descend(problem, evaluate, at, free, steps), free

        starts = [
            (name, *each) for name, each_start in chosen.items() for each in each_start
        ]
        few = min(steps, own.far_steps)
        fits = list(pool.map(partial(fitted, few), starts))
        if steps > few:
            fits.sort(key=lambda f: f[1].left)
            longer = fits[: own.far_longer]
            fits[: own.far_longer] = pool.map(partial(fitted, steps - few), longer)
    out: dict[str, list[Linear]] = {}
    for name, fit, _ in fits:
        out.setdefault(name, []).append(fit)
    return out


def _above(state: Tracing, noise: np.ndarray) -> np.ndarray:
    """The channels in which something is left that may be far from zero: it shows, at
    half way to what counts as above the noise.
    """
    rms = state.problem.rms(state.problem.errors_at(state.point.values))
    return np.isfinite(noise) & (rms > (1 + state.criteria.at_noise) / 2 * noise)


def _accounted(state: Tracing, scores: Mapping[str, Score], noise: np.ndarray) -> bool:
    """Whether nothing would be left by the score of one candidate at zero."""
    seen, weights = np.isfinite(noise), state.point.weights
    windows, ticks, _ = state.problem.batch.windows.measured.shape
    floor = windows * ticks * float(np.sum((noise[seen] / weights[seen]) ** 2))
    left = next(iter(scores.values())).left
    above = (state.criteria.at_noise**2 - 1) * floor
    above = min(above, state.criteria.fair_share * max(left - floor, 0.0))
    return left - max(s.gain for s in scores.values()) <= floor + above


def nonlocal_starts(effect: Effect) -> list[dict[str, float]]:
    """Strengths at which an effect is tried as it stands, along its grid: what it does
    there is not predicted by its derivative at zero. Each with every shape of its grid.
    """
    strengths = _along(effect, [f for f, s in specs(effect).items() if s.strength])
    return [a | b for a, b in product(strengths, shape_starts(effect))]


def shape_starts(effect: Effect) -> list[dict[str, float]]:
    """Values of its shape along their grids, its strengths at zero; one at least."""
    shape = [f for f, s in specs(effect).items() if not s.strength]
    return _along(effect, shape) or [{}]


def _along(effect: Effect, fields: Sequence[str]) -> list[dict[str, float]]:
    """The first values of these fields' grids together, then the second, and so on."""
    grids = {f"{effect.name}.{f}": specs(effect)[f].grid for f in fields}
    length = max((len(g) for g in grids.values()), default=0)
    return [{n: g[i] for n, g in grids.items() if i < len(g)} for i in range(length)]
