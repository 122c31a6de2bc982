"""Of the gains that descents found, those that hold in runs: what is proposed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hydrojax.control.base import RATES
from hydrojax.tune.aims import TOLERANCE, Following, Magnitude
from hydrojax.tune.objective import Objective
from hydrojax.tune.optimize import Optimum
from hydrojax.tune.search import Judged, search
from hydrojax.tune.trials import MOVING
from hydrojax.tune.verification import (
    DECIBELS,
    PEAK_SLACK,
    Tried,
    against,
    beyond,
    checks,
    run_trials,
)

BLENDS = (0.75, 0.5, 0.25, 0.1)
"""Shares of the way from the present gains to those found, in logarithms."""

SLOWER = (0.1, 0.01)
"""Factors on the rates of adaptation that are tried with the gains found."""

CALM = 0.7
"""How much of what counts as an oscillation the search lets pass: on another plant, or
with other noise, there is more of it."""

NEAR_FIRST = 1.1
"""How much larger the errors of what is searched may be than those of the descents'
gains: a band may grow at the price of all that lies in it."""

NEARER = 0.9
"""Where there is no band, before and after, the share of the error that may be left."""

BANDS = (Following, Magnitude)
"""Aims that are bands, and 0 where there is none."""

NARROWER = 0.98
"""Least share of what is aimed at before that a proposal must reach; and of what the
best reaches, from which gains that track better are taken in its place."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """What is proposed, and what speaks against the rest.

    Attributes:
        before: the present gains, tried.
        after: the gains proposed; the present ones where none is.
        obstacles: what stands in the way, where none is proposed.
        tried: all that were, and what is to be said of them.
    """

    before: Tried
    after: Tried
    obstacles: tuple[str, ...]
    tried: tuple[Judged, ...]

    @property
    def found(self) -> bool:
        """Whether gains are proposed."""
        return not self.obstacles


def tolerance_of(objective: Objective) -> float:
    """Of |1 - F/F_d|: the aim's, if it has one."""
    aim = objective.aim
    return aim.tolerance if isinstance(aim, Following) else TOLERANCE


def candidates(objective: Objective, optimum: Optimum) -> list[np.ndarray]:
    """What is tried: the ends of all descents, half ways, and slower adaptation."""
    start = objective.initial()
    low = np.where(start > 0, start, 1.0)
    way = np.where(start > 0, np.log(np.maximum(optimum.gains, 1e-300) / low), 0.0)
    rates = np.array([q.name in RATES for q in objective.free])
    blends = [
        np.where(start > 0, low * np.exp(f * way), f * optimum.gains) for f in BLENDS
    ]
    slower = [np.where(rates, f * optimum.gains, optimum.gains) for f in SLOWER]
    return [optimum.gains, *optimum.others, *blends, *(slower if rates.any() else ())]


def try_before(objective: Objective, most: float) -> Tried:
    """The present gains, tried; `most` is the highest band that is promised, Hz."""
    start = objective.initial()
    return run_trials(objective, [start], most, tolerance_of(objective))[0]


def propose(
    objective: Objective, optimum: Optimum, before: Tried, most: float,
    progress: Callable[[str], None],
) -> Proposal:  # fmt: skip
    """Try gains on all plants; the best of those that nothing speaks against.

    What the descents found is tried first, and then searched on from in the runs
    themselves: for more of what is aimed at, but with errors that stay near those of
    the descents' best that holds. The present gains are among those searched on from:
    they may keep all limits where no end of a descent does. Gains that keep the limit
    on the peak at both amplitudes come before those whose peak is only no higher than
    before. Of those that reach about as much, the ones that track best are proposed.

    Args:
        objective: plants, trials and aim.
        optimum: what the descents found.
        before: the present gains, tried.
        most: the highest band that is promised, Hz.
        progress: called with a line of text.
    """
    tolerance = tolerance_of(objective)

    def judge(these: list[np.ndarray], first: Tried | None = None) -> list[Judged]:
        tried = run_trials(objective, these, most, tolerance)
        return [judged(objective, t, before, first) for t in tried]

    these = candidates(objective, optimum)
    progress(f"try {len(these)} proposals in runs")
    begin = judge(these)
    good = [j for j in begin if not j.faults]
    first = max(good, key=lambda j: j.rank).tried if good else None
    begin = [
        judged(objective, t, before, first) for t in (*(j.tried for j in begin), before)
    ]
    found = search(objective, begin, lambda these: judge(these, first), progress)
    # The present gains are no proposal.
    found = [j for j in found if j.tried is not before]
    good = [j for j in found if not j.faults]
    best = max(good or found, key=lambda j: j.rank)
    if good:
        best = min(_alike(good, best), key=lambda j: _errors(j.tried))
    after = best.tried if good else before
    return Proposal(before, after, best.faults, tuple(found))


def judged(
    objective: Objective, tried: Tried, before: Tried, first: Tried | None = None
) -> Judged:
    """What speaks against gains, and how good they are.

    The search lets only `CALM` of what counts as an oscillation pass, and of the worst
    plant's errors no more than `NEAR_FIRST` times those of `first`, where it is given.
    """
    was, now = _reached(objective, before), _reached(objective, tried)
    towards = _reached(objective, tried.averaged())
    faults = (
        *against(objective, tried, before),
        *_narrower(objective, now, before, was),
    )
    over = [float(c.over.max()) for c in checks(objective, tried, before, CALM)]
    for name in ("rms", "rms_moving", "small_moving") if first else ():
        most = NEAR_FIRST * np.max(getattr(first, name))
        over.append(float(beyond(np.max(getattr(tried, name)), most)))
    steep = float(tried.peak.max()) - (objective.limits.peak_dB + PEAK_SLACK)
    return Judged(tried, faults, np.array(over), steep / DECIBELS, now, towards)


def _alike(good: list[Judged], best: Judged) -> list[Judged]:
    """Those that reach as much as the best, and keep as many limits."""
    least = best.aim - (1 - NARROWER) * abs(best.aim)
    kept = best.rank[:2]
    return [j for j in good if j.rank[:2] == kept and j.aim >= least]


def _errors(tried: Tried) -> float:
    """Tracking errors of the worst plants, as one: the sum of their logarithms."""
    each = (tried.rms, tried.rms_moving, tried.small_moving)
    return float(sum(np.log(np.max(e)) for e in each))


def _reached(objective: Objective, tried: Tried) -> float:
    """What is aimed at; where none of it is reached, less than nothing by the error of
    the moving joint, as a share of the desired force: of gains that all have no band
    those that track better are nearer to one.
    """
    reached = objective.aim.measured(tried.figures(None))
    if reached > 0 or not isinstance(objective.aim, BANDS):
        return reached
    return -float(np.max(tried.rms_moving)) / objective.trials.amplitude[MOVING]


def _narrower(
    objective: Objective, now: float, before: Tried, was: float
) -> tuple[str, ...]:
    """That less of what is aimed at is reached than before, if that was sound; or, of
    a band that there is none of, no more.
    """
    least = was - (1 - NARROWER) * abs(was)
    if was < 0 and isinstance(objective.aim, BANDS):
        least = NEARER * was
    elif not before.sound:
        return ()
    if now >= least:
        return ()
    return (f"no better than before in {objective.aim.description}",)
