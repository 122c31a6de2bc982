"""Measured and model over time: the stretch in which they differ most."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from hydrojax.identify.report.figures import (
    AFTER,
    BEFORE,
    drawn,
    moved,
    sheet,
    styled,
)
from hydrojax.identify.report.headline import worst
from hydrojax.report.text import engineering, in_picture, symbol

if TYPE_CHECKING:
    from hydrojax.identify.results.outcome import Outcome, Series

SECONDS = 2.0
"""Length of the stretch that is drawn."""


def traced(outcome: Outcome) -> tuple[str, Series] | None:
    """The channel and the log that are drawn."""
    found = worst(outcome)
    if found is None:
        return None
    name = found[0]
    own = [s for s in drawn(outcome) if name in s.before and name in s.after]
    return (name, own[0]) if own else None


def stretch(t: Float[np.ndarray, "rows"], error: Float[np.ndarray, "rows"]) -> slice:
    """The rows of `SECONDS` in which the squared error is largest; NaN adds nothing."""
    real = np.maximum.accumulate(np.nan_to_num(t, nan=-np.inf))
    total = np.concatenate([[0.0], np.cumsum(np.nan_to_num(error) ** 2)])
    last = np.searchsorted(real, real + SECONDS)
    first = int(np.argmax(total[last] - total[:-1]))
    return slice(first, int(last[first]))


@styled
def traces_figure(outcome: Outcome) -> Figure | None:
    """Measured, and the model before and after, where before is furthest off."""
    found = traced(outcome)
    if found is None:
        return None
    name, s = found
    part = stretch(s.t, s.before[name])
    t, measured = s.t[part], s.measured[name][part]
    if not np.isfinite(measured).any():
        return None
    factor, unit = engineering(float(np.nanmax(np.abs(measured))), _unit(outcome, name))
    figure = sheet(2.9)
    ax = figure.subplots()
    ax.plot(t, measured / factor, color="black", lw=2.2, alpha=0.35, label="measured")
    changed = moved([s], [name])
    if changed:
        before = (measured - s.before[name][part]) / factor
        ax.plot(t, before, "--", color=BEFORE, lw=1.4, label="model before")
    after = (measured - s.after[name][part]) / factor
    label = "model after" if changed else "model"
    ax.plot(t, after, color=AFTER, lw=1.1, label=label)
    ax.set(
        xlabel=f"time [s], {in_picture(s.log)}", ylabel=f"{symbol(name)} [{unit or 1}]"
    )
    ax.margins(x=0.01)
    figure.legend(loc="outside upper center", ncols=3)
    return figure


def _unit(outcome: Outcome, name: str) -> str:
    return outcome.channels[name].unit


def traces_said(outcome: Outcome) -> tuple[str, str]:
    """Alternative text and caption of the figure."""
    found = traced(outcome)
    name, log = (found[0], found[1].log) if found else ("", "")
    return (
        f"{name} measured and modelled over {SECONDS:g} s of {log}, before and after.",
        f"{name} as measured, and as the model replays it in windows, before and "
        f"after: the {SECONDS:g} s of {log} in which the model before is furthest off.",
    )
