"""The plants of `benchmarks.blind` against equations written here."""

from __future__ import annotations

import functools
import json
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from benchmarks.blind import recording
from hydrojax.effects import EFFECTS

pytestmark = pytest.mark.slow


@functools.cache
def labs() -> SimpleNamespace:
    """Both plants; when they are asked for, as Numba takes 200 MiB of every worker."""
    pytest.importorskip("numba")
    joints, machines = "benchmarks.blind.joints", "benchmarks.blind.machines"
    where = {n: f"{joints}.{n}" for n in ("effects", "make", "plant", "rigs")}
    where |= {
        "parts": f"{machines}.effects",
        "made": f"{machines}.make",
        "machine_plant": f"{machines}.plant",
        "machine_rigs": f"{machines}.rigs",
    }
    return SimpleNamespace(**{n: import_module(of) for n, of in where.items()})


SECONDS, HOLD = 0.4, 0.02
"""Of a log, and of each value of its command."""

SWAY, OMEGA = 2e-3, 11.0
"""Motion of the piston: m, rad/s."""


@pytest.fixture(scope="module")
def rig():
    return labs().rigs.draw_rig(3, layout="differential", constant_supply=True)


def commands(rig):
    """Each held command, V: about what the motion takes."""
    c, t = rig.plant, np.arange(HOLD / 2, SECONDS, HOLD)
    v = SWAY * OMEGA * np.cos(OMEGA * t)
    return -v * c.area_2 / (c.c_p2 * np.sqrt(rig.P_s / 2))


def simulated(rig, own):
    """Pressures and force under a command that steps, the motion imposed."""
    n, t = round(SECONDS * 1000), np.arange(0, SECONDS + 0.1, labs().rigs.DT)
    knots = np.ascontiguousarray(CubicSpline(t, SWAY * np.sin(OMEGA * t)).c)
    u = np.repeat(commands(rig), round(HOLD * 1000))
    start = np.array([0.45, 0.5]) * rig.P_s
    P_s, none = np.full(t.size, rig.P_s), np.zeros((n, 3))
    return labs().plant.simulate(
        own, rig.control, False, 1e-3, 40, knots, P_s, labs().rigs.DT, 0 * t, u, none,
        start, np.zeros((1, 2)), 0,
    )  # fmt: skip


class Paper:
    """Equations (3)-(7), (12), (13) and (22) of the paper, written again."""

    def __init__(self, rig):
        self.c, self.P_s = rig.plant, rig.P_s

    def rates(self, t, y, u):
        c, (P_1, P_2, z, speed) = self.c, y
        x, v = SWAY * np.sin(OMEGA * t), SWAY * OMEGA * np.cos(OMEGA * t)
        if u > 0:
            Q_1 = c.c_p1 * np.sqrt(self.P_s - P_1) * u
            Q_2 = -c.c_n2 * np.sqrt(P_2 - c.P_r) * u
        else:
            Q_1 = c.c_n1 * np.sqrt(P_1 - c.P_r) * u
            Q_2 = -c.c_p2 * np.sqrt(self.P_s - P_2) * u
        V_1 = c.area_1 * (c.length / 2 + c.delta_1 - x)
        V_2 = c.area_2 * (c.length / 2 + c.delta_2 + x)
        return [
            c.beta / V_1 * (Q_1 + c.area_1 * v),
            c.beta / V_2 * (Q_2 - c.area_2 * v),
            v - abs(v) * z / c.z_ss,
            10 * (abs(v) - speed),
        ]

    def force(self, t, y):
        c, (P_1, P_2, z, speed) = self.c, y
        v = SWAY * OMEGA * np.cos(OMEGA * t)
        L = 1 / (1 + (300 * speed) ** 3)
        share = np.clip(z / c.z_ss, -1, 1)
        f_c = (c.k_cp if share > 0 else c.k_cn) * share + c.k_0
        f_c -= (c.k_vp if v > 0 else c.k_vn) * v
        drive = c.area_2 * P_2 - c.area_1 * P_1 - (1 - L) * f_c

        def left(F):
            k_f = c.k_fp if F > 0 else c.k_fn
            return drive - L * k_f * F / (1 + c.delta * abs(F)) - F

        return brentq(left, -2 * abs(drive) - 1, 2 * abs(drive) + 1, xtol=1e-9)


def test_a_rig_without_faults_is_the_papers(rig):
    """By scipy: pressures to 20 Pa, where they move by bar, and the force to 0.05 N."""
    law, fine = Paper(rig), simulated(rig, rig.plant)
    options = {"rtol": 1e-9, "atol": [1e-2, 1e-2, 1e-12, 1e-10]}
    y, got = [0.45 * rig.P_s, 0.5 * rig.P_s, 0.0, 0.0], []
    for i, u in enumerate(commands(rig)):
        t = HOLD * i + np.arange(round(HOLD * 1000) + 1) / 1000
        ends = (t[0], t[-1])
        s = solve_ivp(law.rates, ends, y, "LSODA", t, args=(u,), **options)
        got += [[*s.y[:2, j], law.force(t[j], s.y[:, j])] for j in range(t.size - 1)]
        y = s.y[:, -1]
    want, here = np.array(got), fine[:: labs().plant.FINE]
    assert np.ptp(want[:, :2], axis=0).min() > 2e5
    assert np.abs(want[:, :2] - here[:, 3:]).max() < 20.0
    assert np.abs(want[:, 2] - here[:, 2]).max() < 0.05
    assert np.array_equal(here[:, :2], here[:, 3:])  # perfect gauges


@pytest.mark.parametrize(
    "name", ["valve_lag", "entrained_air", "stribeck", "rod_compliance"]
)
def test_an_effect_at_its_absent_value_changes_nothing(rig, name):
    """To the last bit; and at its largest it changes much."""
    drawn = labs().effects.draw_effect(np.random.default_rng(5), name, rig)
    fields = labs().make.plant_fields(labs().effects.at_size(drawn, 1.0, rig.plant))
    assert set(fields) <= set(labs().plant.ABSENT)
    gone = {field: labs().plant.ABSENT[field] for field in fields}
    bare = simulated(rig, rig.plant)
    assert np.array_equal(simulated(rig, rig.plant._replace(**gone)), bare)
    there = simulated(rig, rig.plant._replace(**fields))
    noise = [labs().rigs.total_noise(rig, channel) for channel in labs().make.CHANNELS]
    assert np.max(np.abs(there - bare)[:, :3] / noise) > 3.0


def test_a_machine_is_scipys():
    """A crane with overlaps, dead time, spool and air lifts for 0.3 s: to 0.02 bar."""
    seed = 7
    machine = labs().machine_rigs.draw_machine(
        np.random.default_rng(seed), True, True, False
    )
    p = dict(machine.plant)
    assert p["o_p2"] > 0 and p["tau_u"] > 0 and np.isfinite(p["omega_v"])
    p |= {"alpha": 4e-3, "R_src": 0.0}
    u, x_0, rate, end = -0.6 * p["u_full"], -0.1 * p["stroke"], 100, 0.3
    start = [machine.rest_P1, machine.rest_P2]
    n = round(end * rate) + 1
    command = np.full(n, u)
    command[0] = 0.0
    plant = labs().machine_plant
    rec, _, _ = plant.run(
        plant.parameters(**p), command, float(rate), 100, 100, np.zeros(7),
        np.array([x_0]), np.empty((0, 4)), np.array([start]), 0,
    )  # fmt: skip

    def root(gain, opening, dp):
        return gain * max(opening, 0.0) * dp / (dp**2 + 1e8) ** 0.25

    def stiff(P):
        P = P + 101325.0
        air = p["alpha"] * (101325.0 / P) ** (1 / 1.4) / (1.4 * P)
        return 1 / (1 / p["beta"] + air)

    def rates(t, s):
        P_1, P_2, x, v, z, y, dy = s
        want = u * np.clip((t - p["tau_u"]) * rate, 0.0, 1.0)  # straight between ticks
        P_s = p["P_src"]
        Q_1 = root(p["c_p1"], y - p["o_p1"], P_s - P_1)
        Q_1 -= root(p["c_n1"], -y - p["o_n1"], P_1 - p["P_r"])
        Q_2 = root(p["c_p2"], -y - p["o_p2"], P_s - P_2)
        Q_2 -= root(p["c_n2"], y - p["o_n2"], P_2 - p["P_r"])
        load = p["W"] * (1 + p["W_slope"] * x / p["stroke"]) + p["load_b"] * v
        load += p["load_c"] * np.tanh(v / 5e-3)
        net = p["area_2"] * P_2 - p["area_1"] * P_1 - load
        net -= p["k_c"] * z / p["z_ss"] + p["k_0"] + p["b"] * v
        V_1 = p["area_1"] * (p["stroke"] / 2 + p["delta_1"] - x)
        V_2 = p["area_2"] * (p["stroke"] / 2 + p["delta_2"] + x)
        return [
            stiff(P_1) / V_1 * (Q_1 + p["area_1"] * v),
            stiff(P_2) / V_2 * (Q_2 - p["area_2"] * v),
            v,
            net / p["mass"],
            v - abs(v) * z / p["z_ss"],
            dy,
            p["omega_v"] ** 2 * (want - y) - 2 * p["zeta_v"] * p["omega_v"] * dy,
        ]

    t, y = np.arange(n) / rate, [*start, x_0, 0.0, 0.0, 0.0, 0.0]
    atol = [1.0, 1.0, 1e-9, 1e-8, 1e-10, 1e-8, 1e-6]
    s = solve_ivp(rates, (0, end), y, "LSODA", t, rtol=1e-8, atol=atol, max_step=1e-3)
    assert np.ptp(s.y[1]) > 10e5 and np.ptp(s.y[2]) > 1e-3
    assert np.abs(s.y[:2].T - rec[:, :2]).max() < 2e3
    assert np.abs(s.y[2] - rec[:, 3]).max() < 2e-6


def test_draws_come_again():
    assert labs().rigs.draw_rig(5) == labs().rigs.draw_rig(5) != labs().rigs.draw_rig(6)
    one, again = (
        labs().machine_rigs.draw_machine(np.random.default_rng(2), True, 0, 0)
        for _ in "12"
    )
    assert one == again
    assert [labs().make.draw_task(i) for i in range(20)] == [
        labs().make.draw_task(i) for i in range(20)
    ]
    for lab in (labs().make, labs().made):
        of = labs().make.draw_task if lab is labs().make else labs().made.kind_of
        assert sorted(of(i)[0] for i in range(20, 40)) == sorted(lab.KINDS)


def test_every_effect_that_is_hidden_has_a_name():
    assert set(labs().effects.TABLE) | {e.name for e in labs().parts.TABLE} <= set(
        EFFECTS
    )


def test_what_is_there_is_not_recorded_again(tmp_path, monkeypatch):
    written = []

    def write(folder, number):
        written.append(number)
        return {"case": f"c{number:02d}", "kind": "nothing"}

    monkeypatch.setattr(labs().make, "write_case", write)
    assert len(list(recording.record(tmp_path, [1, 2], False))) == 2
    assert [t["case"] for t in recording.record(tmp_path, [2, 3], False)] == ["c03"]
    assert written == [1, 2, 3]
    assert list(recording.truths(tmp_path)) == ["c01", "c02", "c03"]
    assert json.loads((tmp_path / recording.TRUTHS).read_text().splitlines()[0])
    assert list((tmp_path / recording.CASES).iterdir()) == []
