"""An operator at a lever: strokes, steps and sums of sines that stay off the ends."""

from __future__ import annotations

import math

import numpy as np

from .run import TICK

LSB = 1 / 4096
"""Resolution of a command, of full command."""

SCRIPTS = {
    "fit_1": ("stroke", "step", "rest"),
    "fit_2": ("sines", "stroke", "rest"),
    "validate": ("stroke", "sines", "step", "rest"),
}
"""What follows what in each log; it begins again at its end."""

ROOM = 0.08
"""Share of the stroke at either end that no command drives into."""

FADE = 0.12
"""Share of the stroke over which a command fades out before it."""


class Operator:
    """Makes one log's commands, each from where the piston stands.

    Called once a tick with the piston's stroke in m; returns the command, -1 to 1,
    positive to retract. Made of a seed, so two alike do alike on equal strokes.
    """

    def __init__(self, seed: list[int], name: str, stroke: float, speed: float):
        self.rng = np.random.default_rng(seed)
        self.script = SCRIPTS[name]
        self.stroke, self.speed = stroke, speed
        self.n, self.left = 0, round(self.rng.uniform(0.5, 1.5) / TICK)
        self.shape = np.zeros(self.left)

    def __call__(self, x: float) -> float:
        """Next command."""
        if not self.left:
            kind = self.script[self.n % len(self.script)]
            self.n += 1
            self.shape = getattr(self, "_" + kind)(self._out(x))
            self.left = len(self.shape)
        u = float(self.shape[-self.left])
        self.left -= 1
        share = x / self.stroke
        room = (share - ROOM) if u > 0 else (1 - ROOM - share)
        u *= min(max(room / FADE, 0.0), 1.0)
        return round(u / LSB) * LSB

    def _out(self, x: float) -> float:
        """Sign of the command: mostly toward the farther end."""
        extend = self.rng.random() < (0.9 if x < self.stroke / 2 else 0.1)
        return -1.0 if extend else 1.0

    def _time(self, share: float, size: float) -> int:
        """Ticks in which a command of some size moves about a share of the stroke."""
        seconds = share * self.stroke / (self.speed * size**1.5)
        return round(min(max(seconds, 0.8), 6.0) / TICK)

    def _rest(self, sign: float) -> np.ndarray:
        return np.zeros(round(self.rng.uniform(0.5, 2.5) / TICK))

    def _stroke(self, sign: float) -> np.ndarray:
        """One push of the lever, with ramps of raised cosines."""
        size = self.rng.uniform(0.3, 0.9)
        ramp = round(self.rng.uniform(0.15, 1.0) / TICK)
        up = (1 - np.cos(math.pi * np.arange(ramp) / ramp)) / 2
        held = np.ones(self._time(self.rng.uniform(0.25, 0.6), size))
        return sign * size * np.concatenate([up, held, up[::-1]])

    def _step(self, sign: float) -> np.ndarray:
        """Two to four held levels, every one back the other way, with stops between."""
        parts = []
        for _ in range(int(self.rng.integers(2, 5))):
            size = self.rng.uniform(0.25, 0.8)
            n = self._time(self.rng.uniform(0.1, 0.3), size)
            parts.append(np.full(n, sign * size))
            if self.rng.random() < 0.5:
                parts.append(np.zeros(round(self.rng.uniform(0.2, 1.0) / TICK)))
            sign = -sign
        return np.concatenate(parts)

    def _sines(self, sign: float) -> np.ndarray:
        """Sum of sines from 0.08 to 1.5 Hz, the slowest first toward the far end."""
        t = np.arange(round(self.rng.uniform(8, 14) / TICK)) * TICK
        slow = self.rng.uniform(0.08, 0.16)
        sum_ = sign * np.sin(2 * math.pi * slow * t)
        for share, low, high in ((0.5, 0.25, 0.5), (0.3, 0.6, 1.5)):
            rate, phase = self.rng.uniform(low, high), self.rng.uniform(0, 2 * math.pi)
            sum_ += share * np.sin(2 * math.pi * rate * t + phase)
        return self.rng.uniform(0.45, 0.9) * sum_ / np.max(np.abs(sum_))
