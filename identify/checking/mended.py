"""Inputs that are mended before a trace: the rig file, and its logs read by it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hydrojax.identify.case import Case
from hydrojax.identify.checking.words import Finding
from hydrojax.logs.log import Log
from hydrojax.rigfile.edit import with_lines
from hydrojax.rigfile.schema import RigFile

MENDED = ("sign", "exchanged", "unit", "left out")
"""Findings that are mended before a trace. A factor of an area or a gain is not: no log
tells it from an effect of the load cell."""


def mended(
    spec: RigFile, groups: Sequence[Sequence[Log]], found: Sequence[Finding]
) -> tuple[RigFile, tuple[tuple[Log, ...], ...]] | None:
    """A rig file with the lines of what was found in it, and logs read by it.

    Args:
        spec: the rig file as it is.
        groups: logs as they were read by it.
        found: what looks wrong.

    Returns:
        None where nothing is to be mended before a trace.
    """
    wanted = [f for f in found if to_be_mended(f)]
    if not wanted:
        return None
    content = spec.text
    for f in wanted:
        content = with_lines(content, f.lines)
    new = RigFile.from_text(content, spec.path, spec.valve)
    read = tuple(tuple(_again(g, wanted, new) for g in group) for group in groups)
    return replace(new, command_unit=spec.command_unit, law=spec.law), read


def mended_case(case: Case, found: Sequence[Finding]) -> Case:
    """The case with what was found in its inputs mended; itself where that is nothing.

    Raises:
        InputError: the mended inputs cannot be made ready; see `open_case`.
    """
    right = mended(case.spec, case.as_read, found)
    return case if right is None else case.again(*right)


def to_be_mended(f: Finding) -> bool:
    """Whether it is mended before a trace."""
    if not f.lines or (f.input == "u" and f.finding == "unit"):
        return False
    return f.finding in MENDED or (f.input, f.finding) == ("P_s", "factor")


def _again(log: Log, found: Sequence[Finding], spec: RigFile) -> Log:
    """A log as it is read by the mended rig file."""
    signals = dict(log.signals)
    for f in found:
        names = [n for n in f.input.split(", ") if n in signals]
        if f.finding == "exchanged":
            one, other = names
            signals[one], signals[other] = signals[other], signals[one]
        elif f.factor is not None:
            signals |= {n: f.factor * signals[n] for n in names}
    return replace(log, signals=signals, channels=dict(spec.channels))
