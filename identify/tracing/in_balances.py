"""Effects sought in the flow balances: one, several together, and an effect's rivals.

A balance knows the error of its own tick only, and integrates nothing: what acts on
the pressures is told apart there where replays of a model that lacks much are not.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from hydrojax.identify.estimation.balance import balance_at, descend
from hydrojax.identify.tracing.grids import (
    Search,
    Values,
    bases,
    found_along,
    nonlocal_starts,
    own_fits,
    shape_starts,
)
from hydrojax.identify.tracing.judge import negligible
from hydrojax.identify.tracing.state import Added, Tracing, free_names
from hydrojax.plant.effect import Effect


def in_balances(
    state: Tracing,
    effects: Mapping[str, Effect],
    begin: Sequence[Values],
    steps: int,
) -> Search | None:
    """Effects that act on the pressures, where these are measured."""
    few = state.problem.brief
    upstream = {
        name: [*shape_starts(e), *nonlocal_starts(e)]
        for name, e in effects.items()
        if len(few.side(free_names(e), True)) == len(free_names(e))
    }
    if not upstream or not few.sees_pressures:
        return None

    evaluate = partial(balance_at, few)
    here = min(f.left for f in own_fits(state, few, evaluate, begin, steps))
    return Search(few, evaluate, here, upstream, begin, steps)


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
        begin = bases(state)[: 1 if sought else None]
        search = in_balances(state, rest, begin, own.together_steps)
        if search is None:
            return
        found = found_along(state, effects, search)
        fits = [
            (name, fit)
            for name, own_fits in found.items()
            for fit in own_fits
            if not negligible(search.problem, fit.values, effects[name])
        ]
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
    own, few = state.criteria, state.problem.brief
    if not few.sees_pressures:
        return None
    evaluate = partial(balance_at, few)
    here, back = own_fits(state, few, evaluate, bases(state), own.far_steps)
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
    search = in_balances(less, rivals, bases(less)[:1], own.far_steps)
    if search is None:
        return None
    problem, evaluate = search.problem, search.evaluate
    here = evaluate(state.point.values, state.free)
    here = descend(problem, evaluate, here, state.free, own.far_steps)
    best = {
        name: min(fits, key=lambda f: f.left)
        for name, fits in found_along(less, rivals, search).items()
    }
    enough = here.left + own.plainly_lacks * (search.here - here.left)
    order = sorted(best, key=lambda n: best[n].left)
    return [(n, best[n].values) for n in order if best[n].left < enough]
