"""A sweep to slide through: for notebooks, drawn by plotly."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from hydrojax.report.interactive import layout, plotly
from hydrojax.tune.selection import (
    axes_of,
    axis_label,
    methods_of,
    near_rig,
    nominal,
    without_single_axes,
)

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

COLOUR = "#0072B2"
HERE = "#D55E00"


def explore(data: xr.Dataset, quantity: str = "within_1dB") -> Figure:
    """A slider over the last axis: what is left of the sweep, and a cell's response.

    Left stands a map over the first two axes, a line over the first of two, or where
    on the line the slider is; right the gain of the widest cell of that slice.

    Args:
        data: a sweep; axes that are not shown stand next to the rig file's values.
        quantity: what is shown at the left.

    Raises:
        InputError: plotly is not installed.
    """
    graph, subplots = plotly()
    data = without_single_axes(nominal(data))
    names = axes_of(data)
    slid, kept = names[-1], names[: min(2, len(names) - 1)]
    data = near_rig(data, [*kept, slid])
    way = methods_of(data)[0]
    table = data[f"{way}_{quantity}"]
    figure = subplots.make_subplots(1, 2, column_widths=[0.55, 0.45])
    values = data[slid].values
    start = int(np.abs(values - data[slid].attrs["rig_value"]).argmin())
    each = []
    for i in range(values.size):
        lines = [*_left(graph, data, table, slid, i), _gain(graph, data, way, slid, i)]
        for line, column in lines:
            line.visible = i == start
            figure.add_trace(line, row=1, col=column)
        each.append(len(lines))
    total, first, steps = sum(each), 0, []
    for value, count in zip(values, each, strict=True):
        seen = [first <= j < first + count for j in range(total)]
        steps.append({"label": f"{value:.3g}", "method": "restyle",
                      "args": [{"visible": seen}]})  # fmt: skip
        first += count
    label = axis_label(data, slid)
    figure.update_layout(layout(
        data.attrs["title"],
        hovermode="closest",
        showlegend=False,
        sliders=[{"active": start, "steps": steps, "pad": {"t": 50},
                  "currentvalue": {"prefix": f"{label}: "}}],
    ))  # fmt: skip
    _axes(figure, data, kept or [slid], table)
    return figure


def _left(
    graph: Any, data: xr.Dataset, table: xr.DataArray, slid: str, i: int
) -> list[tuple[Any, int]]:
    """What is left at one value of the slider."""
    kept = [n for n in table.dims if n != slid]
    if len(kept) == 2:
        x, y = kept
        top, low = float(table.max()), min(0.0, float(table.min()))
        part = table.isel({slid: i}).transpose(y, x).values
        return [(graph.Heatmap(
            x=data[x].values, y=data[y].values, z=part, zmin=low, zmax=top,
            colorscale="Viridis", colorbar={"x": 0.5, "thickness": 12},
        ), 1)]  # fmt: skip
    x = kept[0] if kept else slid
    part = table.isel({slid: i}) if kept else table
    style = {"color": COLOUR}
    out = [(graph.Scatter(x=data[x].values, y=part.values, mode="lines+markers",
                          line=style), 1)]  # fmt: skip
    if not kept:
        at = {"x": [float(data[x][i])], "y": [float(table[i])], "mode": "markers"}
        out.append((graph.Scatter(**at, marker={"color": HERE, "size": 12}), 1))
    return out


def _gain(graph: Any, data: xr.Dataset, way: str, slid: str, i: int) -> tuple[Any, int]:
    """Gain over frequency of the widest cell at one value of the slider."""
    one = data.isel({slid: i})
    band = one[f"{way}_within_1dB"]
    if band.dims and bool(band.notnull().any()):
        one = one.isel(band.argmax(dim=list(band.dims)))
    elif band.dims:
        one = one.isel({name: 0 for name in band.dims})
    at = ", ".join(f"{n} = {float(one[n]):.3g}" for n in axes_of(data))
    line = graph.Scatter(
        x=one[f"{way}_hertz"].values, y=one[f"{way}_gain"].values, mode="lines",
        line={"color": COLOUR}, name=at, hovertemplate=f"%{{x:.3g}} Hz: %{{y:.2f}} dB"
        f"<extra>{at}</extra>",
    )  # fmt: skip
    return line, 2


def _axes(figure: Any, data: xr.Dataset, kept: list[str], table: xr.DataArray) -> None:
    """Names of the axes: of the left panel, and of the gain."""
    quantity = f"{table.attrs['long_name']} ({table.attrs['units']})"
    left = [axis_label(data, n) for n in kept]
    figure.update_xaxes(title_text=left[0], row=1, col=1)
    figure.update_yaxes(title_text=left[1] if len(left) > 1 else quantity, row=1, col=1)
    figure.update_xaxes(title_text="frequency (Hz)", type="log", row=1, col=2)
    figure.update_yaxes(title_text="|F/F_d| (dB)", range=[-15, 15], row=1, col=2)
    if len(left) > 1:
        figure.update_layout(title_text=f"{data.attrs['title']}: {quantity}")
