"""A fleet's pictures: parameters against labels, effects found, friction's bounds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from hydrojax.identify.report.figures import ABOVE, AFTER, BAND, STYLE, sheet
from hydrojax.report.text import engineering, in_picture, raised, symbol, words
from hydrojax.workflows.fleet.friction import FleetBounds
from hydrojax.workflows.fleet.merged import FEW, Fleet, label
from hydrojax.workflows.fleet.summary import FAR, Found, robust_z

ROW_NUMBER = "row of the table"
CROWD = 400
"""Fits above which a picture shows their median and spread in place of each."""
KINDS = 12
"""Categories that are drawn, the most frequent ones."""
PARTS = 24
"""Parts of a crowded axis."""
TALL, ROOM = 1.55, 0.55
"""Height of a row of panels, and of the margins above and below, inches."""


def label_figure(fleet: Fleet, name: str = "") -> Figure | None:
    """Every parameter against a label, with its 95 % intervals; against rows for ""."""
    at = label(fleet, name) if name else _rows(fleet)
    drawn = [p for p in fleet.parameters if len(fleet.identified(p))]
    if not drawn or not at.notna().any():
        return None
    with rc_context(STYLE):
        lines = -(-len(drawn) // 2)
        figure = sheet(TALL * lines + ROOM)
        panels = np.ravel(figure.subplots(lines, 2, squeeze=False, sharex=True))
        for ax, parameter in zip(panels, drawn, strict=False):
            _panel(ax, fleet, parameter, at)
        for ax in panels[len(drawn) :]:
            ax.set_visible(False)
        for ax in (panels[len(drawn) - 2], panels[len(drawn) - 1]):
            ax.tick_params(labelbottom=True)
        figure.supxlabel(in_picture(name) or ROW_NUMBER, fontsize=9)
        return figure


def _rows(fleet: Fleet) -> pd.Series:
    return pd.Series(np.arange(1.0, fleet.columns("job").shape[0] + 1))


def _panel(ax: Axes, fleet: Fleet, parameter: str, at: pd.Series) -> None:
    own: Any = fleet.identified(parameter)
    own = own.assign(at=at.reindex(own.index)).dropna(subset=["at"])
    unit = fleet.unit(f"parameter.{parameter}")
    values = own["value"].to_numpy(float)
    size = float(np.median(np.abs(values))) if len(values) else 0.0
    factor, name = _scale(size, unit)
    ax.set_ylabel(f"{symbol(parameter)}" + (f"  [{name}]" if name else ""), fontsize=8)
    ax.tick_params(labelsize=7.5)
    if not len(own):
        return
    x, ticks = _places(own["at"])
    ends = own[["low", "high"]].to_numpy(float)
    std = np.nan_to_num(own["std"].to_numpy(float))
    _fits(ax, x, values / factor, std / factor, ends / factor)
    if ticks is not None:
        ax.set_xticks(
            range(len(ticks)),
            list(map(in_picture, ticks)),
            rotation=30 if len(ticks) > 5 else 0,
        )
        ax.set_xlim(-0.6, len(ticks) - 0.4)
    elif at.dtype.kind == "M":
        locator = AutoDateLocator(minticks=2, maxticks=6)
        ax.xaxis.set_major_locator(locator)
        ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))


def _scale(size: float, unit: str) -> tuple[float, str]:
    """What one printed unit is in SI, and its name, so that numbers are short."""
    factor, name = engineering(size, unit)
    if size and not 1e-3 <= size / factor < 1e5:
        power = int(np.floor(np.log10(size / factor)))
        return factor * 10.0**power, f"10{raised(power)} {name}".rstrip()
    return factor, name


def _places(at: pd.Series) -> tuple[np.ndarray, list[str] | None]:
    """Positions of values on the axis, NaN for rare categories; names of the others."""
    if at.dtype.kind == "f":
        return at.to_numpy(float), None
    if at.dtype.kind == "M":
        return at.to_numpy(), None
    most = at.value_counts().index[:KINDS]
    names = sorted(map(str, most))
    place = {n: float(i) for i, n in enumerate(names)}
    spots = at.map(lambda n: place.get(str(n), np.nan)).to_numpy(float)
    jitter = np.random.default_rng(0).uniform(-0.18, 0.18, len(spots))
    return spots + jitter, names


def _fits(
    ax: Axes, x: np.ndarray, y: np.ndarray, std: np.ndarray, ends: np.ndarray
) -> None:
    """Each fit with its interval, or what a crowd of them does; outliers in colour."""
    far = np.abs(robust_z(y, std)) > (FAR if len(y) >= FEW else np.inf)
    fine = np.isfinite(ends).all(axis=1, keepdims=True)
    wide = np.where(fine, np.abs(ends - y[:, None]), 0.0)
    if len(y) <= CROWD:
        for mask, colour in ((~far, AFTER), (far, ABOVE)):
            ax.errorbar(
                x[mask], y[mask], yerr=wide[mask].T, fmt="o", ms=2.6, lw=0.7,
                color=colour,
            )  # fmt: skip
    else:
        _crowd(ax, x, y)
        ax.plot(x[far], y[far], "o", ms=2.2, color=ABOVE)
    middle, near = np.median(y), y[~far]
    half = 1.15 * max(np.ptp(near) / 2, 1e-3 * abs(middle), 1e-300)
    span = np.max(
        np.abs(ends[~far] - middle), initial=half, where=np.isfinite(ends[~far])
    )
    if len(y) <= CROWD:
        half = max(half, 1.08 * float(np.median(wide)))  # a usual interval is whole
        half = 1.08 * max(half, span) if span < 4 * half else half
    _clip(ax, y, float((near.max() + near.min()) / 2), half)


def _clip(ax: Axes, y: np.ndarray, centre: float, half: float) -> None:
    """Limit the axis to what is near; print how many points lie outside."""
    low, high = min(centre - half, y.min()), max(centre + half, y.max())
    if high - low > 12 * half:
        low, high = centre - 3 * half, centre + 3 * half
        out = int(np.count_nonzero((y < low) | (y > high)))
        if out:
            ax.text(
                0.99, 0.97, f"{out} outside", transform=ax.transAxes, fontsize=7,
                ha="right", va="top", color=ABOVE,
            )  # fmt: skip
    pad = 0.04 * (high - low)
    ax.set_ylim(low - pad, high + pad)


def _crowd(ax: Axes, x: np.ndarray, y: np.ndarray) -> None:
    """Median, and the range of 90 %, in parts of the axis with equally many fits."""
    order = np.argsort(x, kind="stable")
    parts = np.array_split(order, PARTS)
    spots = x.astype("datetime64[ns]").astype("int64") if x.dtype.kind == "M" else x
    middle = np.array([np.median(spots[p]) for p in parts])
    if x.dtype.kind == "M":
        middle = middle.astype("int64").astype("datetime64[ns]")
    low, mid, high = (
        np.array([np.quantile(y[p], q) for p in parts]) for q in (0.05, 0.5, 0.95)
    )
    ax.fill_between(middle, low, high, color=BAND, lw=0)
    ax.plot(middle, mid, "-", lw=1.3, color=AFTER)


def effect_figure(found: Sequence[Found], jobs: int) -> Figure | None:
    """How often each effect was found."""
    if not found:
        return None
    with rc_context(STYLE):
        figure = sheet(0.3 * len(found) + ROOM)
        ax = figure.subplots()
        spots = np.arange(len(found))[::-1]
        bars = ax.barh(spots, [f.jobs for f in found], color=AFTER, height=0.62)
        ax.bar_label(bars, [f"{f.jobs}" for f in found], padding=3, fontsize=8)
        ax.set_yticks(spots, [words(f.name) for f in found])
        ax.set_xlabel(f"fits that found it, of {jobs}")
        ax.grid(axis="y", visible=False)
        ax.margins(x=0.08)
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        return figure


def friction_figure(found: FleetBounds) -> Figure:
    """Friction of every fit, and the box that holds the next one."""
    names = found.box.names
    with rc_context(STYLE):
        figure = sheet(0.55 * len(names) + 0.35)
        panels = np.ravel(figure.subplots(len(names), 1, squeeze=False))
        jitter = np.random.default_rng(0).uniform(-0.5, 0.5, len(found.values))
        for i, (ax, name) in enumerate(zip(panels, names, strict=True)):
            low, high = found.box.lower[i], found.box.upper[i]
            factor, said = engineering(max(abs(low), abs(high)), found.units[i])
            ax.axvspan(low / factor, high / factor, color=BAND, lw=0)
            ax.plot(
                found.values[:, i] / factor, jitter, "o", ms=2.4, color=AFTER, alpha=0.7
            )
            ax.axvline(found.box.mean[i] / factor, color="black", lw=0.8)
            ax.set_yticks([])
            ax.set_ylim(-1, 1)
            ax.grid(axis="y", visible=False)
            title = symbol(name) + (f"  [{said}]" if said else "")
            ax.set_ylabel(title, rotation=0, ha="right", va="center", fontsize=8.5)
            ax.tick_params(labelsize=7.5)
        return figure
