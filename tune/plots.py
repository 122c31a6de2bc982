"""Maps of a sweep: contours over two quantities, lines over one, Bode plots."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from hydrojax.rigfile.controller import PAPER

NAMES = {
    "linear": "linearised, adaptation frozen",
    "multisine": "measured by multisine",
    "noise": "measured by white noise",
}
COLOURS = {"linear": "#1f4e9c", "multisine": "#b2382e", "noise": "#3d7a45"}
EDGE, SATURATED = "#8b1a1a", 0.01
_GREY = "0.45"


def axes_of(data: xr.Dataset) -> list[str]:
    """Names of the swept quantities, in order."""
    first = next(n for n in data.data_vars if str(n).endswith("_within_1dB"))
    return [str(d) for d in data[first].dims if d != "plant"]


def methods_of(data: xr.Dataset) -> list[str]:
    """How it was swept."""
    return data.attrs["methods"].split()


def nominal(data: xr.Dataset) -> xr.Dataset:
    """The first plant's, where there is an ensemble: the rig itself."""
    return data.isel(plant=0) if "plant" in data.dims else data


def near_rig(data: xr.Dataset, keep: list[str]) -> xr.Dataset:
    """All axes but `keep` at the value next to the rig's own."""
    for name in axes_of(data):
        if name not in keep:
            here = data[name].attrs["rig_value"]
            data = data.isel({name: int(np.abs(data[name].values - here).argmin())})
    return data


def spread(data: xr.Dataset) -> xr.Dataset:
    """Without the axes of one value, which are no axes of a picture; one stays."""
    names = axes_of(data)
    return near_rig(data, [n for n in names if data.sizes[n] > 1] or names[:1])


def _label(data: xr.Dataset, name: str) -> str:
    unit = data[name].attrs.get("units", "")
    return f"{name} ({unit})" if unit not in ("", "1") else name


def _is_log(values: np.ndarray) -> bool:
    return bool(
        values.size > 2
        and np.all(values > 0)
        and np.allclose(np.diff(np.log(values)), np.log(values[1] / values[0]))
    )


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
    tables = {}
    for m in ways:
        name = f"{m}_{quantity}{suffix}"
        source = near_rig(whole, [x, y]) if suffix and name in whole else data
        tables[m] = source[name if name in source else f"{m}_{quantity}"].transpose(
            y, x
        )
    top = np.nanpercentile(
        np.concatenate([t.values.ravel() for t in tables.values()]), 99
    )
    low = min(0.0, float(np.nanmin([np.nanmin(t) for t in tables.values()])))
    levels = _levels(low, float(top))
    drawn = None
    for ax, m in zip(grid, ways, strict=False):
        table = tables[m]
        drawn = ax.contourf(
            data[x], data[y], table, levels=levels, cmap="viridis", extend="max"
        )
        lines = ax.contour(data[x], data[y], table, levels=levels[1::2], colors="white",
                           linewidths=0.6)  # fmt: skip
        ax.clabel(lines, fmt="%g", fontsize=7)
        ax.set_title(NAMES[m], fontsize=10)
        _marks(ax, data, x, y)
    unit = data[f"{ways[0]}_{quantity}"].attrs["units"]
    assert drawn is not None  # there is at least one way
    fig.colorbar(drawn, ax=list(grid[: len(ways)]), label=f"{quantity} ({unit})",
                 shrink=0.9)  # fmt: skip
    if compare:
        _disagreement(fig, grid[-1], data, x, y, tables["linear"], tables[measured])
    for ax in grid:
        ax.set_facecolor("0.88")
        ax.set_xlabel(_label(data, x))
        if ax is grid[0]:
            ax.set_ylabel(_label(data, y))
        for which, name in (("x", x), ("y", y)):
            if _is_log(data[name].values):
                getattr(ax, f"set_{which}scale")("log")
    _legend(fig, data, x, y)
    what = data[f"{ways[0]}_{quantity}"].attrs["long_name"]
    extra = ", reached by 95 % of the plants" if suffix else ""
    fig.suptitle(f"{data.attrs['rig']}: {what}{extra}", fontsize=11)
    return fig


def _levels(low: float, top: float) -> np.ndarray:
    rough = max(top - low, 1e-9) / 12
    power = 10.0 ** np.floor(np.log10(rough))
    step = next(s * power for s in (1, 2, 2.5, 5, 10) if s * power >= rough)
    return np.arange(np.floor(low / step), np.ceil(top / step) + 1) * step


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
        Line2D([], [], marker="o", mfc="none", mec="black", ls="", label="the rig file")
    ]
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


def line_figure(data: xr.Dataset) -> Figure:
    """Bandwidths, peak and error over one quantity, for each way."""
    x = axes_of(data)[0]
    whole, data = data, near_rig(nominal(data), [x])
    fig = Figure(figsize=(8.0, 6.4), layout="constrained")
    shown = ("within_1dB", "peak", "lag_90", "rms_error")
    for ax, quantity in zip(fig.subplots(2, 2, sharex=True).flat, shown, strict=True):
        for m in methods_of(data):
            name = f"{m}_{quantity}"
            if name not in data:
                continue
            ax.plot(data[x], data[name], ".-", color=COLOURS[m], label=NAMES[m])
            if f"{name}_95" in whole:
                ax.plot(data[x], near_rig(whole, [x])[f"{name}_95"], ":",
                        color=COLOURS[m], label=f"{m}: 95 % of the plants")  # fmt: skip
            ax.set_ylabel(f"{quantity} ({data[name].attrs['units']})")
        ax.axvline(data[x].attrs["rig_value"], color=_GREY, lw=0.8, ls="--")
        ax.set_xlabel(_label(data, x))
        if _is_log(data[x].values):
            ax.set_xscale("log")
        ax.grid(alpha=0.3)
    lines, names = fig.axes[0].get_legend_handles_labels()
    fig.legend(lines, names, loc="outside lower center", ncols=len(lines), fontsize=8,
               frameon=False)  # fmt: skip
    fig.suptitle(f"{data.attrs['rig']}: over {x}", fontsize=11)
    return fig


def chosen_cells(data: xr.Dataset) -> dict[str, dict[str, int]]:
    """Cells worth a Bode plot: the rig's own, the widest, the one next to the edge."""
    names, flat = axes_of(data), nominal(data)
    here = {
        n: int(np.abs(data[n].values - data[n].attrs["rig_value"]).argmin())
        for n in names
    }
    out = {"the rig's gains": here}
    way = methods_of(data)[0]
    band = flat[f"{way}_within_1dB"].values
    if np.any(np.isfinite(band)):
        best = np.unravel_index(np.nanargmax(band), band.shape)
        out["widest within 1 dB"] = dict(zip(names, map(int, best), strict=True))
    if "linear_radius" in flat:
        r = flat["linear_radius"].values
        if np.any(r < 1) and np.any(r >= 1):
            at = np.unravel_index(np.argmax(np.where(r < 1, r, 0.0)), r.shape)
            out["next to the edge"] = dict(zip(names, map(int, at), strict=True))
    return out


def bode_figure(
    data: xr.Dataset, cells: dict[str, dict[str, int]] | None = None
) -> Figure:
    """Gain and phase of chosen cells by every way, with the plants' band.

    Args:
        data: a sweep.
        cells: title and index along each axis; those worth it if None.
    """
    cells = cells or chosen_cells(data)
    fig = Figure(figsize=(4.0 * len(cells), 6.2), layout="constrained")
    grid = fig.subplots(2, len(cells), squeeze=False, sharex=True, sharey="row")
    for (title, at), (top, bottom) in zip(cells.items(), grid.T, strict=True):
        one = data.isel(at)
        for m in methods_of(data):
            hertz = data[f"{m}_hertz"]
            style = {"color": COLOURS[m], "lw": 1.4 if m == "linear" else 1.0}
            mark = "" if m == "linear" else "."
            for ax, what in ((top, "gain"), (bottom, "phase")):
                table = one[f"{m}_{what}"]
                if "plant" in table.dims:
                    low, high = (table.quantile(q, "plant") for q in (0.025, 0.975))
                    ax.fill_between(hertz, low, high, color=COLOURS[m], alpha=0.2, lw=0)
                    table = table.isel(plant=0)
                ax.plot(hertz, table, marker=mark, ms=3, label=NAMES[m], **style)
        names = ", ".join(f"{n} = {float(data[n][i]):.3g}" for n, i in at.items())
        top.set_title(f"{title}\n{names}", fontsize=9)
        top.axhspan(-1, 1, color="0.9", zorder=0)
        top.set_ylim(-15, 15)
        bottom.set_ylim(-270, 30)
        bottom.axhline(-90, color=_GREY, lw=0.6)
        bottom.set_xlabel("frequency (Hz)")
        for ax in (top, bottom):
            ax.set_xscale("log")
            ax.set_xlim(0.5, 200)
            ax.grid(alpha=0.3)
    grid[0, 0].set_ylabel("|F/F_d| (dB)")
    grid[1, 0].set_ylabel("phase (deg)")
    grid[0, 0].legend(fontsize=7, loc="lower left")
    return fig


def figures(data: xr.Dataset) -> dict[str, Figure]:
    """What a sweep shows, by the name of its file."""
    out: dict[str, Figure] = {}
    data = spread(data)
    if len(axes_of(data)) == 1:
        out["lines"] = line_figure(data)
    else:
        out["map_within_1dB"] = map_figure(data)
        out["map_peak"] = map_figure(data, "peak")
        if "plant" in data.dims:
            out["map_within_1dB_95"] = map_figure(data, suffix="_95")
        if any(m != "linear" for m in methods_of(data)):
            out["map_rms_error"] = map_figure(data, "rms_error")
        rest = axes_of(data)[2:]
        if len(rest) == 2:
            out["map_" + "_".join(rest)] = map_figure(data, over=(rest[0], rest[1]))
    out["bode"] = bode_figure(data)
    return out
