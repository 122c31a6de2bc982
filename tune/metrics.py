"""What a frequency response is worth: bandwidths, peak, margins, noise."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

LEAST_HZ, LINES = 0.5, 160
"""Where the grid of frequencies begins, and how many it has up to half the rate."""

UNITS = {
    "within_1dB": "Hz", "minus_3dB": "Hz", "lag_90": "Hz", "peak": "dB",
    "gain_margin": "dB", "phase_margin": "deg", "delay_margin": "s",
    "radius": "1", "noise_F": "N", "noise_u": "{u}", "push": "{u}/N",
}  # fmt: skip
"""What `merits` gives, and its units."""

SAYS = {
    "within_1dB": "highest frequency up to which |F/F_d| is within 1 dB",
    "minus_3dB": "where |F/F_d| first falls below -3 dB",
    "lag_90": "where F first lags F_d by 90 degrees",
    "peak": "largest |F/F_d|",
    "gain_margin": "factor on the command that the loop bears",
    "phase_margin": "least phase margin of the loop opened at the command",
    "delay_margin": "further delay that the loop bears",
    "radius": "largest |eigenvalue| of a sample's step: stable below 1",
    "noise_F": "RMS of F by the sensors' noise alone",
    "noise_u": "RMS of the command by the sensors' noise alone",
    "push": "largest |u/F_d| up to within_1dB",
}


def grid(rate: float, lines: int = LINES) -> np.ndarray:
    """Frequencies from LEAST_HZ to just below half the rate, [lines], Hz."""
    return np.geomspace(LEAST_HZ, 0.499 * rate, lines)


def dB(H: Array) -> Array:
    """Size in dB, finite with its derivative where H is 0."""
    return 10 * jnp.log10(jnp.real(H) ** 2 + jnp.imag(H) ** 2 + 1e-30)


def first(hertz: Array, inside: Array) -> Array:
    """The frequency at which `inside` [n] first goes below 0, by line, Hz.

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


def within(hertz: Array, H: Array, most: float = 1.0) -> Array:
    """The highest frequency up to which |H| stays within `most` dB, Hz.

    0 where it is not even at the first.
    """
    inside = most - jnp.abs(dB(H))
    return jnp.where(inside[0] < 0, 0.0, first(hertz, inside))


def soft_inside(H: Array, most: float | Array, width: float) -> Array:
    """How well |H| has been within `most` dB up to each frequency, 1 to 0, [n].

    `width` (dB) is over how much "within" fades.
    """
    inside = (most - jnp.abs(dB(H))) / width
    return jnp.exp(jnp.cumsum(-jnp.logaddexp(0.0, -inside)))


def unwrapped(H: Array) -> Array:
    """Phase without jumps, rad."""
    return jnp.unwrap(jnp.angle(H))


def margins(hertz: Array, L: Array) -> tuple[Array, Array, Array]:
    """Gain margin (dB), phase margin (deg) and delay margin (s) of a loop, [n].

    The loop is opened at the command. Least over all crossings on the grid, each found
    by line. A gain that may only be lowered counts not: that edge is the delay's.
    inf where nothing crosses.
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


def rms(hertz: Array, H: Array) -> Array:
    """RMS of white noise of one sample's variance 1 behind H, up to half the rate."""
    power = jnp.abs(H) ** 2
    area = jnp.sum((power[1:] + power[:-1]) / 2 * jnp.diff(hertz))
    mean = (area + power[0] * hertz[0]) / hertz[-1]
    # A noise that the controller does not read has no derivative, not an infinite one.
    return jnp.where(mean > 0, jnp.sqrt(jnp.where(mean > 0, mean, 1.0)), 0.0)


def merits(hertz: Array, H: Array, radius: Array) -> dict[str, Array]:
    """All of `UNITS`, of a response [n, 2, 5] as `linear.response` gives it.

    An unstable loop has no bandwidth: NaN, but for its radius.
    """
    track, push = H[:, 0, 0], H[:, 1, 0]
    L = 1 / H[:, 1, 1] - 1  # what is added to the command comes out as 1 / (1 + L)
    gain, phase, delay = margins(hertz, L)
    edge = within(hertz, track)
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


def number(value: Any) -> Any:
    """A finite number, or None."""
    return float(value) if np.isfinite(value) else None


def least(values: np.ndarray) -> float:
    """The least bandwidth: an unstable plant has none."""
    return float(np.min(np.nan_to_num(values, nan=0.0)))


def most(values: np.ndarray) -> float | None:
    """The largest, None if one is unstable."""
    return number(np.max(values))
