"""Values for longer runs, where a model that is not whole loses its way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from hydrojax.errors import InputError
from hydrojax.identify.case import Case
from hydrojax.identify.results.horizons import LONG, drifting
from hydrojax.identify.results.outcome import Horizon, LongRuns, Outcome, skill_text


def with_long_runs(
    case: Case, found: Outcome, fit: Callable[[Case], Outcome]
) -> Outcome:
    """The outcome with values fitted to runs of `LONG` seconds, if those found have no
    skill through whole logs, and these more.

    What a model lacks is made up for by other values over a quarter of a second than
    over seconds.

    Args:
        case: what was fitted.
        found: in it.
        fit: fits the declared model of a case.
    """
    advice = drifting(found.channels, found.verdict, case.preparation.horizon)
    if not advice:
        return found
    try:
        spec = case.spec.with_text(found.rig_file)
        other = fit(case.again(spec, case.as_read, LONG))
    except InputError:  # the logs have no runs as long as that
        return found
    errors = {
        name: (found.channels[name].horizons.get("free"), c.horizons.get("free"))
        for name, c in other.channels.items()
    }
    channels = {
        name: replace(new, before=old.after)
        for name, (old, new) in errors.items()
        if old is not None and new is not None
    }
    pressures = [h for name, h in channels.items() if name != "F" and h.held]
    if not pressures or _lost(pressures, True) >= _lost(pressures, False):
        return found
    long = LongRuns(LONG, channels, other.rig_file)
    limits = (*(line for line in found.limits if line not in advice), said(long))
    return replace(found, long_runs=long, limits=limits)


def _lost(pressures: list[Horizon], fitted: bool) -> float:
    """Squared errors over those of a held value, summed; infinite where a run ends."""
    each = [h.after if fitted else h.before for h in pressures]
    return sum(
        float("inf") if e is None else (e / h.held) ** 2
        for e, h in zip(each, pressures, strict=True)
    )


def said(long: LongRuns) -> str:
    """What became of whole logs, with the file that has the values."""
    skills = " and ".join(
        f"{name} has skill {skill_text(replace(h, after=h.before))} with the values "
        f"found and {skill_text(h)} with those of rig_long.toml"
        for name, h in long.channels.items()
        if name != "F"
    )
    return (
        f"through whole logs {skills}, which are fitted to runs of {long.seconds:g} s: "
        "a model that lacks something is best made up for in another way there"
    )
