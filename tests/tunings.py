"""A tuning made by hand, for what shows one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrojax.paper.records import reference
from hydrojax.tune.aims import TOLERANCE, Following, Limits
from hydrojax.tune.limiting import Relaxed
from hydrojax.tune.optimize import Optimum
from hydrojax.tune.proposal import Proposal
from hydrojax.tune.result import Tuned
from hydrojax.tune.search import Judged
from hydrojax.tune.verification import Tried

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
             "noise_F", "noise_u", "sensitivity_moving")  # fmt: skip
    return {name: other for name in names} | {
        "within_1dB": band,
        "delay_margin": 1e-3 * other,
        "largest_eigenvalue": np.where(alive, 0.9, 1.2),
        "radius": np.where(alive, 0.9, 1.2),
        "response": 1 / (1 + 1j * HERTZ / (edge * EDGES[:, None])),
    }


def tried(edge: float, peak: float, stable: tuple[bool, ...]) -> Tried:
    """Three plants in runs, whose bands end at `edge` Hz at least."""
    alive, three = np.array(stable), np.ones(3)
    band = edge * EDGES
    swings = np.zeros((7, 3))
    swings[3] = np.where(alive, 0.0, 2.0)
    return Tried(
        np.array([1.31, 3.2]), band, 2 * band, band / 2,
        np.stack([band, band / 2]),
        np.array([peak, peak + 1, peak]), 2 * three, np.where(alive, 9.0, 600.0),
        9 * three, np.where(alive, 0.99, 1.02), 0.99 * three, three / 2,
        swings, 0 * swings,
    )  # fmt: skip


def judged(edge: float, peak: float, faults: tuple[str, ...] = ()) -> Judged:
    """Three plants in runs, and what is said of them."""
    over = np.array([0.3 if faults else -1.0])
    return Judged(
        tried(edge, peak, (True,) * 3), faults, over, peak - 4.0, edge / 2, edge / 2
    )


TRIALS = (
    judged(32.0, 2.0), judged(30.0, 1.0), judged(20.0, 0.5), judged(34.0, 6.0, ("no",)),
    judged(40.0, 9.0, ("no", "no")), judged(10.0, 0.2),
)  # fmt: skip


def tuned() -> Tuned:
    """Two gains over three plants, one of them unstable before."""
    return Tuned(
        file=replace(SPEC, name="STVF joint 1"),
        gains={"k_p": 1.31, "k_f": 3.2},
        units={"k_p": "V/kN", "k_f": "V/kN"},
        start={"k_p": 1.2, "k_f": 2.4},
        before=found(16.0, (True, True, False)),
        after=found(32.0, (True, True, True)),
        proposal=Proposal(
            tried(16.0, 4.0, (True, True, False)),
            replace(tried(32.0, 2.0, (True,) * 3), peak=np.array([2.0, 2.5, 2.0])),
            (),
            TRIALS,
        ),  # fmt: skip
        hertz=HERTZ,
        optimum=Optimum(
            np.array([1.31, 3.2]),
            float(np.log(28.0)),
            {"peak": 0.0, "noise": 0.4, "tracking": -0.3},
        ),
        relaxed=(Relaxed("spool: ten times as fast", 38.0, 38 / 28 - 1),),
        plants="3 plants within 20 % of the rig in what it is made of",
        limits=Limits(),
        aim=Following(),
        tolerance=TOLERANCE,
        amplitude=100.0,
        speed=0.03,
        run_by="C, as XLA to 1e-09 in 8 cells",
        edges=("k_f",),
        comparison=(
            (
                "old gains",
                {"within_1dB_Hz": 16.3, "peak_dB": 11.6, "rms_moving_N": 7.7},
            ),
        ),
        notes=("A note.",),
    )
