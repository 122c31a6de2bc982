"""The closed loop and the replay's scheme compiled by numba, instances in parallel."""

from __future__ import annotations

import math
import os
from collections.abc import Callable

import numba
import numpy as np
from numba import njit, prange

from hydrojax.control.loop import Loop, Scenario
from hydrojax.control.simulation import PARTS

from .numbers import KEPT, columns, delay, numbers
from .plain import (
    begin,
    bristle,
    decide,
    force,
    pressure_step,
    records,
    spool_step,
)

COMPILE = {"error_model": "numpy", "fastmath": {"contract"}}
"""No other liberty than fused multiply-adds, as in C."""


@njit(inline="always")
def _act(p, P, z, speed, u, y, rate, part, i, supply, back, x, h):
    """One part of a period: spool, pressures, bristle, filtered speed."""
    y, rate, mean = spool_step(p, y, rate, u)
    at, later = part / PARTS, (part + 0.5) / PARTS
    ds, db = supply[i, 1] - supply[i, 0], back[i, 1] - back[i, 0]
    line = supply[i, 0] + at * ds, back[i, 0] + at * db
    middle = supply[i, 0] + later * ds, back[i, 0] + later * db
    places = x[i, part, 0], x[i, part, 1], x[i, part, 2]
    P = pressure_step(p, max(mean, 0.0), max(-mean, 0.0), P, line, middle, places, h)
    dx = places[2] - places[0]
    speed = p.keep * speed + (1 - p.keep) * abs(dx) / h
    return P, bristle(z, dx, p.z_ss), speed, y, rate


@njit(**COMPILE)
def _one(p, whole, share, h, F_d, noise, supply, back, x, v, out):
    """One instance; RMS of F_d - F. `out` is [N, 13], or [0, 13] for no signals."""
    e, row, commands = np.empty(9), np.empty(7), np.zeros(16)
    start = (x[0, 0, 1] - x[0, 0, 0]) / (h / PARTS / 2)
    P_1, P_2, F, memory = begin(p, F_d[0], x[0, 0, 0], start, e, row)
    P = (P_1, P_2)
    z = speed = y = rate = total = 0.0
    for i in range(F_d.size):
        total += (F_d[i] - F) ** 2
        if out.shape[0]:
            out[i, 1], out[i, 2], out[i, 3] = P[0], P[1], F
            out[i, 4:] = e
        truth = P[0], P[1], supply[i, 0], F, x[i, 0, 0]
        memory, u = decide(p, memory, e, row, truth, F_d[i], noise[i], h)
        if out.shape[0]:
            out[i, 0] = u
        commands[i & 15] = u
        for part in range(PARTS):
            at = PARTS * (i + 16) + part - whole
            newer = commands[(at // PARTS) & 15]
            late = newer + share * (commands[((at - 1) // PARTS) & 15] - newer)
            P, z, speed, y, rate = _act(
                p, P, z, speed, late, y, rate, part, i, supply, back, x, h / PARTS
            )
        F = force(p, P[0], P[1], z, speed, v[i, PARTS - 1])
    return math.sqrt(total / F_d.size)


@njit(parallel=True, **COMPILE)
def _all(p, whole, share, h, F_d, noise, supply, back, x, v, rms, out):
    for b in prange(p.size):
        rms[b] = _one(p[b], whole, share, h, F_d, noise, supply, back, x, v, out[b])


def prepare(
    loop: Loop, scenario: Scenario, threads: int | None = None, signals: bool = False
) -> Callable[[], tuple[np.ndarray, np.ndarray | None]]:
    """A closed loop in numba, compiled and ready to be run; see `peers_c.prepare`."""
    p = records(numbers(loop))
    h, n = float(loop.h), scenario.F_d.shape[0]
    given = (p, *delay(loop.rig, h / PARTS), h, *columns(scenario))
    rms = np.empty(p.size)
    out = np.empty((p.size, n if signals else 0, len(KEPT)))
    most = min(threads or os.cpu_count() or 1, numba.config.NUMBA_NUM_THREADS)

    def call():
        numba.set_num_threads(most)
        _all(*given, rms, out)
        return rms, (out if signals else None)

    return call
