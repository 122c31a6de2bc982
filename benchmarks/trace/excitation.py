"""What drives the rigs: paths, desired forces, supplies, disturbances and noise.

Every function takes its own random generator, so that a lane is the same whatever it
is simulated beside. Logs to fit and logs to validate are excited differently.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter, sosfiltfilt

TICK = 1e-3  # s
NOISE = {"P_a1": 9e3, "P_a2": 9e3, "P_s": 9e3, "F": 2.5}  # Pa, Pa, Pa, N
LSB = {"P_a1": 35e6 / 4096, "P_a2": 35e6 / 4096, "P_s": 35e6 / 4096, "F": 2e4 / 4096}
STYLES = ("fit_1", "fit_2", "validate")
NOISES = ("white", "coloured", "quantised", "heavy-tailed")


@dataclass(frozen=True)
class Drive:
    """What a lane is driven by, at its ticks [n]; SI.

    `path` is where the motion drive wants the load, with rates `path_v`, `path_a`;
    `other` an unlogged force of unit RMS; `noise` [n, 4] for P_a1, P_a2, P_s, F.
    """

    path: np.ndarray
    path_v: np.ndarray
    path_a: np.ndarray
    wanted: np.ndarray
    supply: np.ndarray
    other: np.ndarray
    noise: np.ndarray


def multisine(rng: np.random.Generator, t: np.ndarray, f, amplitude) -> np.ndarray:
    """Sum of sines of random phase at the frequencies `f` (Hz)."""
    total = np.zeros_like(t)
    phases = rng.uniform(0, 2 * np.pi, len(f))
    for one, phase, a in zip(f, phases, amplitude, strict=True):
        total += a * np.sin(2 * np.pi * one * t + phase)
    return total


def _moves(rng, t, peak: tuple[float, float], rest: float) -> np.ndarray:
    """Moves to and fro of a smooth profile, with peak speeds (m/s) and rests (s)."""
    where, when = rng.uniform(-0.012, 0.012), rng.uniform(0.05, 0.3)
    x = np.full_like(t, where)
    while when < t[-1]:
        goal = -np.copysign(rng.uniform(0.004, 0.013), where)
        speed = np.exp(rng.uniform(*np.log(peak)))
        span = max(1.875 * abs(goal - where) / speed, 0.2)
        s = np.clip((t - when) / span, 0, 1)
        x += (goal - where) * s**3 * (10 - 15 * s + 6 * s**2)
        where, when = goal, when + span + rng.uniform(0.03, rest)
    return x


def path(rng: np.random.Generator, t: np.ndarray, style: str) -> CubicSpline:
    """Planned position (m) of the load; speeds stay below some 3 cm/s."""
    if style == "fit_1":
        x = _moves(rng, t, (5e-3, 25e-3), 1.5)
    elif style == "fit_2":
        x = _moves(rng, t, (10e-3, 26e-3), 0.4)
    else:
        speed = 2 * np.pi * np.array([0.23, 0.61, 1.1])
        peak = rng.uniform(0.7, 1.0, 3) * [11e-3, 7e-3, 5e-3]
        x = multisine(rng, t, speed / (2 * np.pi), peak / speed)
    f = rng.uniform(4, 22, 40)
    speeds = 1.3e-3 * np.minimum(1, (12 / f) ** 3)  # m/s of each sine
    swell = 0.6 + 0.4 * np.sin(2 * np.pi * t / rng.uniform(4, 7) + rng.uniform(0, 6.3))
    wiggle = multisine(rng, t, f, speeds / (2 * np.pi * f))
    return CubicSpline(t, x + swell * wiggle)


def wanted_force(rng: np.random.Generator, t: np.ndarray, style: str) -> np.ndarray:
    """Desired force (N), some 400 N RMS, to about 20 Hz."""
    if style == "fit_1":
        f = np.exp(rng.uniform(np.log(0.1), np.log(20), 40))
        size = 1 / (1 + f / 2)
        return multisine(rng, t, f, size * 400 / np.sqrt(np.sum(size**2) / 2))
    if style == "fit_2":
        held = rng.uniform(-700, 700, int(t[-1] / 0.35) + 2)
        steps = held[(t / 0.35).astype(int)]
        smooth = sosfiltfilt(butter(2, 12, fs=1 / TICK, output="sos"), steps)
        return smooth + multisine(rng, t, rng.uniform(3, 18, 12), np.full(12, 30.0))
    span = t[-1] / 2
    sweep = 0.3 * (18 / 0.3) ** ((t % span) / span)
    angle = 2 * np.pi * np.cumsum(sweep) * TICK
    slow = 2 * np.abs((t / 3.1 + rng.uniform()) % 1 * 2 - 1) - 1
    return (480 / (1 + sweep / 8)) * np.sin(angle) + 350 * slow


def supply(rng: np.random.Generator, t, style: str, mean: float) -> np.ndarray:
    """Supply pressure (Pa): a slow swing of some 15 % about `mean`, and ripple."""
    period = rng.uniform(5, 8) if style == "validate" else rng.uniform(8, 13)
    swing = 0.15 * mean * np.sin(2 * np.pi * t / period + rng.uniform(0, 6.3))
    return mean + swing + multisine(rng, t, rng.uniform(1, 30, 8), np.full(8, 2e4))


def unit_noise(rng: np.random.Generator, shape, kind: str) -> np.ndarray:
    """Noise of unit standard deviation; `quantised` is white before the rounding."""
    white = rng.normal(size=shape)
    if kind == "coloured":
        keep = 0.7
        return lfilter([np.sqrt(1 - keep**2)], [1, -keep], white, axis=0)
    if kind == "heavy-tailed":
        # A converter's range cuts the tail at 8 standard deviations: without that one
        # sample in ten thousand would be as large as all others together.
        y = np.clip(rng.standard_t(3, size=shape) / np.sqrt(3), -8, 8)
        return y / 0.945808
    return white


def noise(rng: np.random.Generator, n: int, kind: str) -> np.ndarray:
    """[n, 4] errors of P_a1, P_a2, P_s and F.

    A quantised sensor keeps the declared standard deviation: its rounding is part.
    """
    size = np.array([NOISE[c] for c in NOISE])
    if kind == "quantised":
        lsb = np.array([LSB[c] for c in NOISE])
        size = np.sqrt(size**2 - lsb**2 / 12)
    return size * unit_noise(rng, (n, 4), kind)


def drive(seed: int, n: int, style: str, kind: str, mean_supply: float) -> Drive:
    """All that drives one lane for `n` ticks."""
    streams = [np.random.default_rng([seed, STYLES.index(style), i]) for i in range(5)]
    t = np.arange(n) * TICK
    way = path(streams[0], t, style)
    other = multisine(streams[4], t, streams[4].uniform(0.7, 9, 12), np.ones(12))
    return Drive(
        way(t),
        way(t, 1),
        way(t, 2),
        wanted_force(streams[1], t, style),
        supply(streams[2], t, style, mean_supply),
        other / np.sqrt(6),
        noise(streams[3], n, kind),
    )
