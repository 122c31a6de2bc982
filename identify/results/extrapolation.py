"""What the fitted logs do not show of a model, and the logs of the check need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydrojax.identify.estimation.known import Known
from hydrojax.identify.inference.uncertainty import curvature
from hydrojax.identify.tracing.state import Tracing


def extrapolation(state: Tracing, unidentifiable: Sequence[str]) -> tuple[str, ...]:
    """Parameters that the fitted logs leave open and the check needs.

    A fit to the check's logs, held by what the fitted logs identify. The
    names are empty unless there are values with which every channel of all the logs is
    at its noise: then nothing says that the model lacks anything.

    Args:
        state: where a run ended.
        unidentifiable: those that the fitted logs do not identify, named first.
    """
    own = state.criteria
    noise, free, index = state.noise, state.free, _index(state)
    fitted, check, start = state.problem, state.check, state.point.values

    def off(problem, values) -> np.ndarray:
        """Each channel's error over its noise."""
        return problem.rms(problem.errors_at(values)) / noise

    if np.any(off(fitted, start) > own.at_noise):
        return ()
    known = Known(free, start[index], curvature(fitted, state.point, free)[0])
    both = replace(fitted, batch=check.batch, known=known, symmetric=False)
    values = start
    for _ in range(2):
        values, out = both.solve(values, free, noise)
        both = both.restarted(out.also, values)
    if np.any(off(fitted, values) > own.at_noise) or np.any(
        off(check, values) > own.at_noise
    ):
        return ()

    def cost(at) -> float:
        return float(np.sum(off(check, at) ** 2))

    least = cost(values)
    fall = cost(start) - least
    rise = {}
    for name, i in zip(free, index, strict=True):
        without = values.copy()
        without[i] = start[i]
        rise[name] = (cost(without) - least) / fall
    named = sorted((n for n in free if rise[n] > own.needed), key=lambda n: -rise[n])
    return tuple(n for n in named if n in unidentifiable) or tuple(named)


def _index(state: Tracing) -> np.ndarray:
    names = state.problem.model.names
    return np.array([names.index(n) for n in state.free], dtype=int)
