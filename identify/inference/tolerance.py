"""Tolerances of the constants that a rig file holds, in every interval of a fit.

A held constant that is off by d moves the estimate by S d, with S = -H^-1 J^T J_c from
the fit's own normal equations: J_c is a column of the model for a parameter, and for
geometry or supply the gradient's difference between two rigs (the step of Gauss and
Newton; G. Seber and C. Wild, Nonlinear Regression, 1989).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from hydrojax.effects import EFFECTS
from hydrojax.identify.estimation.columns import ParametricRig, batch_of
from hydrojax.identify.estimation.problem import Problem
from hydrojax.identify.inference.uncertainty import Uncertainty, curvature
from hydrojax.identify.preparation.data import Data, prepare_logs
from hydrojax.identify.tracing.state import Tracing
from hydrojax.plant.places import PLACES
from hydrojax.rigfile.build import build_rig
from hydrojax.rigfile.schema import RigFile

if TYPE_CHECKING:
    from hydrojax.identify.case import Case

IN_THE_LOGS = ("radius", "x_mid", "P_s", "P_r")
"""Held constants that act through the prepared logs; the others act in the rig."""


def held_tolerances(spec: RigFile) -> dict[str, float]:
    """Standard deviations of the parameters that a rig file holds, by name, SI."""
    entries = dict(spec.parameters)
    for effect, given in spec.effects.items():
        entries |= {f"{effect}.{name}": e for name, e in given.items()}
    return {n: e.tolerance for n, e in entries.items() if e.tolerance}


def with_tolerances(
    uncertainty: Uncertainty, case: Case, state: Tracing
) -> Uncertainty:
    """The uncertainty with what the tolerances of held constants add to it, and the
    noise of the position.

    A position with noise bends an estimate: bristles fade by it. Measured once more it
    bends it once more by as much (simulation extrapolation; J. R. Cook and L. A.
    Stefanski, J. Am. Stat. Assoc. 89, 1994), and that counts as a standard deviation.
    """
    inside = uncertainty.inside
    moved = _moved(case, state, inside) if inside else np.empty((0, 0))
    return uncertainty.widened(moved) if moved.size else uncertainty


def _moved(
    case: Case, state: Tracing, inside: tuple[str, ...]
) -> Float[np.ndarray, "inside constants"]:
    """By how much each constant's tolerance moves the estimate, and the position's
    noise, SI.
    """
    problem, values, weights = state.problem, state.point.values, state.point.weights
    names, scale = problem.model.names, problem.model.scale
    at = np.array([names.index(n) for n in inside])
    H, _ = curvature(problem, state.point, inside)
    gram = np.asarray(problem.sums_at(values, weights).gram).sum(axis=0)
    pulls = [
        gram[at, names.index(n)] * (t / scale[names.index(n)])
        for n, t in held_tolerances(case.spec).items()
    ]

    def gradient(of: Problem) -> np.ndarray:
        return np.asarray(of.sums_at(values, weights).gram).sum(axis=0)[at, -1]

    for key, t in case.spec.tolerances.items():
        shifts = [gradient(_with(case, problem, key, d)) for d in (-t / 2, t / 2)]
        pulls.append(shifts[1] - shifts[0])
    if case.twice is not None:
        once, again = (gradient(_on(problem, data)) for data in case.twice)
        pulls.append(again - once)
    if not pulls:
        return np.empty((0, 0))
    return (
        -np.linalg.lstsq(H, np.stack(pulls, axis=1), rcond=1e-12)[0]
        * (scale[at][:, None])
    )


def _on(problem: Problem, data: Data) -> Problem:
    """The problem on the same windows of other logs."""
    batch = batch_of(data)._replace(noise=problem.batch.noise)
    if batch.P_0.shape == problem.batch.P_0.shape:
        batch = batch._replace(P_0=problem.batch.P_0)
    return replace(problem, batch=batch)


def _with(case: Case, problem: Problem, key: str, by: float) -> Problem:
    """The problem with a constant of geometry or supply moved."""
    spec = case.spec
    if key in spec.supply:
        new = replace(spec, supply=spec.supply | {key: spec.supply[key] + by})
    else:
        new = replace(spec, geometry=spec.geometry | {key: spec.geometry[key] + by})
    if key in IN_THE_LOGS:
        own = case.preparation
        data = prepare_logs(
            case.fit_logs, new, own.horizon, own.noise, own.sign, own.band,
            own.criteria,
        )  # fmt: skip
        batch = batch_of(data)._replace(P_0=problem.batch.P_0)
        return replace(problem, batch=batch)
    there = {n.split(".")[0] for n in problem.model.names if "." in n}
    own = (e for place in PLACES for e in getattr(problem.model.rig, place))
    curves = [e for e in own if e.name in there - set(EFFECTS)]
    rig = build_rig(new, there & set(EFFECTS) - set(spec.effects), curves)
    return replace(problem, model=ParametricRig.of(rig))
