"""Where windows begin, and what each of them and friction's replay are given."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from hydrojax.identify.preparation.segments import Segment
from hydrojax.plant.replay import Motion, Windows

PRE = 60
"""Ticks of command ahead of a window that the log must have."""

LEAD, FEWEST_LEAD = 0.02, 4
"""Seconds at the head of a window that are run but not compared, and ticks at least."""

DRIVEN_LEAD = 20
"""The same in ticks where the pressures drive, at most: it settles sensors only."""

NEAR = 8e-3
"""Seconds around its first tick whose measured pressures give a window's first guess,
8 ticks at most."""

SUBSTEP = 2.5e-3
"""Longest substep of the pressures, s; `tests/identify/test_balance.py` halves it."""

SETTLE = 1.0
"""Seconds at the head of a segment that no window takes: what bristle, filtered speed
and film start from is unknown. Half of it in segments under `SHORT` seconds."""

SHORT = 5.0

MOVED, BY = 0.01, 0.1
"""Share of a segment's travel that the piston has left where it stood by when windows
begin: until then a play, or oil behind a valve that is shut, stands as nobody knows.
Not waited for through more than so much of the segment."""

RUN = 20
"""Windows that follow each other where only some of a log's are taken: friction is
followed through them, and through the seconds ahead, so that memory does not grow with
the length of the log."""

BEYOND = 20
"""Ticks after the last window of a run that its splines are given."""

REST = 0.2
"""Seconds from which a piston that hardly moves is at rest: one that turns round does
so in a tenth of that or less."""

QUARTERS = 4
"""Steps of the bristle per tick."""


def starts_in(
    t: Float[np.ndarray, "ticks"],
    x: Float[np.ndarray, "ticks"],
    T: int,
    pre: int,
    lead: int,
) -> range:
    """First ticks (of the lead) of the windows that tile a segment with times `t` and
    positions `x`.
    """
    settle = SETTLE if t[-1] - t[0] > SHORT else SETTLE / 2
    settled = int(np.searchsorted(t, t[0] + settle))
    moved = int(np.argmax(np.abs(x - x[0]) > MOVED * np.ptp(x)))
    if moved <= BY * t.size:
        settled = max(settled, moved)
    begin = max(settled - lead, pre)
    return range(begin, t.size - lead - T + 1, T)


def spread_runs(
    rows: list[tuple[int, slice]], starts: list[range], most: int, size: int
) -> tuple[list[tuple[int, slice]], list[range]]:
    """Runs of windows spread evenly, each a stretch with what it needs ahead of it.

    `rows` and `starts` are the segments' and their windows'; about `most` windows of
    `size` ticks are kept.
    """
    blocks = [
        (k, own[j : j + RUN])
        for k, own in enumerate(starts)
        for j in range(0, len(own), RUN)
    ]
    count = max(int(most / np.mean([len(own) for _, own in blocks])), 1)
    even = np.linspace(0, len(blocks) - 1, min(count, len(blocks)))
    kept_rows, kept = [], []
    for k, own in (blocks[j] for j in even.round().astype(int)):
        i, of = rows[k]
        ahead = min(own[0], starts[k][0])
        # A little beyond the last window, where a spline is at its end.
        stop = min(of.start + own[-1] + size + BEYOND, of.stop)
        kept_rows.append((i, slice(of.start + own[0] - ahead, stop)))
        kept.append(range(ahead, ahead + own[-1] - own[0] + 1, own.step))
    return kept_rows, kept


def motion(segments: list[Segment], h: float, still: float = 0.0) -> Motion:
    """What friction and the command's path follow through whole segments, whose ticks
    last about `h` s; for friction without what a position moves within `still` m.
    """
    n = max(s.t.size for s in segments)
    u = [np.pad(s.u, (0, n - s.t.size), mode="edge") for s in segments]
    dx = np.zeros((len(segments), n - 1, QUARTERS))
    ticks = np.full((len(segments), n - 1), h)
    speed, v, F = np.zeros(len(segments)), np.zeros((len(segments), n)), []
    for k, s in enumerate(segments):
        step = np.diff(s.t)
        parts = np.arange(QUARTERS + 1) / QUARTERS
        x = s.place(s.t[:-1, None] + step[:, None] * parts)
        dx[k, : step.size] = np.diff(x, axis=1)
        if still:
            rest = max(round(REST / h), 1)
            dx[k, : step.size] = at_rest(dx[k, : step.size], still, rest)
        ticks[k, : step.size] = step
        first = np.abs(dx[k, : max(int(0.2 / h), 2)])
        speed[k] = first.sum() / (first.shape[0] * h)
        v[k, : s.t.size] = s.v
        F.append(np.pad(s.smoothed, (0, n - s.t.size), mode="edge"))
    runs_on = jnp.array([s.runs_on for s in segments])
    one, two = (jnp.asarray([s.P[0, i] for s in segments]) for i in range(2))
    u, dx, ticks, speed, v, F = (
        jnp.asarray(np.array(a)) for a in (u, dx, ticks, speed, v, F)
    )
    return Motion(u, runs_on, dx, ticks, speed, v, F, (one, two))


def at_rest(
    dx: Float[np.ndarray, "ticks parts"], still: float, rest: int
) -> Float[np.ndarray, "ticks parts"]:
    """Displacements along ticks without what a piston at rest is moved by noise.

    It rests where it stays within `still` to either side, m, for `rest` ticks or more;
    there its displacement is what comes through a play as wide. Elsewhere, and where it
    only turns round, it stays as it is.
    """
    path = np.concatenate([[0.0], np.cumsum(dx)])
    size = rest * dx.shape[1]
    # Of the samples from each on.
    span = maximum_filter1d(path, size, origin=-(size // 2))
    span -= minimum_filter1d(path, size, origin=-(size // 2))
    whole = max(len(path) - size + 1, 0)  # a piece may be shorter than a rest
    begins = np.nonzero(span[:whole] <= 2 * still)[0]
    rests = np.zeros(len(path), int)
    np.add.at(rests, begins, 1)
    np.add.at(rests, begins + size - 1, -1)
    moves = np.diff(path)
    inside = np.cumsum(rests)[:-1] > 0
    edges = np.flatnonzero(np.diff(np.pad(inside, 1).astype(int)))
    for begin, end in edges.reshape(-1, 2):
        moves[begin:end] = np.diff(_played(path[begin : end + 1], still))
    return moves.reshape(dx.shape)


def _played(path: Float[np.ndarray, "n"], half: float) -> Float[np.ndarray, "n"]:
    """What follows a path behind a play of twice `half`, from its middle on."""
    at, out = float(path[0]), []
    for low, high in zip((path - half).tolist(), (path + half).tolist(), strict=True):
        at = min(max(at, low), high)
        out.append(at)
    return np.array(out)


def _past(s: Segment, first: int, pre: int) -> tuple[np.ndarray, np.ndarray]:
    """The ticks ahead of a window, s, and the pressures then, Pa.

    Ahead of the segment they are taken to have stood where they began.
    """
    have = min(pre, first)
    lack, usual = (pre - have, 0), float(s.t[first] - s.t[first - 1])
    own = slice(first - have, first)
    h = np.diff(s.t[first - have : first + 1])
    return (
        np.pad(h, lack, constant_values=usual),
        np.pad(s.P[own], (lack, (0, 0)), "edge"),
    )


def cut(
    segments: list[Segment],
    cuts: list[tuple[int, int]],
    T: int,
    pre: int,
    lead: int,
    n: int,
) -> tuple[Windows, Float[np.ndarray, "windows 2"]]:
    """The windows, and a first guess of the pressures where each begins, Pa.

    `cuts` are segments and first ticks there; a window has `lead + T`, each of `n`
    substeps, and the pressures of `pre` ticks ahead of it.
    """
    parts = np.arange(2 * n + 1) / (2 * n)
    columns: dict[str, list] = {name: [] for name in Windows._fields}
    P_0 = []
    for k, first in cuts:
        s = segments[k]
        at = slice(first, first + lead + T)
        t = s.t[at]
        h = np.append(np.diff(t), t[-1] - t[-2])
        fine = t[:-1, None] + h[:-1, None] * parts
        around = int(np.clip(round(NEAR / h[0]), 2, 8))
        near = slice(max(first - around, 0), first + around + 1)
        slope = np.polyfit(s.t[near] - t[0], s.P[near], 1)
        P_0.append(slope[1])
        before_h, P_before = _past(s, first, pre)
        row = {
            "seg": k,
            "first": first,
            "before_h": before_h,
            "P_before": P_before,
            "u": s.u[at],
            "h": h,
            "P_s": s.P_s[at],
            "P_r": s.P_r[at],
            "t": t - s.origin,
            "x": s.place(t),
            "v": s.v[at],
            "a": s.a[at],
            "F": s.smoothed[at],
            "x_fine": s.place(fine),
            "P_a1": s.P[at, 0],
            "P_a2": s.P[at, 1],
            "dP": s.dP[at],
            "measured": np.column_stack([s.P[at], s.F[at]])[lead:],
            "filtered": 1.0,
        }
        for name, value in row.items():
            columns[name].append(value)
    windows = Windows(**{k: jnp.asarray(np.array(v)) for k, v in columns.items()})
    return windows, np.array(P_0)
