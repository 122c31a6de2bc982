"""Scenarios of closed-loop runs: from references and motions, or from logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hydrojax.control.inputs import (
    AbstractMotion,
    AbstractReference,
    Samples,
    sines,
    wander,
)
from hydrojax.control.loop import Loop, Scenario
from hydrojax.control.simulation import Trajectory, make_scenario
from hydrojax.errors import SAMPLES, InputError
from hydrojax.logs.log import Log
from hydrojax.rigfile.recording import duration, log_path, longest
from hydrojax.rigfile.schema import RigFile

_Values: TypeAlias = Float[np.ndarray, "samples"] | Sequence[float]

ReferenceLike: TypeAlias = AbstractReference | _Values | Log | str | Path
"""A reference, its values at every control period (N), a log with F_d or its path."""

MotionLike: TypeAlias = AbstractMotion | Log | str | Path
"""A motion, or a log with one or its path."""


@dataclass(frozen=True, eq=False)
class LoggedForce(AbstractReference):
    """The desired force of a log, over its longest segment.

    Raises:
        InputError: the log has no F_d there, or one with missing values.
    """

    log: Log

    def __post_init__(self) -> None:
        if "F_d" not in self.log.signals:
            raise InputError(
                f"{self.log.name}: no column F_d to follow; give a log that has one, "
                "or another reference"
            )
        if np.isnan(self.log.signals["F_d"][slice(*longest(self.log))]).any():
            raise InputError(
                f"{self.log.name}: F_d has missing values in the log's longest "
                "segment; fill them, or cut the log there"
            )

    def force(
        self, n: int, h: float, rng: np.random.Generator
    ) -> Float[np.ndarray, "n"]:
        """F_d at n samples, interpolated linearly, N."""
        rows = slice(*longest(self.log))
        t = self.log.time[rows]
        return np.interp(t[0] + np.arange(n) * h, t, self.log.signals["F_d"][rows])

    def seconds(self, h: float) -> float:
        """The length of the log's longest segment, s."""
        return duration(self.log)


@dataclass(frozen=True, eq=False)
class LoggedMotion(AbstractMotion):
    """The motion of a log, over its longest segment.

    Attributes:
        log: with a column x or psi.
        file: the rig that was logged.
    """

    log: Log
    file: RigFile

    def path(self, rng: np.random.Generator) -> Trajectory:
        """A quintic spline through the positions.

        Raises:
            InputError: the log has no motion, or an angle and the rig no radius.
        """
        return log_path(self.log, self.file, longest(self.log))

    def seconds(self, h: float) -> float:
        """The length of the log's longest segment, s."""
        return duration(self.log)


def rig_scenario(
    file: RigFile,
    loop: Loop,
    reference: ReferenceLike | None = None,
    motion: MotionLike | None = None,
    seconds: float = 12.0,
    seed: int = 0,
) -> Scenario:
    """The scenario of a rig's closed-loop run, under the supply of its file.

    Args:
        file: the rig.
        loop: the loop that will run it.
        reference: the desired force; `inputs.sines()` if there is none.
        motion: of the piston, or of what its load is held by; `inputs.wander()` if
            there is none.
        seconds: length; a log or an array shortens it to its own.
        seed: of the sensors' noise and of what is random in reference and motion.

    Raises:
        InputError: an invalid reference, motion or length, or a motion beyond the ends
            of the chambers.
    """
    force = as_reference(sines() if reference is None else reference, file)
    moved = as_motion(wander() if motion is None else motion, file)
    h = float(loop.h)
    seconds = min(seconds, force.seconds(h), moved.seconds(h))
    if not 0.05 <= seconds <= 1e5:
        raise InputError(f"seconds: invalid length {seconds:g}: expected 0.05 to 1e5")
    if seconds / h > SAMPLES:
        raise InputError(
            f"seconds: {seconds:g} s of {1 / h:g} samples a second are more than "
            f"{SAMPLES}; shorten the run, or lower the rate"
        )
    rng = np.random.default_rng([seed, 1])
    F_d = force.force(round(seconds / h), h, rng)
    P_s, P_r = file.line["P_s"], file.line["P_r"]
    scenario = make_scenario(F_d, moved.path(rng), h, P_s, P_r, seed)
    _check_travel(loop, np.asarray(scenario.environment.x))
    return scenario


def _check_travel(loop: Loop, x: Float[np.ndarray, "..."]) -> None:
    """Refuse positions, m, beyond the ends of the chambers."""
    low, high = float(x.min()), float(x.max())
    x_1, x_2 = (float(c) for c in loop.rig.chambers.lengths(jnp.array(0.0)))
    if high >= x_1 or low <= -x_2:
        raise InputError(
            f"motion: x from {1e3 * low:.4g} to {1e3 * high:.4g} mm is beyond the "
            f"chambers' ends at {-1e3 * x_2:.4g} and {1e3 * x_1:.4g} mm; reduce it"
        )


def as_reference(given: ReferenceLike, file: RigFile) -> AbstractReference:
    """A reference from whatever may be given for one.

    Raises:
        InputError: no such log, or a log or an array that cannot be followed.
    """
    if isinstance(given, AbstractReference):
        return given
    if isinstance(given, (str, Path)):
        given = _load(given, file, 'hydrojax.sine("300 N", "0.5 Hz")')
    if isinstance(given, Log):
        return LoggedForce(given)
    try:
        values = np.asarray(given, float)
    except (TypeError, ValueError) as err:
        raise InputError(
            f"reference: invalid {type(given).__name__}: expected a reference, an "
            "array, a Log or its path"
        ) from err
    return Samples(values)


def as_motion(given: MotionLike, file: RigFile) -> AbstractMotion:
    """A motion from whatever may be given for one.

    Raises:
        InputError: no such log, or something else.
    """
    if isinstance(given, AbstractMotion):
        return given
    if isinstance(given, (str, Path)):
        given = _load(given, file, 'hydrojax.to_and_fro("30 mm", "3 s")')
    if isinstance(given, Log):
        return LoggedMotion(given, file)
    raise InputError(
        f"motion: invalid {type(given).__name__}: expected a motion, a Log or its path"
    )


def _load(path: str | Path, file: RigFile, example: str) -> Log:
    """The log at a path."""
    if not Path(path).exists():
        raise InputError(
            f"{path}: no such log; give a log's path, or a value such as {example}"
        )
    return Log.load(path, file.channels)
