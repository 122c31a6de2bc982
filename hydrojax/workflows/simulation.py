"""A closed-loop run of a rig: objects in, a `Simulation` out."""

from __future__ import annotations

import html
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from jaxtyping import Float

from hydrojax.control.loop import Loop
from hydrojax.control.simulation import Run, simulate_loop
from hydrojax.errors import InputError
from hydrojax.jax_setup import ensure_jax
from hydrojax.logs.log import Log
from hydrojax.plant.effect import Effect
from hydrojax.rigfile import recording
from hydrojax.rigfile.build import build_loop, build_rig
from hydrojax.rigfile.scenarios import MotionLike, ReferenceLike, rig_scenario
from hydrojax.rigfile.schema import RigFile

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_UNITS = {
    "u": "V", "x": "m", "P_a1": "Pa", "P_a2": "Pa", "P_s": "Pa", "F": "N", "F_d": "N",
    "true_x": "m", "true_v": "m/s", "true_P_a1": "Pa", "true_P_a2": "Pa", "true_F": "N",
}  # fmt: skip


@dataclass(frozen=True, repr=False)
class Simulation:
    """A closed-loop run; `run["F"]` is a signal by name, [samples], SI.

    Attributes:
        run: the signals, and how often a pressure or the piston left its range.
        file: the rig.
        loop: what was run: plant, controller, load and sensors.
    """

    run: Run
    file: RigFile
    loop: Loop

    @property
    def t(self) -> Float[np.ndarray, "samples"]:
        """Time, s."""
        return self.run.t

    def __getitem__(self, name: str) -> Float[np.ndarray, "samples"]:
        if name == "F_d":
            return self.run.F_d
        return self.run[name]

    @property
    def rms_error(self) -> float:
        """RMS of F_d - F after the first quarter, of the true output force, N."""
        later = self.t >= self.t[-1] / 4
        off = (self.run.F_d - self.run["true_F"])[later]
        return float(np.sqrt(np.mean(off**2)))

    @property
    def saturated(self) -> float:
        """Share of the samples in which the command is at its limit."""
        full = 0.999 * float(self.loop.law.u_max)
        return float(np.mean(np.abs(self.run["u"]) >= full))

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know before the run is used, a line each."""
        still = noiseless = ""
        if not np.ptp(self.run["x"]):
            still = (
                "the position does not move: identify and trace do not take such a log"
            )
        if not {"P_a1", "P_a2", "F"} & set(self.file.sensors):
            noiseless = (
                "the rig file gives no noise under [sensors], so the log has none: "
                "identify and trace will take every small misfit for real"
            )
        return tuple(line for line in (self.run.warning(), still, noiseless) if line)

    def summary(self) -> str:
        """Length, error and saturation as text, and the notes."""
        head = f"{self.file.name}: {self.t.size} samples in {self._seconds:g} s"
        lines = [
            head,
            f"F_d - F {self.rms_error:.3g} N RMS after the first quarter",
            f"command saturated in {100 * self.saturated:.1f} % of the samples",
            *(f"note: {line}" for line in self.notes),
        ]
        return "\n".join(lines) + "\n"

    def to_frame(self) -> pd.DataFrame:
        """Every signal over `time` (s), SI: the readings, the truth behind them
        (`true_...`), F_d, and what the controller records.

        The units of all but the controller's signals are in `attrs["units"]`.
        """
        units = _UNITS | {"u": self.file.command_unit}
        signals = {**self.run.signals, "F_d": self.run.F_d}
        order = [name for name in units if name in signals]
        order += [name for name in signals if name not in units]
        left_out = self.file.layout.unmeasured
        shown = {name: signals[name] for name in order if name not in left_out}
        frame = pd.DataFrame(shown, index=pd.Index(self.t, name="time"))
        units = {"time": "s"} | {n: u for n, u in units.items() if n in shown}
        frame.attrs["units"] = units
        return frame

    def to_log(self) -> Log:
        """The log that the rig would have written: its channels, in the logs' units.

        Raises:
            InputError: the run is shorter than a log may be, or a signal does not move.
        """
        table = recording.log_columns(self.run, self.file)
        frame = pd.DataFrame({name: values for name, (_, values) in table.items()})
        units = {name: unit for name, (unit, _) in table.items()}
        return Log.from_frame(frame, units, name="simulation")

    def save(self, path: str | Path) -> None:
        """Write the log: .csv, .csv.gz, .parquet or .mat.

        Raises:
            InputError: another ending.
            OSError: it cannot be written.
        """
        recording.write_log(Path(path), recording.log_columns(self.run, self.file))

    def plot(self) -> Figure:
        """Forces, pressures, command and position over time."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(8.0, 7.0), layout="constrained")
        force, pressure, command, place = figure.subplots(4, 1, sharex=True)
        force.plot(self.t, self["F"] / 1e3, lw=0.8, label="$F$")
        force.plot(self.t, self["F_d"] / 1e3, "k--", lw=1.0, label="$F_d$")
        for name, label in (
            ("P_a1", "$P_{a1}$"), ("P_a2", "$P_{a2}$"), ("P_s", "$P_s$"),
        ):  # fmt: skip
            if name not in self.file.layout.unmeasured:
                pressure.plot(self.t, self[name] / 1e6, lw=0.8, label=label)
        command.plot(self.t, self["u"], lw=0.8)
        place.plot(self.t, 1e3 * self["x"], lw=1.0)
        unit = "V" if self.file.command_unit == "V" else "-"
        for ax, label in zip(
            (force, pressure, command, place),
            ("force (kN)", "pressure (MPa)", f"command ({unit})", "position (mm)"),
            strict=True,
        ):
            ax.set_ylabel(label)
            ax.grid(alpha=0.3)
        force.legend(loc="upper right", ncols=2, fontsize=9)
        pressure.legend(loc="upper right", ncols=3, fontsize=9)
        place.set_xlabel("time (s)")
        return figure

    @property
    def _seconds(self) -> float:
        return self.t.size * float(self.loop.h)

    def __repr__(self) -> str:
        return (
            f"<simulation of {self.file.name!r}: {self._seconds:g} s, "
            f"F_d - F {self.rms_error:.3g} N RMS>"
        )

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return f"<pre>{html.escape(self.summary())}</pre>"


def simulate(
    rig: RigFile | str | Path,
    *,
    reference: ReferenceLike | None = None,
    motion: MotionLike | None = None,
    seconds: float = 12.0,
    seed: int = 0,
    gains: Mapping[str, object] | None = None,
    effects: Sequence[Effect] = (),
    out: str | Path | None = None,
) -> Simulation:
    """Run a rig in closed loop.

    Args:
        rig: a rig file, or its path.
        reference: the desired force: `sine`, `sines`, `noise`, its values at every
            control period (N), or a log with F_d; `sines()` if there is none.
        motion: of the piston, or of what its load is held by: `to_and_fro`, `wander`,
            `locked`, or a log; `wander()` if there is none.
        seconds: length of the run; a log or an array shortens it to its own.
        seed: of the sensors' noise and of what is random in reference and motion.
        gains: keys of [controller] that replace the file's.
        effects: instances of effects, with their strengths, beside those of the file:
            also of classes that are not registered.
        out: a file for the log; see `Simulation.save`.

    Warns:
        RuntimeWarning: a pressure leaves (P_r, P_s), or the piston the chambers.

    Raises:
        InputError: an invalid rig, reference, motion, gain or effect, or a run that
            diverges.
        RuntimeError: see `hydrojax.jax_setup.ensure_jax`.
    """
    ensure_jax()
    if out is not None:
        recording.check_kind(Path(out))
    file = rig if isinstance(rig, RigFile) else RigFile.load(rig)
    plant = build_rig(file, added=effects)
    loop = build_loop(file, plant, gains)
    scenario = rig_scenario(file, loop, reference, motion, seconds, seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # given below, in one line
        run = simulate_loop(loop, scenario)
    if run.diverged:
        raise InputError(f"{file.path}: {run.warning()}")
    if run.warning():
        warnings.warn(run.warning(), RuntimeWarning, stacklevel=2)
    made = Simulation(run, file, loop)
    if out is not None:
        made.save(out)
    return made
