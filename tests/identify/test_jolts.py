"""Rows that do not tell how a piston moved between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import hydrojax as hj
from hydrojax.identify.case import open_case
from hydrojax.identify.preparation.jolts import without_jolts
from hydrojax.rigfile.build import build_rig
from tests.pages import ROOT

NOISE = np.array([6e3, 6e3, np.inf])
RIG = """
name = "boom"
layout = "differential"

[geometry]
area_1 = "3.6e-3 m^2"
area_2 = "5e-3 m^2"
chamber_length = "0.67 m"

[supply]
P_s = "17 MPa"

[parameters]
beta = { start = "1.2e9 Pa", range = ["4e8 Pa", "2e9 Pa"] }
"""


def moved(jolts=(), size=10.0, seconds=20.0, rate=100.0, noise=4e-6) -> hj.Log:
    """A log of a piston that swings slowly, and at times gains `size` m/s^2 for 8 ms
    and loses it as long, which 100 Hz sees in one or two rows.
    """
    t = np.arange(0.0, seconds, 1 / rate)
    x = 0.1 * np.sin(2 * np.pi * 0.3 * t)
    for at in jolts:
        since = np.clip(t - at, 0.0, None)
        # Twice integrated: up for 8 ms, down for 8 ms.
        ramps = (s**2 for s in (since, since - 8e-3, since - 16e-3))
        one, two, three = (
            np.where(since > late, r, 0.0)
            for r, late in zip(ramps, (0, 8e-3, 16e-3), strict=True)
        )
        x = x + size / 2 * (one - 2 * two + three)
    x = x + noise * np.random.default_rng(1).normal(size=t.size)
    swing = np.sin(0.7 * t)
    frame = {"time [s]": t, "u [1]": swing, "x [m]": x, "P_a1 [Pa]": 5e6 + 1e6 * swing}
    return hj.Log.from_frame(pd.DataFrame(frame | {"P_a2 [Pa]": 4e6 - 1e6 * swing}))


def cut(log: hj.Log) -> hj.Log:
    spec = hj.RigFile.from_text(RIG)
    return without_jolts(log, spec, build_rig(spec), NOISE)


@pytest.mark.parametrize("rate", [100.0, 1000.0])
def test_a_log_without_a_jolt_is_left_as_it_is(rate):
    log = moved(rate=rate)
    assert cut(log) is log


def test_rows_about_a_jolt_are_left_out():
    at = 7.313
    found = cut(moved((at,)))
    (first, stop), (start, last) = found.segments
    assert (first, last) == (0, 2000)
    assert found.time[stop] < at < found.time[start - 1]
    assert found.time[start] - found.time[stop - 1] < 0.15
    assert f"moved between them: {start - stop}" in found.notes[-1]


def test_a_jolt_is_no_gap_where_rows_follow_it():
    log = moved((7.313,), rate=1000.0)
    assert cut(log) is log


def test_a_jolt_that_no_pressure_shows_is_none():
    log = moved((7.313,), size=0.5)
    assert cut(log) is log


def test_of_a_log_that_is_shaken_all_the_time_nothing_is_left_out():
    log = moved(np.arange(1.0, 20.0, 1.1) + 0.003)
    assert cut(log) is log
    few = cut(moved((3.003, 17.003)))
    assert len(few.segments) == 3


def test_what_has_no_pressures_is_left_as_it_is():
    log, spec = moved((7.313,)), hj.RigFile.from_text(RIG)
    none = np.full(3, np.inf)
    assert without_jolts(log, spec, build_rig(spec), none) is log


def test_the_report_says_so():
    """A slow copy of the demo's log, with a jolt in it."""
    rig = hj.RigFile.load(ROOT / "hydrojax/demo/rig.toml")
    log = hj.Log.load(ROOT / "hydrojax/demo/fit_1.csv.gz", rig.channels)
    slow = replace(
        log,
        time=log.time[::10],
        signals={n: y[::10].copy() for n, y in log.signals.items()},
        segments=((0, len(log.time[::10])),),
    )
    assert without_jolts(slow, rig, build_rig(rig), NOISE) is slow
    jolt = 4e-4 * (slow.time > 12.0) / rig.geometry["radius"]
    slow.signals["psi"] += jolt
    shaken = open_case(rig, [slow])
    assert any("how psi moved between them" in note for note in shaken.fit.notes)
