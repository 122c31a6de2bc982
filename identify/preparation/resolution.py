"""What drives a replay and is measured coarsely: its noise taken off as far as it goes,
and the remainder counted into the noise of the channels.

Oil and bristle answer a micrometre of the piston by some 10 kPa and 20 N. The paper's
encoder resolves 0.06 um; one of 17 bits, or a potentiometer, some microns. Pressures
and force are then predicted worse than they are measured, and a trace would find
effects that are the sensor's. So it is with pressures that drive: a lag smooths their
noise, and would be taken for one of the load cell.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from hydrojax.identify.estimation.balance import balanced
from hydrojax.identify.estimation.columns import batch_of
from hydrojax.identify.estimation.coupled import answer
from hydrojax.identify.estimation.fit import fit_all
from hydrojax.identify.estimation.known import free_parameters
from hydrojax.identify.estimation.problem import Problem, in_play
from hydrojax.identify.preparation.data import Data
from hydrojax.identify.preparation.noise import (
    CHANNELS,
    Noise,
    SensorNoise,
    force_areas,
    level,
    sensor_noise_of,
)
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.logs.log import Log
from hydrojax.plant.rig import Rig
from hydrojax.rigfile.build import build_rig
from hydrojax.rigfile.recording import position
from hydrojax.rigfile.schema import RigFile

Change = Callable[
    [Float[np.ndarray, "rows"], Float[np.ndarray, "rows"]], Float[np.ndarray, "rows"]
]
"""What makes another signal of times (s) and a signal."""


Values = Float[np.ndarray, "n"]

NoiseBy = Callable[[Problem, Values], Noise]
"""The channels' noise, SI, with what the position's brings by a model there."""


@dataclass(frozen=True)
class Resolved:
    """Logs with what drives them as good as it gets, and those to fit made ready, with
    the remainder of its noise in that of the channels.

    `check_noise` is the channels' noise in the logs that take no part; `smoothed` does
    the same to a log that took no part in it; `noise_by` is the noise by another model;
    `twice` are the logs to fit as they are, and with their position measured once more;
    `still` is that of `prepare_logs`.
    """

    logs: tuple[Log, ...]
    fit: Data
    check_noise: Float[np.ndarray, "3"]
    notes: tuple[str, ...] = ()
    smoothed: Callable[[Log], Log] = lambda log: log
    noise_by: NoiseBy | None = None
    twice: tuple[Data, Data] | None = None
    still: float = 0.0


WILD = 2.0
"""RMS in a window over that which nine in ten windows stay below, from which a replay
is taken to have run into an end there."""

AT_REST = 3.0
"""Standard deviations of what is left of a position's noise within which a piston is
taken to rest, for friction: a bristle goes by the way that was covered, and forgets on
the way that noise makes of a rest."""

SHAKEN = 0.1
"""Share of the largest change of position from which a window's counts as one: a sensor
that only rounds says the same again at rest."""


@runtime_checkable
class Ready(Protocol):
    """What makes logs ready, as `prepare_logs` does."""

    def __call__(
        self,
        logs: Sequence[Log],
        noise: Float[np.ndarray, "3"],
        sign: float = 1.0,
        placed: Sequence[Log] | None = None,
        still: float = 0.0,
    ) -> Data:
        """Logs with a noise of their channels, SI."""
        ...


def resolve(
    logs: tuple[Log, ...],
    count: int,
    spec: RigFile,
    fit: Data,
    ready: Ready,
    criteria: Criteria = Criteria(),
) -> Resolved:
    """Smooth what drives the logs where its noise shows in what is replayed.

    That is the position where u drives, or the pressures where they do; a log that P
    drives is compared in a band of its own already.

    Args:
        logs: all of them; the first `count` are to be fitted, the others take no part
            but for how noisy they are.
        count: see `logs`.
        spec: the rig they were recorded on.
        fit: what the logs to fit gave as they are.
        ready: see `Ready`.
        criteria: from which noise on it is dealt with.
    """
    found = None
    if fit.driven_by == "u":
        found = _position(logs, count, spec, fit, ready, criteria)
    elif fit.driven_by == "pressures":
        found = _drive(logs, spec, criteria)
    if found is None:
        return Resolved(logs, fit, fit.noise)
    fit = ready(found.logs[:count], found.noise.fit, still=found.still)
    return Resolved(
        found.logs,
        fit,
        found.noise.check,
        (found.note,),
        found.change,
        found.noise_by,
        found.twice,
        found.still,
    )


class Smoothed(NamedTuple):
    """Logs with what drives smoothed, the channels' noise with it, SI, a remark,
    what smooths another log, the noise by another model, and `twice` and `still` of
    `Resolved`.
    """

    logs: tuple[Log, ...]
    noise: Noise
    note: str
    change: Callable[[Log], Log]
    noise_by: NoiseBy | None = None
    twice: tuple[Data, Data] | None = None
    still: float = 0.0


def _position(
    logs: tuple[Log, ...],
    count: int,
    spec: RigFile,
    fit: Data,
    ready: Ready,
    criteria: Criteria,
) -> Smoothed | None:
    """Smooth the position; None where its noise does not show."""
    noise, rig = fit.noise, build_rig(spec)
    sensor_noise = sensor_noise_of(
        _stretches(logs, lambda log: position(log, spec), criteria), criteria
    )
    if sensor_noise is None or not _matters(sensor_noise, rig, fit, criteria):
        return None

    def of(log: Log) -> SensorNoise:
        return _noise_of(log, spec, sensor_noise, criteria)

    def change(log: Log) -> Log:
        return _moved(log, spec, of(log).smoothed, criteria)

    smoothed, noises = tuple(map(change, logs)), tuple(map(of, logs))
    still = AT_REST * max(b.left(_tick(logs)) for b in noises)
    ready = partial(ready, still=still)
    again = _drawn_again(smoothed, noises, spec, criteria)
    both = [
        (
            ready(smoothed[own], noise),
            *(ready(drawn[own], noise, placed=smoothed[own]) for drawn in again),
        )
        for own in (slice(count), slice(count, None))
        if smoothed[own]
    ]

    def problem_of(data: Data) -> Problem:
        return Problem.of(rig, free_parameters(spec), data, criteria)

    def brought(problem: Problem, values: np.ndarray) -> np.ndarray:
        """[2, 3]: what it brings into the logs to fit, and into those to validate."""
        return np.array([_brought(problem, values, *pair) for pair in both])[[0, -1]]

    def noise_by(problem: Problem, values: np.ndarray) -> Noise:
        return Noise(*np.hypot(noise, brought(problem, values)))

    # How far the position moves the channels depends on what the rig is: that of the
    # file may be off, and one fitted without what it lacks may be distorted.
    problem = problem_of(both[0][0])
    extra = brought(problem, start := problem.initial_values())
    if not np.isfinite(extra[:, np.isfinite(noise)]).all():
        return None  # the fit will say that the model has no finite answer
    data = ready(smoothed[:count], np.hypot(noise, extra[0]))
    problem = problem_of(data)
    values = _roughly_fitted(problem, start, in_play(problem, data))
    found = brought(problem, values)
    found = np.where(np.isfinite(found), found, extra)
    extra = np.clip(extra, found, criteria.distorted * found)
    note, twice = _position_note(noises, noise, extra), (both[0][0], both[0][1])
    whole = Noise(*np.hypot(noise, extra))
    return Smoothed(smoothed, whole, note, change, noise_by, twice, still)


def _tick(logs: Sequence[Log]) -> float:
    """The logs' median step, s."""
    return float(np.median(np.concatenate([np.diff(log.time) for log in logs])))


def _drawn_again(
    smoothed: tuple[Log, ...],
    noises: tuple[SensorNoise, ...],
    spec: RigFile,
    criteria: Criteria,
) -> list[tuple[Log, ...]]:
    """The smoothed logs with their position measured once more, as often as counts."""
    return [
        tuple(
            _moved(log, spec, partial(_again, own, seed), criteria)
            for log, own in zip(smoothed, noises, strict=True)
        )
        for seed in range(criteria.position_draws)
    ]


def _noise_of(
    log: Log, spec: RigFile, common: SensorNoise, criteria: Criteria
) -> SensorNoise:
    """The position's noise of a log, in size its own, and where to smooth it: some are
    noisier than others, and a fast motion reaches beyond where a slow one has ended.
    """
    pieces = _stretches([log], lambda log: position(log, spec), criteria)
    own = sensor_noise_of(pieces, criteria)
    return replace(own, step=common.step) if own else common


def _brought(
    problem: Problem, values: np.ndarray, one: Data, *others: Data
) -> Float[np.ndarray, "3"]:
    """How far apart replays of the same logs with one position and with others are,
    RMS by channel, SI; of the one that is furthest off, as the noise of one recording
    may be: what it brings stands in a few windows.
    """
    left, *moved = (
        replace(problem, batch=batch_of(data)).residuals_at(values)
        for data in (one, *others)
    )
    found = []
    for other, theirs in zip(others, moved, strict=True):
        shaken = np.sqrt(np.mean((other.windows.x - one.windows.x) ** 2, axis=1))
        largest = np.max(shaken, initial=0.0)
        found.append(_largest(theirs - left, one.log, shaken > SHAKEN * largest))
    return np.max(found, axis=0)


def _position_note(
    noises: Sequence[SensorNoise], noise: np.ndarray, extra: np.ndarray
) -> str:
    """What is said of the position's noise in the logs; `extra` [2, 3] is what it
    brings, into those to fit and those to validate.
    """
    moves = ", ".join(
        f"{name} by {size / per:.2g} {unit}"
        for name, size, per, unit in zip(
            CHANNELS,
            np.max(extra, axis=0),
            (1e3, 1e3, 1.0),
            ("kPa", "kPa", "N"),
            strict=True,
        )
        if np.isfinite(noise[CHANNELS.index(name)])
    )
    return (
        f"the position is known to {1e6 * np.median([b.sigma for b in noises]):.2g} "
        f"um: {_said(noises)} by a first fit, what is left of its noise moves {moves} "
        "RMS, in the fitted or in the validation logs, whichever is more; what it "
        "moves in each of the two, or would by the model found, is counted into their "
        "noise there"
    )


def _roughly_fitted(
    problem: Problem, values: Float[np.ndarray, "n"], free: Sequence[str]
) -> Float[np.ndarray, "n"]:
    """Values near a fit: flow balances, then mechanics by themselves."""
    if not problem.sees_pressures:
        return fit_all(problem, values, free)[1].values
    if problem.side(free, True):
        values = balanced(problem, values, free)
    mechanical, noise = problem.side(free, False), np.asarray(problem.batch.noise)
    if mechanical and np.isfinite(noise[2]):
        values, _ = problem.solve(values, mechanical, noise)
    return values


def _drive(logs: tuple[Log, ...], spec: RigFile, criteria: Criteria) -> Smoothed | None:
    """Smooth pressures that drive; None where their noise does not show in F."""
    has = logs[0].signals
    own = spec.sensors.get("F", level(logs, "F") if "F" in has else 0.0)
    areas: dict[str, float] = dict(
        zip(("P_a1", "P_a2"), force_areas(spec), strict=True)
    )
    noises: dict[str, SensorNoise] = {}
    for name in (n for n in areas if n in has and areas[n] > 0):
        pieces = _stretches(logs, lambda log, name=name: log.signals[name], criteria)
        if sensor_noise := sensor_noise_of(pieces, criteria):
            noises[name] = sensor_noise
    if (
        np.linalg.norm([areas[n] * b.sigma for n, b in noises.items()])
        <= criteria.sensor_counts * own
    ):
        return None
    silent = [n for n in areas if n in has and n not in noises]
    square = own**2 + sum((areas[n] * level(logs, n)) ** 2 for n in silent)
    for name, sensor_noise in noises.items():
        logs = tuple(
            _smoothed(log, name, sensor_noise.smoothed, criteria) for log in logs
        )
        again = (
            _smoothed(log, name, partial(_again, sensor_noise, 0), criteria)
            for log in logs
        )
        off = [
            np.sqrt(np.mean((b - a) ** 2))
            for (_, a), (_, b) in zip(
                _stretches(logs, lambda log, name=name: log.signals[name], criteria),
                _stretches(
                    tuple(again), lambda log, name=name: log.signals[name], criteria
                ),
                strict=True,
            )
        ]
        square += (areas[name] * max(off)) ** 2
    known = ", ".join(f"{n} by {b.sigma / 1e3:.2g} kPa" for n, b in noises.items())
    note = (
        f"the pressures drive, and are noisy ({known}): "
        f"{_said([min(noises.values(), key=lambda b: b.cut)])} what is left moves F by "
        f"{np.sqrt(square - own**2):.2g} N RMS, which is counted into its noise"
    )

    def change(log: Log) -> Log:
        for name, sensor_noise in noises.items():
            log = _smoothed(log, name, sensor_noise.smoothed, criteria)
        return log

    noise = np.array([np.inf, np.inf, np.sqrt(square)])
    return Smoothed(logs, Noise(noise, noise), note, change)


def _said(noises: Sequence[SensorNoise]) -> str:
    """Where signals are smoothed, each at its own frequency."""
    cuts = [f"{b.cut:.0f}" for b in sorted(noises, key=lambda b: b.cut)]
    cuts = [cut for cut in cuts if cut != "inf"]
    if not cuts:
        return "smoothing would not help;"
    return f"smoothed above {' to '.join(dict.fromkeys((cuts[0], cuts[-1])))} Hz;"


def _smoothed(log: Log, name: str, change: Change, criteria: Criteria) -> Log:
    """The log with one of its signals changed."""
    values = _changed(log, log.signals[name], change, criteria)
    return replace(log, signals={**log.signals, name: values})


def _stretches(
    logs: Sequence[Log], values: Callable[[Log], np.ndarray], criteria: Criteria
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Time and a signal in every stretch without gaps."""
    for log in logs:
        y = values(log)
        for start, stop in log.segments:
            if stop - start > criteria.fewest_rows:
                yield log.time[start:stop], y[start:stop]


def _again(
    sensor_noise: SensorNoise, seed: int, t: np.ndarray, y: np.ndarray
) -> np.ndarray:
    """A smoothed signal measured once more by such a sensor, and smoothed again.

    Beside it as it is, this shows what noise is left, and what smoothing takes off.
    """
    return sensor_noise.smoothed(t, sensor_noise.again(y, seed))


def _matters(
    sensor_noise: SensorNoise, rig: Rig, data: Data, criteria: Criteria
) -> bool:
    """Whether what the position brings as it is shows beside a channel's noise, by the
    rig's declared values.
    """
    brings = sensor_noise.sigma * answer(rig, batch_of(data))
    return bool(np.any(brings > criteria.sensor_counts * data.noise))


def _largest(change: np.ndarray, log: np.ndarray, shaken: np.ndarray) -> np.ndarray:
    """RMS by channel, [3], of [W, T, 3], in that of the logs where it is largest.

    A replay that is off may run into a supply, a tank or an end in some window, where
    the least change decides: no window counts for more than `WILD` times the RMS that
    nine in ten stay below, of those in which the position changed (`shaken`, [W]).
    """
    square = np.mean(change**2, axis=1)
    each = [_mean_of_most(square[log == i], shaken[log == i]) for i in np.unique(log)]
    return np.sqrt(np.max(each, axis=0))


def _mean_of_most(square: np.ndarray, shaken: np.ndarray) -> np.ndarray:
    if not shaken.any():
        return np.mean(square, axis=0)
    most = WILD**2 * np.quantile(square[shaken], 0.9, axis=0)
    return np.mean(np.minimum(square, most), axis=0)


def _moved(log: Log, spec: RigFile, change: Change, criteria: Criteria) -> Log:
    """The log with its position changed, m."""
    key = log.motion
    zero = spec.geometry.get("x_mid", 0.0) if key == "x" else 0.0
    radius = 1.0 if key == "x" else spec.geometry["radius"]
    x = _changed(log, position(log, spec), change, criteria)
    return replace(log, signals={**log.signals, key: (x + zero) / radius})


def _changed(log: Log, y: np.ndarray, change: Change, criteria: Criteria) -> np.ndarray:
    """A log's signal changed in every stretch: `change(t, y)`."""
    y = y.copy()
    for start, stop in log.segments:
        if stop - start > criteria.fewest_rows:
            own = slice(start, stop)
            y[own] = change(log.time[own], y[own])
    return y
