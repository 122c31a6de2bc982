"""Friction that holds at rest, as most cylinders have it, in logs that NumPy made."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import hydrojax as hj

RIG = """
name = "plain friction"
layout = "single"
[geometry]
area = "1e-3 m^2"
[sensors]
F = "2 N"
[parameters]
k_cp = { start = "300 N", range = ["0 N", "3 kN"] }
k_cn = { start = "300 N", range = ["0 N", "3 kN"] }
k_0 = { start = "0 N", range = ["-500 N", "500 N"] }
k_vp = { start = "0 N*s/m", range = ["-20 kN*s/m", "20 kN*s/m"] }
k_vn = { start = "0 N*s/m", range = ["-20 kN*s/m", "20 kN*s/m"] }
k_fp = { start = "0.1", range = ["0", "3"] }
k_fn = { start = "0.1", range = ["0", "3"] }
z_ss = { start = "50 um", range = ["2 um", "1 mm"] }
"""
"""Written as the paper's rig, with no word on the switch L(t)."""
UP, DOWN, VISCOUS, Z_SS, RISE, V_S, DAMPING = 520.0, 610.0, 2e3, 70e-6, 250.0, 4e-3, 8e3
"""N, N, N*s/m, m, N, m/s, N*s/m."""


def lugre(v: np.ndarray, h: float, rise: float, damping: float) -> np.ndarray:
    """LuGre's friction in steps of a tenth of the log's, by the midpoint; N."""
    z, out = 0.0, np.empty(v.size)
    for k in range(v.size):
        slope = (v[k] - v[k - 1]) / 10 if k else 0.0
        rate = 0.0
        for i in range(10):
            w = v[k] - slope * (9.5 - i)
            rate = w - abs(w) * (z + h / 20 * rate) / Z_SS
            z += h / 10 * rate
        level = np.where(z > 0, UP, DOWN) + rise * np.exp(-((v[k] / V_S) ** 2))
        out[k] = level * z / Z_SS + VISCOUS * v[k]
        out[k] += damping * (v[k] - abs(v[k]) * z / Z_SS)
    return out


def recorded(seed: int, rise: float = 0.0, damping: float = 0.0) -> pd.DataFrame:
    """Slow waves and creeping, with stops; 500 Hz, 2 N of noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(10_000) / 500
    hertz = rng.uniform(0.1, 1.2, 5)
    waves = rng.uniform(1, 6, 5) * 1e-3 / (2 * np.pi * hertz)
    angle = 2 * np.pi * np.outer(t, hertz) + rng.uniform(0, 2 * np.pi, 5)
    x, v = np.sin(angle) @ waves, np.cos(angle) @ (waves * 2 * np.pi * hertz)
    stops = 0.5 + 0.5 * np.tanh(20 * np.sin(2 * np.pi * 0.13 * t + 1))
    v = v * stops
    x = np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) / 2)]) / 500
    P = 2e6 + 3e5 * np.sin(2 * np.pi * 0.7 * t) + 2e5 * np.sin(2 * np.pi * 2.3 * t)
    F = 1e-3 * P - lugre(v, 1 / 500, rise, damping) + 2 * rng.standard_normal(t.size)
    return pd.DataFrame({"time [s]": t, "x [m]": x, "P_a2 [Pa]": P, "F [N]": F})


def traced(**more: float):
    logs = [recorded(seed, **more) for seed in (1, 2)]
    return hj.trace(hj.RigFile.from_text(RIG), logs, validate=[recorded(3, **more)])


@pytest.mark.slow
def test_coulomb_friction_is_missed_at_rest_only():
    outcome = traced().outcome
    (found,) = outcome.effects
    assert found.name == "friction_at_rest"
    assert found.parameters["s"].value == pytest.approx(1.0, abs=0.02)
    # All of it is no end of a range to be widened, and what acts on nothing is at none.
    assert "end of" not in outcome.sentence
    assert not any("widen the range" in said for said in outcome.limits)
    F = outcome.channels["F"]
    assert F.before > 5 * F.noise
    assert F.after < 1.1 * F.noise
    assert outcome.parameters["k_cp"].value == pytest.approx(UP, rel=0.02)
    assert outcome.parameters["k_cn"].value == pytest.approx(DOWN, rel=0.02)
    assert outcome.parameters["z_ss"].value == pytest.approx(Z_SS, rel=0.05)


@pytest.mark.slow
def test_lugre_is_named_by_its_parts():
    outcome = traced(rise=RISE, damping=DAMPING).outcome
    names = {e.name for e in outcome.effects}
    assert names == {"friction_at_rest", "stribeck", "bristle_damping"}
    F = outcome.channels["F"]
    assert F.after < 1.1 * F.noise
    stribeck = next(e for e in outcome.effects if e.name == "stribeck")
    assert stribeck.parameters["k_st"].value == pytest.approx(RISE, rel=0.05)
    assert stribeck.parameters["v_s"].value == pytest.approx(V_S, rel=0.05)
