"""The plant of the drawn machines, against equations written here; and their files."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks.machines import files, laws, record, rigs, run, table
from benchmarks.machines.laws import State
from benchmarks.machines.sizes import draw
from hydrojax.identify.case import open_case, read
from hydrojax.rigfile.schema import RigFile

PLAIN, HOLDS = 4, 3
"""Seeds: a flow curve and an orifice; an over-centre valve and a compensator."""


@pytest.fixture(scope="module")
def fast():
    """One lane's program where Numba is there; the same text in NumPy elsewhere."""
    return run.compiled()


class Reference:
    """One machine's equations written again, angles by trigonometry."""

    def __init__(self, machine, u: float):
        self.p, self.u, self.delay = machine.parameters, u, machine.delay

    def beta(self, P):
        p, absolute = self.p, max(P + 101325.0, 2e3)
        gas = p.alpha * (101325.0 / absolute) ** (1 / 1.2) / (1.2 * absolute)
        return p.beta / (1 + p.beta * gas)

    @staticmethod
    def orifice(c, drop, core=5e4):
        return math.copysign(c * abs(drop) / (drop**2 + core**2) ** 0.25, drop)

    def force(self, x):
        """Weight on the rod, arm, and its change, by differences of the angle."""
        p = self.p

        def angle(L):
            return math.acos((p.arm_a**2 + p.arm_b**2 - L**2) / (2 * p.arm_a * p.arm_b))

        def arm(x):
            h = 1e-5
            return 2 * h / (angle(p.length + x + h) - angle(p.length + x - h))

        level = math.atan2(p.sin_0, p.cos_0)
        torque = p.moment * math.cos(angle(p.length + x) - level)
        slope = (arm(x + 1e-3) - arm(x - 1e-3)) / 2e-3  # dr/dx
        return torque / arm(x), arm(x), slope

    def __call__(self, t, y):
        s, ds, P1, P2, PL, Ps, pilot, x, v = y
        p, u = self.p, self.u if t >= self.delay else 0.0
        o = max(s - p.u_dbp, 0.0) - max(-s - p.u_dbn, 0.0)
        o = math.copysign((1 - p.k) * abs(o) + p.k * abs(o) ** p.p, o)

        def feed(c, port):
            drop = Ps - port
            if p.compensated:
                drop = min(max(drop, 0.0), p.dP_c)
            return self.orifice(c, drop)

        behind = PL if p.has_line else P2
        Q1 = o * feed(p.c_p1, P1) if o > 0 else o * self.orifice(p.c_n1, P1 - p.P_r)
        Q2 = (
            -o * self.orifice(p.c_n2, behind - p.P_r)
            if o > 0
            else -o * feed(p.c_p2, behind)
        )
        drawn, dPL = max(Q1, Q2), 0.0
        if p.has_line:
            lift = min(max((P2 + p.ratio * pilot - p.P_set) / p.dP_full, 0.0), 1.0)
            through = (
                self.orifice(p.c_out * lift, P2 - PL)
                if P2 > PL
                else self.orifice(p.c_check, P2 - PL, 3e5)
            )
            dPL = self.beta(PL) / p.V_line * (Q2 + through)
            Q2 = -through
        seep = p.c_il * (P1 - P2)
        V1, V2 = p.V_1 + p.A_1 * (p.stroke - x), p.V_2 + p.A_2 * x
        weight, arm, slope = self.force(x)
        # Half m(x) v^2 with m = J / r^2: d/dt(m v) - m' v^2 / 2 is the net force.
        mass, dmass = p.inertia / arm**2, -2 * p.inertia / arm**3 * slope
        net = p.A_2 * P2 - p.A_1 * P1 - weight - p.viscous * v
        net -= p.coulomb * v / math.hypot(v, 2e-3)
        return [
            ds,
            p.omega**2 * (u - s) - 2 * p.zeta * p.omega * ds,
            self.beta(P1) / V1 * (Q1 + p.A_1 * v - seep),
            self.beta(P2) / V2 * (Q2 - p.A_2 * v + seep),
            dPL,
            (p.P_max - p.sag * drawn - Ps) / p.tau_pump,
            (P1 - pilot) / p.tau_pilot,
            v,
            (net - dmass * v**2 / 2) / mass,
        ]


@pytest.mark.parametrize(("seed", "u"), [(PLAIN, 0.6), (PLAIN, -0.5), (HOLDS, 0.7)])
def test_a_second_of_a_step_is_scipys(seed, u, fast):
    """To 0.02 bar and 2 um, where pressures move by tens of bar."""
    machine = draw(seed)
    p = machine.parameters
    assert not p.senses and p.holding and p.r_v == 1e3  # what the reference can do
    start = record.settled(p, 0.5 * p.stroke)
    plain = type(p)(*map(float, p))
    u_run, got = run.run([plain], [start], [lambda x: u], [machine.delay], 100, fast)
    assert np.all(u_run == u)
    begun = machine.delay
    law, t = Reference(machine, u), np.arange(100) * run.TICK
    options = {"method": "LSODA", "rtol": 1e-8, "atol": 1e-9 * np.ones(9)}
    options["atol"][[2, 3, 4, 5, 6]] = 1.0
    want = np.tile(np.array(start, float)[:, None], 100)
    later = t >= begun
    solved = solve_ivp(law, (begun, 1.0), start, t_eval=t[later], **options)
    want[:, later] = solved.y
    assert np.ptp(want[2]) > 10e5
    for column, row in ((1, 2), (2, 3), (3, 5)):
        assert np.max(np.abs(got[0, :, 0, column] - want[row])) < 2e3
    assert np.max(np.abs(got[0, :, 0, 0] - want[7])) < 2e-6


def test_a_compensated_edge_knows_no_supply_above_its_margin():
    p = draw(HOLDS).parameters
    margin, port = p.dP_c, 60e5
    above = laws.metered_in(port + margin * np.array([1.0, 1.5, 4.0]), port, p)
    assert np.all(above == above[0])
    below = laws.metered_in(port + 0.25 * margin, port, p)
    assert below == pytest.approx(above[0] / 2, rel=0.02)  # an orifice again
    assert laws.metered_in(port - 30e5, port, p) == 0.0  # its check valve holds
    bare = p._replace(compensated=0.0)
    assert laws.metered_in(port - 30e5, port, bare) < 0


def test_numpy_and_numba_run_alike_and_again_alike(fast):
    machines = [draw(PLAIN), draw(HOLDS)]
    once = record.record_machines(machines, 0.03)
    again = record.record_machines(machines[:1], 0.03)
    for name, log in again[0].logs.items():
        assert np.array_equal(log, once[0].logs[name])
    if fast is not None:
        other = record.record_machines(machines, 0.03, fast)
        for a, b in zip(once, other, strict=True):
            assert all(np.allclose(a.clean[n], b.clean[n], rtol=1e-9) for n in a.clean)


def test_seeds_leave_out_none_one_or_some():
    drawn = [draw(seed) for seed in range(60)]
    assert {len(m.left_out) for m in drawn[::3]} == {0}
    assert {len(m.left_out) for m in drawn[1::3]} == {1}
    assert {len(m.left_out) for m in drawn[2::3]} == {2, 3}
    assert all(set(m.left_out) <= set(m.truth) for m in drawn)
    assert draw(7) == draw(7) and draw(7) != draw(7, 1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [HOLDS, 10])
def test_hydrojax_opens_what_is_recorded(seed, tmp_path, fast):
    machine = draw(seed)
    recording = record.record_machines([machine], 6.0, fast)[0]
    files.write(recording, tmp_path)
    logs = [tmp_path / f"{name}.csv" for name in record.LOGS]
    case = open_case(tmp_path / files.RIG, logs[:2], logs[2:])
    assert set(case.spec.effects) == set(machine.truth) - set(machine.left_out)


def test_hydrojax_reads_every_effect_and_log(tmp_path, fast):
    for seed in range(20):
        machine = draw(seed)
        (tmp_path / files.RIG).write_text(rigs.rig_text(machine))
        spec = RigFile.load(tmp_path / files.RIG)
        assert set(spec.effects) == set(machine.truth) - set(machine.left_out)
    machine = draw(PLAIN)  # no filter between the plant and the log
    recording = record.record_machines([machine], 3.0, fast)[0]
    files.write(recording, tmp_path)
    log = read(tmp_path / "fit_1.csv", RigFile.load(tmp_path / files.RIG))
    P = np.asarray(log.signals["P_a1"])
    assert P.shape == (300,) and np.allclose(
        P, recording.clean["fit_1"][:, 3], atol=6 * machine.noise
    )
    truth = json.loads((tmp_path / files.TRUTH).read_text())
    assert truth["left_out"] == list(machine.left_out)
    for name in rigs.true_parameters(machine):
        assert name in (tmp_path / files.RIG).read_text()


def test_the_summary_counts_kinds():
    def row(case, left_out, named, skill=0.95):
        channel = {"after": 1.0, "noise": 1.0, "unit": "Pa", "free": 2.0}
        result = {"verdict": "explained", "named": named, "seconds": 1.0}
        result["channels"] = {"P_a1": channel | {"skill": skill}}
        return table.Row(case, left_out, result)

    rows = [
        row(1, ("a",), ["a"]),
        row(2, ("a",), ["a", "b"]),
        row(3, ("a", "b"), ["a"], skill=0.5),
        row(4, (), []),
        row(5, (), ["c"], skill=None),
    ]
    assert [r.kind for r in rows] == list(table.KINDS[:5])
    assert "channel: 3 of 5" in table.summary(rows)
    assert table.table(rows).row_count == 5


def test_a_held_load_stays(fast):
    """The start is an equilibrium: no pressure moves by a hundredth of a bar."""
    machine = draw(HOLDS)
    p = type(machine.parameters)(*map(float, machine.parameters))
    start = record.settled(p, 0.5 * p.stroke)
    assert isinstance(start, State)
    _, got = run.run([p], [start], [lambda x: 0.0], [machine.delay], 50, fast)
    assert np.max(np.ptp(got[0, :, 0], axis=0)) < 1e3
