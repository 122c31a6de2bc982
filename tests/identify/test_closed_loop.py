"""A measured closed-loop run, run again in the identified loop."""

from dataclasses import replace
from importlib import resources

import numpy as np
import pytest

from hydrojax.control.simulation import simulate_loop
from hydrojax.identify.results.parts import check_loop
from hydrojax.logs.log import Log
from hydrojax.parameters import get, parameter_specs
from hydrojax.rigfile import recording
from hydrojax.rigfile.build import build_loop, build_rig
from hydrojax.rigfile.edit import identified
from hydrojax.rigfile.scenarios import rig_scenario
from hydrojax.rigfile.schema import RigFile

TRAVEL = (-0.02, 0.02)


@pytest.fixture(scope="module")
def spec():
    with resources.as_file(
        resources.files("hydrojax") / "paper/reference.toml"
    ) as path:
        return RigFile.load(path)


@pytest.fixture(scope="module")
def log(spec, tmp_path_factory):
    """Five seconds of the reference rig, with noise and encoder, as a file."""
    rig = build_rig(spec)
    loop = build_loop(spec, rig)
    scenario = rig_scenario(spec, loop, seconds=5.0, seed=2)
    path = tmp_path_factory.mktemp("loop") / "log.csv"
    recording.write_log(
        path, recording.log_columns(simulate_loop(loop, scenario), spec)
    )
    return Log.load(path, spec.channels)


@pytest.fixture(scope="module")
def truth(spec):
    rig = build_rig(spec)
    names = tuple(parameter_specs(rig))
    return dict(zip(names, np.asarray(get(rig, names)).tolist(), strict=True))


def test_the_true_rig_runs_as_measured(spec, log, truth):
    """What differs is the sensors' noise, and what it does in the loop."""
    found = check_loop(spec, log, truth, ())
    assert found.rms < 6.0 and not found.warning
    assert found.rms > 2.0  # the load cell's own noise is 2.5 N
    assert found.tracking_measured == pytest.approx(found.tracking_simulated, rel=0.25)
    assert found.t.size == found.measured.size == found.simulated.size
    noise = found.measured - found.simulated
    assert found.rms == pytest.approx(np.sqrt(np.mean(noise**2)), rel=1e-12)


def test_another_friction_shows(spec, log, truth):
    off = truth | {"k_cp": 2 * truth["k_cp"], "k_cn": 0.5 * truth["k_cn"]}
    right = check_loop(spec, log, truth, ())
    # The law that knows the wrong friction is another law, and the plant another too.
    assert check_loop(spec, log, off, ()).rms > 1.3 * right.rms


def test_an_effect_that_was_found_is_in_the_plant(spec, log, truth):
    right = check_loop(spec, log, truth, ())
    lag = truth | {"loadcell_lag.tau_F": 5e-3}
    assert check_loop(spec, log, lag, ("loadcell_lag",)).rms > 2 * right.rms


@pytest.mark.parametrize("missing", ["F_d", "u", "F"])
def test_without_a_loop_there_is_nothing_to_run(spec, log, truth, missing):
    signals = {n: v for n, v in log.signals.items() if n != missing}
    assert check_loop(spec, replace(log, signals=signals), truth, ()) is None


def test_holes_in_the_desired_force_end_the_run(spec, log, truth):
    F_d = log.signals["F_d"].copy()
    F_d[3000:] = np.nan
    cut = replace(log, signals=log.signals | {"F_d": F_d})
    found = check_loop(spec, cut, truth, ())
    assert found.t[-1] == pytest.approx(2.998, abs=0.01)
    F_d[1000:] = np.nan
    assert check_loop(spec, cut, truth, ()) is None


def test_the_identified_file_has_the_identified_values(spec):
    new = identified(spec, {"beta": 7e8, "valve_lag.tau": 1e-3, "stribeck.k_st": 9.0})
    assert new.parameters["beta"].start == 7e8
    assert new.effects["valve_lag"]["tau"].start == 1e-3
    assert "stribeck" not in new.effects and "beta" in spec.parameters
    assert spec.parameters["beta"].start == 8.5e8
