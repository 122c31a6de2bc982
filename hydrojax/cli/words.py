"""Words of the command line, such as `k_p=0.2:4:48`, as arguments of the library."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrojax import units
from hydrojax.errors import COUNT, InputError


def read_axes(words: Sequence[str]) -> dict[str, list[float | str]]:
    """`name=start:stop:count`, `name=start:stop:count:log` or `name=a,b,c` words.

    Returns:
        Values by name: numbers, or texts where a unit was written.

    Raises:
        InputError: words of another form, or a name twice.
    """
    out: dict[str, list[float | str]] = {}
    for word in words:
        where = f"--over {word!r}"
        name, sign, text = (part.strip() for part in word.partition("="))
        if not sign or not text:
            raise InputError(
                f"{where}: write NAME=START:STOP:COUNT, such as k_p=0.2:4:48"
            )
        if name in out:
            raise InputError(f"--over: {name} is given twice; drop one")
        ranged = ":" in text
        out[name] = _range(text, where) if ranged else _list(text, where)
    return out


def _list(text: str, where: str) -> list[float | str]:
    values = [_number(part.strip(), where) for part in text.split(",")]
    if len(set(values)) < len(values):
        raise InputError(f"{where}: a value is given twice; drop one")
    return values


def _range(text: str, where: str) -> list[float | str]:
    ends, spacing = [p.strip() for p in text.split(":")], "lin"
    if len(ends) == 4:
        spacing = ends.pop()
    if len(ends) != 3 or spacing not in ("lin", "log"):
        raise InputError(
            f"{where}: write START:STOP:COUNT, and :log for a logarithmic scale"
        )
    (start, unit), (stop, other) = (units.split(p, where) for p in ends[:2])
    if ends[2].isdecimal() and (len(ends[2]) > 9 or int(ends[2]) > COUNT):
        raise InputError(f"{where:.60}: a count of {ends[2]:.20} is more than {COUNT}")
    count = int(ends[2]) if ends[2].isdecimal() else 0
    if count < 2 or (start, unit) == (stop, other):
        raise InputError(f"{where}: give two ends and a count of 2 or more")
    if unit != other:
        if not unit and start == 0:
            unit = other
        elif not other and stop == 0:
            other = unit
        elif not unit or not other:
            raise InputError(f"{where}: give both ends a unit, or neither")
        stop = units.to_si(stop, other, unit, where)
    if spacing == "log" and min(start, stop) <= 0:
        raise InputError(f"{where}: a log scale needs both ends above 0")
    space = np.geomspace if spacing == "log" else np.linspace
    values = space(start, stop, count).tolist()
    return [f"{value!r} {unit}" for value in values] if unit else values


def read_point(words: Sequence[str], option: str = "--at") -> dict[str, float | str]:
    """`name=value` words as values by name: numbers, or texts with a unit.

    Raises:
        InputError: words of another form.
    """
    out: dict[str, float | str] = {}
    for word in words:
        name, sign, text = (part.strip() for part in word.partition("="))
        where = f"{option} {word!r}"
        if not sign or not text:
            raise InputError(f"{where}: write NAME=VALUE, such as v=0.01")
        out[name] = _number(text, where)
    return out


def read_columns(words: Sequence[str]) -> dict[str, str]:
    """`signal=column` words as columns by signal.

    Raises:
        InputError: words of another form.
    """
    out: dict[str, str] = {}
    for word in words:
        name, sign, text = (part.strip() for part in word.partition("="))
        if not sign or not text:
            raise InputError(f"--column {word!r}: write SIGNAL=COLUMN, such as u=MainU")
        out[name] = text
    return out


def read_gains(words: Sequence[str]) -> dict[str, object]:
    """`name=value` or `name=lower,upper` words as keys of [controller].

    Raises:
        InputError: words of another form.
    """
    out: dict[str, object] = {}
    for word in words:
        name, sign, text = word.partition("=")
        if not sign or not text.strip():
            raise InputError(f"--gains {word!r}: write NAME=VALUE, such as k_p=1.5")
        values = [_plain(part) for part in text.split(",")]
        out[name.strip()] = values[0] if len(values) == 1 else values
    return out


def _number(text: str, where: str) -> float | str:
    """A number as such, a quantity with a unit as its text.

    Raises:
        InputError: neither.
    """
    number, unit = units.split(text, where)
    return text if unit else number


def _plain(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text
