"""Which column of a log is which signal, in what unit and with what sign: a guess."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float

from hydrojax import units
from hydrojax.errors import InputError, check_known
from hydrojax.logs.columns import as_floats
from hydrojax.logs.dates import clock_seconds
from hydrojax.logs.tables import SIGNALS, Column, File

_FORCE = r"(force|kraft|load ?cell|loadcell|kraftmess\w*)"
_WANTED = r"(ref|reference|soll|set|setpoint|desired|cmd|command|demand|target)"
_PRESSURE = r"(p|pressure|druck|press|chamber|kammer|port)"

NAMES: Mapping[str, str] = {
    "time": r"t|time|zeit|timestamp|time stamp|elapsed.*|uhrzeit|date.*|datum.*|clock",
    "F_d": rf"f {_WANTED}|f d|.*{_FORCE} {_WANTED}|{_WANTED} {_FORCE}",
    "wanted": rf".*(x|v|pos\w*|weg|hub|speed|{_PRESSURE}|winkel|angle) {_WANTED}",
    "P_s": rf"p ?[sp0]|{_PRESSURE} (supply|system|(pump|versorgung|speise)\w*)"
    r"|(supply|system|(pump|versorgung|speise)\w*)( ?(pressure|druck|p))?",
    "P_r": rf"p ?[rt]|{_PRESSURE} (tank|return|ruecklauf)"
    r"|(tank|return|ruecklauf)( ?(pressure|druck|p))?",
    "bore": rf"{_PRESSURE} (bore|cap|head|kolben(seite)?|piston)"
    r"|(bore|cap|head|piston|kolben)( ?(seite|side|end))?( ?(pressure|druck|p))?",
    "rod": rf"{_PRESSURE} (rod|ring|stange(nseite)?|annulus)"
    r"|(rod|ring|stangen|annulus)( ?(seite|side|end))?( ?(pressure|druck|p))?",
    "A": rf"{_PRESSURE} ?(a|1|a1)|(a|1) ?(pressure|druck)",
    "B": rf"{_PRESSURE} ?(b|2|a2)|(b|2) ?(pressure|druck)",
    "u": r"u|y|main ?u|.*(valve|ventil|spool|stell|servo|command|cmd).*|input|u valve",
    "psi": r"psi|phi|theta|.*(angle|winkel|joint).*",
    "v": r"v|x ?dot|.*(speed|velocity|geschwindigkeit).*",
    "x": r"x ?\d?|x (ist|act\w*|meas\w*)|s|lvdt|"
    r".*(pos|position|stroke|weg|hub|displacement|travel|extension).*",
    "P": r"(drive|motor|actuator|thrust|antriebs?) ?(force|kraft)",
    "F": rf"f( \w+)?|cell|.*{_FORCE}.*",
}
"""What columns are called in English and German, in words without case and accents; the
first that fits has it. Chamber pressures are told apart by the sides of the piston."""

CHOICES: Mapping[str, tuple[tuple[str, float], ...]] = {
    "u": (("1", 1.0), ("V", 10.5), ("%", np.inf)),
    "psi": (("rad", 7.0), ("deg", np.inf)),
    "x": (("m", 3.0), ("mm", np.inf)),
    "v": (("m/s", 3.0), ("mm/s", np.inf)),
    "F": (("kN", 50.0), ("N", np.inf)),
    "F_d": (("kN", 50.0), ("N", np.inf)),
    "P": (("kN", 50.0), ("N", np.inf)),
}
"""Units that a column without one may be in, each up to its largest value."""
_SUFFIXES = (
    "s", "ms", "us", "V", "mV", "m", "mm", "cm", "rad", "deg", "Pa", "kPa", "MPa",
    "bar", "mbar", "psi", "N", "kN",
)  # fmt: skip
_PRESSURES = (("MPa", 45.0), ("bar", 2e3), ("Pa", np.inf))


@dataclass(frozen=True)
class Guess:
    """One signal's column.

    Attributes:
        column: as the file has it.
        unit: in which it is read.
        values: [rows], SI, with the sign turned where `invert`.
        named: whether name and unit in the file need no line in the rig file.
        invert: whether the sign is turned.
        doubts: what a reader has to check, one phrase each.
    """

    column: Column
    unit: str
    values: Float[np.ndarray, "rows"]
    named: bool
    invert: bool = False
    doubts: tuple[str, ...] = ()


def guess_signals(
    file: File, chosen: Mapping[str, str], two_areas: bool
) -> dict[str, Guess]:
    """Signals by their names, from what a file's columns are called.

    Args:
        file: as `read_table` gives it.
        chosen: columns by signal, which need no guess.
        two_areas: whether the cylinder has a bore side, which becomes chamber 2.

    Raises:
        InputError: a chosen signal or column that there is not; no time.
    """
    check_known(f"{file.path}: --column", chosen, SIGNALS, "signal")
    found: dict[str, tuple[Column, tuple[str, ...]]] = {}
    labels = [c.label for c in file.columns]
    for name, label in chosen.items():
        matches = [c for c in file.columns if label in (c.label, c.name)]
        if not matches:
            check_known(f"{file.path}: --column {name}", [label], labels, "column")
        found[name] = (matches[0], ())
    for name, column in _by_name(file.columns, two_areas).items():
        used = [c for c, _ in found.values()]
        if name not in found and all(column[0] is not c for c in used):
            found[name] = column
    if "x" in found and "psi" in found and "psi" not in chosen:
        del found["psi"]
    if "time" not in found:
        raise InputError(
            f"{file.path}: no column looks like time; it has {labels[:12]}; name it "
            "with --column time=NAME"
        )
    # Pressures without a unit are in that of the largest.
    bare = [
        _largest(as_floats(file, str(file.path), c.values))
        for n, (c, _) in found.items()
        if n.startswith("P_") and not (c.unit or _suffix(c))
    ]
    pressure = max(bare, default=0.0)
    return {
        n: _read(file, n, *found[n], pressure if n.startswith("P_") else 0.0)
        for n in SIGNALS
        if n in found
    }


def _largest(values: Float[np.ndarray, "rows"]) -> float:
    return float(np.nanmax(np.abs(values), initial=0.0))


def _by_name(
    columns: Sequence[Column], two_areas: bool
) -> dict[str, tuple[Column, tuple[str, ...]]]:
    """The columns that names tell, with what is doubtful about each."""
    out: dict[str, tuple[Column, tuple[str, ...]]] = {}
    for column in columns:
        if column.name in SIGNALS:
            out[column.name] = (column, ())
    left = [c for c in columns if c.name not in SIGNALS]
    found: dict[str, list[Column]] = {}
    for column in left:
        said = _words(column)
        name = next((n for n, p in NAMES.items() if re.fullmatch(p, said)), None)
        if name and name != "wanted":
            found.setdefault(name, []).append(column)
    sides = (
        {"rod": "P_a1", "bore": "P_a2", "A": "P_a2", "B": "P_a1"}
        if two_areas
        else {"A": "P_a1", "B": "P_a2", "bore": "P_a2", "rod": "P_a1"}
    )
    for name, several in found.items():
        if name == "time":  # a date has the time of day in a column of its own
            several.sort(key=_is_bare_date)
        signal = sides.get(name, name)
        doubts = [f"or {c.label!r}?" for c in several[1:]]
        if two_areas and name in "AB":
            doubts.append(f"taken for the {'bore' if name == 'A' else 'rod'} side")
        out.setdefault(signal, (several[0], tuple(doubts)))
    return out


def _is_bare_date(column: Column) -> bool:
    """Whether a column begins with a date without a time of day."""
    if np.ndim(column.values) != 1:
        return False
    first = next((str(c).strip() for c in pd.Series(column.values).dropna()), "")
    return bool(re.fullmatch(r"\d{1,4}([-/.])\d{1,2}\1\d{1,4}", first))


def _words(column: Column) -> str:
    """A column's name in small words, without accents and units."""
    text = column.name
    if column.unit is None and (tail := _suffix(column)):
        text = text[: -len(tail)]
    text = text.replace("ü", "ue").replace("ö", "oe").replace("ä", "ae")
    text = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text)
    return re.sub(r"[^A-Za-z0-9]+", " ", text).strip().lower()


def _suffix(column: Column) -> str:
    """The unit at the end of a name such as `t_ms`, "" if there is none."""
    if column.name in SIGNALS:  # of `P_s` and `F_d` the last letter is no unit
        return ""
    head, _, tail = column.name.rpartition("_")
    return tail if head and tail in _SUFFIXES else ""


def _read(
    file: File, name: str, column: Column, doubts: tuple[str, ...], least: float
) -> Guess:
    """A column in SI, in its own unit or in the one that its size suggests.

    `least` is a size that it is taken to have in any case.
    """
    where = f"{file.path}: column {column.label!r}"
    if name == "time" and (clock := clock_seconds(file, where, column)) is not None:
        return Guess(column, "s", clock, column.name == name, doubts=doubts)
    values = as_floats(file, where, column.values)
    unit, said = column.unit, ()
    want = SIGNALS[name]
    if unit is None:
        unit = _suffix(column)
        if name != "u" and unit and not units.fits(unit, want):
            unit = ""
    if not unit:
        largest = _largest(values)
        unit = _likely(name, values, max(largest, least))
        size = f"largest {largest:.4g}" if name != "time" else "by its steps"
        said = (f"the log gives no unit: {size}",)
    if name == "u":
        want = "V" if units.fits(unit, "V") else "1"
    si = units.to_si(values, unit, want, where)
    named = column.name == name and column.unit is not None
    return Guess(column, unit, si, named, doubts=(*said, *doubts))


def _likely(name: str, values: Float[np.ndarray, "rows"], largest: float) -> str:
    """The unit that values of a signal have by their size, or by their steps."""
    if name == "time":
        steps = np.diff(values)
        steps = steps[np.isfinite(steps)]
        step = float(np.median(steps)) if len(steps) else 0.0
        return "s" if step < 0.2 else "ms" if step < 100 else "us"
    return next(u for u, most in CHOICES.get(name, _PRESSURES) if largest <= most)
