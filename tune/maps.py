"""Maps of a sweep: contours over two quantities, a panel for each method."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from hydrojax.report.text import in_picture
from hydrojax.rigfile.controller import PAPER
from hydrojax.tune.selection import (
    axes_of,
    axis_label,
    is_log,
    methods_of,
    near_rig,
    nominal,
)

NAMES = {
    "linear": "linearised, adaptation frozen",
    "multisine": "measured by multisine",
    "noise": "measured by white noise",
}

EDGE, SATURATED = "#8b1a1a", 0.01


def map_figure(
    data: xr.Dataset,
    quantity: str = "within_1dB",
    over: tuple[str, str] | None = None,
    suffix: str = "",
) -> Figure:
    """Contours over two quantities, one panel for each way, and where they disagree.

    Args:
        data: a sweep of two quantities or more; the others stand next to the rig's.
        quantity: what is shown.
        over: which two, across and up; the first two if None.
        suffix: `_95` for what 95 % of the plants reach.
    """
    x, y = over or (axes_of(data)[0], axes_of(data)[1])
    whole = data
    data = near_rig(nominal(data), [x, y])
    ways = [m for m in methods_of(data) if f"{m}_{quantity}" in data]
    measured = next((m for m in ways if m != "linear"), None)
    compare = quantity != "radius" and "linear" in ways and measured is not None
    panels = len(ways) + bool(compare)
    fig = Figure(
        figsize=(4.3 * panels + 2.2 * (panels == 1), 4.8), layout="constrained"
    )
    grid = fig.subplots(1, panels, squeeze=False)[0]
    tables = {
        m: _table(near_rig(whole, [x, y]), data, f"{m}_{quantity}", suffix, (y, x))
        for m in ways
    }
    _contours(fig, list(grid[: len(ways)]), data, x, y, tables, quantity)
    if compare and measured:
        _disagreement(fig, grid[-1], data, x, y, tables["linear"], tables[measured])
    _label_axes(list(grid), data, x, y)
    _legend(fig, data, x, y)
    what = data[f"{ways[0]}_{quantity}"].attrs["long_name"]
    extra = ", reached by 95 % of the plants" if suffix else ""
    fig.suptitle(f"{in_picture(data.attrs['rig'])}: {what}{extra}", fontsize=11)
    return fig


def _table(
    whole: xr.Dataset, rig: xr.Dataset, name: str, suffix: str, dims: tuple[str, str]
) -> xr.DataArray:
    """A quantity of the rig itself, or of the ensemble where it has this suffix."""
    source = whole if suffix and f"{name}{suffix}" in whole else rig
    full = f"{name}{suffix}"
    return source[full if full in source else name].transpose(*dims)


def _contours(
    fig: Figure, grid: list[Any], data: xr.Dataset, x: str, y: str,
    tables: dict[str, xr.DataArray], quantity: str,
) -> None:  # fmt: skip
    """A panel of filled contours for each method, on one scale."""
    levels = colour_edges(np.concatenate([t.values.ravel() for t in tables.values()]))
    norm = BoundaryNorm(levels, 256)
    drawn = None
    for ax, m in zip(grid, tables, strict=True):
        table = tables[m]
        drawn = ax.contourf(
            data[x], data[y], table, levels=levels, norm=norm, cmap="viridis"
        )
        lines = ax.contour(data[x], data[y], table, levels=levels[1:-3:2],
                           colors="white", linewidths=0.6)  # fmt: skip
        ax.clabel(lines, fmt="%g", fontsize=7)
        ax.set_title(NAMES[m], fontsize=10)
        _marks(ax, data, x, y)
        _mark_best(ax, data, x, y, m)
    unit = data[f"{next(iter(tables))}_{quantity}"].attrs["units"]
    assert drawn is not None  # there is at least one way
    fig.colorbar(drawn, ax=grid, label=f"{quantity} ({unit})", shrink=0.9,
                 ticks=levels, format="%.4g")  # fmt: skip


def _label_axes(grid: list[Any], data: xr.Dataset, x: str, y: str) -> None:
    """Names and scales of both axes of every panel."""
    for ax in grid:
        ax.set_facecolor("0.88")
        ax.set_xlabel(axis_label(data, x))
        if ax is grid[0]:
            ax.set_ylabel(axis_label(data, y))
        for which, name in (("x", x), ("y", y)):
            if is_log(data[name].values):
                getattr(ax, f"set_{which}scale")("log")


def colour_edges(values: Float[np.ndarray, "n"]) -> Float[np.ndarray, "k"]:
    """Edges of the colours: even over nine cells of ten, wider and wider up to the top.

    A few cells may stand far above all others, which would then share one colour.
    """
    real = values[np.isfinite(values)]
    if not real.size:
        return np.array([0.0, 1.0])
    low = min(0.0, float(real.min()))
    high = float(np.percentile(real, 90, method="lower"))
    rough = max(high - low, 1e-9) / 10
    power = 10.0 ** np.floor(np.log10(rough))
    step = next(s * power for s in (1, 2, 2.5, 5, 10) if s * power >= rough)
    edges = list(np.arange(np.floor(low / step), np.ceil(high / step) + 1) * step)
    while edges[-1] <= real.max():
        edges.append(edges[-1] + np.ceil(0.3 * abs(edges[-1]) / step + 1e-9) * step)
    return np.array(edges)


def _mark_best(ax: Axes, data: xr.Dataset, x: str, y: str, method: str) -> None:
    """The widest cell of what is shown, with its band."""
    band = data[f"{method}_within_1dB"].transpose(y, x)
    if not bool(band.notnull().any()):
        return
    best = band.isel(band.argmax(dim=[y, x]))
    at = (float(best[x]), float(best[y]))
    ax.plot(*at, "D", color="white", mec="black", ms=7, clip_on=False, zorder=5)
    # Toward the middle, or it leaves the panel.
    right, up = (
        float(np.argmin(np.abs(data[n].values - v))) < data.sizes[n] / 2
        for n, v in zip((x, y), at, strict=True)
    )
    ax.annotate(
        f"{float(best):.1f} Hz", at, xytext=(8 if right else -8, 8 if up else -8),
        textcoords="offset points", fontsize=8, color="white", weight="bold", zorder=6,
        ha="left" if right else "right", va="bottom" if up else "top",
        path_effects=[withStroke(linewidth=2, foreground="black")],
    )  # fmt: skip


def _marks(ax: Any, data: xr.Dataset, x: str, y: str) -> None:
    """Stability's edge, saturation, the rig's gains and the paper's."""
    if "linear_radius" in data:
        r = data["linear_radius"].transpose(y, x)
        if float(r.min()) < 1 < float(r.max()):
            ax.contour(data[x], data[y], r, levels=[1.0], colors=EDGE, linewidths=2)
    way = next((m for m in methods_of(data) if m != "linear"), None)
    if way:
        s = data[f"{way}_saturation"].transpose(y, x).fillna(1.0)
        if float(s.max()) > SATURATED:
            ax.contourf(data[x], data[y], s, levels=[SATURATED, 2.0], colors="none",
                        hatches=["///"])  # fmt: skip
    here = [data[n].attrs["rig_value"] for n in (x, y)]
    ax.plot(*here, "o", mfc="none", mec="white", ms=9, mew=1.6, clip_on=True)
    if x in PAPER and y in PAPER:
        ax.plot(PAPER[x], PAPER[y], "*", color="white", mec="black", ms=12)
    ax.set_xlim(float(data[x].min()), float(data[x].max()))
    ax.set_ylim(float(data[y].min()), float(data[y].max()))


def _disagreement(
    fig: Figure, ax: Any, data: xr.Dataset, x: str, y: str, one: xr.DataArray,
    other: xr.DataArray,
) -> None:  # fmt: skip
    off = 100 * (other / one - 1)
    drawn = ax.contourf(
        data[x], data[y], np.clip(off, -100, 100), levels=np.linspace(-50, 50, 11),
        cmap="RdBu", extend="both",
    )  # fmt: skip
    lines = ax.contour(data[x], data[y], np.abs(off), levels=[10.0], colors="black",
                       linewidths=1.2, linestyles="--")  # fmt: skip
    ax.clabel(lines, fmt="10 %%", fontsize=7)
    fig.colorbar(drawn, ax=ax, label="measured over linearised (%)", shrink=0.9)
    at = "" if "amplitude" in (x, y) else f" (at {data.attrs['amplitude']:g} N)"
    ax.set_title(f"where they disagree{at}", fontsize=10)
    _marks(ax, data, x, y)


def _legend(fig: Figure, data: xr.Dataset, x: str, y: str) -> None:
    parts: list[Any] = [
        Line2D(
            [], [], marker="o", mfc="none", mec="black", ls="", label="the rig file"
        ),
        Line2D([], [], marker="D", color="white", mec="black", ls="",
               label="widest within 1 dB"),
    ]  # fmt: skip
    if x in PAPER and y in PAPER:
        parts.append(
            Line2D([], [], marker="*", color="white", mec="black", ls="", ms=11,
                   label="the paper's gains")
        )  # fmt: skip
    if "linear_radius" in data and float(data["linear_radius"].max()) > 1:
        parts.append(Line2D([], [], color=EDGE, lw=2, label="edge of stability"))
        parts.append(Patch(fc="0.88", label="unstable"))
    if any(m != "linear" for m in methods_of(data)):
        parts.append(Patch(fc="none", ec="black", hatch="///", label="saturates > 1 %"))
    fig.legend(handles=parts, loc="outside lower center", ncols=len(parts), fontsize=8,
               frameon=False)  # fmt: skip
