"""Summaries and figures of a sweep's dataset: `data.hydrojax`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import xarray as xr

from hydrojax.errors import InputError
from hydrojax.report import markup

if TYPE_CHECKING:
    import plotly.graph_objects
    from matplotlib.figure import Figure


def _widest(data: xr.Dataset, way: str, most: float = math.inf) -> xr.Dataset | None:
    """The cell that is widest within 1 dB among those with a peak of `most` dB at most;
    None where there is none.
    """
    from hydrojax.tune.selection import axes_of, nominal

    flat = nominal(data)
    band = flat[f"{way}_within_1dB"].where(flat[f"{way}_peak"] <= most)
    if not bool(band.notnull().any()):
        return None
    return flat.isel(band.argmax(dim=axes_of(data)))


def sentences(data: xr.Dataset) -> list[str]:
    """The result of a sweep in words, one line for each way.

    A band may be wide beside a high resonance, so that where the peak of the widest is
    beyond what `tune` allows, the widest of those within it is said, too.
    """
    from hydrojax.tune.aims import Limits
    from hydrojax.tune.selection import axes_of, methods_of

    def said_of(cell: xr.Dataset, way: str) -> str:
        where = ", ".join(f"{n} = {float(cell[n]):.4g}" for n in axes_of(data))
        ends = [n for n in axes_of(data) if _at_end(data[n], float(cell[n]))]
        words = f"{float(cell[f'{way}_within_1dB']):.1f} Hz at {where}"
        return words + (f" (at an end of {' and '.join(ends)})" if ends else "")

    said, most = [], Limits().peak_dB
    for way in methods_of(data):
        best = _widest(data, way)
        if best is None:
            said.append(f"{way}: no cell is stable")
            continue
        peak = float(best[f"{way}_peak"])
        words = f"{way}: widest band within 1 dB {said_of(best, way)}, "
        words += f"peak {peak:.1f} dB"
        if peak > most:
            other = _widest(data, way, most)
            words += f"; with a peak of at most {most:g} dB: "
            words += "none" if other is None else said_of(other, way)
        by = data.attrs.get(f"{way}_runs", "XLA")
        said.append(words if by == "XLA" else f"{words}; run by {by}")
    return said


def _at_end(axis: xr.DataArray, value: float) -> bool:
    """Whether a value is the first or the last of an axis of three or more."""
    return axis.size > 2 and value in (float(axis[0]), float(axis[-1]))


def axis_row(axis: xr.DataArray) -> tuple[str, ...]:
    """Name, description, number of values, range, and the rig's value."""
    values, unit = axis.values, axis.attrs["units"]
    return (
        str(axis.name),
        axis.attrs["long_name"],
        str(values.size),
        f"{values.min():.4g} to {values.max():.4g} {unit}".removesuffix(" 1"),
        f"{axis.attrs['rig_value']:.4g}",
    )


@xr.register_dataset_accessor("hydrojax")
class Swept:
    """A sweep's own views of its dataset."""

    def __init__(self, data: xr.Dataset):
        self.data = data

    def plot(self, quantity: str = "within_1dB") -> Figure:
        """A map of a quantity over the first two axes; lines where there is one.

        Raises:
            InputError: no sweep, no axis left of it, or no such quantity.
        """
        from hydrojax.tune import maps, plots, selection

        self._check(quantity)
        data = selection.without_single_axes(self.data)
        if len(selection.axes_of(data)) > 1:
            return maps.map_figure(data, quantity)
        return plots.line_figure(data)

    def explore(self, quantity: str = "within_1dB") -> plotly.graph_objects.Figure:
        """The sweep with a slider over its last axis, in a notebook: see `plot`.

        Beside the map or line stands the gain of the widest cell at the slider's value.
        It needs plotly (`hydrojax[notebook]`).

        Raises:
            InputError: plotly is not installed, no sweep, no axis left of it, or no
                such quantity.
        """
        from hydrojax.tune.interactive import explore

        self._check(quantity)
        return explore(self.data, quantity)

    def plot_bode(self, cells: Mapping[str, Mapping[str, int]] | None = None) -> Figure:
        """Gain and phase of chosen cells by every method, with the plants' range.

        Args:
            cells: title, and index along each axis, such as
                `{"low gain": {"k_p": 0, "k_f": 0}}`; if None, the cells of the rig's
                own values, of the widest bandwidth, and next to instability.

        Raises:
            InputError: no sweep, no axis left of it, or an invalid axis or index.
        """
        from hydrojax.tune import plots, selection

        self._check_whole()
        names = selection.axes_of(self.data)
        for title, at in (cells or {}).items():
            if set(at) != set(names):
                raise InputError(
                    f"invalid cell {title!r}: expected an index for each of "
                    f"{', '.join(names)}"
                )
            for name, index in at.items():
                size = self.data.sizes[name]
                if not -size <= index < size:
                    raise InputError(
                        f"invalid cell {title!r}: expected an index of {name} below "
                        f"{size}, got {index}"
                    )
        chosen = {title: dict(at) for title, at in (cells or {}).items()}
        return plots.sweep_bode_figure(self.data, chosen or None)

    def summary(self) -> str:
        """The cell with the widest bandwidth within 1 dB, a line for each method.

        Raises:
            InputError: no sweep, or no axis left of it.
        """
        self._check_whole()
        return "\n".join((self.data.attrs["title"], *sentences(self.data)))

    def _check_whole(self) -> None:
        from hydrojax.tune.selection import axes_of

        ways = self.data.attrs.get("methods", "").split()
        if not any(f"{way}_within_1dB" in self.data for way in ways):
            raise InputError(
                "no linear_within_1dB or the like: the dataset is not a whole sweep"
            )
        if not axes_of(self.data):
            raise InputError(
                "no axis of the sweep is left to draw over; keep at least one"
            )

    def _check(self, quantity: str) -> None:
        self._check_whole()
        ways = self.data.attrs["methods"].split()
        known = sorted({
            str(name).removeprefix(f"{way}_")
            for way in ways
            for name, table in self.data.data_vars.items()
            if str(name).startswith(f"{way}_") and f"{way}_hertz" not in table.dims
        })  # fmt: skip
        if quantity not in known:
            raise InputError(
                f"invalid quantity {quantity!r}: expected one of {', '.join(known)}"
            )

    def _repr_html_(self) -> str:
        """What a notebook shows: the result in words, and the axes."""
        from hydrojax.tune.selection import axes_of

        axes = [axis_row(self.data[name]) for name in axes_of(self.data)]
        return markup.block(
            markup.paragraph("; ".join(sentences(self.data)), self.data.attrs["title"]),
            markup.table(("axis", "", "values", "range", "the rig's"), axes),
        )
