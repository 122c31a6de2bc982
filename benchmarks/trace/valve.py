"""From the command, held over a tick, to the conductances of the four metering edges.

Order on the way: null offset of the amplifier's play, delay, spool (second order,
with a limit on its rate), null bias, laps of the edges.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from .hidden import Hidden

PAD = 192  # ticks of command kept from before the log


class Valve:
    """The valves of all lanes [L]; `step` (s) is the length of a substep."""

    def __init__(self, hidden: Hidden, ticks: int, substeps: int, step: float):
        self.e, self.step, self.substeps = hidden, step, substeps
        lanes = hidden.lanes
        self.history = np.zeros((PAD + ticks + 1, lanes))
        self.held = np.zeros(lanes)
        self.spool, self.rate = np.zeros(lanes), np.zeros(lanes)
        self.columns = np.arange(lanes)
        late = hidden("valve_delay", "tau_u") / step
        self.part = late % 1
        sub = np.arange(substeps)[:, None] - np.floor(late).astype(int)
        self.newer, self.older = sub // substeps, (sub - 1) // substeps
        self.moves = hidden.has("valve_lag") or hidden.has("valve_rate_limit")
        omega = hidden("valve_lag", "omega")
        zeta = hidden("valve_lag", "zeta")
        self.lags = np.isfinite(omega)
        self.map = np.zeros((2, 2, lanes))
        for i in np.nonzero(self.lags)[0]:
            w, z = omega[i], zeta[i]
            self.map[..., i] = expm(step * np.array([[0.0, 1.0], [-w * w, -2 * z * w]]))
        self.reach = hidden("valve_rate_limit", "r_v") * step  # V a substep

    def openings(self, k: int, u: np.ndarray) -> np.ndarray:
        """Mean spool position (V) in each substep of tick `k`: [substeps, L]."""
        e, t = self.e, (k + (np.arange(self.substeps) + 0.5) / self.substeps) * 1e-3
        play = e("valve_hysteresis", "u_h")
        self.held = np.minimum(np.maximum(self.held, u - play), u + play)
        self.history[PAD + k] = self.held
        at = PAD + k
        goal = self.history[at + self.newer, self.columns]
        if e.has("valve_delay"):
            older = self.history[at + self.older, self.columns]
            goal = goal + self.part * (older - goal)
        if e.has("valve_dither"):
            angle = 2 * np.pi * e("valve_dither", "hertz") * t[:, None]
            goal = goal + e("valve_dither", "volts") * np.sin(angle)
        if self.moves:
            goal = np.stack([self._move(g) for g in goal])
        return goal + e("valve_bias", "u_0")

    def _move(self, goal: np.ndarray) -> np.ndarray:
        """The spool over one substep toward a held goal; its mean position."""
        (a, b), (c, d) = self.map
        gap, start = self.spool - goal, self.spool
        end = np.where(self.lags, goal + a * gap + b * self.rate, goal)
        rate = c * gap + d * self.rate
        top = self.reach / self.step
        self.spool = start + np.clip(end - start, -self.reach, self.reach)
        self.rate = np.clip(rate, -top, top)
        # A spool without dynamics jumps at the tick; any other moves evenly.
        jumps = ~self.lags & ~np.isfinite(self.reach)
        return np.where(jumps, goal, (start + self.spool) / 2)

    def edges(self, opening: np.ndarray) -> np.ndarray:
        """Openings (V) of the edges [n, 2, 2, L]: (supply, return) x (chamber 1, 2)."""
        e = self.e
        under = e("underlap", "u_ul")
        p = np.maximum(opening + under - e("valve_deadband", "u_dbp"), 0)
        n = np.maximum(under - opening - e("valve_deadband", "u_dbn"), 0)
        return np.stack([np.stack([p, n], 1), np.stack([n, p], 1)], 1)
