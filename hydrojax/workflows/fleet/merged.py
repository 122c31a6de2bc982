"""The merged table of a fleet, read by columns so that it need not fit in memory."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.parquet as pq

from hydrojax.workflows.fleet.jobs import OWN, PREFIXES, RESULTS

FEW = 5
"""Number of fits below which no outliers, drifts and bounds are reported."""


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
            n.removeprefix("parameter.").removesuffix(".identified")
            for n in self.schema.names
            if n.startswith("parameter.") and n.endswith(".identified")
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

    def identified(self, name: str) -> pd.DataFrame:
        """job, value, std, low, high of the fits that identify a parameter.

        Row numbers stay those of the table.
        """
        ends = ("", ".std", ".low", ".high", ".identified")
        own: Any = self.columns("job", *(f"parameter.{name}{end}" for end in ends))
        own.columns = ["job", "value", "std", "low", "high", "identified"]
        return own[own["identified"].fillna(False).astype(bool) & own["value"].notna()]


def named(folder: Path, most: int) -> list[str]:
    """A line for each job that failed or came out unknown, `most` of each kind."""
    table = Fleet(folder / "fleet.parquet").columns(
        "job", "verdict", "sentence", "failed"
    )
    kinds = {
        "failed": (table[table["failed"].notna()], "failed"),
        "unknown": (table[table["verdict"] == "unknown"], "sentence"),
    }
    out = []
    for kind, (rows, column) in kinds.items():
        told = zip(rows["job"][:most], rows[column][:most], strict=True)
        out += [f"{kind}: {job}: {why}" for job, why in told]
        if len(rows) > most:
            out.append(f"{kind}: {len(rows) - most} more in fleet.parquet")
    return out


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
