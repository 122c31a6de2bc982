"""What a sweep found as an `xarray.Dataset` with names and units."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from jaxtyping import Shaped

from hydrojax import __version__, units
from hydrojax.report.files import DRAFT
from hydrojax.tune import measure, metrics

if TYPE_CHECKING:
    from hydrojax.tune.plan import Plan

POINT = (
    "at rest: F_0 on the output, valve shut; moving: where a slow loop stands as the "
    "piston, led at v, passes x; estimates that are adapted at the plant's values"
)
"""How the operating point is defined."""

LIKELY = 0.05
"""What 95 % of the plants reach is this quantile."""


def dataset(
    plan: Plan, found: Mapping[str, Mapping[str, Shaped[np.ndarray, "cells *rest"]]]
) -> xr.Dataset:
    """All that was found: `linear_within_1dB`, `multisine_rms_error` and the like.

    With plants, a name ending in `_95` is what 95 % of them reach: an unstable one
    reaches no bandwidth. Responses are in dB and degrees, over frequencies of their
    own: `linear_hertz`, `multisine_hertz`, `noise_hertz`.
    """
    dims = (*(("plant",) if plan.plants else ()), *(a.name for a in plan.axes))
    data = xr.Dataset(attrs={
        "title": f"{plan.rig}: gains to bandwidth",
        "rig": plan.rig,
        "methods": " ".join(plan.methods),
        "key": plan.key(),
        "made_by": f"hydrojax {__version__}",
        "operating_point": POINT,
        "adaptation": "linear: frozen; measured: "
        + ("frozen" if plan.frozen else "as the law runs"),
        "plants": plan.plants.description if plan.plants else "the rig's own",
    })  # fmt: skip
    for axis in plan.axes:
        attrs = {"units": axis.quantity.unit, "long_name": axis.quantity.description}
        here = float(axis.quantity.get(plan.setting))
        data[axis.name] = (axis.name, axis.values, attrs | {"rig_value": here})
    for name in ("x", "v", "F_0", "P_s", "P_r", "amplitude"):
        data.attrs[name] = float(plan.known[name].get(plan.setting))
    for method, values in found.items():
        _add(data, method, values, plan, dims)
    return data


def _add(
    data: xr.Dataset, method: str, values: Mapping[str, np.ndarray], plan: Plan,
    dims: tuple[str, ...],
) -> None:  # fmt: skip
    is_linear = method == "linear"
    wants, descriptions = (
        (metrics.UNITS, metrics.DESCRIPTIONS)
        if is_linear
        else (measure.UNITS, measure.DESCRIPTIONS)
    )
    for name, unit in wants.items():
        attrs = {
            "units": units.with_command(unit, plan.unit),
            "long_name": descriptions[name],
        }
        table = values[name].reshape(plan.shape)
        data[f"{method}_{name}"] = (dims, table, attrs)
        if plan.plants and name in ("within_1dB", "minus_3dB", "lag_90"):
            least = np.quantile(np.nan_to_num(table, nan=0.0), LIKELY, axis=0)
            attrs["long_name"] += ", reached by 95 % of the plants"
            data[f"{method}_{name}_95"] = (dims[1:], least, attrs)
    over = f"{method}_hertz"
    rate = float(1 / plan.setting.loop.h)
    if any(a.name == "rate" for a in plan.axes):
        rate = min(float(v) for a in plan.axes if a.name == "rate" for v in a.values)
    hertz = metrics.grid(rate) if is_linear else plan.excitations[method].hertz
    data[over] = (over, np.asarray(hertz), {"units": "Hz"})
    H = values["response"].reshape(*plan.shape, -1)
    size = 20 * np.log10(np.maximum(np.abs(H), 1e-12))
    angle = np.rad2deg(np.unwrap(np.angle(H), axis=-1))
    data[f"{method}_gain"] = ((*dims, over), size.astype("f4"), {"units": "dB"})
    data[f"{method}_phase"] = ((*dims, over), angle.astype("f4"), {"units": "deg"})
    if not is_linear:
        table = values["coherence"].reshape(*plan.shape, -1)
        data[f"{method}_coherence"] = (
            (*dims, over),
            table.astype("f4"),
            {"units": "1"},
        )


def save_dataset(data: xr.Dataset, path: Path) -> None:
    """Write NetCDF, whole or not at all."""
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=DRAFT) as folder:
        draft = Path(folder) / path.name
        data.to_netcdf(draft, engine="h5netcdf")
        os.replace(draft, path)
