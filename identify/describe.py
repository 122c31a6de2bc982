"""What is left above the noise, in words: in which channel, and what it follows."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import signal

from .outcome import Unexplained

BINS = 16
"""Quantiles of a signal between which the residual's mean is compared."""
FOLLOWS = 0.08
"""Share of the residual's square that a signal's bins must hold to be named."""
LINE = 12.0
"""Height of a spectral line above the median of the spectrum to be named."""


def unexplained(
    channel: str,
    unit: str,
    noise: float,
    residual: np.ndarray,
    signals: Mapping[str, np.ndarray],
    tick: float,
) -> Unexplained:
    """Describe the residual [W, T] (SI) of a channel that stays above its noise.

    `signals` are [W, T] each; `tick` the step, s. The sentence is a description, not
    a cause: what it follows is where an engineer would look first.
    """
    excess = float(np.sqrt(max(np.mean(residual**2) - noise**2, 0.0)))
    size = f"{channel} stays {_size(excess, unit)} RMS above its noise"
    shares = {name: dependence(residual, s) for name, s in signals.items()}
    best = max(shares, key=lambda n: shares[n], default="")
    if best and shares[best] > FOLLOWS:
        says = (
            f"{size}; {100 * shares[best]:.0f} % of what is left goes with {best}, "
            "more than with any other signal of the log"
        )
        return Unexplained(channel, excess, unit, best, says)
    line, height = spectral_line(residual, tick)
    if height > LINE:
        says = f"{size}; it stands out as a line near {line:.3g} Hz"
        return Unexplained(channel, excess, unit, "frequency", says)
    loud = np.log(residual**2 + (0.1 * noise) ** 2)
    loud = loud - loud.mean()
    swell = {name: dependence(loud, np.abs(s)) for name, s in signals.items()}
    best = max(swell, key=lambda n: swell[n], default="")
    if best and swell[best] > FOLLOWS:
        high = np.abs(signals[best]) > np.median(np.abs(signals[best]))
        where = "large" if loud[high].mean() > loud[~high].mean() else "small"
        says = (
            f"{size}; its sign goes with none of the log's signals, but it is larger "
            f"where {best} is {where}"
        )
        return Unexplained(channel, excess, unit, best, says)
    says = f"{size}; it goes with none of the log's signals and has no line"
    return Unexplained(channel, excess, unit, "none", says)


def dependence(residual: np.ndarray, s: np.ndarray) -> float:
    """Share of the residual's square held by its means between quantiles of `s`.

    Both [W, T]. Less what the same sum holds by chance, when the signal's windows are
    exchanged among each other.
    """
    residual = residual - residual.mean()
    edges = np.unique(np.quantile(s, np.linspace(0, 1, BINS + 1)[1:-1]))
    if edges.size < 2:
        return 0.0
    index = np.searchsorted(edges, s)
    count = np.maximum(np.bincount(index.ravel()), 1)

    def held(index):
        total = np.bincount(index.ravel(), weights=residual.ravel())
        return np.sum(total**2 / count[: total.size])

    draw = np.random.default_rng(0)
    chance = np.mean([held(index[draw.permutation(len(index))]) for _ in range(8)])
    return float(max((held(index) - chance) / max(np.sum(residual**2), 1e-300), 0.0))


def spectral_line(residual: np.ndarray, tick: float) -> tuple[float, float]:
    """Frequency (Hz) of the highest line of the residual, and its height.

    The height is above a running median of the spectrum.
    """
    f, power = signal.periodogram(
        residual, 1 / tick, window="hann", detrend="linear", axis=-1
    )
    # The lowest bins of so short a window hold whatever is slow, and no line.
    f, mean = f[2:], power.mean(axis=0)[2:]
    around = signal.medfilt(np.pad(mean, 12, mode="reflect"), 13)[12:-12]
    ratio = mean / np.maximum(around, 1e-300)
    top = int(np.argmax(ratio))
    return float(f[top]), float(ratio[top])


def _size(value: float, unit: str) -> str:
    if unit == "Pa":
        return f"{value / 1e3:.3g} kPa"
    return f"{value:.3g} {unit}"
