"""The motion that a model predicts, in words and as a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from hydrojax.identify.report.figures import AFTER, BEFORE, moved, sheet, styled
from hydrojax.report.text import engineering

if TYPE_CHECKING:
    from hydrojax.identify.results.outcome import Outcome, Series

DRAWN = 4000
"""Samples that are drawn of a log."""


@styled
def motion_figure(outcome: Outcome) -> Figure | None:
    """Measured and predicted position through the first log, and the error."""
    found = _shown(outcome)
    if found is None:
        return None
    every = slice(None, None, max(found.t.size // DRAWN, 1))
    t, x = found.t[every], found.measured["x"][every]
    before, after = found.before["x"][every], found.after["x"][every]
    factor, unit = engineering(float(np.max(np.abs(x))), "m")
    figure = sheet(3.8)
    top, below = figure.subplots(2, sharex=True, height_ratios=(3, 2))
    top.plot(t, x / factor, color="black", lw=2.2, alpha=0.35, label="measured")
    runs = [("model", after, {"color": AFTER, "lw": 1.1})]
    if moved([found], ["x"]) and np.isfinite(before).all():
        runs[0] = ("model after", *runs[0][1:])
        style = {"color": BEFORE, "lw": 1.4, "ls": "--"}
        runs.insert(0, ("model before", before, style))
    reach = [np.max(np.abs(after))] if np.isfinite(after).all() else []
    small, small_unit = engineering(float(max(reach, default=1.0)), "m")
    for label, off, style in runs:
        top.plot(t, (x - off) / factor, label=label, **style)
        below.plot(t, off / small, **style)
    span = 1.15 * np.ptp(x) / factor
    middle = (np.max(x) + np.min(x)) / 2 / factor
    top.set_ylim(middle - span, middle + span)
    if reach:
        below.set_ylim(-1.5 * reach[0] / small, 1.5 * reach[0] / small)
    top.set_ylabel(f"x [{unit}]")
    below.set(ylabel=f"error [{small_unit}]", xlabel=f"time [s], {found.log}")
    top.margins(x=0.01)
    figure.legend(loc="outside upper center", ncols=3)
    return figure


def motion_said(outcome: Outcome) -> tuple[str, str]:
    """Alternative text and caption of the figure."""
    found = _shown(outcome)
    log = found.log if found else ""
    return (
        f"Position through {log}, measured and predicted, and the error.",
        f"The position through {log} as it was measured, and as the model predicts it "
        "from the log's drive alone; below, measured less predicted.",
    )


def _shown(outcome: Outcome) -> Series | None:
    return outcome.motion.series[0] if outcome.motion else None
