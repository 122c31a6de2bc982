"""Channels of different rates on common ticks, as a replay of the log needs them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from hydrojax.errors import InputError
from hydrojax.logs.clocks import SAME, WHOLE, Stream, by_one_clock

_AS_FAST = 1.33  # periods of motion and command within this ratio count as equal


def on_one_base(
    streams: Sequence[Stream],
) -> tuple[
    Float[np.ndarray, "ticks"], dict[str, Float[np.ndarray, "ticks"]], list[str]
]:
    """Bring all signals to the ticks of one of the topics.

    The base is the command's topic, so that the command is as it was sent; where the
    motion comes more slowly, the motion's, since a speed between its samples would be
    invented. `u` is held from one message to the next, and the mean over a tick is
    taken. The others are sampled at the ticks: as they are where stamps agree,
    otherwise linearly between neighbours; a wider gap is NaN. A clock that drifts
    against the base's beyond doubt, or has another zero, is brought to the base's.

    Args:
        streams: at least one, each of some signals.

    Returns:
        Time of the ticks, s; each signal at them; remarks.

    Raises:
        InputError: less than two samples of a topic, or no time common to all.
    """
    tidied = [_tidy(s) for s in streams]
    notes = [note for _, remarks in tidied for note in remarks]
    streams = [s for s, _ in tidied]
    base = _base(streams)
    times, remarks = by_one_clock(streams, base)
    notes += remarks
    ticks = _common(streams, times, times[base.topic])
    signals: dict[str, np.ndarray] = {}
    for stream in streams:
        for name, values in stream.values.items():
            if stream is base:
                kept = np.isin(times[base.topic], ticks)
                signals[name] = values[kept]
            elif name == "u":
                longest = WHOLE * stream.period if stream.steady else np.inf
                signals[name] = held(times[stream.topic], values, ticks, longest)
            else:
                signals[name] = sampled(times[stream.topic], values, ticks)
        notes += _rate(stream, base, times[stream.topic], ticks)
    return *_without_single_holes(ticks, signals, notes), notes


def sampled(
    time: Float[np.ndarray, "samples"],
    values: Float[np.ndarray, "samples"],
    ticks: Float[np.ndarray, "ticks"],
) -> Float[np.ndarray, "ticks"]:
    """A signal at `ticks`: a sample, or the line between two; NaN in gaps.

    Args:
        time: of the samples, s, rising.
        values: the samples.
        ticks: s, rising.
    """
    after = np.clip(np.searchsorted(time, ticks), 1, len(time) - 1)
    step = np.diff(time)[after - 1]
    share = (ticks - time[after - 1]) / step
    out = values[after - 1] + share * np.diff(values)[after - 1]
    period = np.median(np.diff(time))
    out[(step > WHOLE * period) | (share < 0.0) | (share > 1.0)] = np.nan
    near = np.where(share > 0.5, after, after - 1)
    return np.where(_same(time, near, ticks), values[near], out)


def _same(time: np.ndarray, near: np.ndarray, ticks: np.ndarray) -> np.ndarray:
    """Whether samples, [m] indices into `time`, are at their ticks, [m]."""
    period = min(np.median(np.diff(of)) for of in (time, ticks) if len(of) > 1)
    return np.abs(time[near] - ticks) <= SAME * period


def held(
    time: Float[np.ndarray, "samples"],
    values: Float[np.ndarray, "samples"],
    ticks: Float[np.ndarray, "ticks"],
    longest: float = np.inf,
) -> Float[np.ndarray, "ticks"]:
    """The mean over each tick of a signal that is held between its samples.

    NaN before the first sample, and where one is held for more than `longest` s.

    Args:
        time: of the samples, s, rising.
        values: the samples.
        ticks: s, rising; a tick before a gap lasts the median step.
        longest: s.
    """
    steps = np.diff(ticks)
    usual = np.median(steps) if len(steps) else 0.0
    ends = ticks + np.append(np.minimum(steps, WHOLE * usual), usual)
    last = np.append(np.diff(time), np.inf)
    unknown = np.isnan(values)

    def area(of: np.ndarray, until: np.ndarray) -> np.ndarray:
        """The integral of the held signal from `time[0]`."""
        whole = np.append(0.0, np.cumsum(of[:-1] * np.diff(time)))
        i = np.maximum(np.searchsorted(time, until, side="right") - 1, 0)
        return whole[i] + of[i] * (until - time[i])

    def mean(of: np.ndarray) -> np.ndarray:
        return (area(of, ends) - area(of, ticks)) / (ends - ticks)

    i = np.searchsorted(time, ticks, side="right") - 1
    stale = (i < 0) | ((last[i] > longest) & (ends > time[i] + longest))
    known = mean(np.where(unknown, 0.0, values))
    return np.where(stale | (mean(unknown * 1.0) > 0.0), np.nan, known)


def _tidy(stream: Stream) -> tuple[Stream, list[str]]:
    """Samples by rising stamp, repeats merged; remarks."""
    if len(stream.stamp) < 2:
        raise InputError(f"topic {stream.topic!r} has only one message; log longer")
    notes = []
    turned = int((np.diff(stream.stamp) < 0).sum())
    if turned:
        notes.append(f"{stream.topic}: messages out of order, sorted: {turned}")
    order = np.argsort(stream.stamp, kind="stable")
    stamp, first, counts = np.unique(
        stream.stamp[order], return_index=True, return_counts=True
    )
    if len(stamp) < 2:
        raise InputError(
            f"topic {stream.topic!r}: all messages have the same {stream.by}; mend its "
            "stamps, or leave them zero for the log's time to be taken"
        )
    repeats = len(order) - len(stamp)
    if repeats:
        notes.append(f"{stream.topic}: messages of equal stamp, merged: {repeats}")
    values = {}
    for name, v in stream.values.items():
        # The last command holds; of a measurement all count.
        mean = np.add.reduceat(v[order], first) / counts
        values[name] = v[order][first + counts - 1] if name == "u" else mean
    return replace(
        stream, stamp=stamp, received=stream.received[order][first], values=values
    ), notes


def _base(streams: Sequence[Stream]) -> Stream:
    """The topic whose ticks all signals are brought to."""
    own = {name: stream for stream in streams for name in stream.values}
    command = own.get("u")
    motion = own.get("psi", own.get("x"))
    if command and command.steady:
        ticks = command.period
        return motion if motion and motion.period > _AS_FAST * ticks else command
    others = [stream for stream in streams if stream is not command]
    return motion or min(others or streams, key=lambda s: s.period)


def _common(
    streams: Sequence[Stream], times: Mapping[str, np.ndarray], ticks: np.ndarray
) -> np.ndarray:
    """The base's ticks within the time of every topic that is needed."""
    needed = [s for s in streams if set(s.values) != {"F_d"}] or streams
    first = max(needed, key=lambda s: times[s.topic][0])
    # A command that comes when it changes holds to the end.
    ending = [s for s in needed if "u" not in s.values or s.steady] or needed
    last = min(ending, key=lambda s: times[s.topic][-1])
    start, stop = times[first.topic][0], times[last.topic][-1]
    slack = SAME * np.median(np.diff(ticks))
    kept = ticks[(ticks >= start - slack) & (ticks <= stop + slack)]
    if not len(kept):
        raise InputError(
            f"topic {first.topic!r} starts {start - stop:.3g} s after {last.topic!r} "
            "ends; record them together, and stamp them by one clock"
        )
    return kept


def _rate(
    stream: Stream, base: Stream, time: np.ndarray, ticks: np.ndarray
) -> list[str]:
    """Remarks on what bringing a topic to the base does to it."""
    rate = f"{1 / stream.period:.4g} Hz"
    if stream is base:
        return [f"ticks are those of {stream.topic}, {rate}"]
    notes = []
    if "u" in stream.values:
        how = f"at {rate}" if stream.steady else "now and then"
        notes.append(f"u comes {how}: it is held, and its mean over a tick taken")
    compared = sorted({"P_a1", "P_a2", "P", "F"} & set(stream.values))
    near = np.searchsorted((time[1:] + time[:-1]) / 2, ticks)
    if compared and np.mean(_same(time, near, ticks)) < 0.75:
        notes.append(
            f"{stream.topic} comes at {rate}, between the ticks: {', '.join(compared)} "
            "taken on the line between two messages, which hides some of the white "
            "noise; give the noise in [sensors]"
        )
    return notes


def _without_single_holes(
    ticks: np.ndarray, signals: Mapping[str, np.ndarray], notes: list[str]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Ticks without those at which, alone, a message was lost: time may be uneven."""
    lost = np.zeros(len(ticks), dtype=bool)
    for name, values in signals.items():
        if name != "F_d":
            lost |= np.isnan(values)
    alone = lost & ~np.append(False, lost[:-1]) & ~np.append(lost[1:], False)
    if alone.any():
        notes.append(f"single ticks left out, as a message is lost: {alone.sum()}")
    return ticks[~alone], {name: v[~alone] for name, v in signals.items()}
