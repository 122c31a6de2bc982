"""Check, identification and trace: rig and logs in, a result out."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from hydrojax.errors import InputError
from hydrojax.identify import api
from hydrojax.identify.case import Case, LogSource, RigSource, open_case, read
from hydrojax.identify.checking.check import Checked, check_inputs
from hydrojax.identify.checking.mended import mended_case
from hydrojax.identify.result import Result
from hydrojax.identify.results.summary import with_inputs
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.jax_setup import ensure_jax
from hydrojax.rigfile.build import build_loop
from hydrojax.rigfile.schema import RigFile

Progress = Callable[[str], None]
"""Is called with a line of text at each stage."""


def fit(
    rig: RigSource,
    logs: Sequence[LogSource],
    validate: Sequence[LogSource] = (),
    test: Sequence[LogSource] = (),
    *,
    criteria: Criteria = Criteria(),
    horizon: float = 0.25,
    starts: int = 4,
    profile: bool = False,
    progress: Progress = lambda _: None,
) -> Result:
    """Fit the declared model to logs.

    Args:
        rig: a `RigFile`, or the path of one; what has a range in it is fitted.
        logs: to be fitted: each a `Log`, a path, or a DataFrame or dict of
            columns (`Log.from_frame`).
        validate: logs that take no part in the fit; errors and verdict are theirs.
            Without any they are those of the fitted logs.
        test: logs that take part in no decision; errors are then theirs.
        criteria: the thresholds by which it is decided.
        horizon: length of a replay window, s.
        starts: number of starts of the fit.
        profile: 95 % intervals by profile likelihood too: many refits.
        progress: is called with a line of text at each stage.

    Raises:
        InputError: whatever is wrong with rig or logs, in one line.
    """
    _check_starts(starts)
    case = _opened(rig, logs, validate, test, horizon, criteria)
    return Result(api.identify(case, starts, progress, profile), case)


def _check_starts(starts: int) -> None:
    if starts < 1:
        raise InputError(f"starts {starts}: a fit begins at one point at least")


def trace(
    rig: RigSource,
    logs: Sequence[LogSource],
    validate: Sequence[LogSource],
    test: Sequence[LogSource] = (),
    *,
    criteria: Criteria = Criteria(),
    horizon: float = 0.25,
    starts: int = 1,
    profile: bool = False,
    progress: Progress = lambda _: None,
    early: Callable[[Result], None] = lambda _: None,
) -> Result:
    """Find the effects behind the residual: fit, score, refit, validate, and again.

    Signs, units and constants that look wrong are mended first, and the result is of
    the mended inputs; `result.outcome.inputs` says which, and the lines to write.

    Args:
        rig: a `RigFile`, or the path of one; what has a range in it is fitted.
        logs: to be fitted: each a `Log`, a path, or a DataFrame or dict of
            columns (`Log.from_frame`).
        validate: logs that take no part in the fit, on which effects are judged.
        test: logs that take part in no decision; errors are then theirs.
        criteria: the thresholds by which it is decided.
        horizon: length of a replay window, s.
        starts: number of starts of the first fit.
        profile: 95 % intervals by profile likelihood too: many refits.
        progress: is called with a line of text at each stage.
        early: is called with the result before values for longer runs are looked for,
            which takes minutes; not where they are not (`outcome.long_runs`).

    Raises:
        InputError: whatever is wrong with rig or logs, in one line.
    """
    _check_starts(starts)
    case = _opened(rig, logs, validate, test, horizon, criteria)
    outcome = api.trace_case(
        case, starts, progress, profile, lambda mended, now: early(Result(now, mended))
    )
    return Result(outcome, mended_case(case, outcome.inputs)[0])


def discover(result: Result, *, progress: Progress = lambda _: None) -> Result:
    """Look for what no known effect explains: curves over the rig's signals.

    At each place of the signal path (command, flow into the chambers, compliance,
    Coulomb level, friction, force at the load cell) a curve of free form is tried over
    each signal of that place, by the rule of the named effects: a family-wise test of
    its score, a refit with all that is free, and a validation error that falls. The
    curves are penalised B-splines whose smoothing is found by restricted likelihood;
    what the rig's own parameters can follow is left to them, and the intervals in
    `outcome.beside` count what a curve leaves to them or takes from them.

    Args:
        result: of `fit` or `trace`; only what it leaves above the noise is looked at.
        progress: is called with a line of text at each stage.

    Returns:
        The result with `curves`; `save` writes my_effects.py beside the report, which
        `load_effects` takes.

    Raises:
        InputError: no validation log was given.
    """
    ensure_jax()
    case = result.case
    if not case.held_out:
        raise InputError(
            f"{case.spec.path}: curves are judged on logs that take no part in the "
            "fit: give at least one with validate"
        )
    from hydrojax.identify.discovery.discover import searched

    began = time.perf_counter()
    _, outcome = searched(case, result.outcome, progress)
    spent = outcome.seconds.get("run", 0.0) + time.perf_counter() - began
    seconds = {**outcome.seconds, "run": spent}
    return replace(result, outcome=replace(outcome, seconds=seconds))


def retraced(
    result: Result,
    starts: int = 1,
    profile: bool = False,
    progress: Progress = lambda _: None,
) -> Result:
    """The trace of a result's case once more, with what was added to the vocabulary
    since; its curves are kept, and its time counts.
    """
    outcome = api.trace_case(result.case, starts, progress, profile)
    spent = result.outcome.seconds
    seconds = {n: s + spent.get(n, 0.0) for n, s in outcome.seconds.items()}
    outcome = replace(
        outcome,
        curves=result.curves,
        beside=result.outcome.beside,
        seconds=seconds,
    )
    known = result.outcome.inputs
    if any(f.mended for f in known):  # in that case nothing of it is left to be found
        outcome = with_inputs(outcome, known)
    return Result(outcome, result.case)


def check(rig: RigSource, logs: Sequence[LogSource]) -> Checked:
    """Check whether rig file and logs can be true, before anything is fitted.

    Signs, exchanged channels, units, areas, the supply, stated noise and constants that
    the rig file leaves out are tried on balances of flow and force over short windows:
    nothing is simulated.

    Args:
        rig: a `RigFile`, or the path of one.
        logs: recorded on it: each a `Log`, a path, or a DataFrame or dict of
            columns (`Log.from_frame`).

    Raises:
        InputError: whatever cannot be read of rig or logs, in one line.
    """
    ensure_jax()
    spec = rig if isinstance(rig, RigFile) else RigFile.load(rig)
    if not logs:
        raise InputError(f"{spec.path}: no log to check: name at least one")
    if spec.controller:
        build_loop(spec)  # which refuses what [controller] cannot be
    return check_inputs(spec, [read(log, spec) for log in logs])


def _opened(
    rig: RigSource,
    logs: Sequence[LogSource],
    validate: Sequence[LogSource],
    test: Sequence[LogSource],
    horizon: float,
    criteria: Criteria,
) -> Case:
    """The case, once JAX is in double precision."""
    ensure_jax()
    return open_case(rig, logs, validate, test, horizon=horizon, criteria=criteria)
