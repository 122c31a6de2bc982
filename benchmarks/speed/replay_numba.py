"""The replay over windows and its Jacobian in numba, in parallel."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import ArrayLike
from numba import njit, prange

from hydrojax.plant.rig import PARTS

from .numbers import Numbers
from .peers_numba import COMPILE
from .plain import bristle, force, pressure_step, records, spool_step
from .replays import NAMES, STAGES, Replay, ahead, from_ticks, moved, numbers_at, start


@njit(**COMPILE)
def _friction(p, dx, h, speed0, z, speed):
    """Bristle and filtered speed at all ticks of all segments, [S N] each."""
    segments, steps, quarters = dx.shape
    for s in range(segments):
        at = s * (steps + 1)
        z[at], speed[at] = 0.0, speed0[s]
        for i in range(steps):
            now, w = z[at + i], speed[at + i]
            keep = np.exp(-p.L_rate * h[s, i] / quarters)
            for q in range(quarters):
                now = bristle(now, dx[s, i, q], p.z_ss)
                share = (1 - keep) * quarters / h[s, i]
                w = keep * w + share * abs(dx[s, i, q])
            z[at + i + 1], speed[at + i + 1] = now, w


@njit(**COMPILE)
def _openings(p, lag, u, y, rate):
    """The spool and its mean openings toward either side over a tick."""
    if not lag:
        return y, rate, max(u, 0.0), max(-u, 0.0)
    open_p = open_n = 0.0
    for _ in range(PARTS):
        y, rate, mean = spool_step(p, y, rate, u)
        open_p, open_n = open_p + max(mean, 0.0), open_n + max(-mean, 0.0)
    return y, rate, open_p / PARTS, open_n / PARTS


@njit(**COMPILE)
def _pressures(p, lag, before, u, h, P_s, P_r, x, P_0, out):
    """One window's pressures at its ticks into `out` [ticks, 2 or more]."""
    y, rate, n = (before[0] if before.size else u[0]), 0.0, (x.shape[1] - 1) // 2
    for command in before:
        y, rate, _, _ = _openings(p, lag, command, y, rate)
    P = P_0[0], P_0[1]
    out[0, 0], out[0, 1] = P
    for i in range(u.size - 1):
        y, rate, open_p, open_n = _openings(p, lag, u[i], y, rate)
        ds, db = (P_s[i + 1] - P_s[i]) / (2 * n), (P_r[i + 1] - P_r[i]) / (2 * n)
        for k in range(0, 2 * n, 2):
            line = P_s[i] + k * ds, P_r[i] + k * db
            middle = line[0] + ds, line[1] + db
            places = x[i, k], x[i, k + 1], x[i, k + 2]
            P = pressure_step(p, open_p, open_n, P, line, middle, places, h[i] / n)
        out[i + 1, 0], out[i + 1, 1] = P


@njit(**COMPILE)
def _forces(p, first, v, z, speed, out):
    """One window's force from its pressures, into `out` [ticks, 3]."""
    for i in range(v.size):
        at = first + i
        out[i, 2] = force(p, out[i, 0], out[i, 1], z[at], speed[at], v[i])


@njit(parallel=True, **COMPILE)
def _replay(p, lag, window, motion, first, z, speed, out):
    before, u, h, P_s, P_r, x, v, P_0 = window
    _friction(p[0], *motion, z, speed)
    for w in prange(out.shape[0]):
        _pressures(
            p[0], lag, before[w], u[w], h[w], P_s[w], P_r[w], x[w], P_0[w], out[w]
        )
        _forces(p[0], first[w], v[w], z, speed, out[w])


@njit(parallel=True, **COMPILE)
def _jacobian(p, lag, window, motion, first, z, speed, base, stage, step, out):
    """Forward differences into `out` [16, W, ticks, 3], from the replay in `base`."""
    before, u, h, P_s, P_r, x, v, P_0 = window
    for j in prange(step.size):
        q, here, z_j, speed_j = p[j + 1], out[j], z, speed
        if stage[j] == 2:
            z_j, speed_j = np.empty_like(z), np.empty_like(speed)
            _friction(q, *motion, z_j, speed_j)
        for w in range(here.shape[0]):
            if stage[j] == 1:
                _pressures(
                    q, lag, before[w], u[w], h[w], P_s[w], P_r[w], x[w], P_0[w], here[w]
                )
            else:
                here[w] = base[w]
            _forces(q, first[w], v[w], z_j, speed_j, here[w])
            here[w] = (here[w] - base[w]) / step[j]


@dataclass(frozen=True)
class Compiled:
    """A log laid out for numba; `replay` and `jacobian` run on it."""

    given: Replay
    start: Numbers
    log: tuple
    base: np.ndarray
    slopes: np.ndarray
    threads: int

    def _scored(self, out: np.ndarray) -> np.ndarray:
        return out[..., out.shape[-2] - self.given.windows.scored :, :]

    def _run(self, sets: np.ndarray) -> np.ndarray:
        numba.set_num_threads(self.threads)
        p = records(numbers_at(self.start, sets))
        _replay(p[:1], *self.log, self.base)
        return p

    def replay(self, params: ArrayLike) -> np.ndarray:
        """P_a1, P_a2, F, [W, T, 3], at `params` [16] (`NAMES`), SI; a buffer's view."""
        self._run(np.asarray(params, float)[None])
        return self._scored(self.base)

    def jacobian(self, params: ArrayLike) -> np.ndarray:
        """Its derivative by forward differences, [W, T, 3, 16]; a buffer's view."""
        sets, step = moved(np.asarray(params, float))
        p, stage = self._run(sets), np.array(STAGES)
        _jacobian(p, *self.log, self.base, stage, step, self.slopes)
        return np.moveaxis(self._scored(self.slopes), 0, -1)


def prepare(given: Replay, threads: int | None = None) -> Compiled:
    """A replay in numba, ready to be compiled at its first call; see `replay_c`."""
    w, m = given.windows, given.motion

    def arrays(*given: ArrayLike) -> tuple[np.ndarray, ...]:
        return tuple(np.ascontiguousarray(a, float) for a in given)

    window = arrays(ahead(given), w.u, w.h, w.P_s, w.P_r, w.x_fine, w.v, given.P_0)
    motion = arrays(m.dx, m.h, m.speed0)
    segments, steps, _ = motion[0].shape
    room = np.empty(segments * (steps + 1)), np.empty(segments * (steps + 1))
    log = (given.lag, window, motion, from_ticks(given), *room)
    base = np.empty((*np.shape(w.u), 3))
    most = min(threads or os.cpu_count() or 1, numba.config.NUMBA_NUM_THREADS)
    return Compiled(
        given, start(given), log, base, np.empty((len(NAMES), *base.shape)), most
    )
