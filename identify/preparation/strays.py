"""Readings that jump away and back, and logs without them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from hydrojax.logs.log import Log, with_holes

STRAY = 20.0
"""Times the step that 999 of 1000 others stay below, or the sensor's least, from which
a reading jumps away, if as far a jump back ends it."""
FEW = 0.1
"""Share of a stretch that one jump away takes at most."""

MAY_STRAY = ("x", "psi", "P_a1", "P_a2", "P_s", "P_r", "P", "F")
"""What is measured. A command may jump as it likes."""


def runs_of(y: Float[np.ndarray, "rows"]) -> Int[np.ndarray, "runs"]:
    """Lengths of the runs of one value, in ticks."""
    turns = np.flatnonzero(np.diff(y) != 0)
    return np.diff(np.concatenate([[-1], turns, [len(y) - 1]]))


def strays_in(
    y: Float[np.ndarray, "rows"], runs: Int[np.ndarray, "runs"]
) -> Bool[np.ndarray, "rows"]:
    """Which readings jump away and back: a loose plug, a lost telegram, a bad cell.

    Between the two jumps, each the other's opposite to a factor of two, stands one
    value. `runs` are the lengths of the runs of one value; see `runs_of`.
    """
    steps = np.diff(y)
    sizes, ends = np.abs(steps), np.cumsum(runs)[:-1]
    if len(ends) < 2:
        return np.zeros(len(y), dtype=bool)
    away, back = steps[ends[:-1] - 1], -steps[ends[1:] - 1]
    back_again = (away * back > 0) & (runs[1:-1] <= FEW * len(y))
    back_again &= np.abs(away) < 2 * np.abs(back)
    back_again &= np.abs(back) < 2 * np.abs(away)
    # Of a coarse sensor that hardly moves most steps are 0: of those that are not.
    moves = sizes[sizes > 0]
    odd = back_again & (np.abs(away) > STRAY * np.median(moves))
    # Where such jumps are many, it is the others that say how far it steps.
    others = np.delete(sizes, np.concatenate([ends[:-1][odd], ends[1:][odd]]) - 1)
    usual = np.quantile(others, 0.999) if len(others) else np.inf
    jumps = odd & (np.abs(away) > STRAY * max(usual, np.min(moves)))
    return np.repeat(np.pad(jumps, 1), runs)


def without_strays(log: Log) -> Log:
    """The log as if those readings were empty cells; itself where there are none, or
    too little would be left.
    """
    strays = {}
    for name in (n for n in MAY_STRAY if n in log.signals):
        own = np.zeros(len(log.time), dtype=bool)
        for rows in (slice(*s) for s in log.segments):
            y = log.signals[name][rows]
            own[rows] = strays_in(y, runs_of(y))
        if own.any():
            strays[name] = own
    if not strays:
        return log
    notes = (
        f"rows left out, as {name} jumps away and back: {own.sum()}"
        for name, own in strays.items()
    )
    cut = with_holes(log, strays, notes)
    return cut if cut.segments else log
