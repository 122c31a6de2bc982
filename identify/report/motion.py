"""The motion that a model predicts, in words and as a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hydrojax.identify.motion.course import SIGNALS
from hydrojax.identify.report.figures import AFTER, BEFORE, moved, sheet, styled
from hydrojax.report.text import engineering, in_picture

if TYPE_CHECKING:
    from hydrojax.identify.results.outcome import Outcome, Series

DRAWN = 4000
"""Samples that are drawn of a log."""

DRAWN_SIGNALS = ("x", "F")
"""What is drawn of what a run predicts."""


@styled
def motion_figure(outcome: Outcome) -> Figure | None:
    """Measured and predicted position, and force where there is one, through the first
    log, each with its error.
    """
    found = _shown(outcome)
    if found is None:
        return None
    drawn = [name for name in DRAWN_SIGNALS if name in found.measured]
    figure = sheet(3.8 * len(drawn))
    rows = figure.subplots(
        2 * len(drawn), sharex=True, height_ratios=(3, 2) * len(drawn)
    )
    for i, name in enumerate(drawn):
        _draw(rows[2 * i], rows[2 * i + 1], found, name)
    rows[-1].set_xlabel(f"time [s], {in_picture(found.log)}")
    handles = rows[0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper center", ncols=3)
    return figure


def _draw(top: Axes, below: Axes, found: Series, name: str) -> None:
    """One signal, measured and predicted, and below it the error."""
    every = slice(None, None, max(found.t.size // DRAWN, 1))
    t, y = found.t[every], found.measured[name][every]
    before, after = found.before[name][every], found.after[name][every]
    factor, unit = engineering(float(np.max(np.abs(y))), SIGNALS[name])
    top.plot(t, y / factor, color="black", lw=2.2, alpha=0.35, label="measured")
    runs = [("model", after, {"color": AFTER, "lw": 1.1})]
    if moved([found], [name]) and np.isfinite(before).all():
        runs[0] = ("model after", *runs[0][1:])
        style = {"color": BEFORE, "lw": 1.4, "ls": "--"}
        runs.insert(0, ("model before", before, style))
    reach = [np.max(np.abs(after))] if np.isfinite(after).all() else []
    small, small_unit = engineering(float(max(reach, default=1.0)), SIGNALS[name])
    for label, off, style in runs:
        top.plot(t, (y - off) / factor, label=label, **style)
        below.plot(t, off / small, **style)
    span = 1.15 * np.ptp(y) / factor
    middle = (np.max(y) + np.min(y)) / 2 / factor
    top.set_ylim(middle - span, middle + span)
    if reach:
        below.set_ylim(-1.5 * reach[0] / small, 1.5 * reach[0] / small)
    top.set_ylabel(f"{name} [{unit}]")
    below.set_ylabel(f"error [{small_unit}]")
    top.margins(x=0.01)


def motion_said(outcome: Outcome) -> tuple[str, str]:
    """Alternative text and caption of the figure."""
    found = _shown(outcome)
    log = found.log if found else ""
    what = "position and force" if found and "F" in found.measured else "position"
    return (
        f"{what.capitalize()} through {log}, measured and predicted, and the error.",
        f"The {what} through {log} as measured, and as the model predicts from the "
        "log's drive alone; below, measured less predicted.",
    )


def _shown(outcome: Outcome) -> Series | None:
    return outcome.motion.series[0] if outcome.motion else None
