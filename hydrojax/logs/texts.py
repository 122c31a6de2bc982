"""Text files of columns as labs have them: separators, decimals, encodings, units.

What a file leaves no doubt about is read; where two readings are possible the file is
refused with the line to write.
"""

from __future__ import annotations

import codecs
import csv
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from hydrojax import units
from hydrojax.errors import BoundedGzip, InputError

_SAMPLE = 1 << 18
"""Bytes of a file that decide how it is read."""

_NUMBER = re.compile(
    r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.I
)
_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_POINT = re.compile(r"[+-]?\d*\.\d+([eE][+-]?\d+)?")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
_BOTH = re.compile(r"[+-]?\d{1,3}(\.\d{3})+,\d+|[+-]?\d{1,3}(,\d{3})+\.\d+")
DATE = re.compile(r"\d{1,4}[-./]\d{1,2}[-./]\d{1,4}.*|\d{1,2}:\d{2}(:.*)?")


@dataclass(frozen=True)
class Head:
    """What stands above the rows of a table.

    Attributes:
        labels: of the columns.
        units: of the columns, "" where there is none; None without a row of units.
        lines: before the first row.
    """

    labels: list[str]
    units: list[str] | None
    lines: int


@dataclass(frozen=True)
class TextForm:
    """How a text file writes its table."""

    encoding: str
    separator: str
    decimal: str
    head: Head

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks, where it is not plain CSV."""
        separators = {";": "semicolons between columns", "\t": "tabs between columns"}
        said = {
            separators.get(self.separator, ""): True,
            "decimal commas": self.decimal == ",",
            f"encoded as {self.encoding.upper()}": "utf-8" not in self.encoding,
            "a row of units": self.head.units is not None,
        }
        found = [text for text, true in said.items() if text and true]
        return (f"read with {', '.join(found)}",) if found else ()


def read_text(path: Path) -> tuple[Head, list[Any], tuple[str, ...]]:
    """The head of a text file, its columns and remarks on how it was read.

    Raises:
        InputError: it can be read in more than one way.
        Exception: whatever the libraries raise on what is no text, or no table.
    """
    form = _form(path)
    with warnings.catch_warnings(), _opened(path) as file:
        warnings.simplefilter("error", pd.errors.ParserWarning)  # cells lost
        frame = pd.read_csv(
            file,
            skiprows=form.head.lines,
            names=range(len(form.head.labels)),
            low_memory=False,
            encoding=form.encoding,
            sep=form.separator,
            decimal=form.decimal,
            skipinitialspace=True,
            header=None,
            skip_blank_lines=False,  # so that rows can be counted in lines
            index_col=False,
        )
    filled = np.flatnonzero(frame.notna().any(axis=1))
    frame = frame.iloc[: filled[-1] + 1 if len(filled) else 0]
    columns = [frame[i] for i in range(len(form.head.labels))]
    if form.decimal == ",":  # a column with a word in it stays text: as others have it
        columns = [
            c.str.replace(",", ".") if c.dtype.kind not in "biuf" else c
            for c in columns
        ]
    return form.head, columns, form.notes


def head_of(rows: Sequence[Sequence[str]], where: str) -> Head:
    """Labels and units in the first rows of a table, without comments ahead of it.

    Args:
        rows: cells as text; a comment's first one begins with #.
        where: opens an error's line.

    Raises:
        InputError: a row of words that are not units follows the labels.
    """
    first = next((i for i, r in enumerate(rows) if not _comment(r)), len(rows))
    if first and first < len(rows) and _is_data(rows[first]):
        # As NumPy writes it: the labels are the last comment.
        cells = [c.strip() for c in rows[first - 1]]
        cells[0] = cells[0].lstrip("#").strip()
        if len(cells) == len(rows[first]):
            return Head(cells, None, first)
    labels = [cell.strip() for cell in rows[first]] if first < len(rows) else [""]
    after = [cell.strip() for cell in rows[first + 1]] if first + 1 < len(rows) else []
    below = rows[first + 2 : first + 3]
    words = bool(after) and any(after) and not any(map(_is_value, after))
    if not words or not any(_is_data(r) for r in below) or len(after) != len(labels):
        return Head(labels, None, first + 1)
    bare = [re.sub(r"^[\[(](.*)[\])]$", r"\1", cell).strip() for cell in after]
    if not any(_is_unit(cell) for cell in bare):
        raise InputError(
            f"{where}, line {first + 2}: {after[0]!r} … is neither numbers nor units; "
            "delete the line, or write units such as s, V, mm, bar in it"
        )
    return Head(labels, bare, first + 2)


def _comment(row: Sequence[str]) -> bool:
    return not any(c.strip() for c in row) or row[0].lstrip().startswith("#")


def _is_value(cell: str) -> bool:
    cell = cell.strip()
    kinds = (_NUMBER, _COMMA, DATE)
    return any(kind.fullmatch(cell) for kind in kinds)


def _is_data(row: Sequence[str]) -> bool:
    """Whether a row holds numbers or dates, and no words."""
    filled = [cell for cell in row if cell.strip()]
    return bool(filled) and all(map(_is_value, filled))


def _is_unit(cell: str) -> bool:
    """Whether a cell is the unit of something that a log may hold."""
    wants = ("s", "V", "1", "m", "m/s", "Pa", "N")
    return bool(cell) and any(units.fits(cell, want) for want in wants)


def _opened(path: Path) -> Any:
    """A text file's bytes."""
    return (BoundedGzip if path.name.lower().endswith(".gz") else open)(path, "rb")


def _form(path: Path) -> TextForm:
    """How a file is written, from its first lines."""
    with _opened(path) as file:
        raw = file.read(_SAMPLE)
    encoding = _encoding(raw)
    text = codecs.getincrementaldecoder(encoding)("strict").decode(raw)
    lines = text.splitlines()
    if len(raw) == _SAMPLE:
        lines.pop()  # cut short
    if not lines:
        raise InputError(
            f"{path}: its first line has more than {_SAMPLE} bytes; it is to hold the "
            "columns' names, and every row is to have a line of its own"
        )
    body = [line for line in lines if line.strip() and not line.startswith("#")]
    separator = _separator(body[:50])
    # Each row as wide as its line; quoted line ends count as lines.
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    rows = list(reader)
    head = head_of(rows, str(path))
    cells = rows[head.lines :]
    return TextForm(encoding, separator, _decimal(cells, separator, head, path), head)


def _encoding(raw: bytes) -> str:
    """The encoding of a text, by its byte-order mark or by what its bytes can be."""
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    even, odd = raw[:4096:2].count(0), raw[1:4096:2].count(0)
    if max(even, odd) > 0.4 * min(len(raw), 4096) / 2 and not min(even, odd):
        return "utf-16-le" if odd else "utf-16-be"
    try:
        codecs.getincrementaldecoder("utf-8")("strict").decode(raw)
    except UnicodeDecodeError:
        control = bytes(range(9)) + bytes(range(14, 32)) + bytes(range(127, 160))
        if raw.count(b"\n") > 1 and not set(raw) & set(control):
            return "latin-1"
    return "utf-8-sig"


def _separator(lines: Sequence[str]) -> str:
    """What stands between the cells: tab or semicolon where every line has as many."""
    for separator in ("\t", ";"):
        counts = [len(row) for row in csv.reader(lines, delimiter=separator)]
        if len(counts) > 1 and min(counts) > 1 and len(set(counts[1:])) == 1:
            return separator
    return ","


def _decimal(
    rows: Sequence[Sequence[str]], separator: str, head: Head, path: Path
) -> str:
    """The decimal sign of a table's cells.

    Raises:
        InputError: commas stand between columns and in numbers; points and commas are
            mixed; or what stands behind the commas may be thousands.
    """
    wide = 2 * len(head.labels)
    if separator == ",":
        if (
            len(rows) > 1
            and len(head.labels) > 1
            and all(len(r) == wide for r in rows[:-1])
        ):
            raise InputError(
                f"{path}: commas stand between the columns and in the numbers; export "
                "it with semicolons between the columns, or with decimal points"
            )
        return "."
    commas = None
    for index, row in enumerate(rows):
        for cell in map(str.strip, row):
            where = f"{path}, line {index + 1 + head.lines}: {cell!r}"
            if _BOTH.fullmatch(cell):
                raise InputError(
                    f"{where} has a thousands separator; export without it"
                )
            if _COMMA.fullmatch(cell):
                sure = not _THOUSANDS.fullmatch(cell)
                commas = where if commas is None else commas
                if sure:
                    return _without_points(rows, head, path)
    if commas is None:
        return "."
    raise InputError(
        f"{commas} may be a thousand or a decimal comma; export it with decimal points"
    )


def _without_points(rows: Sequence[Sequence[str]], head: Head, path: Path) -> str:
    """A decimal comma, where no number has a point."""
    for index, row in enumerate(rows):
        for cell in map(str.strip, row):
            if _POINT.fullmatch(cell):
                raise InputError(
                    f"{path}, line {index + 1 + head.lines}: {cell!r} has a decimal "
                    "point, other numbers have a comma; export all with points"
                )
    return ","
