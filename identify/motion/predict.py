"""The motion that a rig predicts: its errors over runs, and a fit to these."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from hydrojax.errors import InputError
from hydrojax.identify.case import Case
from hydrojax.identify.estimation.known import Free
from hydrojax.identify.motion.course import SIGNALS, Course, course_of
from hydrojax.identify.motion.linear import arx_errors
from hydrojax.identify.motion.mover import Mover, mover_of, rms, runs_through
from hydrojax.identify.motion.refine import costs_of, refined, searched
from hydrojax.identify.preparation.noise import estimate_noise
from hydrojax.identify.results.outcome import (
    ChannelErrors,
    Horizon,
    MotionValue,
    PredictedMotion,
    Series,
)
from hydrojax.logs.log import Log
from hydrojax.parameters import parameter_specs
from hydrojax.rigfile.edit import rewrite
from hydrojax.rigfile.recording import longest, position
from hydrojax.rigfile.schema import RigFile
from hydrojax.units import with_command


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
    mover = mover_of(case, found, added)
    if mover is None:
        return None
    progress("predict the motion")
    fit = course_of(case, case.fit_logs, mover.parts)
    every = {**free, **of_load}
    every = {n: f for n, f in every.items() if n in mover.model.names}
    starts = searched(mover, found, every, fit) if of_load else [found]
    best = refined(mover, starts, every, fit)[0]
    # Stiffer oil or a lighter load than it began with needs a finer tick.
    finer = mover_of(case, best, added)
    if finer is not None and finer.parts > mover.parts:
        (was,) = costs_of(mover, [best], fit, fit.settling)
        mover, fit = finer, course_of(case, case.fit_logs, finer.parts)
        (now,) = costs_of(mover, [best], fit, fit.settling)
        if now > (1 + case.criteria.matters) * was:
            best = refined(mover, [best], every, fit)[0]
    check = course_of(case, case.check_logs, mover.parts)
    ends = {"windows": found, "runs": best}
    costs = costs_of(mover, list(ends.values()), check, check.settling)
    chosen = tuple(ends)[int(np.argmin(costs))]
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
    mover: Mover,
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


def _whole(
    mover: Mover, values: Mapping[str, float], course: Course
) -> dict[str, float]:
    """RMS errors in runs through whole logs by signal, SI; NaN if not finite."""
    fresh = np.asarray(course.settling)[None]
    off = mover.run(values, course, fresh)[0][np.asarray(course.there) > 0]
    return {name: rms(off[:, i]) for name, i in _seen(course).items()}


def _seen(course: Course) -> dict[str, int]:
    """The signals that were measured, and their places."""
    measured = np.asarray(course.measured)
    return {
        name: i for i, name in enumerate(SIGNALS) if np.isfinite(measured[..., i]).any()
    }


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _channels(
    case: Case,
    mover: Mover,
    ends: tuple[Mapping[str, float], Mapping[str, float]],
    fit: Course,
    course: Course,
) -> dict[str, ChannelErrors]:
    """Errors by signal and length of the run, with the values `ends`; an ARX model from
    the drive beside them.
    """
    fresh = runs_through(course)
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
            before, after = (_finite(rms(run[k, ..., i][there])) for run in runs)
            horizons[name] = Horizon(
                before, after, rms(held[there]), _finite(float(linear[k]))
            )
        first = next(iter(horizons.values()))
        out[signal] = ChannelErrors(
            SIGNALS[signal],
            float(np.median([_noise(case, log, signal) for log in case.fit_logs])),
            float("nan") if first.before is None else first.before,
            float("nan") if first.after is None else first.after,
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
    mover: Mover,
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
