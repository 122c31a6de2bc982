"""What a log's own noise is, and the band in which motion can be differentiated."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import interpolate, linalg, ndimage, signal, stats

from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.logs.log import Log
from hydrojax.rigfile.schema import RigFile

CHANNELS = ("P_a1", "P_a2", "F")
"""What a replay can predict, in the order of `Windows.measured`."""


class Noise(NamedTuple):
    """The channels' noise, SI; inf where a channel is not compared.

    What the noise of a position brings into a channel differs from log to log: a short
    chamber answers it more. Where nothing is validated both are the same.

    Attributes:
        fit: that of the logs to fit.
        check: that of the logs to validate.
    """

    fit: Float[np.ndarray, "3"]
    check: Float[np.ndarray, "3"]


STRETCH = 3.0
"""Over how many periods of a signal's band it is looked whether smoothing takes off
more than noise."""

HIGHEST = 0.4
"""Periods per row from which on a cut, near half the rate then, is not raised."""

BEYOND_NOISE = 1e-4
"""Level at which smoothing is found to take off more than noise."""


def estimate_noise(y: Float[np.ndarray, "rows"]) -> float:
    """Standard deviation of white noise on a smooth signal, in the unit of `y`.

    Sixth differences remove what is smooth; the median of their size is robust to
    jumps. Not below what rounding to the signal's own resolution makes.
    """
    weights = np.array([1, -6, 15, -20, 15, -6, 1.0])
    d = np.convolve(y, weights, "valid") / np.sqrt(np.sum(weights**2))
    steps = np.diff(np.unique(y))
    resolution = np.min(steps[steps > 1e-12 * np.ptp(y)], initial=np.ptp(y))
    return float(max(np.median(np.abs(d)) / 0.6745, resolution / np.sqrt(12)))


def motion_band(
    t: Float[np.ndarray, "rows"],
    x: Float[np.ndarray, "rows"],
    driven_by: str,
    criteria: Criteria = Criteria(),
) -> float | None:
    """Frequency (Hz) up to which acceleration can be had from a position, or None.

    The spectrum of a position falls until it meets the flat floor of its noise, which
    acceleration raises with the fourth power of frequency. The band is where noise
    brings at most the share `Criteria.band_noise` of the acceleration that stands clear
    of it, but not below `Criteria.lowest_band` unless it brings much there; None if
    that is all of it.
    """
    h = float(np.median(np.diff(t)))
    even = np.interp(np.arange(t[0], t[-1], h), t, x)
    f, power = signal.welch(even, 1 / h, nperseg=min(2048, even.size), detrend="linear")
    floor = np.median(power[f > 0.7 * f[-1]])
    rise = (2 * np.pi * f) ** 4
    step = f[1]
    clear = power > criteria.above_floor * floor
    size = np.sum((power * rise)[clear]) * step
    noise = np.cumsum(floor * rise) * step

    def up_to(share: float) -> float:
        below = np.nonzero(noise <= share**2 * size)[0]
        return float(f[below[-1]]) if below.size else float(f[1])

    lowest = criteria.lowest_band
    if driven_by == "pressures":
        lowest = min(lowest, up_to(criteria.rough_pressures))
    cut = max(up_to(criteria.band_noise[driven_by]), lowest)
    return None if cut > 0.4 / h else cut


def smooth(
    t: Float[np.ndarray, "rows"],
    y: Float[np.ndarray, "rows"],
    cut: float | Float[np.ndarray, "rows"],
) -> interpolate.CubicSpline:
    """A smoothing spline that passes what is below `cut` Hz, which may differ from row
    to row; ticks may be uneven.

    Its response is 1/(1 + (f/cut)^4), without phase. It is the natural cubic spline
    that SciPy's `make_smoothing_spline` gives, by Reinsch's banded equations for its
    second derivatives (Numerische Mathematik 10, 1967): SciPy sets up its penalty row
    by row in Python, which is slow on long logs. The spline is in the unit of `y`.
    """
    h, n = np.diff(t), t.size - 2
    lam = np.broadcast_to(1 / (np.median(h) * (2 * np.pi * cut) ** 4), t.shape)
    slope = 1 / h
    Q = np.stack([slope[:-1], -slope[:-1] - slope[1:], slope[1:]])  # second differences
    rows = [slice(i, n + i) for i in range(3)]
    weighed = np.stack([lam[own] for own in rows]) * Q
    bands = np.zeros((3, n))
    bands[2] = (h[:-1] + h[1:]) / 3 + np.sum(weighed * Q, axis=0)
    bands[1, 1:] = h[1:-1] / 6 + np.sum(weighed[1:, :-1] * Q[:2, 1:], axis=0)
    bands[0, 2:] = weighed[2, :-2] * Q[0, 2:]
    bent = linalg.solveh_banded(bands, np.diff(np.diff(y) * slope))
    moved = np.zeros(t.size)
    for own, by in zip(rows, weighed, strict=True):
        moved[own] += by * bent
    return interpolate.CubicSpline(t, y - moved, bc_type="natural")


@dataclass(frozen=True)
class SensorNoise:
    """The noise of a measured signal that drives a replay; SI.

    Attributes:
        sigma: its standard deviation, as far as it is white.
        step: between the values that the sensor gives, where that makes half of the
            noise or more; 0 where it does not.
        cut: Hz at which a smoothing spline errs least; inf if smoothing does not pay.
    """

    sigma: float
    step: float
    cut: float

    def smoothed(
        self, t: Float[np.ndarray, "rows"], y: Float[np.ndarray, "rows"]
    ) -> Float[np.ndarray, "rows"]:
        """The signal, in its unit, smoothed at `cut`, and higher where that takes off
        more than noise: a stroke may be slow, and a valve that shuts in it shake it for
        a moment.
        """
        if not np.isfinite(self.cut):
            return y
        h = float(np.median(np.diff(t)))
        rows = max(round(STRETCH / (self.cut * h)), 1)
        cut = np.full(y.size, self.cut)
        while True:
            out = smooth(t, y, cut)(t)
            square = ndimage.uniform_filter1d((y - out) ** 2, rows)
            most = _most_of_noise(self.cut, h, rows * h) * self._taken_off(cut, h)
            raised = (square > most) & (cut < HIGHEST / h)
            if not raised.any():
                return out
            cut = np.where(raised, 2 * cut, cut)

    def _taken_off(self, cut: np.ndarray, h: float) -> np.ndarray:
        """Variance of what smoothing at `cut` takes off white noise."""
        levels, which = np.unique(cut, return_inverse=True)
        f = np.linspace(0, 0.5 / h, 512) / levels[:, None]
        return (self.sigma**2 * np.mean((1 - 1 / (1 + f**4)) ** 2, axis=1))[which]

    def left(self, h: float) -> float:
        """Standard deviation of what smoothing leaves of it, with a row every `h` s."""
        if not np.isfinite(self.cut):
            return self.sigma
        # Of white noise up to 1/(2h), through 1/(1 + (f/cut)^4).
        return self.sigma * min(1.0, np.sqrt(3 * np.pi / np.sqrt(32) * self.cut * h))

    def again(
        self, y: Float[np.ndarray, "rows"], seed: int = 0
    ) -> Float[np.ndarray, "rows"]:
        """The signal measured once more by such a sensor.

        Where it moves by a step or more from row to row, its place between two steps is
        drawn: hardly smoothed it stands near them, and would be rounded to the same.
        """
        draw = np.random.default_rng(seed)
        rounding = self.step**2 / 12
        y = y + np.sqrt(max(self.sigma**2 - rounding, 0.0)) * draw.normal(size=y.size)
        if not self.step:
            return y
        offset = draw.uniform()
        steps = (y if np.isfinite(self.cut) else _without_steps(y)) / self.step
        passed = np.minimum(np.abs(np.gradient(steps)), 1.0)
        within = steps + passed * draw.uniform(-0.5, 0.5, y.size) + offset
        return y + (np.round(within) - within) * self.step


def _most_of_noise(cut: float, h: float, length: float) -> float:
    """Largest mean square of noise above `cut`, s `length` long, in its variance; at
    least twice: what a sensor rounds is louder while it moves.
    """
    freedom = max(2 * length * (0.5 / h - cut), 1.0)
    return max(2.0, float(stats.chi2.isf(BEYOND_NOISE, freedom)) / freedom)


def _without_steps(y: Float[np.ndarray, "rows"]) -> Float[np.ndarray, "rows"]:
    """A rounded signal as a line between the middles of its steps."""
    ahead = np.flatnonzero(np.diff(y))
    if not ahead.size:
        return y
    middles = (y[ahead] + y[ahead + 1]) / 2
    return np.interp(np.arange(y.size), ahead + 0.5, middles)


def sensor_noise_of(
    pieces: Iterable[tuple[Float[np.ndarray, "rows"], Float[np.ndarray, "rows"]]],
    criteria: Criteria = Criteria(),
) -> SensorNoise | None:
    """A signal's noise, the median over pieces (time, signal) of some rows; None where
    their spectra have no floor.
    """
    found = [b for t, y in pieces if (b := _sensor_noise(t, y, criteria))]
    if not found:
        return None
    sigma = float(np.median([b.sigma for b in found]))
    cut = float(np.median([b.cut for b in found]))
    steps = [b.step for b in found if b.step]
    step = float(np.median(steps)) if 2 * len(steps) > len(found) else 0.0
    return SensorNoise(sigma, step, cut)


def _sensor_noise(
    t: np.ndarray, y: np.ndarray, criteria: Criteria
) -> SensorNoise | None:
    if np.ptp(y) == 0:
        return None
    # Moved to even times along its own slope: interpolating would smooth the noise.
    h = (t[-1] - t[0]) / (t.size - 1)
    slope = signal.savgol_filter(y, 11, 2, deriv=1) / h
    even = y + slope * (t[0] + h * np.arange(t.size) - t)
    size = min(2048, max(y.size // 4, 16))
    f, power = signal.welch(even, 1 / h, nperseg=size, detrend="linear")
    end = f[-1]
    median = _floor(f / end, power, criteria)
    if not median:
        return None
    floor = median / _median_of_mean(y.size, size)
    sigma = np.sqrt(floor * end)
    # Least squares: what smoothing takes off the signal, and leaves of the noise.
    cuts = f[2 : int(0.8 * f.size)]
    passes = 1 / (1 + (f / cuts[:, None]) ** 4)
    clear = np.maximum(power - floor, 0.0)
    cost = (1 - passes) ** 2 @ clear + floor * np.sum(passes**2, axis=1)
    best = int(np.argmin(cost))
    cut = float(cuts[best]) if best < cuts.size - 1 else np.inf
    steps = np.diff(np.unique(y))
    step = float(np.min(steps[steps > 1e-12 * np.ptp(y)]))
    return SensorNoise(
        float(sigma), step if step / np.sqrt(12) > 0.5 * sigma else 0.0, cut
    )


def _floor(share: np.ndarray, power: np.ndarray, criteria: Criteria) -> float:
    """Median power of a spectrum's floor, over the share of its band; 0 without one."""

    def between(low: float, high: float) -> float:
        return float(np.median(power[(share > low) & (share <= high)]))

    last = between(0.8, 1.0)
    # At 100 Hz a hard stop moves an encoder up to half of the band, and not its end.
    if (
        between(0.4, 0.6) <= criteria.flat_floor * last
        or between(0.6, 0.8) <= criteria.flat_end * last
    ):
        return last
    if share.size < criteria.fewest_bins:
        return 0.0
    # A slow log shows its floor at the very end, and one that was brought forward
    # ahead of it: between rows, a signal is interpolated. Only motion falls so steeply.
    early = between(0.25, 0.35)
    for low, middle, high, flat in (
        (0.75, 0.875, 1.0, criteria.flat_end),
        (0.6, 0.7, 0.8, criteria.flat_part),
    ):
        first, second = between(low, middle), between(middle, high)
        if first <= flat * second and early > criteria.steep_fall * first:
            return second
    return 0.0


def _median_of_mean(rows: int, size: int) -> float:
    """Median over mean of white noise's power by Welch's method, half-overlapping
    segments of `size` rows under a Hann window.

    Source: P. D. Welch, IEEE Trans. Audio Electroacoust. 15 (1967), for the degrees of
    freedom; E. B. Wilson, M. M. Hilferty, PNAS 17 (1931), for chi-square's median.
    """
    segments = max((rows - size // 2) // (size - size // 2), 1)
    freedom = 36 * segments**2 / (19 * segments - 1)
    return (1 - 2 / (9 * freedom)) ** 3


def derivatives(
    t: Float[np.ndarray, "rows"], y: Float[np.ndarray, "rows"]
) -> Float[np.ndarray, "rows 2"]:
    """First and second derivative of a measured signal, smoothed as far as it pays."""
    if np.ptp(y) == 0:
        return np.zeros((t.size, 2))
    noise, most = sensor_noise_of([(t, y)]), 0.4 / float(np.median(np.diff(t)))
    smoothed = smooth(t, y, min(noise.cut, most) if noise else most)
    return np.stack([smoothed(t, 1), smoothed(t, 2)], axis=1)


def channel_noise(
    logs: Sequence[Log], spec: RigFile, driven_by: str
) -> Float[np.ndarray, "3"]:
    """Noise of each channel, from the rig file or the logs; inf where not compared."""
    out = np.full(3, np.inf)
    for c, name in enumerate(CHANNELS):
        if name != "F" and driven_by != "u":
            continue
        if name != "F" and name not in logs[0].signals:
            continue
        if name == "F" and "F" not in logs[0].signals and "F" not in spec.output_load:
            continue
        if name in spec.sensors:
            out[c] = spec.sensors[name]
        else:
            out[c] = _estimated(logs, spec, name, driven_by)
    return out


def supply_noise_of(logs: Sequence[Log], spec: RigFile) -> float:
    """Noise of the measured supply pressure, Pa; 0 where the logs have none."""
    if "P_s" not in logs[0].signals:
        return 0.0
    if "P_s" in spec.sensors:
        return spec.sensors["P_s"]
    return level(logs, "P_s")


def force_areas(spec: RigFile) -> tuple[float, float]:
    """Areas on which P_a1 and P_a2 push, m^2; (16)."""
    area_1, area_2 = spec.layout.areas(spec.geometry)[1].tolist()
    return area_1, area_2


def level(logs: Sequence[Log], name: str) -> float:
    """Noise of one signal over the logs' whole stretches, in its own unit."""
    each = [
        estimate_noise(log.signals[name][slice(*rows)])
        for log in logs
        for rows in log.segments
        if np.ptp(log.signals[name][slice(*rows)]) > 0
    ]
    return float(np.median(each)) if each else 0.0


def _estimated(logs, spec, name, driven_by) -> float:
    """Noise of a channel from the logs; with what the drive brings into a force."""
    has = logs[0].signals

    out = level(logs, name) if name in has else 0.0
    if name == "F" and (driven_by != "u" or "F" not in has):
        areas = dict(zip(("P_a1", "P_a2"), force_areas(spec), strict=True))
        for drive, area in {**areas, "P": 1.0}.items():
            if drive in has and area > 0:
                out = float(np.hypot(out, area * level(logs, drive)))
    return out
