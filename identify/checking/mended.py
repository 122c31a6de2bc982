"""Inputs that are mended before a trace: the rig file, and its logs read by it."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from hydrojax.errors import InputError
from hydrojax.identify.case import Case
from hydrojax.identify.checking.lines import applied
from hydrojax.identify.checking.words import Finding
from hydrojax.identify.preparation.strays import without_strays
from hydrojax.logs.log import Log, brought_forward
from hydrojax.rigfile.schema import RigFile

MENDED = ("sign", "exchanged", "unit", "delay", "held", "zero", "left out")
"""Findings that are mended before a trace. A factor of an area or a gain is not: no log
tells it from an effect of the load cell."""

Findings = tuple[Finding, ...]


def mended_case(case: Case, found: Sequence[Finding]) -> tuple[Case, Findings]:
    """The case with what was found in its inputs mended, and the findings, of which
    those are marked; the case itself where there is none.

    Raises:
        InputError: the mended inputs cannot be made ready; see `open_case`.
    """
    spec, marked = mended(case.spec, found)
    if spec is case.spec:
        return case, marked
    own = [f for f in marked if f.mended]
    logs = [[read_again(log, own, spec) for log in group] for group in case.as_read]
    return case.again(spec, logs), marked


def mended(spec: RigFile, found: Sequence[Finding]) -> tuple[RigFile, Findings]:
    """The rig file with the lines of what is to be mended in it, and the findings, of
    which those are marked.
    """
    out = []
    for one in found:
        # Stray readings are left out where a case is made ready.
        f = one if one.finding == "stray" else replace(one, mended=False)
        if _to_be_mended(f):
            with suppress(InputError):  # a value that no rig can have
                spec, f = applied(spec, f.lines), replace(f, mended=True)
        out.append(f)
    return spec, tuple(out)


def _to_be_mended(f: Finding) -> bool:
    if not f.lines or (f.input == "u" and f.finding == "unit"):
        return False
    return f.finding in MENDED or (f.input, f.finding) == ("P_s", "factor")


def read_again(log: Log, mended: Sequence[Finding], spec: RigFile) -> Log:
    """A log as the rig file reads it in which these findings are mended.

    Args:
        log: as it was read before.
        mended: the findings, in their order.
        spec: the mended rig file.
    """
    # A spline between rows that it brings forward would spread them over others.
    log = without_strays(log)
    signals = dict(log.signals)
    for f in mended:
        names = [n for n in f.input.split(", ") if n in signals]
        if f.finding == "exchanged":
            one, other = names
            signals[one], signals[other] = signals[other], signals[one]
        elif f.factor is not None:
            signals |= {n: f.factor * signals[n] for n in names}
    before = log.channels or {}
    late = {}
    for f in mended:
        if f.finding == "delay" and f.input in signals:
            was = before[f.input].late if f.input in before else 0.0
            late[f.input] = spec.channels[f.input].late - was
    signals, segments = brought_forward(log.time, signals, log.segments, late)
    return replace(
        log, signals=signals, segments=segments, channels=dict(spec.channels)
    )
