"""Terms laid over what the logs hold of their signals, and put into a model."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import numpy as np
from jaxtyping import Float

from hydrojax.effects.splines import knots_over
from hydrojax.identify.checking.balances import EDGES
from hydrojax.identify.discovery.free_form import (
    COUNT,
    FACTORS,
    PISTON,
    TERMS,
    FreeForm,
    Term,
)
from hydrojax.identify.estimation.problem import Problem

STRAIGHT = {"free_force_F": "loadcell_gain"}
"""Curves whose straight line a known effect is: a fit of both would trade one for the
other without end. Where the rig file declares the effect the curve is not laid; where
it was found it goes when the curve comes.
"""

Samples = Mapping[str, Float[np.ndarray, "rows"]]
"""What the logs hold of each signal, by its name, SI."""


@dataclass(frozen=True)
class Laid:
    """A term, and its effect over the logs' own range."""

    term: Term
    effect: FreeForm


def laid_over(
    samples: Samples, values: Mapping[str, float], declared: Collection[str] = ()
) -> list[Laid]:
    """Every term whose signal the logs move, and whose factor they have, over their
    range; what a valve does by its coefficients among the rig's `values`, or not where
    a valve of another kind has none. None that is one of the `declared` effects, but
    for its bends.
    """
    out, edges = [], tuple(values[name] for name in EDGES if name in values)
    for term in TERMS:
        if STRAIGHT.get(term.name) in declared:
            continue
        if term.factor in FACTORS:
            if len(edges) < len(EDGES):
                continue
            term = replace(term, edges=edges)
        if term.factor in PISTON and term.factor not in samples:
            continue
        rows = samples.get(term.sampled)
        if rows is not None and np.ptp(np.quantile(rows, [0.01, 0.99])) > 0:
            out.append(Laid(term, term.laid(knots_over(rows, COUNT))))
    return out


def with_laid(problem: Problem, effects: Sequence[FreeForm]) -> Problem:
    """The problem whose free forms at these effects' places are these."""
    rig = problem.model.rig
    for effect in effects:
        place = [effect if type(e) is type(effect) else e
                 for e in getattr(rig, effect.place)]  # fmt: skip
        rig = eqx.tree_at(
            lambda r, p=effect.place: getattr(r, p),
            rig,
            tuple(place),
            is_leaf=lambda x: isinstance(x, tuple),
        )
    return replace(problem, model=problem.model._replace(rig=rig))
