"""What an outcome says in words, and what a notebook shows of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from hydrojax.errors import InputError
from hydrojax.identify.report import figures, residuals
from hydrojax.report import markup
from hydrojax.report.text import p_text, quantity_text, words

if TYPE_CHECKING:
    from hydrojax.identify.results.outcome import ChannelErrors, Outcome, Parameter

PICTURES = {
    "error": figures,
    "dependence": residuals,
    "residual": residuals,
    "loop": residuals,
    "ranking": figures,
    "parameter": figures,
}
"""In the order of the page, with the module of `<name>_figure`, `report_<name>.png`."""

TELLING = ("dependence", "residual", "error", "parameter", "ranking", "loop")
"""The pictures, the most telling first."""


def change(p: Parameter) -> str:
    """How far a parameter moved from its start, in per cent of that."""
    if not p.start or not math.isfinite(p.value / p.start):
        return "–"
    percent = 100 * (p.value - p.start) / abs(p.start)
    if abs(percent) >= 1000:
        return f"× {p.value / p.start:.3g}".replace("-", "−")
    return f"{percent:+.1f} %".replace("-", "−")


def remarks(p: Parameter) -> str:
    """What a reader has to know before using a parameter."""
    said = []
    if p.at_bound:
        said.append("at the end of its range: its interval holds on one side only")
    if not p.identified:
        said.append("not identified: these logs do not determine it")
    return "; ".join(said)


def times_noise(value: float, noise: float) -> str:
    """An error in multiples of the noise."""
    if not math.isfinite(value) or not 0 < noise < math.inf:
        return "–"
    ratio = value / noise
    return f"{ratio:.2f} × noise" if ratio < 100 else f"{ratio:.0f} × noise"


def standing(c: ChannelErrors, at_noise: float) -> str:
    """Where a channel's error stands, in words."""
    if not math.isfinite(c.after) or not 0 < c.noise < math.inf:
        return "not compared"
    return "at its noise" if c.after <= at_noise * c.noise else "above its noise"


def share(value: float) -> str:
    """A share of chi-square in per cent."""
    if not math.isfinite(value):
        return "–"
    return f"{100 * value:.2g} %" if value >= 1e-4 else "< 0.01 %"


def listed(names: Sequence[str]) -> str:
    """Names of effects as a phrase: `a`, `a or b`, `a, b or c`."""
    said = [words(n) for n in names]
    return " or ".join([", ".join(said[:-1]), said[-1]] if len(said) > 1 else said)


def drawn_picture(outcome: Outcome, picture: str) -> Figure | None:
    """One of `PICTURES`, or None where there is nothing to show in it."""
    return getattr(PICTURES[picture], f"{picture}_figure")(outcome)


def plot(outcome: Outcome, picture: str | None = None) -> Figure:
    """A picture by its name, or the most telling one.

    Raises:
        InputError: a name that is not among `PICTURES`, or nothing to show in it.
    """
    if picture is not None and picture not in PICTURES:
        raise InputError(f"picture {picture!r}: write one of {', '.join(PICTURES)}")
    for name in TELLING if picture is None else (picture,):
        figure = drawn_picture(outcome, name)
        if figure is not None:
            return figure
    raise InputError(f"{outcome.rig}: nothing to show in {picture or 'any picture'}")


def result_html(outcome: Outcome) -> str:
    """Verdict, effects, channels and fitted parameters: what a notebook shows."""
    effects = [
        (words(e.name), name, quantity_text(p.value, p.unit, p.std), p_text(e.p_value),
         listed(e.cannot_tell_from) if e.cannot_tell_from else "")
        for e in outcome.effects
        for name, p in e.parameters.items()
    ]  # fmt: skip
    channels = [
        (name, *(quantity_text(v, c.unit, figures=3)
                 for v in (c.noise, c.before, c.after)),
         times_noise(c.after, c.noise), standing(c, outcome.criteria.at_noise))
        for name, c in outcome.channels.items()
    ]  # fmt: skip
    found = [
        (name, quantity_text(p.value, p.unit, p.std), _interval(p), remarks(p))
        for name, p in figures.every_parameter(outcome).items()
        if p.free
    ]
    return markup.block(
        markup.paragraph(outcome.sentence, f"{outcome.rig}: {outcome.verdict}."),
        markup.table(
            ("effect", "parameter", "value ± std", "p", "cannot tell from"), effects
        ),
        markup.table(("channel", "noise", "before", "after", "", ""), channels),
        markup.table(("parameter", "value ± std", "95 % interval", ""), found),
    )


def _interval(p: Parameter) -> str:
    """An interval's ends, with as many figures as distinguish them to a hundredth."""
    if p.interval is None or not all(math.isfinite(end) for end in p.interval):
        return "–"
    low, high = p.interval
    size, width = max(abs(low), abs(high)), high - low
    enough = 2 + math.ceil(math.log10(size / width)) if width > 0 else 4
    ends = (quantity_text(end, p.unit, figures=max(enough, 3)) for end in p.interval)
    return " to ".join(ends)
