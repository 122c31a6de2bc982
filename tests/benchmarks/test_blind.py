"""The plants of `benchmarks.blind` against equations written here, and the scoring."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from benchmarks.blind import recording, scoring, table
from hydrojax.effects import EFFECTS

pytest.importorskip("numba")

from benchmarks.blind.joints import effects, make, plant, rigs  # noqa: E402
from benchmarks.blind.machines import effects as parts  # noqa: E402
from benchmarks.blind.machines import make as made  # noqa: E402
from benchmarks.blind.machines import plant as machine_plant  # noqa: E402
from benchmarks.blind.machines.rigs import draw_machine  # noqa: E402

SECONDS, HOLD = 0.4, 0.02
"""Of a log, and of each value of its command."""

SWAY, OMEGA = 2e-3, 11.0
"""Motion of the piston: m, rad/s."""


@pytest.fixture(scope="module")
def rig():
    return rigs.draw_rig(3, layout="differential", constant_supply=True)


def commands(rig):
    """Each held command, V: about what the motion takes."""
    c, t = rig.plant, np.arange(HOLD / 2, SECONDS, HOLD)
    v = SWAY * OMEGA * np.cos(OMEGA * t)
    return -v * c.area_2 / (c.c_p2 * np.sqrt(rig.P_s / 2))


def simulated(rig, own):
    """Pressures and force under a command that steps, the motion imposed."""
    n, t = round(SECONDS * 1000), np.arange(0, SECONDS + 0.1, rigs.DT)
    knots = np.ascontiguousarray(CubicSpline(t, SWAY * np.sin(OMEGA * t)).c)
    u = np.repeat(commands(rig), round(HOLD * 1000))
    start = np.array([0.45, 0.5]) * rig.P_s
    P_s, none = np.full(t.size, rig.P_s), np.zeros((n, 3))
    return plant.simulate(
        own, rig.control, False, 1e-3, 40, knots, P_s, rigs.DT, 0 * t, u, none,
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
    want, here = np.array(got), fine[:: plant.FINE]
    assert np.ptp(want[:, :2], axis=0).min() > 2e5
    assert np.abs(want[:, :2] - here[:, 3:]).max() < 20.0
    assert np.abs(want[:, 2] - here[:, 2]).max() < 0.05
    assert np.array_equal(here[:, :2], here[:, 3:])  # perfect gauges


@pytest.mark.parametrize(
    "name", ["valve_lag", "entrained_air", "stribeck", "rod_compliance"]
)
def test_an_effect_at_its_absent_value_changes_nothing(rig, name):
    """To the last bit; and at its largest it changes much."""
    drawn = effects.draw_effect(np.random.default_rng(5), name, rig)
    fields = make.plant_fields(effects.at_size(drawn, 1.0, rig.plant))
    assert set(fields) <= set(plant.ABSENT)
    gone = {field: plant.ABSENT[field] for field in fields}
    bare = simulated(rig, rig.plant)
    assert np.array_equal(simulated(rig, rig.plant._replace(**gone)), bare)
    there = simulated(rig, rig.plant._replace(**fields))
    noise = [rigs.total_noise(rig, channel) for channel in make.CHANNELS]
    assert np.max(np.abs(there - bare)[:, :3] / noise) > 3.0


def test_a_machine_is_scipys():
    """A crane with overlaps, dead time, spool and air lifts for 0.3 s: to 0.02 bar."""
    seed = 7
    machine = draw_machine(np.random.default_rng(seed), True, True, False)
    p = dict(machine.plant)
    assert p["o_p2"] > 0 and p["tau_u"] > 0 and np.isfinite(p["omega_v"])
    p |= {"alpha": 4e-3, "R_src": 0.0}
    u, x_0, rate, end = -0.6 * p["u_full"], -0.1 * p["stroke"], 100, 0.3
    start = [machine.rest_P1, machine.rest_P2]
    n = round(end * rate) + 1
    command = np.full(n, u)
    command[0] = 0.0
    rec, _, _ = machine_plant.run(
        machine_plant.parameters(**p), command, float(rate), 100, 100, np.zeros(7),
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
    assert rigs.draw_rig(5) == rigs.draw_rig(5) != rigs.draw_rig(6)
    one, again = (draw_machine(np.random.default_rng(2), True, 0, 0) for _ in "12")
    assert one == again
    assert [make.draw_task(i) for i in range(20)] == [
        make.draw_task(i) for i in range(20)
    ]
    for lab in (make, made):
        of = make.draw_task if lab is make else made.kind_of
        assert sorted(of(i)[0] for i in range(20, 40)) == sorted(lab.KINDS)


def test_every_effect_that_is_hidden_has_a_name():
    assert set(effects.TABLE) | {e.name for e in parts.TABLE} <= set(EFFECTS)


# -- the scoring --


def truth(kind, *names, lie=None, layout="differential", **fields):
    made = [{"name": name, "fields": fields} for name in names]
    return {"kind": kind, "effects": made, "lie": lie or {}, "layout": layout}


def row(verdict="explained", *names, alike=(), blamed=(), case="c00"):
    named = [{"name": n, "gain": 1.0, "cannot_tell_from": list(alike)} for n in names]
    inputs = [dict(zip(("input", "finding"), b, strict=True)) for b in blamed]
    channels = {"F": {"noise": 2.0, "after": 3.0}, "P_a2": {"noise": 1.0, "after": 1.0}}
    return {
        "case": case, "ok": True, "verdict": verdict, "named": named,
        "inputs": inputs, "channels": channels, "wall": 60.4,
    }  # fmt: skip


PAIRS = {"o_p1": 0.3, "o_n2": 0.3, "o_n1": 0.2, "o_p2": 0.2}
FOUR = PAIRS | {"o_n2": 0.4}
OPEN = dict.fromkeys(PAIRS, -0.1)
BOTH = truth("several", "stribeck", "backlash")
LIES = {
    "sign": ({"sign": "F"}, ("F", "sign"), ("F", "factor")),
    "area": ({"area": 0.95}, ("area_1", "factor"), ("P_s", "factor")),
    "swapped": (
        {"swapped": ["P_a1", "P_a2"]},
        ("P_a1, P_a2", "exchanged"),
        ("F", "sign"),
    ),
    "unit": ({"unit": {"channel": "P"}}, ("P_a1, P_a2", "unit"), ("F", "unit")),
    "noise": ({"noise": 10.0}, ("F", "noise"), ("F", "delay")),
    "shift": ({"shift": {"channel": "psi"}}, ("psi", "delay"), ("P_a1", "delay")),
}


@pytest.mark.parametrize(
    ("of", "found", "right"),
    [
        (truth("nothing"), row("nothing missing"), True),
        (truth("nothing"), row("unknown"), False),
        (truth("nothing"), row("nothing missing", "stribeck"), False),
        (truth("one", "stribeck"), row("unknown", "stribeck"), True),
        (truth("one", "stribeck"), row("explained", "stribeck", "backlash"), False),
        (truth("one", "stribeck"), row("", "backlash", alike=["stribeck"]), True),
        (BOTH, row("explained", "stribeck"), False),
        (BOTH, row("", "stribeck", "backlash"), True),
        (truth("one", "valve_deadband", **PAIRS), row("", "valve_deadband"), True),
        (truth("one", "valve_deadband", **PAIRS), row("", *scoring.EDGES), False),
        (truth("one", "valve_deadband", **FOUR), row("", "valve_deadband"), False),
        (
            truth("one", "valve_deadband", **FOUR),
            row("", "valve_deadband", "return_overlap"),
            True,
        ),
        (
            truth("one", "valve_deadband", layout="pull-pull", **FOUR),
            row("", "valve_deadband"),
            True,
        ),
        (truth("one", "underlap", **OPEN), row("", "underlap", "return_overlap"), True),
        (truth("one", "valve_deadband", **OPEN), row("", "return_overlap"), True),
        (truth("one", "underlap", **OPEN), row("nothing missing"), False),
        (truth("outside", "gland_leak"), row("unknown", "port_relief"), True),
        (truth("outside", "gland_leak"), row("explained", "port_relief"), False),
        (truth("outside", "relief_valve"), row("explained", "port_relief"), True),
        (truth("lie", lie={"area": 1.05}), row("", "stribeck", alike=["area"]), True),
        (truth("lie", lie={"sign": "F"}), row("unknown", "channel_skew"), False),
        *((truth("lie", lie=a), row(blamed=[b]), True) for a, b, _ in LIES.values()),
        *((truth("lie", lie=a), row(blamed=[b]), False) for a, _, b in LIES.values()),
    ],
)  # fmt: skip
def test_what_is_right(of, found, right):
    assert scoring.right(of, found) == right


def test_a_refusal_may_call_a_lie_by_its_name():
    refused = {"ok": False, "reason": "InputError: log.csv: F is 1e9 N"}
    assert scoring.right(truth("lie", lie={"sign": "F"}), refused)
    assert not scoring.right(truth("lie", lie={"sign": "u"}), refused)
    assert not scoring.right(truth("one", "stribeck"), refused)


def test_the_table_counts_kinds():
    lie = truth("lie", lie=LIES["shift"][0] | {})
    failed = {"case": "c04", "ok": False, "reason": "ValueError: a|b", "wall": 1.0}
    cases = [
        (truth("nothing"), row("nothing missing", case="c01")),
        (truth("one", "stribeck"), row("unknown", "stribeck", alike=["x"])),
        (truth("several", "stribeck", "backlash"), row("explained", "backlash")),
        (truth("outside", "gland_leak"), row("unknown", blamed=[("F", "sign")])),
        (lie, row("nothing missing", blamed=[("psi", "delay")])),
        (truth("nothing"), failed),
    ]
    text = table.report(cases)
    assert "| c01 | nothing | - | - | nothing missing | 1.50 | 60 | yes |" in text
    assert "| stribeck or x | unknown |" in text and "| [F: sign] |" in text
    assert "| ValueError: a/b | - | 1 | no |" in text
    said = (line.strip("| ").split(" | ") for line in table.summary(cases).split("\n"))
    counts = {own[0]: own[1].split(" ")[0] for own in said if len(own) == 2}
    assert counts["nothing missing, and said so"] == "1/2"
    assert counts["single effects named"] == "1/1"
    assert counts["single effects named, and `explained`"] == "0/1"
    assert counts["effects of sets named"] == "1/2"
    assert counts["lies called by their name"] == "1/1"
    assert counts["inputs blamed where none lies"] == "1/4"
    assert counts["traces failed"] == "1/6"


def test_what_is_there_is_not_recorded_again(tmp_path, monkeypatch):
    written = []

    def write(folder, number):
        written.append(number)
        return {"case": f"c{number:02d}", "kind": "nothing"}

    monkeypatch.setattr(make, "write_case", write)
    assert len(list(recording.record(tmp_path, [1, 2], False))) == 2
    assert [t["case"] for t in recording.record(tmp_path, [2, 3], False)] == ["c03"]
    assert written == [1, 2, 3]
    assert list(recording.truths(tmp_path)) == ["c01", "c02", "c03"]
    assert json.loads((tmp_path / recording.TRUTHS).read_text().splitlines()[0])
    assert list((tmp_path / recording.CASES).iterdir()) == []
