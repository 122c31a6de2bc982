"""MAT files: v7.3, which are HDF5, and v5, looked over before SciPy reads them.

SciPy takes sizes and depths from the file as they are: a few bytes could have it take
gigabytes, or overrun the stack. HDF5 reads other files where the file says so.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io

from hydrojax.errors import MEMBERS, WORD, InputError, check_expansion, check_members

DEEPEST = 4
"""Structs and cells within each other; a log has variables, in a struct, at most."""

_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _OBJECT = 1, 2, 3
_PIECE = 2**20


def read_mat(path: Path) -> dict[str, Any]:
    """The variables of a MAT file, structs as dicts.

    Raises:
        InputError: a file that is nested deeply, takes far more memory than its size,
            or refers to other files.
        Exception: whatever the libraries raise on a damaged file.
    """
    if h5py.is_hdf5(path):
        with h5py.File(path, "r") as file:
            return _from_hdf5(file, path)
    _check(path)
    tree = scipy.io.loadmat(path, simplify_cells=True)
    return {k: v for k, v in tree.items() if not k.startswith("__")}


def _check(path: Path) -> None:
    """Refuse a MAT v5 file that is nested deeply, or takes far more than its size."""
    with path.open("rb") as file:
        head = file.read(128)
        order = {b"IM": "<", b"MI": ">"}.get(head[126:128])
        if order is None:
            raise InputError(
                f"{path}: not a readable MAT file of v5 or v7.3; save it again with -v7"
            )
        whole = 0
        while tag := file.read(8):
            kind, size = struct.unpack(f"{order}II", tag.ljust(8, b"\0"))
            content = file.read(size)
            if kind == _COMPRESSED:
                content = b"".join(_expanded(content, whole, path))
                whole += len(content)
                kind, content = _MATRIX, content[8:]
            if kind == _MATRIX:
                _check_matrix(content, order, 0, path)


def _expanded(content: bytes, before: int, path: Path) -> Iterator[bytes]:
    """A compressed element, piece by piece, as long as the file may expand so far."""
    reader = zlib.decompressobj()
    while content and not reader.eof:
        piece = reader.decompress(content, _PIECE)
        before += len(piece)
        check_expansion(before, path)
        yield piece
        content = reader.unconsumed_tail


def _check_matrix(content: bytes, order: str, depth: int, path: Path) -> None:
    """Look over one variable, and what is in it."""
    if depth > DEEPEST:
        raise InputError(
            f"{path}: structs or cells are nested more than {DEEPEST} deep; store the "
            "vectors as variables, or in one struct log"
        )
    parts = list(_elements(content, order, 4))
    if len(parts) < 2:
        return
    flags, dimensions = parts[0][1], parts[1][1]
    if len(flags) < 4:
        return
    kind = struct.unpack_from(f"{order}I", flags)[0] & 0xFF
    if kind not in (_CELL, _STRUCT, _OBJECT):
        return
    sizes = struct.unpack(
        f"{order}{len(dimensions) // 4}i", dimensions[: len(dimensions) // 4 * 4]
    )
    if math.prod(sizes) > MEMBERS:
        raise InputError(
            f"{path}: a struct or cell of {math.prod(sizes)} elements; store vectors"
        )
    for within, inner in _elements(content, order, MEMBERS):
        if within == _MATRIX:
            _check_matrix(inner, order, depth + 1, path)


def _elements(content: bytes, order: str, most: int) -> Iterator[tuple[int, bytes]]:
    """Kind and content of the first elements; small ones are in their tag."""
    at = 0
    for _ in range(most):
        if at + 8 > len(content):
            return
        kind, size = struct.unpack_from(f"{order}II", content, at)
        if kind >> 16:
            yield kind & 0xFFFF, content[at + 4 : at + 4 + min(kind >> 16, 4)]
            at += 8
        else:
            yield kind, content[at + 8 : at + 8 + size]
            at += 8 + size + -size % 8


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
    check_members(len(group), path)
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
