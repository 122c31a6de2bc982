"""A closed-loop run as a log: its columns, and files of them."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.io
from jaxtyping import Float

from hydrojax.control.simulation import Run
from hydrojax.errors import InputError
from hydrojax.logs.log import Log
from hydrojax.rigfile.schema import RigFile

_DIGITS = {"time": "%.6f", "psi": "%.10g", "x": "%.10g"}

KINDS = (".csv", ".csv.gz", ".parquet", ".mat")
"""What a log may be saved as."""


def position(log: Log, spec: RigFile) -> Float[np.ndarray, "n"]:
    """The piston's position in a log, [n], m.

    Raises:
        InputError: the log has no motion, or an angle and the rig no radius.
    """
    if "x" in log.signals:
        return log.signals["x"] - spec.geometry.get("x_mid", 0.0)
    if "psi" in log.signals:
        if "radius" not in spec.geometry:
            raise InputError(
                f"{log.name}: column psi needs the driving radius: write "
                f'radius = "… m" under [geometry] in {spec.path}'
            )
        return log.signals["psi"] * spec.geometry["radius"]
    raise InputError(f"{log.name}: no motion: give a column x [m] or psi [rad]")


def place_column(
    x: Float[np.ndarray, "n"], spec: RigFile
) -> tuple[str, str, Float[np.ndarray, "n"]]:
    """Name, unit and values of the position [n] (m) as this rig logs it."""
    radius = spec.geometry.get("radius")
    if radius:
        return "psi", "rad", x / radius
    return "x", "m", x + spec.geometry.get("x_mid", 0.0)


def scenario_columns(
    t: Float[np.ndarray, "n"],
    F_d: Float[np.ndarray, "n"],
    x: Float[np.ndarray, "n"],
    spec: RigFile,
) -> dict[str, tuple[str, Float[np.ndarray, "n"]]]:
    """Reference and motion as the columns of a log; [n] each, s, N, m."""
    name, unit, place = place_column(x, spec)
    return {"time": ("s", t), name: (unit, place), "F_d": ("N", F_d)}


def log_columns(
    run: Run, spec: RigFile
) -> dict[str, tuple[str, Float[np.ndarray, "n"]]]:
    """A run's log: unit and values by the contract's names."""
    place, unit, values = place_column(run["x"], spec)
    out = {
        "time": ("s", run.t),
        "u": (spec.command_unit, run["u"]),
        place: (unit, values),
    }
    for name in ("P_a1", "P_a2", "P_s", "F"):
        if name not in spec.layout.unmeasured:
            out[name] = ("N" if name == "F" else "Pa", run[name])
    return out | {"F_d": ("N", run.F_d)}


def write_log(
    path: Path, table: Mapping[str, tuple[str, Float[np.ndarray, "n"]]]
) -> None:
    """Write a log, whole or not at all.

    Args:
        path: its name's ending is the kind of file: one of `KINDS`.
        table: unit and values [n] by name.

    Raises:
        InputError: another ending.
    """
    check_kind(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        draft = Path(folder) / path.name
        labels = [f"{name} [{unit}]" for name, (unit, _) in table.items()]
        values = [v for _, v in table.values()]
        kind = path.suffix.lower()
        if kind == ".mat":
            log = {name: v for name, (_, v) in table.items()}
            said = {name: unit for name, (unit, _) in table.items()}
            scipy.io.savemat(draft, {"log": log, "units": said})
        elif kind == ".parquet":
            pd.DataFrame(dict(zip(labels, values, strict=True))).to_parquet(draft)
        else:
            form = [_DIGITS.get(name, "%.8g") for name in table]
            text = {"header": ",".join(labels), "comments": "", "delimiter": ","}
            plain = Path(folder) / ("log.csv.gz" if kind == ".gz" else "log.csv")
            np.savetxt(plain, np.column_stack(values), fmt=form, **text)
            plain.rename(draft)
        os.replace(draft, path)


def check_kind(path: Path) -> None:
    """Refuse a name that does not end in one of `KINDS`."""
    if not path.name.lower().endswith(KINDS):
        raise InputError(
            f"{path}: not a kind of log; call it .csv, .csv.gz, .parquet or .mat"
        )
