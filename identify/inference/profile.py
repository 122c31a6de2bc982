"""Profile likelihood: how far a parameter can go until the fit is worse.

A covariance knows the fit's curvature at its end alone. Here a parameter is held at
places away from it and all others are fitted again, so that bent valleys, ranges and
strengths that end at zero show as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy import stats

from hydrojax.identify.estimation.fit import FitPoint
from hydrojax.identify.estimation.problem import Problem
from hydrojax.identify.inference.uncertainty import Interval, Uncertainty, curvature


def profiles(
    problem: Problem,
    point: FitPoint,
    free: Sequence[str],
    uncertainty: Uncertainty,
    progress: Callable[[str], None] = lambda _: None,
    walk: Sequence[str] = (),
) -> dict[str, Interval]:
    """The 95 % interval of every free parameter by profile likelihood, SI.

    The rise of chi-square that ends an interval is scaled by what clustered windows
    made of the variance, as the covariance is. An end is None where the parameter's
    range ends first: the logs do not exclude what lies beyond.

    Args:
        problem: of the logs that were fitted.
        point: the fit.
        free: the parameters that were fitted.
        uncertainty: of the same fit, for where to begin.
        progress: called with a line of text at each stage.
        walk: the parameters whose intervals are wanted; all of `free` if none is named.
    """
    H, inside = curvature(problem, point, free)
    plain = np.sqrt(np.diag(np.linalg.pinv(H, rcond=1e-12, hermitian=True)))
    values, out = problem.solve(point.values, free, point.weights)
    best = 2 * float(out.cost)
    level = float(stats.chi2.ppf(problem.criteria.confidence, 1))
    found: dict[str, Interval] = {}
    for name in walk or free:
        progress(f"profile of {name}")
        i = problem.model.names.index(name)
        f, scale = problem.free[name], problem.model.scale[i]
        std = uncertainty.std.get(name)
        wider = 1.0
        if std is not None and name in inside:
            wider = max((std / (plain[inside.index(name)] * scale)) ** 2, 1e-6)
        step = 2 * std if std else 0.1 * scale
        ends = [
            _end(problem, values, point, free, name, side * step, best, level * wider)
            for side in (-1.0, 1.0)
        ]
        found[name] = (
            None if ends[0] <= f.lower else ends[0],
            None if ends[1] >= f.upper else ends[1],
        )
    return found


def _end(
    problem: Problem,
    values: np.ndarray,
    point: FitPoint,
    free: Sequence[str],
    name: str,
    step: float,
    best: float,
    level: float,
) -> float:
    """Where chi-square has risen by `level` on the side of `step`, or the range's end.

    The root of the rise is nearly a line, so each refit aims where that line says.
    """
    i, f = problem.model.names.index(name), problem.free[name]
    rest = tuple(n for n in free if n != name)
    wall = f.lower if step < 0 else f.upper
    inner, outer = 0.0, wall - values[i]
    at = values
    for _ in range(problem.criteria.profile_refits):
        if abs(step) >= abs(outer):
            step = outer
        moved = at.copy()
        moved[i] = values[i] + step
        moved, out = problem.solve(moved, rest, point.weights)
        rise = max(2 * float(out.cost) - best, 1e-12)
        aim = step * np.sqrt(level / rise)
        if abs(aim / step - 1) < problem.criteria.profile_close:
            return float(values[i] + aim)
        if rise < level:
            if step == outer and outer == wall - values[i]:
                return wall
            inner, at = step, moved
        else:
            outer = step
        low, high = sorted((abs(inner), abs(outer)))
        step = np.sign(outer) * float(
            np.clip(abs(aim), low + 0.1 * (high - low), high if rise < level else
                    high - 0.1 * (high - low))
        )  # fmt: skip
    return float(values[i] + step)
