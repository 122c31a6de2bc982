"""What a tuning makes as large as it can, and the limits that it keeps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Complex, Float

WIDTH = 0.15
"""Over what share of its tolerance "within" fades in a smooth band."""

TOLERANCE = 0.2
"""Default of |1 - F/F_d|: a lag of 11 degrees, or 1.6 dB."""


class Seen(NamedTuple):
    """What an aim is judged by, of every plant.

    `hertz` [lines]; `response` F/F_d at rest; `rms_moving` of F_d - F with the joint
    moving, N; `rejection` of slow disturbances, dB (the lower the better).
    """

    hertz: Float[np.ndarray, "lines"]
    response: Complex[np.ndarray, "plants lines"]
    rms_moving: Float[np.ndarray, "plants"]
    rejection: Float[np.ndarray, "plants"]


def soft_kept(
    off: Float[np.ndarray, "plants lines"],
) -> Float[np.ndarray, "plants lines"]:
    """How well `off` has been below 1 up to each frequency, 1 to 0."""
    return np.exp(np.cumsum(-np.logaddexp(0.0, (off - 1) / WIDTH), axis=-1))


def soft_band(
    hertz: Float[np.ndarray, "lines"], off: Float[np.ndarray, "plants lines"]
) -> Float[np.ndarray, "plants"]:
    """A smooth band up to which `off` stays below 1, Hz."""
    kept = soft_kept(off)
    return hertz[0] + np.sum(kept[:, 1:] * np.diff(hertz), axis=-1)


def smallest(values: Float[np.ndarray, "n"], sharp: float = 2.0) -> float:
    """The smallest of `values`, smoothly."""
    low = np.min(values)
    return float(low - np.log(np.mean(np.exp(-sharp * (values - low)))) / sharp)


@dataclass(frozen=True)
class Aim(ABC):
    """What is made as large as it can be."""

    word: ClassVar[str]
    """What the command line calls it."""

    @abstractmethod
    def score(self, seen: Seen) -> float:
        """The logarithm of what is made large, of the worst plant."""

    @abstractmethod
    def measured(self, figures: Mapping[str, Any]) -> float:
        """What is made large, as runs measured it: of tune.json's figures."""

    @property
    @abstractmethod
    def description(self) -> str:
        """In a few words."""

    @property
    @abstractmethod
    def reached(self) -> str:
        """What `measured` gives the size of, with its unit."""


@dataclass(frozen=True)
class Following(Aim):
    """The widest band in which F follows F_d in magnitude and phase.

    Attributes:
        tolerance: of |1 - F/F_d|.
    """

    tolerance: float = TOLERANCE
    word: ClassVar[str] = "following"

    def score(self, seen: Seen) -> float:
        """See `Aim`."""
        off = np.abs(1 - seen.response) / self.tolerance
        band = soft_band(seen.hertz, off)
        return float(np.log(max(smallest(band), 1e-3)))

    def measured(self, figures: Mapping[str, Any]) -> float:
        """See `Aim`."""
        return float(figures["follows_to_Hz"] or 0.0)

    @property
    def description(self) -> str:
        """See `Aim`."""
        return f"the widest band with |1 - F/F_d| at most {self.tolerance:g}"

    @property
    def reached(self) -> str:
        """See `Aim`."""
        return "follows up to (Hz)"


@dataclass(frozen=True)
class Magnitude(Aim):
    """The widest band in which |F/F_d| is within some dB, whatever the phase.

    Attributes:
        within_dB: of |F/F_d|.
    """

    within_dB: float = 1.0
    word: ClassVar[str] = "magnitude"

    def score(self, seen: Seen) -> float:
        """See `Aim`."""
        dB = 20 * np.log10(np.abs(seen.response) + 1e-15)
        band = soft_band(seen.hertz, np.abs(dB) / self.within_dB)
        return float(np.log(max(smallest(band), 1e-3)))

    def measured(self, figures: Mapping[str, Any]) -> float:
        """See `Aim`."""
        return float(figures["within_1dB_Hz"] or 0.0)

    @property
    def description(self) -> str:
        """See `Aim`."""
        return f"the widest band with |F/F_d| within {self.within_dB:g} dB"

    @property
    def reached(self) -> str:
        """See `Aim`."""
        return "magnitude kept up to (Hz)"


@dataclass(frozen=True)
class Tracking(Aim):
    """The smallest error while the joint moves."""

    word: ClassVar[str] = "tracking"

    def score(self, seen: Seen) -> float:
        """See `Aim`."""
        return -float(np.log(np.max(seen.rms_moving)))

    def measured(self, figures: Mapping[str, Any]) -> float:
        """See `Aim`."""
        return -float(figures["rms_moving_N"] or np.inf)

    @property
    def description(self) -> str:
        """See `Aim`."""
        return "the smallest tracking error with the joint moving"

    @property
    def reached(self) -> str:
        """See `Aim`."""
        return "error, joint moving (N RMS)"


@dataclass(frozen=True)
class Rejection(Aim):
    """The best rejection of slow disturbances, with the joint moving."""

    word: ClassVar[str] = "rejection"

    def score(self, seen: Seen) -> float:
        """See `Aim`."""
        return -float(np.max(seen.rejection)) / 20 * np.log(10)

    def measured(self, figures: Mapping[str, Any]) -> float:
        """See `Aim`."""
        return -float(figures["rms_moving_N"] or np.inf)

    @property
    def description(self) -> str:
        """See `Aim`."""
        return "the best rejection of slow disturbances"

    @property
    def reached(self) -> str:
        """See `Aim`."""
        return "error, joint moving (N RMS)"


AIMS: tuple[type[Aim], ...] = (Following, Magnitude, Tracking, Rejection)
"""The aims, the default first."""


@dataclass(frozen=True)
class Limits:
    """What the tuned loop must keep, for every plant of the ensemble.

    Attributes:
        peak_dB: largest |F/F_d|, joint at rest, dB.
        sensitivity_dB: largest |1 / (1 + L)| of the loop opened at the command, at
            rest: 6 dB ensure a gain margin of 6 dB and a phase margin of 29 degrees.
        moving_dB: the same at the peak speed of the runs either way, where no
            presliding lowers the gain, adaptation live; where the gains before are
            sound but have less, theirs.
        noise: RMS of the command by sensor noise, share of u_max.
        push: command at the setting's amplitude where F follows, share of u_max.
        tracking: RMS of F_d - F in the moving run, relative to before, plant by plant;
            where a plant is unstable before, twice as much.
        rejection: of disturbances at 2 Hz, relative to before.
    """

    peak_dB: float = 3.0
    sensitivity_dB: float = 6.0
    moving_dB: float = 9.0
    noise: float = 0.01
    push: float = 0.9
    tracking: float = 1.0
    rejection: float = 0.7


CONSTRAINTS = ("peak", "sensitivity", "noise", "push", "tracking", "rejection")
"""The constraints, in the order in which `objective.Objective` gives them."""
