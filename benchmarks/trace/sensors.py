"""Pressure gauges and load cell of many lanes: lags, gains, offsets, hum and rounding.

Rows: P_a1, P_a2, F; arrays are [3, L]. Lags are exact for signals that run straight
within a substep.
"""

from __future__ import annotations

import numpy as np

from .hidden import Hidden

FORCE = 2  # the row of F


class Sensors:
    """What the sensors show, before noise; `step` (s) is the length of a substep."""

    def __init__(self, hidden: Hidden, step: float, lsb: np.ndarray):
        self.e, self.step = hidden, step
        tau_P = hidden("pressure_sensor_lag", "tau_P")
        tau = np.array([tau_P, tau_P, hidden("loadcell_lag", "tau_F")])
        self.lags = hidden.has("pressure_sensor_lag", "loadcell_lag")
        ratio = np.maximum(tau, 1e-9) / step
        self.keep = np.exp(-1 / ratio)
        self.mean = ratio * (1 - self.keep)
        bias = (
            hidden("pressure_sensor_bias", "b_1"),
            hidden("pressure_sensor_bias", "b_2"),
        )
        self.offset = np.array([*bias, hidden("loadcell_bias", "b")])
        self.gain = np.ones((3, hidden.lanes))
        self.gain += [
            hidden("pressure_sensor_gain", "eps_1"),
            hidden("pressure_sensor_gain", "eps_2"),
            hidden("loadcell_gain", "eps"),
        ]
        omega = hidden("tap_resonance", "omega")
        self.rings = np.isfinite(omega)
        self.omega = np.where(self.rings, omega, 1.0)
        self.damping = 2 * hidden("tap_resonance", "zeta") * self.omega
        self.lsb = lsb

    def start(self, true: np.ndarray) -> None:
        """At rest on the true values [3, L]."""
        self.before = self.shown = true
        self.tap, self.tap_rate = true[:FORCE], np.zeros_like(true[:FORCE])

    def follow(self, true: np.ndarray) -> None:
        """One substep, at whose end the true values are these."""
        if self.e.has("tap_resonance"):
            # The oil in the gauge's line swings against the gauge's compliance.
            pull = self.omega**2 * (true[:FORCE] - self.tap)
            rate = self.tap_rate + self.step * (pull - self.damping * self.tap_rate)
            self.tap = np.where(self.rings, self.tap + self.step * rate, true[:FORCE])
            self.tap_rate = np.where(self.rings, rate, 0.0)
            true = np.concatenate([self.tap, true[FORCE:]])
        if self.lags:
            past = self.keep * self.shown + (self.mean - self.keep) * self.before
            self.shown = past + (1 - self.mean) * true
        else:
            self.shown = true
        self.before = true

    def reading(self, t: float) -> np.ndarray:
        """What is shown at time `t` (s), before noise."""
        out = self.gain * self.shown + self.offset
        if self.e.has("mains_hum"):
            hum = np.sin(2 * np.pi * 50.0 * t + np.array([[0.0], [0.4], [1.1]]))
            size = self.e("mains_hum", "pressure")
            out = out + hum * np.array([size, size, self.e("mains_hum", "force")])
        return out

    def rounded(self, values: np.ndarray) -> np.ndarray:
        """Readings [4, L] of P_a1, P_a2, P_s, F as the converters give them out."""
        lsb = np.where(self.lsb > 0, self.lsb, 1.0)
        return np.where(self.lsb > 0, np.round(values / lsb) * lsb, values)
