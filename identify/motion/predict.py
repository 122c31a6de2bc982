"""The motion that a rig predicts: its errors over runs, and a fit to these."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from hydrojax.errors import InputError
from hydrojax.identify.case import Case
from hydrojax.identify.estimation.known import Free
from hydrojax.identify.motion.course import SIGNALS, Course, course_of, parts_of
from hydrojax.identify.motion.follow import ParametricMover, fit_follow, run_follow
from hydrojax.identify.motion.linear import arx_errors
from hydrojax.identify.preparation.noise import estimate_noise
from hydrojax.identify.results.outcome import (
    ChannelErrors,
    Horizon,
    MotionValue,
    PredictedMotion,
    Series,
)
from hydrojax.jax_setup import cores
from hydrojax.logs.log import Log
from hydrojax.parameters import parameter_specs
from hydrojax.rigfile.build import build_rig, free_load
from hydrojax.rigfile.edit import rewrite
from hydrojax.rigfile.recording import longest, position
from hydrojax.units import with_command

MASSES = ("payload_inertia.m", "load.mass")
"""The parameters that are moving masses, of the plant and of [load]."""

LENGTHS = (0.25, 1.0, 5.0)
"""Seconds of the runs beside those of whole logs."""

CALLS = 3
"""Fits of 20 steps at one length at most."""

HEAD = 2000
"""Ticks of each log on which starts are ranked: time against information."""

REFINED = 2
"""Of these, the best that are fitted to whole logs."""

START_SPREAD = 0.7
"""Standard deviation of the logarithm of a start about the rig file's: what a user
knows of a mass that bends is its order of magnitude."""


@dataclass(frozen=True)
class _Mover:
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


def check_drive(case: Case) -> None:
    """Refuse to predict a motion that nothing in the logs drives; before a fit begins.

    Raises:
        InputError: the rig file asks for it, and the logs have neither u nor P.
    """
    if case.spec.predicts and case.fit.driven_by == "pressures":
        raise InputError(
            f"{case.spec.path}: [load] predicts needs a drive: give u in the logs, or "
            "the net drive force P"
        )


def predict_motion(
    case: Case,
    declared: Mapping[str, float],
    found: Mapping[str, float],
    free: Mapping[str, Free],
    added: Sequence[str],
    progress: Callable[[str], None] = lambda _: None,
) -> PredictedMotion | None:
    """Errors of the position where the rig's drive moves its load, and the values that
    are best for whole logs; None where the rig file does not ask for it, or nothing has
    a mass.

    Args:
        case: the rig and its logs.
        declared: values of the declared model by name, SI.
        found: those that were found from pressures and force.
        free: what may be moved, by name.
        added: effects that were found, which the rig file lacks.
        progress: is told what is being done.
    """
    if not case.spec.predicts:
        return None
    of_load = free_of_load(case.spec)
    found = dict(found) | {name: f.start for name, f in of_load.items()}
    mover = _mover(case, found, added)
    if mover is None:
        return None
    progress("predict the motion")
    fit = course_of(case, case.fit_logs, mover.parts)
    check = course_of(case, case.check_logs, mover.parts)
    every = {n: f for n, f in (free | of_load).items() if n in mover.model.names}
    starts = [found]
    if of_load:
        starts += _starts(found, every, case.criteria.motion_starts)
        starts = _refined(mover, starts, every, fit.head(HEAD))[:REFINED]
    ends = {"windows": found, "runs": _refined(mover, starts, every, fit)[0]}
    chosen = tuple(ends)[int(np.argmin(_costs(mover, list(ends.values()), check)))]
    judged, logs = check, case.check_logs
    if case.test_logs:
        judged, logs = course_of(case, case.test_logs, mover.parts), case.test_logs
    pair = (declared, ends[chosen])
    whole = _whole(mover, found, judged)
    moved = {n: float(ends[chosen][n]) for n in every}
    return PredictedMotion(
        _channels(case, mover, pair, fit, judged),
        {name: _finite(error) for name, error in whole.items()},
        chosen,
        _shown(mover, moved, found, case.spec.command_unit),
        _series(mover, pair, judged, [log.name for log in logs]),
        rewrite(case.spec, dict(found) | moved, added),
    )


def free_of_load(spec: RigFile) -> dict[str, Free]:
    """What a rig file leaves to be found of the load that moves."""
    return {
        f"load.{name}": Free(spec.output_load[name], *ends)
        for name, ends in spec.load_ranges.items()
    }


def _shown(
    mover: _Mover,
    moved: Mapping[str, float],
    found: Mapping[str, float],
    command_unit: str,
) -> dict[str, MotionValue]:
    """Values as reports show them: by the outside name of those that have one."""
    specs, out = parameter_specs(mover.model.tree), {}
    for name, value in moved.items():
        spec, own, shown = specs[name], (value, float(found[name])), name
        unit = spec.unit
        if spec.outside:
            owner = name.rpartition(".")[0]
            shown = f"{owner}.{spec.outside[0]}" if owner else spec.outside[0]
            own = (_inverse(own[0]), _inverse(own[1]))
            unit = spec.outside[1]
        out[shown] = MotionValue(*own, with_command(unit, command_unit))
    return out


def _inverse(value: float) -> float:
    return 1 / value if value else float("inf")


def _mover(
    case: Case, found: Mapping[str, float], added: Sequence[str]
) -> _Mover | None:
    """The rig that moves its load; None where it has no mass."""
    model = ParametricMover.of(build_rig(case.spec, added), free_load(case.spec))
    mover = _Mover(model, 1)
    if mover.mass(found) <= 0:
        return None
    moving = model.at(jnp.asarray(mover.vector(found)))
    h = float(np.median(np.concatenate([np.diff(log.time) for log in case.fit_logs])))
    return _Mover(model, parts_of(moving.rig, moving.load, mover.mass(found), h))


def _starts(
    found: Mapping[str, float], free: Mapping[str, Free], count: int, seed: int = 0
) -> list[dict[str, float]]:
    """Starts of a load of which no window tells anything, and of all that was found
    without it: the rig file's, and `count` about them, most within a factor of 2.
    """
    rng = np.random.default_rng(seed)
    spread = np.exp(START_SPREAD * rng.standard_normal((count, len(free))))
    spread = np.concatenate([np.ones((1, len(free))), spread])
    return [
        dict(found)
        | {
            name: float(np.clip(f.start * factor, f.lower, f.upper))
            for (name, f), factor in zip(free.items(), row, strict=True)
        }
        for row in spread
    ]


def _refined(
    mover: _Mover,
    starts: Sequence[Mapping[str, float]],
    free: Mapping[str, Free],
    course: Course,
) -> list[dict[str, float]]:
    """The starts and the values found from them for runs through the course, the best
    first.

    From every start they are found in two ways: at once, and through shorter runs. A
    long run has many minima where an oscillation slips by a period; a short one is
    mostly what it begins with, which is measured.
    """
    if not free:
        return [dict(start) for start in starts]
    every = _fresh(course)
    moved = _Moved.of(mover, free, course)

    def ends(start: Mapping[str, float]) -> list[dict[str, float]]:
        steps = dict(start)
        for fresh in every.values():
            steps = moved.fitted(steps, fresh)
        return [steps, moved.fitted(start, every["free"])]

    with ThreadPoolExecutor(cores()) as pool:
        found = [end for pair in pool.map(ends, starts) for end in pair]
    tried = [*(dict(start) for start in starts), *found]
    costs = _costs(mover, tried, course)
    return [tried[i] for i in np.argsort(costs, kind="stable")]


def _costs(
    mover: _Mover, tried: Sequence[Mapping[str, float]], course: Course
) -> Float[np.ndarray, "tried"]:
    """Errors through whole logs with several values, of all signals together, each over
    how much it varies; inf where a run does not stay finite.
    """
    fresh = np.asarray(course.settling)[None]
    there = np.asarray(course.there) > 0
    size = _sizes(course)
    seen = np.isfinite(size)
    off = (mover.run(values, course, fresh)[0][there] for values in tried)
    costs = [_rms(o[:, seen] / size[seen]) for o in off]
    return np.nan_to_num(costs, nan=np.inf)


@dataclass(frozen=True)
class _Moved:
    """What is moved in a fit, in which directions, and what it is fitted to."""

    mover: _Mover
    free: Mapping[str, Free]
    index: np.ndarray
    scale: np.ndarray
    course: Course

    @classmethod
    def of(cls, mover: _Mover, free: Mapping[str, Free], course: Course) -> _Moved:
        """That of the parameters `free`."""
        index = np.array([mover.model.names.index(n) for n in free])
        return cls(mover, free, index, np.asarray(mover.model.scale)[index], course)

    def fitted(
        self, values: Mapping[str, float], fresh: Bool[np.ndarray, "runs n"]
    ) -> dict[str, float]:
        """The best values for runs that begin where ticks are `fresh`."""
        directions = np.zeros((len(self.free), len(self.mover.model.names)))
        directions[np.arange(len(self.free)), self.index] = self.scale
        values = dict(values)
        for _ in range(CALLS):
            at = self.mover.vector(values)
            own = at[self.index]
            lower = np.array([f.lower for f in self.free.values()])
            upper = np.array([f.upper for f in self.free.values()])
            fit = fit_follow(
                self.mover.model,
                jnp.asarray(at),
                jnp.asarray(directions),
                self.course,
                jnp.asarray(fresh),
                jnp.asarray(_sizes(self.course)),
                (
                    jnp.asarray((lower - own) / self.scale),
                    jnp.asarray((upper - own) / self.scale),
                ),
            )
            moved = own + np.asarray(fit.at) * self.scale
            if not np.isfinite(moved).all():
                break
            values |= zip(self.free, np.clip(moved, lower, upper).tolist(), strict=True)
            if bool(fit.converged):
                break
        return values


def _sizes(course: Course) -> Float[np.ndarray, "4"]:
    """What errors are counted in, SI: how much a signal varies; inf where it was not
    measured. Not its noise: what a model of a machine leaves is mostly not that.
    """
    there = np.asarray(course.there) > 0
    spread = np.std(np.asarray(course.measured)[there], axis=0)
    return np.where(np.isfinite(spread) & (spread > 0), spread, np.inf)


def _whole(
    mover: _Mover, values: Mapping[str, float], course: Course
) -> dict[str, float]:
    """RMS errors in runs through whole logs by signal, SI; NaN if not finite."""
    fresh = np.asarray(course.settling)[None]
    off = mover.run(values, course, fresh)[0][np.asarray(course.there) > 0]
    return {name: _rms(off[:, i]) for name, i in _seen(course).items()}


def _seen(course: Course) -> dict[str, int]:
    """The signals that were measured, and their places."""
    there = np.isfinite(np.asarray(course.measured)).any(axis=(0, 1))
    return {name: i for i, name in enumerate(SIGNALS) if there[i]}


def _rms(off: np.ndarray) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        size = float(np.sqrt(np.mean(off**2)))
    return size if np.isfinite(size) else float("nan")


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _fresh(course: Course) -> dict[str, Bool[np.ndarray, "runs n"]]:
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


def _channels(
    case: Case,
    mover: _Mover,
    ends: tuple[Mapping[str, float], Mapping[str, float]],
    fit: Course,
    course: Course,
) -> dict[str, ChannelErrors]:
    """Errors by signal and length of the run, with the values `ends`; an ARX model from
    the drive beside them.
    """
    fresh = _fresh(course)
    stack = np.stack(list(fresh.values()))
    there = np.asarray(course.there) > 0
    runs = [mover.run(values, course, stack) for values in ends]
    out = {}
    for signal, i in _seen(course).items():
        y = np.asarray(course.measured)[..., i]
        linear = arx_errors(fit, course, stack, i)
        horizons = {}
        for k, (name, begins) in enumerate(fresh.items()):
            last = np.where(begins, np.arange(y.shape[1]), 0)
            since = np.maximum.accumulate(last, axis=1)
            held = y - np.take_along_axis(y, since, axis=1)
            before, after = (_finite(_rms(run[k, ..., i][there])) for run in runs)
            horizons[name] = Horizon(
                before, after, _rms(held[there]), _finite(float(linear[k]))
            )
        first = next(iter(horizons.values()))
        out[signal] = ChannelErrors(
            SIGNALS[signal],
            float(np.median([_noise(case, log, signal) for log in case.fit_logs])),
            *(float("nan") if e is None else e for e in (first.before, first.after)),
            horizons=horizons,
        )
    return out


def _noise(case: Case, log: Log, signal: str) -> float:
    """Noise of a log's signal, SI."""
    if signal in case.spec.sensors:
        return case.spec.sensors[signal]
    own = position(log, case.spec) if signal == "x" else log.signals[signal]
    return estimate_noise(own[slice(*longest(log))])


def _series(
    mover: _Mover,
    ends: tuple[Mapping[str, float], Mapping[str, float]],
    course: Course,
    names: Sequence[str],
) -> tuple[Series, ...]:
    """Measured signals and errors of the runs through whole logs, log by log."""
    fresh = np.asarray(course.settling)[None]
    runs = [-mover.run(values, course, fresh)[0] for values in ends]
    out = []
    for i, name in enumerate(names):
        own = np.asarray(course.there)[i] > 0
        measured, before, after = (
            {signal: y[i, own, k] for signal, k in _seen(course).items()}
            for y in (np.asarray(course.measured), *runs)
        )
        t = np.asarray(course.t)[i, own]
        out.append(Series(name, t, measured, before, after, {}))
    return tuple(out)
