"""A log's columns as signals in SI, with rising time, in stretches without a gap."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from hydrojax import units
from hydrojax.errors import InputError
from hydrojax.logs.dates import clock_seconds
from hydrojax.logs.tables import SIGNALS, Channel, Column, File, is_bag, tidy

_WILD = 1e15  # SI; no signal comes near it

Signals = Mapping[str, Float[np.ndarray, "rows"]]
"""Signals by name, SI, all of the same rows."""

_MAY_REST = ("v", "P_s", "P_r", "F_d")  # a constant here is no fault of the log

_GAP = 2.5  # a step this many times the median is a gap


def assigned(
    file: File, channels: Mapping[str, Channel]
) -> tuple[dict[str, tuple[Column, str | None, float]], list[str]]:
    """Each signal's column, unit and factor; remarks."""
    found, notes = {}, []
    for name in SIGNALS:
        channel = channels.get(name)
        wanted = name if channel is None else tidy(file.path, channel.column)
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
        found[name] = (column, unit, channel.factor if channel else 1.0)
    return found, notes


def _missing(file: File, name: str, wanted: str) -> str:
    labels = [c.label for c in file.columns]
    near = get_close_matches(wanted, [c.name for c in file.columns], n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"it has {labels[:12]}"
    if len(labels) == 1 and file.header:
        hint = "its header is one cell, so separate the columns with commas"
    if not any(labels):
        hint = "it has no columns"
    mend = "name it 'time [s]', or its column" if name == "time" else "mend the column"
    return (
        f"{file.path}: no column {wanted!r} for {name}; {hint}; {mend} in the rig "
        f"file's [channels] {name}"
    )


def si_values(
    file: File, name: str, column: Column, unit: str | None
) -> tuple[Float[np.ndarray, "rows"], str]:
    """A signal in SI, [n], NaN where it has no finite number, and its unit."""
    where = f"{file.path}: column {column.label!r}"
    want = SIGNALS[name]
    if name == "time" and (dates := clock_seconds(file, where, column)) is not None:
        return dates, want
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
    values = as_floats(file, where, column.values)
    with np.errstate(over="ignore"):
        found = units.to_si(values, unit, want, where)
    wild = np.flatnonzero(np.abs(found) > _WILD)
    if len(wild):
        raise InputError(
            f"{where}, {file.row(int(wild[0]))}: {values[wild[0]]:g} {unit} is beyond "
            "any sensor; mend the cell or the unit, or leave the cell empty"
        )
    return found, want


def as_floats(file: File, where: str, values: Any) -> Float[np.ndarray, "rows"]:
    """A column's cells as floats, NaN where empty or infinite."""
    plain = isinstance(values, (pd.Series, np.ndarray)) and values.dtype.names is None
    if not plain or not values.shape or values.size != max(values.shape):
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


def check_time(file: File, label: str, time: Float[np.ndarray, "rows"]) -> bool:
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


def check_values(
    file: File, name: str, label: str, values: Float[np.ndarray, "rows"]
) -> list[str]:
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


def merged_rows(
    arrays: dict[str, Float[np.ndarray, "rows"]],
) -> tuple[dict[str, Float[np.ndarray, "rows"]], int]:
    """Average the rows of equal time; the rows saved."""
    time, first, counts = np.unique(
        arrays["time"], return_index=True, return_counts=True
    )
    merged = {name: np.add.reduceat(a, first) / counts for name, a in arrays.items()}
    return merged | {"time": time}, len(arrays["time"]) - len(time)


def _holed(signals: Signals) -> Bool[np.ndarray, "rows"]:
    """Which rows lack a number that counts."""
    out = np.zeros(len(next(iter(signals.values()))), dtype=bool)
    for name, values in signals.items():
        if name not in ("time", "F_d"):
            out |= np.isnan(values)
    return out


def without_lone_holes(
    arrays: dict[str, Float[np.ndarray, "rows"]],
) -> tuple[dict[str, Float[np.ndarray, "rows"]], list[str]]:
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


def segments_of(
    time: Float[np.ndarray, "rows"], signals: Signals, shortest: float
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
