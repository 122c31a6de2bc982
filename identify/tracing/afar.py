"""Effects far from where they are absent: a scan of their whole range on a few windows.

A delay longer than the command's own period, a play wider than its swing: what these
do is not predicted by their derivative at zero, along which a fit goes the wrong way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from hydrojax.identify.estimation.balance import Linear
from hydrojax.identify.estimation.columns import slot_names, thinned
from hydrojax.identify.estimation.problem import PRESSURES, Problem
from hydrojax.identify.tracing.grids import (
    Search,
    Values,
    bases,
    found_along,
    nonlocal_starts,
    own_fits,
)
from hydrojax.identify.tracing.in_balances import in_balances
from hydrojax.identify.tracing.score import Score
from hydrojax.identify.tracing.state import Tracing, free_names
from hydrojax.plant.effect import Effect
from hydrojax.plant.places import place_of


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
    at zero accounts for all of it; and the balances only of pressures that do. Where
    they are at their noise and the force plainly is not, which may show a valve's small
    faults more clearly, what acts on the pressures is rated by replays.

    Returns:
        By effect the gain, in units of its score's, and where it may be fitted from,
        the best first.
    """
    rms = state.problem.rms(state.problem.errors_at(state.point.values))
    ratio = rms / state.fitted_noise(noise)
    # Half way to what counts as above the noise.
    above = np.isfinite(noise) & (ratio > (1 + state.criteria.at_noise) / 2)
    if not effects or not np.any(above) or _accounted(state, scores, noise):
        return {}
    whole = next(iter(scores.values())).left
    searches = [_replays(state, effects, noise)]
    if np.any(above & PRESSURES):
        steps = state.criteria.far_steps
        searches.insert(0, in_balances(state, effects, bases(state), steps))
    elif state.problem.sees_pressures and ratio[2] > state.criteria.at_noise:
        searches.append(_hydraulics(state, effects, noise))
    if state.problem.sees_force and state.problem.sees_pressures:
        # Last, so that it counts where the balances rate the same effects.
        searches.append(_commands(state, effects, noise))
    out = {}
    for search in filter(None, searches):
        for name, fits in found_along(state, effects, search).items():
            gain = whole * (1 - min(f.left for f in fits) / search.here)
            fits = sorted(fits, key=lambda f: f.left)
            out[name] = (float(gain), tuple(f.values for f in fits))
    return out


def _replays(
    state: Tracing, effects: Mapping[str, Effect], noise: Float[np.ndarray, "3"]
) -> Search | None:
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
    return _by_replays(state, few, grids, bases(state))


def _hydraulics(
    state: Tracing, effects: Mapping[str, Effect], noise: Float[np.ndarray, "3"]
) -> Search | None:
    """Effects on the pressures whose strengths have a grid."""
    grids = {
        name: starts
        for name, e in effects.items()
        if (starts := nonlocal_starts(e)) and state.problem.side(free_names(e), True)
    }
    if not grids:
        return None
    return _by_replays(state, _thinned(state, noise), grids, bases(state)[:1])


def _commands(
    state: Tracing, effects: Mapping[str, Effect], noise: Float[np.ndarray, "3"]
) -> Search | None:
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
    return _by_replays(state, _thinned(state, noise), grids, bases(state)[:1])


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
) -> Search:
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
    fits = own_fits(state, few, evaluate, others, own.far_steps)
    left = evaluate(at, state.free).predicted(few)
    here = min([left, *(f.left for f in fits)])
    return Search(few, evaluate, here, grids, begin, own.far_steps)


def _accounted(state: Tracing, scores: Mapping[str, Score], noise: np.ndarray) -> bool:
    """Whether nothing would be left by the score of one candidate at zero."""
    seen, weights = np.isfinite(noise), state.point.weights
    windows, ticks, _ = state.problem.batch.windows.measured.shape
    own = state.fitted_noise(noise)
    floor = windows * ticks * float(np.sum((own[seen] / weights[seen]) ** 2))
    left = next(iter(scores.values())).left
    above = (state.criteria.at_noise**2 - 1) * floor
    above = min(above, state.criteria.fair_share * max(left - floor, 0.0))
    return left - max(s.gain for s in scores.values()) <= floor + above
