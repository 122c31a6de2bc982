"""What effects that are too small to be named would move the parameters by.

An effect whose score is beyond chance and that lowers no error by as much as matters
is left out, and what of it the fitted columns can follow goes into these: the bias of
an omitted variable (J. M. Wooldridge, Econometric Analysis of Cross Section and Panel
Data, 2010, 4.3). A long log tells a parameter to a ten-thousandth, and such an effect
may move it by a per cent.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrojax.identify.estimation.starts import placed
from hydrojax.identify.inference.uncertainty import Uncertainty
from hydrojax.identify.tracing.score import family, score
from hydrojax.identify.tracing.screen import (
    projected,
    size_that_matters,
    strength_columns,
)
from hydrojax.identify.tracing.state import Tracing


def with_omitted(uncertainty: Uncertainty, state: Tracing) -> Uncertainty:
    """The uncertainty with what omitted effects would move the parameters by, counted
    as a standard deviation, of a fit that is at its noise.
    """
    inside, model = uncertainty.inside, state.problem.model
    moved = _moves(state) if inside else {}
    if not moved:
        return uncertainty
    at = [state.free.index(n) for n in inside]
    sizes = model.scale[[model.names.index(n) for n in inside]]
    by = np.stack([m[at] * sizes for m in moved.values()], axis=1)
    before = np.sqrt(np.maximum(np.diag(uncertainty.covariance), 0.0))
    bent = np.abs(by) > before[:, None]
    limits = list(uncertainty.limits)
    if np.any(bent):
        effects = [n for i, n in enumerate(moved) if bent[:, i].any()]
        own = [n for i, n in enumerate(inside) if bent[i].any()]
        limits.append(_said(effects, own))
    return replace(uncertainty.widened(by), limits=tuple(limits))


def _moves(state: Tracing) -> dict[str, np.ndarray]:
    """By how much each omitted effect moves what is free, in units of the scales.

    One by one, the clearest first, each with those before it in the model: what is
    missing shows in many candidates. Those that show nearly as much as the clearest
    may be it, and count too.
    """
    own, noise = state.criteria, state.noise
    p = family(state.scores, own)
    added = {a.name for a in state.added}
    rest = {n: state.effects[n] for n in p if n not in added and p[n] < own.level}
    if not rest:
        return {}
    weights = np.where(np.isfinite(noise), state.point.weights, np.inf)
    shapes = {n: v for e in rest for n, v in state.scores[e].shape.items()}
    values = placed(state.problem, state.point.values, shapes)
    names, projection = projected(state, rest, values, weights)
    matters = size_that_matters(state, noise)
    moves: dict[str, np.ndarray] = {}
    while rest:
        columns = {n: strength_columns(names, e) for n, e in rest.items()}
        scores = {
            n: score(projection, n, *c, matters, own.level) for n, c in columns.items()
        }
        p = family(scores, own)
        most = max(scores.values(), key=lambda s: s.gain)
        near = [s for s in scores.values() if s.gain >= own.near_best * most.gain]
        for s in near:
            if p[s.name] < own.level and s.name not in moves:
                through = projection.through[: len(state.free), columns[s.name][0]]
                moves[s.name] = -through @ s.step
        if p[most.name] >= own.level:
            return moves
        projection = projection.beside(columns[most.name][0])
        del rest[most.name]
    return moves


def _said(effects: list[str], names: list[str]) -> str:
    one = len(effects) == 1
    return (
        f"{_listed(effects)} {'shows' if one else 'show'} in these logs beyond "
        "chance, by too little to matter for the errors: what "
        f"{'it' if one else 'each'} would move {_listed(names)} by is more than "
        "their own standard deviation, and is counted into the intervals"
    )


def _listed(names: list[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last
