"""Pictures of a sweep: maps, lines over one quantity, Bode plots."""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure

from hydrojax.report.text import in_picture
from hydrojax.tune.maps import NAMES, map_figure
from hydrojax.tune.selection import (
    axes_of,
    axis_label,
    chosen_cells,
    is_log,
    methods_of,
    near_rig,
    nominal,
    without_single_axes,
)

COLOURS = {"linear": "#1f4e9c", "multisine": "#b2382e", "noise": "#3d7a45"}
_GREY = "0.45"


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
        ax.set_xlabel(axis_label(data, x))
        if is_log(data[x].values):
            ax.set_xscale("log")
        ax.grid(alpha=0.3)
    lines, names = fig.axes[0].get_legend_handles_labels()
    fig.legend(lines, names, loc="outside lower center", ncols=len(lines), fontsize=8,
               frameon=False)  # fmt: skip
    fig.suptitle(f"{in_picture(data.attrs['rig'])}: over {x}", fontsize=11)
    return fig


def sweep_bode_figure(
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


def sweep_figures(data: xr.Dataset) -> dict[str, Figure]:
    """What a sweep shows, by the name of its file."""
    out: dict[str, Figure] = {}
    data = without_single_axes(data)
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
    out["bode"] = sweep_bode_figure(data)
    return out
