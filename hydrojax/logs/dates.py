"""Dates and times of day as seconds."""

from __future__ import annotations

import numpy as np
import pandas as pd
from jaxtyping import Float

from hydrojax.errors import InputError
from hydrojax.logs.tables import Column, File
from hydrojax.logs.texts import DATE

ZONE = r"\s*(Z|[+-]\d\d(?::?\d\d)?)$"
"""A time zone behind a time of day."""

DAY = 86400.0
"""Seconds."""


def clock_seconds(
    file: File, where: str, column: Column
) -> Float[np.ndarray, "rows"] | None:
    """Dates or times of day as s from the first row, [n]; None where they are none."""
    if np.ndim(column.values) != 1:
        return None
    cells = column.values
    found = _seconds(cells if isinstance(cells, pd.Series) else pd.Series(cells))
    if found is None:
        return None
    values, wrong = found
    if wrong is not None:
        cell = str(pd.Series(cells).iloc[wrong])[:40]
        raise InputError(
            f"{where}, {file.row(wrong)}: {cell!r} is not a date that can be read in "
            "one way; write it as 2024-03-01 12:00:00.001, or seconds as numbers"
        )
    return values


def _seconds(cells: pd.Series) -> tuple[np.ndarray, int | None] | None:
    """Dates or times of day as seconds from the first, [n]; None where they are none.

    Returns:
        the seconds, NaN where a cell is empty or wrong; and the first wrong cell.
        A date such as 03/04/2024 is accepted where all rows have the same.
    """
    if cells.dtype.kind == "M":
        return _elapsed(cells), None
    if cells.dtype.kind == "m":
        return cells.dt.total_seconds().to_numpy(), None
    if cells.dtype.kind in "biufc":
        return None
    text = cells.dropna().astype(str).str.strip()
    if text.empty or not DATE.fullmatch(text.iloc[0]):
        return None
    text = text.str.replace(",", ".").str.replace("T", " ")
    both = text.str.extract(r"^(\S+[-/.]\S+[-/.]\S+)?\s*(.*)$")
    clear = both[0].str.fullmatch(r"\d{4}-\d{1,2}-\d{1,2}")
    dotted = both[0].str.fullmatch(r"\d{1,2}\.\d{1,2}\.\d{4}")
    if both[0].isna().all() or both[0].nunique(dropna=False) == 1:
        found = _of_one_day(both[1], dated=bool(both[0].notna().all()))
    elif clear.all() or dotted.all():
        first = bool(dotted.all())
        stamps = pd.to_datetime(
            text, errors="coerce", format="mixed", dayfirst=first, utc=True
        )
        found = pd.Series(_elapsed(stamps), text.index)
    else:
        return np.full(len(cells), np.nan), int(np.flatnonzero(cells.notna())[0])
    out = np.full(len(cells), np.nan)
    out[cells.notna().to_numpy()] = found.to_numpy()
    wrong = np.flatnonzero(cells.notna().to_numpy() & np.isnan(out))
    if len(wrong):
        return out, int(wrong[0])
    return out - out[np.isfinite(out)][0], None


def _of_one_day(text: pd.Series, dated: bool) -> pd.Series:
    """Times of day as seconds, NaN where they are none; without a date they may pass
    midnight. A zone that all have says nothing.
    """
    zones = text.str.extract(ZONE)[0]
    if zones.notna().all() and zones.nunique() == 1:
        text = text.str.replace(ZONE, "", regex=True)
    found = pd.to_timedelta(text, errors="coerce").dt.total_seconds()
    if not dated:
        found = found + DAY * (found.diff() < -DAY / 2).cumsum()
    return found


def _elapsed(stamps: pd.Series) -> np.ndarray:
    """Seconds since the first stamp, NaN where there is none."""
    return (stamps - stamps.dropna().iloc[0]).dt.total_seconds().to_numpy()
