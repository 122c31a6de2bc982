"""A specimen that a bench moves against a load cell: no drive, `layout = "tester"`."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

import hydrojax as hj
from hydrojax.errors import InputError
from hydrojax.rigfile.schema import RigFile

UP, DOWN, OFFSET, BEND, MASS = 300.0, 240.0, 15.0, 2e-4, 60.0
"""Friction (N) either way and beside it, the bristle's deflection (m), kg."""

RIG = """
name = "damper on a bench"
layout = "tester"
[parameters]
k_cp = { start = "100 N", range = ["0 N", "2 kN"] }
k_cn = { start = "100 N", range = ["0 N", "2 kN"] }
k_0 = { start = "0 N", range = ["-200 N", "200 N"] }
z_ss = { start = "500 um", range = ["1 um", "20 mm"] }
L_slope = "1e6 s/m"
[effects.payload_inertia]
m = { start = "10 kg", range = ["0 kg", "500 kg"] }
"""


def recorded(seed: int, sign: float) -> pd.DataFrame:
    """A bench's log of 10 s at 500 Hz: Dahl's friction and a mass, 1 N of noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(5000) / 500
    w = 2 * np.pi * rng.uniform([0.3, 0.9, 3.0], [0.5, 1.3, 4.0])
    size, angle = np.array([8e-3, 3e-3, 4e-4]), w * t[:, None] + rng.uniform(0, 6, 3)
    x, a = (size * np.sin(angle)).sum(1), (-size * w**2 * np.sin(angle)).sum(1)
    bent, friction = 0.0, np.empty(t.size)
    for k in range(t.size):
        move = x[k] - x[k - 1] if k else 0.0
        goal = np.sign(move)
        bent = goal + (bent - goal) * np.exp(-abs(move) / BEND)
        friction[k] = (UP if bent > 0 else DOWN) * bent + OFFSET
    F = sign * (-friction - MASS * a) + rng.standard_normal(t.size)
    return pd.DataFrame({"time [s]": t, "x [m]": x, "F [N]": F})


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_friction_and_mass_follow_from_motion_and_force(sign):
    """With a load cell that counts the other way the motion is inverted."""
    rig = RigFile.from_text(RIG)
    logs = [recorded(1, sign), recorded(2, sign)]
    found = hj.fit(rig, logs, validate=[recorded(3, sign)], starts=1)
    value = found.parameters["value"]
    up, down = (UP, DOWN) if sign > 0 else (DOWN, UP)
    assert value["k_cp"] == pytest.approx(up, rel=0.005)
    assert value["k_cn"] == pytest.approx(down, rel=0.005)
    assert value["k_0"] == pytest.approx(sign * OFFSET, abs=1.0)
    assert value["payload_inertia.m"] == pytest.approx(MASS, rel=0.01)
    assert list(found.channels.index) == ["F"]
    assert found.channels["after"]["F"] < 1.5
    assert ("so it was inverted" in str(found.summary())) == (sign < 0)


@pytest.mark.parametrize(
    "column, says",
    [
        ("u [V]", "u drives, but a tester has no drive: take the column out"),
        ("P [N]", "P drives, but a tester has no drive"),
        ("", "a tester needs F [N]"),
    ],
)
def test_what_is_no_tester_s_log_is_said(column, says):
    log = recorded(1, 1.0)
    if column:
        log[column] = np.sin(log["time [s]"])
    else:
        log = log.drop(columns="F [N]")
    with pytest.raises(InputError, match=says.replace("[", r"\[").replace("]", r"\]")):
        hj.fit(RigFile.from_text(RIG), [log], starts=1)


@pytest.mark.parametrize("line", ['F = "0 N"', 'predicts = "x"'])
def test_it_has_neither_a_known_load_nor_a_motion_of_its_own(line):
    with pytest.raises(InputError, match="a tester .*; delete the line"):
        RigFile.from_text(f"{RIG}[load]\n{line}\n")
