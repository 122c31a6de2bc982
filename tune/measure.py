"""The closed loop measured in simulation: by multisine and by white noise.

Both begin at the operating point with the law as it runs, adaptation and sensor noise
included, or with the adaptation frozen. Friction, saturation and what the small-signal
view leaves out make what is found depend on the amplitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from hydrojax.control.loop import step_loop
from hydrojax.control.waveforms import band_noise
from hydrojax.rigfile.quantities import Setting
from hydrojax.tune import metrics, operating_point

KEEP = ("true_F", "u", "true_P_a1", "true_P_a2")

UNITS = {
    "within_1dB": "Hz", "minus_3dB": "Hz", "lag_90": "Hz", "peak": "dB",
    "rms_error": "N", "saturation": "1", "violations": "1",
}  # fmt: skip
"""What a measurement gives."""

DESCRIPTIONS = {
    **{
        name: metrics.DESCRIPTIONS[name]
        for name in ("within_1dB", "minus_3dB", "lag_90")
    },
    "peak": "largest |F/F_d| among the lines",
    "rms_error": "RMS of F_d - F",
    "saturation": "share of the samples in which the command saturates",
    "violations": "share of the samples in which a pressure leaves (P_r, P_s)",
}


@dataclass(frozen=True, eq=False)
class Excitation:
    """A desired force of RMS 1, and how the response to it is computed.

    Attributes:
        name: `multisine` or `noise`.
        shape: the force, without dimension.
        noise: standard normal numbers for the sensors.
        skip: samples that are not counted.
        hertz: frequencies of the response.
        weights: what the samples after `skip` are multiplied with (multisine), or None:
            Welch's segments, averaged around `hertz`.
        segment: samples in a segment of Welch's.
    """

    name: str
    shape: Float[np.ndarray, "n"]
    noise: Float[np.ndarray, "n 4"]
    skip: int
    hertz: Float[np.ndarray, "lines"]
    weights: Complex[np.ndarray, "lines m"] | None = None
    segment: int = 0


def _lines(period: float, top: float, count: int) -> np.ndarray:
    """Whole numbers of periods, near to evenly spaced on a log scale."""
    wanted = np.geomspace(1.0, top * period, count)
    return np.unique(np.round(wanted).astype(int))


def multisine(
    rate: float, top: float = 100.0, period: float = 2.0, lines: int = 48, seed: int = 0
) -> Excitation:
    """Sines of whole periods and equal size, phases at random; two periods long. The
    sensors' noise lies between them.

    Args:
        rate: of the samples, Hz.
        top: the highest frequency, Hz; no more than 0.45 of the rate.
        period: s; the first is not counted.
        lines: about how many sines.
        seed: of phases and sensor noise.
    """
    n = round(period * rate)
    whole = _lines(period, min(top, 0.45 * rate), lines)
    rng = np.random.default_rng([seed, 11])
    angle = 2 * np.pi * np.outer(np.arange(2 * n), whole) / n
    shape = np.cos(angle + rng.uniform(0, 2 * np.pi, whole.size)).sum(1)
    shape /= np.sqrt(whole.size / 2)
    weights = np.exp(-1j * angle[:n]).T / n
    return Excitation(
        "multisine", shape, _between(rng, whole, n), n, whole / period, weights
    )


def _between(
    rng: np.random.Generator, whole: Float[np.ndarray, "lines"], n: int
) -> Float[np.ndarray, "2n 4"]:
    """Standard normal numbers of two equal periods of `n`, without what they have at
    the sines' frequencies.

    It would be taken for a part of the response, and with many sines at a small
    amplitude that is more than models differ by.
    """
    noise = np.fft.rfft(rng.normal(size=(n, 4)), axis=0)
    noise[whole] = 0.0
    return np.tile(np.fft.irfft(noise, n, axis=0), (2, 1))


def white_noise(
    rate: float, band: float = 50.0, seconds: float = 12.0, lines: int = 32,
    seed: int = 0,
) -> Excitation:  # fmt: skip
    """White noise up to `band`, as the paper has it; Welch's segments of 1 s.

    Args:
        rate: of the samples, Hz.
        band: where a Butterworth filter of fourth order cuts it, Hz.
        seconds: length; the first is not counted.
        lines: about how many frequencies; each is the mean of those around it.
        seed: of the noises.
    """
    rng = np.random.default_rng([seed, 12])
    n, segment = round(seconds * rate), round(rate)
    hertz = _lines(1.0, min(band, 0.45 * rate), lines) * rate / segment
    shape = band_noise(rng, n, 1 / rate, 1.0, band)
    noise = rng.normal(size=(n, 4))
    return Excitation("noise", shape, noise, segment, hertz, None, segment)


def desired_force(setting: Setting, shape: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """F_d of an excitation's shape, N."""
    return setting.F_0 + setting.amplitude / jnp.sqrt(2.0) * shape


def step_excited(
    setting: Setting,
    frozen: bool,
    carry: Any,
    given: tuple[Float[Array, ""], Float[Array, "4"], Float[Array, ""]],
) -> tuple[Any, Float[Array, "4"]]:
    """One period of the loop: its state, and the signals `KEEP`, SI.

    Args:
        setting: the loop and its point.
        frozen: whether its adaptation stands still.
        carry: its state.
        given: the excitation's shape, standard normal numbers, and the time, s.
    """
    shape, noise, t = given
    F_d = desired_force(setting, shape)
    one = operating_point.scenario(setting, F_d[None], noise[None], t[None])
    loop = operating_point.frozen(setting.loop) if frozen else setting.loop
    carry, now = step_loop(loop, carry, operating_point.moment(one, 0))
    return carry, jnp.stack([now[name] for name in KEEP])


def run_excited(
    setting: Setting, given: Excitation, frozen: bool = False, settle: int = 0
) -> Float[Array, "n 4"]:
    """The signals `KEEP` of the loop from its operating point, SI."""
    carry = operating_point.initial_state(setting, settle=settle)
    t = jnp.arange(given.shape.size) * setting.loop.h
    course = (jnp.asarray(given.shape), jnp.asarray(given.noise), t)
    return jax.lax.scan(
        lambda c, now: step_excited(setting, frozen, c, now), carry, course
    )[1]


def segments(x: Float[Array, "n"], size: int) -> Complex[Array, "segments lines"]:
    """Half-overlapping segments without their mean under a Hann window, spectra."""
    count = (x.shape[0] - size) // (size // 2) + 1
    at = np.arange(count)[:, None] * (size // 2) + np.arange(size)
    window = np.hanning(size + 1)[:-1]
    cut = x[at]
    return jnp.fft.rfft(window * (cut - jnp.mean(cut, axis=1, keepdims=True)))


def estimate_response(
    given: Excitation, F_d: Float[Array, "n"], F: Float[Array, "n"]
) -> tuple[Complex[Array, "lines"], Float[Array, "lines"]]:
    """F/F_d at the excitation's frequencies, and its coherence."""
    desired, actual = F_d[given.skip :], F[given.skip :]
    if given.weights is not None:
        W = jnp.asarray(given.weights)
        return (W @ actual) / (W @ desired), jnp.ones(given.hertz.size)
    X, Y = segments(desired, given.segment), segments(actual, given.segment)
    cross = jnp.sum(jnp.conj(X) * Y, axis=0)
    own, other = jnp.sum(jnp.abs(X) ** 2, axis=0), jnp.sum(jnp.abs(Y) ** 2, axis=0)
    pool = jnp.asarray(_pool(given, cross.shape[0]))
    cross, own, other = pool @ cross, pool @ own, pool @ other
    return cross / own, jnp.abs(cross) ** 2 / (own * other)


def _pool(given: Excitation, count: int) -> np.ndarray:
    """Which of Welch's frequencies are averaged for each of `hertz`, [lines, count]."""
    step = given.hertz[0]
    middle = np.round(given.hertz / step).astype(int)
    edges = np.concatenate([[middle[0] - 0.5], (middle[1:] + middle[:-1]) / 2,
                            [middle[-1] + 0.5]])  # fmt: skip
    k = np.arange(count)
    inside = (k >= edges[:-1, None]) & (k < edges[1:, None])
    return inside / inside.sum(1, keepdims=True)


def measure(
    setting: Setting, given: Excitation, frozen: bool = False, settle: int = 0
) -> dict[str, Any]:
    """All of `UNITS`, and `response` [lines], complex, with its `coherence`.

    NaN where the run diverged.
    """
    return figures(setting, given, run_excited(setting, given, frozen, settle))


def figures(
    setting: Setting, given: Excitation, table: Float[Array, "n 4"]
) -> dict[str, Any]:
    """What `measure` gives, of a run's signals `KEEP`."""
    F_d = desired_force(setting, jnp.asarray(given.shape))
    late = table[given.skip :]
    F, u, P_1, P_2 = late.T
    H, coherence = estimate_response(given, F_d, table[:, 0])
    hertz = jnp.asarray(given.hertz)
    loop = setting.loop
    shut = [loop.rig.force_area_1 > 0, loop.rig.force_area_2 > 0]
    left = [
        s & ~((setting.P_r < P) & (setting.P_s > P))
        for s, P in zip(shut, (P_1, P_2), strict=True)
    ]
    found = {
        "within_1dB": metrics.band_within(hertz, H),
        "minus_3dB": metrics.first(hertz, metrics.dB(H) + 3.0),
        "lag_90": metrics.first(hertz, metrics.unwrapped(H) + jnp.pi / 2),
        "peak": jnp.max(metrics.dB(H)),
        "rms_error": jnp.sqrt(jnp.mean((F_d[given.skip :] - F) ** 2)),
        "saturation": jnp.mean(jnp.abs(u) >= 0.999 * loop.law.u_max),
        "violations": jnp.mean(left[0] | left[1]),
    }
    sound = jnp.all(jnp.isfinite(F))
    found = {n: jnp.where(sound, v, jnp.nan) for n, v in found.items()}
    return found | {"response": H, "coherence": coherence}
