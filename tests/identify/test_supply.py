"""A supply pressure off by a factor, told from sensors that all read wrong by one."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import hydrojax as hj
from hydrojax.identify.checking.words import late_position
from hydrojax.identify.supply import simpler_and_no_worse, with_supply_of_gains
from tests.pages import ROOT

DEMO = ROOT / "hydrojax" / "demo"
GAUGES = {f"pressure_sensor_gain.eps_{i}": -0.075 for i in (1, 2)}
CELL = {"loadcell_gain.eps": -0.074}


def ended(named, force=2.5):
    """Where a trace stands that found effects of these parameters."""
    names = dict.fromkeys(n.split(".")[0] for n in named)
    return SimpleNamespace(
        added=[SimpleNamespace(name=n) for n in names],
        named=named,
        noise=np.array([8e3, 8e3, force]),
    )


def opened(logged=True, driven_by="u"):
    signals = {"u": 0, **({"P_s": 0} if logged else {})}
    return SimpleNamespace(
        spec=hj.RigFile.load(DEMO / "rig.toml"),
        fit=SimpleNamespace(driven_by=driven_by),
        read_logs=[SimpleNamespace(signals=signals)],
    )


def test_sensors_that_all_read_wrong_by_one_factor_are_a_wrong_supply():
    (one,) = with_supply_of_gains(opened(), (), ended(GAUGES | CELL), print)
    assert (one.input, one.finding) == ("P_s", "factor")
    assert one.factor == pytest.approx(1 - 0.0747, abs=1e-4)
    assert one.says.startswith("P_s is 8.1 % too high: write [channels] P_s = ")
    assert "scale = 0.9253" in one.says
    assert "P_a1, P_a2 and F all read 7.5 % too little" in one.says
    assert one.effects == ("pressure_sensor_gain", "loadcell_gain")


def test_without_a_load_cell_both_gauges_are_all():
    state = ended(GAUGES, np.inf)
    (one,) = with_supply_of_gains(opened(logged=False), (), state, print)
    assert "[supply] P_s" in one.says
    assert "P_a1 and P_a2 both read 7.5 % too little" in one.says


@pytest.mark.parametrize(
    ("named", "case"),
    [
        (GAUGES, opened()),  # the load cell disagrees
        (CELL, opened()),
        (GAUGES | {"loadcell_gain.eps": 0.075}, opened()),
        (GAUGES | CELL | {"pressure_sensor_gain.eps_1": -0.05}, opened()),
        ({n: 0.1 * v for n, v in (GAUGES | CELL).items()}, opened()),
        (GAUGES | CELL, opened(driven_by="pressures")),
    ],
)
def test_other_sensors_are_no_wrong_supply(named, case):
    assert with_supply_of_gains(case, (), ended(named), print) == ()


def test_a_supply_that_was_called_is_not_called_again():
    called = (replace(late_position(opened().spec, "psi", 1e-3), input="P_s"),)
    found = with_supply_of_gains(opened(), called, ended(GAUGES | CELL), print)
    assert found is called


def test_a_simpler_end_is_as_good_where_no_channel_is_worse():
    def end(count, *rms):
        problem = SimpleNamespace(rms=lambda _: np.array(rms), errors_at=lambda _: 0)
        return SimpleNamespace(
            added=[0] * count,
            check=problem,
            point=SimpleNamespace(values=0),
            noise=np.array([1.0, 1.0, np.inf]),
            criteria=SimpleNamespace(matters=0.02),
        )

    own = end(2, 1.0, 1.5, 0.0)
    assert simpler_and_no_worse(own, end(0, 1.01, 1.5, 9.0))
    assert not simpler_and_no_worse(own, end(0, 1.0, 1.6, 0.0))
    assert not simpler_and_no_worse(own, end(2, 1.0, 1.4, 0.0))
