"""Friction behind a play, as a linkage has it: found in a log that NumPy made."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import hydrojax as hj
from hydrojax.identify.case import open_case
from hydrojax.identify.discovery.discover import samples_of
from hydrojax.identify.discovery.laid import laid_over
from hydrojax.rigfile.build import build_rig

RIG = """
name = "damper"
layout = "driven-axis"
[load]
F = "0 N"
[parameters]
k_cp = { start = "2 kN", range = ["0 kN", "20 kN"] }
k_cn = { start = "2 kN", range = ["0 kN", "20 kN"] }
k_0 = { start = "0 N", range = ["-2 kN", "2 kN"] }
z_ss = { start = "500 um", range = ["1 um", "20 mm"] }
"""
SLIDES, BACK, PLAY, SPRING = 4000.0, 3000.0, 1.8e-3, 1.2e-3
"""Forces (N) of the element, half of its play and how far it bends, m."""


def recorded(seed: int) -> pd.DataFrame:
    """Of a sum of sines, first up to 4 mm and then up to 9; 500 Hz, 5 N of noise.

    It begins in the play.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(10_000) / 500
    x = sum(
        size * np.sin(2 * np.pi * f * t + phase)
        for size, f, phase in zip(
            [2.2e-3, 1.2e-3, 0.6e-3],
            rng.uniform([0.2, 0.5, 1.0], [0.4, 0.8, 1.5]),
            rng.uniform(0, 6, 3),
            strict=True,
        )
    ) * np.where(t < 8, 1.0, 2.2)
    x = np.convolve(np.pad(x, 50, mode="edge"), np.full(101, 1 / 101), "valid")
    w, P = 0.0, np.empty(x.size)
    for k in range(x.size):
        move = x[k] - x[k - 1] if k else 0.0
        w = min(max(w + move, -(PLAY + SPRING)), PLAY + SPRING)
        bent = max(abs(w) - PLAY, 0.0) / SPRING
        P[k] = (SLIDES if w > 0 else -BACK) * bent
    P += 5.0 * rng.standard_normal(P.size)
    return pd.DataFrame({"time [s]": t, "x [m]": x, "P [N]": P})


@pytest.fixture(scope="module")
def traced():
    """The trace of two logs, checked on a third."""
    rig = hj.RigFile.from_text(RIG)
    return hj.trace(rig, [recorded(1), recorded(2)], validate=[recorded(3)])


@pytest.mark.slow
def test_it_is_named_with_its_play(traced):
    (found,) = traced.outcome.effects
    assert found.name == "maxwell_slip"
    slip = {name: p.value for name, p in found.parameters.items()}
    assert slip["z_m"] == pytest.approx(PLAY + SPRING, rel=0.01)
    assert slip["gap"] * slip["z_m"] == pytest.approx(PLAY, rel=0.02)
    assert slip["f_p"] == pytest.approx(SLIDES, rel=0.01)
    assert slip["f_n"] == pytest.approx(BACK, rel=0.01)


@pytest.mark.slow
def test_little_is_left(traced):
    """Above the noise: the drive force is compared below 20 Hz, its corners round."""
    F = traced.outcome.channels["F"]
    assert F.before > 500
    assert F.after < 15


@pytest.mark.parametrize("measured", [False, True])
def test_no_curve_is_over_what_stands_for_the_output_force(measured):
    """A drive force is the residual itself where no output force is measured."""
    logs = [recorded(seed) for seed in (1, 2)]
    if measured:
        logs = [log.assign(**{"F [N]": log["P [N]"]}) for log in logs]
    case = open_case(hj.RigFile.from_text(RIG), logs[:1], logs[1:])
    samples = samples_of(case.fit, build_rig(case.spec))
    assert {"v", "x", "z"} < set(samples)
    assert ("P_net" in samples) is measured and ("P_mean" in samples) is measured
    terms = [one.term for one in laid_over(samples, {})]
    signals = {name for t in terms for name in (t.signal, t.factor)}
    assert bool({"P_mean", "P_net"} & signals) is measured
