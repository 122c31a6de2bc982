"""From a rig file to a closed loop, to a log, and back: [controller], `simulate`."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hydrojax.cli.scenario import read_inputs
from hydrojax.control import simulation, waveforms
from hydrojax.control.adaptive import Safeguards
from hydrojax.control.base import Estimates
from hydrojax.control.inverting import mean_area
from hydrojax.control.loop import Scenario
from hydrojax.errors import InputError
from hydrojax.identify import api as running
from hydrojax.identify.case import open_case
from hydrojax.logs.log import Log
from hydrojax.paper import experiments
from hydrojax.parameters import specs
from hydrojax.plant.load import Driven, Inertia
from hydrojax.plant.places import PLACES
from hydrojax.rigfile import recording
from hydrojax.rigfile.build import build_loop, build_rig
from hydrojax.rigfile.controller import KEYS, written_unit
from hydrojax.rigfile.scenarios import rig_scenario
from hydrojax.rigfile.schema import RigFile
from tests.conftest import Said

KAPPA = 1.18e-4

RIG = Path(experiments.__file__).with_name("reference.toml").read_text()
BARE = RIG.split("[effects.valve_lag]")[0]
"""The reference rig without effects and without [controller]."""


@pytest.fixture
def load(tmp_path) -> Callable[..., object]:
    """Reads a rig file from its text."""

    def read(text: str):
        path = tmp_path / "bench.toml"
        path.write_text(text)
        return RigFile.load(path)

    return read


def si(keys: str, load, rig: str = BARE):
    return build_loop(load(rig + "\n[controller]\n" + keys)).law


# -- [controller]: units at the door --


def test_volts_per_kilonewton_become_si(load):
    """1.2 V/kN at kappa = 1.18e-4 m^2/(s V) is 1.416e-7 m^2/(s N)."""
    law = si('kappa = "1.18e-4 m^2/(s*V)"\nk_p = "1.2 V/kN"\nk_f = 2.4', load)
    assert float(law.k_p) == pytest.approx(1.416e-7, rel=1e-12)
    assert float(law.k_f) == pytest.approx(2.832e-7, rel=1e-12)


SCALES = {
    # key: (paper's unit in SI, whether kappa is in it)
    "k_p": (1e-3, True), "k_f": (1e-3, True), "rho_1": (1e-9, True),
    "rho_a": (1e-3, True), "c_1": (1.0, False), "c_2": (1.0, False),
    "c_3": (1.0, False), "c_4": (1.0, False), "c_5": (1.0, False),
    "c_6": (1e-6, False), "c_7": (1e-6, False), "k_1": (1e-3, True),
    "A_a": (1.0, True), "k_cp": (1e3, False), "k_cn": (1e3, False),
    "k_0": (1e3, False), "k_vp": (1e3, False), "k_vn": (1e3, False),
    "k_fp": (1.0, False), "k_fn": (1.0, False), "u_max": (1.0, False),
    "tau_d": (1.0, False), "tau_v": (1.0, False), "dead_zone": (1.0, False),
    "leakage": (1.0, False), "saturated": (1.0, False),
}  # fmt: skip

_RATES = ("rho_1", "rho_a", *(f"c_{i}" for i in range(1, 8)))


def found(law, key: str) -> tuple[float, float]:
    """What a key became: two bounds, or one value twice."""
    if key in Estimates._fields:
        return float(getattr(law.lower, key)), float(getattr(law.upper, key))
    if key in _RATES:
        value = float(law.rate[_RATES.index(key)])
    elif key in specs(Safeguards):
        value = float(getattr(law.safeguards, key))
    else:
        value = float(getattr(law, key))
    return value, value


@pytest.mark.parametrize("key", SCALES)
def test_a_bare_number_is_in_the_papers_unit(load, key):
    scale, volts = SCALES[key]
    want = 0.37 * scale * (KAPPA if volts else 1.0)
    law = si(f'kappa = "1.18e-4 m^2/(s*V)"\n{key} = 0.37', load)
    assert found(law, key) == pytest.approx((want, want), rel=1e-12)
    # The same with the paper's unit written out, and as --gains.
    unit = written_unit(key).replace("{u}", "V")
    law = si(f'kappa = "1.18e-4 m^2/(s*V)"\n{key} = "0.37 {unit}"', load)
    assert found(law, key) == pytest.approx((want, want), rel=1e-12)


def test_every_key_is_tried_above():
    assert set(SCALES) == set(KEYS) - {"rate", "kappa", "resolution"}


@pytest.mark.parametrize(
    ("text", "key", "want"),
    [
        ('k_p = "1.2 mV/N"', "k_p", 1.2e-3 * KAPPA),
        ('k_p = "0.0012 V/N"', "k_p", 1.2e-3 * KAPPA),
        ('rho_a = "0.7 V*s/N"', "rho_a", 0.7 * KAPPA),
        ('c_1 = "0.1 1/ms"', "c_1", 100.0),
        ('c_6 = "2e-5 1/(s*N^2)"', "c_6", 2e-5),
        ('tau_d = "2 ms"', "tau_d", 2e-3),
        ('u_max = "5000 mV"', "u_max", 5.0),
    ],
)
def test_units_of_ones_own(load, text, key, want):
    law = si('kappa = "1.18e-4 m^2/(s*V)"\n' + text, load)
    assert found(law, key)[0] == pytest.approx(want, rel=1e-12)


def test_an_estimate_takes_one_value_or_two_bounds(load):
    law = si('k_cp = ["200 N", 1.5]\nk_cn = "0.9 kN"\nk_0 = [-0.2, 0.1]', load)
    assert found(law, "k_cp") == pytest.approx((200.0, 1500.0))
    assert found(law, "k_cn") == pytest.approx((900.0, 900.0))
    assert found(law, "k_0") == pytest.approx((-200.0, 100.0))


def test_rate_and_resolution(load):
    loop = build_loop(
        load(BARE + '[controller]\nrate = "2 kHz"\nresolution = "1e-6 rad"')
    )
    assert float(loop.h) == pytest.approx(5e-4)
    assert float(loop.sensors.step) == pytest.approx(0.085e-6)
    straight = BARE.replace('radius = "0.085 m"\n', "")
    loop = build_loop(load(straight + '[controller]\nresolution = "1 um"'))
    assert float(loop.sensors.step) == pytest.approx(1e-6)
    assert float(build_loop(load(straight)).sensors.step) == 0.0
    step = float(build_loop(load(BARE)).sensors.step)
    assert step == pytest.approx(2 * math.pi / 2**23 * 0.085)


@pytest.mark.parametrize("beta", [8.5e8, 1.4e9])
def test_defaults_make_a_loop_of_360_rad_per_s(load, beta):
    loop = build_loop(load(BARE.replace("8.5e8 Pa", f"{beta:g} Pa")))
    law = loop.law
    assert float(law.k_p + law.k_f) * beta == pytest.approx(360.0)
    assert found(law, "k_1") == pytest.approx((1 / beta, 1 / beta))
    low, high = found(law, "A_a")
    assert (low, high) == pytest.approx((0.6 * 1.18e-3, 1.5 * 1.18e-3))
    assert float(loop.h) == 1e-3 and float(law.u_max) == 10.0
    assert found(law, "k_cp") == (0.0, 2500.0)  # the rig's own 1.25 kN twice
    assert found(law, "k_cn") == (0.0, 2000.0)
    assert isinstance(loop.load, Driven)
    assert float(loop.sensors.F) == 2.5 and float(loop.sensors.P_s) == 9e3
    assert float(loop.P_start) == pytest.approx(7.125e6)


def test_a_command_without_unit(load):
    """Constants per unit command: the law saturates at 1, and gains stay the same."""
    per_one = re.sub(r"2\.(\d\d)e-9 m\^3/\(s\*V\*", r"2.\1e-8 m^3/(s*", BARE)
    law = build_loop(load(per_one)).law
    assert float(law.u_max) == 1.0
    assert float(law.k_p + law.k_f) * 8.5e8 == pytest.approx(360.0)
    assert float(law.nominal.valve.c_p1) == pytest.approx(2.24e-8)


def test_the_law_knows_the_file_and_not_its_effects(load):
    spec = load(RIG)
    rig = build_rig(spec)
    loop = build_loop(spec, rig, {"k_p": 1.5})
    assert not any(getattr(loop.law.nominal, place) for place in PLACES)
    assert len(loop.rig.command) == 2
    assert float(loop.law.k_p) == pytest.approx(1.5e-3 * KAPPA)
    assert float(mean_area(loop.law.nominal)) == 1.18e-3


def test_a_load_needs_a_mass(load):
    text = BARE + '[load]\nmass = "2 t"\nstiffness = "1 kN/mm"\n'
    got = build_loop(load(text)).load
    assert isinstance(got, Inertia)
    assert [float(v) for v in (got.mass, got.stiffness, got.damping)] == [2e3, 1e6, 0]
    with pytest.raises(InputError, match=r"\[load\] mass is missing; add mass"):
        build_loop(load(BARE + '[load]\nstiffness = "1 kN/mm"\n'))


WRONG = {
    "k_q = 1": r"\[controller\] unknown key 'k_q'; did you mean 'k_",
    "zzz = 1": r"unknown key 'zzz'; known: \['rate'",
    'k_p = "1.2 V"': r"\[controller\] k_p: unit 'V' does not fit; give it in V/N",
    'k_p = "1.2 bananas"': "unknown unit 'bananas'",
    'k_p = "fast"': "'fast' is not a quantity",
    "k_cp = [2, 1]": r"k_cp: \[2.*, 1.*\] is upside down; exchange them",
    "k_p = [1, 2]": "k_p: invalid value .*: expected one value",
    "k_cp = [1, 2, 3]": "k_cp: invalid value .*: expected one value, or two bounds",
    "k_f = -2.4": "k_f: -2.4 must be 0 or more",
    "c_1 = -1": "c_1: -1.* must be 0 or more",
    "rate = 0": "rate: 0.* must be above 0",
    "u_max = 0": "u_max: 0.* must be above 0",
    'kappa = "0 m^2/(s*V)"': "kappa: .* must be above 0",
    "k_p = inf": "'inf V/kN' is not a quantity",
}


@pytest.mark.parametrize("text", WRONG)
def test_what_a_controller_is_refused_for(load, text):
    with pytest.raises(InputError, match=WRONG[text]) as error:
        si(text, load)
    assert "\n" not in str(error.value)
    assert str(error.value).split(": ")[0].endswith("bench.toml")


def test_gains_are_named_in_their_own_errors(load):
    with pytest.raises(InputError, match="^gains: unknown key 'kp'; did you mean"):
        build_loop(load(BARE), None, {"kp": 1})


def test_a_driven_axis_has_no_loop(load):
    with pytest.raises(InputError, match="'driven-axis' has no valve"):
        build_loop(load('layout = "driven-axis"'))


# -- desired forces and motions --


@pytest.mark.parametrize(
    "path",
    [
        waveforms.sinusoidal_path(0.03, 0.7),
        waveforms.random_path(np.random.default_rng(3), 0.02),
        simulation.hold(3e-3),
    ],
    ids=["to-and-fro", "wander", "locked"],
)
def test_motions_are_their_own_derivatives(path):
    t, e = np.linspace(0.1, 2.0, 50), 1e-5
    for nu in (0, 1):
        slope = (path(t + e, nu) - path(t - e, nu)) / (2 * e)
        assert np.allclose(slope, path(t, nu + 1), rtol=1e-6, atol=1e-7)
    assert path(t.reshape(5, 10), 1).shape == (5, 10)


def test_motions_keep_their_promises():
    t = np.linspace(0, 30, 30001)
    path = waveforms.sinusoidal_path(0.03, 3.0)
    assert abs(path(t[:1], 1)[0]) < 1e-15
    assert np.max(path(t, 1)) == pytest.approx(0.03, rel=1e-6)
    for seed in range(5):
        path = waveforms.random_path(np.random.default_rng(seed), 0.025, 0.02)
        assert 0.005 < np.max(np.abs(path(t, 1))) <= 0.025
        assert 0.005 < np.max(np.abs(path(t, 0))) <= 0.02
    rng = np.random.default_rng(1)
    for force in (
        waveforms.random_sines(rng, np.linspace(0, 100, 100001), 400.0),
        waveforms.band_noise(rng, 100000, 1e-3, 400.0, 50.0),
    ):
        assert np.std(force) == pytest.approx(400.0, rel=0.01)
    hertz = np.fft.rfftfreq(100000, 1e-3)
    power = np.abs(np.fft.rfft(force)) ** 2
    assert power[hertz > 150].sum() < 1e-3 * power.sum()


# -- logs --

TABLE = {
    "time": ("s", 1e-3 * np.arange(700)),
    "u": ("V", 2 * np.sin(np.arange(700) / 9)),
    "psi": ("rad", 0.1 * np.cos(np.arange(700) / 50)),
    "P_a1": ("Pa", 7e6 + 1e5 * np.sin(np.arange(700) / 13)),
    "F": ("N", 300 * np.sin(np.arange(700) / 21)),
    "F_d": ("N", 300 * np.sin(np.arange(700) / 20)),
}


@pytest.mark.parametrize("kind", recording.KINDS)
def test_a_log_comes_back(tmp_path, kind):
    path = tmp_path / "new" / f"log{kind}"
    recording.write_log(path, TABLE)
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    log = Log.load(path)
    exact = kind in (".mat", ".parquet")
    assert np.allclose(log.time, TABLE["time"][1], rtol=0, atol=0 if exact else 1e-9)
    assert set(log.signals) == set(TABLE) - {"time"}
    for name, values in log.signals.items():
        unit, want = TABLE[name]
        assert log.units[name] == unit
        tolerance = 1e-15 if exact else 6e-8  # eight digits
        assert np.allclose(values, want, rtol=tolerance, atol=1e-15), name
    if not exact:  # ten digits of what an encoder of 23 bits says
        assert np.allclose(log.signals["psi"], TABLE["psi"][1], rtol=6e-10, atol=0)
    assert log.segments == ((0, 700),)


@pytest.mark.parametrize("name", ["log.txt", "log", "log.gz", "csv"])
def test_other_kinds_are_refused(tmp_path, name):
    with pytest.raises(InputError, match=r"not a kind of log; call it \.csv"):
        recording.write_log(tmp_path / name, TABLE)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", [".MAT", ".PARQUET", ".CSV.GZ"])
def test_endings_in_capitals(tmp_path, kind):
    path = tmp_path / f"log{kind}"
    recording.write_log(path, TABLE)
    assert len(Log.load(path).time) == 700


# -- a scenario in words --


def read_scenario(
    spec, loop, reference="sines", motion="wander", seconds=12.0, seed=0
) -> Scenario:
    """The scenario that `hydrojax simulate` runs."""
    return rig_scenario(
        spec, loop, *read_inputs(spec, reference, motion), seconds, seed
    )


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A rig file, its spec and its loop."""
    path = tmp_path_factory.mktemp("bench") / "rig.toml"
    path.write_text(RIG)
    spec = RigFile.load(path)
    return path, spec, build_loop(spec)


def test_words_make_a_course(bench):
    _, spec, loop = bench
    scenario = read_scenario(
        spec, loop, "sine:250 N,2 Hz", "to-and-fro:2 cm/s,1 s", 1.0, 7
    )
    t = np.arange(1000) * 1e-3
    assert np.allclose(scenario.t, t)
    assert np.allclose(scenario.F_d, 250 * np.sin(4 * np.pi * t), atol=1e-9)
    environment = scenario.environment
    assert np.allclose(
        environment.x[:, 0, 0], -0.02 / (2 * np.pi) * np.cos(2 * np.pi * t)
    )
    assert np.allclose(
        environment.v[:, -1], 0.02 * np.sin(2 * np.pi * (t + 1e-3)), atol=1e-12
    )
    assert np.allclose(environment.x[1:, 0, 0], environment.x[:-1, -1, 2], atol=1e-15)
    assert np.all(scenario.P_s == 14e6) and np.all(scenario.P_r == 0.25e6)
    assert np.std(scenario.noise) == pytest.approx(1.0, abs=0.05)
    again = read_scenario(spec, loop, "sines:0.3 kN", "wander", 1.0, 7)
    same = read_scenario(spec, loop, "sines:0.3 kN", "wander", 1.0, 7)
    other = read_scenario(spec, loop, "sines:0.3 kN", "wander", 1.0, 8)
    assert np.array_equal(again.F_d, same.F_d)
    assert np.array_equal(again.environment.x, same.environment.x)
    assert (
        np.ptp(again.F_d - other.F_d) > 1
        and np.ptp(again.environment.x - other.environment.x) > 0
    )
    locked = read_scenario(spec, loop, "noise", "locked:5 mm", 0.5, 1)
    assert np.all(locked.environment.x == 5e-3) and not np.any(locked.environment.v)


WORDS = {
    ("sinus", "wander"): "'sinus' is neither a log's path nor a kind; did you mean",
    ("sines", "stay"): "'stay' is neither a log's path nor a kind; known: wander",
    ("sine:300 N,1 Hz,2 s", "wander"): "too many values; write sine:300 N,0.5 Hz",
    ("sine:300", "wander"): "--reference sine: '300' has no unit; write",
    ("sine:300 Pa", "wander"): "--reference sine: unit 'Pa' does not fit",
    ("sine:-3 N", "wander"): "'-3 N' must be above 0",
    ("sines", "to-and-fro:3 cm"): "--motion to-and-fro: unit 'cm' does not fit",
    ("nowhere.csv", "wander"): "nowhere.csv",
}


@pytest.mark.parametrize("words", WORDS, ids="-".join)
def test_words_that_will_not_do(bench, words):
    _, spec, loop = bench
    with pytest.raises(InputError, match=re.escape(WORDS[words])):
        read_scenario(spec, loop, *words, 1.0, 0)


@pytest.mark.parametrize("seconds", [0.0, 0.04, -1.0, 1e6, math.nan])
def test_lengths_that_will_not_do(bench, seconds):
    _, spec, loop = bench
    with pytest.raises(InputError, match="seconds: invalid length"):
        read_scenario(spec, loop, seconds=seconds)


def test_a_misspelt_kind_with_a_decimal(bench):
    _, spec, loop = bench
    with pytest.raises(InputError, match="did you mean 'sine'"):
        read_scenario(spec, loop, "sin:300 N,0.5 Hz", "wander", 1.0, 0)


def logged(path: Path, **changed: tuple[str, np.ndarray]) -> Path:
    n = 1500
    t = 1e-3 * np.arange(n)
    table = {
        "time": ("s", 5 + t),
        "psi": ("rad", 0.05 * np.sin(3 * t) / 0.085),
        "F_d": ("N", 200 * np.sin(8 * t)),
        "F": ("N", np.sin(8 * t)),
    } | changed
    recording.write_log(path, {k: v for k, v in table.items() if v is not None})
    return path


def test_a_log_gives_force_and_motion(bench, tmp_path):
    _, spec, loop = bench
    path = str(logged(tmp_path / "log.csv"))
    scenario = read_scenario(spec, loop, path, path, 12.0, 0)
    n, t = scenario.t.size, np.asarray(scenario.t)
    assert 1499 <= n <= 1500  # cut to the log's length
    assert np.allclose(scenario.F_d, 200 * np.sin(8 * t), atol=0.02)
    environment = scenario.environment
    assert np.allclose(environment.x[:, 0, 0], 0.05 * np.sin(3 * t), atol=1e-8)
    inner = slice(20, -20)  # a spline is least sure of itself at its ends
    assert np.allclose(
        environment.v[inner, 0], 0.15 * np.cos(3 * (t + 2.5e-4))[inner], atol=1e-5
    )
    half = read_scenario(spec, loop, path, "locked", 0.5, 0)
    assert half.t.size == 500 and not np.any(half.environment.x)
    bare = str(logged(tmp_path / "bare.csv", F_d=None))
    with pytest.raises(InputError, match="no column F_d to follow"):
        read_scenario(spec, loop, bare, "wander", 1.0, 0)
    still = str(logged(tmp_path / "still.csv", psi=None))
    with pytest.raises(InputError, match=r"no motion: give a column x \[m\] or psi"):
        read_scenario(spec, loop, "sines", still, 1.0, 0)


def test_a_log_with_holes_in_its_desired_force(bench, tmp_path):
    _, spec, loop = bench
    F_d = 200 * np.sin(8e-3 * np.arange(1500))
    F_d[:100] = np.nan
    path = str(logged(tmp_path / "log.mat", F_d=("N", F_d)))
    try:
        scenario = read_scenario(spec, loop, path, "wander", 12.0, 0)
    except InputError as refused:
        assert "F_d" in str(refused)
    else:
        assert np.all(np.isfinite(scenario.F_d))


# -- the command line --


def text_of(said: Said) -> str:
    return " ".join(said.out.split())


def test_simulate_writes_a_log(call, bench, tmp_path):
    out = tmp_path / "log.csv"
    said = call("simulate", bench[0], "--seconds", 0.6, "--seed", 3, "--out", out)
    assert said.code == 0, said
    assert "600 samples in" in text_of(said) and "N RMS" in text_of(said)
    assert "warning" not in said.out
    log = Log.load(out, bench[1].channels)
    assert list(log.signals) == ["u", "psi", "P_a1", "P_a2", "P_s", "F", "F_d"]
    assert log.time.size == 600 and log.time[1] == 1e-3
    assert np.std(log.signals["P_s"]) == pytest.approx(9e3, rel=0.2)
    counts = log.signals["psi"] / (2 * math.pi / 2**23)
    assert np.max(np.abs(counts - np.round(counts))) < 2e-3
    assert np.sqrt(np.mean((log.signals["F_d"] - log.signals["F"]) ** 2)) < 50
    again = tmp_path / "again.csv"
    call("simulate", bench[0], "--seconds", 0.6, "--seed", 3, "--out", again)
    assert again.read_bytes() == out.read_bytes()


def test_gains_take_all_words_that_follow(call, bench, tmp_path):
    """And change the run as [controller] would."""
    out, other = tmp_path / "a.csv", tmp_path / "b.csv"
    gains = ("--gains", "k_p=0.5", "A_a=6 V*s,12 V*s", "k_f=1.0 V/kN")
    one = ("simulate", bench[0], *gains, "--seconds", 0.6, "--out", out)
    assert call(*one).code == 0
    text = RIG.replace("1.2 V/kN", "0.5 V/kN").replace("2.4 V/kN", "1 V/kN")
    rig = tmp_path / "rig.toml"
    rig.write_text(text.replace('"15 V*s"', '"12 V*s"'))
    assert call("simulate", rig, "--seconds", 0.6, "--out", other).code == 0
    assert other.read_bytes() == out.read_bytes()
    plain = tmp_path / "c.csv"
    assert call("simulate", bench[0], "--seconds", 0.6, "--out", plain).code == 0
    assert plain.read_bytes() != out.read_bytes()


def test_a_rig_with_a_rod_has_its_middle_in_the_log(call, tmp_path):
    """x and x_mid; and a log's motion comes back to where it was."""
    rig, out = tmp_path / "rig.toml", tmp_path / "log.csv"
    text = RIG.replace('radius = "0.085 m"', 'x_mid = "0.3 m"')
    rig.write_text(text)
    assert call("simulate", rig, "--seconds", 0.6, "--out", out).code == 0
    log = Log.load(out)
    assert np.all(np.abs(log.signals["x"] - 0.3) < 0.021)
    spec = RigFile.load(rig)
    scenario = read_scenario(spec, build_loop(spec), str(out), str(out), 1.0)
    assert np.allclose(
        scenario.environment.x[:, 0, 0], log.signals["x"][:-1] - 0.3, atol=1e-12
    )
    assert np.allclose(scenario.F_d, log.signals["F_d"][:-1])
    again = tmp_path / "again.csv"
    both = ("--reference", out, "--motion", out)
    assert call("simulate", rig, *both, "--out", again).code == 0
    first, second = log.signals["F"][:-1], Log.load(again).signals["F"]
    assert np.std(first) > 200  # and the encoder's steps, in the motion now, cost 2 N
    assert np.sqrt(np.mean((second - first) ** 2)) < 5


def test_one_chamber_has_one_pressure(call, tmp_path):
    rig, out = tmp_path / "rig.toml", tmp_path / "log.parquet"
    rig.write_text(RIG.replace('"pull-pull"', '"single"'))
    said = call("simulate", rig, "--seconds", 0.6, "--out", out)
    assert said.code == 0
    assert "P_a1" not in " ".join(pd.read_parquet(out).columns)
    assert "P_a1 in" not in said.out


def test_a_log_without_noise_is_warned_of(call, tmp_path):
    rig, out = tmp_path / "rig.toml", tmp_path / "log.mat"
    quiet = re.sub(r"\[sensors\]\n(?:\w+ = .*\n)*", "", RIG)
    rig.write_text(quiet)
    said = call("simulate", rig, "--seconds", 0.6, "--out", out)
    assert said.code == 0
    assert "warning: the rig file gives no noise under " in text_of(said)
    assert Log.load(out).time.size == 600


def test_the_warning_names_the_section(call, tmp_path):
    rig = tmp_path / "rig.toml"
    rig.write_text(re.sub(r"\[sensors\]\n(?:\w+ = .*\n)*", "", RIG))
    said = call("simulate", rig, "--seconds", 0.6, "--out", tmp_path / "log.csv")
    assert "no noise under [sensors]" in text_of(said)


def test_a_supply_that_is_too_low_is_warned_of(call, tmp_path):
    rig, out = tmp_path / "rig.toml", tmp_path / "log.csv"
    rig.write_text(RIG.replace("14 MPa", "0.9 MPa"))
    said = call("simulate", rig, "--seconds", 0.6, "--out", out)
    assert said.code == 0
    assert re.search(r"warning: a pressure left .*; raise P_s", text_of(said))


REFUSED = {
    "unknown gain": (("--gains", "kp=1"), "gains: unknown key 'kp'; did you mean"),
    "no sign": (("--gains", "k_p"), "--gains 'k_p': write NAME=VALUE"),
    "wrong unit": (("--gains", "k_p=3 N"), "gains: k_p: unit 'N' does not fit"),
    "no value": (("--gains", "k_p="), "write NAME=VALUE"),
    "second of two": (("--gains", "k_p=1", "k_f=-1"), "k_f: -1.0 must be 0 or more"),
    "reference": (("--reference", "sinus"), "did you mean 'sines'"),
    "motion": (("--motion", "wonder"), "did you mean 'wander'"),
    "seconds": (("--seconds", "0.01"), "seconds: invalid length 0.01: expected"),
    "log": (("--reference", "no.csv"), "no.csv"),
}


@pytest.mark.parametrize("why", REFUSED)
def test_what_simulate_refuses(call, bench, tmp_path, why):
    words, line = REFUSED[why]
    out = tmp_path / "new" / "log.csv"
    said = call("simulate", bench[0], *words, "--out", out)
    assert said.code == 2 and said.out == ""
    lines = said.err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("hydrojax: ") and line in lines[0]
    assert not out.parent.exists()


def test_outs_that_will_not_do(call, bench, tmp_path):
    for out in (tmp_path, tmp_path / "log.txt", bench[0] / "log.csv"):
        said = call("simulate", bench[0], "--out", out)
        assert said.code == 2 and len(said.err.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_loop_that_diverges_is_refused(call, tmp_path):
    rig, out = tmp_path / "rig.toml", tmp_path / "log.csv"
    massless = '\n[load]\nmass = "1 mg"\nstiffness = "1e9 N/m"\n'
    rig.write_text(RIG + massless)
    said = call("simulate", rig, "--seconds", 0.6, "--out", out)
    assert said.code == 2 and "the closed loop diverges; lower the gains" in said.err
    assert [p.name for p in tmp_path.iterdir()] == ["rig.toml"]


def test_a_locked_joints_log_is_said_to_be_of_no_use_here(call, bench, tmp_path):
    out = tmp_path / "a.csv"
    words = ("--seconds", 0.6, "--motion", "locked", "--out", out)
    said = call("simulate", bench[0], *words)
    assert said.code == 0 and "position does not move" in said.out


def test_a_motion_beyond_the_stroke_is_refused(call, bench, tmp_path):
    out = tmp_path / "log.csv"
    said = call(
        "simulate", bench[0], "--seconds", 0.6, "--motion", "locked:0.2 m", "--out", out
    )
    assert said.code == 2 or "warning" in said.out


@pytest.mark.parametrize("mass", ["-5 kg", "0 kg"])
def test_a_mass_that_cannot_be(load, mass):
    with pytest.raises(InputError, match=r"\[load\] mass must be above 0"):
        build_loop(load(BARE + f'[load]\nmass = "{mass}"\n'))


def test_a_switch_is_no_gain(load):
    with pytest.raises(InputError, match="k_p"):
        si("k_p = true", load)


def test_a_loop_that_saturates_is_warned_of(call, bench, tmp_path):
    """Empty chambers and the supply bound what any gain can do."""
    gains = ("--gains", "k_p=1e9", "k_f=1e9", "u_max=1e9")
    said = call(
        "simulate", bench[0], *gains, "--seconds", 0.6, "--out", tmp_path / "log.csv"
    )
    assert said.code == 0
    assert "warning: a pressure left (P_r, P_s)" in said.out
    assert "command saturated in 99" in " ".join(said.out.split())


# -- there and back: simulate, then trace --

RANGES = {
    "beta": ("Pa", 1e8, 3e9),
    **{c: ("m^3/(s*V*Pa^0.5)", 2e-10, 2e-8) for c in ("c_p1", "c_n1", "c_p2", "c_n2")},
    **{d: ("m", 0.0, 0.05) for d in ("delta_1", "delta_2")},
    **{k: ("N", 0.0, 4000.0) for k in ("k_cp", "k_cn")},
    "k_0": ("N", -800.0, 800.0),
    **{k: ("N*s/m", -3e4, 3e4) for k in ("k_vp", "k_vn")},
    **{k: ("", 0.0, 3.0) for k in ("k_fp", "k_fn")},
    "z_ss": ("m", 2e-6, 5e-4),
    "delta": ("1/N", 1e-4, 1e-2),
}


def guess(truth: Path) -> str:
    """A rig file with ranges, starts 20 % off, spool and delay, and no effect more."""
    spec = RigFile.load(truth)
    lines = [RIG.split("[parameters]")[0], "[parameters]"]
    for i, (name, (unit, low, high)) in enumerate(RANGES.items()):
        start = spec.parameters[name].start * (1.2 if i % 2 else 0.8)
        ends = f'"{low:g} {unit}", "{high:g} {unit}"'
        lines.append(f'{name} = {{ start = "{start:.6g} {unit}", range = [{ends}] }}')
    lines += [
        "[effects.valve_lag]",
        'omega = { start = "1500 rad/s", range = ["200 rad/s", "5000 rad/s"] }',
        'zeta = "0.7"',
        "[effects.valve_delay]",
        'tau_u = { start = "1.2 ms", range = ["0 ms", "5 ms"] }',
    ]
    return "\n".join(lines) + "\n"


@pytest.mark.slow
def test_a_simulated_leak_is_found_in_the_logs(call, tmp_path):
    """The whole circle, and the slowest test here: three logs of 12 s by `simulate`
    from a rig that leaks inside, and `trace` with a rig file that knows of no leak.
    """
    truth = tmp_path / "truth.toml"
    leak = '\n[effects.internal_leakage]\nc_il = "1e-12 m^3/(s*Pa)"\n'
    truth.write_text(RIG + leak)
    logs = [tmp_path / f"{name}.csv.gz" for name in ("fit_1", "fit_2", "validate")]
    for seed, log in enumerate(logs, 1):
        said = call("simulate", truth, "--seconds", 12, "--seed", seed, "--out", log)
        assert said.code == 0, said
    rig = tmp_path / "rig.toml"
    rig.write_text(guess(truth))
    case = open_case(rig, logs[:2], logs[2:])
    out = running.trace_case(case)
    assert out.verdict == "explained"
    assert [e.name for e in out.effects] == ["internal_leakage"]
    (effect,) = out.effects
    leak = effect.parameters["c_il"]
    assert leak.value == pytest.approx(1e-12, rel=0.005)
    assert abs(leak.value - 1e-12) < 5 * leak.std
    for channel in out.channels.values():
        assert channel.before > 10 * channel.noise
        assert channel.after < 1.03 * channel.noise
    for name, rel in {"beta": 0.03, "c_p1": 0.002, "c_n2": 0.002, "z_ss": 0.03}.items():
        true = RigFile.load(truth).parameters[name].start
        assert out.parameters[name].value == pytest.approx(true, rel=rel), name
