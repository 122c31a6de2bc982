"""Measured against model over time, to zoom into: for notebooks, drawn by plotly."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hydrojax.errors import InputError
from hydrojax.identify.report.explorer import COLOURS, condensed
from hydrojax.identify.report.figures import compared, drawn, moved, reach
from hydrojax.report.interactive import layout, plotly
from hydrojax.report.text import engineering

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from hydrojax.identify.results.outcome import Outcome, Series

POINTS = 3000
"""Columns into which a line is condensed: each holds its smallest and largest value."""


def explore(outcome: Outcome) -> Figure:
    """Measured and model above, the residual below; a menu of logs and channels.

    Raises:
        InputError: no residual to show, or plotly is not installed.
    """
    graph, subplots = plotly()
    series = drawn(outcome)
    names = compared(outcome, series)
    if not names:
        raise InputError("explore: this result has no residual to show")
    figure = subplots.make_subplots(2, 1, shared_xaxes=True, vertical_spacing=0.06)
    ways = ["before", "after"] if moved(series, names) else ["after"]
    shown: list[tuple[str, int]] = []
    titles: list[tuple[str, str]] = []
    for s in series:
        for name in (n for n in names if n in s.before and n in s.after):
            lines = _lines(graph, outcome, s, name, ways)
            shown.append((f"{name}, {s.log}", len(lines)))
            titles.append(_titles(outcome, name))
            for row, line in lines:
                line.visible = len(shown) == 1
                figure.add_trace(line, row=row, col=1)
    total = len(figure.data)
    buttons, first = [], 0
    for (label, count), (above, below) in zip(shown, titles, strict=True):
        seen = [first <= i < first + count for i in range(total)]
        axes = {"yaxis.title.text": above, "yaxis2.title.text": below}
        buttons.append(
            {"label": label, "method": "update", "args": [{"visible": seen}, axes]}
        )
        first += count
    figure.update_layout(layout(
        f"{outcome.rig}: {outcome.verdict}",
        updatemenus=[{"buttons": buttons, "x": 1, "y": 1.16, "xanchor": "right"}],
    ))  # fmt: skip
    figure.update_yaxes(title_text=titles[0][0], row=1, col=1)
    figure.update_yaxes(title_text=titles[0][1], row=2, col=1)
    figure.update_xaxes(title_text="time [s]", row=2, col=1)
    return figure


def _titles(outcome: Outcome, name: str) -> tuple[str, str]:
    """What stands at the two axes of a channel."""
    c = outcome.channels[name]
    unit = engineering(reach(c), c.unit)[1] or "1"
    return f"{name} [{unit}]", f"residual [{unit}]"


def _lines(
    graph: Any, outcome: Outcome, s: Series, name: str, ways: list[str]
) -> list[tuple[int, Any]]:
    """Row and line of all that is drawn of one channel of one log."""
    c = outcome.channels[name]
    factor = engineering(reach(c), c.unit)[0]
    step = float(np.ptp(s.t[np.isfinite(s.t)])) / POINTS

    def line(y: np.ndarray, label: str, colour: str, wide: float) -> Any:
        t, low_high = condensed(s.t, y, step)
        return graph.Scattergl(
            x=t.astype(np.float32), y=(low_high / factor).astype(np.float32),
            mode="lines", name=label, line={"color": colour, "width": wide},
        )  # fmt: skip

    measured = s.measured[name]
    out = [(1, line(measured, "measured", COLOURS["measured"], 2.5))]
    for way in ways:
        left = getattr(s, way)[name]
        label = f"model {way}" if len(ways) > 1 else "model"
        out.append((1, line(measured - left, label, COLOURS[way], 1.4)))
        below = line(left, f"residual {way}", COLOURS[way], 1.2)
        below.showlegend = False
        out.append((2, below))
    if np.isfinite(c.noise):
        ends = np.array([np.nanmin(s.t), np.nanmax(s.t)])
        for sign in (-2.0, 2.0):
            edge = graph.Scattergl(
                x=ends, y=np.full(2, sign * c.noise / factor), mode="lines",
                name="noise, ±2σ", showlegend=sign > 0,
                line={"color": "#b59b00", "width": 1.0, "dash": "dash"},
            )  # fmt: skip
            out.append((2, edge))
    return out
