"""Gains searched in simulated runs: all that speaks against them shows there.

A descent sees the linearised loop and one run. What stands in the way of its gains is
often another run, on one plant, so the search goes by all of them: first towards gains
that keep every limit, then to where they reach what is aimed at best.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import optimize
from scipy.stats import qmc

from hydrojax.tune.objective import Objective
from hydrojax.tune.optimize import from_logs, mean_log, origin, reach
from hydrojax.tune.verification import Tried

WIDE = 18
"""Gains that are tried first in each of `SPREADS`, spread evenly."""

SPREADS = ((100.0, 1.5), (3.0, 3.0))
"""How far they lie below and above the present gains, at most: what is proposed may lie
far below, where a fast loop is unstable, or near by on either side."""

AROUND = 6
"""Gains that are tried in a round."""

ROUNDS = 20
"""At most."""

BEGIN, END = 0.35, 0.02
"""How far the first round goes, of the logarithm of each group of gains, and how far
none goes any more."""

FARTHER, CLOSER = 1.5, 0.6
"""How far the next goes after a round that found better gains, and after another."""

STRIDES = (1.0, 0.5)
"""Of that, how far gains may lie that a model of what was tried around promises."""

NEAR = 3.0
"""Of that, from how far away what was tried counts for the model."""

MOST = 3.0
"""Where the logarithm of how far a limit is exceeded is cut off: what goes on from
there says nothing of what is near."""

INSIDE = 0.02
"""How far inside its limits the model looks for gains, of their logarithms."""

PENALTY = 30.0
"""What a limit exceeded e times costs, of what is aimed at."""


class Judged(NamedTuple):
    """Gains that were tried, and what is to be said of them.

    Attributes:
        tried: what they give.
        faults: what speaks against proposing them.
        over: of each limit, the logarithm of how far it is exceeded; kept up to 0.
        wanted: the same of what is wanted, and need not be kept.
        aim: what is to be as large as it can be.
    """

    tried: Tried
    faults: tuple[str, ...]
    over: Float[np.ndarray, "limits"]
    wanted: float
    aim: float

    @property
    def rank(self) -> tuple[float, bool, float]:
        """By which gains are compared: the larger the better, figure by figure."""
        return (-max(float(np.max(self.over)), 0.0), self.wanted <= 0, self.aim)

    @property
    def limits(self) -> Float[np.ndarray, "limits"]:
        """What must be kept and, last, what is wanted, cut off."""
        return np.clip([*self.over, self.wanted], -MOST, MOST)


def search(
    objective: Objective,
    begin: list[Judged],
    judge: Callable[[list[Float[np.ndarray, "gains"]]], list[Judged]],
    progress: Callable[[str], None],
    seed: int = 0,
) -> list[Judged]:
    """Gains around the best of those that were tried, round by round.

    First gains that are spread evenly about the present ones and down from them: what
    is proposed may lie far from where a descent ended. Then rounds of sequential linear
    programming: a model of all limits, fitted to what was tried near the best so far,
    says which gains keep them and reach most; some at random keep the model alive.

    Args:
        objective: whose gains they are; they stay within `optimize.reach`.
        begin: what was tried already.
        judge: tries gains.
        progress: called with a line of text.
        seed: of the draws.

    Returns:
        All that was tried, that of `begin` first.
    """
    low, high = reach(objective)
    here = origin(objective)
    rng = np.random.default_rng([seed, 32])
    found = [*begin]
    logs = [mean_log(objective, j.tried.gains / here) for j in begin]

    def try_all(these: list[Float[np.ndarray, "groups"]]) -> None:
        inside = [np.clip(y, low, high) for y in these]
        logs.extend(inside)
        found.extend(judge([from_logs(objective, here, y) for y in inside]))

    progress("search in runs")
    for down, up in SPREADS:
        even = qmc.LatinHypercube(low.size, rng=rng).random(WIDE)
        least, most = np.maximum(low, -np.log(down)), np.minimum(high, np.log(up))
        try_all(list(least + even * (most - least)))
    best, radius = _best(found), BEGIN
    for i in range(ROUNDS):
        progress(f"search in runs, round {i + 1} of at most {ROUNDS}")
        y = logs[best]
        box = low - y, high - y
        model = _model(np.array(logs) - y, found, best, NEAR * radius)
        drawn = [
            y + step
            for keep in ((slice(None),) if found[best].wanted <= 0 else BOTH)
            for r in STRIDES
            if model and (step := _step(*model, keep, r * radius, box)) is not None
        ]
        rest = AROUND - len(drawn)
        drawn += list(y + radius * rng.uniform(-1, 1, (rest, low.size)))
        try_all(drawn)
        better = _best(found) != best
        best, radius = _best(found), radius * (FARTHER if better else CLOSER)
        if radius < END:
            break
    return found


def _best(found: list[Judged]) -> int:
    return max(range(len(found)), key=lambda i: found[i].rank)


BOTH = (slice(None), slice(None, -1))
"""All limits, and those without what is wanted: it may be out of reach."""

Model = tuple[
    Float[np.ndarray, "limits"],
    Float[np.ndarray, "groups limits"],
    Float[np.ndarray, "groups"],
]
"""The limits where the model stands, their slopes, and the aim's, relative to it."""


def _model(
    away: Float[np.ndarray, "tried groups"],
    found: list[Judged],
    best: int,
    reaches: float,
) -> Model | None:
    """Limits and aim to first order about the best; None where too little was tried
    within `reaches` of it.
    """
    groups = away.shape[1]
    distance = np.max(np.abs(away), axis=1)
    near = np.argsort(distance)[1 : 3 * groups + 1]
    near = near[distance[near] <= reaches]
    centre = found[best]
    if near.size < groups or not np.isfinite(centre.aim):
        return None
    size = max(abs(centre.aim), 1e-3)
    rise = [
        [
            *(found[i].limits - centre.limits),
            np.clip((found[i].aim - centre.aim) / size, -MOST, MOST),
        ]
        for i in near
    ]
    weight = np.exp(-((distance[near] / reaches) ** 2))[:, None]
    # A direction in which nothing was tried has no slope.
    rows = np.vstack([weight * away[near], 1e-2 * np.eye(groups)])
    right = np.vstack([weight * np.array(rise), np.zeros((groups, len(rise[0])))])
    slopes = np.linalg.lstsq(rows, right, rcond=None)[0]
    return centre.limits, slopes[:, :-1], slopes[:, -1]


def _step(
    limits: Float[np.ndarray, "limits"],
    slopes: Float[np.ndarray, "groups limits"],
    aim: Float[np.ndarray, "groups"],
    keep: slice,
    most: float,
    box: tuple[Float[np.ndarray, "groups"], Float[np.ndarray, "groups"]],
) -> Float[np.ndarray, "groups"] | None:
    """Where the model's aim is largest within the limits `keep`, at most `most` off."""
    limits, slopes = limits[keep], slopes[:, keep]
    ends = zip(np.maximum(box[0], -most), np.minimum(box[1], most), strict=True)
    out = optimize.linprog(
        [*-aim, PENALTY],
        A_ub=np.column_stack([slopes.T, -np.ones(limits.size)]),
        b_ub=-limits - INSIDE,
        bounds=[*ends, (0.0, None)],
    )
    return out.x[:-1] if out.success else None
