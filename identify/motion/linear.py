"""A linear autoregressive model of a position, to compare a prediction with."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy.signal import lfilter, lfiltic

from hydrojax.identify.motion.course import Course

ORDER = 4
"""Past samples of the position and of what drives it."""


def arx_errors(
    fit: Course,
    judged: Course,
    fresh: Bool[np.ndarray, "lengths runs n"],
    signal: int = 0,
) -> Float[np.ndarray, "lengths"]:
    """RMS error of a signal, by its place in `course.SIGNALS`, SI, of an ARX model from
    the drive that is fitted to the runs `fit` by least squares, and simulated through
    `judged` from every `fresh` tick on; NaN where it does not stay finite.
    """
    fit, judged = (c._replace(measured=c.measured[..., signal]) for c in (fit, judged))
    mean, size = _scales(fit)
    rows, wanted = [], []
    for i in range(len(fit.t)):
        x, drive = _signals(fit, i, mean, size)
        rows.append(np.column_stack([_past(x), _past(drive), np.ones(x.size - ORDER)]))
        wanted.append(x[ORDER:])
    weights = np.linalg.lstsq(np.concatenate(rows), np.concatenate(wanted), rcond=None)
    off = [
        _errors(judged, i, own[i], weights[0], mean, size)
        for own in fresh
        for i in range(len(judged.t))
    ]
    count = len(judged.t)
    out = [np.concatenate(off[k : k + count]) for k in range(0, len(off), count)]
    with np.errstate(over="ignore", invalid="ignore"):
        rms = np.sqrt([np.mean(e**2) for e in out])
    return np.where(np.isfinite(rms), rms, np.nan) * size[0]


def _scales(course: Course) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of the signal and its drive."""
    drive = course.inputs.P if course.inputs.P is not None else course.inputs.u
    both = [np.asarray(course.measured), np.asarray(drive)]
    size = np.array([np.std(a) for a in both])
    return np.array([np.mean(a) for a in both]), np.where(size > 0, size, 1.0)


def _signals(
    course: Course, i: int, mean: np.ndarray, size: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Signal and drive of run `i`, standardised, without what pads it."""
    drive = course.inputs.P if course.inputs.P is not None else course.inputs.u
    end = int(np.flatnonzero(np.asarray(course.there)[i])[-1])
    x = np.asarray(course.measured)[i, :end]
    return (x - mean[0]) / size[0], (np.asarray(drive)[i, :end] - mean[1]) / size[1]


def _past(y: np.ndarray) -> np.ndarray:
    """The `ORDER` samples before each from the `ORDER`-th on, the last first."""
    return np.lib.stride_tricks.sliding_window_view(y, ORDER)[:-1, ::-1]


def _errors(
    course: Course,
    i: int,
    fresh: np.ndarray,
    weights: np.ndarray,
    mean: np.ndarray,
    size: np.ndarray,
) -> np.ndarray:
    """Simulated less measured of run `i`, standardised, where it is compared."""
    x, drive = _signals(course, i, mean, size)
    there = np.asarray(course.there)[i, : x.size] > 0
    push = np.zeros(x.size)
    push[ORDER:] = _past(drive) @ weights[ORDER:-1] + weights[-1]
    y = x.copy()
    begins = np.flatnonzero(fresh[: x.size])
    denominator = np.concatenate([[1.0], -weights[:ORDER]])
    for first, last in zip(begins, [*begins[1:], x.size - 1], strict=True):
        if last > first and first >= ORDER - 1:
            before = lfiltic([1.0], denominator, x[first - ORDER + 1 : first + 1][::-1])
            run = push[first + 1 : last + 1]
            y[first + 1 : last + 1] = lfilter([1.0], denominator, run, zi=before)[0]
    return (y - x)[there]
