"""The force controller of the benchmark's rigs, which knows nominal values only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .excitation import TICK

K_P, K_F = 1.0e-3, 2.0e-3  # V/N: pressure force, output force
KAPPA = 1.18e-4  # m^2/s per V
U_MAX = 10.0  # V


class ForceLoop:
    """Feedforward of speed and force rate, two proportional terms, inverse valve.

    After (17)-(19) and (23) of the paper without adaptation; friction is taken from
    the slow part of what pressures and load cell disagree by.
    """

    def __init__(self, nominals: Sequence[Mapping[str, float]]):
        names = nominals[0]
        self.r = {n: np.array([r[n] for r in nominals]) for n in names}
        self.v = np.zeros(len(nominals))
        self.drag = np.zeros(len(nominals))
        self.x: np.ndarray | None = None

    def command(self, psi, P_1, P_2, P_s, force, wanted, wanted_rate) -> np.ndarray:
        """Valve voltage [L] from what the sensors read and the force wanted."""
        r = self.r
        x = r["radius"] * psi
        before = x if self.x is None else self.x
        self.v += 0.6 * ((x - before) / TICK - self.v)
        self.x = x
        x_1 = r["chamber_length"] / 2 + r["delta_1"] - x
        x_2 = r["chamber_length"] / 2 + r["delta_2"] + x
        drive = r["area_2"] * P_2 - r["area_1"] * P_1
        self.drag += 0.05 * (drive - force - self.drag)
        volts = K_P * (wanted + self.drag - drive) + K_F * (wanted - force)
        # Only the load's motion is fed forward: F's rate in pressure is A beta (...).
        swept = r["area_1"] / x_1 + r["area_2"] / x_2
        goal = wanted_rate / r["beta"] + self.v * swept
        goal = goal + KAPPA * volts

        def root(drop):
            return np.sqrt(np.maximum(drop, 2e5))

        fill_2 = r["c_p2"] * root(P_s - P_2) / x_2 + r["c_n1"] * root(P_1) / x_1
        fill_1 = r["c_p1"] * root(P_s - P_1) / x_1 + r["c_n2"] * root(P_2) / x_2
        u = -goal / np.where(goal < 0, fill_1, fill_2)
        return np.clip(u, -U_MAX, U_MAX)
