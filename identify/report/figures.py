"""Errors, candidates and parameters as pictures, and the style of all pictures.

None touches pyplot; the residual over time and against signals is in `residuals`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from hydrojax.report import page
from hydrojax.report.text import engineering, p_text, symbol, words

if TYPE_CHECKING:
    from hydrojax.identify.results.outcome import (
        Candidate,
        ChannelErrors,
        Outcome,
        Parameter,
        Series,
    )

# Okabe and Ito's palette: distinguished by colour-blind readers and in greyscale.
BEFORE, AFTER, ABOVE, BAND = "#8F8F8F", "#0072B2", "#D55E00", "#F7F0A8"
DASHES = (0, (4, 3))
STATUS = {
    "added": ("#0072B2", ""),
    "rejected": ("#E69F00", ""),
    "cannot tell": ("#CC79A7", "////"),
    "absent": ("#BDBDBD", ""),
}
STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "mathtext.fontset": "dejavusans",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.6,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "legend.frameon": False,
    "hatch.linewidth": 0.6,
    "savefig.facecolor": "white",
}
WIDTH = 7.2
"""Width of every picture, inches: two columns of a paper."""
RANKED = 24
"""Candidates that are drawn."""


def png(figure: Figure, dpi: int = 160) -> bytes:
    """The picture as a PNG file."""
    with rc_context(STYLE):
        return page.as_png(figure, dpi)


def styled(
    draw: Callable[[Outcome], Figure | None],
) -> Callable[[Outcome], Figure | None]:
    """Draw in this module's style and leave the caller's alone."""

    @wraps(draw)
    def inside(outcome: Outcome) -> Figure | None:
        with rc_context(STYLE):
            return draw(outcome)

    return inside


def judged(outcome: Outcome) -> str:
    """Which logs the errors before and after are of: `test`, `validation`, `fitted`."""
    return "test" if outcome.test_logs else replayed(outcome)


def replayed(outcome: Outcome) -> str:
    """Which logs the residuals are of: `validation`, or `fitted` without any."""
    return "validation" if outcome.validate_logs else "fitted"


def _plain(value: float, _: object = None) -> str:
    return f"{value:g}" if 1e-4 <= abs(value) < 1e5 or value == 0 else f"{value:.0e}"


def sheet(height: float) -> Figure:
    """An empty picture of `height` inches."""
    figure = Figure((WIDTH, height), layout="constrained")
    engine = figure.get_layout_engine()
    if isinstance(engine, ConstrainedLayoutEngine):
        engine.set(w_pad=0.09, h_pad=0.06)
    return figure


def log_axis(ax: Axes, low: float, high: float) -> None:
    """A log x-axis from `low` to `high` with ticks that read as plain numbers."""
    ax.set_xscale("log")
    ax.set_xlim(low, high)
    decades = np.log10(high / low)
    ax.xaxis.set_minor_formatter(NullFormatter())
    if decades < 3:
        subs = (1, 2, 5) if decades > 0.7 else (1, 1.5, 2, 3, 4, 5, 7)
        ax.xaxis.set_major_locator(LogLocator(subs=subs))
        ax.xaxis.set_major_formatter(FuncFormatter(_plain))
    else:
        ax.xaxis.set_major_locator(LogLocator(numticks=8))


@styled
def error_figure(outcome: Outcome) -> Figure | None:
    """Each channel's error before and after, in multiples of its noise."""
    rows = [
        (name, c, c.before / c.noise, c.after / c.noise)
        for name, c in outcome.channels.items()
        if np.isfinite([c.before, c.after]).all() and 0 < c.noise < np.inf
    ]
    if not rows:
        return None
    at_noise = outcome.criteria.at_noise
    figure = sheet(0.95 + 0.5 * len(rows))
    ax = figure.subplots()
    ax.axvline(1.0, color="black", lw=1.0, zorder=1)
    ax.axvline(at_noise, color="black", lw=0.8, ls=DASHES, zorder=1)
    labels, colours = [], set()
    for y, (name, c, before, after) in enumerate(rows):
        colour = AFTER if after <= at_noise else ABOVE
        colours.add(colour)
        ax.plot([before, after], [y, y], color="#C4C4C4", lw=3, zorder=2)
        ax.plot(before, y, "o", ms=8, mfc="white", mec=BEFORE, mew=1.8, zorder=3)
        shape = "o" if colour == AFTER else "D"
        ax.plot(after, y, shape, ms=7.5, color=colour, zorder=4)
        said = f"{after:.3g}" if before == after else f"{before:.3g} → {after:.3g}"
        ax.annotate(said, (1.01, y), xycoords=("axes fraction", "data"), va="center")
        factor, unit = engineering(c.noise, c.unit)
        labels.append(f"{symbol(name)}   noise {c.noise / factor:.3g} {unit}")
    ax.set_yticks(range(len(rows)), labels)
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.tick_params(axis="y", length=0)
    ax.grid(visible=False, axis="y")
    ratios = [r for *_, b, a in rows for r in (b, a) if r > 0]
    log_axis(ax, min(0.8, 0.8 * min(ratios)), max(2.0, 1.3 * max(ratios)))
    ax.set_xlabel(f"RMS error on the {judged(outcome)} logs / noise")
    marks: dict[str, Any] = {"ls": "", "ms": 7}
    open_mark: dict[str, Any] = {"mfc": "white", "mec": BEFORE, "mew": 1.6}
    handles = [Line2D([], [], marker="o", label="before", **open_mark, **marks)]
    for kind, shape, said in ((AFTER, "o", "at the noise"), (ABOVE, "D", "above it")):
        if kind in colours:
            mark = {"marker": shape, "color": kind, "label": f"after, {said}"}
            handles.append(Line2D([], [], **mark, **marks))
    handles += [
        Line2D([], [], color="black", lw=1, label="the noise"),
        Line2D([], [], color="black", lw=0.8, ls="--", label=f"{at_noise:g} × noise"),
    ]
    figure.legend(
        handles=handles, loc="outside upper center", ncols=len(handles), fontsize=8
    )
    return figure


@styled
def ranking_figure(outcome: Outcome) -> Figure | None:
    """Candidates by the share of chi-square each would explain, and their status."""
    ranked = ranking(outcome)[:RANKED]
    if not ranked:
        return None
    shares = np.array([c.share if np.isfinite(c.share) else 0.0 for c in ranked])
    least = float(np.clip(np.min(shares[shares > 0], initial=1.0) / 2, 1e-6, 0.01))
    figure = sheet(0.9 + 0.235 * len(ranked))
    ax = figure.subplots()
    for y, (c, share) in enumerate(zip(ranked, shares, strict=True)):
        colour, hatch = STATUS.get(c.status, ("#BDBDBD", ""))
        width = max(share - least, 0.0)
        ax.barh(y, width, 0.68, least, color=colour, hatch=hatch, edgecolor="white")
        _beside(ax, y, p_text(c.p_value), f"{c.power:.2f}".replace("nan", "–"))
    _beside(ax, -0.8, "p", "power", style="italic")
    ax.set_yticks(range(len(ranked)), [words(c.name) for c in ranked])
    ax.set_ylim(len(ranked) - 0.4, -0.6)
    ax.tick_params(axis="y", length=0)
    ax.grid(visible=False, axis="y")
    log_axis(ax, least, 1.0)
    ax.set_xlabel("share of the residual's chi-square that a linear step would remove")
    seen = [s for s in STATUS if any(c.status == s for c in ranked)]
    handles = [
        Patch(facecolor=STATUS[s][0], hatch=STATUS[s][1], edgecolor="white", label=s)
        for s in seen
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=4)
    return figure


def _beside(ax: Axes, y: float, p: str, power: str, style: str = "normal") -> None:
    """A row of the two columns on the right of the ranking."""
    for at, text in ((1.13, p), (1.235, power)):
        where: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "style": style}
        ax.annotate(text, (at, y), ha="right", va="center", **where)


def ranking(outcome: Outcome) -> list[Candidate]:
    """Candidates, largest share first; those with no share last."""
    share = [c.share if np.isfinite(c.share) else -1.0 for c in outcome.candidates]
    order = sorted(range(len(share)), key=lambda i: -share[i])
    return [outcome.candidates[i] for i in order]


@styled
def parameter_figure(outcome: Outcome) -> Figure | None:
    """Half the width of each free parameter's 95 % interval, relative to its value."""
    found = [(n, p) for n, p in every_parameter(outcome).items() if p.free]
    rows = [
        (n, p, 50 * (p.interval[1] - p.interval[0]) / abs(p.value))
        for n, p in found
        if p.interval and p.value and np.isfinite([*p.interval, p.value]).all()
    ]
    rows = [row for row in rows if row[2] > 0]
    if not rows:
        return None
    rows.sort(key=lambda row: row[2])
    widths = [w for *_, w in rows]
    low, high = max(min(0.1, 0.7 * widths[0]), 1e-4), 1e3 if widths[-1] > 100 else 100
    figure = sheet(0.9 + 0.235 * len(rows))
    ax = figure.subplots()
    for y, (_, p, width) in enumerate(rows):
        colour = ABOVE if p.at_bound or not p.identified else AFTER
        end = min(width, high)
        ax.plot([low, end], [y, y], color=colour, lw=1.2, alpha=0.6)
        shape = ">" if width > high else "D" if colour == ABOVE else "o"
        ax.plot(end, y, shape, ms=5.5, color=colour, clip_on=False, zorder=5)
        said = f"±{width:.2g} %" if width < 999 else "> 1000 %"
        said += "" if p.identified else "  not identified"
        said += "  at its range's end" if p.at_bound else ""
        ax.annotate(said, (1.01, y), xycoords=("axes fraction", "data"), va="center")
    ax.set_yticks(range(len(rows)), [_owned(n) for n, *_ in rows])
    ax.set_ylim(len(rows) - 0.4, -0.6)
    ax.tick_params(axis="y", length=0)
    ax.grid(visible=False, axis="y")
    log_axis(ax, low, high)
    ax.xaxis.set_major_formatter(FuncFormatter(_plain))
    ax.set_xlabel("half width of the 95 % interval / value  [%]")
    return figure


def _owned(name: str) -> str:
    """A parameter's symbol, with the effect that it belongs to."""
    owner, _, own = name.rpartition(".")
    return f"{words(owner)}  {symbol(own)}" if owner else symbol(own)


def every_parameter(outcome: Outcome) -> dict[str, Parameter]:
    """The rig's parameters, then those of the effects by `effect.parameter`."""
    own = {f"{e.name}.{n}": p for e in outcome.effects for n, p in e.parameters.items()}
    # A run may list an effect's parameters in both places.
    return outcome.parameters | own


def drawn(outcome: Outcome) -> list[Series]:
    """The validation logs of which there is something to draw."""
    return [s for s in outcome.series if np.isfinite(s.t).any()]


def compared(outcome: Outcome, series: Sequence[Series]) -> list[str]:
    """The channels of which some of these logs has a residual."""
    return [c for c in outcome.channels if any(c in s.before for s in series)]


def moved(series: Sequence[Series], names: Sequence[str]) -> bool:
    """Whether any residual after differs from the one before."""
    return any(
        not np.array_equal(s.before[c], s.after[c], equal_nan=True)
        for c in names
        for s in series
        if c in s.before and c in s.after
    )


def reach(c: ChannelErrors) -> float:
    """About how large a channel's residual is, of what is finite."""
    sizes = [size for size in (c.before, c.after, 2 * c.noise) if np.isfinite(size)]
    return max(sizes, default=0.0)
