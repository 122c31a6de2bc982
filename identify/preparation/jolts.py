"""Where a position is logged too slowly to say how it moved from row to row."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import interpolate, ndimage

from hydrojax.logs.log import Log
from hydrojax.parameters import get
from hydrojax.plant.rig import Rig
from hydrojax.rigfile.recording import position
from hydrojax.rigfile.schema import RigFile

SURE = 6.0
"""Times what every other row is usually off a spline through the rest from which it is
more than noise. A choice: one row in 5e8 of normal noise is as far off."""
SHOWS = 3.0
"""Times a pressure's noise from which it shows there that a position is not known."""
COARSER = 4.0
"""By how much a spline through every other row is further off than one through all: a
kink's share, the square of the step."""
BESIDE = 3
"""Rows to either side that are left out with one."""
LASTING = 3.0
"""Seconds of a stretch that is worth keeping: friction and valve settle in it first."""
ENOUGH = 0.5
"""Share of a log's rows that such stretches keep: of one that lacks more, nothing is
left out."""
FEWEST = 24
"""Rows of a stretch that is looked at."""


def without_jolts(
    log: Log, spec: RigFile, rig: Rig, noise: Float[np.ndarray, "3"]
) -> Log:
    """The log without rows between which the piston moved in a way that they do not
    tell: a valve that shuts shakes a load within 10 ms, and the oil answers each
    micrometre. The log itself where there are none, or too many.

    Every other row is held against a spline through the rest: a kink between two rows
    shows there four times as large as between all of them.

    Args:
        log: whose position drives a replay.
        spec: the rig file.
        rig: as it declares it.
        noise: of the channels, SI.
    """
    quiet = np.min(noise[:2])
    if not np.isfinite(quiet) or "chamber_length" not in spec.geometry:
        return log
    beta, *deltas = (float(v) for v in get(rig, ("beta", "delta_1", "delta_2")))
    shorter = spec.geometry["chamber_length"] / 2 + min(deltas)
    least = COARSER * SHOWS * quiet * shorter / beta
    x, out = position(log, spec), np.zeros(len(log.time), dtype=bool)
    for start, stop in log.segments:
        if stop - start < FEWEST:
            continue
        off = np.abs(_off_the_others(log.time[start:stop], x[start:stop]))
        usual = np.median(off) / 0.6745
        out[start:stop] = off > max(SURE * usual, least)
    out = ndimage.binary_dilation(out, iterations=BESIDE)
    pieces = tuple(
        (start + int(a), start + int(b))
        for start, stop in log.segments
        for a, b in _runs(np.logical_not(out[start:stop]))
    )
    seconds = [log.time[b - 1] - log.time[a] for a, b in pieces]
    kept = sum(b - a for (a, b), s in zip(pieces, seconds, strict=True) if s > LASTING)
    if not out.any() or kept < ENOUGH * len(log.time):
        return log
    note = (
        f"rows left out, as they do not tell how {log.motion} moved between them: "
        f"{out.sum()}"
    )
    return replace(log, segments=pieces, notes=(*log.notes, note))


def _off_the_others(
    t: Float[np.ndarray, "rows"], x: Float[np.ndarray, "rows"]
) -> Float[np.ndarray, "rows"]:
    """How far each row is off a spline through every other one beside it, m."""
    off = np.zeros(len(t))
    for first in (0, 1):
        through = interpolate.make_interp_spline(t[first::2], x[first::2], k=5)
        left = slice(1 - first, None, 2)
        off[left] = x[left] - through(t[left])
    off[:6] = off[-6:] = 0.0  # a spline's ends
    return off


def _runs(own: Bool[np.ndarray, "rows"]) -> Int[np.ndarray, "runs 2"]:
    """Where runs of rows begin and end."""
    return np.flatnonzero(np.diff(np.pad(own, 1))).reshape(-1, 2)
