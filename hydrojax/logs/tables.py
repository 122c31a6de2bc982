"""What a log may hold; files of columns: CSV, Parquet, MAT v5 and v7.3."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import scipy.io
from pydantic import BaseModel, ConfigDict

from hydrojax.errors import InputError, one_line
from hydrojax.limits import MEMBERS, TEXT, WORD, BoundedGzip, check_expansion
from hydrojax.logs import matfile

SIGNALS = {
    "time": "s", "u": "{u}", "psi": "rad", "x": "m", "v": "m/s", "P_a1": "Pa",
    "P_a2": "Pa", "P_s": "Pa", "P_r": "Pa", "P": "N", "F": "N", "F_d": "N",
}  # fmt: skip
"""What a log may hold, and the SI unit; `{u}` is V or 1."""


class Channel(BaseModel):
    """One line of the rig file's [channels]: where a signal is in the logs."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    column: str
    unit: str | None = None
    invert: bool = False


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
    kinds = {
        ".csv": ("CSV", _csv), ".csv.gz": ("gzipped CSV", _csv),
        ".parquet": ("Parquet", _parquet), ".mat": ("MAT", _mat),
    }  # fmt: skip
    ending = next((e for e in kinds if path.name.lower().endswith(e)), None)
    if ending is None:
        raise InputError(
            f"{path}: not a kind of log; save it as {', '.join(kinds)} or .mcap"
        )
    if not path.is_file():
        raise InputError(f"{path}: no such file; check the path")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty; export the log again")
    kind, reader = kinds[ending]
    try:
        columns = reader(path)
    except InputError:
        raise
    except Exception as err:  # every library has its own kinds for a broken file
        mend = f"export it again as {kind}"
        raise unreadable(path, f"{kind} file", err, mend) from err
    return File(path, columns, header=1 if reader is _csv else 0)


def is_bag(path: Path) -> bool:
    """Whether a path names what `read_bag` reads: .mcap, .db3, or any folder."""
    return path.suffix.lower() in (".mcap", ".db3") or path.is_dir()


def table_of(frame: pd.DataFrame, units: Mapping[str, str], name: str) -> File:
    """The columns of a table that is not a file; see `Log.from_frame`."""
    if any(own is not None for own in frame.index.names):
        frame = frame.reset_index()
    given = {**frame.attrs.get("units", {}), **units}
    columns = [
        _labelled(Path(name), label, frame.iloc[:, i]) for i, label in enumerate(frame)
    ]
    columns = [replace(c, unit=given.get(c.name, c.unit)) for c in columns]
    return File(Path(name), columns, header=0)


def unreadable(path: Path, kind: str, error: Exception, mend: str) -> InputError:
    """What to raise where a library cannot read a file of the kind."""
    words = " ".join(str(error).replace(f" '{path}'", "").split())[:100]
    return InputError(
        f"{path}: not a readable {kind} ({words or type(error).__name__}); {mend}"
    )


def tidy(name: str) -> str:
    """A column's name in one line, as it is compared and shown."""
    return one_line(" ".join(name.split()))


def _labelled(path: Path, label: object, values: Any) -> Column:
    """A column called `name [unit]`."""
    text = str(label)
    if len(text) > WORD:
        raise InputError(
            f"{path}: column {one_line(text, 60)!r}: a name of {len(text)} characters "
            f"is too long; give it one of at most {WORD}"
        )
    text = tidy(text)
    if not text.endswith("]") or "[" not in text:
        return Column(text, text, None, values)
    name, _, unit = text[:-1].partition("[")
    return Column(text, name.rstrip(), unit.strip() or None, values)


def _few(count: int, path: Path) -> None:
    if count > MEMBERS:
        raise InputError(
            f"{path}: {count} columns are more than the {MEMBERS} that are read; "
            "export those that are needed"
        )


def _csv(path: Path) -> list[Column]:
    options: dict[str, Any] = {
        "encoding": "utf-8-sig",
        "skipinitialspace": True,
        "header": None,
        "skip_blank_lines": False,  # so that rows can be counted in lines
        "index_col": False,
    }
    with _opened(path) as file:
        first = file.read(TEXT)
    if len(first) == TEXT and b"\n" not in first:
        raise InputError(
            f"{path}: its first line has more than {TEXT} bytes; it is to hold the "
            "columns' names, and every row is to have a line of its own"
        )
    with _opened(path) as file:
        labels = pd.read_csv(file, nrows=1, dtype=str, **options).iloc[0].fillna("")
    _few(len(labels), path)
    with warnings.catch_warnings(), _opened(path) as file:
        warnings.simplefilter("error", pd.errors.ParserWarning)  # cells lost
        frame = pd.read_csv(
            file, skiprows=1, names=range(len(labels)), low_memory=False, **options
        )
    filled = np.flatnonzero(frame.notna().any(axis=1))
    frame = frame.iloc[: filled[-1] + 1 if len(filled) else 0]
    return [_labelled(path, label, frame[i]) for i, label in enumerate(labels)]


def _opened(path: Path) -> Any:
    """A CSV's bytes."""
    return (BoundedGzip if path.name.lower().endswith(".gz") else open)(path, "rb")


def _parquet(path: Path) -> list[Column]:
    import pyarrow as pa  # slow to import
    from pyarrow import dataset
    from pyarrow import parquet as pq

    with pq.ParquetFile(path) as file:
        said = file.metadata
        _few(said.num_columns, path)
        check_expansion(said.num_rows * said.num_columns * 8, path)
    # Column by column, each let go as it is taken over, and given back to the system,
    # which Arrow's own allocator puts off: long logs are large.
    pool = pa.system_memory_pool()
    table = dataset.dataset(path, format="parquet").to_table(memory_pool=pool)
    frame = table.to_pandas(memory_pool=pool, split_blocks=True, self_destruct=True)
    del table
    if any(name is not None for name in frame.index.names):
        frame = frame.reset_index()
    return [
        _labelled(path, name, frame.iloc[:, i]) for i, name in enumerate(frame.columns)
    ]


def _mat(path: Path) -> list[Column]:
    if h5py.is_hdf5(path):
        with h5py.File(path, "r") as file:
            tree = _from_hdf5(file, path)
    else:
        matfile.check(path)
        tree = scipy.io.loadmat(path, simplify_cells=True)
        tree = {k: v for k, v in tree.items() if not k.startswith("__")}
    _few(len(tree), path)
    inner = tree.pop("log", {})
    tree |= inner if isinstance(inner, dict) else {"log": inner}
    given = tree.pop("units", {})
    given = given if isinstance(given, dict) else {}
    said = {k: v for k, v in given.items() if isinstance(v, str)}
    for name in list(tree):
        if f"{name}_unit" in tree:
            said[name] = str(tree.pop(f"{name}_unit"))
    columns = [_labelled(path, k, v) for k, v in tree.items()]
    return [
        replace(c, name=c.label, unit=(said.get(k, "")).strip() or None)
        for k, c in zip(tree, columns, strict=True)
    ]


def _from_hdf5(group: h5py.Group, path: Path) -> dict[str, Any]:
    """A v7.3 file as a dict; what is a struct in it is a dict, if it can be of use."""
    tree = _stored(group, path, ("log", "units"))
    sizes = (int(d.size or 0) * max(int(d.dtype.itemsize), 8) for d in _datasets(tree))
    check_expansion(sum(sizes), path)
    return _values(tree)


def _stored(group: h5py.Group, path: Path, structs: tuple[str, ...]) -> dict[str, Any]:
    """The datasets in a group, and in the groups of some names.

    Only what MATLAB itself stores is taken: links lead to other places of the file, or
    to other files, and virtual and external datasets hold the bytes of any file.
    """
    tree: dict[str, Any] = {}
    _few(len(group), path)
    for name in map(str, group):
        if name.startswith("#"):  # MATLAB's store of cells
            continue
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            raise InputError(
                f"{path}: {name!r} is a link to another place, which is not followed; "
                "store the values themselves"
            )
        item = group[name]
        if isinstance(item, h5py.Group) and name in structs:
            tree[name] = _stored(item, path, structs[1:])
        elif isinstance(item, h5py.Dataset):
            if item.external or item.is_virtual:
                raise InputError(
                    f"{path}: {name!r} has its values in another file, which is not "
                    "read; store the values themselves"
                )
            tree[name] = item
    return tree


def _datasets(tree: dict[str, Any]) -> Iterator[h5py.Dataset]:
    for item in tree.values():
        yield from _datasets(item) if isinstance(item, dict) else (item,)


def _values(tree: dict[str, Any]) -> dict[str, Any]:
    """The values of datasets; text is uint16 arrays."""
    out = {}
    for name, item in tree.items():
        value: Any = _values(item) if isinstance(item, dict) else item[()]
        if not isinstance(item, dict) and item.attrs.get("MATLAB_class") == b"char":
            value = "".join(map(chr, np.ravel(value, order="F")[:WORD]))
        out[name] = value.decode() if isinstance(value, bytes) else value
    return out
