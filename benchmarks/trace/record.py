"""Logs of many rigs at once: plant, valve, sensors and force controller in a loop.

Each lane is one log. Between ticks of 1 ms everything moves in substeps of 50 us.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from .excitation import LSB, TICK, drive
from .force_loop import ForceLoop
from .plant import MASS, Lane, Plant
from .sensors import Sensors
from .valve import Valve

SUBSTEPS = 20
AHEAD = 300
"""Ticks that a rig has run before its log begins: bristle and loop are under way."""
CHANNELS = ("P_a1", "P_a2", "P_s", "F")

Log = dict[str, np.ndarray]


def record(
    lanes: Sequence[Lane],
    seconds: float = 12.0,
    substeps: int = SUBSTEPS,
    progress: Callable[[int, int], None] = lambda done, total: None,
    ahead: int = AHEAD,
) -> list[Log]:
    """Record all lanes side by side; SI, one row a tick of 1 ms.

    At tick k the sensors are read and the row is written; its command holds until
    tick k + 1. `tell` hears of ticks done and in all; the rigs run
    `ahead` ticks before that. A rig that runs away leaves a log
    that is not finite, and the others untouched.
    """
    with np.errstate(all="ignore"):
        return _record(lanes, seconds, substeps, progress, ahead)


def _record(lanes, seconds, substeps, progress, ahead) -> list[Log]:
    n, h = round(seconds / TICK) + ahead, TICK / substeps
    drives = [drive(la.seed, n + 1, la.style, la.noise, la.supply) for la in lanes]
    plant, loop = Plant(lanes, h), ForceLoop([la.nominal for la in lanes])
    e, r = plant.e, plant.r

    def over(name):
        return np.stack([getattr(d, name) for d in drives], axis=-1)

    P_s, wanted, other, noise = (
        over(name) for name in ("supply", "wanted", "other", "noise")
    )
    path, path_v, path_a = over("path"), over("path_v"), over("path_a")
    servo = plant.K * path + plant.D * path_v + MASS * path_a
    rise = np.gradient(wanted, TICK, axis=0)
    quantised = np.array([la.noise == "quantised" for la in lanes])
    lsb = np.array([[LSB[c]] for c in CHANNELS]) * quantised
    valve, sensors = Valve(e, n, substeps, h), Sensors(e, h, lsb)
    mark = np.array([2 * np.pi / 2**la.bits for la in lanes])  # rad
    skew = _Skew(e("channel_skew", "tau"), h, substeps, n)

    first = wanted[0] * (1 + r["k_fp"] / (1 + r["delta"] * np.abs(wanted[0])))
    half = P_s[0] / 2
    plant.start(
        path[0] + wanted[0] / plant.K,
        path_v[0],
        np.stack([half, (first + r["area_1"] * half) / r["area_2"]]),
    )
    cell, a, a_p = plant.forces(0.0, other[0], servo[0])
    sensors.start(np.stack([*plant.P, cell]))
    parts = (np.arange(substeps) + 0.5) / substeps
    rows = np.empty((n, 7, len(lanes)))
    for k in range(n):
        t = (k - ahead) * TICK
        p_1, p_2, force = shown = plant.odd.read(t, sensors.reading(k * TICK), TICK)
        skew.keep(k, 0, shown)
        angle = np.round(plant.encoder / r["radius"] / mark) * mark
        read = sensors.rounded(np.stack([p_1, p_2, P_s[k], force]) + noise[k])
        u = loop.command(angle, *read, wanted[k], rise[k])
        rows[k] = [u, angle, *read, wanted[k]]
        spool = plant.odd.command(t, P_s[k], valve.openings(k, u))
        g = plant.conductances(t, valve.edges(spool))
        line = P_s[k] + parts[:, None] * (P_s[k + 1] - P_s[k])
        for j in range(substeps):
            plant.advance(a, a_p, line[j], g[j], t + parts[j] * TICK)
            part = (j + 1) / substeps
            push = servo[k] + part * (servo[k + 1] - servo[k])
            cell, a, a_p = plant.forces(t + part * TICK, other[k], push)
            sensors.follow(np.stack([*plant.P, cell]))
            if j + 1 < substeps:
                skew.keep(k, j + 1, sensors.shown)
        if k % 100 == 0:
            progress(k, n)
    if skew.lanes:
        # Read at another instant, and so with other noise than the controller saw.
        late = skew.shifted() + np.roll(noise[:n, 3], 1, axis=0)
        rows[:, 5, skew.lanes] = late[:, skew.lanes]
    names = ("u", "psi", *CHANNELS, "F_d")
    rows, t = rows[ahead:], np.arange(n - ahead) * TICK
    return [
        {"time": t} | {c: rows[:, i, lane] for i, c in enumerate(names)}
        for lane in range(len(lanes))
    ]


class _Skew:
    """The load cell's readings at another instant than the tick, by lane."""

    def __init__(self, tau: np.ndarray, step: float, substeps: int, ticks: int):
        late = np.round(tau / step).astype(int)
        self.whole, part = late // substeps, late % substeps
        self.lanes = np.nonzero(late)[0].tolist()
        self.at = {j: np.nonzero((late != 0) & (part == j))[0] for j in set(part)}
        self.seen = np.zeros((ticks, len(tau)))

    def keep(self, k: int, j: int, shown: np.ndarray) -> None:
        """Note what is shown at substep `j` of tick `k`."""
        if self.lanes and j in self.at:
            self.seen[k, self.at[j]] = shown[-1, self.at[j]]

    def shifted(self) -> np.ndarray:
        """[ticks, L]: at row k what was shown at k + tau."""
        rows = np.arange(len(self.seen))[:, None] + self.whole
        rows = np.clip(rows, 0, len(self.seen) - 1)
        return np.take_along_axis(self.seen, rows, axis=0)
