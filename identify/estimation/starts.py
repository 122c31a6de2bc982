"""Several starts at once, so that one poor guess does not decide a fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import repeat

import numpy as np
from jaxtyping import Float

from hydrojax.identify.estimation.columns import thinned
from hydrojax.identify.estimation.known import is_of_shapes
from hydrojax.identify.estimation.problem import Problem
from hydrojax.jax_setup import cores
from hydrojax.parameters import parameter_specs


def ranked_starts(
    problem: Problem,
    values: Float[np.ndarray, "n"],
    free: Sequence[str],
    count: int,
    seed: int = 0,
) -> list[Float[np.ndarray, "n"]]:
    """Where `count` fits from starts around `values` (itself among them) end, the best
    first.

    All are made on a few windows spread over the logs. A start that fails, to no number
    or a poor end, only comes last.
    """
    free = tuple(free)
    index = np.array([problem.model.names.index(n) for n in free])
    lower = np.array([problem.free[n].lower for n in free])
    upper = np.array([problem.free[n].upper for n in free])
    at = values[index]
    size = np.maximum(np.abs(at), 0.1 * problem.model.scale[index])
    spread = problem.criteria.start_spread
    draw = np.random.default_rng(seed).uniform(-spread, spread, (count, len(free)))
    draw[0] = 0.0
    starts = np.repeat(values[None], count, axis=0)
    starts[:, index] = np.clip(at + size * draw, lower, upper)
    few = replace(problem, batch=thinned(problem.batch, problem.criteria.start_windows))
    with ThreadPoolExecutor(cores()) as pool:
        ends = list(pool.map(few.solve, starts, repeat(free)))
    cost = np.array([float(fit.cost) for _, fit in ends])
    order = np.argsort(np.where(np.isfinite(cost), cost, np.inf), kind="stable")
    return [ends[i][0] for i in order]


def placed(
    problem: Problem, values: Float[np.ndarray, "n"], given: Mapping[str, float]
) -> Float[np.ndarray, "n"]:
    """The values with some of them as given, inside their ranges."""
    values = values.copy()
    for name, value in given.items():
        f = problem.free[name]
        values[problem.model.names.index(name)] = np.clip(value, f.lower, f.upper)
    return values


def other_ends(
    problem: Problem, values: Float[np.ndarray, "n"], names: Sequence[str]
) -> Iterator[tuple[str, float]]:
    """Those of the names that are shares between two shapes of an effect, each with the
    end of its range that it is further from.
    """
    specs = parameter_specs(problem.model.rig)
    for name in names:
        own = problem.free[name]
        if is_of_shapes(own, specs[name]):
            now = values[problem.model.names.index(name)]
            low = now - own.lower < own.upper - now
            yield name, own.upper if low else own.lower


def stuck(
    problem: Problem, values: Float[np.ndarray, "n"], names: Sequence[str]
) -> list[str]:
    """Those of the names that stand at an end of their range, off which they began."""
    out = []
    for name in names:
        f, at = problem.free[name], values[problem.model.names.index(name)]
        slack = 1e-6 * (f.upper - f.lower)
        inside = f.lower + slack < f.start < f.upper - slack
        if inside and not f.lower + slack < at < f.upper - slack:
            out.append(name)
    return out
