"""A tuning made by hand, for what shows one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrojax.paper.records import reference
from hydrojax.tune.limiting import Relaxed
from hydrojax.tune.objective import Limits
from hydrojax.tune.optimize import Optimum
from hydrojax.tune.result import Tuned

SPEC, _ = reference()

HERTZ = np.geomspace(0.5, 200, 60)
EDGES = np.array([1.0, 1.1, 0.875])
"""Where each plant's band ends, relative to the rig's own."""


def found(edge: float, stable: tuple[bool, ...]) -> dict[str, np.ndarray]:
    """Metrics of three plants whose lag of first order is down 3 dB at `edge` Hz."""
    alive = np.array(stable)
    band = np.where(alive, edge * EDGES, np.nan)
    other = np.where(alive, [2.0, 2.5, 2.2], np.nan)
    names = ("minus_3dB", "lag_90", "peak", "gain_margin", "phase_margin", "rms",
             "noise_F", "noise_u")  # fmt: skip
    return {name: other for name in names} | {
        "within_1dB": band,
        "delay_margin": 1e-3 * other,
        "radius": np.where(alive, 0.9, 1.2),
        "response": 1 / (1 + 1j * HERTZ / (edge * EDGES[:, None])),
    }


def tuned() -> Tuned:
    """Two gains over three plants, one of them unstable before."""
    return Tuned(
        file=replace(SPEC, name="STVF joint 1"),
        gains={"k_p": 1.31, "k_f": 3.2},
        units={"k_p": "V/kN", "k_f": "V/kN"},
        start={"k_p": 1.2, "k_f": 2.4},
        before=found(16.0, (True, True, False)),
        after=found(32.0, (True, True, True)),
        hertz=HERTZ,
        optimum=Optimum(
            np.array([1.31, 3.2]),
            float(np.log(28.0)),
            {"peak": 0.0, "sensitivity": 0.4, "tracking": -0.3},
            (28.0, np.nan),
        ),
        relaxed=(Relaxed("spool: ten times as fast", 38.0, 38 / 28 - 1),),
        plants="3 plants within 20 % of the rig in what it is made of",
        limits=Limits(),
        comparison=(
            ("old gains", {"within_1dB_Hz": 16.3, "peak_dB": 11.6, "rms_N": 7.7}),
        ),
        notes=("A note.",),
    )
