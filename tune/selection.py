"""Parts of a sweep that its pictures show: axes, methods, cells."""

from __future__ import annotations

import numpy as np
import xarray as xr
from jaxtyping import Float


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


def without_single_axes(data: xr.Dataset) -> xr.Dataset:
    """Without the axes of one value, which are no axes of a picture; one stays."""
    names = axes_of(data)
    return near_rig(data, [n for n in names if data.sizes[n] > 1] or names[:1])


def axis_label(data: xr.Dataset, name: str) -> str:
    """An axis by its name and unit."""
    unit = data[name].attrs.get("units", "")
    return f"{name} ({unit})" if unit not in ("", "1") else name


def is_log(values: Float[np.ndarray, "n"]) -> bool:
    """Whether values are spaced evenly on a logarithmic scale."""
    return bool(
        values.size > 2
        and np.all(values > 0)
        and np.allclose(np.diff(np.log(values)), np.log(values[1] / values[0]))
    )


def chosen_cells(data: xr.Dataset) -> dict[str, dict[str, int]]:
    """Cells worth a Bode plot: the rig's own, the widest, the one next to the edge."""
    names, flat = axes_of(data), nominal(data)
    here = {
        n: int(np.abs(data[n].values - data[n].attrs["rig_value"]).argmin())
        for n in names
    }
    exact = all(
        np.isclose(data[n].values[i], data[n].attrs["rig_value"], rtol=1e-6)
        for n, i in here.items()
    )
    out = {"the rig's gains" if exact else "next to the rig's gains": here}
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
