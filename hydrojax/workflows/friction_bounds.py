"""The law's friction bounds from logs: many fits, refined through the closed loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from hydrojax import units
from hydrojax.control.loop import Loop, Scenario
from hydrojax.errors import InputError
from hydrojax.identify import api
from hydrojax.identify.case import Case
from hydrojax.identify.estimation.box import (
    Box,
    FrictionStretch,
    fit_stretches,
    friction_names,
    smallest_box,
)
from hydrojax.identify.tracing.state import Tracing
from hydrojax.logs.log import Log
from hydrojax.rigfile import controller
from hydrojax.rigfile.build import build_loop
from hydrojax.rigfile.edit import identified, rewrite, text
from hydrojax.rigfile.recording import rerun
from hydrojax.rigfile.schema import RigFile
from hydrojax.tune.ensemble import Plants
from hydrojax.tune.refine import (
    Ends,
    refine,
    tracking_errors,
    under_model_error,
    with_bounds,
)

MOST_SECONDS = 6.0
"""How much of each log is run in closed loop, s."""

PROPOSED = ("rig file", "refined", "paper")
"""Ways that may be proposed; of equally good ones the first."""


@dataclass(frozen=True)
class Bounds:
    """Bounds of theta_f in several ways, and how the law tracks with each; SI.

    Attributes:
        box: that holds the next stretch's theta_f at a confidence.
        fits: of the stretches of the logs that took part.
        other_fits: of those that did not.
        bounds: lower and upper by way: "paper", "box", "refined", and "rig file" where
            that gives bounds of some.
        coverage: share of stretches that each way's bounds hold, by way: of the logs
            that took no part, where there are any.
        proposed: the way whose bounds are proposed.
        fitted: RMS tracking error by way, N, over plants and scenarios of the logs that
            took part.
        others: over those of the logs that did not; empty without any.
        rig_file: its text, with the proposed bounds.
    """

    box: Box
    fits: list[FrictionStretch]
    other_fits: list[FrictionStretch]
    bounds: dict[str, Ends]
    coverage: dict[str, float]
    proposed: str
    fitted: dict[str, float]
    others: dict[str, float]
    rig_file: str


def friction_bounds(
    case: Case,
    confidence: float = 0.95,
    stretch: float = 2.0,
    progress: Callable[[str], None] = lambda _: None,
) -> Bounds:
    """The law's bounds of theta_f from many fits, then refined through the loop.

    Args:
        case: the rig and its logs; those kept for the check give plants on which the
            ways are compared and which take no part in finding them. The refined bounds
            are proposed only where they track better there than the rig file's own, and
            no worse than the paper's.
        confidence: that the box holds the next stretch's theta_f.
        stretch: length of a fit, s.
        progress: called with a line of text at each stage.

    Raises:
        InputError: nothing of friction is free, or the logs are too short.
    """
    state = api.fit_case(case, 1, progress)
    names = friction_names(state.problem)
    progress("fit friction in every stretch")
    fits, other_fits = _fits(case, state, stretch)
    free = [state.problem.free[n] for n in names]
    limits = [(f.lower, f.upper) for f in free]
    box = smallest_box(names, fits, confidence, limits)
    spec = identified(case.spec, state.named)
    loop, scenarios = _scenarios(spec, build_loop(spec), case.fit_logs)
    plants = _plants(names, fits, loop)
    progress("refine the bounds")
    paper = controller.default_bounds(loop.law.nominal)
    lowest, highest = (np.array([paper[n][i] for n in names]) for i in (0, 1))
    held = (box.lower, box.upper)
    both = (np.minimum(lowest, box.lower), np.maximum(highest, box.upper))
    ways = {"paper": (lowest, highest), "box": held}
    if case.spec.controller.keys() & set(names):
        ways["rig file"] = _own(loop, names)
    tried = [
        refine(loop, plants, scenarios, held, limits, names, start, progress)
        for start in (held, both)
    ]
    errors = [_errors(loop, names, {"": ends}, plants, scenarios)[""] for ends in tried]
    ways["refined"] = tried[int(np.argmin(errors))]

    progress("compare them")
    fitted, elsewhere = _errors(loop, names, ways, plants, scenarios), {}
    if other_fits:
        others = _scenarios(spec, loop, case.check_logs)[1]
        rest = _plants(names, other_fits, loop, seed=1)
        elsewhere = _errors(loop, names, ways, rest, others)
    judged = (elsewhere or fitted).__getitem__
    proposed = min((way for way in PROPOSED if way in ways), key=judged)
    ends = zip(names, *ways[proposed], strict=True)
    keys = {n: [_paper_unit(n, a), _paper_unit(n, b)] for n, a, b in ends}
    file = rewrite(case.spec, state.named, controller=keys)
    coverage = {way: _held(ends, other_fits or fits) for way, ends in ways.items()}
    return Bounds(
        box, fits, other_fits, ways, coverage, proposed, fitted, elsewhere, file
    )


def _own(loop: Loop, names: tuple[str, ...]) -> Ends:
    """The loop's own bounds."""
    low, high = (
        np.array([float(getattr(ends, n)) for n in names])
        for ends in (loop.law.lower, loop.law.upper)
    )
    return low, high


def _plants(
    names: tuple[str, ...], fits: list[FrictionStretch], loop: Loop, seed: int = 0
) -> Plants:
    """The stretches' friction, each in a plant that the law does not quite know.

    Another seed gives other plants: those that judge are not those that were fitted.
    """
    theta = np.array([f.theta for f in fits])
    return under_model_error(Plants(names, theta), loop, seed=seed)


def _held(ends: Ends, fits: list[FrictionStretch]) -> float:
    """The share of stretches whose theta_f lies within bounds, within its own error."""

    def one(f: FrictionStretch) -> bool:
        spare = 2 * np.sqrt(np.diag(f.covariance))
        return bool(np.all((f.theta >= ends[0] - spare) & (f.theta <= ends[1] + spare)))

    return float(np.mean([one(f) for f in fits]))


def _fits(
    case: Case, state: Tracing, stretch: float
) -> tuple[list[FrictionStretch], list[FrictionStretch]]:
    """Friction in every stretch of the logs to fit, and of those to check."""
    logs = [log.name for log in case.fit_logs]
    fits = fit_stretches(state.problem, state.point, case.fit, logs, stretch)
    if not case.held_out:
        return fits, []
    values = state.point.values
    check = state.check.restarted(state.check.sums_at(values), values)
    check = replace(check, free=state.problem.free)
    others = [log.name for log in case.check_logs]
    return fits, fit_stretches(check, state.point, case.check, others, stretch)


def _errors(
    loop: Loop,
    names: tuple[str, ...],
    ways: Mapping[str, Ends],
    plants: Plants,
    scenarios: Scenario,
) -> dict[str, float]:
    """RMS tracking error over plants and scenarios by way, N."""
    out = {}
    for way, ends in ways.items():
        each = tracking_errors(with_bounds(loop, names, *ends), plants, scenarios)
        out[way] = float(np.sqrt(np.mean(each**2)))
    return out


def _paper_unit(name: str, value: float) -> str:
    """A bound as [controller] has it."""
    unit = controller.written_unit(name)
    factor = units.to_si(1.0, unit, controller.si(unit), name)
    return text(float(value) / factor, unit)


def _scenarios(
    spec: RigFile, loop: Loop, logs: tuple[Log, ...]
) -> tuple[Loop, Scenario]:
    """Every log's start as a scenario, of equal length, stacked."""
    for log in logs:
        if "F_d" not in log.signals:
            raise InputError(
                f"{log.name}: no column F_d: bounds are refined on what the loop was "
                "asked for; give logs that have it"
            )
    runs = [rerun(spec, loop, log, MOST_SECONDS) for log in logs]
    scenarios = [scenario for scenario, _ in runs if scenario is not None]
    if not scenarios:
        raise InputError(f"{logs[0].name}: no two seconds without a gap to run again")
    least = min(c.F_d.size for c in scenarios)
    cut = [jax.tree.map(lambda a: a[:least], c) for c in scenarios]
    return runs[0][1], jax.tree.map(lambda *a: jnp.stack(a), *cut)
