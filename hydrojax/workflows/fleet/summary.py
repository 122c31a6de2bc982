"""Summary of a fleet's table: outliers, drifts with labels, effects."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy import stats

from hydrojax.workflows.fleet.merged import FEW, Fleet, label

FAR = 3.5
"""Robust z score of an outlier (Iglewicz and Hoaglin, How to Detect and Handle
Outliers, ASQC 1993); see `robust_z`."""

CHANCE = 0.01
"""Family-wise chance of naming a drift where there is none."""

PAIRED = 2000
"""Most rows that a slope is cut from: it looks at all pairs."""


def robust_z(
    values: Float[np.ndarray, "n"], std: Float[np.ndarray, "n"] | float = 0.0
) -> Float[np.ndarray, "n"]:
    """(x - median) / sqrt((MAD / 0.6745)^2 + std^2): robust z scores.

    `std` is each value's own: a less certain value may lie further off. 0 where
    more than half of the values are the same.
    """
    middle = np.median(values)
    spread = np.median(np.abs(values - middle)) / 0.6745
    if spread == 0:
        return np.zeros(len(values))
    return (values - middle) / np.hypot(spread, std)


@dataclass(frozen=True)
class Outlier:
    """A job whose `what` (SI) is far from the fleet's median."""

    job: str
    what: str
    value: float
    median: float
    unit: str
    z: float


def outliers(fleet: Fleet) -> list[Outlier]:
    """Fits whose parameters, or errors in multiples of the noise, are outliers."""
    out = []
    for name in fleet.parameters:
        own: Any = fleet.identified(name)
        unit = fleet.unit(f"parameter.{name}")
        values, std = (own[c].to_numpy(float) for c in ("value", "std"))
        out += _apart(own["job"], values, np.nan_to_num(std), name, unit)
    for name in fleet.channels:
        parts = [f"channel.{name}.{end}" for end in ("noise", "after")]
        own = fleet.columns("job", *parts).dropna()
        ratio = own[parts[1]].to_numpy(float) / own[parts[0]].to_numpy(float)
        fine = np.isfinite(ratio)
        what = f"{name} after / noise"
        out += _apart(own["job"][fine], ratio[fine], 0.0, what, "1")
    return sorted(out, key=lambda o: -abs(o.z))


def _apart(
    jobs: pd.Series, values: np.ndarray, std: np.ndarray | float, what: str, unit: str
) -> list[Outlier]:
    if len(values) < FEW:
        return []
    z, middle = robust_z(values, std), float(np.median(values))
    names = jobs.to_numpy()
    return [
        Outlier(str(names[i]), what, float(values[i]), middle, unit, float(z[i]))
        for i in np.flatnonzero(np.abs(z) > FAR)
    ]


@dataclass(frozen=True)
class Drift:
    """A parameter that correlates with a label: change over the label's range.

    `change`, `low`, `high` (95 %) are Theil's and Sen's slope times that span, SI.
    """

    parameter: str
    label: str
    change: float
    low: float
    high: float
    median: float
    unit: str
    p_value: float


def drifts(fleet: Fleet) -> list[Drift]:
    """Parameters that rise or fall with a numeric label or time, beyond chance.

    Kendall's test, Holm's correction over all pairs of parameter and label.
    """
    found, chances = [], []
    for name in fleet.labels:
        column = label(fleet, name)
        if column.dtype.kind not in "fM":
            continue
        for parameter in fleet.parameters:
            own = fleet.identified(parameter)
            own = own.assign(x=_numbers(column).reindex(own.index)).dropna(
                subset=["value", "x"]
            )
            x, y = own["x"].to_numpy(float), own["value"].to_numpy(float)
            if len(x) < FEW or np.ptp(x) == 0 or np.ptp(y) == 0:
                continue
            test: Any = stats.kendalltau(x, y)
            chances.append(float(test.pvalue))
            unit = fleet.unit(f"parameter.{parameter}")
            found.append((parameter, name, x, y, unit, chances[-1]))
    found.sort(key=lambda f: f[-1])
    out = []
    for i, (parameter, name, x, y, unit, p) in enumerate(found):
        if p * (len(chances) - i) > CHANCE:
            break
        some = np.random.default_rng(0).permutation(len(x))[:PAIRED]
        slope: Any = stats.theilslopes(y[some], x[some])
        change, low, high = (
            float(np.ptp(x) * s)
            for s in (slope.slope, slope.low_slope, slope.high_slope)
        )
        middle = float(np.median(y))
        out.append(Drift(parameter, name, change, low, high, middle, unit, p))
    return out


def _numbers(column: pd.Series) -> pd.Series:
    """A numeric label, or a time as seconds since the first."""
    if column.dtype.kind != "M":
        return column
    return (column - column.min()).dt.total_seconds()


@dataclass(frozen=True)
class Found:
    """How often an effect was found; `alike`: effects not distinguishable from it."""

    name: str
    jobs: int
    alike: tuple[str, ...]


def effects(fleet: Fleet, records: Iterable[dict[str, Any]]) -> list[Found]:
    """Effects found, the most frequent first."""
    column = fleet.columns("effects")["effects"].dropna()
    count = Counter(name for cell in column for name in cell.split(";") if name)
    alike: dict[str, Counter[str]] = {}
    for record in records if count else ():
        for effect in record.get("effects", []):
            alike.setdefault(effect["name"], Counter()).update(effect["alike"])
    return [
        Found(n, k, tuple(a for a, _ in alike.get(n, Counter()).most_common(3)))
        for n, k in sorted(count.items(), key=lambda c: (-c[1], c[0]))
    ]
