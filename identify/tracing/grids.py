"""A search along effects' grids: starts rated on a few windows, the best fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import product, repeat
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hydrojax.identify.estimation.balance import Evaluate, Linear, descend
from hydrojax.identify.estimation.problem import Problem
from hydrojax.identify.estimation.starts import placed
from hydrojax.identify.tracing.state import Tracing, free_names
from hydrojax.jax_setup import cores
from hydrojax.parameters import specs
from hydrojax.plant.effect import Effect

Values = Float[np.ndarray, "n"]


class Search(NamedTuple):
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


def own_fits(
    state: Tracing,
    few: Problem,
    evaluate: Evaluate,
    begin: Sequence[Values],
    steps: int,
) -> list[Linear]:
    """Fits of what is free already, a few steps from each of some values."""
    free = state.free
    return [descend(few, evaluate, evaluate(at, free), free, steps) for at in begin]


def bases(state: Tracing) -> tuple[Values, Values]:
    """The values as they stand, and with the rig's own parameters at their starts."""
    added = {n for a in state.added for n in free_names(state.effects[a.name])}
    back = {n: state.problem.free[n].start for n in state.free if n not in added}
    here = state.point.values
    return here, placed(state.problem, here, back)


def found_along(
    state: Tracing, effects: Mapping[str, Effect], search: Search
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
                lowest = (left <= around[:-2]) & (left <= around[2:])
                (low,) = np.nonzero(lowest & np.isfinite(left))
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
