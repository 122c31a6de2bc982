"""What a run found as report.json, as figures, and as one self-contained page."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hydrojax.identify.report import figures, residuals
from hydrojax.identify.report.explorer import explorer_data
from hydrojax.identify.results.outcome import (
    ChannelErrors,
    FoundEffect,
    LoopCheck,
    Outcome,
    Parameter,
    Unexplained,
)
from hydrojax.identify.results.show import (
    PICTURES,
    change,
    drawn_picture,
    listed,
    remarks,
    share,
    standing,
    times_noise,
)
from hydrojax.report.files import write_all
from hydrojax.report.page import Picture, page
from hydrojax.report.text import p_text, quantity_text, words

FORMAT = "hydrojax-report/1"


def report_json(outcome: Outcome) -> dict[str, Any]:
    """The content of report.json: SI units; null for what is not a finite number."""
    o = outcome
    found = {
        "format": FORMAT,
        "command": o.command,
        "rig": o.rig,
        "logs": {
            "fit": o.fit_logs,
            "validate": o.validate_logs,
            "test": o.test_logs,
        },
        "verdict": o.verdict,
        "sentence": o.sentence,
        "parameters": {n: _parameter(p) for n, p in o.parameters.items()},
        "channels": {n: _channel(c) for n, c in o.channels.items()},
        "effects": [_effect(e) for e in o.effects],
        "candidates": [asdict(c) for c in o.candidates],
        "unexplained": [_unexplained(u) for u in o.unexplained],
        "closed_loop": [_loop(c) for c in o.loops],
        "covariance": asdict(o.covariance) if o.covariance else None,
        "limits": o.limits,
        "notes": o.notes,
        "seconds": o.seconds,
        "criteria": asdict(o.criteria),
    }
    return _strict(found)


def _parameter(p: Parameter) -> dict[str, Any]:
    return {
        "value": p.value,
        "std": p.std,
        "unit": p.unit,
        "interval": p.interval,
        "start": p.start,
        "at_bound": p.at_bound,
        "identified": p.identified,
        "held": not p.free,
        "says": p.description,
        **({"profile": p.profile} if p.profile else {}),
    }


def _effect(e: FoundEffect) -> dict[str, Any]:
    own = {n: _parameter(p) for n, p in e.parameters.items()}
    # Not asdict: it would spell a parameter's fields in another way than the rig's.
    return {
        "name": e.name,
        "parameters": own,
        "p_value": e.p_value,
        "before": e.before,
        "after": e.after,
        "cannot_tell_from": e.cannot_tell_from,
        "betrayed_by": e.residual_axis,
    }


def _channel(c: ChannelErrors) -> dict[str, Any]:
    own = asdict(c)
    return own if c.validate else {k: v for k, v in own.items() if k != "validate"}


def _unexplained(u: Unexplained) -> dict[str, Any]:
    own = asdict(u)
    return own | {"says": own.pop("description")}


def _loop(c: LoopCheck) -> dict[str, Any]:
    names = ("log", "rms", "tracking_measured", "tracking_simulated", "warning")
    return {"unit": "N"} | {name: getattr(c, name) for name in names}


def _strict(value: Any) -> Any:
    """The same in JSON's own types, without NaN and infinity."""
    if hasattr(value, "tolist"):
        value = value.tolist()  # an array's or a NumPy number's own way
    if isinstance(value, Mapping):
        return {str(k): _strict(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_strict(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


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
        "error": _error_said,
        "dependence": _dependence_said,
        "residual": _residual_said,
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
        "Measured minus replayed over time on validation logs, condensed to the "
        "smallest and largest value per pixel; broken where the log has gaps or is "
        f"not compared.{more}",
    )


def _loop_said(outcome: Outcome) -> tuple[str, str]:
    loop = outcome.loops[0]
    return (
        f"Output force over time in {loop.log}: desired, measured, and simulated; "
        f"measured and simulated differ by {quantity_text(loop.rms, 'N')} RMS.",
        "The log's desired force in the simulated loop: the identified rig, the "
        "paper's law with the rig file's [controller]; motion and supply are the "
        "log's. The "
        f"liveliest {residuals.LOOP_SECONDS:g} s.",
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


def report_page(outcome: Outcome, shown: Sequence[Picture]) -> str:
    """report.html, with its pictures inside."""
    help_ = (
        quantity_text, change, remarks, times_noise, standing, share, listed, words,
        p_text,
    )  # fmt: skip
    return page(
        Path(__file__).parent / "report.html",
        help_,
        o=outcome,
        pictures={p.name: p for p in shown},
        ranking=figures.ranking(outcome),
        at_noise=outcome.criteria.at_noise,
        judged=figures.judged(outcome),
        explorer=explorer_data(outcome),
    )


def write_report(outcome: Outcome, folder: Path) -> None:
    """Write report.json, report.html, the figures and rig.toml into `folder`.

    All is made before the first file appears; a report that stands there is replaced,
    and files that are not a report's stay.
    """
    shown = report_pictures(outcome)
    text = json.dumps(
        report_json(outcome), indent=1, allow_nan=False, ensure_ascii=False
    )
    files = {f"report_{p.name}.png": p.png for p in shown}
    files["report.html"] = report_page(outcome, shown).encode()
    files["report.json"] = (text + "\n").encode()
    if outcome.rig_file:
        files["rig.toml"] = outcome.rig_file.encode()
    write_all(folder, files)
    for name in {f"report_{p}.png" for p in PICTURES} - set(files):
        (folder / name).unlink(missing_ok=True)
