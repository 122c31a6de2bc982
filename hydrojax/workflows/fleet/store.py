"""Results: a small file per job as it is done, and one table of all of them.

`DIR/jobs/ab/ab….json` is a job's result, whole or not there. `ab….again.json` is one
that failed for a reason that may pass: the next run tries it again. A result that is
damaged, or was stored under another key, counts as none: its job is done again.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from hydrojax.report.files import DRAFT, write_one
from hydrojax.workflows.fleet.jobs import Jobs

ROWS = 4096
"""Rows that are in memory at once while the table is written."""

AGAIN = ".again.json"
HASH = "sha256"
"""In a result: the hash of all the rest."""

STALE = 60.0
"""Seconds after which a draft can have no writer any more."""


@dataclass(frozen=True)
class Store:
    """The results in a folder."""

    folder: Path

    def _path(self, key: str, ending: str = ".json") -> Path:
        return self.folder / "jobs" / key[:2] / f"{key}{ending}"

    def has(self, key: str) -> bool:
        """Whether a job is done for good."""
        return self._path(key).exists()

    def save(self, key: str, record: dict[str, Any], final: bool) -> None:
        """Keep a result, whole or not at all, with a hash of it."""
        path = self._path(key, ".json" if final else AGAIN)
        own = record | {"key": key}
        text = json.dumps(own | {HASH: _hash(own)}, allow_nan=False, ensure_ascii=False)
        write_one(path, f"{text}\n".encode())
        if final:
            self._path(key, AGAIN).unlink(missing_ok=True)

    def load(self, key: str) -> dict[str, Any] | None:
        """A result; None where there is none that is this key's and undamaged."""
        ending = ".json" if self.has(key) else AGAIN
        try:
            found = json.loads(self._path(key, ending).read_bytes())
            sound = found.pop(HASH) == _hash(found) and found["key"] == key
        except (
            OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError,
        ):  # fmt: skip
            return None
        return found if sound else None

    def drop(self, keys: Iterable[str]) -> None:
        """Forget results."""
        for key, ending in product(keys, (".json", AGAIN)):
            self._path(key, ending).unlink(missing_ok=True)

    def done(self) -> set[str]:
        """Keys of all jobs that are done for good."""
        found: set[str] = set()
        for shard in self.folder.glob("jobs/[!.]*"):
            for entry in os.scandir(shard):
                key, _, ending = entry.name.partition(".")
                if ending == "json":
                    found.add(key)
        return found

    def clear(self) -> None:
        """Remove drafts that a killed run has left."""
        for pattern in (f"jobs/*/{DRAFT}*", f"{DRAFT}*"):
            for draft in self.folder.glob(pattern):
                with suppress(OSError):
                    if time.time() - draft.stat().st_mtime < STALE:
                        continue
                    if draft.is_dir():
                        shutil.rmtree(draft, ignore_errors=True)
                    else:
                        draft.unlink(missing_ok=True)


def _hash(record: Mapping[str, Any]) -> str:
    own = {name: value for name, value in record.items() if name != HASH}
    text = json.dumps(own, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass
class _Columns:
    """The columns that results turn out to have, in the order they are first seen."""

    units: dict[str, list[str]] = field(default_factory=dict)
    channels: dict[str, str] = field(default_factory=dict)

    def see(self, record: dict[str, Any]) -> None:
        for name, p in record.get("parameters", {}).items():
            known = self.units.setdefault(name, [])
            if p["unit"] not in known:
                known.append(p["unit"])
        for name, c in record.get("channels", {}).items():
            self.channels.setdefault(name, c["unit"])

    def parameter(self, name: str, unit: str) -> str:
        """A parameter's column; with its unit where rigs have it in several."""
        several = len(self.units[name]) > 1
        return f"parameter.{name} [{unit}]" if several else f"parameter.{name}"


PARAMETER = {"": "value", ".std": "std", ".low": "low", ".high": "high"}
CHANNEL = ("noise", "before", "after")


def merge(
    store: Store, jobs: Jobs, keys: Sequence[str], mark: str
) -> tuple[list[str], int]:
    """Write fleet.parquet and seconds.parquet: a row per job, in the table's order.

    The same results give the same bytes of fleet.parquet; what differs from run to run
    is in seconds.parquet alone. Results pass through memory `ROWS` at a time.

    Args:
        store: holds a result of every key.
        jobs: the table.
        keys: of the jobs, in order.
        mark: kept with the table; see `merged`.

    Returns:
        Keys whose result cannot be read (then nothing is written), and how many failed.
    """
    columns, unread, failed = _Columns(), [], 0
    for key in keys:
        record = store.load(key)
        if record is None:
            unread.append(key)
        else:
            columns.see(record)
            failed += bool(record["failed"])
    if unread:
        return unread, failed
    schema = _schema(jobs, columns, mark)
    # fleet.parquet is the last, since its mark means that both are complete.
    _write(store.folder / "seconds.parquet", SECONDS, _seconds(store, jobs, keys))
    _write(store.folder / "fleet.parquet", schema, _rows(store, jobs, keys, columns))
    return [], failed


def merged(store: Store) -> str:
    """The mark of the table in the folder; "" where it has none."""
    try:
        found = pq.read_schema(store.folder / "fleet.parquet").metadata or {}
        return found.get(b"hydrojax", b"").decode()
    except (OSError, ValueError, pa.ArrowException):  # damaged
        return ""


def _schema(jobs: Jobs, columns: _Columns, mark: str) -> pa.Schema:
    text, number = pa.string(), pa.float64()
    fields = [pa.field(n, text) for n in ("job", "rig", "fit", "validate")]
    for name in jobs.labels:
        fields.append(pa.field(name, number if _is_number(jobs, name) else text))
    fields += [pa.field(n, text) for n in ("verdict", "sentence", "failed", "effects")]
    for name, units in columns.units.items():
        for unit in units:
            stem = columns.parameter(name, unit)
            said = {"unit": unit}
            fields += [pa.field(stem + e, number, metadata=said) for e in PARAMETER]
            fields.append(pa.field(f"{stem}.identified", pa.bool_()))
    for name, unit in columns.channels.items():
        said = {"unit": unit}
        fields += [
            pa.field(f"channel.{name}.{e}", number, metadata=said) for e in CHANNEL
        ]
    return pa.schema(fields, metadata={"hydrojax": mark})


def _is_number(jobs: Jobs, name: str) -> bool:
    return jobs.table[name].dtype.kind == "f"


def _rows(
    store: Store, jobs: Jobs, keys: Sequence[str], columns: _Columns
) -> Iterator[dict[str, Any]]:
    own = list(jobs.table.columns)
    for key, cells in zip(
        keys, jobs.table.itertuples(index=False, name=None), strict=True
    ):
        record = store.load(key) or {}
        row = dict(zip(own, cells, strict=True))
        for name in jobs.labels:
            row[name] = None if row[name] == "" or row[name] != row[name] else row[name]
        for name in ("verdict", "sentence", "failed"):
            row[name] = record.get(name) or None
        if not record.get("failed"):
            row["effects"] = ";".join(e["name"] for e in record.get("effects", []))
        for name, p in record.get("parameters", {}).items():
            stem = columns.parameter(name, p["unit"])
            row |= {stem + end: p[what] for end, what in PARAMETER.items()}
            row[f"{stem}.identified"] = p["identified"]
        for name, c in record.get("channels", {}).items():
            row |= {f"channel.{name}.{e}": c[e] for e in CHANNEL}
        yield row


SECONDS = pa.schema(
    [("job", pa.string())] + [(n, pa.float64()) for n in ("all", "compile", "run")]
)


def _seconds(store: Store, jobs: Jobs, keys: Sequence[str]) -> Iterator[dict[str, Any]]:
    for key, name in zip(keys, jobs.table["job"], strict=True):
        record = store.load(key) or {}
        yield {"job": name} | record.get("seconds", {})


def _write(path: Path, schema: pa.Schema, rows: Iterator[dict[str, Any]]) -> None:
    """A table from rows, whole or not at all; absent cells are null."""
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=DRAFT) as beside:
        draft = Path(beside) / path.name
        with pq.ParquetWriter(draft, schema, compression="zstd") as writer:
            block: list[dict[str, Any]] = []
            for row in rows:
                block.append(row)
                if len(block) == ROWS:
                    writer.write_table(pa.Table.from_pylist(block, schema=schema))
                    block = []
            if block:
                writer.write_table(pa.Table.from_pylist(block, schema=schema))
        os.replace(draft, path)
