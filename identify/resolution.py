"""A position that is measured coarsely: its noise taken off as far as it goes, and
what is left of it counted into the noise of the channels.

Oil and bristle answer a micrometre of the piston by some 10 kPa and 20 N. The paper's
encoder resolves 0.06 um; one of 17 bits, or a potentiometer, some microns. Pressures
and force are then foreseen worse than they are measured, and a trace would find effects
that are the sensor's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import signal

from ..build import make_effects, make_rig
from ..record import position
from ..rig import Rig
from ..rigfile import RigSpec
from ..signals import Log
from .coupled import answer
from .fit import fit as fit_all
from .measured import CHANNELS, smooth
from .prepare import Data
from .problem import Problem, batch_of, free_parameters, in_play

FLAT = 1.5
"""How much a spectrum's last fifth may fall below its middle and still be a floor."""

SPARE = 1.5
"""Times the best cut at which the spline is set: it begins to smooth well below."""

COUNTS = 0.3
"""Share of a channel's noise that the position must bring to be dealt with."""


@dataclass(frozen=True)
class Blur:
    """The noise of a measured position.

    Attributes:
        sigma: its standard deviation, m, as far as it is white.
        step: m, between the values that the sensor gives, where that makes the noise; 0
            where it does not.
        cut: Hz, up to which motion stands clear of the noise.
    """

    sigma: float
    step: float
    cut: float


@dataclass(frozen=True)
class Resolved:
    """Logs with the position as good as it gets, and those to fit made ready, with what
    is left of the position's noise in that of the channels.
    """

    fitted: tuple[Log, ...]
    others: tuple[Log, ...]
    fit: Data
    notes: tuple[str, ...] = ()


def resolve(
    fitted: tuple[Log, ...],
    others: tuple[Log, ...],
    spec: RigSpec,
    fit: Data,
    ready: Callable[[Sequence[Log], np.ndarray], Data],
) -> Resolved:
    """Smooth the position where its noise shows in what it drives.

    For logs that u drives: otherwise the motion is taken in a band of its own already.

    Args:
        fitted: the logs to fit.
        others: logs that take no part, but for how noisy they are.
        spec: the rig they were recorded on.
        fit: what the logs to fit gave as they are.
        ready: makes logs ready, with a noise of the channels [3].
    """
    noise, logs = fit.noise, (*fitted, *others)
    blur = blur_of(logs, spec)
    rig = make_rig(spec, make_effects(spec.effects, spec, fit.travel))
    if blur is None or not _matters(blur, rig, fit):
        return Resolved(fitted, others, fit)
    calm = tuple(_calmed(log, spec, blur) for log in logs)
    fitted, others = calm[: len(fitted)], calm[len(fitted) :]
    again = [_calmed(_measured(log, spec, blur), spec, blur) for log in calm]

    def problem_of(data: Data) -> Problem:
        return Problem.of(rig, free_parameters(spec), data)

    one, other = ready(calm, noise), ready(again, noise)

    def brought(values: np.ndarray) -> np.ndarray:
        left = [problem_of(data).residuals_at(values) for data in (one, other)]
        return _largest(left[1] - left[0], one.log)

    # How far the position moves the channels depends on what the rig is: that of the
    # file may be off, and one that is fitted without what it lacks may be bent.
    start = problem_of(one).initial_values()
    extra = brought(start)
    data = ready(fitted, np.hypot(noise, extra))
    problem = problem_of(data)
    _, point = fit_all(problem, start, in_play(problem, data))
    extra = np.maximum(extra, brought(point.values))
    moves = ", ".join(
        f"{name} by {size / per:.2g} {unit}"
        for name, size, per, unit in zip(
            CHANNELS, extra, (1e3, 1e3, 1.0), ("kPa", "kPa", "N"), strict=True
        )
        if np.isfinite(noise[CHANNELS.index(name)])
    )
    note = (
        f"the position is known to {1e6 * blur.sigma:.2g} um: it was smoothed above "
        f"{blur.cut:.0f} Hz; what is left of its noise moves {moves} RMS, which is "
        "counted into their noise"
    )
    data = replace(data, noise=np.hypot(noise, extra))
    return Resolved(fitted, others, data, (note,))


def blur_of(logs: Sequence[Log], spec: RigSpec) -> Blur | None:
    """The position's noise, the median over the logs' stretches; None where there is no
    frequency above which a log holds nothing else.
    """
    found = [b for log in logs for rows in log.segments if (b := _one(log, spec, rows))]
    if not found:
        return None
    sigma, step, cut = np.median([(b.sigma, b.step, b.cut) for b in found], axis=0)
    return Blur(float(sigma), float(step), float(cut))


def _one(log: Log, spec: RigSpec, rows: tuple[int, int]) -> Blur | None:
    t, x = log.time[slice(*rows)], position(log, spec)[slice(*rows)]
    h = float(np.median(np.diff(t)))
    even = np.interp(np.arange(t[0], t[-1], h), t, x)
    f, power = signal.welch(even, 1 / h, nperseg=min(2048, even.size), detrend="linear")
    end = f[-1]
    floor = float(np.median(power[f > 0.8 * end]))
    if floor <= 0 or np.median(power[(f > 0.4 * end) & (f < 0.6 * end)]) > FLAT * floor:
        return None
    # Least squares: the motion that is lost above a cut, and the noise kept below it.
    lost = np.cumsum(np.maximum(power - floor, 0.0)[::-1])[::-1]
    sigma = np.sqrt(floor * end)
    cut = SPARE * f[np.argmin(lost + floor * np.arange(f.size))]
    if cut > 0.4 / h:
        return None
    steps = np.diff(np.unique(x))
    step = float(np.min(steps[steps > 1e-12 * np.ptp(x)]))
    return Blur(float(sigma), step if step / np.sqrt(12) > 0.5 * sigma else 0.0, cut)


def _matters(blur: Blur, rig: Rig, data: Data) -> bool:
    """Whether what the position brings once smoothed shows beside a channel's noise, by
    the rig's declared values.
    """
    h = float(np.median(data.motion.h))
    left = blur.sigma * np.sqrt(min(2 * blur.cut * h, 1.0))
    return bool(np.any(left * answer(rig, batch_of(data)) > COUNTS * data.noise))


def _calmed(log: Log, spec: RigSpec, blur: Blur) -> Log:
    """The log with its position smoothed up to where motion sinks in the noise."""

    def calm(t: np.ndarray, x: np.ndarray) -> np.ndarray:
        return smooth(t, x, blur.cut)(t)

    return _replaced(log, spec, calm)


def _measured(log: Log, spec: RigSpec, blur: Blur) -> Log:
    """The log with its position measured once more by such a sensor."""
    draw = np.random.default_rng(0)

    def measured(t: np.ndarray, x: np.ndarray) -> np.ndarray:
        if blur.step:
            offset = draw.uniform()
            return (np.round(x / blur.step + offset) - offset) * blur.step
        return x + blur.sigma * draw.normal(size=x.size)

    return _replaced(log, spec, measured)


def _largest(change: np.ndarray, log: np.ndarray) -> np.ndarray:
    """RMS by channel, [3], of [W, T, 3], in that of the logs where it is largest."""
    square = np.mean(change**2, axis=1)
    return np.sqrt(np.max([square[log == i].mean(0) for i in np.unique(log)], axis=0))


def _replaced(
    log: Log, spec: RigSpec, change: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> Log:
    """The log with its position changed, stretch by stretch: `change(t, x)`, m."""
    key = "x" if "x" in log.signals else "psi"
    zero = spec.geometry.get("x_mid", 0.0) if key == "x" else 0.0
    radius = 1.0 if key == "x" else spec.geometry["radius"]
    values, x = log.signals[key].copy(), position(log, spec)
    for rows in log.segments:
        own = slice(*rows)
        values[own] = (change(log.time[own], x[own]) + zero) / radius
    return replace(log, signals={**log.signals, key: values})
