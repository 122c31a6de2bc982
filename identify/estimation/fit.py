"""Fit a rig's free parameters, in the order of the signal path."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from hydrojax.identify.estimation.balance import balanced
from hydrojax.identify.estimation.columns import thinned
from hydrojax.identify.estimation.problem import PRESSURES, Problem
from hydrojax.identify.estimation.solve import ENOUGH
from hydrojax.identify.estimation.starts import other_ends, placed, stuck
from hydrojax.plant.places import gauge_names


@dataclass(frozen=True)
class FitPoint:
    """Where a fit stands.

    Attributes:
        values: of all parameters of the model, SI.
        weights: each channel's standard deviation that the fit was made with, SI; inf
            where it was not compared.
        steps: of the last fit.
        converged: whether it did.
    """

    values: Float[np.ndarray, "n"]
    weights: Float[np.ndarray, "3"]
    steps: int
    converged: bool


def only(
    noise: Float[np.ndarray, "3"], channels: Bool[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """The noise, with the other channels not compared."""
    return np.where(channels, noise, np.inf)


def reweighted(
    noise: Float[np.ndarray, "3"], rms: Float[np.ndarray, "3"], above: float
) -> Float[np.ndarray, "3"]:
    """The noise, or the misfit of a channel where it is `above` times the noise.

    Given the weight of its noise such a channel would bend the parameters of the
    others: force stands downstream of pressure, and an unknown force would be paid
    for with a wrong bulk modulus.
    """
    return np.where(rms > above * noise, np.maximum(noise, rms), noise)


def in_short(problem: Problem) -> Problem:
    """The problem on some of its windows, spread over the logs: enough to look for
    effects on. Itself where that would not be much less work.
    """
    most = problem.criteria.short_windows
    if not problem.simulate or len(problem.batch.P_0) < 2 * most:
        return problem
    return replace(problem, batch=thinned(problem.batch, most))


def fit_from_balances(
    problem: Problem,
    values: Float[np.ndarray, "n"],
    free: Sequence[str],
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Problem, Float[np.ndarray, "n"]]:
    """`fit_pressures` from where a fit of the flow balances leads, to where all that is
    free is then fitted from: not as far, for of a model that lacks something the last
    steps are most of the work.

    Where that leaves a parameter at an end of its range, a fit from `values` is made
    too, and the better one kept: balances see little of some (a volume, an opening),
    and may put them where no replay comes back from. So is one from there with the
    other shape of an effect that may have either, where something is left: between them
    lies a hill that no fit comes over, and the one drives what else delays to its ends.
    """
    few, own = in_short(problem), problem.criteria
    near = balanced(problem, values, free)
    enough = own.enough_at_first if few is problem else own.enough_in_short
    best = _fit_these_pressures(few, near, free, enough)
    if near is not values and stuck(problem, best[1], few.side(free, True)):
        progress("fit from the rig file's own values too")
        best = _nearer(best, _fit_these_pressures(few, values, free, enough))
    for name, end in other_ends(few, best[1], free):
        if np.all(_left(*best) <= own.at_noise):
            break
        progress(f"fit from the other end of {name} too")
        start = placed(few, values, {name: end})
        best = _nearer(best, _fit_these_pressures(few, start, free, enough))
    if few is problem:
        return best
    return _fit_these_pressures(problem, best[1], free, own.enough_at_first)


Fitted = tuple[Problem, Float[np.ndarray, "n"]]


def _nearer(one: Fitted, other: Fitted) -> Fitted:
    """Which of two leaves less of the pressures; the other if the one has no answer."""
    left = [np.sum(_left(*fit) ** 2) for fit in (one, other)]
    return other if left[1] < left[0] or not np.isfinite(left[0]) else one


def _left(
    problem: Problem, values: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "channels"]:
    """What is left of each pressure, over its noise; 0 of what is not compared."""
    noise = only(np.asarray(problem.batch.noise), PRESSURES)
    return problem.rms(problem.errors_at(values)) / noise


def fit_all(
    problem: Problem, values: Float[np.ndarray, "n"], free: Sequence[str]
) -> tuple[Problem, FitPoint]:
    """Fit the free parameters to all channels, in the order of the signal path.

    Hydraulics on the pressures alone, then the mechanics, then all together with each
    channel at the weight it has earned. Returns the problem with its windows'
    initial pressures brought up to date, and the fit.
    """
    if problem.sees_pressures and problem.side(free, True):
        problem, values = fit_pressures(problem, values, free)
    return fit_force(problem, values, free)


def fit_force(
    problem: Problem, values: Float[np.ndarray, "n"], free: Sequence[str]
) -> tuple[Problem, FitPoint]:
    """The second half of `fit_all`, from hydraulics that fit the pressures already."""
    noise = np.asarray(problem.batch.noise)
    weights, above = noise, problem.criteria.reweighted_above
    mechanical = problem.side(free, False)
    if problem.sees_pressures and mechanical and np.isfinite(noise[2]):
        # Pressures that are off would be paid for by friction: weigh, then fit.
        _, out = problem.solve(values, (), noise)
        weights = reweighted(noise, problem.rms(out.also.sse), above)
        values, out = problem.solve(values, mechanical, weights)
        problem = problem.restarted(out.also, values)
        weights = reweighted(noise, problem.rms(out.also.sse), above)
    return fit_jointly(problem, values, free, weights)


def fit_blind(
    problem: Problem,
    starts: Sequence[Float[np.ndarray, "n"]],
    free: Sequence[str],
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Problem, FitPoint]:
    """`fit_force` where no pressure is measured: from one start after the other until
    the force is at its noise, or what leaves least of it. Where initial pressures are
    guesses too, a volume may end at 0 from starts that looked as good as any.
    """
    noise, best, least = np.asarray(problem.batch.noise)[2], None, np.inf
    for i, values in enumerate(starts):
        if i:
            progress("fit the declared model from another start")
        fitted = fit_force(problem, values, free)
        left = fitted[0].rms(fitted[0].errors_at(fitted[1].values))[2] / noise
        if best is None or left < least:
            best, least = fitted, left if np.isfinite(left) else np.inf
        if least <= problem.criteria.at_noise:
            break
    assert best is not None, "there is one start at least"
    return best


def fit_on(
    problem: Problem, values: Float[np.ndarray, "n"], free: Sequence[str]
) -> tuple[Problem, FitPoint]:
    """Fit everything free to the end, from where a fit to some of the windows, or one
    that did not go as far, has led: all at once, each channel at the weight it earns
    there. Its hydraulics need not be fitted by themselves again.
    """
    problem = replace(problem, batch=problem.started(values))
    rms = problem.rms(problem.errors_at(values))
    noise = np.asarray(problem.batch.noise)
    weights = reweighted(noise, rms, problem.criteria.reweighted_above)
    return fit_jointly(problem, values, free, weights)


def fit_jointly(
    problem: Problem,
    values: Float[np.ndarray, "n"],
    free: Sequence[str],
    weights: Float[np.ndarray, "3"],
) -> tuple[Problem, FitPoint]:
    """Fit everything free at once from nearby, each channel at its weight."""
    noise, own = np.asarray(problem.batch.noise), problem.criteria
    seen = np.isfinite(noise)
    before = np.inf
    rounds = own.blind_rounds if problem.blind else own.weight_rounds
    for left in reversed(range(rounds)):
        values, out = problem.solve(values, free, weights)
        problem = problem.restarted(out.also, values)
        rms = problem.rms(out.also.sse)
        earned = reweighted(noise, rms, own.reweighted_above)
        same = np.allclose(earned[seen], weights[seen], rtol=own.weights_settled)
        # Without pressures to see, where the windows begin moves on with the fit.
        moves = problem.blind and rms[2] < own.blind_progress * before
        if left == 0 or (same and not moves):
            return problem, FitPoint(
                values, weights, int(out.steps), bool(out.converged)
            )
        weights, before = earned, rms[2]
    raise AssertionError("the last round returns")


def fit_pressures(
    problem: Problem,
    values: Float[np.ndarray, "n"],
    free: Sequence[str],
    enough: float = ENOUGH,
) -> tuple[Problem, Float[np.ndarray, "n"]]:
    """Fit the free parameters that the pressures see, on the pressures alone; where the
    windows are many, on some of them first. `enough` is the share of the cost below
    which a step is not worth taking.
    """
    few = in_short(problem)
    if few is not problem:
        values = _fit_these_pressures(few, values, free, enough)[1]
    return _fit_these_pressures(problem, values, free, enough)


def _fit_these_pressures(
    problem: Problem,
    values: Float[np.ndarray, "n"],
    free: Sequence[str],
    enough: float = ENOUGH,
) -> tuple[Problem, Float[np.ndarray, "n"]]:
    """`fit_pressures` on all windows of the problem at once."""
    noise = only(np.asarray(problem.batch.noise), PRESSURES)
    gauges = gauge_names(problem.model.rig)
    own = problem.side(free, True)
    names = (*own, *(n for n in free if n in gauges and n not in own))
    settled = problem.criteria.pressures_settled * np.min(noise)
    for _ in range(problem.criteria.weight_rounds):
        values, out = problem.solve(values, names, noise, enough)
        problem = problem.restarted(out.also, values)
        if np.median(np.abs(out.also.start[:, :2, -1])) < settled:
            break
    return problem, values
