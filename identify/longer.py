"""Values for longer runs, where a model that is not whole loses its way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from hydrojax.errors import InputError
from hydrojax.identify.case import Case
from hydrojax.identify.results.horizons import drifting
from hydrojax.identify.results.outcome import LongRuns, Outcome, skill_text

Progress = Callable[[str], None]


def with_long_runs(
    case: Case,
    found: Outcome,
    fit: Callable[[Case, int, Progress], Outcome],
    progress: Progress = lambda _: None,
    early: Callable[[Outcome], None] = lambda _: None,
) -> Outcome:
    """The outcome with values fitted to longer runs, where those found have little
    skill through whole logs, and these have more in every pressure.

    What a model lacks is made up for by other values over a quarter of a second than
    over seconds. Each fit begins where the one to shorter runs ended: from the values
    for a quarter of a second one to the longest may not find back.

    Args:
        case: what was fitted. One with test logs is left as it is: errors are of those
            then, and decide nothing.
        found: in it.
        fit: fits the declared model of a case, from so many starts.
        progress: is called with a line of text at each fit.
        early: is given `found` before the first of them: together they take minutes.
    """
    own, length = case.criteria, case.preparation.horizon
    advice = drifting(found.channels, found.verdict, length, own)
    if not advice or case.test is not None:
        return found
    early(found)
    best, text = None, found.rig_file
    for seconds in (own.longer_run, own.longest_run):
        progress(f"fit runs of {seconds:g} s")
        try:
            spec = case.spec.with_text(text)
            other = fit(case.again(spec, case.as_read, seconds), 1, progress)
        except InputError:  # the logs have no runs as long as that
            break
        long = _compared(found, other, seconds)
        if long is not None and (best is None or _lost(long) < _lost(best)):
            best, text = long, other.rig_file
    if best is None:
        return found
    limits = (*(line for line in found.limits if line not in advice), said(best))
    return replace(found, long_runs=best, limits=limits)


def _compared(found: Outcome, other: Outcome, seconds: float) -> LongRuns | None:
    """The values of `other`, if no pressure is further off through whole logs."""
    channels = {}
    for name, c in other.channels.items():
        old, new = found.channels[name].horizons.get("free"), c.horizons.get("free")
        if old is not None and new is not None:
            channels[name] = replace(new, before=old.after)
    pressures = [h for name, h in channels.items() if name != "F"]
    better = [
        h.after is not None and (h.before is None or h.after < h.before)
        for h in pressures
    ]
    if not better or not all(better):
        return None
    return LongRuns(seconds, channels, other.rig_file)


def _lost(long: LongRuns) -> float:
    """Squared errors of the pressures over those of a held value, summed."""
    own = (h for name, h in long.channels.items() if name != "F" and h.held)
    return sum((h.after / h.held) ** 2 for h in own if h.after is not None)


def said(long: LongRuns) -> str:
    """What became of whole logs, with the file that has the values."""
    skills = " and ".join(
        f"{name} has skill {skill_text(replace(h, after=h.before))}, and "
        f"{skill_text(h)} with the values of rig_long.toml"
        for name, h in long.channels.items()
        if name != "F"
    )
    return (
        f"through whole logs {skills}, which are fitted to runs of {long.seconds:g} s"
    )
