"""`identify` and `trace`: from a case to an `Outcome`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import jax
import numpy as np

from hydrojax.effects import EFFECTS
from hydrojax.errors import InputError
from hydrojax.identify.case import Case
from hydrojax.identify.checking.check import check_inputs
from hydrojax.identify.checking.mended import Findings, mended_case
from hydrojax.identify.estimation.columns import room_of
from hydrojax.identify.estimation.fit import (
    FitPoint,
    fit_blind,
    fit_force,
    fit_from_balances,
    fit_jointly,
    fit_on,
    in_short,
    reweighted,
)
from hydrojax.identify.estimation.known import COULOMB, free_effect, free_parameters
from hydrojax.identify.estimation.problem import Problem, in_play
from hydrojax.identify.estimation.starts import ranked_starts
from hydrojax.identify.inference.profile import profiles
from hydrojax.identify.inference.tolerance import with_tolerances
from hydrojax.identify.inference.uncertainty import Uncertainty, estimate_uncertainty
from hydrojax.identify.late import (
    with_command_between,
    with_delay_replayed,
    with_late_signal,
)
from hydrojax.identify.longer import with_long_runs
from hydrojax.identify.motion.predict import check_drive, predict_motion
from hydrojax.identify.one_log import FILTER, with_filter_of_one_log
from hydrojax.identify.preparation.noise import Noise
from hydrojax.identify.preparation.segments import has_rod_force
from hydrojax.identify.results.outcome import LoopCheck, Outcome
from hydrojax.identify.results.parts import check_loop
from hydrojax.identify.results.sentence import motion_sentence
from hydrojax.identify.results.summary import summarise, with_inputs
from hydrojax.identify.supply import simpler_and_no_worse, with_supply_of_gains
from hydrojax.identify.tracing.judge import cost
from hydrojax.identify.tracing.loop import search_effects
from hydrojax.identify.tracing.rivals import beyond_position, pruned, shed
from hydrojax.identify.tracing.state import Tracing
from hydrojax.jax_setup import cores
from hydrojax.parameters import specs
from hydrojax.plant.effect import Effect
from hydrojax.rigfile.build import build_rig, effects_of, inverts
from hydrojax.rigfile.edit import rewrite

Progress = Callable[[str], None]

NO_MASS = (
    "the motion was not predicted: nothing that moves has a mass; add mass under "
    "[load], or [effects.payload_inertia] with a range for m"
)


def applicable(case: Case) -> tuple[str, ...]:
    """Names of the effects that could show in these logs at all."""
    has = set(case.fit_logs[0].signals)
    can = has & {"P_a1", "P_a2"}
    if case.fit.driven_by == "u":
        can.add("u")
        if inverts(case.spec):
            can.add("edges")
    if np.isfinite(case.fit.noise[2]):
        can.add("F")
        if "F" in has:
            can.add("loadcell")
    if has_rod_force(case.fit_logs[0], case.spec):
        can.add("rod_force")
    if "radius" in case.spec.geometry:
        can.add("psi")
    if len(set(case.spec.layout.chamber_areas)) > 1:
        can.add("differential")
    can -= set(case.spec.layout.unmeasured)
    return tuple(n for n, e in EFFECTS.items() if set(e.needs) <= can)


def _problems(
    case: Case, candidates: Sequence[str]
) -> tuple[Problem, Problem, tuple[str, ...], dict[str, Effect]]:
    """Problems on both sets of logs, the free parameters, the candidates' modules."""
    effects = effects_of(candidates, case.spec)
    rig = build_rig(case.spec, candidates)
    free = free_parameters(case.spec)
    known = dict(free)
    for name in candidates:
        known |= free_effect(name, specs(effects[name]))
    problem = Problem.of(rig, free, case.fit, case.criteria)
    check = Problem.of(rig, free, case.check, case.criteria)
    use = in_play(problem, case.fit)
    if len(check.batch.P_0) > len(problem.batch.P_0) // 3:
        # One program for both: what it runs for nothing costs less than another.
        check = replace(check, least=room_of(problem.batch))
    return replace(problem, free=known), check, use, effects


def _fit_base(
    problem: Problem, free: tuple[str, ...], starts: int, progress: Progress, path: str
) -> _Base:
    """Fit the declared model: where its pressures stood, and where all of it does.

    Raises:
        InputError: values of the rig file at `path` that have no finite answer.
    """
    values, others = problem.initial_values(), []
    starts = max(starts, problem.criteria.blind_starts) if problem.blind else starts
    if starts > 1:
        progress(f"{starts} starts on every few windows")
        values, *others = ranked_starts(problem, values, free, starts)
    progress("fit the declared model")
    if problem.blind:
        done, point = fit_blind(problem, [values, *others], free, progress)
    else:
        if problem.sees_pressures and problem.side(free, True):
            problem, values = fit_from_balances(problem, values, free, progress)
        done, point = fit_force(problem, values, free)
    if not np.isfinite(done.batch.P_0).all():
        raise InputError(
            f"{path}: with the values under [parameters] and [geometry] the model has "
            "no finite answer to these logs; look for one that no rig has"
        )
    return problem, values, done, point


def fit_case(
    case: Case, starts: int = 4, progress: Progress = lambda _: None
) -> Tracing:
    """Fit the declared model: the state before anything is concluded from it.

    Raises:
        InputError: no parameter of the rig file has a range.
    """
    problem, check, free, _ = _problems(case, ())
    if not free:
        raise InputError(
            f"{case.spec.path}: nothing to identify: give at least one parameter a "
            'range, as in beta = { start = "8e8 Pa", range = ["1e8 Pa", "3e9 Pa"] }'
        )
    *_, problem, point = _fit_base(problem, free, starts, progress, case.spec.path)
    return Tracing(problem, check, {}, free, point, progress)


def identify(
    case: Case,
    starts: int = 4,
    progress: Progress = lambda _: None,
    profile: bool = False,
) -> Outcome:
    """Fit the declared model; report its errors and the uncertainty of its parameters.

    With `profile`, intervals by profile likelihood too: many refits.
    """
    began, compiled = time.perf_counter(), _Compiling()
    check_drive(case)
    progress("check the inputs")
    inputs = check_inputs(case.spec, case.read_logs).found
    state = fit_case(case, starts, progress)
    state = _with_noise_found(case, state)
    found = _outcome("identify", case, state, state.point, progress, profile)
    return with_inputs(_timed(found, began, compiled), inputs)


def trace_case(
    case: Case,
    starts: int = 1,
    progress: Progress = lambda _: None,
    profile: bool = False,
    early: Callable[[Case, Outcome], None] = lambda *_: None,
) -> Outcome:
    """The whole loop: fit, residual, the effect behind it, refit, before and after.

    Inputs that look wrong are mended first, where a line of the rig file does that.
    `early` is given the case, mended, and what was found, before values for longer runs
    are looked for, where they are.
    """
    began = time.perf_counter()
    check_drive(case)
    compiled = _Compiling()
    with ThreadPoolExecutor(1) as pool:
        traces = _Traces(case, starts, progress, pool, _Ready.of(case, pool))
        (case, found, point, state), said_of_it = traces.to_the_end()
    outcome = _outcome("trace", case, state, point, progress, profile)
    outcome = replace(outcome, limits=(*said_of_it, *outcome.limits))

    def said(outcome: Outcome) -> Outcome:
        return with_inputs(_timed(outcome, began, compiled), found)

    return said(
        with_long_runs(
            case, outcome, identify, progress, lambda now: early(case, said(now))
        )
    )


class _Traced(NamedTuple):
    """A trace: the case as it was, what was found in its inputs, where the declared
    model's fit stands, and where the search ended.
    """

    case: Case
    found: Findings
    point: FitPoint
    state: Tracing


@dataclass(frozen=True)
class _Traces:
    """A case traced, and again with inputs that read otherwise.

    Attributes:
        given: the case as it was given.
        starts: of the first fit.
        progress: is called with a line of text.
        pool: compiles programs ahead.
        ready: the case, ready to be traced.
    """

    given: Case
    starts: int
    progress: Progress
    pool: ThreadPoolExecutor
    ready: _Ready

    def to_the_end(self) -> tuple[_Traced, tuple[str, ...]]:
        """The trace, its inputs as they turned out to be; and what is said of a filter
        of one log.
        """
        now = self.first()
        later = with_late_signal(now.case, now.found, now.state, self.progress)
        if later is not now.found:
            now = self.again(later)
        later = with_supply_of_gains(now.case, now.found, now.state, self.progress)
        if later is not now.found:
            other = self.again(later)
            if simpler_and_no_worse(now.state, other.state):
                now = other
        one, said = with_filter_of_one_log(now.case, now.state, self.progress)
        if one is not now.case:
            other = self.searched(one, now.found, *self.fitted(one))
            if any(a.name == FILTER for a in other.state.added):
                return other, said
        return now, ()

    def first(self) -> _Traced:
        """The first: the inputs are checked, and then the declared model's replays say
        what balances of flow know less well.
        """
        self.progress("check the inputs")
        seen = check_inputs(self.given.spec, self.given.read_logs).found
        case, found = mended_case(self.given, seen)
        own, base = self.fitted(case)
        at = (*base[2:], own.free, self.progress)
        later = with_delay_replayed(case, self.given.spec, found, *at)
        if later is found:
            later = with_command_between(case, found, *at)
        if later is not found:
            return self.again(later)
        return self.searched(case, found, own, base)

    def again(self, found: Findings) -> _Traced:
        """The case traced with these findings mended in it."""
        case, found = mended_case(self.given, found)
        return self.searched(case, found, *self.fitted(case))

    def fitted(self, case: Case) -> tuple[_Ready, _Base]:
        """A case made ready, and the declared model's fit."""
        own = self.ready if case is self.given else _Ready.of(case, self.pool)
        return own, own.fitted(case, self.starts, self.progress)

    def searched(
        self, case: Case, found: Findings, own: _Ready, base: _Base
    ) -> _Traced:
        """The trace from there on; from its beginning, if what it adds shows an input
        to be at fault.
        """

        def question(state: Tracing) -> None:
            at = (state.problem, state.point, state.free, self.progress)
            later = with_command_between(case, found, *at)
            if later is not found:
                raise _MistakenError(later)

        try:
            state = own.searched(case, base, self.progress, question)
        except _MistakenError as mistaken:
            return self.again(mistaken.found)
        return _Traced(case, found, base[3], state)


def _timed(outcome: Outcome, began: float, compiled: _Compiling) -> Outcome:
    """The outcome with the time since it was begun."""
    total = time.perf_counter() - began
    seconds = {"compile": compiled.seconds, "run": total - compiled.seconds}
    return replace(outcome, seconds=seconds)


class _MistakenError(Exception):
    """What a search has found shows an input to be at fault: it is to begin again."""

    def __init__(self, found: Findings):
        super().__init__()
        self.found = found


_Base = tuple[Problem, np.ndarray, Problem, FitPoint]
"""Where the declared model's pressures stood, and where all of it does."""


@dataclass(frozen=True)
class _Ready:
    """What a trace begins with; `ahead` are programs that it will need, as they are
    compiled on a core that has nothing else to do: each takes 600 MiB meanwhile.
    """

    problem: Problem
    check: Problem
    free: tuple[str, ...]
    effects: dict[str, Effect]
    ahead: tuple[Future, ...]

    @classmethod
    def of(cls, case: Case, pool: ThreadPoolExecutor) -> _Ready:
        names = [n for n in applicable(case) if n not in case.spec.effects]
        problem, check, free, effects = _problems(case, names)
        values = problem.initial_values()

        def fitted(values: np.ndarray) -> None:
            problem.evaluate(values, free, problem.slots(free), problem.batch)

        # In the order in which they are waited for.
        needed = (check.errors_at, fitted, problem.sums_at) if cores() > 1 else ()
        ahead = tuple(pool.submit(evaluate, values) for evaluate in needed)
        return cls(problem, check, free, effects, ahead)

    def fitted(self, case: Case, starts: int, progress: Progress) -> _Base:
        """The declared model's fit, as `_fit_base` gives it."""
        path = case.spec.path
        base = _fit_base(self.problem, self.free, starts, progress, path)
        for job in self.ahead:
            job.result()
        return base

    def searched(
        self,
        case: Case,
        base: _Base,
        progress: Progress,
        question: Callable[[Tracing], None],
    ) -> Tracing:
        """What a search for effects finds from the declared model's fit."""
        early, values, done, point = base
        start = Tracing(
            in_short(early),
            self.check,
            self.effects,
            self.free,
            replace(point, values=values),
            progress,
            question=question,
        )
        state = shed(_on_all(done, _searched(case, search_effects(start))))
        return _or_none(state, replace(start, problem=done, point=point))


def _or_none(state: Tracing, base: Tracing) -> Tracing:
    """The state, or the declared model's if that leaves no more of the validation logs:
    what helped on the windows that were searched may not help on all, or in one channel
    by as much as it harms another.
    """
    # By one noise, which also says where the windows' pressures begin.
    without = state.check.errors_at(base.point.values)
    if cost(state.errors, state.noise) < cost(without, state.noise):
        return state
    names = [a.name for a in state.added]
    for name in names:
        state.progress(f"let go of {name}")
    tried = {**state.tried, **dict.fromkeys(names, "does not help")}
    return replace(base, scores=state.scores, tried=tried)


def _searched(case: Case, state: Tracing) -> Tracing:
    """The search gone on with the noise by the model that it found, without effects
    that do nothing but answer the position's noise otherwise.
    """
    state = _with_search_gone_on(case, state)
    if case.noise_by is None or not state.added:
        return state
    less = beyond_position(state, case.noise_by)
    return state if less is state else _with_noise_found(case, less)


def _with_search_gone_on(case: Case, state: Tracing) -> Tracing:
    """The search gone on with the noise by the model that it found, if any channel
    stands above that; where it is more than before, without effects needless by it.
    """
    known = _with_noise_found(case, state)
    if known is state:
        return state
    rms = known.check.rms(known.check.errors_at(known.point.values))
    seen, limit = np.isfinite(known.noise), state.criteria.at_noise
    above = rms > limit * known.noise
    if np.any((above & (rms <= limit * state.noise))[seen]):
        return search_effects(known)
    if np.any((known.noise > state.noise)[seen]):
        return pruned(known, known.noise, fresh=0)
    return known


def _with_noise_found(case: Case, state: Tracing) -> Tracing:
    """The state with the channels' noise as the model that was found has it.

    How far the position's noise moves a pressure depends on the model; one that lacked
    an effect, or a rig file's first values, gave it when the logs were made ready. It
    is raised by little, and not by chambers as stiff as they may be: a model that is
    off may answer the position too strongly, and would excuse its own error.
    """
    if case.noise_by is None:
        return state
    seen = np.isfinite(state.noise)
    free, here = state.problem.free, state.named
    ends = {"beta": 1.0, "delta_1": -1.0, "delta_2": -1.0}
    stiffest = any(
        name in state.free
        and np.isclose(here[name], free[name].upper if way > 0 else free[name].lower)
        for name, way in ends.items()
    )
    own = state.criteria
    raised = 1.0 if stiffest else own.recounted
    found = np.array(case.noise_by(state.problem, state.point.values))
    known = np.array([state.fitted_noise(state.noise), state.noise])
    noise = Noise(*np.where(seen, np.fmin(found, raised * known), known))
    if np.allclose(np.array(noise)[:, seen], known[:, seen], rtol=own.matters):
        return state
    problem, check = (
        replace(p, batch=p.batch._replace(noise=one))
        for p, one in zip((state.problem, state.check), noise, strict=True)
    )
    rms = problem.rms(problem.errors_at(state.point.values))
    weights = reweighted(noise.fit, rms, own.reweighted_above)
    problem, point = fit_jointly(problem, state.point.values, state.free, weights)
    return replace(state, problem=problem, check=check, point=point)


def _on_all(problem: Problem, state: Tracing) -> Tracing:
    """The state fitted to the end: on all windows, where effects were looked for on
    some, and without those that are not needed there.
    """
    whole = len(state.problem.batch.P_0) == len(problem.batch.P_0)
    if whole and (np.isfinite(state.noise[2]) or not state.added):
        return state  # its last fit was to the end
    state.progress("fit to the end" if whole else "fit to all windows")
    noise = state.problem.batch.noise
    problem = replace(problem, batch=problem.batch._replace(noise=noise))
    problem, point = fit_on(problem, state.point.values, state.free)
    state = replace(state, problem=problem, point=point)
    return state if whole else pruned(state, state.noise, fresh=0)


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


def _settled(state: Tracing) -> tuple[Tracing, Uncertainty, tuple[str, ...]]:
    """The final fit, what the logs say of it, and a remark: symmetric in Coulomb
    friction unless fit or check show otherwise.

    In sliding only `k_cp + k_0` and `k_cn - k_0` act: the three differ in the bristle's
    turning alone, which a log may not resolve. Where the fit does not separate k_cp
    from k_cn, and the check is as good without a difference, the simpler of the two
    descriptions is taken.
    """
    noise = state.noise
    uncertainty = estimate_uncertainty(state.problem, state.point, state.free)
    if not {*COULOMB, "k_0"} <= set(state.free) or not np.isfinite(noise[2]):
        return state, uncertainty, ()
    if set(COULOMB) <= set(uncertainty.inside):
        at = [uncertainty.inside.index(n) for n in COULOMB]
        difference = np.array([1.0, -1.0])
        spread = np.sqrt(
            difference @ uncertainty.covariance[np.ix_(at, at)] @ difference
        )
        if (
            abs(state.named["k_cp"] - state.named["k_cn"])
            > state.criteria.asymmetry * spread
        ):
            return state, uncertainty, ()
    problem, point = fit_jointly(
        replace(state.problem, symmetric=True),
        state.point.values,
        state.free,
        state.point.weights,
    )
    own, tied = (
        state.check.rms(state.check.errors_at(p.values)) for p in (state.point, point)
    )
    if np.any(tied > own + state.criteria.matters * np.maximum(noise, own)):
        return state, uncertainty, ()
    said = (
        "k_cp, k_cn and k_0: these logs identify only k_cp + k_0 and "
        "k_cn - k_0; k_cp and k_cn were taken as equal"
    )
    state = replace(state, problem=problem, point=point)
    return state, estimate_uncertainty(problem, point, state.free), (said,)


def _loops(case: Case, state: Tracing) -> tuple[LoopCheck, ...]:
    """The first log kept for the check, run again in the identified rig's loop."""
    if case.fit.driven_by != "u":
        return ()
    added = tuple(a.name for a in state.added)
    log = case.check_logs[0]
    done = check_loop(case.spec, log, state.named, added, case.criteria)
    return (done,) if done else ()


def _outcome(command, case, state, base, progress, profile) -> Outcome:
    progress("errors, intervals and residuals")
    state, uncertainty, said = _settled(state)
    uncertainty = with_tolerances(uncertainty, case, state)
    if profile:
        found = profiles(state.problem, state.point, state.free, uncertainty, progress)
        uncertainty = replace(uncertainty, profiles=found)
    outcome = summarise(command, case, state, base, uncertainty)
    outcome = replace(outcome, limits=(*said, *outcome.limits))
    free = {n: state.problem.free[n] for n in state.free}
    declared = dict(zip(state.problem.model.names, base.values, strict=True))
    if command == "identify":
        start = state.check.initial_values()
        declared = dict(zip(state.check.model.names, start, strict=True))
    added = [a.name for a in state.added]
    motion = predict_motion(case, declared, state.named, free, added, progress)
    if case.spec.predicts and motion is None:
        outcome = replace(outcome, limits=(*outcome.limits, NO_MASS))
    progress("the closed loop again")
    return replace(
        outcome,
        loops=_loops(case, state),
        sentence=outcome.sentence + (f" {motion_sentence(motion)}" if motion else ""),
        rig_file=rewrite(case.spec, state.named, added),
        motion=motion,
    )
