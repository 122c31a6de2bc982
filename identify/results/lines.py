"""Spectral lines of a residual: what shakes a rig at one frequency."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy import signal, stats

from hydrojax.identify.tracing.criteria import Criteria

EDGE, SKIRT, AROUND = 3, 2, 16
"""Bins at either end of a spectrum that are left out: what is slow, and what filters
leave; bins on either side that a line is spread over; and bins that give its
background."""

PERIODS = 1.5
"""Periods to a window from which on a line is looked for over joined windows: what is
slower goes with the detrending."""

SEGMENT = 10.0
"""Length of what one spectrum of joined windows is of, s: a frequency that wanders by
less than its inverse meanwhile, 0.1 Hz, still counts as one."""


def line_of(
    residual: Float[np.ndarray, "windows ticks"],
    tick: float,
    places: Sequence[tuple[str, float, float]],
    v: Float[np.ndarray, "windows ticks"] | None,
    criteria: Criteria,
) -> float | None:
    """Frequency (Hz) of a line that stands out of a residual; None without one.

    The arguments are those of `spectral_line` and, where there are `places`, of
    `steady_line`.
    """
    if places:
        line, share, chance = steady_line(residual, tick, places, v)
        if chance < criteria.level and share > criteria.line_share:
            return line
    line, height, chance = spectral_line(residual, tick, v)
    return line if chance < criteria.level and height > criteria.line else None


def lowest_seen(
    ticks: int, tick: float, places: Sequence[tuple[str, float, float]]
) -> float | None:
    """Frequency (Hz) from which on `line_of` sees lines; None where it sees none."""
    if places:
        return PERIODS / (ticks * tick)
    return (EDGE + 1) / (ticks * tick) if bins_of(ticks).size else None


def spectral_line(
    residual: Float[np.ndarray, "windows ticks"],
    tick: float,
    v: Float[np.ndarray, "windows ticks"] | None = None,
) -> tuple[float, float, float]:
    """The line that stands out most from the residual's own smooth spectrum.

    The residual is detrended by window and whitened by real poles, which take a drift
    or a random walk but no line. Each bin of the mean spectrum is then compared with
    the bins around it, and the logarithm of the ratio with its own scatter over the
    spectrum. The bins at its ends are no candidates. Where the motion's speed `v` is
    given, only by how much more the residual stands out there counts: what a rig is
    moved with, and where that ends, is no line of its own.

    Returns:
        Its frequency, Hz; its height over the background; and the chance that any bin
        of a smooth spectrum stands out so far.
    """
    f, above = _above_background(residual, tick)
    if not f.size:
        return 0.0, 1.0, 1.0
    if v is not None and np.ptp(v) > 0:
        of_motion = np.interp(f, *_above_background(v, tick))
        above = above - np.maximum(of_motion, 0.0)
    middle = np.median(above)
    scatter = 1.4826 * np.median(np.abs(above - middle))
    top = 1 + int(np.argmax(above[1:-1]))
    far = stats.norm.sf((above[top] - middle) / max(scatter, 1e-12))
    chance = -np.expm1((f.size - 2) * np.log1p(-min(far, 1 - 1e-12)))
    return float(f[top]), float(np.exp(above[top])), float(chance)


def _above_background(
    y: Float[np.ndarray, "windows ticks"], tick: float
) -> tuple[Float[np.ndarray, "bins"], Float[np.ndarray, "bins"]]:
    """Frequencies, Hz, and the logarithm of by how much the mean spectrum of some
    windows, whitened, lies there above that of the bins around; none of few ticks.
    """
    f, power = signal.periodogram(
        _whitened(signal.detrend(y, axis=-1)),
        1 / tick,
        window="hann",
        detrend="linear",
        axis=-1,
    )
    kept = bins_of(y.shape[1])
    kept = kept[kept < f.size - EDGE]
    if not kept.size:
        return np.zeros(0), np.zeros(0)
    level = np.log(np.maximum(power.mean(axis=0), 1e-300))[kept]
    apart = np.abs(kept[:, None] - kept)
    apart = np.where(apart > SKIRT, apart, kept.size)
    near = np.argsort(apart, axis=1, kind="stable")[:, :AROUND]
    off, around = near - np.arange(kept.size)[:, None], level[near]
    lean = off - off.mean(axis=1, keepdims=True)
    slope = np.sum(lean * around, axis=1) / np.sum(lean**2, axis=1)
    return f[kept], level - np.median(around - slope[:, None] * off, axis=1)


def bins_of(ticks: int) -> Int[np.ndarray, "bins"]:
    """Bins of the spectrum of so many ticks that may hold a line; none of few ticks."""
    kept = np.arange(EDGE, ticks // 2 + 1 - EDGE)
    return kept if kept.size >= 2 * AROUND else kept[:0]


def _whitened(
    residual: Float[np.ndarray, "windows ticks"],
) -> Float[np.ndarray, "windows shorter"]:
    """The residual through the inverse of up to three real poles, each from what
    neighbouring ticks have in common.
    """
    for _ in range(3):
        residual = residual - residual.mean(axis=-1, keepdims=True)
        now, before = residual[:, 1:], residual[:, :-1]
        pole = np.sum(now * before) / max(np.sum(before**2), 1e-300)
        if pole < 0.5:
            break
        residual = now - pole * before
    return residual


def steady_line(
    residual: Float[np.ndarray, "windows ticks"],
    tick: float,
    places: Sequence[tuple[str, float, float]],
    v: Float[np.ndarray, "windows ticks"] | None = None,
) -> tuple[float, float, float]:
    """The line whose phase goes on from window to window, and so may lie below where
    single windows show one, or among what the rig is moved with.

    The detrended windows of a log are joined where they were in time. Compared is the
    share that three neighbouring bins have of the whole spectrum, less the share that
    they have of that of the speed `v`. Left out are frequencies of less than one and a
    half periods to a window, and the multiples of how often a window begins: there a
    replay that starts anew from the measured state does so as well.

    Args:
        residual: measured minus replayed, SI.
        tick: step of the log, s.
        places: log, start and end (s) of each window.
        v: the piston's speed in the same windows, m/s.

    Returns:
        Its frequency, Hz; its share; and the chance that any three neighbouring bins
        of a spectrum that is smooth there have such a share of those around them (as
        R. A. Fisher's test of the largest bin, Proc. R. Soc. A 125, 1929).
    """
    power = _power(residual, tick, places)
    f = np.arange(power.size) / (2 * (power.size - 1) * tick)
    begins = np.array([start for _, start, _ in places])
    apart = np.diff(begins)[np.diff(begins) > 0]
    again = 1 / float(np.median(apart)) if apart.size else 2 * f[-1]
    off = np.abs(f - again * np.round(f / again))
    kept = (f > PERIODS / (residual.shape[1] * tick)) & (off > 2 * f[1])
    kept[-(AROUND + 2) :] = False
    if np.count_nonzero(kept) < 2 * AROUND:
        return 0.0, 0.0, 1.0
    three = np.convolve(power, np.ones(3), mode="same")
    share = three / max(np.sum(power[kept]), 1e-300)
    if v is not None and np.ptp(v) > 0:
        of_motion = _power(v, tick, places)
        share = share - np.convolve(of_motion, np.ones(3), mode="same") / np.sum(
            of_motion[kept]
        )
    top = int(np.argmax(np.where(kept, share, -np.inf)))
    near = np.sum(power[max(top - AROUND, 1) : top + AROUND + 1])
    spectra = len({log for log, *_ in places})
    far = stats.beta.sf(three[top] / near, 3 * spectra, (2 * AROUND - 2) * spectra)
    chance = min(np.count_nonzero(kept) * far, 1.0)
    return float(f[top]), float(share[top]), float(chance)


def _power(
    y: Float[np.ndarray, "windows ticks"],
    tick: float,
    places: Sequence[tuple[str, float, float]],
) -> Float[np.ndarray, "bins"]:
    """Mean spectrum of detrended windows, joined at their times, zero between them."""
    joined = _joined(signal.detrend(y, axis=-1), tick, places)
    return np.sum(np.abs(np.fft.rfft(joined)) ** 2, axis=0)


def _joined(
    y: Float[np.ndarray, "windows ticks"],
    tick: float,
    places: Sequence[tuple[str, float, float]],
) -> Float[np.ndarray, "segments ticks"]:
    """Windows at their times in segments of their logs, of an even number of ticks."""
    first: dict[str, float] = {}
    for log, start, _ in places:
        first[log] = min(start, first.get(log, start))
    at = [(log, round((start - first[log]) / tick)) for log, start, _ in places]
    span = max(k for _, k in at) + y.shape[1]
    length = 2 * -(-span // (2 * max(round(span * tick / SEGMENT), 1)))
    rows: dict[tuple[str, int], np.ndarray] = {}
    for (log, k), own in zip(at, y, strict=True):
        number, inside = divmod(k, length)
        row = rows.setdefault((log, number), np.zeros(length))
        fits = own[: length - inside]
        row[inside : inside + fits.size] = fits
    return np.array(list(rows.values()))
