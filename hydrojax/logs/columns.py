"""A log's columns: which one a signal is, its unit, its values in SI."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from hydrojax import units
from hydrojax.errors import InputError
from hydrojax.logs.bagfile import is_bag
from hydrojax.logs.signals import SIGNALS, Channel
from hydrojax.logs.tables import Column, File

_WILD = 1e15  # SI; no signal comes near it


def assigned(
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


def si_values(
    file: File, name: str, column: Column, unit: str | None
) -> tuple[Float[np.ndarray, "rows"], str]:
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
