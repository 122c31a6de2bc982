"""Friction on a film, as a soft seal has it: found in logs that NumPy made."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import hydrojax as hj

RIG = """
name = "seal"
layout = "single"
[geometry]
area = "5e-4 m^2"
[parameters]
k_cp = { start = "5 N", range = ["0 N", "100 N"] }
k_cn = { start = "5 N", range = ["0 N", "100 N"] }
k_0 = { start = "0 N", range = ["-50 N", "50 N"] }
k_vp = { start = "0 N*s/m", range = ["-2 kN*s/m", "2 kN*s/m"] }
k_vn = { start = "0 N*s/m", range = ["-2 kN*s/m", "2 kN*s/m"] }
k_fp = "0"
k_fn = "0"
z_ss = { start = "100 um", range = ["2 um", "3 mm"] }
delta = "0.01 1/N"
L_slope = "1e6 s/m"
"""
"""`L_slope`: a seal that is moved has its friction at the lowest speeds too."""
COULOMB, FILM, GROWS, POWER = 6.0, 4.0, 1.5e-5, 0.6
"""N, N at 10 mm/s, N/Pa at 10 mm/s, exponent."""


def recorded(seed: int, bar: float) -> pd.DataFrame:
    """To and fro over 20 mm at speeds from 1 to 30 mm/s; 100 Hz, 50 mN of noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(4000) / 100
    speed = np.interp(t, np.arange(0, 45, 3), rng.permutation(np.geomspace(1, 30, 15)))
    x = 10e-3 * np.sin(np.cumsum(speed) / 100 / 10)
    v = np.gradient(x, t)
    bristle = np.empty(t.size)
    z = 0.0
    for k in range(t.size):
        move = x[k] - x[k - 1] if k else 0.0
        way = abs(move) / 80e-6
        z = z * np.exp(-way) + np.sign(move) * 80e-6 * -np.expm1(-way)
        bristle[k] = z / 80e-6
    P = 1e5 * bar * (1 + 0.01 * np.sin(0.7 * t))
    film = np.sign(v) * (np.abs(v) / 10e-3) ** POWER * (FILM + GROWS * P)
    F = 5e-4 * P - COULOMB * bristle - film + 0.05 * rng.standard_normal(t.size)
    return pd.DataFrame({"time [s]": t, "x [m]": x, "P_a2 [Pa]": P, "F [N]": F})


@pytest.mark.slow
def test_the_film_is_named_with_its_exponent():
    rig = hj.RigFile.from_text(RIG)
    logs = [recorded(1, 1.0), recorded(2, 4.0), recorded(3, 7.0)]
    traced = hj.trace(rig, logs, validate=[recorded(4, 2.5), recorded(5, 6.0)])
    (found,) = traced.outcome.effects
    assert found.name == "film_friction"
    film = {name: p.value for name, p in found.parameters.items()}
    assert film["n"] == pytest.approx(POWER, abs=0.03)
    assert film["k_h"] == pytest.approx(FILM, rel=0.1)
    assert film["kappa_h"] == pytest.approx(GROWS, rel=0.05)
    F = traced.outcome.channels["F"]
    assert F.before > 5 * F.noise
    assert F.after < 1.1 * F.noise
