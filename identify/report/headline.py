"""What stands first in a report: one line, a grade, and what the closed loop shows."""

from __future__ import annotations

import math
from collections.abc import Sequence

from hydrojax.identify.results.outcome import (
    ChannelErrors,
    LoopCheck,
    Outcome,
    excess_of,
)
from hydrojax.report.text import quantity_text, words

AGREES = 0.3
"""A simulated loop agrees where it is off by at most this share of the tracking error:
then nine tenths of that error's power are reproduced."""


def worst(outcome: Outcome) -> tuple[str, ChannelErrors] | None:
    """The channel that was furthest above its noise before, or is so after."""
    known = {
        name: c
        for name, c in outcome.channels.items()
        if math.isfinite(c.before + c.after) and 0 < c.noise < math.inf
    }
    if not known:
        return None
    moved = outcome.effects and outcome.verdict == "explained"
    size = (lambda c: c.before) if moved else (lambda c: c.after)
    name = max(known, key=lambda n: size(known[n]) / known[n].noise)
    return name, known[name]


def headline(outcome: Outcome) -> str:
    """What was found, in two lines at most; the outcome's sentence says all of it."""
    lead = ""
    if mended := [f.input.replace(", ", " and ") for f in outcome.inputs if f.mended]:
        lead = f"As given, {_phrase(mended)} looked wrong: mended first. "
    elif outcome.inputs:
        lead = f"Check {outcome.inputs[0].input} first: it looks wrong. "
    found = worst(outcome)
    if found is None:
        return lead + "No channel could be compared."
    name, c = found
    after = f"{quantity_text(c.after, c.unit, figures=3)} RMS"
    times = f"{c.after / c.noise:.3g} times its noise"
    effects = _phrase([words(e.name) for e in outcome.effects])
    if outcome.verdict == "nothing missing":
        return f"{lead}Nothing is missing: every channel is at its noise."
    if outcome.verdict == "explained":
        before = quantity_text(c.before, c.unit, figures=3)
        was, it = ("was", "it") if len(outcome.effects) == 1 else ("were", "them")
        now = after.removesuffix(" RMS")
        noise = quantity_text(c.noise, c.unit, figures=3)
        return (
            f"{lead}{effects.capitalize()} {was} missing: with {it}, the error of "
            f"{name} falls from {before} to {now}, at a noise of {noise}."
        )
    for u in outcome.unexplained:
        if u.beyond_windows:
            size = quantity_text(u.excess, u.unit, figures=3)
            may = f"{effects} may stand in for what" if effects else "something"
            return (
                f"{lead}{may.capitalize()} is missing: over 1 s and more {u.channel} "
                f"stays {size} above its noise."
            )
    if c.window is not None and c.window.skill is not None and c.window.skill <= 0:
        return f"{lead}The model predicts {name} no better than a held value: {after}."
    stays = f"{after}, {times}."
    left = {u.channel: outcome.channels[u.channel] for u in outcome.unexplained}
    if any(c.validate is not None for c in left.values()):
        # The verdict is theirs, and the test logs may be at their noise.
        name, c = max(left.items(), key=lambda n: _decided(n[1]) / n[1].noise)
        after = quantity_text(_decided(c), c.unit, figures=3)
        times = f"{_decided(c) / c.noise:.3g} times its noise"
        stays = f"{after} RMS on the validation logs, {times}."
    if effects:
        was = "was" if len(outcome.effects) == 1 else "were"
        return f"{lead}{effects.capitalize()} {was} found, but {name} stays at {stays}"
    by = "the declared model" if outcome.command == "identify" else "any known effect"
    return f"{lead}{name} is not explained by {by}: {stays}"


def _decided(c: ChannelErrors) -> float:
    """The error by which the verdict was found, SI."""
    return (c.validate or c).after


def _phrase(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def grade(outcome: Outcome) -> str:
    """How much of the squared error above the noise the effects take, in words."""
    ends = [(c.validate or c, c.noise) for c in outcome.channels.values()]
    if not outcome.effects:
        return ""
    if not sum(excess_of(e.before, n) for e, n in ends):
        return "no channel was above its noise before"
    share = 100 * outcome.explained_share
    text = f"{share:.3g}" if share < 99.95 else "100"
    return f"{text} % of the squared error above the noise is explained"


def loop_verdict(loop: LoopCheck) -> str:
    """Whether the simulated loop does as the measured one."""
    if not math.isfinite(loop.rms):
        return "not compared: the simulation does not stay finite"
    ratio = loop.rms / loop.tracking_measured if loop.tracking_measured else math.inf
    if ratio <= AGREES:
        return "agrees: rig and controller are those that ran"
    if loop.tracking_simulated < (1 - AGREES) * loop.tracking_measured:
        return (
            "does not agree: the simulated loop tracks better, so another law, other "
            "gains or a slower path than in [controller] ran"
        )
    return "does not agree: the controller that ran is not the one in [controller]"
