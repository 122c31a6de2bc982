"""Logs: from a file of any accepted kind to SI arrays that can be replayed.

A CSV or Parquet column is called `name [unit]`. In a MAT file the vectors are
variables called by name, at the top or in a struct `log`; their units are the fields
of a struct `units`, or variables `<name>_unit`. The rig file's [channels] may rename a
column, give its unit (which then wins over the file's) and turn its sign round. In an
MCAP file or a ROS 2 bag it says which topic and field a signal is; see `bags`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydantic import BaseModel, ConfigDict

from hydrojax import units
from hydrojax.errors import InputError
from hydrojax.logs.bagfile import is_bag
from hydrojax.logs.rosbag import read_bag
from hydrojax.logs.tables import Column, File, read_table

SIGNALS = {
    "time": "s", "u": "{u}", "psi": "rad", "x": "m", "v": "m/s", "P_a1": "Pa",
    "P_a2": "Pa", "P_s": "Pa", "P_r": "Pa", "P": "N", "F": "N", "F_d": "N",
}  # fmt: skip
"""What a log may hold, and the SI unit; `{u}` is V or 1."""


_MAY_REST = ("v", "P_s", "P_r", "F_d")  # a constant here is no fault of the log


_LEAST_ROWS = 50


_WILD = 1e15  # SI; no signal comes near it


_GAP = 2.5  # a step this many times the median is a gap


class Channel(BaseModel):
    """One line of the rig file's [channels]: where a signal is in the logs."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    column: str
    unit: str | None = None
    invert: bool = False


@dataclass(frozen=True)
class Log:
    """One run, in SI.

    Attributes:
        name: the file's name, such as "fit_1.csv.gz".
        time: [n] s, strictly rising, starting wherever the file does.
        signals: by the contract's names, each [n]; NaN where the file has no number.
        units: the unit each signal is in; that of `u` is "V" or "1".
        ignored: columns left alone.
        merged: rows that went into a neighbour of the same stamp.
        segments: [start, stop) row ranges without a gap or a NaN (`F_d`'s aside).
        notes: one-line remarks for the report.
    """

    name: str
    time: np.ndarray
    signals: dict[str, np.ndarray]
    units: dict[str, str]
    ignored: tuple[str, ...]
    merged: int
    segments: tuple[tuple[int, int], ...]
    notes: tuple[str, ...]


def read_log(
    path: str | Path,
    channels: Mapping[str, Channel] | None = None,
    shortest: float = 0.5,
) -> Log:
    """Read a run from .csv, .csv.gz, .parquet, .mat (v5 or v7.3), .mcap or a bag.

    Gaps in time and missing numbers cut the run in segments: nothing is interpolated
    over them. See `bags.read_bag` for what brings a bag's channels to common rows.

    Args:
        path: the file, whose ending says what it is, or the folder of a ROS 2 bag.
        channels: where signals are that the file calls otherwise, by contract name.
        shortest: s, the least length of a segment.

    Raises:
        InputError: the file is not what its name says, lacks `time`, has fewer than 50
            rows or no segment; a signal has a missing or wrong unit, a cell that is no
            number or beyond any sensor, or does not move; time is missing, falls or
            repeats in some row (rows of one stamp of a coarse clock are averaged).
    """
    path, channels = Path(path), channels or {}
    if is_bag(path):
        file = read_bag(path, {name: c.column for name, c in channels.items()})
    else:
        file = read_table(path)
    found, notes = _assign(file, channels)
    notes = [*file.notes, *notes]
    labels = {name: column.label for name, (column, _, _) in found.items()}
    used = {id(column) for column, _, _ in found.values()}
    ignored = tuple(c.label for c in file.columns if id(c) not in used)
    file.columns.clear()  # a long log is large: what is taken over is let go
    arrays, stored = {}, {}
    for name in list(found):
        column, unit, sign = found.pop(name)
        values, stored[name] = _si(file, name, column, unit)
        arrays[name] = values if sign == 1.0 else sign * values
    rows = len(arrays["time"])
    for name, values in arrays.items():
        if len(values) != rows:
            raise InputError(
                f"{path}: {labels[name]!r} has {len(values)} values, time has "
                f"{rows}; log both at the same rows"
            )
    if rows < _LEAST_ROWS:
        raise InputError(
            f"{path}: {rows} rows are too few; a log needs at least {_LEAST_ROWS}"
        )
    coarse = _check_time(file, labels["time"], arrays["time"])
    for name, values in arrays.items():
        notes += _check_values(file, name, labels[name], values)
    merged = 0
    if coarse:
        arrays, merged = _merge(arrays)
    if merged:
        notes.append(f"rows averaged, as they share a coarse time stamp: {merged}")
    arrays, lost = _without_lone_holes(arrays)
    notes += lost
    time = arrays.pop("time")
    stored.pop("time")
    segments, cuts = _segments(time, arrays, shortest)
    if not segments:
        why = "; ".join(lost + cuts) or f"it lasts {time[-1] - time[0]:g} s"
        raise InputError(
            f"{path}: no stretch of {shortest:g} s without a gap or a missing number "
            f"({why}); log longer, or take the column with the holes out"
        )
    name = path.absolute().name  # of "." too
    return Log(name, time, arrays, stored, ignored, merged, segments, (*notes, *cuts))


def _assign(
    file: File, channels: Mapping[str, Channel]
) -> tuple[dict[str, tuple[Column, str | None, float]], list[str]]:
    """Each signal's column, unit and sign; remarks."""
    found, notes = {}, []
    for name in SIGNALS:
        channel = channels.get(name)
        wanted = name if channel is None else channel.column.strip()
        matches = [c for c in file.columns if wanted in (c.name, c.label)]
        if len(matches) > 1:
            raise InputError(
                f"{file.path}: {len(matches)} columns are called {wanted!r}; rename "
                "all but one"
            )
        if not matches:
            if channel is not None or name == "time":
                raise InputError(_missing(file, name, wanted))
            continue
        column = matches[0]
        unit = (channel.unit if channel else None) or column.unit
        if channel and channel.unit and column.unit not in (None, channel.unit):
            notes.append(
                f"column {column.label!r} is read in {unit}, as the rig file says"
            )
        found[name] = (column, unit, -1.0 if channel and channel.invert else 1.0)
    return found, notes


def _missing(file: File, name: str, wanted: str) -> str:
    labels = [c.label for c in file.columns]
    near = get_close_matches(wanted, [c.name for c in file.columns], n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"it has {labels[:12]}"
    if len(labels) == 1 and file.header:
        hint = "its header is one cell, so separate the columns with commas"
    mend = "name it 'time [s]', or its column" if name == "time" else "mend the column"
    return (
        f"{file.path}: no column {wanted!r} for {name}; {hint}; {mend} in the rig "
        f"file's [channels] {name}"
    )


def _si(
    file: File, name: str, column: Column, unit: str | None
) -> tuple[np.ndarray, str]:
    """A signal in SI, [n], NaN where it has no finite number, and its unit."""
    where = f"{file.path}: column {column.label!r}"
    want = SIGNALS[name]
    if name == "u":
        want = "V" if unit is not None and units.fits(unit, "V") else "1"
    if unit is None:
        such = "V" if name == "u" else want
        mend = f"call it '{name} [{such}]'"
        if file.path.suffix.lower() == ".mat":
            mend = f"add a variable {name}_unit = '{such}'"
        if is_bag(file.path):
            raise InputError(
                f"{where} has no unit; set unit = {such!r} in the rig file's "
                f"[channels] {name}"
            )
        raise InputError(
            f"{where} has no unit; {mend}, or set one in the rig file's [channels] "
            f"{name}"
        )
    if name == "u" and not units.fits(unit, want):
        raise InputError(f"{where}: unit {unit!r} is neither V nor 1; give u in either")
    values = _numbers(file, where, column.values)
    with np.errstate(over="ignore"):
        found = units.to_si(values, unit, want, where)
    wild = np.flatnonzero(np.abs(found) > _WILD)
    if len(wild):
        raise InputError(
            f"{where}, {file.row(int(wild[0]))}: {values[wild[0]]:g} {unit} is beyond "
            "any sensor; mend the cell or the unit, or leave the cell empty"
        )
    return found, want


def _numbers(file: File, where: str, values: Any) -> np.ndarray:
    """A column's cells as floats, [n], NaN where empty or infinite."""
    shape = np.shape(values)
    if not shape or np.size(values) != max(shape):
        raise InputError(f"{where} is not a vector; store it as one")
    cells = values if isinstance(values, pd.Series) else pd.Series(np.ravel(values))
    if cells.dtype.kind not in "biuf":  # text, or objects
        numbers = pd.Series(pd.to_numeric(cells.astype(object), errors="coerce"))
        wrong = np.flatnonzero(cells.notna() & numbers.isna())
        if len(wrong) or cells.dtype.kind in "mMc":
            row = int(wrong[0]) if len(wrong) else 0
            raise InputError(
                f"{where}, {file.row(row)}: {str(cells.iloc[row])[:40]!r} is not a "
                "number; write one, or leave the cell empty"
            )
        cells = numbers
    result = cells.to_numpy(dtype=float, na_value=np.nan)
    finite = np.isfinite(result)
    return result if finite.all() else np.where(finite, result, np.nan)


def _check_time(file: File, label: str, time: np.ndarray) -> bool:
    """Refuse time that is missing, falls or repeats; whether rows are to be merged.

    A clock is coarse if it can be seen to round: the stamps keep to ticks about as
    wide as a step, and the steps jitter by whole ticks. Then a stamp may repeat.
    """
    where = f"{file.path}: column {label!r}"
    lost = np.flatnonzero(np.isnan(time))
    if len(lost):
        raise InputError(
            f"{where}, {file.row(int(lost[0]))}: time is missing; fill it in or delete "
            "the row"
        )
    steps = np.diff(time)
    falls = np.flatnonzero(steps < 0.0)
    if len(falls):
        raise InputError(
            f"{where}, {file.row(int(falls[0]) + 1)}: time falls; sort the rows, or "
            "make one file of each run"
        )
    repeats = np.flatnonzero(steps == 0.0)
    if not len(repeats):
        return False
    rising = steps[steps > 0.0]
    if len(rising):
        tick, median = rising.min(), np.median(rising)
        jitter = np.mean(np.abs(rising - median) > 0.1 * tick)
        on_ticks = np.abs(rising / tick - np.round(rising / tick)) < 0.1
        if jitter > 0.01 and median < 3.5 * tick and np.mean(on_ticks) > 0.99:
            return True
    raise InputError(
        f"{where}, {file.row(int(repeats[0]) + 1)}: time repeats; delete the row, or "
        "export time with more digits"
    )


def _check_values(file: File, name: str, label: str, values: np.ndarray) -> list[str]:
    """Refuse a column without numbers or movement; a remark if it may rest."""
    known = values[~np.isnan(values)]
    if not len(known):
        raise InputError(
            f"{file.path}: column {label!r} holds no number; take it out of the log"
        )
    if name == "time" or known.min() < known.max():
        return []
    if name in _MAY_REST:
        return [f"column {label!r} is constant"]
    raise InputError(
        f"{file.path}: column {label!r} does not move; check its sensor, log a run in "
        "which it does, or take the column out"
    )


def _merge(arrays: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], int]:
    """Average the rows of equal time; the rows saved."""
    time, first, counts = np.unique(
        arrays["time"], return_index=True, return_counts=True
    )
    merged = {name: np.add.reduceat(a, first) / counts for name, a in arrays.items()}
    return merged | {"time": time}, len(arrays["time"]) - len(time)


def _holed(signals: Mapping[str, np.ndarray]) -> np.ndarray:
    """Which rows lack a number that counts."""
    out = np.zeros(len(next(iter(signals.values()))), dtype=bool)
    for name, values in signals.items():
        if name not in ("time", "F_d"):
            out |= np.isnan(values)
    return out


def _without_lone_holes(
    arrays: dict[str, np.ndarray],
) -> tuple[dict[str, np.ndarray], list[str]]:
    """The rows less those that lack a number between two that do not: one tick is then
    as long as two, where a cut would cost the second after it too. And what is missing.

    A command that such a row does have counts in the mean over the long tick.
    """
    notes = [
        f"rows left out, as {name} is missing: {np.isnan(values).sum()}"
        for name, values in arrays.items()
        if name not in ("time", "F_d") and np.isnan(values).any()
    ]
    if not notes:
        return arrays, notes
    time, whole = arrays["time"], ~_holed(arrays)
    near = time[2:] - time[:-2] <= _GAP * np.median(np.diff(time))
    lone = np.zeros(len(time), dtype=bool)
    lone[1:-1] = ~whole[1:-1] & whole[:-2] & whole[2:] & near
    if "u" in arrays:
        u, at = arrays["u"].copy(), np.flatnonzero(lone & ~np.isnan(arrays["u"]))
        held, more = time[at] - time[at - 1], time[at + 1] - time[at]
        u[at - 1] = (held * u[at - 1] + more * u[at]) / (held + more)
        arrays = arrays | {"u": u}
    return {name: values[~lone] for name, values in arrays.items()}, notes


def _segments(
    time: np.ndarray, signals: Mapping[str, np.ndarray], shortest: float
) -> tuple[tuple[tuple[int, int], ...], list[str]]:
    """Row ranges without gap or NaN that last `shortest` s; what was cut, in words."""
    notes = []
    whole = ~_holed(signals)
    steps = np.diff(time)
    gap = steps > _GAP * np.median(steps)
    if gap.any():
        notes.append(f"gaps in time: {gap.sum()}, the longest {steps.max():.3g} s")
    joined = whole[1:] & whole[:-1] & ~gap
    starts = np.flatnonzero(whole & ~np.concatenate([[False], joined]))
    stops = np.flatnonzero(whole & ~np.concatenate([joined, [False]])) + 1
    kept, short = [], 0
    for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
        if time[stop - 1] - time[start] >= shortest * (1.0 - 1e-9):
            kept.append((start, stop))
        else:
            short += stop - start
    if short:
        notes.append(f"rows left out, in stretches under {shortest:g} s: {short}")
    return tuple(kept), notes
