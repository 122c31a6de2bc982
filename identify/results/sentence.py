"""The sentence that states a verdict."""

from __future__ import annotations

from collections.abc import Mapping

from hydrojax.identify.results.outcome import (
    ChannelErrors,
    FoundEffect,
    PredictedMotion,
    Unexplained,
)
from hydrojax.identify.results.unexplained import LeftOpen
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.report.text import quantity_text


def without_skill(channels: Mapping[str, ChannelErrors], at_noise: float) -> str:
    """What is said first of channels above their noise that the model predicts no
    better than the value held from the start of each window; empty without one.
    """
    poor = [
        f"{name} ({quantity_text(c.after, c.unit, figures=3)} RMS) no better than its "
        f"value held from the start of each window "
        f"({quantity_text(c.window.held, c.unit, figures=3)})"
        for name, c in channels.items()
        if c.after > at_noise * c.noise
        and c.window is not None
        and c.window.skill is not None
        and c.window.skill <= 0.0
    ]
    if not poor:
        return ""
    return f"The model has no skill: it predicts {' and '.join(poor)}. "


def with_ends(said: str, ends: tuple[str, ...]) -> str:
    """The sentence, and after it what cannot be taken for an estimate."""
    if not ends:
        return said
    where = "an end of its range" if len(ends) == 1 else "an end of their ranges"
    return f"{said} At {where}: {', '.join(ends)}."


def verdict_sentence(
    command: str,
    verdict: str,
    effects: tuple[FoundEffect, ...],
    left: tuple[Unexplained, ...],
    held_out: bool,
    needed: LeftOpen,
    criteria: Criteria = Criteria(),
) -> str:
    """What a run found, in one sentence; in two where effects may stand in for others.

    `left` is what stays above its noise, `needed` what the fitted logs leave open and
    the validation logs depend on.
    """
    names, many = " and ".join(e.name for e in effects), len(effects) > 1
    where = "validation" if held_out else "fitted"
    if verdict == "nothing missing":
        return f"Nothing is missing: every channel of the {where} logs is at its noise."
    if verdict == "explained":
        return (
            f"The model lacked {names}: with {'them' if many else 'it'} every channel "
            f"of the {where} logs is at its noise."
        )
    channels = " and ".join(u.channel for u in left)
    share = sum(e.share for e in effects)
    part = "over 99.9" if share > 0.999 else f"{100 * share:.3g}"
    found = "were found and added and take" if many else "was found and added and takes"
    start = (
        f"{names} {found} away {part} % of the squared error above the noise, but "
        if names
        else ""
    )
    rest = "; ".join(u.description for u in left)
    open_ones = " and ".join(needed.names)
    if needed.whole:
        return (
            f"{start}{channels} cannot be judged: the validation logs depend on "
            f"{open_ones}, which the fitted logs leave open. With values "
            "that suit both, every channel of all logs is at its noise; fit a log that "
            "moves as the validation logs do."
        )
    if needed.names:
        rest += (
            f"; other values of {open_ones}, which the fitted logs leave open, take "
            f"away {100 * needed.share:.3g} % of the squared error above the noise"
        )
    if command == "identify":
        return f"The declared model does not explain {channels}: {rest}. Try trace."
    none = f"{'no' if start else 'No'} known effect explains the residual of"
    hint = ""
    hidden = any(u.beyond_windows for u in left)
    if names and (hidden or share < criteria.stands_in):
        hint = f" {names} may stand in for what is missing."
    return f"{start}{none} {channels}: {rest}.{hint}"


def motion_sentence(motion: PredictedMotion) -> str:
    """How far the position, and the force where it was measured, are off over whole
    logs.
    """
    off = [
        _off(motion, name, word)
        for name, word in (("x", "position"), ("F", "force"))
        if name in motion.channels
    ]
    if None in off:
        return "Motion: the run through whole logs does not stay finite."
    text = " and ".join(text for text in off if text)
    own = motion.windows["x"]
    if motion.fitted_to == "runs" and own is not None:
        shown = quantity_text(own, "m", figures=3)
        text += (
            f"; with the values found from pressures and force, the position by {shown}"
        )
    return f"Motion: {text}."


def _off(motion: PredictedMotion, name: str, word: str) -> str | None:
    """How far one signal is off; None where its run does not stay finite."""
    errors = motion.channels[name]
    whole = errors.horizons["free"]
    if whole.after is None:
        return None
    after, held = (
        quantity_text(v, errors.unit, figures=3) for v in (whole.after, whole.held)
    )
    skill = "" if whole.skill is None else f", skill {whole.skill:.4g}"
    return (
        f"the {word} is off by {after} RMS over whole logs (held at its start, "
        f"{held}{skill})"
    )
