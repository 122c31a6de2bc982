"""The reference rig, and what the experiments on it give."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hydrojax.control import theory
from hydrojax.jax_setup import ensure_jax
from hydrojax.plant.rig import Rig
from hydrojax.rigfile.build import build_rig
from hydrojax.rigfile.schema import RigFile


@dataclass(frozen=True)
class Track:
    """One case: desired and actual force over time; SI.

    `rms` is of their difference in the steady part.
    """

    t: Float[np.ndarray, "n"]
    desired: Float[np.ndarray, "n"]
    actual: Float[np.ndarray, "n"]
    rms: float


@dataclass(frozen=True)
class Response:
    """|F/F_d| in dB by white noise, with its coherence, and by single sines.

    `hertz` are the sines' frequencies; `noise_hertz`, `noise_dB`, `coherence`
    the noise's. `alone_dB` is of sines without the noise beneath them. `by_bounds` is
    up to where the response to noise stays within 1 dB, Hz, by the bounds of k_f.
    """

    hertz: Float[np.ndarray, "n"]
    sines_dB: Float[np.ndarray, "n"]
    alone_dB: Float[np.ndarray, "n"]
    noise_hertz: Float[np.ndarray, "m"]
    noise_dB: Float[np.ndarray, "m"]
    coherence: Float[np.ndarray, "m"]
    by_bounds: dict[str, float]

    def at(self, values: Float[np.ndarray, "m"]) -> Float[np.ndarray, "n"]:
        """Values over the noise's frequencies, at those of the sines; NaN beyond."""
        return np.interp(self.hertz, self.noise_hertz, values, right=np.nan)


@dataclass(frozen=True)
class Descent:
    """W of (31), its bound (35), and the part of W that the tracking error makes, over
    time at a matched plant.
    """

    t: Float[np.ndarray, "n"]
    W: Float[np.ndarray, "n"]
    bound: Float[np.ndarray, "n"]
    tracking: Float[np.ndarray, "n"]


class Reproduced(NamedTuple):
    """What one reading of the paper gives.

    RMS of P_d - P in Figs. 2 (b) and (c), N, and up to where Fig. 5 stays within 1 dB,
    Hz.
    """

    fig2_b: float
    fig2_c: float
    within_1dB: float


@dataclass(frozen=True)
class Experiments:
    """All that `hydrojax paper` shows."""

    tracks: dict[str, dict[str, Track]]
    ablation: Track
    response: Response
    descent: dict[float, Descent]
    supply: theory.Supply
    readings: dict[str, Reproduced]


def reference_rig() -> RigFile:
    """The reference rig: 200 Hz spool, 1 ms of computing."""
    file = resources.files("hydrojax") / "paper" / "reference.toml"
    with resources.as_file(file) as path:
        return RigFile.load(path)


def reference() -> tuple[RigFile, Rig]:
    """The reference rig's file and its plant."""
    ensure_jax()
    spec = reference_rig()
    return spec, build_rig(spec)
