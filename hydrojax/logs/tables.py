"""What a log may hold; files of columns: CSV, Parquet, MAT v5 and v7.3, Excel, TDMS."""

from __future__ import annotations

import importlib
import math
import os
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
from pydantic import AfterValidator, BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError

from hydrojax import units
from hydrojax.errors import WORD, InputError, check_expansion, check_members, one_line
from hydrojax.logs.matfile import read_mat
from hydrojax.logs.texts import Head, head_of, read_text

SIGNALS = {
    "time": "s", "u": "{u}", "psi": "rad", "x": "m", "v": "m/s", "P_a1": "Pa",
    "P_a2": "Pa", "P_s": "Pa", "P_r": "Pa", "P": "N", "F": "N", "F_d": "N",
}  # fmt: skip
"""What a log may hold, and the SI unit; `{u}` is V or 1."""


TABLES = {
    ".csv": "CSV", ".csv.gz": "gzipped CSV", ".txt": "text", ".tsv": "text",
    ".parquet": "Parquet", ".mat": "MAT", ".xlsx": "Excel", ".tdms": "TDMS",
}  # fmt: skip
"""Files of columns, by how their names end."""


_CELL = 64
"""Bytes that a cell of a sheet takes, about."""


LONGEST_DELAY = 1.0
"""Seconds that a column may be late, or early, at most."""


def _delay(text: str) -> str:
    with suppress(InputError):
        if abs(units.quantity(text, "s", "delay")) <= LONGEST_DELAY:
            return text
    raise PydanticCustomError("delay", "no delay")


class Channel(BaseModel):
    """One line of the rig file's [channels]: where a signal is in the logs.

    `scale` is what the column is multiplied by beside its unit, as for a gauge whose
    span is off. `delay` is how long after the other columns it shows the same moment,
    as a sensor behind a slow bus does; below 0 where it shows it earlier. `held` is of
    the command `u` alone: whether it stands at a row's value until the next row, as a
    digital controller's does, or runs on to it in a straight line, as a joystick's.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    column: str
    unit: str | None = None
    invert: bool = False
    scale: float = Field(default=1.0, gt=0, lt=math.inf)
    delay: Annotated[str, AfterValidator(_delay)] = "0 s"
    held: bool = True

    @property
    def late(self) -> float:
        """The delay, s."""
        return units.quantity(self.delay, "s", "delay")

    @property
    def factor(self) -> float:
        """What the column is multiplied by, its sign included."""
        return -self.scale if self.invert else self.scale


@dataclass(frozen=True)
class Column:
    """One column as the file has it."""

    label: str  # as the file has it, for messages
    name: str
    unit: str | None
    values: Any


@dataclass(frozen=True)
class File:
    """A file's columns, and how to speak of its rows."""

    path: Path
    columns: list[Column]
    header: int  # lines before the first row, 0 if rows are not lines
    notes: tuple[str, ...] = ()  # remarks on how it was read

    def row(self, index: int) -> str:
        """What a message calls the row: its number, and its line where it has one."""
        line = f" (line {index + 1 + self.header})" if self.header else ""
        return f"row {index + 1}{line}"


def read_table(path: Path) -> File:
    """Read a file of columns by what its name says it is.

    Raises:
        InputError: no such file, an unknown kind, or contents that are not that kind.
    """
    ending = next((e for e in TABLES if path.name.lower().endswith(e)), None)
    if ending is None:
        raise InputError(
            f"{path}: not a kind of log; save it as {', '.join(TABLES)} or .mcap"
        )
    if not os.path.isfile(path):  # whatever the name is
        raise InputError(f"{path}: no such file; check the path")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty; export the log again")
    kinds = {
        "CSV": _csv, "gzipped CSV": _csv, "text": _csv, "Parquet": _parquet,
        "MAT": _mat, "Excel": _xlsx, "TDMS": _tdms,
    }  # fmt: skip
    kind = TABLES[ending]
    try:
        return kinds[kind](path)
    except InputError:
        raise
    except Exception as err:  # every library has its own kinds for a broken file
        mend = f"export it again as {kind}"
        raise unreadable(path, f"{kind} file", err, mend) from err


def is_bag(path: Path) -> bool:
    """Whether a path names what `read_bag` reads: .mcap, .db3, or any folder."""
    return path.suffix.lower() in (".mcap", ".db3") or os.path.isdir(path)


def table_of(frame: pd.DataFrame, units: Mapping[str, str], name: str) -> File:
    """The columns of a table that is not a file; see `Log.from_frame`."""
    if any(own is not None for own in frame.index.names):
        frame = frame.reset_index()
    given = {**frame.attrs.get("units", {}), **units}
    path = Path(name)
    columns = [
        _labelled(path, label, frame.iloc[:, i]) for i, label in enumerate(frame)
    ]
    columns = [replace(c, unit=given.get(c.name, c.unit)) for c in columns]
    return File(path, columns, header=0)


def unreadable(path: Path, kind: str, error: Exception, mend: str) -> InputError:
    """What to raise where a library cannot read a file of the kind."""
    words = " ".join(str(error).replace(f" '{path}'", "").split())[:100]
    long = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", words)
    if long:  # as pandas says it
        words = f"line {long[2]} has {long[3]} cells, {long[1]} columns are named"
    return InputError(
        f"{path}: not a readable {kind} ({words or type(error).__name__}); {mend}"
    )


_UNIT = re.compile(r"(.*?)\s*\[(.*)\]|(.*?\S)\s*(?:\(([^()]*)\)|\s/\s(\S+))")
"""`name [unit]`; and `name (unit)`, `name / unit`, where it is a unit of a signal."""


def tidy(path: Path, name: str) -> str:
    """A column's name in one line, as it is compared and shown.

    Raises:
        InputError: a name that is too long.
    """
    if len(name) > WORD:
        raise InputError(
            f"{path}: column {one_line(name, 60)!r}: a name of {len(name)} characters "
            f"is too long; give it one of at most {WORD}"
        )
    return one_line(" ".join(name.split()))


def _labelled(
    path: Path, label: object, values: Any, below: str | None = None
) -> Column:
    """A column called `name [unit]`; `below`: the cell of a row of units."""
    text = tidy(path, str(label))
    match = _UNIT.fullmatch(text)
    if match is None:
        return Column(text, text, below or None, values)
    if match[1] is not None:
        return Column(text, match[1], match[2].strip() or below or None, values)
    unit = (match[4] or match[5] or "").strip()
    wants = ("s", "V", "m", "m/s", "rad", "Pa", "N")
    if not re.search("[a-z%°]", unit) or not any(units.fits(unit, w) for w in wants):
        return Column(text, text, below or None, values)
    return Column(text, match[3], unit, values)


def _csv(path: Path) -> File:
    head, values, notes = read_text(path)
    return _headed(path, head, values, notes)


def _headed(path: Path, head: Head, values: Sequence[Any], notes: tuple = ()) -> File:
    """A file whose labels, and units, stand in rows of it."""
    check_members(len(head.labels), path)
    below = head.units or [""] * len(head.labels)
    columns = [
        _labelled(path, label, cells, unit)
        for label, unit, cells in zip(head.labels, below, values, strict=True)
    ]
    return File(path, columns, head.lines, notes)


def _parquet(path: Path) -> File:
    import pyarrow as pa  # slow to import
    from pyarrow import dataset
    from pyarrow import parquet as pq

    with pq.ParquetFile(path) as file:
        said = file.metadata
        check_members(said.num_columns, path)
        check_expansion(said.num_rows * said.num_columns * 8, path)
    # Column by column, each let go as it is taken over, and given back to the system,
    # which Arrow's own allocator puts off: long logs are large.
    pool = pa.system_memory_pool()
    table = dataset.dataset(path, format="parquet").to_table(memory_pool=pool)
    frame = table.to_pandas(memory_pool=pool, split_blocks=True, self_destruct=True)
    del table
    if any(name is not None for name in frame.index.names):
        frame = frame.reset_index()
    columns = [_labelled(path, name, frame.iloc[:, i]) for i, name in enumerate(frame)]
    return File(path, columns, header=0)


def _mat(path: Path) -> File:
    tree = read_mat(path)
    check_members(len(tree), path)
    inner = tree.pop("log", {})
    tree |= inner if isinstance(inner, dict) else {"log": inner}
    given = tree.pop("units", {})
    given = given if isinstance(given, dict) else {}
    said = {k: v for k, v in given.items() if isinstance(v, str)}
    for name in list(tree):
        if f"{name}_unit" in tree:
            said[name] = str(tree.pop(f"{name}_unit"))
    names = {k: tidy(path, k) for k in tree}
    columns = [
        Column(names[k], names[k], said.get(k, "").strip() or None, v)
        for k, v in tree.items()
    ]
    return File(path, columns, header=0)


def _xlsx(path: Path) -> File:
    """The one sheet of an Excel file that holds a table."""
    openpyxl = _package(path, "openpyxl", "xlsx")
    with zipfile.ZipFile(path) as parts:
        check_expansion(sum(p.file_size for p in parts.infolist()), path)
    book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    try:
        sheets = {s.title: list(_rows(s, path)) for s in book.worksheets}
    finally:
        book.close()
    tables = {title: rows for title, rows in sheets.items() if len(rows) > 20}
    if len(tables) != 1:
        which = f"{len(tables)} sheets ({', '.join(tables)})" if tables else "no sheet"
        raise InputError(
            f"{path}: {which} with more than 20 rows; keep the run's sheet alone"
        )
    ((rows),) = tables.values()
    text = [["" if c is None else str(c) for c in row] for row in rows[:50]]
    head = head_of(text, str(path))
    kept = [i for i, label in enumerate(head.labels) if label]
    filled = [row for row in rows[head.lines :] if any(c is not None for c in row)]
    values = [
        pd.Series([r[i] if i < len(r) else None for r in filled]).infer_objects()
        for i in kept
    ]
    below = None if head.units is None else [head.units[i] for i in kept]
    short = Head([head.labels[i] for i in kept], below, head.lines)
    return _headed(path, short, values)


def _rows(sheet: Any, path: Path) -> Iterator[tuple[Any, ...]]:
    """The rows of a sheet; one cell far off would make millions of empty ones."""
    cells = 0
    for row in sheet.iter_rows(values_only=True):
        cells += len(row)
        check_members(len(row), path)
        check_expansion(_CELL * cells, path)
        yield row


def _tdms(path: Path) -> File:
    """The channels of a TDMS file; time from their common sampling, if not logged."""
    nptdms = _package(path, "nptdms", "tdms")
    with nptdms.TdmsFile.open(path) as file:
        channels = [c for g in file.groups() for c in g.channels() if len(c)]
        check_members(len(channels), path)
        check_expansion(8 * sum(map(len, channels)), path)
        read = [(c.group_name, c.name, dict(c.properties), c[:]) for c in channels]
    names = [name for _, name, _, _ in read]
    columns, steps = [], set()
    for group, name, given, values in read:
        label = name if names.count(name) == 1 else f"{group}/{name}"
        unit = str(given.get("unit_string") or given.get("NI_UnitDescription") or "")
        columns.append(_labelled(path, label, pd.Series(values), unit.strip()))
        start = given.get("wf_start_offset", 0.0)
        steps.add((given.get("wf_increment"), start, len(values)))
    if not any(c.name == "time" for c in columns) and len(steps) == 1:
        ((step, start, rows),) = steps
        if step:
            time = start + step * np.arange(rows)
            columns.insert(0, Column("time", "time", "s", time))
    return File(path, columns, header=0)


def _package(path: Path, name: str, extra: str) -> Any:
    """A package that only one kind of file needs.

    Raises:
        InputError: it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError as err:
        raise InputError(
            f"{path}: reading it needs {name}; pip install 'hydrojax[{extra}]', or "
            "save the log as CSV"
        ) from err
