"""The parameters of a rig file: as written, and checked in SI."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from hydrojax import units
from hydrojax.errors import InputError
from hydrojax.parameters import Spec
from hydrojax.rigfile.sections import check_known


@dataclass(frozen=True)
class Entry:
    """One parameter as the file gives it, in the SI unit its model stores.

    Attributes:
        start: where the search starts, or the value held.
        range: the range it may take; None: held fixed at `start`.
        unit: SI unit of both.
    """

    start: float
    range: tuple[float, float] | None
    unit: str


@dataclass(frozen=True)
class Given:
    """A parameter as written, beside what is known of it."""

    where: str
    field: str
    spec: Spec
    start: object
    range: tuple[object, object] | None
    reciprocal: bool  # given under `spec.outside`


def section_values(
    where: str, given: Mapping[str, object], wants: Mapping[str, str]
) -> dict[str, float]:
    """The quantities of one table in SI; `wants` are its keys and their units.

    Raises:
        InputError: an unknown key, no quantity, or a wrong unit.
    """
    check_known(where, given, wants, "key")
    return {
        key: units.quantity(text, wants[key], f"{where} {key}")
        for key, text in given.items()
    }


def givens(
    where: str, table: Mapping[str, Any], specs: Mapping[str, Spec]
) -> list[Given]:
    """The parameters of one table, under the names that the models use.

    Raises:
        InputError: an unknown name, one given twice, or no start beside a range.
    """
    outside = {s.outside[0]: field for field, s in specs.items() if s.outside}
    shown = [s.outside[0] if s.outside else field for field, s in specs.items()]
    check_known(where, [k for k in table if k not in specs], shown, "parameter")
    found: list[Given] = []
    for key, value in table.items():
        field, start, bounds = outside.get(key, key), value, None
        if any(given.field == field for given in found):
            raise InputError(f"{where} {key} gives {field} a second time; drop one")
        if isinstance(value, dict):
            check_known(f"{where} {key}", value, ("start", "range"), "key")
            start, ends = value.get("start"), value.get("range")
            if start is None or not isinstance(ends, list) or len(ends) != 2:
                raise InputError(
                    f"{where} {key} needs a start and a range of two; write {key} = "
                    '{ start = "...", range = ["...", "..."] }'
                )
            bounds = (ends[0], ends[1])
        reciprocal = key in outside and key not in specs
        found.append(
            Given(f"{where} {key}", field, specs[field], start, bounds, reciprocal)
        )
    return found


def unit_of_command(givens: Iterable[Given]) -> str:
    """The command's unit, V or 1, that all the constants agree on.

    Raises:
        InputError: they do not.
    """
    found: tuple[str, str] | None = None
    for given in givens:
        want = _file_unit(given)
        if "{u}" not in want:
            continue
        written = units.split(given.start, given.where)[1] or "1"
        wants = {u: units.with_command(want, u) for u in ("V", "1")}
        fitting = [u for u in wants if units.fits(written, wants[u])]
        if not fitting:
            continue  # a wrong unit, which `_entry` refuses
        if found and found[0] not in fitting:
            raise InputError(
                f"{given.where} takes the command in {fitting[0]}, {found[1]} in "
                f"{found[0]}; give all of them for a command in V, or all for 1"
            )
        found = found or (fitting[0], given.field)
    return found[0] if found else "V"


def _file_unit(given: Given) -> str:
    outside = given.spec.outside
    return outside[1] if given.reciprocal and outside else given.spec.unit


def entry(given: Given, command: str) -> Entry:
    """A parameter in SI, as its model stores it.

    Raises:
        InputError: no quantity, a wrong unit, or a range without the start in it.
    """
    want = units.with_command(_file_unit(given), command)
    texts = {"start": given.start}
    if given.range is not None:
        texts |= {"range": given.range[0], "range's end": given.range[1]}
    values = []
    for key, text in texts.items():
        where = f"{given.where} {key}" if given.range else given.where
        value = units.quantity(text, want, where)
        if given.reciprocal and value <= 0.0:
            raise InputError(f"{where}: {text!r} must be above 0; give a larger one")
        values.append(value)
    unit = units.with_command(given.spec.unit, command)
    if given.range is None:
        start = 1.0 / values[0] if given.reciprocal else values[0]
        return Entry(start, None, unit)
    start, lower, upper = values
    if not lower < upper:
        raise InputError(
            f"{given.where} range {list(given.range)} is upside down or empty; put the "
            "smaller first, or give a plain quantity to hold it fixed"
        )
    if not lower <= start <= upper:
        raise InputError(
            f"{given.where} start {given.start!r} is outside its range "
            f"{list(given.range)}; widen the range or move the start"
        )
    if given.reciprocal:
        start, lower, upper = 1.0 / start, 1.0 / upper, 1.0 / lower
    return Entry(start, (lower, upper), unit)
