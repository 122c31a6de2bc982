"""Programs timed in turns: medians, quartiles, ratios of runs side by side.

A shared machine is faster at one moment than at the next. So all programs run once in
every round, and a ratio is taken within a round before its median is.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median, quantiles
from typing import Any

Clock = Callable[[], float]

Rounds = dict[str, list[float]]
"""Seconds by program, one a round."""


@dataclass(frozen=True)
class Spread:
    """A median with its quartiles, and of how many values."""

    median: float
    lower: float
    upper: float
    count: int

    def times(self, factor: float) -> Spread:
        """The same in another unit."""
        ends = (self.median * factor, self.lower * factor, self.upper * factor)
        return Spread(*ends, self.count)


def spread(values: Sequence[float]) -> Spread:
    """Median and quartiles; of one value both are the value itself.

    Raises:
        ValueError: no value.
    """
    if not values:
        raise ValueError("nothing was timed")
    if len(values) == 1:
        return Spread(values[0], values[0], values[0], 1)
    lower, _, upper = quantiles(values, n=4, method="inclusive")
    return Spread(median(values), lower, upper, len(values))


def ratio(of: Sequence[float], to: Sequence[float]) -> Spread:
    """How many times `to` the values `of` are, round by round.

    Raises:
        ValueError: they were not timed in the same rounds.
    """
    return spread([a / b for a, b in zip(of, to, strict=True)])


def interleave(
    programs: Mapping[str, Callable[[], float]],
    rounds: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Rounds:
    """Run every program once a round, each round in another order.

    Args:
        programs: by name; each runs once and says how many seconds that took.
        rounds: how many.
        progress: called with the rounds done and their total number.
    """
    names, out = list(programs), {name: [] for name in programs}
    for i in range(rounds):
        progress(i, rounds)
        turn = i % len(names) if names else 0
        for name in names[turn:] + names[:turn]:
            out[name].append(programs[name]())
    return out


def timed(
    call: Callable[[], Any], least: float = 0.0, clock: Clock = time.perf_counter
) -> float:
    """Seconds of one call: the mean of as many as take `least` seconds together."""
    began, count = clock(), 0
    while True:
        call()
        count += 1
        passed = clock() - began
        if passed >= least:
            return passed / count


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Of log y over log x: 1 is in proportion, 0 is flat; NaN for fewer than two."""
    if len(x) < 2:
        return math.nan
    u, v = ([math.log(a) for a in values] for values in (x, y))
    mean_u, mean_v = sum(u) / len(u), sum(v) / len(v)
    over = sum((a - mean_u) * (b - mean_v) for a, b in zip(u, v, strict=True))
    return over / sum((a - mean_u) ** 2 for a in u)


# -- of this process --


def forget_peak() -> None:
    """Start the peak of memory anew, where the system can (Linux)."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_mib() -> float:
    """The most memory this process has held, MiB, since `forget_peak`."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
        high = next(line for line in lines if line.startswith("VmHWM"))
        return int(high.split()[1]) / 1024
    except (OSError, StopIteration):
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def device_mib() -> float | None:
    """The most memory taken of the device that JAX runs on; None where it is the
    host's own.
    """
    import jax

    taken = jax.devices()[0].memory_stats()
    return taken["peak_bytes_in_use"] / 2**20 if taken else None


class Compiling:
    """Seconds in which XLA compiled, summed since it was made."""

    EVENT = "/jax/core/compile/backend_compile_duration"

    def __init__(self):
        import jax

        self.seconds = 0.0
        jax.monitoring.register_event_duration_secs_listener(self._heard)

    def _heard(self, event: str, duration_secs: float, **_: str | int) -> None:
        if event == self.EVENT:
            self.seconds += duration_secs


# -- goals --


@dataclass(frozen=True)
class Goal:
    """What a ratio (or a number of seconds, or of MiB) must be.

    `most` True: at most `limit`; False: at least.
    """

    limit: float
    most: bool = True

    def met(self, value: float) -> bool:
        """Whether a median keeps it."""
        return value <= self.limit if self.most else value >= self.limit

    def __str__(self) -> str:
        return f"{'≤' if self.most else '≥'} {self.limit:g}"


def figure(says: str, value: Spread, unit: str, goal: Goal | None = None) -> dict:
    """One figure that is asked for, as plain data."""
    held = {"goal": str(goal), "met": goal.met(value.median)} if goal else {}
    return {"says": says, "unit": unit, **asdict(value), **held}
