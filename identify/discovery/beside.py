"""The rig's own parameters with curves in place: what the logs then say of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from hydrojax.identify.case import Case
from hydrojax.identify.discovery.free_form import coefficients
from hydrojax.identify.discovery.search import above_noise
from hydrojax.identify.discovery.smooth import pull, signal_in
from hydrojax.identify.discovery.with_curves import Search, known_of
from hydrojax.identify.inference.tolerance import with_tolerances
from hydrojax.identify.inference.uncertainty import estimate_uncertainty
from hydrojax.identify.results.outcome import Parameter
from hydrojax.identify.results.parts import parameter_of
from hydrojax.parameters import parameter_specs

BEYOND = -2.0
"""Standard deviations of its chance by which an error must stand above the noise to
count as one of the parameters."""


def parameters_beside(at: Search, case: Case) -> dict[str, Parameter]:
    """The fitted parameters where a search with curves ended, by the names they have in
    a rig file.

    Their intervals count what a curve takes to itself, or leaves to them, beyond what
    the logs tell: see `smooth.pull`. Of what causes an error that stays above the noise
    as much is taken to be hidden in what is fitted, in all of its directions alike.
    """
    state = at.state
    known = known_of(state.problem, at.curves, state.free)
    state = replace(state, problem=replace(state.problem, known=known))
    uncertainty = estimate_uncertainty(
        state.problem, state.point, state.free, _pulls(at)
    )
    uncertainty = with_tolerances(uncertainty, case, state)
    out = {}
    for name, spec in parameter_specs(state.problem.model.rig).items():
        if name in state.free and name not in at.coefficients:
            shown, p = parameter_of(name, case, state, uncertainty, spec)
            effect = name.rpartition(".")[0]
            out[f"{effect}.{shown}" if effect else shown] = p
    return out


def _pulls(at: Search) -> Float[np.ndarray, "free free"]:
    """Covariance of what draws a fit with curves off the truth, by the free parameters
    in units of their scales.
    """
    state = at.state
    names, free = state.problem.model.names, list(state.free)
    columns = [names.index(n) for n in free]
    gram = np.asarray(
        state.problem.sums_at(state.point.values, state.point.weights).gram
    )
    H = gram.sum(axis=0)[np.ix_(columns, columns)]
    inflation = max(at.columns[c.laid.term.name].inflation for c in at.curves)
    left = above_noise(state, inflation, BEYOND)
    out = left / len(free) * H
    others = [n for n in free if n not in at.coefficients]
    priors = known_of(state.problem, (), others)
    held = [free.index(n) for n in priors.names]
    out[np.ix_(held, held)] += priors.curvature
    for curve in at.curves:
        own = coefficients(curve.laid.effect)
        mine = [free.index(n) for n in own]
        knots = np.asarray(curve.laid.effect.knots)
        c = state.point.values[[names.index(n) for n in own]]
        sums = at.columns[curve.laid.term.name]
        out[np.ix_(mine, mine)] += pull(sums, curve.smooth, c, signal_in(knots))
    return out
