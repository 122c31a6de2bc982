"""Signals of desired forces and motions, from numbers in SI."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy import signal

from hydrojax.control.simulation import Trajectory


def sinusoidal_path(speed: float, period: float) -> Trajectory:
    """A sinusoid of the piston that starts at rest at one end.

    Args:
        speed: its peak, m/s.
        period: of one to and fro, s.
    """
    w = 2 * np.pi / period
    size = speed / w
    return lambda t, nu: -size * w**nu * np.cos(w * t + nu * np.pi / 2)


def random_path(
    rng: np.random.Generator, speed: float, travel: float = 0.02
) -> Trajectory:
    """A smooth random motion: eight sines of 0.05 to 1.2 Hz, at rest nowhere for long.

    Args:
        rng: where its numbers come from.
        speed: its peak in two minutes, m/s, unless travel limits it first.
        travel: the most it goes from its middle meanwhile, m.
    """
    hertz = np.exp(rng.uniform(np.log(0.05), np.log(1.2), 8))
    w, phase = 2 * np.pi * hertz, rng.uniform(0, 2 * np.pi, 8)
    share = rng.uniform(0.3, 1.0, 8)
    t = np.arange(0.0, 120.0, 0.01)
    angle = np.multiply.outer(t, w) + phase
    fastest = np.abs((share * np.cos(angle)).sum(-1)).max()
    furthest = np.abs((share / w * np.sin(angle)).sum(-1)).max()
    size = share / w / max(fastest / speed, furthest / travel)

    def path(t: np.ndarray, nu: int) -> np.ndarray:
        angle = np.multiply.outer(t, w) + phase + nu * np.pi / 2
        return (size * w**nu * np.sin(angle)).sum(-1)

    return path


def random_sines(
    rng: np.random.Generator, t: Float[np.ndarray, "n"], rms: float
) -> Float[np.ndarray, "n"]:
    """Desired force of forty sines of 0.1 to 20 Hz that fall off above 2 Hz, N."""
    hertz = np.exp(rng.uniform(np.log(0.1), np.log(20.0), 40))
    size = 1 / (1 + hertz / 2)
    size *= rms / np.sqrt(np.sum(size**2) / 2)
    angle = np.multiply.outer(t, 2 * np.pi * hertz) + rng.uniform(0, 2 * np.pi, 40)
    return (size * np.sin(angle)).sum(-1)


def band_noise(
    rng: np.random.Generator, n: int, h: float, rms: float, band: float
) -> Float[np.ndarray, "n"]:
    """White noise up to `band` Hz (fourth-order Butterworth), every `h` s, N."""
    white = rng.normal(size=n)
    if band < 0.5 / h:
        filter_ = signal.butter(4, band, fs=1 / h, output="sos")
        white = np.asarray(signal.sosfilt(filter_, white))
    return rms * white / np.std(white)
