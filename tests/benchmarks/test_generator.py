"""The recorded logs are physical, and like those of a rig."""

import ast
import json
import tomllib

import numpy as np
import pytest

from tests import generator

ABSENT = dict.fromkeys(generator.AT_INFINITY, np.inf)


def white(signal: np.ndarray) -> float:
    """Standard deviation of a signal's fastest part, from its fourth differences."""
    return float(np.std(np.diff(signal, 4)) / np.sqrt(70))


@pytest.fixture(scope="module")
def rig():
    return generator.draw_rig(3)


@pytest.fixture(scope="module")
def log(rig):
    return generator.record(rig, 3, seconds=8.0)


def test_it_shares_nothing_with_the_simulator():
    with open(generator.__file__) as source:
        tree = ast.parse(source.read())
    names = [n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
    assert {name.split(".")[0] for name in names}.isdisjoint({"hydrojax", "jax"})


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_pressures_stay_between_return_and_supply(seed):
    rig = generator.draw_rig(seed)
    log = generator.record(rig, seed, seconds=3.0)
    for name in ("P_a1", "P_a2"):
        assert log[name].min() > rig["P_r"] + 1e6
        assert (log["P_s"] - log[name]).min() > 1e6
    assert np.abs(log["u"]).max() < generator.U_MAX


def test_force_follows_its_reference(log):
    error, wanted = log["F"] - log["F_d"], log["F_d"]
    assert 5 < np.std(error) < 0.5 * np.std(wanted)


def test_friction_opposes_sliding(rig, log):
    x = rig["radius"] * log["psi"]
    v = np.gradient(x, generator.TICK)
    drag = rig["area"] * (log["P_a2"] - log["P_a1"]) - log["F"]
    forward, back = drag[v > 0.01], drag[v < -0.01]
    assert 0.5 * rig["k_cp"] < np.mean(forward) < rig["k_cp"] + rig["k_0"]
    assert -rig["k_cn"] + rig["k_0"] < np.mean(back) < -0.5 * rig["k_cn"]


def test_noise_is_what_the_rig_file_says(rig, log):
    assert white(log["P_a1"]) == pytest.approx(9e3, rel=0.08)
    assert white(log["P_a2"]) == pytest.approx(9e3, rel=0.08)
    assert 2.3 < white(log["F"]) < 4  # what the valve makes of the noise comes on top
    counts = log["psi"] / generator.ENCODER
    assert np.allclose(counts, np.round(counts), atol=1e-6)


def test_supply_is_logged_with_its_noise(log):
    truth = generator.supply(np.random.default_rng([3, 2, 1]), log["time"])
    assert np.std(log["P_s"] - truth) == pytest.approx(9e3, rel=0.06)


@pytest.mark.parametrize("name", generator.TYPICAL)
def test_an_effect_at_zero_is_none_and_at_its_size_is_seen(rig, name):
    strength = next(iter(generator.TYPICAL[name]))
    none = generator.record(rig, 5, seconds=0.5)
    zero = {name: {strength: ABSENT.get(name, 0.0)}}
    if name == "pressure_sensor_bias":
        zero[name]["b_2"] = 0.0
    absent = generator.record(rig, 5, seconds=0.5, effects=zero)
    present = generator.record(rig, 5, seconds=0.5, effects={name: {}})
    for signal in none:
        np.testing.assert_array_equal(absent[signal], none[signal])
    assert any(np.std(present[s] - none[s]) > 0 for s in ("P_a1", "P_a2", "F"))


def test_unknown_effect_is_refused(rig):
    with pytest.raises(KeyError, match="no such effect"):
        generator.record(rig, 5, seconds=0.1, effects={"phlogiston": {}})


@pytest.mark.parametrize(
    "name",
    [
        None,
        "valve_lag",
        "valve_delay",
        "valve_rate_limit",
        "rod_compliance",
        "backlash",
    ],
)
def test_the_substep_is_fine_enough(rig, name, monkeypatch):
    effects = {name: {}} if name else {}
    coarse = generator.record(rig, 5, seconds=1.0, effects=effects)
    monkeypatch.setattr(generator, "SUBSTEPS", 60)
    monkeypatch.setattr(generator, "STEP", generator.TICK / 60)
    fine = generator.record(rig, 5, seconds=1.0, effects=effects)
    assert np.std(coarse["P_a1"] - fine["P_a1"]) < 300
    assert np.std(coarse["F"] - fine["F"]) < 0.5


@pytest.mark.parametrize("drive", [-3000.0, -1.0, 0.0, 0.2, 700.0, 5000.0])
def test_piston_force_solves_its_equation(drive):
    k_p, k_n, delta = 0.9, 0.6, 1 / 900
    force = generator.piston_force(drive, k_p, k_n, delta)
    k = k_p if force > 0 else k_n
    total = force + k * force / (1 + delta * abs(force))
    assert total == pytest.approx(drive, abs=1e-9)


def test_case_folder(tmp_path):
    where = tmp_path / "case"
    arguments = ["--out", str(where), "--seed", "3", "--seconds", "0.2"]
    generator.main([*arguments, "--effect", "internal_leakage"])
    rig = tomllib.loads((where / "rig.toml").read_text())
    truth = json.loads((where / "truth.json").read_text())
    assert set(rig["parameters"]) == set(generator.RANGES)
    assert truth["effects"] == {"internal_leakage": {"c_il": 1e-12}}
    start = float(rig["parameters"]["beta"]["start"].split()[0])
    assert abs(start / truth["rig"]["beta"] - 1) < 0.2501
    for name in ("fit_1", "fit_2", "validate"):
        lines = (where / f"{name}.csv").read_text().splitlines()
        assert lines[0] == (
            "time [s],u [V],psi [rad],P_a1 [bar],P_a2 [bar],P_s [bar],F [kN],F_d [kN]"
        )
        assert len(lines) == 201
