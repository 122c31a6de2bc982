"""What a fleet's table says: outliers, drifts with labels, effects, friction's bounds.

Columns are read as they are asked for, so that a long table need not fit in memory.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
from scipy import stats

from hydrojax.identify.estimation.box import Box, Stretch, smallest_box
from hydrojax.plant.friction import Theta
from hydrojax.workflows.fleet.jobs import OWN, PREFIXES, RESULTS

FAR = 3.5
"""Robust z score of an outlier (Iglewicz and Hoaglin, How to Detect and Handle
Outliers, ASQC 1993); see `robust_z`."""

LITTLE = 3.0
"""Multiple of the fleet's median standard deviation above which a fit says too little
of friction to be counted: few such would pass for the scatter of all."""

FEW = 5
"""Fits below which nothing is said of outliers, drifts and bounds."""

CHANCE = 0.01
"""Family-wise chance of naming a drift where there is none."""

PAIRED = 2000
"""Most rows that a slope is cut from: it looks at all pairs."""

BOXED = 5000
"""Most fits that friction's bounds are cut from."""


@dataclass(frozen=True)
class Fleet:
    """The merged table."""

    path: Path

    @cached_property
    def schema(self) -> Any:
        """Its columns, with their units."""
        return pq.read_schema(self.path)

    def columns(self, *names: str) -> pd.DataFrame:
        """Some columns."""
        return pq.read_table(self.path, columns=list(names)).to_pandas()

    def unit(self, name: str) -> str:
        """Unit of a parameter or channel, by its column."""
        said = self.schema.field(name).metadata or {}
        return said.get(b"unit", b"1").decode()

    @property
    def parameters(self) -> list[str]:
        """Fitted parameters, as they are called between `parameter.` and `.std`."""
        return [
            n.removeprefix("parameter.").removesuffix(".told")
            for n in self.schema.names
            if n.startswith("parameter.") and n.endswith(".told")
        ]

    @property
    def channels(self) -> list[str]:
        """Channels that were compared."""
        return [
            n.removeprefix("channel.").removesuffix(".after")
            for n in self.schema.names
            if n.startswith("channel.") and n.endswith(".after")
        ]

    @property
    def labels(self) -> list[str]:
        """Columns that are the user's own."""
        known = (*OWN, *RESULTS)
        return [
            n
            for n in self.schema.names
            if n not in known and not n.startswith(PREFIXES)
        ]

    def told(self, name: str) -> pd.DataFrame:
        """job, value, std, low, high of the fits that tell a parameter.

        Row numbers stay those of the table.
        """
        ends = ("", ".std", ".low", ".high", ".told")
        own: Any = self.columns("job", *(f"parameter.{name}{end}" for end in ends))
        own.columns = ["job", "value", "std", "low", "high", "told"]
        return own[own["told"].fillna(False).astype(bool) & own["value"].notna()]


def label(fleet: Fleet, name: str) -> pd.Series:
    """A label's values: numbers, times (UTC), or text: what all that are filled are."""
    column: Any = fleet.columns(name)[name]
    if column.dtype.kind == "f" or not column.notna().any():
        return column
    try:
        times = pd.to_datetime(column, format="ISO8601", utc=True)
        return times.dt.tz_localize(None)
    except (ValueError, TypeError):
        return column


def robust_z(values: np.ndarray, std: np.ndarray | float = 0.0) -> np.ndarray:
    """(x - median) / sqrt((MAD / 0.6745)^2 + std^2): robust z scores.

    `std` is each value's own: what is known less well may stand further off. 0 where
    more than half of the values are the same.
    """
    middle = np.median(values)
    spread = np.median(np.abs(values - middle)) / 0.6745
    if spread == 0:
        return np.zeros(len(values))
    return (values - middle) / np.hypot(spread, std)


@dataclass(frozen=True)
class Outlier:
    """A job whose `what` (SI) stands apart from the fleet's median."""

    job: str
    what: str
    value: float
    median: float
    unit: str
    z: float


def outliers(fleet: Fleet) -> list[Outlier]:
    """Fits whose parameters, or errors in multiples of the noise, stand apart."""
    out = []
    for name in fleet.parameters:
        own: Any = fleet.told(name)
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
    """A parameter that goes with a label: change from the label's least to its most.

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
            own = fleet.told(parameter)
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
    """How often an effect was found; `alike` are those it was not told from, if any."""

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


@dataclass(frozen=True)
class Bounds:
    """Friction's bounds over the fleet.

    `units` [n] of the box's parameters; `values` [K, n] of the K fits that it is cut
    from, of `of` fits that have friction at all.
    """

    box: Box
    units: tuple[str, ...]
    values: np.ndarray
    of: int


def friction_box(
    records: Sequence[dict[str, Any]], confidence: float = 0.95
) -> Bounds | None:
    """The smallest box that holds the next run's friction at a confidence.

    Of the friction parameters those that most fits tell; of the fits those that tell
    all of these, and about as well as most do. The fits' own uncertainty is taken out
    of their scatter. None where they are fewer than `FEW`.
    """
    good = [r for r in records if r.get("friction")]
    names = tuple(
        n for n in Theta._fields if 2 * sum(_tells(r, n) for r in good) > len(good)
    )
    fits = [r for r in good if all(_tells(r, n) for n in names)]
    if not names or len(fits) < FEW:
        return None
    stretches = [_stretch(r, names) for r in fits]
    std = np.sqrt([np.diag(s.covariance) for s in stretches])
    clear = np.all(std <= LITTLE * np.median(std, axis=0), axis=1)
    if np.count_nonzero(clear) < FEW:
        return None
    stretches = [s for s, known in zip(stretches, clear, strict=True) if known]
    ranges = [[r["friction"]["ranges"][n] for n in names] for r in fits]
    low, high = np.min(ranges, axis=0)[:, 0], np.max(ranges, axis=0)[:, 1]
    limits = list(zip(low.tolist(), high.tolist(), strict=True))
    box = smallest_box(names, stretches, confidence, limits)
    units = tuple(fits[0]["parameters"][n]["unit"] for n in names)
    return Bounds(box, units, np.array([s.theta for s in stretches]), len(good))


def _tells(record: dict[str, Any], name: str) -> bool:
    p = record["parameters"].get(name)
    return bool(p and p["told"]) and name in record["friction"]["ranges"]


def _stretch(record: dict[str, Any], names: tuple[str, ...]) -> Stretch:
    """A fit's friction; what ended at its range's end has no spread of its own."""
    own = record["friction"]
    covariance = np.zeros((len(names), len(names)))
    inside = [n for n in names if n in own["inside"]]
    at = [own["inside"].index(n) for n in inside]
    to = [names.index(n) for n in inside]
    if inside:
        covariance[np.ix_(to, to)] = np.array(own["covariance"])[np.ix_(at, at)]
    theta = np.array([record["parameters"][n]["value"] for n in names])
    return Stretch("", 0.0, 0.0, theta, covariance)
