"""The residual over time, condensed: for pictures, and as inline data of a page."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from jaxtyping import Float

from hydrojax.identify.report.figures import (
    AFTER,
    BAND,
    BEFORE,
    compared,
    drawn,
    moved,
    reach,
)
from hydrojax.identify.report.traces import stretch, traced
from hydrojax.identify.results.outcome import Outcome, Series
from hydrojax.report.text import engineering

BYTES = 1_200_000
"""What all residuals of a page may take; a log that fits is kept sample by sample."""
COLOURS = {"measured": "#1c1f23", "before": BEFORE, "after": AFTER, "noise": BAND}
STEPS = 32767
"""Steps from zero to the largest value of a line; one further down is a gap."""


def condensed(
    t: Float[np.ndarray, "rows"], y: Float[np.ndarray, "rows"], step: float
) -> tuple[Float[np.ndarray, "points"], Float[np.ndarray, "points"]]:
    """`y(t)` as its smallest and largest value in each `step` of time.

    NaN parts stretches that do not adjoin, before and after.
    """
    good = np.isfinite(t) & np.isfinite(y)
    if not good.any():
        return np.empty(0), np.empty(0)
    stretch = np.cumsum(~good)[good]
    t, y = t[good], y[good]
    column = np.floor((t - t[0]) / step) if step > 0 else np.zeros(t.size)
    new = (np.diff(column) != 0) | (np.diff(stretch) != 0)
    starts = np.concatenate([[0], np.nonzero(new)[0] + 1])
    low, high = np.minimum.reduceat(y, starts), np.maximum.reduceat(y, starts)
    gap = np.diff(stretch[starts], append=stretch[-1]) != 0
    rows = np.stack([low, high, np.where(gap, np.nan, high)], axis=1)
    return np.repeat(t[starts], 3), rows.ravel()


def envelope(
    t: Float[np.ndarray, "rows"],
    y: Float[np.ndarray, "rows"],
    start: float,
    step: float,
    size: int,
) -> tuple[Float[np.ndarray, "{size}"], Float[np.ndarray, "{size}"]]:
    """Smallest and largest `y` within half a `step` of each column.

    Column i stands at `start + i step`, in the unit of `t`, which may hold NaN as
    `y` may; a column without a sample is NaN.
    """
    good = np.isfinite(t) & np.isfinite(y)
    at = np.clip(np.floor((t[good] - start) / step + 0.5).astype(int), 0, size - 1)
    low, high = np.full(size, np.inf), np.full(size, -np.inf)
    np.minimum.at(low, at, y[good])
    np.maximum.at(high, at, y[good])
    empty = low > high
    low[empty] = high[empty] = np.nan
    return low, high


def line_columns(
    t: Float[np.ndarray, "rows"], values: float
) -> tuple[float, float, int]:
    """Start, step (s) and number of the columns of a line that `values` may take.

    The log's own ticks where they fit, else as many columns of two values.
    """
    real = t[np.isfinite(t)]
    span = float(np.ptp(real))
    ticks = np.diff(t)
    tick = float(np.median(ticks[ticks > 0])) if (ticks > 0).any() else 1.0
    every = round(span / tick) + 1
    if every <= values:
        return float(real.min()), tick, every
    size = max(int(values / 2), 2)
    return float(real.min()), span / (size - 1), size


def _packed(y: np.ndarray, scale: float) -> str:
    whole = np.where(np.isfinite(y), np.round(y / scale), -STEPS - 1)
    return base64.b64encode(whole.astype("<i2").tobytes()).decode("ascii")


def _line(low: np.ndarray, high: np.ndarray, factor: float) -> list[Any]:
    """Scale in the printed unit, lows, highs: none where they are the lows."""
    size = float(np.max(np.abs(np.nan_to_num([low, high]))))
    scale = size / STEPS or 1.0
    same = np.array_equal(low, high, equal_nan=True)
    above = None if same else _packed(high, scale)
    return [scale / factor, _packed(low, scale), above]


def _log(s: Series, factors: dict[str, float], ways: list[str], room: float) -> Any:
    own = [c for c in factors if c in s.before and c in s.after]
    # Two bytes a value, and base64 writes three bytes as four.
    values = room / max(len(own) * (len(ways) + 1), 1) / (2 * 4 / 3)
    start, step, size = line_columns(s.t, values)
    lines = {
        c: {
            w: _line(*envelope(s.t, getattr(s, w)[c], start, step, size), factors[c])
            for w in ways
        }
        for c in own
    }
    measured = {
        c: _line(*envelope(s.t, s.measured[c], start, step, size), factors[c])
        for c in own
    }
    return {
        "name": s.log, "start": start, "step": step, "size": size, "lines": lines,
        "measured": measured,
    }  # fmt: skip


def explorer_data(outcome: Outcome) -> dict[str, Any] | None:
    """What the page's script draws, for JSON; None if there is no residual.

    A line's values are whole numbers of 16 bits, little-endian, in base64, times its
    scale in the channel's printed unit; those of a gap are the least.
    """
    series = drawn(outcome)
    names = compared(outcome, series)
    if not names:
        return None
    ways = ["before", "after"] if moved(series, names) else ["after"]
    factors, shown = {}, []
    for name in names:
        c = outcome.channels[name]
        factors[name], unit = engineering(reach(c), c.unit)
        noise = c.noise / factors[name] if np.isfinite(c.noise) else None
        shown.append({"name": name, "unit": unit or "1", "noise": noise})
    return {
        "channels": shown,
        "ways": ways,
        "colours": COLOURS,
        "logs": [_log(s, factors, ways, BYTES / len(series)) for s in series],
        "worst": _worst(outcome, series),
    }


def _worst(outcome: Outcome, series: list[Series]) -> dict[str, Any] | None:
    """The stretch of the picture over time: which log, and from when to when, s."""
    found = traced(outcome)
    if found is None:
        return None
    name, s = found
    t = s.t[stretch(s.t, s.before[name])]
    log = next(i for i, one in enumerate(series) if one is s)
    return {"log": log, "from": float(np.nanmin(t)), "to": float(np.nanmax(t))}
