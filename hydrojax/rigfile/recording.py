"""Logs of closed-loop runs: written from a run, and run again from a log."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pandas as pd
import scipy.io
from jaxtyping import Float
from scipy import interpolate

from hydrojax.control.loop import Loop, Scenario
from hydrojax.control.simulation import Run, Trajectory, make_scenario
from hydrojax.errors import InputError
from hydrojax.logs.log import Log
from hydrojax.report.files import DRAFT
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


def rerun(
    spec: RigFile, loop: Loop, log: Log, most: float
) -> tuple[Scenario | None, Loop]:
    """The scenario of a measured run, and the loop begun where the run began.

    Args:
        spec: the rig.
        loop: the loop that will run it.
        log: with F_d and motion; its supply is taken where it has one.
        most: s, of which no more is taken.

    Returns:
        None for a scenario of less than two seconds without a gap or a missing F_d.
    """
    start, stop = longest(log)
    rows = slice(start, stop)
    t = log.time[rows] - log.time[start]
    holes = np.flatnonzero(np.isnan(log.signals["F_d"][rows]))
    end = t[holes[0] - 1] if holes.size else t[-1]
    h = float(loop.h)
    n = int(min(end, most) / h)
    if n * h < 2.0:
        return None, loop
    at = np.arange(n + 1) * h

    def given(name: str) -> float | np.ndarray:
        if name not in log.signals:
            return spec.line[name]
        return np.interp(at, t, log.signals[name][rows])

    F_d = np.interp(at[:-1], t, log.signals["F_d"][rows])
    path = log_path(log, spec, (start, stop))
    if "P_a1" in log.signals and "P_a1" in spec.layout.pressures:
        first = jnp.asarray(np.median(log.signals["P_a1"][rows][:5]))
        loop = eqx.tree_at(lambda lo: lo.P_start, loop, first)
    return make_scenario(F_d, path, h, given("P_s"), given("P_r")), loop


def longest(log: Log) -> tuple[int, int]:
    """The longest segment of a log: [start, stop) rows without a gap."""
    return max(log.segments, key=lambda rows: rows[1] - rows[0])


def duration(log: Log) -> float:
    """The length of the longest segment of a log, s."""
    start, stop = longest(log)
    return float(log.time[stop - 1]) - float(log.time[start])


def log_path(log: Log, spec: RigFile, rows: tuple[int, int]) -> Trajectory:
    """The motion of a stretch of a log, from its first row on."""
    t, x = log.time[slice(*rows)], position(log, spec)[slice(*rows)]
    spline = interpolate.make_interp_spline(t, x, k=5)

    def path(at: np.ndarray, nu: int) -> np.ndarray:
        # Held at its ends: a spline runs off beyond them.
        return spline(np.clip(t[0] + at, t[0], t[-1]), nu)

    return path


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
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=DRAFT) as folder:
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
