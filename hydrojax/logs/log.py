"""Logs: from a file of any accepted kind, or a table, to SI arrays to be replayed.

A CSV or Parquet column is called `name [unit]`. In a MAT file the vectors are
variables called by name, at the top or in a struct `log`; their units are the fields
of a struct `units`, or variables `<name>_unit`. The rig file's [channels] may rename a
column, give its unit (which then wins over the file's), invert its sign, and say how
late it is. In an MCAP file or a ROS 2 bag it says which topic and field a signal is;
see `rosbag`.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from hydrojax.errors import WORD, InputError, one_line
from hydrojax.logs.columns import (
    Signals,
    assigned,
    check_time,
    check_values,
    merged_rows,
    segments_of,
    si_values,
    without_lone_holes,
)
from hydrojax.logs.rosbag import read_bag
from hydrojax.logs.tables import Channel, File, is_bag, read_table, table_of

SHORTEST = 0.5
"""Least length of a segment, s."""

_LEAST_ROWS = 50


@dataclass(frozen=True)
class Log:
    """One run, in SI.

    Attributes:
        name: the file's name, such as "fit_1.csv.gz".
        time: [rows] s, strictly rising, starting wherever the file does.
        signals: by the contract's names, each [rows]; NaN where the file has no number.
        units: the unit each signal is in; that of `u` is "V" or "1".
        ignored: columns that were not used.
        merged: rows that went into a neighbour of the same stamp.
        segments: [start, stop) row ranges without a gap or a NaN (`F_d`'s aside).
        notes: one-line remarks for the report.
        channels: the [channels] with which its columns were read, by signal; None for a
            log that is made of arrays, whose signals have the rig's names and signs.
        sha256: of the file's content; "" where the log is no single file.
    """

    name: str
    time: Float[np.ndarray, "rows"]
    signals: dict[str, Float[np.ndarray, "rows"]]
    units: dict[str, str]
    ignored: tuple[str, ...] = ()
    merged: int = 0
    segments: tuple[tuple[int, int], ...] = ()
    notes: tuple[str, ...] = ()
    channels: Mapping[str, Channel] | None = None
    sha256: str = ""

    @classmethod
    def load(
        cls,
        path: str | Path,
        channels: Mapping[str, Channel] | None = None,
        shortest: float = SHORTEST,
    ) -> Log:
        """Read a run from a file of `tables.TABLES`, .mcap or a bag.

        Gaps in time and missing numbers cut the run in segments: nothing is
        interpolated over them. See `rosbag.read_bag` for what brings a bag's channels
        to common rows.

        Args:
            path: the file, whose ending says what it is, or the folder of a ROS 2 bag.
            channels: where signals are that the file calls otherwise, by contract name:
                `RigFile.channels` of the rig that was logged.
            shortest: s, the least length of a segment.

        Raises:
            InputError: the file is not what its name says, lacks `time`, has fewer than
                50 rows or no segment; a signal has a missing or wrong unit, a cell that
                is no number or beyond any sensor, or does not move; time is missing,
                falls or repeats in some row (rows of one stamp of a coarse clock are
                averaged).
        """
        path, channels = Path(path), channels or {}
        if is_bag(path):
            file = read_bag(path, {name: c.column for name, c in channels.items()})
        else:
            file = read_table(path)
        log = _log_of(file, channels, shortest)
        return replace(log, sha256=_digest(path)) if path.is_file() else log

    @classmethod
    def from_frame(
        cls,
        frame: pd.DataFrame,
        units: Mapping[str, str] | None = None,
        channels: Mapping[str, Channel] | None = None,
        name: str = "frame",
        shortest: float = SHORTEST,
    ) -> Log:
        """A run from a table, checked as a file is.

        Args:
            frame: columns called by the contract's names, with the unit in the name
                (`P_a1 [bar]`) or in `units`; an index that has a name is a column too.
            units: by column; those in `frame.attrs["units"]` where it is silent.
            channels: as `load` has it.
            name: what the log is called in messages and reports.
            shortest: s, the least length of a segment.

        Raises:
            InputError: see `load`.
        """
        return _log_of(table_of(frame, units or {}, name), channels or {}, shortest)

    @property
    def motion(self) -> str:
        """The signal that the position is taken from: `x`, or else `psi`."""
        return "x" if "x" in self.signals else "psi"

    def to_frame(self) -> pd.DataFrame:
        """The signals as columns beside `time`, SI; units in `attrs["units"]`."""
        frame = pd.DataFrame({"time": self.time, **self.signals})
        frame.attrs["units"] = {"time": "s", **self.units}
        return frame


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _log_of(file: File, channels: Mapping[str, Channel], shortest: float) -> Log:
    """The log of a file's columns; it lets go of them."""
    path = file.path
    found, notes = assigned(file, channels)
    notes = [*file.notes, *notes]
    labels = {name: column.label for name, (column, _, _) in found.items()}
    used = {id(column) for column, _, _ in found.values()}
    ignored = tuple(c.label for c in file.columns if id(c) not in used)
    file.columns.clear()  # a long log is large: what is taken over is let go
    arrays, stored = {}, {}
    for name in list(found):
        column, unit, sign = found.pop(name)
        values, stored[name] = si_values(file, name, column, unit)
        arrays[name] = values if sign == 1.0 else sign * values
    check_rows(file, labels, arrays)
    coarse = check_time(file, labels["time"], arrays["time"])
    for name, values in arrays.items():
        notes += check_values(file, name, labels[name], values)
    merged = 0
    if coarse:
        arrays, merged = merged_rows(arrays)
    if merged:
        notes.append(f"rows averaged, as they share a coarse time stamp: {merged}")
    arrays, lost = without_lone_holes(arrays)
    notes += lost
    time = arrays.pop("time")
    stored.pop("time")
    late = {n: c.late for n, c in channels.items() if n in (*arrays, "time") and c.late}
    if "time" in late:
        raise InputError(
            f"{path}: [channels] time.delay: the time is not late to itself; give the "
            "delay to the channels that are"
        )
    shortest += max((0.0, *late.values())) - min((0.0, *late.values()))
    segments, cuts = segments_of(time, arrays, shortest)
    if not segments and time[-1] - time[0] < shortest:
        raise InputError(
            f"{path}: it lasts {time[-1] - time[0]:.3g} s by its column "
            f"{labels['time']!r}, and {shortest:g} s are needed; look at the unit of "
            "the time, or log longer"
        )
    if not segments:
        why = "; ".join(lost + cuts) or f"it lasts {time[-1] - time[0]:g} s"
        raise InputError(
            f"{path}: no stretch of {shortest:g} s without a gap or a missing number "
            f"({why}); log longer, or take the column with the holes out"
        )
    arrays, segments = brought_forward(time, arrays, segments, late)
    # Of "." too; bytes that are no text would end a report half way.
    name = os.fsencode(path.absolute().name).decode(errors="replace")
    name = one_line(name, WORD)
    return Log(
        name, time, arrays, stored, ignored, merged, segments, (*notes, *cuts),
        dict(channels),
    )  # fmt: skip


def with_holes(
    log: Log,
    holes: Mapping[str, Bool[np.ndarray, "rows"]],
    notes: Iterable[str],
) -> Log:
    """A log as if some readings were empty cells of its file.

    Args:
        log: as it was read.
        holes: which readings, by signal.
        notes: why, for the report.

    Returns:
        The log in other segments, without the rows of lone holes; with no segment where
        none lasts `SHORTEST`.
    """
    outside = np.ones(len(log.time), dtype=bool)
    for start, stop in log.segments:
        outside[start:stop] = False
    arrays = {
        name: np.where(holes[name], np.nan, y) if name in holes else y
        for name, y in log.signals.items()
    }
    arrays, _ = without_lone_holes(
        arrays | {"time": log.time, "outside": outside + 0.0}
    )
    outside, time = arrays.pop("outside") > 0, arrays.pop("time")
    whole = {**arrays, "inside": np.where(outside, np.nan, 0.0)}
    segments, _ = segments_of(time, whole, SHORTEST)
    return replace(
        log, time=time, signals=arrays, segments=segments, notes=(*log.notes, *notes)
    )


DEGREE = 7
"""Of the spline between a late signal's rows: white noise stays nearly white."""

EVEN = 0.2
"""Part of a tick by which rows may be uneven for such a spline: else it would swing."""


def brought_forward(
    time: Float[np.ndarray, "rows"],
    signals: Mapping[str, Float[np.ndarray, "rows"]],
    segments: Sequence[tuple[int, int]],
    late: Mapping[str, float],
) -> tuple[dict[str, Float[np.ndarray, "rows"]], tuple[tuple[int, int], ...]]:
    """Signals at the moments that they show, between whose rows they are interpolated.

    Args:
        time: s.
        signals: as they were logged, SI.
        segments: see `Log`.
        late: how late signals are, s, by name; early ones below 0.

    Returns:
        The signals, and the segments without the end of which the late ones do not
        show anything, and without the beginning that early ones do not show.
    """
    if not late:
        return dict(signals), tuple(segments)
    out = {**signals, **{name: signals[name].copy() for name in late}}
    cut = []
    for start, stop in segments:
        own = time[start:stop]
        for name, lag in late.items():
            at = np.clip(own + lag, own[0], own[-1])
            out[name][start:stop] = _between(own, signals[name][start:stop], name)(at)
        first = own[0] - min(0.0, *late.values())
        last = own[-1] - max(0.0, *late.values())
        cut.append(
            (
                start + int(np.searchsorted(own, first)),
                start + int(np.searchsorted(own, last, side="right")),
            )
        )
    return out, tuple(cut)


def _between(
    time: np.ndarray, y: np.ndarray, name: str
) -> Callable[[np.ndarray], np.ndarray]:
    """A signal between its rows. Straight lines, and splines of a lower degree, would
    smooth the noise of a sensor, by which it is known; a command steps.
    """
    ticks = np.diff(time)
    uneven = np.ptp(ticks) > EVEN * np.median(ticks) if len(ticks) else True
    if name == "u" or uneven or len(y) <= DEGREE:
        return lambda t: np.interp(t, time, y)
    from scipy import interpolate

    return interpolate.make_interp_spline(time, y, k=DEGREE)


def check_rows(file: File, labels: Mapping[str, str], arrays: Signals) -> None:
    """Refuse columns of different lengths, and too few rows.

    Raises:
        InputError: there are such.
    """
    rows = len(arrays["time"])
    for name, values in arrays.items():
        if len(values) != rows:
            raise InputError(
                f"{file.path}: {labels[name]!r} has {len(values)} values, time has "
                f"{rows}; log both at the same rows"
            )
    if rows < _LEAST_ROWS:
        raise InputError(
            f"{file.path}: a log needs at least {_LEAST_ROWS} rows, and it has {rows}; "
            "log longer"
        )
