"""How late a position or a command is, as replays have it: a balance of flow knows it
less well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from hydrojax.identify.case import Case
from hydrojax.identify.checking.factors import LATEST
from hydrojax.identify.checking.mended import Findings
from hydrojax.identify.checking.path import least
from hydrojax.identify.checking.words import (
    Finding,
    command_between,
    late_position,
    with_delay,
)
from hydrojax.identify.estimation.balance import balance_at, descend
from hydrojax.identify.estimation.columns import batch_of
from hydrojax.identify.estimation.fit import (
    FitPoint,
    fit_jointly,
    fit_pressures,
    in_short,
)
from hydrojax.identify.estimation.problem import PRESSURES, Problem
from hydrojax.identify.preparation.data import Data
from hydrojax.identify.preparation.segments import runs_on
from hydrojax.identify.preparation.strays import without_strays
from hydrojax.identify.tracing.rivals import taken_out
from hydrojax.identify.tracing.state import Tracing
from hydrojax.logs.log import Log, brought_forward
from hydrojax.logs.tables import Channel
from hydrojax.plant.places import place_of
from hydrojax.rigfile.schema import RigFile

STEP = 0.2
"""Share of a step of the logs by which the position is moved to and fro."""

MOVES = 4
"""How often it is moved on, at most."""

LATE = ("pressure_sensor_lag", "channel_skew", "loadcell_lag")
"""Effects by which a reading comes late."""

WITHIN = 0.1
"""Share of a step of the logs to which a delay is found by fits of what a trace found.
"""

SAME = 0.1
"""Moves within which the delay is what it was."""


def with_delay_replayed(
    case: Case,
    given: RigFile,
    found: Findings,
    problem: Problem,
    point: FitPoint,
    free: Sequence[str],
    progress: Callable[[str], None],
) -> Findings:
    """The findings, of which that of a late position has the delay by which the model
    that was fitted leaves least; themselves where that is the delay they have, and
    without that of a position that is not late then.

    Args:
        case: with the findings mended in it.
        given: its rig file as it was.
        found: in its inputs as they were given.
        problem: that was fitted.
        point: where that fit ended.
        free: what was free in it.
        progress: is called with a line of text.
    """
    late = next((f for f in found if f.mended and _is_late(f)), None)
    if late is None or not problem.sees_pressures:
        return found
    progress(f"find the delay of {late.input} by replays")
    step = STEP * _tick(case)

    def refitted(moved: Problem) -> np.ndarray:
        return fit_jointly(moved, point.values, free, point.weights)[1].values

    error = _Error(case, problem, refitted, late.input, point.weights)
    moves = _lowest(lambda moves: error(moves * step))
    if moves is None or abs(moves) < SAME:
        return found
    was, now = (
        spec.channels[late.input].late if late.input in spec.channels else 0.0
        for spec in (given, case.spec)
    )
    # The balances called it late (or early), and it is not.
    if (now + moves * step - was) * (now - was) <= 0:
        return tuple(f for f in found if f is not late)
    new = with_delay(late, given, case.spec, moves * step)
    return tuple(new if f is late else f for f in found)


def with_late_position(
    case: Case, found: Findings, state: Tracing, progress: Callable[[str], None]
) -> Findings:
    """The findings, with that of a position that is late, where bringing it forward
    takes most of what the model that was found leaves above the noise; else themselves.

    What a valve's path does is known by then, and a balance of flow cannot tell it from
    a late position.

    Args:
        case: with the findings mended in it.
        found: in its inputs.
        state: where the trace ended.
        progress: is called with a line of text.
    """
    problem, own, noise = state.problem, state.criteria, state.noise
    seen = np.isfinite(noise) & PRESSURES
    rms = state.check.rms(state.check.errors_at(state.point.values))
    if any(map(_is_late, found)) or not np.any((rms > own.at_noise * noise)[seen]):
        return found
    name = case.read_logs[0].motion
    progress(f"see whether {name} is late")
    tick = _tick(case)
    weights = state.fitted_noise(np.where(seen, noise, np.inf))

    def refitted(moved: Problem) -> np.ndarray:
        # As far as one delay has to be told from another.
        return fit_pressures(
            moved, state.point.values, state.free, own.enough_in_search
        )[1]

    error = _Error(case, problem, refitted, name, weights)
    given = best = error(0.0)
    late = 0.0
    while (ticks := max(2 * late, 0.5)) * tick <= LATEST:
        if (later := error(ticks * tick)) >= best:
            break
        best, late = later, ticks
    floor = np.sum(seen)
    if not late or best - floor > own.late_leaves * (given - floor):
        return found
    around = (late / 2 * tick, min(2 * late * tick, LATEST))
    return (
        *found,
        late_position(case.spec, name, least(error, around, WITHIN * tick)[0]),
    )


def with_command_between(
    case: Case,
    found: Findings,
    problem: Problem,
    point: FitPoint,
    free: Sequence[str],
    progress: Callable[[str], None],
) -> Findings:
    """The findings, with that of a command that runs on from row to row where the rig
    file holds it until the next, if that takes most of what the fit leaves above the
    noise; else themselves.

    Args:
        case: with the findings mended in it.
        found: in its inputs.
        problem: that was fitted.
        point: where that fit ended.
        free: what was free in it.
        progress: is called with a line of text.
    """
    own, noise = problem.criteria, np.asarray(problem.batch.noise)
    seen = np.isfinite(noise) & PRESSURES
    if case.fit.driven_by != "u" or runs_on(case.spec):
        return found
    rms = problem.rms(problem.errors_at(point.values))
    if not np.any((rms > own.at_noise * noise)[seen]):
        return found
    line = replace(case.preparation, spec=_running_on(case.preparation.spec))
    held, on = (p.data(case.read_logs) for p in (case.preparation, line))
    if not _balances_want(problem, point, free, held, on):
        return found
    progress("see whether u runs on between rows")
    weights, floor = np.where(seen, noise, np.inf), np.sum(seen)

    def kept(_: Problem) -> np.ndarray:
        return point.values

    def refitted(moved: Problem) -> np.ndarray:
        return fit_pressures(moved, point.values, free, own.enough_in_search)[1]

    again = _Error(case, problem, refitted, "u", weights)
    # Beside what another fit to these windows alone leaves of a held command.
    given = min(replace(again, refitted=kept).of(held), again.of(held))
    above = given > own.at_noise**2 * floor
    if above and again.of(on) - floor <= own.late_leaves * (given - floor):
        return (*found, command_between(case.spec))
    return found


def _balances_want(
    problem: Problem, point: FitPoint, free: Sequence[str], held: Data, on: Data
) -> bool:
    """Whether the flow balances, fitted a few steps on, are left with less of a command
    that runs `on` than of one that is `held`: they are fitted in a moment, and do not
    say how much of either is noise.
    """

    def left(data: Data) -> float:
        few = replace(problem, batch=batch_of(data)).brief
        evaluate = partial(balance_at, few)
        here, steps = evaluate(point.values, free), problem.criteria.far_steps
        return descend(few, evaluate, here, free, steps).left

    return left(on) < (1 - problem.criteria.matters) * left(held)


def with_late_signal(
    case: Case, found: Findings, state: Tracing, progress: Callable[[str], None]
) -> Findings:
    """The findings, with that of a command that runs on between rows, or else of a late
    position, where a trace has ended above the noise; else themselves.

    What the model lacked may have hidden the first from `with_command_between` before.
    """
    at = (state.problem, state.point, state.free, progress)
    later = with_command_between(case, found, *at)
    for ask in (with_late_position, with_early_position):
        if later is found:
            later = ask(case, found, state, progress)
    return later


def with_early_position(
    case: Case, found: Findings, state: Tracing, progress: Callable[[str], None]
) -> Findings:
    """The findings, with that of a position that is early, where that leaves no more
    than readings of the pressures and of the force which are late, both of them: one
    cause for two.

    Args:
        case: with the findings mended in it.
        found: in its inputs.
        state: where the trace ended.
        progress: is called with a line of text.
    """
    late = [a.name for a in state.added if a.name in LATE]
    if state.named.get("channel_skew.tau_s", 0.0) > 0:
        return found  # ahead of its time
    places = {place_of(state.effects[name]).name for name in late}
    if len(places) < 2 or any(map(_is_late, found)):
        return found
    name, less = case.read_logs[0].motion, state
    progress(f"see whether {name} is early")
    for gone in late:
        less = taken_out(less, gone)

    def refitted(moved: Problem) -> np.ndarray:
        return fit_jointly(moved, less.point.values, less.free, less.point.weights)[
            1
        ].values

    weights = state.fitted_noise(state.noise)
    error = _Error(case, state.problem, refitted, name, weights)
    given = replace(error, refitted=lambda _: state.point.values)(0.0)
    ends = (-min(2 * state.named["pressure_sensor_lag.tau_P"], LATEST), 0.0)
    early, left = least(error, ends, WITHIN * _tick(case))
    if left > (1 + state.criteria.matters) ** 2 * given:
        return found
    return (*found, late_position(case.spec, name, early))


def _running_on(spec: RigFile) -> RigFile:
    """The rig file with a command that runs on between rows."""
    u = spec.channels.get("u", Channel(column="u")).model_copy(update={"held": False})
    return replace(spec, channels=spec.channels | {"u": u})


def _is_late(finding: Finding) -> bool:
    return finding.finding == "delay" and finding.input != "u"


def _tick(case: Case) -> float:
    return float(np.median(np.diff(case.read_logs[0].time)))


@dataclass(frozen=True)
class _Error:
    """The squared errors, over `weights`, of a fit with a signal brought forward by so
    many seconds more; where windows are many, on some: each delay that is tried takes
    a fit.
    """

    case: Case
    problem: Problem
    refitted: Callable[[Problem], Float[np.ndarray, "n"]]
    name: str
    weights: Float[np.ndarray, "3"]

    def __call__(self, seconds: float) -> float:
        logs = [_later(log, self.name, seconds) for log in self.case.read_logs]
        return self.of(self.case.preparation.data(logs))

    def of(self, data: Data) -> float:
        """The same of logs made ready otherwise."""
        batch = batch_of(data)._replace(noise=self.problem.batch.noise)
        moved = in_short(replace(self.problem, batch=batch))
        seen = np.isfinite(self.weights)
        left = moved.rms(moved.errors_at(self.refitted(moved))) / self.weights
        return float(np.sum(left[seen] ** 2))


def _later(log: Log, name: str, seconds: float) -> Log:
    """The log, less stray readings, with a signal brought forward by some more time."""
    log = without_strays(log)
    signals, segments = brought_forward(
        log.time, log.signals, log.segments, {name: seconds}
    )
    return replace(log, signals=signals, segments=segments)


def _lowest(error: Callable[[int], float]) -> float | None:
    """Where the parabola through the least error and those beside it has its lowest
    point; None where no least one is found.
    """
    known = {i: error(i) for i in (-1, 0, 1)}
    for _ in range(MOVES):
        lowest = min(known, key=lambda i: known[i])
        beside = {lowest - 1, lowest + 1} - known.keys()
        if not beside:
            break
        known |= {i: error(i) for i in beside}
    lowest = min(known, key=lambda i: known[i])
    if not {lowest - 1, lowest + 1} <= known.keys():
        return None
    before, here, after = (known[lowest + i] for i in (-1, 0, 1))
    bend = before - 2 * here + after
    return lowest + (0.5 * (before - after) / bend if bend > 0 else 0.0)
