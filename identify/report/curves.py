"""Curves that stand for what no known effect explains, as one picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from hydrojax.identify.report.figures import ABOVE, AFTER, DASHES, sheet, styled
from hydrojax.report.text import engineering, p_equation, symbol, words

if TYPE_CHECKING:
    from hydrojax.identify.results.curve import FoundCurve
    from hydrojax.identify.results.outcome import Outcome

WIDE = 1.96
"""Standard deviations of the band, on either side."""


@styled
def curve_figure(outcome: Outcome) -> Figure | None:
    """Each curve over its signal: band, formula, samples, and where there are none."""
    curves = outcome.curves
    if not curves:
        return None
    figure = sheet(0.5 + 2.3 * len(curves))
    for ax, c in zip(
        figure.subplots(len(curves), 1, squeeze=False)[:, 0], curves, strict=True
    ):
        _curve(ax, c)
    handles = [
        Line2D([], [], color=AFTER, lw=1.8, label="curve"),
        Patch(fc=AFTER, alpha=0.2, label="95 % band"),
        Line2D([], [], color="black", marker="|", ls="", label="samples"),
    ]
    if any(c.law_y is not None for c in curves):
        label = "formula"
        handles.append(Line2D([], [], color=ABOVE, lw=1.2, ls=DASHES, label=label))
    if any(c.unseen for c in curves):
        handles.append(Patch(fc="#E4E4E4", label="no samples"))
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure


def _curve(ax: Axes, c: FoundCurve) -> None:
    across, s_unit = engineering(float(np.max(np.abs(c.s))), c.signal_unit)
    up, y_unit = engineering(float(np.max(np.abs(c.y))), c.unit)
    s, y, wide = c.s / across, c.y / up, WIDE * c.std / up
    ax.axhline(0.0, color="black", lw=0.5, zorder=1)
    ax.fill_between(s, y - wide, y + wide, color=AFTER, alpha=0.2, lw=0)
    ax.plot(s, y, color=AFTER, lw=1.8)
    if c.law_y is not None:
        ax.plot(s, c.law_y / up, color=ABOVE, lw=1.2, ls=DASHES)
    for low, high in c.unseen:
        ax.axvspan(low / across, high / across, color="#E4E4E4", lw=0, zorder=0)
    ax.plot(c.rug / across, np.full(len(c.rug), 0.02), "|", color="black", ms=5,
            mew=0.4, alpha=0.5, transform=ax.get_xaxis_transform())  # fmt: skip
    seen = ~np.array(c.extrapolated)
    if np.any(seen):  # a guess may be far larger than what the logs show
        low, high = np.min((y - wide)[seen]), np.max((y + wide)[seen])
        room = 0.15 * (high - low) + 1e-300
        ax.set_ylim(low - room, high + room)
    by = f" × {symbol(c.factor)}" if c.factor else ""
    ax.set_ylabel(f"{words(c.place)}{by}\n[{y_unit or 1}]")
    ax.set_xlabel(f"{symbol(c.signal)}  [{s_unit or 1}]")
    ax.margins(x=0.0)


def curves_said(outcome: Outcome) -> tuple[str, str]:
    """Alternative text and caption of the picture."""
    rows = [
        f"{words(c.name)} (p {p_equation(c.p_value)}, {100 * c.share:.0f} % of the "
        "excess)"
        for c in outcome.curves
    ]
    return (
        f"Curves beside the known effects: {', '.join(rows)}.",
        "What the known effects leave, as a curve over one signal at one place of the "
        "rig, less what the rig's own fitted parameters can follow. Ticks below: the "
        "samples on which it rests; grey: it has none there, and is a guess.",
    )
