"""Two reports side by side: verdicts, errors, effects and parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hydrojax.errors import InputError
from hydrojax.report.page import made_by, page
from hydrojax.report.record import read_report
from hydrojax.report.schema import ChannelRecord, ParameterRecord, Report
from hydrojax.report.text import quantity_text

APART = 3.0
"""Difference of two values, in standard deviations of it, from which they differ."""


@dataclass(frozen=True)
class Pair:
    """One quantity of two reports, SI; None where a report does not have it.

    Attributes:
        name: of a parameter (`beta`, `stribeck.k_st`) or a channel.
        unit: SI unit.
        a, b: values.
        std_a, std_b: standard deviations, where they are known.
    """

    name: str
    unit: str
    a: float | None
    b: float | None
    std_a: float | None = None
    std_b: float | None = None

    @property
    def change(self) -> str:
        """How far b is from a, in per cent of a, or how many times as large."""
        if self.a is None or self.b is None or not self.a:
            return "–"
        if self.b / self.a >= 10:
            return f"× {self.b / self.a:.3g}"
        percent = 100 * (self.b - self.a) / abs(self.a)
        return f"{percent:+.3g} %".replace("-", "−")

    @property
    def apart(self) -> float | None:
        """The difference in standard deviations of it, where both are known."""
        if None in (self.a, self.b, self.std_a, self.std_b):
            return None
        spread = math.hypot(self.std_a or 0.0, self.std_b or 0.0)
        return abs((self.b or 0.0) - (self.a or 0.0)) / spread if spread else None

    def text(self, side: str) -> str:
        """The value of a side, as it is printed."""
        value = getattr(self, side)
        if value is None:
            return "–"
        return quantity_text(value, self.unit, getattr(self, f"std_{side}"))


@dataclass(frozen=True)
class Comparison:
    """Two reports side by side.

    Attributes:
        names: of the folders.
        rigs, verdicts, sentences: of the reports.
        same_logs: whether both were judged on logs of the same names.
        channels: errors after, by channel.
        effects: names, and whether each report found them.
        parameters: of the rig and of the effects.
    """

    names: tuple[str, str]
    rigs: tuple[str, str]
    verdicts: tuple[str, str]
    sentences: tuple[str, str]
    same_logs: bool
    channels: list[Pair]
    effects: list[tuple[str, bool, bool]]
    parameters: list[Pair]

    def to_dict(self) -> dict[str, Any]:
        """The content for other programs; SI."""
        out = asdict(self)
        for pair, row in zip(self.parameters, out["parameters"], strict=True):
            row["apart"] = pair.apart
        return out

    def html(self, command_line: str = "") -> str:
        """A page of its own; `command_line` is what it says that made it."""
        template, made = Path(__file__).parent / "compare.html", made_by(command_line)
        return page(template, (), c=self, far=APART, made=made)


def compare(a: str | Path, b: str | Path) -> Comparison:
    """Compare the reports in two folders of `identify` or `trace`.

    Raises:
        InputError: no report in a folder, or one of another format.
    """
    both = first, second = read_report(a), read_report(b)
    judged = [r.logs.test or r.logs.validate_ for r in both]
    found = [{e.name: e for e in r.effects} for r in both]
    return Comparison(
        names=(Path(a).name or str(a), Path(b).name or str(b)),
        rigs=(first.rig, second.rig),
        verdicts=(first.verdict, second.verdict),
        sentences=(first.sentence, second.sentence),
        same_logs=judged[0] == judged[1],
        channels=_channels(both),
        effects=[(n, n in found[0], n in found[1]) for n in _names(found)],
        parameters=_parameters(both),
    )


def _names(tables: Sequence[Mapping[str, Any]]) -> list[str]:
    """The keys of both, in order."""
    return list(dict.fromkeys(name for table in tables for name in table))


def _unit(name: str, sides: Sequence[ChannelRecord | ParameterRecord | None]) -> str:
    """The unit that both have.

    Raises:
        InputError: they have different ones.
    """
    found = {s.unit for s in sides if s is not None}
    if len(found) > 1:
        raise InputError(
            f"{name} is in {' and in '.join(sorted(found))} in the two reports; "
            "compare reports of one rig"
        )
    return found.pop()


def _channels(both: Sequence[Report]) -> list[Pair]:
    out = []
    for name in _names([r.channels for r in both]):
        sides = [r.channels.get(name) for r in both]
        a, b = (s and s.after for s in sides)
        out.append(Pair(name, _unit(name, sides), a, b))
    return out


def _parameters(both: Sequence[Report]) -> list[Pair]:
    """The fitted parameters, and those of the effects."""
    tables = [report.every_parameter for report in both]
    out = []
    for name in _names(tables):
        sides = [table.get(name) for table in tables]
        a, b = (s and s.value for s in sides)
        std_a, std_b = (s and s.std for s in sides)
        if a != b or std_a is not None or std_b is not None:  # not held in both
            out.append(Pair(name, _unit(name, sides), a, b, std_a, std_b))
    return out
