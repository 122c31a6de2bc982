"""Controllers of a user's own, through simulation, sweeps and tuning."""

from __future__ import annotations

import inspect
import warnings
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

from hydrojax.control.adaptive import VALVE_GAIN, Law, adaptive_law
from hydrojax.control.base import AbstractController, Gain
from hydrojax.control.baselines import PIController
from hydrojax.control.loop import Loop, Sensors, signal_names
from hydrojax.control.simulation import make_scenario, simulate_loop
from hydrojax.control.waveforms import sinusoidal_path
from hydrojax.errors import InputError
from hydrojax.paper import experiments
from hydrojax.parameters import param, specs
from hydrojax.rigfile.build import build_loop
from hydrojax.rigfile.controller import KEYS, file_keys, valve_gain, written_unit
from hydrojax.rigfile.quantities import open_setting, quantities
from hydrojax.rigfile.schema import RigFile
from hydrojax.tune import linearize
from hydrojax.tune.api import sweep, tune_gains

RIG = Path(experiments.__file__).with_name("reference.toml")


class MyPI(AbstractController):
    """As a user would write it, and nothing more."""

    k: Array = param("V/N", 1.5e-3, 0.0, 1.0, "proportional gain")
    beta: Array = param("1/s", 8.0, 0.0, 100.0, "rate of the integral")
    u_max: Array = param("V", 10.0, 0.0, 10.0, "saturation")

    def init(self, measured, F_d):
        return jnp.zeros_like(F_d)

    def step(self, memory, measured, F_d, h):
        error = F_d - measured.F
        memory = memory + h * self.beta * error
        u = jnp.clip(-self.k * (error + memory), -self.u_max, self.u_max)
        return memory, u, {"error": error}


@pytest.fixture(scope="module")
def file() -> RigFile:
    return replace(RigFile.load(RIG), law=MyPI())


@pytest.fixture
def scenario():
    t = np.arange(1500) * 1e-3
    F_d = 300 * np.sin(2 * np.pi * t)
    return make_scenario(F_d, sinusoidal_path(0.005, 3.0), 1e-3, 14e6, 0.25e6)


@pytest.mark.parametrize("law", [MyPI(k=3e-3), PIController(k_p=3e-3, k_i=2.4e-2)])
def test_it_follows_in_a_simulation(law, scenario):
    loop = build_loop(replace(RigFile.load(RIG), law=law))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        run = simulate_loop(loop, scenario)
    off = (run.F_d - run["true_F"])[500:]
    assert np.sqrt(np.mean(off**2)) < 150.0  # of 212
    assert np.allclose(run["error"], run.F_d - run["F"])
    assert "P_d" not in run.signals and "true_F" in run.signals


def test_an_integral_stands_still_while_the_command_saturates():
    law, h = PIController(u_max=0.1), jnp.asarray(1e-3)
    measured = jax.tree.map(jnp.asarray, _measured(F=0.0))
    memory = law.init(measured, jnp.asarray(500.0))
    memory, u, _ = law.step(memory, measured, jnp.asarray(500.0), h)
    assert float(u) == -0.1 and float(memory.integral) == 0.0
    memory, u, signals = law.step(memory, measured, jnp.asarray(50.0), h)
    assert float(memory.integral) == pytest.approx(0.05)
    assert float(signals["error"]) == 50.0
    assert float(u) == pytest.approx(-(1e-3 * 50 + 1e-2 * 0.05))


def _measured(F: float):
    from hydrojax.control.base import Measured

    return Measured(7e6, 7e6, 14e6, F, 0.0)


def test_its_gains_have_names_units_and_a_rate(file):
    setting = open_setting(file)
    known = quantities(file, setting)
    assert known["k"].unit == "V/N" and known["u_max"].description == "saturation"
    assert known["beta"].unit == "Pa"  # the plant's
    assert float(known["controller.beta"].get(setting)) == 8.0
    other = known["k"].put(setting, 1e-4)
    assert float(other.loop.law.k) == 1e-4 and "k_p" not in known
    assert float(known["rate"].get(setting)) == pytest.approx(1000.0)
    given = build_loop(file, None, {"k": "2 mV/N", "beta": 3, "rate": "2 kHz"})
    assert float(given.law.k) == pytest.approx(2e-3) and float(given.law.beta) == 3.0
    assert float(given.h) == pytest.approx(5e-4)
    with pytest.raises(InputError, match="gains: unknown gain 'kk'; did you mean 'k'"):
        build_loop(file, None, {"kk": 1})
    with pytest.raises(InputError, match="gains: k: unit 'Pa' does not fit"):
        build_loop(file, None, {"k": "1 Pa"})


@pytest.mark.slow
def test_it_is_swept(file):
    data = sweep(file, {"k": np.array([1e-3, 2.5e-3, 4e-3])})
    band = data["linear_minus_3dB"].values.ravel()
    assert band.shape == (3,) and np.all(np.isfinite(band))
    assert np.all(np.diff(band) > 0)  # the more gain, the wider


@pytest.mark.slow
def test_it_is_tuned(file, scenario):
    """Gains are found that let the force follow while the joint moves, though the law
    knows nothing of its speed: the search in runs finds the fast integral that does.
    """
    found = tune_gains(file, plants=1, starts=1)
    assert set(found.gains) == {"k", "controller.beta"} and not found.obstacles
    off = []
    own = {name.removeprefix("controller."): v for name, v in found.gains.items()}
    for given in ({}, own):
        run = simulate_loop(build_loop(file, None, given), scenario)
        off.append(np.sqrt(np.mean((run.F_d - run["true_F"])[500:] ** 2)))
    assert off[1] < 0.2 * off[0]
    with pytest.raises(InputError, match="invalid gain 'v': expected one of k, contr"):
        tune_gains(file, free=("v",), plants=1)


def test_gains_are_declared_once():
    """[controller] takes the law's declarations, and what they are stored in is SI."""
    for name, s in specs(Law).items():
        assert isinstance(s, Gain)
        assert KEYS[name].description == s.description
        assert written_unit(name) == (s.written or s.unit)
    assert KEYS["rate"] is specs(Loop)["h"]
    assert KEYS["resolution"] is specs(Sensors)["step"]
    assert KEYS["kappa"] is VALVE_GAIN
    file = RigFile.load(RIG)
    assert valve_gain(file_keys(file), build_loop(file).law.nominal) > 0
    assert inspect.isabstract(AbstractController)


def test_signals_are_the_controllers_own(file, scenario):
    mine = set(signal_names(build_loop(file), scenario))
    theirs = set(signal_names(build_loop(RigFile.load(RIG)), scenario))
    assert mine - theirs == {"error"}
    assert {"P_d", "k_cp", "L", "virtual"} <= theirs - mine


def test_a_loop_is_opened_at_the_command_of_any_controller(file):
    law = linearize.Tapped(MyPI(), jnp.asarray(0.25), jnp.asarray(10.0))
    given = (
        jnp.asarray(0.0), jax.tree.map(jnp.asarray, _measured(F=0.0)),
        jnp.asarray(100.0), jnp.asarray(1e-3),
    )  # fmt: skip
    assert float(law.step(*given)[1] - MyPI().step(*given)[1]) == pytest.approx(0.25)


def test_the_theorems_are_of_the_adaptive_law():
    with pytest.raises(TypeError, match="invalid controller PIController: expected"):
        adaptive_law(PIController())
    law = build_loop(RigFile.load(RIG)).law
    assert adaptive_law(law) is law
