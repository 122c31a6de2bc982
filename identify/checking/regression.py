"""Least squares on sums over short windows, by their normal equations."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls

UNSEEN = 1e-12
"""Share of the largest eigenvalue of columns of one size up to which a direction is
rounding."""


@dataclass(frozen=True)
class Table:
    """A regression: rows of all windows, what they should give, and columns by name."""

    y: Float[np.ndarray, "rows"]
    columns: Mapping[str, Float[np.ndarray, "rows"]]

    @classmethod
    def stacked(cls, tables: Sequence[Table]) -> Table:
        """The rows of several."""
        names = tables[0].columns
        joined = {n: np.concatenate([t.columns[n] for t in tables]) for n in names}
        return cls(np.concatenate([t.y for t in tables]), joined)

    def with_columns(self, other: Table) -> Table:
        """The same rows with further columns."""
        return Table(self.y, {**self.columns, **other.columns})

    def holding(self, values: Mapping[str, float]) -> Table:
        """The same with some columns at known coefficients."""
        y = self.y - sum(v * self.columns[n] for n, v in values.items())
        return Table(y, {n: c for n, c in self.columns.items() if n not in values})


@dataclass(frozen=True)
class Fitted:
    """A regression's coefficients and standard errors by name; RMS of its rest."""

    values: dict[str, float]
    std: dict[str, float]
    error: float
    left: Float[np.ndarray, "rows"]


def solved(
    table: Table, names: Iterable[str], not_negative: Collection[str] = ()
) -> Fitted:
    """Least squares on some of a table's columns.

    Standard errors are those of windows that overlap by half.
    """
    names = list(names)
    X = np.stack([table.columns[n] for n in names], axis=1)
    size = np.sqrt(np.sum(X**2, axis=0))
    size[size == 0] = 1.0
    # Of columns of one size: some seven digits are left of doubles, and it takes a
    # tenth of the time of a factorisation of X.
    scaled = X / size
    square, turn = np.linalg.eigh(scaled.T @ scaled)
    square = np.maximum(square, np.finfo(float).tiny)
    seen = square > UNSEEN * square[-1]
    seen[-1] = True  # one direction at least, where all columns are nothing
    root, turn = np.sqrt(square[seen]), turn[:, seen]
    r, goal = root[:, None] * turn.T, (turn.T @ (scaled.T @ table.y)) / root
    inverse = turn / root
    if not_negative:
        open_ = [i for i, n in enumerate(names) if n not in not_negative]
        at, _ = nnls(np.hstack([r, -r[:, open_]]), goal)
        at[open_] -= at[len(names) :]
        at = at[: len(names)]
    else:
        at = inverse @ goal
    left = table.y - X @ (at / size)
    error = float(np.sqrt(np.mean(left**2)))
    std = error * np.sqrt(1.5 * np.sum(inverse**2, axis=1)) / size
    return Fitted(
        dict(zip(names, (at / size).tolist(), strict=True)),
        dict(zip(names, std.tolist(), strict=True)),
        error,
        left,
    )


def bump(ticks: int) -> Float[np.ndarray, "ticks"]:
    """A smooth weight over a window, of unit sum."""
    w = np.sin(np.pi * (np.arange(ticks) + 0.5) / ticks) ** 2
    return w / w.sum()


def window_sums(
    y: Float[np.ndarray, "ticks *more"], ticks: int
) -> Float[np.ndarray, "windows *more"]:
    """Weighted means over windows of `ticks` that overlap by half."""
    views = np.lib.stride_tricks.sliding_window_view(y, ticks, axis=0)
    return views[:: max(ticks // 2, 1)] @ bump(ticks)
