"""The path of a command to the edges, as a balance wants it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from hydrojax.identify.checking.inputs import Inputs

DEAD = 0.25
"""Seconds of dead time that a valve may have, its lag in them."""
TICKS = np.array([0.5, 1, 2, 3, 5, 8, 12, 18, 27, 40, 60, 90, 130, 180, 250])
"""Steps in which shifts are tried."""
BANDS = (0.0, 0.02, 0.04, 0.08, 0.13, 0.2)
"""Dead bands that are tried, over the largest command."""
TURNS = 2
"""How often each of the two is tried beside the other."""


def shifts(h: float, most: float) -> list[float]:
    """The shifts (s) that are tried of signals every `h` seconds, up to some."""
    return [0.0, *(t for t in h * TICKS if t <= most)]


def least(
    error: Callable[[float], float], ends: tuple[float, float], within: float
) -> tuple[float, float]:
    """Where an error is least between two ends, found to `within`, and that error."""
    options = {"xatol": within}
    best: Any = minimize_scalar(error, bounds=ends, method="bounded", options=options)
    return float(best.x), float(best.fun)


def along_path(of: Inputs, error: Callable[[Inputs], float]) -> Inputs:
    """The inputs with the command behind the dead time and dead band of least error.

    Args:
        of: the inputs.
        error: of a balance.
    """
    dead, band = 0.0, BANDS[2]
    for _ in range(TURNS):
        dead = _refined(
            lambda t, b=band: error(of.behind(t, b)), shifts(of.h, DEAD), of.h / 4
        )
        band = _refined(lambda b, t=dead: error(of.behind(t, b)), BANDS, 5e-3)
    return min(of.behind(dead, band), of, key=error)


def _refined(
    error: Callable[[float], float], points: Sequence[float], within: float
) -> float:
    """Where an error is least, found to `within` beside the best of some points."""
    each = [error(x) for x in points]
    i = int(np.argmin(each))
    around = points[max(i - 1, 0)], points[min(i + 1, len(points) - 1)]
    at, lowest = least(error, around, within)
    return at if lowest < each[i] else points[i]
