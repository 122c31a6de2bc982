"""A closed-loop run as a log, and a log as a closed-loop run."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pandas as pd
import scipy.io
from scipy import interpolate

from hydrojax import units
from hydrojax.control import inputs, simulation
from hydrojax.control.loop import Loop, Scenario
from hydrojax.control.simulation import Run, hold, make_scenario
from hydrojax.errors import InputError
from hydrojax.logs.log import Log
from hydrojax.rigfile.schema import RigFile

_DIGITS = {"time": "%.6f", "psi": "%.10g", "x": "%.10g"}

KINDS = (".csv", ".csv.gz", ".parquet", ".mat")
"""What a log may be saved as."""

REFERENCES = {
    "sines": (("N", 400.0),),
    "sine": (("N", 300.0), ("Hz", 0.5)),
    "noise": (("N", 200.0), ("Hz", 50.0)),
}
"""Desired forces by kind: what each is given, unit and default."""

MOTIONS = {
    "wander": (("m/s", 0.025),),
    "to-and-fro": (("m/s", 0.03), ("s", 3.0)),
    "locked": (("m", 0.0),),
}
"""Motions by kind: what each is given, unit and default."""


def position(log: Log, spec: RigFile) -> np.ndarray:
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


def read_scenario(
    spec: RigFile,
    loop: Loop,
    reference: str = "sines",
    motion: str = "wander",
    seconds: float = 12.0,
    seed: int = 0,
) -> Scenario:
    """A course in words: `kind`, `kind:quantity,quantity`, or a log's path.

    Args:
        spec: the rig, for its supply and its logs' channels.
        loop: the loop that will run it.
        reference: one of `REFERENCES`, such as `sine:300 N,0.5 Hz`; or a log with F_d.
        motion: one of `MOTIONS`, such as `to-and-fro:3 cm/s,3 s`; or a log.
        seconds: length; a log cuts it to its own.
        seed: of the sensors' noise and of what is random in reference and motion.

    Raises:
        InputError: words, quantities or logs that will not do.
    """
    h = float(loop.h)
    force_log = _log(reference, REFERENCES, spec)
    path_log = force_log if motion == reference else _log(motion, MOTIONS, spec)
    for log in (force_log, path_log):
        if log is not None:
            seconds = min(seconds, _span(log)[1] - _span(log)[0])
    if not 0.05 <= seconds <= 1e5:
        raise InputError(f"--seconds {seconds:g}: give 0.05 to 100000")
    n = round(seconds / h)
    t = np.arange(n) * h
    rng = np.random.default_rng([seed, 1])
    if force_log is not None:
        rows = slice(*longest(force_log))
        if "F_d" not in force_log.signals:
            raise InputError(
                f"{reference}: no column F_d to follow; name another log, or one of "
                f"{', '.join(REFERENCES)}"
            )
        if np.isnan(force_log.signals["F_d"][rows]).any():
            raise InputError(
                f"{reference}: F_d has holes in its longest stretch; fill them or cut "
                "the log there"
            )
        start = force_log.time[rows][0]
        F_d = np.interp(start + t, force_log.time[rows], force_log.signals["F_d"][rows])
    else:
        kind, given = _words(reference, REFERENCES, "--reference")
        if kind == "sines":
            F_d = inputs.sines(rng, t, given[0])
        elif kind == "sine":
            F_d = given[0] * np.sin(2 * np.pi * given[1] * t)
        else:
            if given[1] >= 0.5 / h:
                raise InputError(
                    f"--reference {reference}: a band of {given[1]:g} Hz is not below "
                    f"half the sampling rate, {0.5 / h:g} Hz; give less"
                )
            F_d = inputs.band_noise(rng, n, h, *given)
    if path_log is not None:
        path = log_path(path_log, spec, longest(path_log))
    else:
        kind, given = _words(motion, MOTIONS, "--motion")
        if kind == "wander":
            path = inputs.wander(rng, given[0])
        elif kind == "to-and-fro":
            path = inputs.to_and_fro(*given)
        else:
            path = hold(given[0])
    line = spec.line
    scenario = make_scenario(F_d, path, h, line["P_s"], line["P_r"], seed)
    x = np.asarray(scenario.environment.x)
    low, high = float(x.min()), float(x.max())
    x_1, x_2 = (float(c) for c in loop.rig.chambers.lengths(jnp.array(0.0)))
    if high >= x_1 or low <= -x_2:
        raise InputError(
            f"--motion {motion}: x from {1e3 * low:.4g} to {1e3 * high:.4g} mm is "
            f"beyond the chambers' ends at {-1e3 * x_2:.4g} and {1e3 * x_1:.4g} mm; "
            "give less"
        )
    return scenario


def rerun(
    spec: RigFile, loop: Loop, log: Log, most: float
) -> tuple[Scenario | None, Loop]:
    """The course of a measured run, and the loop begun where the run began.

    Args:
        spec: the rig.
        loop: the loop that will run it.
        log: with F_d and motion; its supply is taken where it has one.
        most: s, of which no more is taken.

    Returns:
        None for a course of less than two seconds without a gap or a missing F_d.
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


def _log(word: str, kinds: Mapping[str, object], spec: RigFile) -> Log | None:
    """The log that a word names, if it names one."""
    if word.partition(":")[0] in kinds:
        return None
    if word.lower().endswith((*KINDS, ".mcap")) or Path(word).exists():
        return Log.load(word, spec.channels)
    near = get_close_matches(word.partition(":")[0], kinds, n=1, cutoff=0.5)
    mend = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(kinds)}"
    raise InputError(f"{word!r} is neither a log's path nor a kind; {mend}")


def _words(
    text: str, kinds: Mapping[str, tuple[tuple[str, float], ...]], option: str
) -> tuple[str, list[float]]:
    """`kind:quantity,…` as the kind and its numbers in SI."""
    kind, _, rest = text.partition(":")
    given = [part for part in rest.split(",") if part.strip()]
    wants = kinds[kind]
    if len(given) > len(wants):
        example = ",".join(f"{value:g} {unit}" for unit, value in wants)
        raise InputError(f"{option} {text!r} gives too much; write {kind}:{example}")
    values = [value for _, value in wants]
    for i, (word, (unit, _)) in enumerate(zip(given, wants, strict=False)):
        values[i] = units.quantity(word, unit, f"{option} {kind}")
        if kind != "locked" and values[i] <= 0:
            raise InputError(f"{option} {kind}: {word!r} must be above 0; mend it")
    return kind, values


def longest(log: Log) -> tuple[int, int]:
    """The longest stretch of a log without a gap."""
    return max(log.segments, key=lambda rows: rows[1] - rows[0])


def _span(log: Log) -> tuple[float, float]:
    start, stop = longest(log)
    return float(log.time[start]), float(log.time[stop - 1])


def log_path(log: Log, spec: RigFile, rows: tuple[int, int]) -> simulation.Path:
    """The motion of a stretch of a log, from its first row on."""
    t, x = log.time[slice(*rows)], position(log, spec)[slice(*rows)]
    spline = interpolate.make_interp_spline(t, x, k=5)

    def path(at: np.ndarray, nu: int) -> np.ndarray:
        # Held at its ends: a spline runs off beyond them.
        return spline(np.clip(t[0] + at, t[0], t[-1]), nu)

    return path


def place_column(x: np.ndarray, spec: RigFile) -> tuple[str, str, np.ndarray]:
    """Name, unit and values of the position [n] (m) as this rig logs it."""
    radius = spec.geometry.get("radius")
    if radius:
        return "psi", "rad", x / radius
    return "x", "m", x + spec.geometry.get("x_mid", 0.0)


def scenario_columns(
    t: np.ndarray, F_d: np.ndarray, x: np.ndarray, spec: RigFile
) -> dict[str, tuple[str, np.ndarray]]:
    """A course as a log that `read_course` takes; [n] each, s, N, m."""
    name, unit, place = place_column(x, spec)
    return {"time": ("s", t), name: (unit, place), "F_d": ("N", F_d)}


def columns(run: Run, spec: RigFile) -> dict[str, tuple[str, np.ndarray]]:
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


def write_log(path: Path, table: Mapping[str, tuple[str, np.ndarray]]) -> None:
    """Write a log, whole or not at all.

    Args:
        path: its name's ending says what it is: one of `KINDS`.
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
    """Refuse a name that says no kind of log."""
    if not path.name.lower().endswith(KINDS):
        raise InputError(
            f"{path}: not a kind of log; call it .csv, .csv.gz, .parquet or .mat"
        )
