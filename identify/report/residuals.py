"""The residual as pictures: over time, against signals, and in the loop run again."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from hydrojax.identify.report.explorer import condensed
from hydrojax.identify.report.figures import (
    AFTER,
    BAND,
    BEFORE,
    DASHES,
    compared,
    drawn,
    moved,
    reach,
    sheet,
    styled,
)
from hydrojax.report.text import engineering, in_picture, signal_unit, symbol, words

if TYPE_CHECKING:
    from hydrojax.identify.results.outcome import FoundEffect, Outcome, Series

POINTS = 700
"""Columns into which a long residual is condensed."""
LOGS = 3
"""Validation logs whose residual is drawn."""
LOOP_SECONDS = 3.0
"""How much of a run in closed loop is drawn."""


@styled
def residual_figure(outcome: Outcome) -> Figure | None:
    """Residual over time, before and after: a row per channel, a column per log."""
    series = drawn(outcome)[:LOGS]
    names = compared(outcome, series)
    if not names:
        return None
    figure = sheet(0.8 + 1.55 * len(names))
    axes = figure.subplots(
        len(names), len(series), sharex="col", sharey="row", squeeze=False
    )
    for row, name in zip(axes, names, strict=True):
        c = outcome.channels[name]
        factor, unit = engineering(reach(c), c.unit)
        for ax, s in zip(row, series, strict=True):
            _residual(ax, s, name, c.noise, factor)
        row[0].set_ylabel(f"{symbol(name)} residual\n[{unit or 1}]")
    for ax, s in zip(axes[-1], series, strict=True):
        ax.set_xlabel(
            f"time [s], {in_picture(s.log)}" if len(series) > 1 else "time [s]"
        )
    figure.align_ylabels()
    changed = moved(series, names)
    handles = [
        *([Line2D([], [], color=BEFORE, lw=2.5, label="before")] if changed else []),
        Line2D([], [], color=AFTER, lw=2.5, label="after" if changed else "residual"),
        Patch(fc=BAND, ec="black", ls="--", lw=0.8, label="noise, ±2σ"),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure


def _residual(ax: Axes, s: Series, name: str, noise: float, factor: float) -> None:
    ax.axhline(0.0, color="black", lw=0.5, zorder=1)
    step = np.ptp(s.t[np.isfinite(s.t)]) / POINTS
    for arrays, colour, order in ((s.before, BEFORE, 2), (s.after, AFTER, 3)):
        if name in arrays:
            t, y = condensed(s.t, arrays[name], step)
            (line,) = ax.plot(t, y / factor, color=colour, lw=0.7, zorder=order)
            line.set_solid_capstyle("round")  # a lone point stays visible
    if np.isfinite(noise):
        span = 2 * noise / factor
        ax.axhspan(-span, span, color=BAND, lw=0, zorder=0.5)
        for side in (-span, span):
            ax.axhline(side, color="black", lw=0.8, ls=DASHES, zorder=4)
    ax.yaxis.set_major_locator(MaxNLocator(5))
    ax.margins(x=0.01)


@styled
def loop_figure(outcome: Outcome) -> Figure | None:
    """F_d, F as measured and F as simulated over a stretch, and what lies between."""
    if not outcome.loops:
        return None
    loop = outcome.loops[0]
    figure = sheet(4.2)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    first = _most_varied(loop.t, loop.desired)
    part = slice(first, int(np.searchsorted(loop.t, loop.t[first] + LOOP_SECONDS)))
    t = loop.t[part]
    size = float(np.max(np.abs(loop.measured[part])))
    factor, unit = engineering(size, "N")
    for y, colour, style, label in (
        (loop.measured, BEFORE, "-", "F measured"),
        (loop.simulated, AFTER, "-", "F simulated"),
        (loop.desired, "black", "--", "F_d"),
    ):
        wide = 1.8 if style == "-" and colour == BEFORE else 0.9
        top.plot(t, y[part] / factor, style, color=colour, lw=wide, label=symbol(label))
    top.set_ylabel(f"force [{unit}]")
    off = ((loop.desired - loop.measured), BEFORE, "desired − measured")
    left = ((loop.measured - loop.simulated), AFTER, "measured − simulated")
    for y, colour, label in (off, left):
        bottom.plot(t, y[part], color=colour, lw=0.8, label=label)
    bottom.set(xlabel=f"time [s], {in_picture(loop.log)}", ylabel="difference [N]")
    for ax in (top, bottom):
        ax.margins(x=0.01)
        ax.legend(loc="upper right", ncols=3, fontsize=8)
        low, high = ax.get_ylim()
        ax.set_ylim(low, high + 0.22 * (high - low))
    return figure


def _most_varied(t: np.ndarray, y: np.ndarray) -> int:
    """Where the stretch of LOOP_SECONDS begins in which `y` changes most."""
    change = np.cumsum(np.abs(np.gradient(y)))
    last = np.searchsorted(t, t + LOOP_SECONDS)
    whole = last < t.size
    if not whole.any():
        return 0
    return int(
        np.argmax(np.where(whole, change[np.minimum(last, t.size - 1)] - change, -1))
    )


def _command_unit(outcome: Outcome) -> str:
    """`V` where the valve coefficients are per volt, else nothing."""
    volts = any(re.search(r"\bV\b", p.unit) for p in outcome.parameters.values())
    return "V" if volts else ""


def _signal(s: Series, name: str) -> np.ndarray | None:
    return s.t if name == "t" and name not in s.signals else s.signals.get(name)


def improved(effect: FoundEffect, outcome: Outcome) -> list[str]:
    """Channels whose error the effect lowered, the best always, slight ones not."""
    fall = {
        c: (effect.before[c] - effect.after.get(c, np.inf)) / outcome.channels[c].noise
        for c in effect.before
        if c in outcome.channels
    }
    most = max(fall.values(), default=0.0)
    return [c for c, f in fall.items() if f > 0 and f >= 0.1 * most]


def dependences(outcome: Outcome) -> list[tuple[str, str, str]]:
    """What `dependence_figure` draws: (effect or "unexplained", channel, signal)."""
    asked = [
        (words(e.name), c, e.residual_axis)
        for e in outcome.effects
        for c in improved(e, outcome)
    ]
    asked += [("unexplained", u.channel, u.follows) for u in outcome.unexplained]

    def shows(channel: str, signal: str) -> bool:
        if channel not in outcome.channels:
            return False
        x = _pooled(outcome, channel, signal)[0]
        return x.size > 1 and np.ptp(x) > 0

    return [row for row in dict.fromkeys(asked) if shows(*row[1:])]


def _pooled(outcome: Outcome, channel: str, signal: str) -> np.ndarray:
    """Signal, residual before, residual after, sense of motion: [4, n], all logs."""
    tables = [np.empty((4, 0))]
    for s in outcome.series:
        x = _signal(s, signal)
        if x is not None and channel in s.before and channel in s.after:
            way = np.sign(np.nan_to_num(s.signals.get("v", np.zeros(x.shape))))
            tables.append(np.stack([x, s.before[channel], s.after[channel], way]))
    table = np.concatenate(tables, axis=1)
    return table[:, np.isfinite(table).all(axis=0)]


def binned(
    x: Float[np.ndarray, "rows"], y: Float[np.ndarray, "rows"], bins: int = 28
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Mean of x, mean and standard deviation of y in equal parts of x.

    The outermost half per cent of x, and parts with next to nothing in them, are left
    out; `x` and `y` are finite.
    """
    low, high = np.percentile(x, [0.5, 99.5])
    edges = np.linspace(low, high, bins + 1)
    at = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, bins - 1)
    inside = (x >= low) & (x <= high)
    count, sx, sy, syy = (
        np.bincount(at[inside], None if w is None else w[inside], bins)
        for w in (None, x, y, y**2)
    )
    keep = count >= max(3, 1e-3 * x.size)
    n = count[keep]
    mean = sy[keep] / n
    return sx[keep] / n, mean, np.sqrt(np.maximum(syy[keep] / n - mean**2, 0.0))


@styled
def dependence_figure(outcome: Outcome) -> Figure | None:
    """Residual against the signal of each effect, or with which it correlates."""
    panels = dependences(outcome)
    if not panels:
        return None
    columns = min(len(panels), 2 if len(panels) in (2, 4) else 3)
    rows = -(-len(panels) // columns)
    figure = sheet(0.5 + 2.5 * rows)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax in axes[len(panels) :]:
        ax.remove()
    for ax, panel in zip(axes, panels, strict=False):
        _dependence(ax, outcome, *panel)
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=BEFORE, marker="o", ms=4, label="before, mean"),
        Line2D([], [], color=AFTER, marker="o", ms=4, label="after, mean"),
        Patch(color=BEFORE, alpha=0.4, lw=0, label="± std"),
        Line2D([], [], color="black", lw=0.8, ls=DASHES, label="noise, ±2σ"),
    ]
    if any(line.get_linestyle() == ":" for ax in axes for line in ax.lines):
        for style, sign in (("-o", ">"), (":s", "<")):
            mark: Any = {"ls": style[0], "marker": style[1], "label": f"$v$ {sign} 0"}
            handles.append(Line2D([], [], color="#555555", ms=4, **mark))
    figure.legend(
        handles=handles, loc="outside upper center", ncols=len(handles), fontsize=8
    )
    return figure


def _dependence(
    ax: Axes, outcome: Outcome, cause: str, channel: str, name: str
) -> None:
    x, before, after, way = _pooled(outcome, channel, name)
    c = outcome.channels[channel]
    unit = signal_unit(name, _command_unit(outcome))
    fx, ux = engineering(float(np.percentile(np.abs(x), 99)), unit)
    fy, uy = engineering(reach(c), c.unit)
    x, noise = x / fx, c.noise / fy
    # Friction turns round with the motion, and so would cancel in a common mean.
    turns = channel == "F" and name != "v"
    top = 2.2 * noise if np.isfinite(noise) else 0.0
    for y, colour in ((before / fy, BEFORE), (after / fy, AFTER)):
        _cloud(ax, x, y, colour)
        for rows, style in _senses(way, turns):
            top = max(top, _mean(ax, x[rows], y[rows], colour, style))
    for side in (-2, 2):
        ax.axhline(side * noise, color="black", lw=0.8, ls=DASHES)
    low, high = np.percentile(x, [0.3, 99.7])
    if high > low:
        ax.set_xlim(low, high)
    if top > 0:
        ax.set_ylim(-top, top)
    ax.set_xlabel(f"{symbol(name)} [{ux}]" if ux else symbol(name))
    ax.set_ylabel(f"{symbol(channel)} residual [{uy or 1}]")
    ax.set_title(cause, loc="left", fontsize=9, weight="bold")
    ax.xaxis.set_major_locator(MaxNLocator(5))


def _senses(way: np.ndarray, turns: bool) -> list[tuple[np.ndarray, str]]:
    """Rows that go into one mean each, and how its line is drawn."""
    if turns and (way > 0).any() and (way < 0).any():
        return [(way > 0, "o-"), (way < 0, "s:")]
    return [(way == way, "o-")]


def _cloud(ax: Axes, x: np.ndarray, y: np.ndarray, colour: str) -> None:
    some = np.linspace(0, x.size - 1, min(x.size, 1500)).astype(int)
    ax.plot(x[some], y[some], ".", color=colour, ms=1.6, mew=0, alpha=0.25)


def _mean(ax: Axes, x: np.ndarray, y: np.ndarray, colour: str, style: str) -> float:
    """Draw the mean and spread of y over x; gives how far from zero they reach."""
    at, mean, spread = binned(x, y)
    ax.fill_between(at, mean - spread, mean + spread, color=colour, alpha=0.3, lw=0)
    ax.plot(at, mean, style, color=colour, ms=2.6, lw=1.4)
    return float(np.max(np.abs(mean) + 1.7 * spread, initial=0.0))
