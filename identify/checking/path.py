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


def along_path(of: Inputs, error: Callable[[Inputs], float]) -> Inputs:
    """The inputs with the command behind the dead time and dead band of least error.

    Args:
        of: the inputs.
        error: of a balance.
    """
    ends = shifts(of.h, DEAD)
    dead, band = 0.0, BANDS[2]
    for _ in range(TURNS):
        dead = _least(lambda t, b=band: error(of.behind(t, b)), ends, of.h / 4)
        band = _least(lambda b, t=dead: error(of.behind(t, b)), BANDS, 5e-3)
    return min(of.behind(dead, band), of, key=error)


def _least(
    error: Callable[[float], float], ends: Sequence[float], within: float
) -> float:
    """Where an error is least, found to `within` beside the best of some points."""
    i = int(np.argmin([error(x) for x in ends]))
    around = ends[max(i - 1, 0)], ends[min(i + 1, len(ends) - 1)]
    options = {"xatol": within}
    found: Any = minimize_scalar(
        error, bounds=around, method="bounded", options=options
    )
    return float(found.x) if found.fun < error(ends[i]) else ends[i]
