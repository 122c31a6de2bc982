"""Gains searched in simulated runs: all that speaks against them shows there.

A descent sees the linearised loop and one run. What stands in the way of its gains is
often another run, on one plant, so the search goes by all of them: first towards gains
that keep every limit, then to where they reach what is aimed at best. Limits of many
plants leave several separate regions of gains, some of which hold none that keep all: a
few rounds are spent in each of those found, before the best is searched to its end.
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

FEW, MANY = 8, 30
"""Rounds in each region, and in those that are searched on, at most."""

REGIONS = (3, 6)
"""Regions that are looked into where some gains keep all limits, and where none do."""

LAST = 3
"""Regions that are searched on, the best first, until gains keep all limits."""

APART = 1.0
"""How far a region begins from where the search in others ended, in the logarithm of
some group of gains."""

BEGIN, END = 0.35, 0.02
"""How far the first round in a region goes, of the logarithm of each group of gains,
and how far none goes any more."""

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
        towards: the same, of a band over some tolerances: it changes by little where
            the band itself jumps, and the search goes by it.
    """

    tried: Tried
    faults: tuple[str, ...]
    over: Float[np.ndarray, "limits"]
    wanted: float
    aim: float
    towards: float

    @property
    def rank(self) -> tuple[float, bool, float]:
        """By which gains are compared: the larger the better, figure by figure."""
        return (-self._excess, self.wanted <= 0, self.aim)

    @property
    def promise(self) -> tuple[float, bool, float]:
        """By which the search compares them."""
        return (-self._excess, self.wanted <= 0, self.towards)

    @property
    def _excess(self) -> float:
        """How far all limits together are exceeded. The largest alone would not tell
        where some more of them could be kept.
        """
        return float(np.linalg.norm(np.clip(self.over, 0.0, MOST)))

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
    programming in some regions that lie apart: a model of all limits, fitted to what
    was tried near the best there so far, says which gains keep them and reach most;
    some at random keep the model alive. The search goes on in the best region, and,
    while no gains keep all limits, in the next.

    Args:
        objective: whose gains they are; they stay within `optimize.reach`.
        begin: what was tried already.
        judge: tries gains.
        progress: called with a line of text.
        seed: of the draws.

    Returns:
        All that was tried, that of `begin` first.
    """
    tries = _Tries(objective, begin, judge, np.random.default_rng([seed, 32]))
    progress("search in runs")
    for down, up in SPREADS:
        tries.spread(down, up)
    regions: list[list[int]] = []
    while len(regions) < REGIONS[0 if tries.holds else 1]:
        begins = tries.best_apart([tries.best(region) for region in regions])
        if begins is None:
            break
        progress(f"search in runs, region {len(regions) + 1}")
        regions.append(tries.rounds([begins], FEW))
    regions.sort(key=lambda r: tries.found[tries.best(r)].promise, reverse=True)
    for i, region in enumerate(regions[:LAST]):
        progress(f"search in runs, on in region {i + 1}")
        tries.rounds(region, MANY)
        if tries.holds:
            break
    return tries.found


class _Tries:
    """What was tried: as it was judged, and the logarithms of its groups of gains. A
    region is those that were tried in it, by their places.
    """

    def __init__(
        self,
        objective: Objective,
        begin: list[Judged],
        judge: Callable[[list[Float[np.ndarray, "gains"]]], list[Judged]],
        rng: np.random.Generator,
    ):
        self.objective, self.judge, self.rng = objective, judge, rng
        self.low, self.high = reach(objective)
        self.here = origin(objective)
        self.found = [*begin]
        self.logs = [mean_log(objective, j.tried.gains / self.here) for j in begin]

    @property
    def holds(self) -> bool:
        """Whether nothing speaks against some of it."""
        return any(not j.faults for j in self.found)

    def add(self, these: list[Float[np.ndarray, "groups"]]) -> None:
        """Try these logarithms, within reach."""
        inside = [np.clip(y, self.low, self.high) for y in these]
        self.logs.extend(inside)
        gains = [from_logs(self.objective, self.here, y) for y in inside]
        self.found.extend(self.judge(gains))

    def spread(self, down: float, up: float) -> None:
        """Try `WIDE`, evenly from `down` times below the present to `up` above."""
        even = qmc.LatinHypercube(self.low.size, rng=self.rng).random(WIDE)
        least = np.maximum(self.low, -np.log(down))
        most = np.minimum(self.high, np.log(up))
        self.add(list(least + even * (most - least)))

    def best(self, region: list[int]) -> int:
        """The place of its best."""
        return max(region, key=lambda i: self.found[i].promise)

    def best_apart(self, ended: list[int]) -> int | None:
        """The place of the best that lies apart from all of these, if any does."""
        apart = [
            i
            for i, y in enumerate(self.logs)
            if all(np.max(np.abs(y - self.logs[e])) > APART for e in ended)
        ]
        return self.best(apart) if apart else None

    def rounds(self, region: list[int], most: int) -> list[int]:
        """The region after at most so many rounds more."""
        best, radius = self.best(region), BEGIN
        for _ in range(most):
            if radius < END:
                break
            y = self.logs[best]
            box = self.low - y, self.high - y
            model = _model(np.array(self.logs) - y, self.found, best, NEAR * radius)
            drawn = [
                y + step
                for keep in ((slice(None),) if self.found[best].wanted <= 0 else BOTH)
                for r in STRIDES
                if model and (step := _step(*model, keep, r * radius, box)) is not None
            ]
            rest = AROUND - len(drawn)
            drawn += list(y + radius * self.rng.uniform(-1, 1, (rest, y.size)))
            count = len(self.found)
            self.add(drawn)
            region = [*region, *range(count, len(self.found))]
            now = self.best(region)
            best, radius = now, radius * (FARTHER if now != best else CLOSER)
        return region


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
    if near.size < groups or not np.isfinite(centre.towards):
        return None
    size = max(abs(centre.towards), 1e-3)
    rise = [
        [
            *(found[i].limits - centre.limits),
            np.clip((found[i].towards - centre.towards) / size, -MOST, MOST),
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
