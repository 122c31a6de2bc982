"""From a result to the curves that it lacks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hydrojax.identify.case import Case
from hydrojax.identify.discovery.beside import parameters_beside
from hydrojax.identify.discovery.free_form import (
    FORMS,
    PISTON,
    SLIPS,
    TERMS,
    FreeCommand,
    deflection_name,
)
from hydrojax.identify.discovery.laid import laid_over
from hydrojax.identify.discovery.search import search
from hydrojax.identify.discovery.shown import found_curves
from hydrojax.identify.discovery.with_curves import Search
from hydrojax.identify.estimation.columns import room_of
from hydrojax.identify.estimation.fit import FitPoint, reweighted
from hydrojax.identify.estimation.known import free_effect, free_parameters
from hydrojax.identify.estimation.problem import Problem, in_play
from hydrojax.identify.preparation.data import Data
from hydrojax.identify.preparation.noise import CHANNELS
from hydrojax.identify.results.outcome import Outcome
from hydrojax.identify.tracing.state import Tracing
from hydrojax.parameters import specs
from hydrojax.plant.friction import run_linear, run_stop
from hydrojax.plant.places import PLACES
from hydrojax.plant.replay import Motion, friction_memory
from hydrojax.plant.rig import Rig
from hydrojax.rigfile.build import build_rig, effects_of


def begun(
    case: Case, outcome: Outcome, progress: Callable[[str], None] = lambda _: None
) -> Search:
    """A search that stands where a fit or a trace ended, every free form dormant.

    A fit that held k_cp and k_cn equal did so by what it could tell while something was
    missing: with a curve in place the logs may tell them apart, and nothing holds them.
    """
    found = outcome.in_model
    rig = build_rig(case.spec, found, [form() for form in FORMS])
    free = free_parameters(case.spec)
    for name, effect in effects_of(found, case.spec).items():
        free |= free_effect(name, specs(effect))
    noise = case.check.noise.copy()
    for i, name in enumerate(CHANNELS):
        if name in outcome.channels:
            noise[i] = outcome.channels[name].noise
    # What was found moves the fitted logs' noise by as much as that of the others.
    seen, own = np.isfinite(noise), case.fit.noise.copy()
    own[seen] *= noise[seen] / case.check.noise[seen]
    problem = Problem.of(rig, free, replace(case.fit, noise=own), case.criteria)
    check = Problem.of(rig, free, replace(case.check, noise=noise), case.criteria)
    check = replace(check, least=room_of(problem.batch))
    use = in_play(problem, case.fit)
    every = dict(free)
    for form in FORMS:
        every |= free_effect(form.name, specs(form))
    problem = replace(problem, free=every)
    values = np.array(problem.model.values)
    for i, name in enumerate(problem.model.names):
        values[i] = outcome.values.get(name, values[i])
    problem = replace(problem, batch=problem.started(values))
    rms = problem.rms(problem.errors_at(values))
    weights = reweighted(own, rms, case.criteria.reweighted_above)
    point = FitPoint(values, weights, 0, True)
    return Search(Tracing(problem, check, {}, use, point, progress))


def samples_of(data: Data, rig: Rig) -> dict[str, Float[np.ndarray, "rows"]]:
    """What prepared logs hold of every signal that a curve may be over, SI.

    Pressures are the measured ones; the bristle's deflection is the rig's. Where the
    output force is not measured but declared, the drive force stands for it: a curve
    over that would explain the residual by itself, and it is none of the signals.
    """
    w = data.windows
    lead = w.x.shape[1] - w.measured.shape[1]

    def rows(y) -> Float[np.ndarray, "rows"]:
        return np.asarray(y)[:, lead:].ravel()

    P_1, P_2 = rows(w.P_a1), rows(w.P_a2)
    past = friction_memory(rig, data.motion)
    now = past.within(w)
    out = {"v": rows(w.v), "x": rows(w.x), "a": rows(w.a), "t": rows(w.t)}
    out["z"] = rows(now.z)
    if now.turned:
        seen = (now.turned.since, now.turned.way, *now.turned.ages)
        names = list(PISTON)[-len(seen) :]
        out |= {name: rows(y) for name, y in zip(names, seen, strict=True)}

    def within(y) -> Float[np.ndarray, "rows"]:
        return rows(past._replace(slips=(y,)).within(w).slips[0])

    remembered = deflections(data.motion)
    out |= {deflection_name(slip): within(y) for slip, y in remembered}
    if data.driven_by == "u" or np.ptp(rows(w.F)) > 0:
        out["F"] = rows(w.F)
        out |= {"P_mean": (P_1 + P_2) / 2, "P_net": P_2 - P_1}
        if data.driven_by in ("u", "pressures"):
            out |= {"P_a1": P_1, "P_a2": P_2}
    elif data.driven_by == "pressures":
        out["P_mean"] = (P_1 + P_2) / 2
    if data.driven_by == "u":
        out |= {"u": rows(w.u), "P_s": rows(w.P_s), "P": np.r_[P_1, P_2]}
        out |= {name: within(y) for name, y in commanded(data.motion)}
    return out


def deflections(
    motion: Motion,
) -> Iterator[tuple[float, Float[np.ndarray, "segments n"]]]:
    """Of every `SLIPS` that the motion reaches, the deflection at the ticks."""
    dx, start = jnp.moveaxis(jnp.asarray(motion.dx), -1, 0), jnp.zeros(len(motion.dx))
    for slip in SLIPS:
        w = np.asarray(run_stop(dx, jnp.asarray(slip), start))
        if np.any(w == slip) and np.any(w == -slip):
            yield slip, np.pad(w, ((0, 0), (1, 0)))


def commanded(
    motion: Motion,
) -> Iterator[tuple[str, Float[Array, "segments n"]]]:
    """What the command's curves remember of it, at the ticks: of every play that the
    command crosses, and of the lags.
    """
    u, start = jnp.asarray(motion.u), jnp.asarray(motion.u[:, 0])
    h = jnp.asarray(motion.h)
    for term in TERMS:
        if term.form is FreeCommand and term.slip:
            moves = jnp.diff(u, axis=1)[None]
            w = run_stop(moves, jnp.asarray(term.slip), 0 * start)
            if jnp.any(w == term.slip) and jnp.any(w == -term.slip):
                yield term.sampled, jnp.pad(w, ((0, 0), (1, 0)))
        elif term.form is FreeCommand and term.tau:
            keep = jnp.exp(-h / term.tau)
            y = run_linear(keep, (1 - keep) * u[:, :-1], start)
            y = jnp.concatenate([start[:, None], y], axis=1)
            yield term.sampled, y - u


def searched(
    case: Case, outcome: Outcome, progress: Callable[[str], None] = lambda _: None
) -> tuple[Search, Outcome]:
    """A fit or a trace with the curves that it lacks, by the rule of the named effects.

    Returns:
        Where the search ended, and the outcome with its curves.
    """
    start = begun(case, outcome, progress)
    rig = start.state.problem.model.rig
    fit, check = (samples_of(data, rig) for data in (case.fit, case.check))
    both = {name: own for name, own in fit.items() if name in check}
    laid = laid_over(both, start.state.named, case.spec.effects)
    if not start.state.problem.simulate:  # pressures that are given follow no flow
        laid = [o for o in laid if not PLACES[o.term.place].hydraulic]
    end = search(start, laid)
    curves = found_curves(end, start, case, fit, check)
    if not curves:
        said = (
            f"{len(laid)} curves, over every signal at every place, were tried for "
            "what the known effects leave: none lowers the validation error enough"
        )
        return end, replace(outcome, notes=(*outcome.notes, said))
    beside = parameters_beside(end, case)
    gone = {n.rpartition(".")[0] for n in set(start.state.free) - set(end.state.free)}
    notes = (
        f"with the curves {name} is not in the model: its straight line is the curve's"
        for name in sorted(gone)
    )
    outcome = replace(outcome, notes=(*outcome.notes, *notes))
    return end, replace(outcome, curves=curves, beside=beside)
