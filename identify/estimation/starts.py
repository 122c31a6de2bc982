"""Several starts at once, so that one poor guess does not decide a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hydrojax.identify.estimation.columns import basis, filled, thinned
from hydrojax.identify.estimation.misfit import run_starts
from hydrojax.identify.estimation.problem import Problem


def best_start(
    problem: Problem,
    values: Float[np.ndarray, "n"],
    free: Sequence[str],
    count: int,
    seed: int = 0,
) -> Float[np.ndarray, "n"]:
    """The best of `count` fits from starts around `values` (itself among them).

    All run side by side (vmapped) on a few windows spread over the logs. A start that
    fails, to no number or a poor end, only loses.
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
    starts = np.clip(at + size * draw, lower, upper)
    slots = (len(problem.side(free, True)), len(problem.side(free, False)))
    # Columns stand hydraulic first, as `basis` lays them out.
    order = np.argsort([i >= problem.model.hydraulic for i in index], kind="stable")
    scale = problem.model.scale[index]

    def coordinates(x):
        return jnp.asarray(((x - at) / scale)[..., order])

    model, all_values = problem.model.acting(values, free)
    out = run_starts(
        model,
        all_values,
        coordinates(starts),
        basis(model, free, slots),
        coordinates(lower),
        coordinates(upper),
        filled(thinned(problem.batch, problem.criteria.start_windows)),
        problem.simulate,
    )
    cost = np.where(np.isfinite(out.cost), out.cost, np.inf)
    best = np.asarray(out.at)[int(np.argmin(cost))]
    moved = values.copy()
    moved[index[order]] = np.clip(
        at[order] + scale[order] * best, lower[order], upper[order]
    )
    return moved


def placed(
    problem: Problem, values: Float[np.ndarray, "n"], given: Mapping[str, float]
) -> Float[np.ndarray, "n"]:
    """The values with some of them as given, inside their ranges."""
    values = values.copy()
    for name, value in given.items():
        f = problem.free[name]
        values[problem.model.names.index(name)] = np.clip(value, f.lower, f.upper)
    return values
