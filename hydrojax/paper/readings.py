"""Other readings of what the paper leaves open, and what each does to Figs. 2 and 5."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import equinox as eqx
import numpy as np
from scipy import signal

from hydrojax.control.loop import Loop
from hydrojax.control.simulation import hold
from hydrojax.control.waveforms import band_noise, sinusoidal_path
from hydrojax.paper.experiments import (
    FIGURES,
    FORCE,
    FORCE_HZ,
    NOISE_BAND,
    NOISE_RMS,
    NOISE_SHOWN,
    PERIOD,
    SECONDS,
    SPEED,
    STEADY,
    Gains,
    runs,
    scenario_of,
    stack,
    within,
)
from hydrojax.paper.records import Reproduced, reference
from hydrojax.rigfile.build import build_loop, build_rig

NOISE_SECONDS = 60.0
"""Length of the noise of Fig. 5, s."""


@dataclass(frozen=True)
class Reading:
    """One reading: other keys of [controller], and what else is another in the loop."""

    keys: Gains = field(default_factory=dict)
    change: Callable[[Loop], Loop] = lambda loop: loop


def _valve(share: float) -> Callable[[Loop], Loop]:
    """The plant's valve passes this share of what the law takes it to pass."""

    def change(loop: Loop) -> Loop:
        def lands(lo: Loop):
            v = lo.rig.valve
            return [getattr(v, name) for name in ("c_p1", "c_n1", "c_p2", "c_n2")]

        return eqx.tree_at(lands, loop, [share * c for c in lands(loop)])

    return change


def _friction(name: str, share: float) -> Callable[[Loop], Loop]:
    """A constant of friction times `share`, in the plant and in the law."""

    def change(loop: Loop) -> Loop:
        def both(lo: Loop):
            return [getattr(r.mechanics, name) for r in (lo.rig, lo.law.nominal)]

        return eqx.tree_at(both, loop, [share * c for c in both(loop)])

    return change


def _without_effects(loop: Loop) -> Loop:
    spec, _ = reference()
    return replace(loop, rig=build_rig(replace(spec, effects={})))


READINGS: Mapping[str, Reading] = {
    "as shipped": Reading(),
    "the valve passes 10 % less than the law takes it to": Reading(change=_valve(0.9)),
    "the valve passes 10 % more": Reading(change=_valve(1.1)),
    "no spool, no computing time": Reading(change=_without_effects),
    "velocity and rate of P_d filtered over 2 ms": Reading(
        {"tau_v": "2 ms", "tau_d": "2 ms"}
    ),
    "the same over 10 ms": Reading({"tau_v": "10 ms", "tau_d": "10 ms"}),
    "sampled at 500 Hz": Reading({"rate": 500}),
    "sampled at 2 kHz": Reading({"rate": 2000}),
    "L(t) of a speed filtered three times as slowly": Reading(
        change=_friction("L_rate", 1 / 3)
    ),
    "L(t) of a speed filtered three times as fast": Reading(
        change=_friction("L_rate", 3.0)
    ),
    "presliding saturates at half the force": Reading(change=_friction("delta", 2.0)),
    "presliding saturates at twice the force": Reading(change=_friction("delta", 0.5)),
}
"""What the paper leaves open: its valve's constants, delays, filters, sampling rate,
the filter of L(t), and the saturation of presliding."""


def reproduced(reading: Reading) -> Reproduced:
    """Figs. 2 (b), (c) and 5 under one reading."""
    spec, rig = reference()

    def loop(gains: Gains) -> Loop:
        return reading.change(build_loop(spec, rig, {**reading.keys, **gains}))

    loops = [loop(FIGURES["fig2"][case]) for case in ("b", "c")]
    h = float(loops[0].h)
    t = np.arange(round(SECONDS / h)) * h
    F_d = FORCE * np.sin(2 * np.pi * FORCE_HZ * t)
    path = sinusoidal_path(SPEED, PERIOD)
    same = stack([scenario_of(spec, F_d, path, h, seed=0)] * 2)
    P_d, P = np.moveaxis(np.asarray(runs(stack(loops), same, ("P_d", "P"))), -1, 0)
    b, c = np.sqrt(np.mean((P_d - P)[:, t >= STEADY] ** 2, axis=1))

    n, settled = round(NOISE_SECONDS / h), slice(round(STEADY / h), None)
    F_d = band_noise(np.random.default_rng(5), n, h, NOISE_RMS, NOISE_BAND)
    noise = stack([scenario_of(spec, F_d, hold(), h, seed=50)])
    F = np.asarray(runs(stack([loop({})]), noise, ("F",)))[0, settled, 0]
    bins = round(1 / h)
    hertz, cross = signal.csd(F_d[settled], F, fs=1 / h, nperseg=bins)
    gain = np.abs(cross / signal.welch(F_d[settled], fs=1 / h, nperseg=bins)[1])
    keep = (hertz >= 1) & (hertz <= NOISE_SHOWN)
    return Reproduced(
        float(b), float(c), within(hertz[keep], 20 * np.log10(gain[keep]))
    )


def try_readings() -> dict[str, Reproduced]:
    """What every reading does, by its name."""
    return {name: reproduced(reading) for name, reading in READINGS.items()}
