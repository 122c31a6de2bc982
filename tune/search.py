"""Gains searched in simulated runs, around the best that was tried.

A descent sees the linearised loop and one run; what speaks against gains shows in all
runs together, on the one plant where it is worst. So the search goes by what all runs
say: towards what can be proposed first, and among that to what reaches its aim best.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc

from hydrojax.tune.objective import Objective
from hydrojax.tune.optimize import from_logs, mean_log, origin, reach
from hydrojax.tune.verification import Tried

WIDE = 36
"""Gains that are tried first, spread evenly."""

DOWN, UP = 100.0, 1.5
"""How far they lie below and above the present gains, at most."""

AROUND = 12
"""Gains that are tried in a round."""

ROUNDS = 10
"""At most."""

BEGIN, END = 0.35, 0.04
"""Spread of the first round, of the logarithm of each group of gains, and the spread
below which no further round is tried."""

WIDER, CLOSER = 1.3, 0.6
"""How the spread changes after a round that found better gains, and after another."""


class Judged(NamedTuple):
    """Gains that were tried, and what is to be said of them.

    Attributes:
        tried: what they give.
        faults: what speaks against proposing them.
        rank: the larger the better; figures are compared one after the other.
    """

    tried: Tried
    faults: tuple[str, ...]
    rank: tuple[float, ...]


def search(
    objective: Objective,
    begin: list[Judged],
    judge: Callable[[list[Float[np.ndarray, "gains"]]], list[Judged]],
    progress: Callable[[str], None],
    seed: int = 0,
) -> list[Judged]:
    """Gains around the best of those that were tried, round by round.

    First gains that are spread evenly over `optimize.reach`, down from the present
    ones: what is proposed may lie far from where a descent ended. Then each round tries
    some at random around the best so far, one of them further along the last step.

    Args:
        objective: whose gains they are.
        begin: those that were tried already; at least one.
        judge: tries gains.
        progress: called with a line of text.
        seed: of the draws.

    Returns:
        All that were tried, those of `begin` first.
    """
    low, high = reach(objective)
    here = origin(objective)
    rng = np.random.default_rng([seed, 32])

    def gains_at(logs: np.ndarray) -> list[np.ndarray]:
        return [from_logs(objective, here, each) for each in np.clip(logs, low, high)]

    progress("search in runs")
    even = qmc.LatinHypercube(low.size, rng=rng).random(WIDE)
    far = np.maximum(low, -np.log(DOWN))
    out = [*begin, *judge(gains_at(far + even * (np.log(UP) - far)))]
    best, spread, step = max(out, key=_rank), BEGIN, np.zeros(low.size)
    y = np.clip(mean_log(objective, best.tried.gains / here), low, high)
    for i in range(ROUNDS):
        if spread < END:
            break
        progress(f"search in runs, round {i + 1} of at most {ROUNDS}")
        drawn = y + spread * rng.normal(size=(AROUND, low.size))
        drawn[0] = y + step + (0.0 if step.any() else drawn[0] - y)
        found = judge(gains_at(drawn))
        out += found
        k = max(range(AROUND), key=lambda k: found[k].rank)
        better = found[k].rank > best.rank
        spread *= WIDER if better else CLOSER
        step = drawn[k] - y if better else np.zeros(low.size)
        if better:
            best, y = found[k], np.clip(drawn[k], low, high)
    return out


def _rank(judged: Judged) -> tuple[float, ...]:
    return judged.rank
