"""MAT v5 files looked over before SciPy reads them.

Its reader takes sizes and depths from the file as they are: a few bytes could have it
take gigabytes, or overrun the stack.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from hydrojax.errors import InputError
from hydrojax.limits import MEMBERS, check_expansion

DEEPEST = 4
"""Structs and cells within each other; a log has variables, in a struct, at most."""

_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _OBJECT = 1, 2, 3
_PIECE = 2**20


def check(path: Path) -> None:
    """Refuse a MAT v5 file that is nested deeply, or takes far more than its size.

    Raises:
        InputError: such a file, or none of this kind.
    """
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
