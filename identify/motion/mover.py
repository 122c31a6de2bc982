"""A rig that moves its load: its runs through logs, and how far they are off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from hydrojax.effects.valve import LONGEST
from hydrojax.identify.case import Case
from hydrojax.identify.motion.course import SIGNALS, Course, parts_of
from hydrojax.identify.motion.follow import ParametricMover, run_follow
from hydrojax.rigfile.build import build_rig, free_load, with_queues

MASSES = ("payload_inertia.m", "load.mass")
"""The parameters that are moving masses, of the plant and of [load]."""

LENGTHS = (0.25, 1.0, 5.0)
"""Seconds of the runs beside those of whole logs."""


@dataclass(frozen=True)
class Mover:
    """A rig that moves its load, and in how many parts a tick is run."""

    model: ParametricMover
    parts: int

    def mass(self, values: Mapping[str, float]) -> float:
        """What moves, kg."""
        own = dict(zip(self.model.names, self.vector(values), strict=True))
        return float(sum(own.get(name, 0.0) for name in MASSES))

    def vector(self, values: Mapping[str, float]) -> Float[np.ndarray, "n"]:
        """Values in the model's order."""
        own = zip(self.model.names, np.asarray(self.model.values), strict=True)
        return np.array([values.get(name, value) for name, value in own])

    def run(
        self,
        values: Mapping[str, float],
        course: Course,
        fresh: Bool[np.ndarray, "lengths runs n"],
    ) -> Float[np.ndarray, "lengths runs n 4"]:
        """Position, pressures and force less what was measured, SI; NaN where there is
        no mass to move, and of what was not measured.
        """
        if self.mass(values) <= 0:
            return np.full((*fresh.shape, len(SIGNALS)), np.nan)
        at = jnp.asarray(self.vector(values))
        seen = run_follow(self.model, at, course, jnp.asarray(fresh))
        return np.asarray(seen) - course.measured


def mover_of(
    case: Case, found: Mapping[str, float], added: Sequence[str]
) -> Mover | None:
    """The rig that moves its load; None where it has no mass."""
    h = float(np.median(np.concatenate([np.diff(log.time) for log in case.fit_logs])))
    rig = with_queues(build_rig(case.spec, added), h, LONGEST)
    model = ParametricMover.of(rig, free_load(case.spec))
    mover = Mover(model, 1)
    if mover.mass(found) <= 0:
        return None
    moving = model.at(jnp.asarray(mover.vector(found)))
    return Mover(model, parts_of(moving.rig, moving.load, mover.mass(found), h))


def runs_through(course: Course) -> dict[str, Bool[np.ndarray, "runs n"]]:
    """By length of the run: the ticks at which one begins; "free" for whole logs."""
    there, t = np.asarray(course.there) > 0, np.asarray(course.t)
    settling = np.asarray(course.settling)
    out = {}
    for length in LENGTHS:
        steps = np.floor((t - t[:, :1]) / length)
        begins = np.diff(steps, axis=1, prepend=0) > 0
        if (there & begins).sum() > len(t):
            out[f"{length:g}"] = settling | begins
    return out | {"free": settling}


def rms(off: Float[np.ndarray, "..."]) -> float:
    """Root of the mean square; NaN if not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        size = float(np.sqrt(np.mean(off**2)))
    return size if np.isfinite(size) else float("nan")
