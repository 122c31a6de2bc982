"""`identify` and `trace` from files to an `Outcome`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import jax
import numpy as np

from ..backend import make_room
from ..build import load_rig, make_effects, make_rig
from ..channels import QUEUE
from ..effects import EFFECTS
from ..errors import InputError
from ..params import Effect, specs
from ..rewrite import rewrite
from ..rigfile import RigSpec
from ..signals import Log, read_log
from .closed_loop import check_loop
from .fit import Point, fit_force, fit_jointly, fit_pressures
from .measured import channel_noise
from .outcome import LoopCheck, Outcome
from .prepare import Data, driver, prepare, runs_backward
from .problem import (
    COULOMB,
    Problem,
    free_effect,
    free_parameters,
    in_play,
)
from .profile import profiles
from .resolution import resolve
from .segments import common_band
from .starts import best_start
from .state import Tracing
from .summary import summarise
from .trace import trace
from .uncertainty import Belief, believe

Tell = Callable[[str], None]

BLIND_STARTS = 4
"""Starts at least where no pressure is measured: one often leads astray there."""

TOLD = 3.0
"""Standard deviations by which a fit must tell k_cp from k_cn to keep them apart."""


@dataclass(frozen=True)
class Case:
    """A rig and its logs made ready: those that are fitted, and those that are not.

    Without validation logs the check is on the fitted ones, and `held_out` is False.
    """

    spec: RigSpec
    fit: Data
    check: Data
    fit_logs: tuple[Log, ...]
    check_logs: tuple[Log, ...]
    held_out: bool


def open_case(
    rig: str | Path,
    logs: Sequence[str | Path],
    validate: Sequence[str | Path] = (),
    horizon: float = 0.25,
) -> Case:
    """Read a rig file and its logs.

    Raises:
        InputError: whatever is wrong with them, in one line.
        RuntimeError: JAX is not in double precision.
    """
    if not jax.config.read("jax_enable_x64"):
        raise RuntimeError(
            "identification needs double precision: before anything else write "
            'jax.config.update("jax_enable_x64", True)'
        )
    make_room()
    spec = load_rig(rig)
    if not logs:
        raise InputError(f"{rig}: no log to fit: name at least one")
    fitted = tuple(read_log(path, spec.channels) for path in logs)
    others = tuple(read_log(path, spec.channels) for path in validate)
    again = {Path(p).resolve() for p in logs} & {Path(p).resolve() for p in validate}
    if again:
        raise InputError(
            f"{min(again)}: is among the logs to fit too: a check needs one that took "
            "no part in the fit"
        )
    per = [
        s for e in spec.effects for s in specs(EFFECTS[e]).values() if "{u}" in s.unit
    ]
    if not per and not any(n.startswith("c_") for n in spec.parameters):
        # Nothing in the rig file says what a command is: the logs do.
        unit = fitted[0].units.get("u", spec.command_unit)
        spec = replace(spec, command_unit=unit)
    for log in (*fitted, *others):
        unit = log.units.get("u", spec.command_unit)
        if unit != spec.command_unit:
            raise InputError(
                f"{log.name}: u is in [{unit}], but {rig} or another log is per "
                f"[{spec.command_unit}]: bring them to one unit"
            )
    every = (*fitted, *others)
    driven_by = driver(every, spec)
    band = common_band(every, spec, driven_by)
    noise = channel_noise(every, spec, driven_by)

    def ready(logs: Sequence[Log], noise: np.ndarray, sign: float = 1.0) -> Data:
        return prepare(logs, spec, horizon, noise, sign, band)

    fit = ready(fitted, noise)
    found = resolve(every, len(fitted), spec, fit, ready)
    fitted, others = found.logs[: len(fitted)], found.logs[len(fitted) :]
    fit, notes = found.fit, found.notes
    sign = -1.0 if runs_backward(fit) else 1.0
    if sign < 0:
        fit = ready(fitted, fit.noise, sign)
        notes = (
            *notes,
            "friction as logged drives the motion: the position runs against the "
            "rig's sign (P pushes toward positive v), so it was turned round; say so "
            "in the rig file with invert = true under [channels]",
        )
    check = ready(others, fit.noise, sign) if others else fit
    said = (*notes, *fit.notes, *check.notes)
    fit = replace(fit, notes=tuple(dict.fromkeys(said)))
    return Case(spec, fit, check, fitted, others or fitted, bool(others))


def applicable(case: Case) -> tuple[str, ...]:
    """Names of the effects that could show in these logs at all."""
    has = set(case.fit_logs[0].signals)
    can = has & {"P_a1", "P_a2"}
    if case.fit.driven_by == "u":
        can.add("u")
    if np.isfinite(case.fit.noise[2]):
        can.add("F")
        if "F" in has:
            can.add("loadcell")
    if "radius" in case.spec.geometry:
        can.add("psi")
    if case.spec.layout == "single":
        can -= {"P_a1"}
    return tuple(n for n, e in EFFECTS.items() if set(e.needs) <= can)


def _problems(
    case: Case, candidates: Sequence[str]
) -> tuple[Problem, Problem, tuple[str, ...], dict[str, Effect]]:
    """Problems on both sets of logs, the free parameters, the candidates' modules."""
    names = (*case.spec.effects, *candidates)
    effects = make_effects(names, case.spec, case.fit.travel)
    rig = make_rig(case.spec, effects)
    free = free_parameters(case.spec)
    known = dict(free)
    for name in candidates:
        known |= free_effect(name, specs(effects[name]))
    if "valve_delay.tau_u" in known:
        # A delay reaches no further back than its queue, which counts in ticks.
        reach = (QUEUE - 1) * float(np.min(case.fit.windows.h))
        f = known["valve_delay.tau_u"]
        known["valve_delay.tau_u"] = replace(f, upper=min(f.upper, reach))
    problem = Problem.of(rig, free, case.fit)
    check = Problem.of(rig, free, case.check)
    use = in_play(problem, case.fit)
    dormant = {n: e for n, e in effects.items() if n in candidates}
    return replace(problem, free=known), check, use, dormant


def _fit_base(
    problem: Problem, free: tuple[str, ...], starts: int, tell: Tell, path: str
) -> tuple[Problem, np.ndarray, Problem, Point]:
    """Fit the declared model: where its pressures stood, and where all of it does.

    Raises:
        InputError: values of the rig file at `path` that have no finite answer.
    """
    values = problem.initial_values()
    starts = max(starts, BLIND_STARTS) if problem.blind else starts
    if starts > 1:
        tell(f"{starts} starts on every few windows")
        values = best_start(problem, values, free, starts)
    tell("fit the declared model")
    if problem.sees_pressures and problem.side(free, True):
        problem, values = fit_pressures(problem, values, free)
    done, point = fit_force(problem, values, free)
    if not np.isfinite(done.batch.P_0).all():
        raise InputError(
            f"{path}: with the values under [parameters] and [geometry] the model has "
            "no finite answer to these logs; look for one that no rig has"
        )
    return problem, values, done, point


def fit_case(case: Case, starts: int = 4, tell: Tell = lambda _: None) -> Tracing:
    """Fit the declared model: where it stands, before anything is said of it.

    Raises:
        InputError: no parameter of the rig file has a range.
    """
    problem, check, free, _ = _problems(case, ())
    if not free:
        raise InputError(
            f"{case.spec.path}: nothing to identify: give at least one parameter a "
            'range, as in beta = { start = "8e8 Pa", range = ["1e8 Pa", "3e9 Pa"] }'
        )
    *_, problem, point = _fit_base(problem, free, starts, tell, case.spec.path)
    return Tracing(problem, check, {}, free, point, 0.02, 0.01, tell)


def identify(
    case: Case,
    starts: int = 4,
    tell: Tell = lambda _: None,
    profile: bool = False,
) -> Outcome:
    """Fit the declared model, and say how well it does and can be believed.

    With `profile`, intervals by profile likelihood too: many refits.
    """
    began, compiled = time.perf_counter(), _Compiling()
    state = fit_case(case, starts, tell)
    return _outcome(
        "identify", case, state, state.point, began, compiled, tell, profile
    )


def trace_case(
    case: Case,
    starts: int = 1,
    matters: float = 0.02,
    level: float = 0.01,
    tell: Tell = lambda _: None,
    profile: bool = False,
) -> Outcome:
    """The whole loop: fit, residual, the effect behind it, refit, before and after."""
    began = time.perf_counter()
    names = [n for n in applicable(case) if n not in case.spec.effects]
    problem, check, free, effects = _problems(case, names)
    compiled = _Compiling()
    values = problem.initial_values()
    with ThreadPoolExecutor(2) as pool:
        # What the trace will need is compiled while the first fit runs.
        ahead = [
            pool.submit(check.errors_at, values),
            pool.submit(problem.sums_at, values),
        ]
        early, values, done, point = _fit_base(
            problem, free, starts, tell, case.spec.path
        )
        for job in ahead:
            job.result()
    start = Tracing(
        early, check, effects, free, replace(point, values=values), matters, level, tell
    )
    state = trace(start)
    return _outcome("trace", case, state, point, began, compiled, tell, profile)


class _Compiling:
    """Seconds in which something was being compiled, as JAX's own events say.

    Programs are compiled side by side, so it is the time covered that counts.
    """

    EVENT = "/jax/core/compile/backend_compile_duration"

    SPANS: ClassVar[list[tuple[float, float]]] = []
    HEARS: ClassVar[list[bool]] = []

    def __init__(self):
        self.first = len(self.SPANS)
        if not self.HEARS:  # a listener cannot be taken back: one serves all
            jax.monitoring.register_event_duration_secs_listener(self._heard)
            self.HEARS.append(True)

    @classmethod
    def _heard(cls, event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event == cls.EVENT:
            now = time.perf_counter()
            cls.SPANS.append((now - duration_secs, now))

    @property
    def seconds(self) -> float:
        total, until = 0.0, -np.inf
        for start, end in sorted(self.SPANS[self.first :]):
            total += max(0.0, end - max(start, until))
            until = max(until, end)
        return total


def _settled(state: Tracing) -> tuple[Tracing, Belief, tuple[str, ...]]:
    """The final fit, what the logs say of it, and a remark: symmetric in Coulomb
    friction unless fit or check tell otherwise.

    In sliding only `k_cp + k_0` and `k_cn - k_0` act: the three differ in the bristle's
    turning alone, which a log may not resolve. Where the fit does not tell k_cp from
    k_cn, and the check is as good without a difference, the simpler of the two
    descriptions is taken.
    """
    noise = state.noise
    belief = believe(state.problem, state.point, state.free)
    if not {*COULOMB, "k_0"} <= set(state.free) or not np.isfinite(noise[2]):
        return state, belief, ()
    if set(COULOMB) <= set(belief.inside):
        at = [belief.inside.index(n) for n in COULOMB]
        difference = np.array([1.0, -1.0])
        spread = np.sqrt(difference @ belief.covariance[np.ix_(at, at)] @ difference)
        if abs(state.named["k_cp"] - state.named["k_cn"]) > TOLD * spread:
            return state, belief, ()
    problem, point = fit_jointly(
        replace(state.problem, symmetric=True),
        state.point.values,
        state.free,
        state.point.weights,
    )
    own, tied = (
        state.check.rms(state.check.errors_at(p.values)) for p in (state.point, point)
    )
    if np.any(tied > own + state.matters * np.maximum(noise, own)):
        return state, belief, ()
    said = (
        "k_cp, k_cn and k_0: these logs tell only k_cp + k_0 and k_cn - k_0; k_cp and "
        "k_cn were taken as equal"
    )
    state = replace(state, problem=problem, point=point)
    return state, believe(problem, point, state.free), (said,)


def _loops(case: Case, state: Tracing) -> tuple[LoopCheck, ...]:
    """The first log kept for the check, run again in the identified rig's loop."""
    if case.fit.driven_by != "u":
        return ()
    added = tuple(a.name for a in state.added)
    log = case.check_logs[0]
    done = check_loop(case.spec, log, state.named, added, case.fit.travel)
    return (done,) if done else ()


def _outcome(command, case, state, base, began, compiled, tell, profile) -> Outcome:
    tell("errors, intervals and what is left")
    state, belief, said = _settled(state)
    if profile:
        found = profiles(state.problem, state.point, state.free, belief, tell)
        belief = replace(belief, profiles=found)
    outcome = summarise(command, case, state, base, belief)
    outcome = replace(outcome, limits=(*said, *outcome.limits))
    tell("the closed loop again")
    outcome = replace(
        outcome,
        loops=_loops(case, state),
        rig_file=rewrite(
            case.spec,
            state.named,
            [a.name for a in state.added],
            travel=case.fit.travel,
        ),
    )
    total = time.perf_counter() - began
    seconds = {"compile": compiled.seconds, "run": total - compiled.seconds}
    return replace(outcome, seconds=seconds)
