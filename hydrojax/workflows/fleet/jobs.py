"""The table of jobs: which rig is fitted to which logs, and what is known of each."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from pydantic import BaseModel, ConfigDict, ValidationError, field_validator

from hydrojax.errors import InputError, one_line
from hydrojax.logs.tables import TABLES, tidy, unreadable

Command = Literal["identify", "trace"]

OWN = ("job", "rig", "fit", "validate")
"""Columns that say what is done; every other one is a label."""

RESULTS = ("verdict", "sentence", "failed", "effects")
PREFIXES = ("parameter.", "channel.")
LOGS = (*TABLES, ".mcap")


class Job(BaseModel):
    """One row: a rig file, the logs to fit, and those kept for the check.

    Paths are as the table has them: relative ones start at the table's folder.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    rig: str
    fit: tuple[str, ...]
    validate_: tuple[str, ...] = ()

    @field_validator("rig")
    @classmethod
    def _named(cls, rig: str) -> str:
        if not rig.strip():
            raise ValueError("names no rig file")
        return rig.strip()

    @field_validator("fit", "validate_", mode="before")
    @classmethod
    def _several(cls, text: object) -> object:
        if isinstance(text, str):
            return tuple(part.strip() for part in text.split(";") if part.strip())
        return text

    @field_validator("fit")
    @classmethod
    def _some(cls, fit: tuple[str, ...]) -> tuple[str, ...]:
        if not fit:
            raise ValueError("names no log; write one, or several with ; between them")
        return fit


@dataclass(frozen=True)
class Jobs:
    """The jobs of a table, a row each; made one by one, so that a long table is small.

    Attributes:
        source: the table, or the folder of the jobs' folders.
        folder: where relative paths start.
        table: text columns `OWN`, then the labels: numbers, or text. The index counts
            the rows of the file, blank ones too.
    """

    source: Path
    folder: Path
    table: pd.DataFrame

    def __len__(self) -> int:
        return len(self.table)

    def __iter__(self) -> Iterator[Job]:
        own = self.table[list(OWN)]
        for name, rig, fit, validate in own.itertuples(index=False, name=None):
            yield Job(name=name, rig=rig, fit=fit, validate_=validate)

    @property
    def labels(self) -> list[str]:
        """Names of the labels."""
        return [c for c in self.table.columns if c not in OWN]


def read_jobs(source: str | Path, command: Command = "trace") -> Jobs:
    """Read a table (CSV or Parquet), or take every subfolder with a rig.toml as a job.

    Args:
        source: the table, or a folder whose subfolders hold rig.toml, fit* and
            validate*.
        command: what is to be done: `trace` needs logs to validate.

    Raises:
        InputError: no such file, an invalid column, row or cell, or no job.
    """
    source = Path(source)
    if os.path.isdir(source):
        jobs = Jobs(source, source, _folders(source))
    else:
        jobs = Jobs(source, source.parent, _table(source))
    if not len(jobs):
        need = "a subfolder with rig.toml and fit*" if source.is_dir() else "a row"
        raise InputError(f"{source}: holds no job; give it {need} for each")
    _check(jobs, command)
    return jobs


def _folders(folder: Path) -> pd.DataFrame:
    rows = []
    for sub in sorted(p.parent for p in folder.glob("*/rig.toml")):
        found = {
            part: ";".join(f"{sub.name}/{path.name}" for path in _logs(sub, part))
            for part in ("fit", "validate")
        }
        rows.append({"job": sub.name, "rig": f"{sub.name}/rig.toml", **found})
    return pd.DataFrame(rows, columns=list(OWN), dtype=str)


def _logs(folder: Path, part: str) -> list[Path]:
    """Logs whose names begin with `part`; a folder is a bag."""
    every = sorted(folder.glob(f"{part}*"))
    return [p for p in every if p.is_dir() or p.name.lower().endswith(LOGS)]


def _table(path: Path) -> pd.DataFrame:
    ending = path.suffix.lower()
    if ending not in (".csv", ".parquet"):
        raise InputError(
            f"{path}: not a table of jobs; give a .csv, a .parquet, or a folder of jobs"
        )
    if not os.path.isfile(path):
        raise InputError(f"{path}: no such file; check the path")
    frame: Any
    kind = "CSV" if ending == ".csv" else "Parquet"
    try:
        frame = _csv(path) if kind == "CSV" else pd.read_parquet(path)
    except Exception as error:  # every library has its own kinds for a broken file
        hint = f"save it again as {kind}"
        raise unreadable(path, f"{kind} file", error, hint) from error
    names = [tidy(path, str(c)) for c in frame.columns]
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(f"{path}: column {name!r} is there twice; rename one")
    frame.columns = names
    for name in ("rig", "fit", "validate"):
        if name not in frame:
            raise InputError(
                f"{path}: no column {name!r}; a table of jobs has rig, fit and "
                "validate, and optionally job and labels"
            )
    if "job" not in frame:
        frame["job"] = [f"row {i + 1}" for i in range(len(frame))]
    labels = [c for c in frame.columns if c not in OWN]
    for name in labels:
        if name in RESULTS or name.startswith(PREFIXES) or not name:
            raise InputError(
                f"{path}: a label cannot be called {name!r}: results are; rename it"
            )
    text = frame[list(OWN)].fillna("").astype(str)
    for name in OWN:
        odd = np.flatnonzero(~text[name].map(str.isprintable).to_numpy(bool))
        if len(odd):
            raise InputError(
                f"{path}: column {name!r}: {one_line(text[name].iloc[odd[0]], 60)!r} "
                "holds a character that cannot be printed; write it anew"
            )
    return pd.concat([text, frame[labels].apply(_typed)], axis=1)


def _csv(path: Path) -> pd.DataFrame:
    """Text cells of the rows that are not blank; the index still counts those."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)  # cells lost
        frame = pd.read_csv(
            path, dtype=str, keep_default_na=False, encoding="utf-8-sig", header=None,
            skipinitialspace=True, index_col=False, skip_blank_lines=False,
        )  # fmt: skip
    # By hand: pandas would rename the second of two columns of one name.
    frame = frame.fillna("")
    frame.columns = frame.iloc[0].tolist()
    frame = frame.iloc[1:].reset_index(drop=True)
    return frame.loc[frame.ne("").any(axis=1)]


def _typed(column: pd.Series) -> pd.Series:
    """Numbers, where every cell that is filled is one; else text."""
    text: Any = column.astype(str).str.strip().where(column.notna(), "")
    filled = text != ""
    numbers: Any = pd.to_numeric(text.where(filled), errors="coerce")
    numbers = numbers.astype(float)
    if filled.any() and np.isfinite(numbers[filled]).all():
        return numbers
    return text


def _check(jobs: Jobs, command: Command) -> None:
    """Raise on the first invalid row."""

    def where(i: int) -> str:
        if jobs.source.is_dir():
            return jobs.table["job"].iloc[i]
        csv = jobs.source.suffix.lower() == ".csv"
        return f"row {i + 1}" + (f" (line {jobs.table.index[i] + 2})" if csv else "")

    rows = iter(jobs)
    for i in range(len(jobs)):
        try:
            job = next(rows)
        except ValidationError as error:
            first = error.errors()[0]
            column = str(first["loc"][0]).strip("_")
            said = first["msg"].removeprefix("Value error, ")
            raise InputError(f"{jobs.source}: {where(i)}: {column} {said}") from error
        if command == "trace" and not job.validate_:
            raise InputError(
                f"{jobs.source}: {where(i)}: validate names no log; trace needs one "
                "that took no part in the fit; give it, or write --command identify"
            )
    twice = jobs.table["job"].duplicated()
    if twice.any():
        i = int(np.flatnonzero(twice)[0])
        name = jobs.table["job"].iloc[i]
        raise InputError(
            f"{jobs.source}: {where(i)}: job {name!r} is there already; give every job "
            "a name of its own"
        )
