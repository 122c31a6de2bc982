"""Desired forces and motions of closed-loop runs, as values.

A quantity is text with a unit (`"300 N"`), a pint quantity, or a number in SI.
"""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hydrojax import units
from hydrojax.control import waveforms
from hydrojax.control.simulation import Trajectory, hold
from hydrojax.errors import InputError
from hydrojax.units import QuantityLike


class AbstractReference(abc.ABC):
    """A desired force. A subclass says what it is at every control period."""

    @abc.abstractmethod
    def force(
        self, n: int, h: float, rng: np.random.Generator
    ) -> Float[np.ndarray, "n"]:
        """The desired force at n samples, N.

        Args:
            n: number of samples.
            h: control period, s.
            rng: source of random numbers.

        Raises:
            InputError: it cannot be sampled at this period.
        """

    def seconds(self, h: float) -> float:
        """The longest run that it serves, s, at the control period `h`."""
        return math.inf


class AbstractMotion(abc.ABC):
    """A motion of the piston, or of the environment that its load is held by."""

    @abc.abstractmethod
    def path(self, rng: np.random.Generator) -> Trajectory:
        """Position and its derivatives as a function of time.

        Args:
            rng: source of random numbers.
        """

    def seconds(self, h: float) -> float:
        """The longest run that it serves, s, at the control period `h`."""
        return math.inf


def _below_half(says: str, hertz: float, h: float) -> None:
    """Refuse what no samples every h seconds can show."""
    if hertz >= 0.5 / h:
        raise InputError(
            f"{says} {hertz:g} Hz: expected less than half the sampling rate, "
            f"{0.5 / h:g} Hz"
        )


@dataclass(frozen=True)
class Sine(AbstractReference):
    """`offset + amplitude * sin(2 pi frequency t)`: N, N, Hz; see `sine`."""

    amplitude: float
    frequency: float
    offset: float = 0.0

    def force(
        self, n: int, h: float, rng: np.random.Generator
    ) -> Float[np.ndarray, "n"]:
        """The sinusoid at n samples, N."""
        _below_half("sine: invalid frequency", self.frequency, h)
        t = np.arange(n) * h
        return self.offset + self.amplitude * np.sin(2 * np.pi * self.frequency * t)


@dataclass(frozen=True)
class Sines(AbstractReference):
    """Forty random sines with an RMS in N; see `sines`."""

    rms: float

    def force(
        self, n: int, h: float, rng: np.random.Generator
    ) -> Float[np.ndarray, "n"]:
        """The sum of sines at n samples, N."""
        return waveforms.random_sines(rng, np.arange(n) * h, self.rms)


@dataclass(frozen=True)
class Noise(AbstractReference):
    """White noise with an RMS in N up to `band` Hz; see `noise`."""

    rms: float
    band: float

    def force(
        self, n: int, h: float, rng: np.random.Generator
    ) -> Float[np.ndarray, "n"]:
        """The noise at n samples, N; see `AbstractReference.force`."""
        _below_half("noise: invalid band", self.band, h)
        return waveforms.band_noise(rng, n, h, self.rms, self.band)


@dataclass(frozen=True, eq=False)
class Samples(AbstractReference):
    """Given values, one a control period, N; the run ends with them.

    Raises:
        InputError: not one row of finite numbers.
    """

    values: Float[np.ndarray, "samples"]

    def __post_init__(self) -> None:
        if self.values.ndim != 1 or not np.isfinite(self.values).all():
            raise InputError(
                "reference: invalid array: expected one row of finite numbers, N"
            )

    def force(
        self, n: int, h: float, rng: np.random.Generator
    ) -> Float[np.ndarray, "n"]:
        """The first n values, N."""
        return self.values[:n]

    def seconds(self, h: float) -> float:
        """How long the values last, s."""
        return self.values.size * h


@dataclass(frozen=True)
class ToAndFro(AbstractMotion):
    """A sinusoid that starts at rest at one end: m/s, s; see `to_and_fro`."""

    speed: float
    period: float

    def path(self, rng: np.random.Generator) -> Trajectory:
        """See `AbstractMotion.path`."""
        return waveforms.sinusoidal_path(self.speed, self.period)


@dataclass(frozen=True)
class Wander(AbstractMotion):
    """A smooth random motion with a peak speed in m/s; see `wander`."""

    speed: float

    def path(self, rng: np.random.Generator) -> Trajectory:
        """See `AbstractMotion.path`."""
        return waveforms.random_path(rng, self.speed)


@dataclass(frozen=True)
class Locked(AbstractMotion):
    """No motion, at `x` m from mid-stroke; see `locked`."""

    x: float

    def path(self, rng: np.random.Generator) -> Trajectory:
        """See `AbstractMotion.path`."""
        return hold(self.x)


def sine(
    amplitude: QuantityLike = 300.0,
    frequency: QuantityLike = 0.5,
    offset: QuantityLike = 0.0,
) -> AbstractReference:
    """A sinusoidal desired force about an offset.

    Args:
        amplitude: N.
        frequency: Hz.
        offset: N.

    Raises:
        InputError: a quantity of another dimension, or not above 0 (`offset` may be).
    """
    return Sine(
        _positive(amplitude, "N", "sine: amplitude"),
        _positive(frequency, "Hz", "sine: frequency"),
        units.in_si(offset, "N", "sine: offset"),
    )


def sines(rms: QuantityLike = 400.0) -> AbstractReference:
    """Forty random sines of 0.1 to 20 Hz that fall off above 2 Hz.

    Args:
        rms: of the desired force, N.

    Raises:
        InputError: a quantity of another dimension, or not above 0.
    """
    return Sines(_positive(rms, "N", "sines: rms"))


def noise(rms: QuantityLike = 200.0, band: QuantityLike = 50.0) -> AbstractReference:
    """White noise through a fourth-order Butterworth low-pass filter.

    Args:
        rms: of the desired force, N.
        band: the filter's corner, Hz; below half the sampling rate.

    Raises:
        InputError: a quantity of another dimension, or not above 0.
    """
    return Noise(
        _positive(rms, "N", "noise: rms"), _positive(band, "Hz", "noise: band")
    )


def to_and_fro(
    speed_or_stroke: QuantityLike = 0.03, period: QuantityLike = 3.0
) -> AbstractMotion:
    """A sinusoidal motion about mid-stroke that starts at rest at its lower end.

    Args:
        speed_or_stroke: the peak speed, m/s, or a length (such as "30 mm"): the
            distance from end to end. A bare number is a speed.
        period: of one cycle, s.

    Raises:
        InputError: a quantity of another dimension, or not above 0.
    """
    where = "to_and_fro: speed_or_stroke"
    T = _positive(period, "s", "to_and_fro: period")
    if units.is_a(speed_or_stroke, "m", where):
        stroke = _positive(speed_or_stroke, "m", where)
        return ToAndFro(np.pi * stroke / T, T)
    return ToAndFro(_positive(speed_or_stroke, "m/s", where), T)


def wander(speed: QuantityLike = 0.025) -> AbstractMotion:
    """A smooth random motion about mid-stroke: eight sines of 0.05 to 1.2 Hz.

    Args:
        speed: the peak speed, m/s; less where 20 mm from mid-stroke limits it first.

    Raises:
        InputError: a quantity of another dimension, or not above 0.
    """
    return Wander(_positive(speed, "m/s", "wander: speed"))


def locked(x: QuantityLike = 0.0) -> AbstractMotion:
    """No motion.

    Args:
        x: the position, m from mid-stroke.

    Raises:
        InputError: a quantity of another dimension.
    """
    return Locked(units.in_si(x, "m", "locked: x"))


def _positive(value: QuantityLike, unit: str, where: str) -> float:
    """The SI value of a quantity above 0."""
    number = units.in_si(value, unit, where)
    if number <= 0:
        raise InputError(f"{where}: {str(value)!r} must be above 0")
    return number
