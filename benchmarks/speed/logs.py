"""A log of the reference rig with noise of 1 %, and a rig file that starts 25 % off."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

OFF, NOISE = 0.25, 0.01
"""How far the starts are off, and the noise over each channel's deviation."""

CHANNELS = ("P_a1", "P_a2", "F")
MINUTE = 60_000
"""Samples in one period of a long log."""


def write_case(folder: str | Path, seconds: float) -> None:
    """Write `rig.toml`, `log.parquet` and `truth.npy` [16] into a folder.

    All sixteen parameters (`replays.NAMES`) have ranges and start `OFF` above or below
    the truth. The spool is known, and there is no compute delay. Logs over a minute
    repeat one minute after a gap, with noise of their own.
    """
    import equinox as eqx

    from hydrojax.control import simulation
    from hydrojax.parameters import get
    from hydrojax.rigfile import recording
    from hydrojax.rigfile.build import build_loop
    from hydrojax.rigfile.scenarios import rig_scenario
    from hydrojax.rigfile.schema import RigFile

    from .replays import NAMES

    file = resources.files("hydrojax") / "paper" / "reference.toml"
    text = re.sub(r"\n\[effects.valve_delay\].*?(?=\n\[)", "", file.read_text("utf-8"),
                  flags=re.S)  # fmt: skip
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    rig = folder / "rig.toml"
    rig.write_text(text, encoding="utf-8")
    spec = RigFile.load(rig)
    loop = build_loop(spec)
    truth = np.asarray(get(loop.rig, NAMES))
    still = [loop.sensors.P_a1, loop.sensors.P_a2, loop.sensors.P_s, loop.sensors.F]
    loop = eqx.tree_at(
        lambda o: [o.sensors.P_a1, o.sensors.P_a2, o.sensors.P_s, o.sensors.F],
        loop, [0.1 * s for s in still],
    )  # fmt: skip
    samples = round(seconds / float(loop.h))
    scenario = rig_scenario(spec, loop, seconds=min(samples, MINUTE) * 1e-3)
    run = simulation.simulate_loop(loop, scenario)
    columns = _columns(run, spec, samples)
    noise = {n: NOISE * float(np.std(run[f"true_{n}"])) for n in CHANNELS}
    rng = np.random.default_rng(5)
    for name, size in noise.items():
        unit, y = columns[name]
        columns[name] = (unit, y + size * rng.normal(size=samples))
    recording.write_log(folder / "log.parquet", columns)
    rig.write_text("\n".join(_declared(text, truth, noise)), encoding="utf-8")
    np.save(folder / "truth.npy", truth)


def _columns(run: Any, spec: Any, samples: int) -> dict[str, tuple[str, np.ndarray]]:
    """The log's columns without noise: as many samples as are asked for."""
    from hydrojax.rigfile.recording import place_column

    at = np.arange(samples)

    def along(y: np.ndarray) -> np.ndarray:
        return y[at % y.size]

    # A gap of a second before each repetition: no window then runs across a jump.
    t = 1e-3 * (at + at // MINUTE * 1000)
    name, unit, place = place_column(run["true_x"], spec)
    out = {
        "time": ("s", t),
        "u": (spec.command_unit, along(run["u"])),
        name: (unit, along(place)),
    }
    for channel in CHANNELS:
        unit = "N" if channel == "F" else "Pa"
        out[channel] = (unit, along(run[f"true_{channel}"]))
    return out


def _declared(text: str, truth: np.ndarray, noise: dict[str, float]) -> Iterator[str]:
    """The rig file's lines with ranges, starts that are off, and the noise."""
    from .replays import NAMES

    signs = np.random.default_rng(7).choice([-1.0, 1.0], truth.size)
    starts = dict(zip(NAMES, truth * (1 + OFF * signs), strict=True))
    within = ""
    for line in text.splitlines():
        within = line.strip() if line.startswith("[") else within
        found = re.match(r'^(\w+) = "\S+( .*)?"$', line)
        name, unit = (found[1], (found[2] or "").strip()) if found else ("", "")
        if within == "[sensors]" and found:
            if name in noise:
                yield f'{name} = "{noise[name]:.6g} {"N" if name == "F" else "Pa"}"'
        elif within == "[parameters]" and name in starts:
            yield f"{name} = {_range(starts[name], unit)}"
        else:
            yield line


SI = {"mm": 1e-3, "kN": 1e3, "kN*s/m": 1e3, "um": 1e-6}


def _range(start: float, unit: str) -> str:
    """A start and a wide range of one sign, in the file's own unit."""
    size = start / SI.get(unit, 1.0)
    first, low, high = (f'"{f"{f * size:.8g} {unit}".strip()}"' for f in (1.0, 0.1, 6))
    return f"{{ start = {first}, range = [{low}, {high}] }}"


@cache
def opened(folder: str) -> Any:
    """The case of a folder, as `identify` opens it."""
    from hydrojax.identify.case import open_case

    return open_case(f"{folder}/rig.toml", [f"{folder}/log.parquet"])


@cache
def problem(folder: str) -> Any:
    """Its problem: the declared model with its free parameters, and the windows.

    If the folder has `P_0.npy` [W, 2], the windows start there.
    """
    import jax.numpy as jnp

    from hydrojax.identify.estimation.known import free_parameters
    from hydrojax.identify.estimation.problem import Problem
    from hydrojax.rigfile.build import build_rig

    case = opened(folder)
    rig = build_rig(case.spec)
    made = Problem.of(rig, free_parameters(case.spec), case.fit)
    starts = Path(folder) / "P_0.npy"
    if not starts.exists():
        return made
    return replace(made, batch=made.batch._replace(P_0=jnp.asarray(np.load(starts))))


def replayed(folder: str) -> tuple[Any, np.ndarray]:
    """The case as the replay's peers take it, and the sixteen starts [16], SI."""
    from .replays import NAMES, Replay

    made = problem(folder)
    b, values = made.batch, made.initial_values()
    start = np.array([values[made.model.names.index(n)] for n in NAMES])
    return Replay(made.model.rig, b.motion, b.windows, np.asarray(b.P_0)), start


def predict(rig: Any, batch: Any) -> Any:
    """What the sensors would read, [W, T, 3], from a batch's initial pressures."""
    from hydrojax.plant.replay import friction_memory, pressures, readings

    w = batch.windows
    past = friction_memory(rig, batch.motion).within(w)
    return readings(rig, w, *pressures(rig, batch.motion, w, batch.P_0), past)
