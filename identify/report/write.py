"""What an outcome says in words, in a notebook, as figures, and as one page."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from hydrojax.errors import InputError
from hydrojax.identify.discovery.catalogue import NAMED
from hydrojax.identify.discovery.effect_file import effect_file
from hydrojax.identify.report import curves, figures, motion, residuals, traces
from hydrojax.identify.report.explorer import explorer_data
from hydrojax.identify.report.headline import grade, headline, loop_verdict
from hydrojax.identify.results.curve import FoundCurve
from hydrojax.identify.results.outcome import (
    ChannelErrors,
    Outcome,
    Parameter,
    skill_text,
)
from hydrojax.identify.results.report_json import report_json
from hydrojax.identify.results.sentence import motion_sentence
from hydrojax.report import markup
from hydrojax.report.files import digest, write_all
from hydrojax.report.page import Picture, made_by, page
from hydrojax.report.text import p_equation, p_text, quantity_text, words

PICTURES = {
    "traces": traces,
    "curve": curves,
    "error": figures,
    "dependence": residuals,
    "residual": residuals,
    "motion": motion,
    "loop": residuals,
    "ranking": figures,
    "parameter": figures,
}
"""In the order of the page, with the module of `<name>_figure`, `report_<name>.png`."""

TELLING = (
    "curve",
    "dependence",
    "residual",
    "traces",
    "error",
    "parameter",
    "motion",
    "ranking",
    "loop",
)
"""The pictures, the most telling first."""


def change(p: Parameter) -> str:
    """How far a parameter moved from its start, in per cent of that."""
    if not 0 < abs(p.start) < math.inf or not math.isfinite(p.value / p.start):
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
    heads = ("parameter", "value ± std", "95 % interval", "")
    found, beside = (
        [(name, quantity_text(p.value, p.unit, p.std), _interval(p), remarks(p))
         for name, p in every.items() if p.free]
        for every in (figures.every_parameter(outcome), outcome.beside)
    )  # fmt: skip
    return markup.block(
        markup.paragraph(outcome.sentence, f"{outcome.rig}: {outcome.verdict}."),
        markup.table(
            ("effect", "parameter", "value ± std", "p", "cannot tell from"), effects
        ),
        markup.table(("channel", "noise", "before", "after", "", ""), channels),
        markup.table(heads, found),
        markup.table(("beside the curves", *heads[1:]), beside),
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


def report_pictures(outcome: Outcome) -> list[Picture]:
    """All figures that this outcome has something to show in."""
    made = []
    for name in PICTURES:
        figure = drawn_picture(outcome, name)
        if figure is not None:
            alt, caption = _described(name, outcome)
            made.append(Picture(name, figures.png(figure), alt, caption))
    return made


def _described(name: str, outcome: Outcome) -> tuple[str, str]:
    """Alternative text and caption of a figure."""
    return {
        "traces": traces.traces_said,
        "curve": curves.curves_said,
        "error": _error_said,
        "dependence": _dependence_said,
        "residual": _residual_said,
        "motion": motion.motion_said,
        "loop": _loop_said,
        "ranking": _ranking_said,
        "parameter": _parameter_said,
    }[name](outcome)


def _error_said(outcome: Outcome) -> tuple[str, str]:
    rows = [
        f"{n} {times_noise(c.before, c.noise)} to {times_noise(c.after, c.noise)}"
        for n, c in outcome.channels.items()
        if standing(c, outcome.criteria.at_noise) != "not compared"
    ]
    return (
        f"Error before and after: {', '.join(rows)}.",
        f"RMS error of each channel on the {figures.judged(outcome)} logs, before and "
        f"after, in multiples of its noise. Up to {outcome.criteria.at_noise:g} a "
        "channel is at its noise.",
    )


def _dependence_said(outcome: Outcome) -> tuple[str, str]:
    rows = [f"{c} against {s} ({e})" for e, c, s in residuals.dependences(outcome)]
    return (
        f"Residual before and after: {', '.join(rows)}.",
        "Residual against the quantity in which each effect shows, or with which "
        "the rest correlates: mean and standard deviation in equal parts of the "
        "quantity, with some of the samples behind. Where the force is shown, each "
        "sense of motion has its own mean.",
    )


def _residual_said(outcome: Outcome) -> tuple[str, str]:
    logs = [s.log for s in outcome.series][: residuals.LOGS]
    rest = len(outcome.series) - len(logs)
    more = f" {rest} more logs are not drawn." if rest else ""
    return (
        f"Residual over time before and after, in {', '.join(logs)}.",
        f"Measured minus replayed over time on {figures.replayed(outcome)} logs, "
        "condensed to the "
        "smallest and largest value per pixel; broken where the log has gaps or is "
        f"not compared.{more}",
    )


def _loop_said(outcome: Outcome) -> tuple[str, str]:
    loop = outcome.loops[0]
    return (
        f"Output force over time in {loop.log}: desired, measured, and simulated; "
        f"measured and simulated differ by {quantity_text(loop.rms, 'N')} RMS.",
        "The log's desired force in the simulated loop: the identified rig under the "
        "controller of the rig file's [controller] (the paper's law by default); "
        "motion and supply are the log's. The "
        f"{residuals.LOOP_SECONDS:g} s of the largest variation.",
    )


def _ranking_said(outcome: Outcome) -> tuple[str, str]:
    first = figures.ranking(outcome)[:3]
    rows = [f"{words(c.name)} ({c.status})" for c in first]
    return (
        f"Candidates by the share they would explain; first are {', '.join(rows)}.",
        "Candidates by the share of the fit's chi-square that a linear step along each "
        "would remove. Power is the chance that these logs would have shown the effect "
        "at a size that matters.",
    )


def _parameter_said(outcome: Outcome) -> tuple[str, str]:
    every = figures.every_parameter(outcome)
    poor = [n for n, p in every.items() if p.free and not p.identified]
    said = f"not identified: {', '.join(poor)}" if poor else "all are identified"
    return (
        f"Relative width of each parameter's 95 % interval; {said}.",
        "Half the width of the 95 % interval of each fitted parameter, relative to its "
        "value. Diamonds: at the end of the range, or not identified.",
    )


def report_page(
    outcome: Outcome,
    shown: Sequence[Picture],
    made: Mapping[str, str],
    laws: str = "my_effects.py",
) -> str:
    """report.html, with its pictures inside; `made`: how, as in report.json; `laws`:
    the file of what was found as curves.
    """
    help_ = (
        quantity_text, change, remarks, times_noise, standing, share, listed, words,
        p_text, p_equation, skill_text, loop_verdict, motion_sentence,
    )  # fmt: skip
    return page(
        Path(__file__).parent / "report.html",
        help_,
        o=outcome,
        pictures={p.name: p for p in shown},
        ranking=figures.ranking(outcome),
        horizons=[
            (name, length, h, c.unit)
            for name, c in outcome.every_channel.items()
            for length, h in c.horizons.items()
        ],
        at_noise=outcome.criteria.at_noise,
        judged=figures.judged(outcome),
        explorer=explorer_data(outcome),
        headline=headline(outcome),
        grade=grade(outcome),
        made=made,
        laws=laws,
    )


def effects_path(folder: Path, curves: Sequence[FoundCurve]) -> Path:
    """The file of found effects in a report's folder: the first that stands there with
    none but these, or that does not stand there. Others a rig file may name.
    """
    own, number = {c.name for c in curves}, 1
    path = folder / "my_effects.py"
    while path.exists() and not _names_in(path) <= own:
        number += 1
        path = folder / f"my_effects_{number}.py"
    return path


def _names_in(path: Path) -> set[str]:
    """Names of the effects that a file defines, as `effect_file` writes them."""
    return set(NAMED.findall(path.read_text(encoding="utf-8", errors="replace")))


def write_report(outcome: Outcome, folder: Path, command_line: str = "") -> None:
    """Write report.json, report.html, the figures and rig.toml into `folder`, and
    my_effects.py where curves were found, rig_motion.toml where motion was predicted,
    rig_long.toml where longer runs have other values.

    All is made before the first file appears; a report that stands there is replaced,
    and files that are not a report's stay.
    """
    shown = report_pictures(outcome)
    made = made_by(command_line)
    content = report_json(outcome) | {"made": made}
    if outcome.rig_file:
        content["rig_toml_sha256"] = digest(outcome.rig_file.encode())
    text = json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False)
    files = {f"report_{p.name}.png": p.png for p in shown}
    laws = effects_path(folder, outcome.curves).name
    files["report.html"] = report_page(outcome, shown, made, laws).encode()
    files["report.json"] = (text + "\n").encode()
    if outcome.curves:
        files[laws] = effect_file(outcome.rig, outcome.curves).encode()
    if outcome.rig_file:
        files["rig.toml"] = outcome.rig_file.encode()
    if outcome.motion:
        files["rig_motion.toml"] = outcome.motion.rig_file.encode()
    if outcome.long_runs:
        files["rig_long.toml"] = outcome.long_runs.rig_file.encode()
    old = ["rig_motion.toml", "rig_long.toml", *(f"report_{p}.png" for p in PICTURES)]
    write_all(folder, files, obsolete=old)
