"""Programs that do the same work: made ready, checked, timed in turns, told as rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from .children import Children, Failed, Program
from .timing import Goal, Rounds, figure, ratio, spread

Row = dict[str, Any]


@dataclass
class Section:
    """What a group found, as plain data: rows of programs, figures with goals, remarks.

    `points` are those of scaling sweeps, `plots` PNG files by name.
    """

    rows: list[Row] = field(default_factory=list)
    figures: list[Row] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    points: dict[str, Any] = field(default_factory=dict)
    plots: dict[str, bytes] = field(default_factory=dict)

    def note(self, text: str) -> None:
        """Add a remark, once."""
        if text not in self.notes:
            self.notes.append(text)


Check = Callable[[str, Any], str]
"""Hears a program's name and answer; what is wrong with it, or nothing."""


def measure(
    children: Children,
    section: Section,
    case: str,
    programs: Sequence[Program],
    rounds: int,
    check: Check = lambda name, answer: "",
    work: Mapping[str, float] | None = None,
    unit: tuple[str, float] = ("s", 1.0),
) -> Rounds:
    """Time programs in turns; rows go into the section.

    Args:
        children: where they run.
        section: hears of rows, and of programs that could not be timed.
        case: what the rows are called together.
        programs: to be timed.
        rounds: how many times each.
        check: of a program's answer; one that is wrong is not timed.
        work: by program, what its seconds are divided by; 1 where it is not named.
        unit: of the rows' figures, and how many of it are a second.

    Returns:
        Seconds over work, by program, one a round.
    """
    made, share = {}, work or {}
    for program in programs:
        try:
            said = children.prepare(program)
        except Failed as error:
            section.note(f"{case}, {program.name}: not timed: {error}")
            continue
        wrong = check(program.name, said.pop("answer"))
        if wrong:
            section.note(f"{case}, {program.name}: not timed: {wrong}")
            children.forget(program.name)
            continue
        made[program.name] = said
    seconds = children.time(list(made), rounds, case)
    per = {n: [s / share.get(n, 1.0) for s in all_] for n, all_ in seconds.items()}
    for name, said in made.items():
        children.forget(name)
        row = {"case": case, "program": name, "unit": unit[0]}
        row |= asdict(spread(per[name]).times(unit[1])) | said
        section.rows.append(row)
    return per


def compare(
    section: Section, per: Rounds, says: str, of: str, to: str, goal: Goal | None = None
) -> None:
    """A ratio of two programs' times as a figure, if both were timed."""
    if of in per and to in per:
        section.figures.append(figure(says, ratio(per[of], per[to]), "times", goal))


def quickest(per: Rounds, start: str) -> str:
    """Of the programs whose names start so, the one with the least median; "" if none.

    More threads are not always faster: not for short work, nor beside other users.
    """
    those = [name for name in per if name.startswith(start)]
    return min(those, key=lambda name: spread(per[name]).median, default="")


def apart(answer: Any, truth: Any) -> float:
    """The largest relative difference of two answers."""
    a, b = np.asarray(answer, float), np.asarray(truth, float)
    if a.shape != b.shape or not np.isfinite(a).all():
        return float("inf")
    return float(np.max(np.abs(a - b)) / np.max(np.abs(b)))


def agrees(within: Mapping[str, float], first: str) -> Check:
    """A check against the answer of the program `first`, which must come first.

    `within` is by the start of a program's name; a name that none fits is not checked.
    """
    truth: list[Any] = []

    def check(name: str, answer: Any) -> str:
        if name == first:
            truth.append(answer)
        limit = next((v for k, v in within.items() if name.startswith(k)), None)
        if limit is None or not truth:
            return ""
        off = apart(answer, truth[0])
        return "" if off <= limit else f"its answer is {off:.1e} off {first}'s"

    return check
