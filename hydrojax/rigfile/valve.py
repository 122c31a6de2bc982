"""The section [valve]: what kind of edges meter the oil, and its flow table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from hydrojax import units
from hydrojax.effects.fluid import PressureCompensation
from hydrojax.errors import InputError, check_known
from hydrojax.parameters import specs
from hydrojax.plant.layout import Layout
from hydrojax.rigfile.sections import Given, givens

KINDS: Mapping[str, tuple[str, ...]] = {
    "orifice": (),
    "compensated": ("margin",),
    "table": ("command", "opening"),
}
"""What kinds of valve there are, and the keys of each beside `kind`."""

MEANINGS: Mapping[str, str] = {
    "kind": "orifice: the flow goes with the root of the drop over each edge. "
    "compensated: behind a compensator, so that it goes with the opening alone "
    "(the effect pressure_compensation at s = 1). table: orifices that open by a table",
    "margin": "drop that the compensator keeps over the edge",
    "command": "of a table: commands, rising, in the command's unit",
    "opening": "of a table: the command at which a linear valve opens as far, at each",
}
"""What each key of [valve] is."""

MARGIN = "dP_0"
"""What `margin` is called in the effect."""

MOST = 64
"""Rows of a table, at most: each takes its part of every step."""


class Table(NamedTuple):
    """A flow table: the opening at each command, in the command's unit."""

    command: tuple[float, ...]
    opening: tuple[float, ...]


def check_valve(path: str, section: Mapping[str, Any], layout: Layout) -> str:
    """The kind of valve that [valve] names; "orifice" where there is no section.

    Raises:
        InputError: an unknown kind or key, one that is missing, or a layout without a
            valve.
    """
    where = f"{path}: [valve]"
    if not section:
        return "orifice"
    if not layout.has_valve:
        raise InputError(
            f"{where}: layout {layout.name!r} has no valve; delete the section"
        )
    kind = section.get("kind", "")
    if not isinstance(kind, str) or kind not in KINDS:
        said = f"{units.shown(kind)} is unknown" if "kind" in section else "is missing"
        raise InputError(f"{where} kind {said}; write one of {tuple(KINDS)}")
    keys = KINDS[kind]
    check_known(where, [k for k in section if k != "kind"], keys, "key")
    if kind == "table" and (missing := [k for k in keys if k not in section]):
        raise InputError(
            f"{where} {missing[0]} is missing; write command and opening as two lists "
            "of one length"
        )
    return kind


def compensation(
    path: str, section: Mapping[str, Any], effects: Mapping[str, Any]
) -> dict[str, list[Given]]:
    """The effect that a compensated valve has, with what [valve] gives of it.

    Raises:
        InputError: the file declares that effect too, or see `givens`.
    """
    name, known = PressureCompensation.name, specs(PressureCompensation)
    if name in effects:
        raise InputError(
            f"{path}: [valve] kind and [effects.{name}] say the same twice; delete one"
        )
    own = givens(f"{path}: [valve]", {"s": "1"}, known)
    table = {k: v for k, v in section.items() if k == "margin"}
    margin = givens(f"{path}: [valve]", table, {"margin": known[MARGIN]})
    return {name: own + [replace(g, field=MARGIN) for g in margin]}


def table_of(path: str, section: Mapping[str, Any], command: str) -> Table:
    """The flow table of [valve].

    Args:
        path: what opens the line of an error.
        section: a checked section of the kind "table".
        command: the command's unit.

    Raises:
        InputError: no two lists of one length; a wrong unit; commands that do not rise,
            or openings that fall; an opening toward the other side.
    """
    where = f"{path}: [valve]"
    columns = []
    for key in KINDS["table"]:
        rows = section[key]
        if not isinstance(rows, list) or not 2 <= len(rows) <= MOST:
            raise InputError(
                f"{where} {key}: invalid {units.shown(rows)}: expected a list of 2 to "
                f"{MOST}"
            )
        columns.append(
            [
                units.quantity(row, command, f"{where} {key} row {i}")
                for i, row in enumerate(rows, 1)
            ]
        )
    at, opening = columns
    if len(at) != len(opening):
        raise InputError(
            f"{where} command has {len(at)} rows and opening {len(opening)}; give as "
            "many"
        )
    _check_rising(f"{where} command", at, strictly=True)
    _check_rising(f"{where} opening", opening, strictly=False)
    for i, (u, o) in enumerate(zip(at, opening, strict=True), 1):
        if u * o < 0 or (u == 0 and o != 0):
            raise InputError(
                f"{where} opening row {i}: {o:g} at a command of {u:g}; a valve opens "
                "toward its command: correct the sign"
            )
    return Table(tuple(at), tuple(opening))


def _check_rising(where: str, rows: list[float], strictly: bool) -> None:
    steps = np.diff(rows)
    wrong = np.flatnonzero(steps <= 0 if strictly else steps < 0)
    if wrong.size:
        raise InputError(
            f"{where} row {wrong[0] + 2} is not {'above' if strictly else 'at least'} "
            "the one before; put the rows in order"
        )
