"""Quantities with units in, SI numbers out."""

from __future__ import annotations

import math
import re
from functools import cache
from typing import TYPE_CHECKING, Any, TypeAlias, overload

import numpy as np
from jaxtyping import Num

from hydrojax.errors import WORD, InputError, one_line

if TYPE_CHECKING:
    import pint

QuantityLike: TypeAlias = "float | str | pint.Quantity"
"""A number in SI, a text with a unit, or pint's quantity."""

_QUANTITY = re.compile(
    r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*\*?\s*(.*?)\s*", re.DOTALL
)


_TOLERANCE = re.compile(r"(.*?)\s*(?:\+/?-|±)\s*(.+)", re.DOTALL)


_POWER = re.compile(r"\*\*|\^|[⁰¹²³⁴-⁹]+")

_EXPONENT = re.compile(
    r"(?:(?:\*\*|\^)\s*(?:[+-]?(?:\d(?:\.\d)?|\.\d)"
    r"|\(\s*[+-]?\d(?:\.\d)?(?:/\d)?\s*\))|[²³⁴-⁹])"
    r"(?![\s)]*(?:\*\*|\^|[⁰¹²³⁴-⁹])|[\w.])"
)
"""An exponent as units have it: a digit, a decimal, or a fraction in brackets, and not
itself raised."""

_FACTOR = re.compile(r"(?<![\w.])(?!1(?![\w.]))[\d.]+")
"""A number other than 1, which no unit has beside its exponents: powers of numbers are
what pint would compute for hours."""


class _UnitError(ValueError):
    """An invalid unit; the public functions add where it is."""


@cache
def _registry() -> pint.UnitRegistry:
    import pint  # slow to import, and not every command reads a file

    return pint.UnitRegistry()


@cache
def _factor(unit: str, want: str) -> float:
    """How many `want` one `unit` is; `_UnitError` if it is none."""
    registry = _registry()
    text = "1" if unit.strip() == "-" else unit.strip().replace("·", "*")
    if text.startswith("/"):
        text = f"1{text}"
    hint = "give it as a plain number" if want == "1" else f"give it in {want} or so"
    shown = repr(one_line(unit, 40))
    if text.lower() == "grad":  # German for degrees, pint's for gon
        raise _UnitError(f"unit {shown} may be degrees or gon; write deg or gon")
    powers = [m.start() for m in _POWER.finditer(text[: WORD + 1])]
    if (
        len(text) > WORD
        or not all(_EXPONENT.match(text, at) for at in powers)
        or _FACTOR.search(_EXPONENT.sub("", text))
    ):
        raise _UnitError(f"unknown unit {shown}; {hint}")
    try:
        parsed = registry.parse_units(text)
    except Exception as err:  # pint raises a dozen kinds on text that is no unit
        near = _other_case(text, want)
        hint = f"did you mean {near!r}?" if near else hint
        raise _UnitError(f"unknown unit {shown}; {hint}") from err
    if "rad" in want and "hertz" in str(parsed):
        raise _UnitError(
            f"{shown} counts cycles, not radians; multiply by 2*pi and write {want}"
        )
    try:
        zero = registry.Quantity(0.0, parsed).to(want).magnitude
        one = registry.Quantity(1.0, parsed).to(want).magnitude
    except Exception as err:
        raise _UnitError(f"unit {shown} does not fit; {hint}") from err
    if zero != 0.0:  # decibel, degC: no factor makes them SI
        raise _UnitError(f"unit {shown} has no true zero; {hint}")
    return float(one)


def _other_case(text: str, want: str) -> str:
    """A unit that is spelled the same in other letters, "" if there is none."""
    head, tail = text[:1], text[1:]
    spellings = [head.upper() + tail.capitalize(), text.lower(), text.upper()]
    spellings += [head.lower() + tail.upper(), head.lower() + tail.capitalize()]
    registry = _registry()
    for spelling in spellings:
        try:
            if registry.parse_units(spelling).is_compatible_with(want):
                return spelling
        except Exception:  # as above
            continue
    return ""


def fits(unit: str, want: str) -> bool:
    """Whether `unit` is a unit of the dimension of `want`."""
    try:
        _factor(unit, want)
    except _UnitError:
        return False
    return True


def with_command(unit: str, command: str) -> str:
    """`unit` with `{u}` replaced by the command's unit, "V" or "1"."""
    if command == "1":
        for part in ("{u}*", "*{u}", "/{u}"):
            unit = unit.replace(part, "")
    return unit.replace("{u}", command)


@overload
def to_si(value: float, unit: str, want: str, where: str) -> float: ...
@overload
def to_si(
    value: Num[np.ndarray, "*batch"], unit: str, want: str, where: str
) -> Num[np.ndarray, "*batch"]: ...
def to_si(
    value: float | Num[np.ndarray, "*batch"], unit: str, want: str, where: str
) -> float | Num[np.ndarray, "*batch"]:
    """Convert `value`, a number or an array, from `unit` to the SI unit `want`.

    Radians count as dimensionless, so rad/s and 1/s fit each other; Hz is refused
    where rad/s is wanted. "-" and "%" are dimensionless.

    Raises:
        InputError: `unit` is unknown or of another dimension; `where` opens the line.
    """
    try:
        return value * _factor(unit, want)
    except _UnitError as err:
        raise InputError(f"{where}: {err}") from err


def split(text: object, where: str) -> tuple[float, str]:
    """The number of a quantity and its unit as written, "" if it has none.

    Raises:
        InputError: `text` is neither a finite number nor a string that opens with one.
    """
    if isinstance(text, (int, float)) and not isinstance(text, bool):
        text = shown(text)
    short = text if isinstance(text, str) and len(text) <= 2 * WORD else ""
    match = _QUANTITY.fullmatch(short)
    if re.match(r"\s*[-+]?\d+,\d", short):
        raise InputError(
            f"{where}: {shown(text)} has a comma in its number; write a point"
        )
    if match is None or not math.isfinite(float(match[1])):
        raise InputError(
            f"{where}: {shown(text)} is not a quantity; write a finite number and its "
            'unit, such as "8e8 Pa"'
        )
    return float(match[1]), match[2]


LARGEST = 1e30
"""Of no quantity of a rig in SI a number is larger: no power of it overflows."""


def quantity(text: object, want: str, where: str) -> float:
    """The SI value of a quantity such as "60 um" or, if dimensionless, "0.7".

    Args:
        text: the quantity, as a string; a bare number if dimensionless.
        want: the SI unit the value is returned in.
        where: file and key, to open an error line with.

    Raises:
        InputError: not a finite number with a unit; no unit where one is needed; an
            unknown unit; another dimension.
    """
    value, unit = split(text, where)
    if not unit and ("rad" in want or not fits("1", want)):
        raise InputError(f'{where}: {text!r} has no unit; write "{value:g} {want}"')
    size = to_si(value, unit or "1", want, where)
    if abs(size) > LARGEST:
        raise InputError(
            f"{where}: {text!r} is larger than anything measured; look at its exponent"
        )
    return size


def shown(value: object) -> str:
    """A value as Python writes it, in one line and not too long."""
    if isinstance(value, int) and value.bit_length() > 1024:
        return "a whole number of more than 300 digits"
    try:
        return one_line(repr(value), WORD)
    except (ValueError, RecursionError):  # such a number inside, or endless lists
        return "a value that cannot be printed"


def parted(text: object) -> tuple[object, str]:
    """A quantity without its tolerance, and the tolerance as written ("" without one):
    "1 mm +- 2 %" is "1 mm" and "2 %".
    """
    short = text if isinstance(text, str) and len(text) <= 2 * WORD else ""
    match = _TOLERANCE.fullmatch(short)
    return (match[1], match[2]) if match else (text, "")


def tolerance(written: str, value: float, want: str, where: str) -> float:
    """A tolerance in SI: a quantity, or per cent of `value`; 0 where none is written.

    Raises:
        InputError: it is not above 0, or see `quantity`.
    """
    if not written:
        return 0.0
    number, unit = split(written, where)
    percent = unit == "%"
    out = number / 100 * abs(value) if percent else quantity(written, want, where)
    if not out > 0:
        raise InputError(f"{where}: tolerance {written!r} must be above 0")
    return out


def in_si(value: QuantityLike, want: str, where: str) -> float:
    """The SI value of a number (taken as it is), a text with a unit or pint's quantity.

    Args:
        value: the quantity.
        want: the SI unit the value is returned in.
        where: opens an error line.

    Raises:
        InputError: see `quantity`.
    """
    text = _text(value)
    return split(text, where)[0] if _is_number(text) else quantity(text, want, where)


def is_a(value: QuantityLike, want: str, where: str) -> bool:
    """Whether a quantity is written with a unit of the dimension of `want`.

    Raises:
        InputError: no finite number.
    """
    unit = split(_text(value), where)[1]
    return bool(unit) and fits(unit, want)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _text(value: Any) -> Any:
    """A pint quantity as text, a NumPy number as a float; the rest as it is."""
    if hasattr(value, "magnitude"):
        return f"{float(value.magnitude):.17g} {value.units:C}".strip()
    return float(value) if isinstance(value, np.number) else value
