"""Metrics of a frequency response: bandwidths, peak, margins, noise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

MIN_HZ, LINES = 0.5, 160
"""Where the grid of frequencies begins, and how many it has up to half the rate."""

UNITS = {
    "within_1dB": "Hz", "minus_3dB": "Hz", "lag_90": "Hz", "peak": "dB",
    "gain_margin": "dB", "phase_margin": "deg", "delay_margin": "s",
    "radius": "1", "noise_F": "N", "noise_u": "{u}", "push": "{u}/N",
}  # fmt: skip
"""What `loop_metrics` gives, and its units."""

DESCRIPTIONS = {
    "within_1dB": "highest frequency up to which |F/F_d| is within 1 dB",
    "minus_3dB": "where |F/F_d| first falls below -3 dB",
    "lag_90": "where F first lags F_d by 90 degrees",
    "peak": "largest |F/F_d|",
    "gain_margin": "gain margin of the loop opened at the command",
    "phase_margin": "smallest phase margin of the loop opened at the command",
    "delay_margin": "delay margin of the loop opened at the command",
    "radius": "spectral radius of the sampled loop: stable below 1",
    "noise_F": "RMS of F due to sensor noise alone",
    "noise_u": "RMS of the command due to sensor noise alone",
    "push": "largest |u/F_d| up to within_1dB",
}


def grid(rate: float, lines: int = LINES) -> Float[np.ndarray, "lines"]:
    """Frequencies from MIN_HZ to just below half the rate, Hz."""
    return np.geomspace(MIN_HZ, 0.499 * rate, lines)


def dB(H: Complex[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Magnitude in dB, finite with its derivative where H is 0."""
    return 10 * jnp.log10(jnp.real(H) ** 2 + jnp.imag(H) ** 2 + 1e-30)


def decibels(H: Complex[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
    """`dB` of NumPy arrays."""
    return 10 * np.log10(np.abs(H) ** 2 + 1e-30)


def first(
    hertz: Float[Array, "lines"], inside: Float[Array, "lines"]
) -> Float[Array, ""]:
    """Where `inside` first falls below 0, linearly interpolated, Hz.

    The first frequency if it is below there already, the last if it never is.
    """
    out = inside < 0
    i = jnp.argmax(out)
    b = jnp.maximum(i, 1)
    fall = inside[b - 1] - inside[b]
    part = inside[b - 1] / jnp.where(fall > 0, fall, 1.0)
    at = hertz[b - 1] + jnp.clip(part, 0.0, 1.0) * (hertz[b] - hertz[b - 1])
    found = jnp.where(i == 0, hertz[0], at)
    return jnp.where(jnp.any(out), found, hertz[-1])


def band(
    hertz: Float[Array, "lines"], inside: Float[Array, "lines"]
) -> Float[Array, ""]:
    """`first`, but 0 where `inside` is below 0 at the first frequency already, Hz."""
    return jnp.where(inside[0] < 0, 0.0, first(hertz, inside))


def band_within(
    hertz: Float[Array, "lines"], H: Complex[Array, "lines"], most: float = 1.0
) -> Float[Array, ""]:
    """The highest frequency up to which |H| stays within `most` dB, Hz.

    0 where it is not even at the first.
    """
    return band(hertz, most - jnp.abs(dB(H)))


def unwrapped(H: Complex[Array, "lines"]) -> Float[Array, "lines"]:
    """Phase without jumps, rad."""
    return jnp.unwrap(jnp.angle(H))


def margins(
    hertz: Float[Array, "lines"], L: Complex[Array, "lines"]
) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
    """Gain margin (dB), phase margin (deg) and delay margin (s) of an open loop.

    The loop is opened at the command. The smallest over all crossings on the grid,
    each interpolated linearly. Lowering the gain is not counted as a margin: that
    limit shows in the delay margin. inf where nothing crosses.
    """
    size, phase = dB(L), jnp.unwrap(jnp.angle(L))
    # Phase crossings: Im L = 0 with Re L < 0.
    a, b = jnp.imag(L[:-1]), jnp.imag(L[1:])
    part = a / jnp.where(a == b, 1.0, a - b)
    real = jnp.real(L[:-1]) + part * (jnp.real(L[1:]) - jnp.real(L[:-1]))
    crossed = (a * b < 0) & (real < 0) & (real > -1)
    gain = jnp.min(jnp.where(crossed, -20 * jnp.log10(jnp.abs(real) + 1e-30), jnp.inf))
    a, b = size[:-1], size[1:]
    crossed = a * b < 0
    part = a / jnp.where(a == b, 1.0, a - b)
    angle = phase[:-1] + part * (phase[1:] - phase[:-1])
    at = hertz[:-1] + part * (hertz[1:] - hertz[:-1])
    lead = jnp.mod(angle + jnp.pi, 2 * jnp.pi)
    signed = jnp.where(lead > jnp.pi, lead - 2 * jnp.pi, lead)
    phase_margin = jnp.min(jnp.where(crossed, jnp.abs(signed), jnp.inf))
    delay = jnp.min(jnp.where(crossed, lead / (2 * jnp.pi * at), jnp.inf))
    return gain, jnp.rad2deg(phase_margin), delay


def rms(hertz: Float[Array, "lines"], H: Complex[Array, "lines"]) -> Float[Array, ""]:
    """RMS of white noise of one sample's variance 1 behind H, up to half the rate."""
    power = jnp.abs(H) ** 2
    area = jnp.sum((power[1:] + power[:-1]) / 2 * jnp.diff(hertz))
    mean = (area + power[0] * hertz[0]) / hertz[-1]
    # A noise that the controller does not read has no derivative, not an infinite one.
    return jnp.where(mean > 0, jnp.sqrt(jnp.where(mean > 0, mean, 1.0)), 0.0)


def loop_metrics(
    hertz: Float[Array, "lines"],
    H: Complex[Array, "lines 2 5"],
    radius: Float[Array, ""],
) -> dict[str, Float[Array, ""]]:
    """All of `UNITS`, of a response as `linearize.frequency_response` gives it.

    An unstable loop has no bandwidth: all are NaN, except its radius.
    """
    track, push = H[:, 0, 0], H[:, 1, 0]
    L = 1 / H[:, 1, 1] - 1  # what is added to the command comes out as 1 / (1 + L)
    gain, phase, delay = margins(hertz, L)
    edge = band_within(hertz, track)
    noise = [
        jnp.sqrt(sum(rms(hertz, H[:, o, i]) ** 2 for i in (2, 3, 4))) for o in (0, 1)
    ]
    found = {
        "within_1dB": edge,
        "minus_3dB": first(hertz, dB(track) + 3.0),
        "lag_90": first(hertz, unwrapped(track) + jnp.pi / 2),
        "peak": jnp.max(dB(track)),
        "gain_margin": gain,
        "phase_margin": phase,
        "delay_margin": delay,
        "noise_F": noise[0],
        "noise_u": noise[1],
        "push": jnp.max(jnp.where(hertz <= edge, jnp.abs(push), 0.0)),
    }
    found = {n: jnp.where(radius < 1, v, jnp.nan) for n, v in found.items()}
    return found | {"radius": radius}


def finite_or_none(value: Any) -> Any:
    """A finite number, or None."""
    return float(value) if np.isfinite(value) else None


def maximum(values: Float[np.ndarray, "plants"]) -> float | None:
    """The largest value; None if a plant is unstable."""
    return finite_or_none(np.max(values))


SUMMARY = {"within_1dB": "within_1dB_Hz", "peak": "peak_dB", "rms": "rms_moving_N"}
"""The linear metrics by which models are compared, and their names there."""


def rig_metrics(
    found: Mapping[str, Float[np.ndarray, "plants *rest"]],
) -> dict[str, float | None]:
    """The metrics of the rig itself by `SUMMARY`'s names; None where it is unstable."""
    return {name: finite_or_none(found[key][0]) for key, name in SUMMARY.items()}
