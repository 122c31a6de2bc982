"""What a log's channels are like, from the log alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy import signal

from hydrojax.identify.preparation.noise import estimate_noise
from hydrojax.identify.preparation.strays import runs_of, strays_in
from hydrojax.logs.log import Log
from hydrojax.rigfile.recording import position
from hydrojax.rigfile.schema import RigFile

STANDSTILL = 2e-4
"""m/s below which the piston stands: less than a bristle's travel in a tenth of a
second."""
STUCK = 0.1
"""Seconds of one and the same reading from which a noisy sensor is stuck."""
READINGS = 4.5
"""Readings of one value up to which that may be chance."""
REST = 3.0
"""Steps of a sensor up to which its next reading may be the same signal at rest."""
JUMP = 3.0
"""Times the next step on, from which a step out of a run of one reading is a jump."""
DEAD = 0.99
"""Share of readings equal to the one before from which a sensor is dead."""
CLIPPED = 1e-3
"""Share of the readings at an end of the range, in runs, from which it is clipped."""
ROLL_OFF = 6.0
"""Decibels by which noise falls toward half the rate beyond the other channels'."""
VACUUM = -0.9e5
"""Pa of a gauge below which no oil can be."""

SENSORS = ("P_a1", "P_a2", "P_s", "P_r", "P", "F")
"""Channels that carry noise, and rest at no value."""


@dataclass(frozen=True)
class Readings:
    """One channel over all logs; SI.

    Attributes:
        unit: of all that has one.
        low: smallest reading.
        high: largest reading.
        resolution: smallest step between two readings.
        noise: standard deviation of the white part, from sixth differences.
        repeated: share of readings equal to the one before.
        at_ends: share of readings at the smallest or largest value, in runs of three.
        stuck: the longest run of one reading that begins or ends with a jump, s.
        roll_off: by how many decibels power falls from a third of the rate to half.
        below_vacuum: share of readings that no oil can have; 0 for what is no pressure.
        strays: share of readings that jump away and back, of one value meanwhile.
    """

    unit: str
    low: float
    high: float
    resolution: float
    noise: float
    repeated: float
    at_ends: float
    stuck: float
    roll_off: float
    below_vacuum: float
    strays: float


def log_table(logs: Sequence[Log], spec: RigFile) -> pd.DataFrame:
    """One row a log: `seconds`, `rows`, `rate` (Hz), `jitter` (of the step, relative),
    `stretches` without a gap, `standstill` (share of the time).
    """
    rows = {}
    for log in logs:
        step = np.diff(log.time)
        h = float(np.median(step))
        x = position(log, spec)
        wide = max(int(0.05 / h), 1)
        v = np.abs(x[wide:] - x[:-wide]) / (wide * h)
        rows[log.name] = {
            "seconds": float(log.time[-1] - log.time[0]),
            "rows": len(log.time),
            "rate": 1 / h,
            "jitter": float(np.std(step[step < 2.5 * h]) / h),
            "stretches": len(log.segments),
            "standstill": float(np.mean(v < STANDSTILL)) if len(v) else 0.0,
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("log")


def channel_table(logs: Sequence[Log]) -> pd.DataFrame:
    """One row a channel; the columns are the attributes of `Readings`."""
    names = [n for n in logs[0].signals if all(n in log.signals for log in logs)]
    rows = {n: vars(_channel(n, logs)) for n in names}
    order = [f.name for f in fields(Readings)]
    return pd.DataFrame.from_dict(rows, orient="index", columns=order).rename_axis(
        "channel"
    )


def _channel(name: str, logs: Sequence[Log]) -> Readings:
    pieces = [
        (float(np.median(np.diff(log.time))), log.signals[name][slice(*rows)])
        for log in logs
        for rows in log.segments
    ]
    whole = np.concatenate([y for _, y in pieces])
    low, high = float(np.min(whole)), float(np.max(whole))
    steps = np.diff(np.unique(whole))
    steps = steps[steps > 1e-12 * max(high - low, 1e-300)]
    resolution = float(np.min(steps, initial=high - low))
    repeated = float(np.mean(np.diff(whole) == 0))
    rest = REST * resolution if repeated < DEAD else 0.0
    runs = [runs_of(y) for _, y in pieces]
    longest = max(
        h * _longest_hold(y, r, rest) for (h, y), r in zip(pieces, runs, strict=True)
    )
    held = np.concatenate([np.repeat(r, r) for r in runs])
    ends = np.concatenate([(y == y.min()) | (y == y.max()) for _, y in pieces])
    loud = [estimate_noise(y) for _, y in pieces if np.ptp(y) > 0 and len(y) > 7]
    strays = np.concatenate(
        [strays_in(y, r) for (_, y), r in zip(pieces, runs, strict=True)]
    )
    pressure = name.startswith("P_")
    return Readings(
        logs[0].units.get(name, ""),
        low,
        high,
        resolution,
        float(np.median(loud)) if loud else 0.0,
        repeated,
        float(np.mean(ends & (held >= 3))),
        longest,
        max((_roll_off(y) for _, y in pieces if np.ptp(y) > 0), default=0.0),
        float(np.mean(whole < VACUUM)) if pressure else 0.0,
        float(np.mean(strays)),
    )


def _longest_hold(y: Float[np.ndarray, "rows"], runs: np.ndarray, step: float) -> int:
    """Ticks of the longest run of one reading that begins or ends with a jump: a step
    that what moves beyond it does not explain.
    """
    size, ends = np.abs(np.pad(np.diff(y), 1)), np.cumsum(runs)[:-1]
    after = (size[ends] > step) & (size[ends] > JUMP * size[ends + 1])
    into = (size[ends] > step) & (size[ends] > JUMP * size[ends - 1])
    around = np.concatenate([[False], into]) | np.concatenate([after, [False]])
    return int(np.max(runs[around], initial=1))


def _roll_off(y: Float[np.ndarray, "rows"]) -> float:
    if len(y) < 64:
        return 0.0
    f, power = signal.welch(y, 1.0, nperseg=min(512, len(y)), detrend="linear")
    middle = np.mean(power[(f > 0.28) & (f < 0.36)])
    end = np.mean(power[(f > 0.43) & (f < 0.49)])
    return float(10 * np.log10(max(middle, 1e-300) / max(end, 1e-300)))
