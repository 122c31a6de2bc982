"""Effects of working machines' valves and loggers, against closed forms and scipy."""

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.signal import TransferFunction, lsim

from hydrojax.effects import EFFECTS as KNOWN
from hydrojax.identify.preparation.noise import derivatives
from hydrojax.parameters import put
from hydrojax.plant.chambers import Losses, Point
from hydrojax.plant.hydraulics import _lost, follow_drops, pressure_step
from hydrojax.plant.layout import LAYOUTS
from hydrojax.plant.replay import Windows, at_start
from hydrojax.plant.rig import add, bare_rig
from hydrojax.plant.state import StepInput

EFFECTS: dict[str, Any] = KNOWN
"""Each class with the method of its own place."""

GEOMETRY = {"area_1": 4.3e-3, "area_2": 6.4e-3, "chamber_length": 0.6}
P_S, P_R, C = 18e6, 0.2e6, 2.2e-9


def point(P_1, P_2, u):
    at = map(np.float64, (P_1, P_2, P_S, P_R))
    return Point(*at, (np.float64(u),), np.float64(0.0), np.float64(0.0))


STILL = StepInput(
    h=jnp.asarray(0.0), u=jnp.asarray(0.0), P_s=jnp.full(2, P_S), P_r=jnp.full(2, P_R),
    x=jnp.zeros(3), dx=None, v=jnp.asarray(0.0), a=jnp.asarray(0.0), t=jnp.asarray(0.0),
)  # fmt: skip


def flows(effect, at):
    """Flows into both chambers, at rest."""
    rig = add(bare_rig(LAYOUTS["differential"], GEOMETRY), [effect])
    return np.array(rig.valve.flows(at, rig.supply, rig.orifice))


@pytest.mark.parametrize("s", [0.4, 1.0])
def test_a_compensator_leaves_its_margin_across_the_edge(s):
    """Above the margin `d^(1-s) dP_0^s`, at s = 1 a flow that knows no pressure."""
    margin = 8e5
    effect = EFFECTS["pressure_compensation"](s=s, dP_0=margin)
    for load in (2e6, 9e6, 16e6):
        q = flows(effect, point(load, 5e6, 0.6))
        left = (P_S - load) ** (1 - s) * margin**s
        assert q[0] == pytest.approx(C * 0.6 * np.sqrt(left), rel=1e-5)
        assert q[1] == pytest.approx(-C * 0.6 * np.sqrt(5e6 - P_R), rel=1e-5)
    below = flows(effect, point(P_S - 3e5, 5e6, 0.6))[0]
    assert below == pytest.approx(C * 0.6 * np.sqrt(3e5), rel=1e-4)
    back = flows(effect, point(P_S + 2e6, 5e6, 0.6))[0]
    assert back == pytest.approx(-C * 0.6 * np.sqrt((1 - s) * 2e6), rel=1e-4, abs=1e-9)


@pytest.mark.parametrize("u_full", [1.0, 10.0])
def test_a_flow_curve_is_whole_at_full_command(u_full):
    effect = EFFECTS["flow_curve"](k=0.8, p=2.6, u_full=u_full)
    share = np.linspace(-1, 1, 41)
    got = np.asarray(effect.step((), jnp.asarray(share * u_full), 1e-3)[1])
    want = u_full * (0.2 * share + 0.8 * np.sign(share) * np.abs(share) ** 2.6)
    assert np.allclose(got, want, rtol=0, atol=1e-12 * u_full)


LAPS = [
    pytest.param(0.0, 0.0, 0.12, -0.05, id="no dead band"),
    pytest.param(0.15, 0.1, 0.2, -0.06, id="closed at centre"),
    pytest.param(0.15, 0.1, -0.16, -0.22, id="open at centre"),
]


@pytest.mark.parametrize(("u_dbp", "u_dbn", "o_n1", "o_n2"), LAPS)
def test_four_edges_open_at_four_overlaps(u_dbp, u_dbn, o_n1, o_n2):
    """Flows of four orifices, each open past its own land, through its notches."""
    rig = add(
        bare_rig(LAYOUTS["differential"], GEOMETRY),
        [
            EFFECTS["valve_deadband"](u_dbp=u_dbp, u_dbn=u_dbn),
            EFFECTS["flow_curve"](k=0.5, p=2.0),
            EFFECTS["return_overlap"](o_n1=o_n1, o_n2=o_n2),
        ],
    )

    def edge(u, land):
        past = max(u - land, 0.0)
        return C * (0.5 * past + 0.5 * past**2)

    P_1, P_2 = 5e6, 7e6
    for u in np.linspace(-1, 1, 41):
        memory = rig.command_init(jnp.asarray(u))
        _, opening = rig.command_step(memory, jnp.asarray(u), jnp.asarray(0.01))
        at = point(P_1, P_2, u)._replace(opening=opening)
        q_1 = edge(u, u_dbp) * np.sqrt(P_S - P_1)
        q_1 -= edge(-u, u_dbn + o_n1) * np.sqrt(P_1 - P_R)
        q_2 = edge(-u, u_dbn) * np.sqrt(P_S - P_2)
        q_2 -= edge(u, u_dbp + o_n2) * np.sqrt(P_2 - P_R)
        got = rig.flows(at)[0]
        assert np.allclose(got, [q_1, q_2], rtol=1e-6, atol=1e-16)


def test_a_spool_that_runs_through_its_centre_opens_each_edge_for_its_share():
    """Means over a tick in which a slow spool crosses every land."""
    rig = add(
        bare_rig(LAYOUTS["differential"], GEOMETRY),
        [
            EFFECTS["valve_rate_limit"](slew=1 / 40.0),
            EFFECTS["valve_deadband"](u_dbp=0.1, u_dbn=0.1),
            EFFECTS["return_overlap"](o_n1=-0.16, o_n2=0.05),
        ],
    )
    memory = rig.command_init(jnp.asarray(0.5))
    _, got = rig.command_step(memory, jnp.asarray(-0.4), jnp.asarray(0.02))
    spool = np.linspace(0.5, -0.3, 4001)
    lands = [spool - 0.1, -spool - 0.1, spool - 0.15, -spool + 0.06]
    want = np.mean(np.maximum(lands, 0.0), axis=1)
    assert np.allclose(got, want, rtol=0, atol=6e-3)


def test_a_counterbalance_valve_opens_by_its_pilot():
    """Shut below its setting but for a leak; by what is beyond it; wholly open."""
    effect = EFFECTS["counterbalance"](k_2=1.0, P_set=1.2e7, ratio=3.0, dP_full=9e6)
    for pilot, share in ((1e6, 0.001), (3e6, 0.3), (4e6, 0.6), (8e6, 0.9)):
        losses = effect.loss(effect.init(np.float64(pilot), np.float64(6e6)))
        assert float(losses[0]) == 0.0
        assert float(losses[1]) == pytest.approx(share**-2, rel=1e-9)


def test_a_counterbalance_valves_pilot_comes_late():
    """After a step of the pilot, as means over each tick, in closed form; its own
    chamber's pressure acts at once.
    """
    tau, h = 0.08, 0.01
    effect = EFFECTS["counterbalance"](
        k_2=1.0, P_set=1.2e7, ratio=3.0, dP_full=9e6, tau=tau
    )
    memory = effect.init(np.float64(3e6), np.float64(6e6))
    for i in range(20):
        own = 6e6 + 1e4 * i
        memory = effect.step(memory, np.float64(4e6), np.float64(own), h)
        ends = np.array([i, i + 1]) * h
        pilot = 4e6 - 1e6 * np.exp(-ends / tau)
        # The integral of what falls off, over the tick.
        mean = 4e6 + 1e6 * np.diff(np.exp(-ends / tau))[0] * tau / h
        assert float(memory[0][1]) == pytest.approx(pilot[1], rel=1e-12)
        share = (own + 3.0 * mean - 1.2e7) / 1e7
        assert float(effect.loss(memory)[1]) == pytest.approx(share**-2, rel=1e-9)


CYLINDER = {"area_1": 5.3e-3, "area_2": 7.9e-3, "chamber_length": 0.63}
VALVE = {
    "k_2": 8.1e11, "P_set": 1.2e7, "ratio": 2.8, "dP_full": 1.8e7, "tau": 0.09,
    "V_line": 8e-4,
}  # fmt: skip
EDGE, BETA, MARGIN = 1.5e-6, 1e9, 4e6
WAVES = ((0.3, 0.09, 0.8), (0.1, 0.03, 2.3))
"""Command, speed (m/s) and Hz of each wave: the piston goes roughly with the oil."""


def command(t):
    return sum(u * np.sin(2 * np.pi * f * t) for u, _, f in WAVES)


def place(t):
    return sum(
        v / (2 * np.pi * f) * (np.cos(2 * np.pi * f * t) - 1) for _, v, f in WAVES
    )


def speed(t):
    return -sum(v * np.sin(2 * np.pi * f * t) for _, v, f in WAVES)


def boom(t, state, u, s, check, laminar):
    """Rates of P_a1, P_a2, the pressure at chamber 2's edges and the late pilot."""
    P_1, P_2, edge, pilot = state

    def flow(drop):
        return EDGE * drop / (drop * drop + 4e6) ** 0.25

    def drawn(drop):
        if drop < 0:
            return flow((1 - min(s, 1.0)) * drop)
        return flow(drop * min(MARGIN / max(drop, 1.0), 1.0) ** s)

    up, down = max(u, 0.0), max(-u, 0.0)
    q_1 = up * drawn(P_S - P_1) - down * flow(P_1 - P_R)
    q_edge = down * drawn(P_S - edge) - up * flow(edge - P_R)
    share = np.clip((P_2 + 2.8 * pilot - 1.2e7) / 1e7, 1e-3, 1.8)

    def through(drop, k, Q_0=1e-6):
        """By `drop = k Q sqrt(Q^2 + Q_0^2)`."""
        ratio = drop / k
        return ratio / np.sqrt(0.5 * Q_0**2 + np.sqrt(0.25 * Q_0**4 + ratio**2))

    # Out through the valve; in through its check valve.
    out = through(P_2 - edge, VALVE["k_2"] / share**2)
    if edge > P_2:
        free = 1e-6 * (P_2 - edge)
        out = through(P_2 - edge, check * VALVE["k_2"], laminar) if check else free
    half, x, v = CYLINDER["chamber_length"] / 2, place(t), speed(t)
    V_1 = CYLINDER["area_1"] * (half - x)
    V_2 = CYLINDER["area_2"] * (half + x) - VALVE["V_line"]
    return [
        BETA / V_1 * (q_1 + CYLINDER["area_1"] * v),
        BETA / V_2 * (-out - CYLINDER["area_2"] * v),
        BETA / VALVE["V_line"] * (q_edge + out),
        (P_1 - pilot) / VALVE["tau"],
    ]


@pytest.mark.parametrize(
    ("h", "off", "s", "check", "laminar"),
    [
        (1e-2, 0.003, 0.0, 0.0, 1e-6),
        (2e-3, 6e-4, 0.0, 0.0, 1e-6),
        (1e-2, 0.005, 1.3, 0.0, 1e-6),
        (2e-3, 6e-4, 1.3, 0.0, 1e-6),
        (1e-2, 0.003, 0.0, 0.4, 1e-6),
        (2e-3, 6e-4, 0.0, 3.0, 1e-6),
        (1e-2, 0.003, 0.0, 0.4, 1e-3),
        (2e-3, 6e-4, 0.0, 3.0, 5e-4),
    ],
)
def test_a_line_behind_a_counterbalance_valve_keeps_its_pressure(
    h, off, s, check, laminar
):
    """Lowered and lifted, against a stiff solver: RMS in shares of the range, and at
    the edges too; also where a compensator takes more than the whole drop.
    """
    rig = add(
        bare_rig(LAYOUTS["differential"], CYLINDER),
        [
            EFFECTS["pressure_compensation"](s=s, dP_0=MARGIN),
            EFFECTS["counterbalance"](**VALVE, check_loss=check, check_flow=laminar),
        ],
    )
    rig = put(rig, ["c_p1", "c_n1", "c_p2", "c_n2", "beta"], [EDGE] * 4 + [BETA])
    start = (2e6, 6e6)

    def one(carry, tick):
        u, x = tick
        P, line = pressure_step(
            rig, carry[0], (u,), STILL._replace(h=jnp.asarray(h), x=x), carry[1]
        )
        return (P, line), jnp.stack([*P, P[1] - line.drop[1]])

    t = h * np.arange(round(1.5 / h))
    fine = t[:, None] + h * np.linspace(0, 1, 9)
    P = tuple(jnp.asarray(p) for p in start)
    ticks = (jnp.asarray(command(t)), jnp.asarray(place(fine)))
    got = np.asarray(jax.lax.scan(one, (P, rig.line_init(*P)), ticks)[1])

    want = [np.array([*start, start[1], start[0]])]
    for now in t:
        part = solve_ivp(
            boom, (now, now + h), want[-1], "LSODA", rtol=1e-8,
            atol=[1.0, 1.0, 1.0, 1.0], args=(command(now), s, check, laminar),
        )  # fmt: skip
        want.append(part.y[:, -1])
    want = np.array(want)[1:, :3]
    parts = want[:, 1] - want[:, 2]
    assert np.max(parts) > 2e6  # the line does part
    assert np.min(parts) <= -1e5 * check
    error = np.sqrt(np.mean((got - want) ** 2, axis=0)) / np.ptp(want, axis=0)
    assert np.all(error < off)


def test_what_a_line_loses_is_the_answer_of_a_solver():
    """Into the chamber, through laminar to turbulent; also its slope by the valve's
    size where there is none yet, without which no search would find it.
    """
    rng = np.random.default_rng(0)
    for _ in range(200):
        r, q = 10 ** rng.uniform(9, 16), 10 ** rng.uniform(-6, -1.5)
        b, goal = 10 ** rng.uniform(6, 13), 10 ** rng.uniform(2, 7.3)

        def drop(Q, r=r, q=q):
            return r * Q * np.hypot(Q, q)

        def left(Q, b=b, goal=goal, drop=drop):
            return drop(Q) + b * Q - goal

        Q = brentq(left, 0.0, goal / b, xtol=1e-300, rtol=1e-14)
        got = _lost(Losses(*map(jnp.asarray, (0.0, r, q))), b, jnp.asarray(-goal))
        assert -float(got) == pytest.approx(drop(Q), rel=1e-6)

    def by_size(r):
        return _lost(Losses(r, r, jnp.asarray(1e-4)), 1e9, jnp.asarray(-1e5))

    slope = jax.grad(by_size)(jnp.asarray(0.0))
    assert float(slope) == pytest.approx(-1e-4 * np.hypot(1e-4, 1e-4), rel=1e-6)


def test_a_flow_that_rises_with_pressure_leaves_a_line_an_answer():
    """By a compensator of more than the drop, into a line that holds next to nothing,
    where the valve is a candidate that does nothing yet.
    """
    valve = VALVE | {"V_line": 1e-5, "k_2": 0.0}
    rig = add(
        bare_rig(LAYOUTS["differential"], CYLINDER),
        [
            EFFECTS["pressure_compensation"](s=1.3, dP_0=2e5),
            EFFECTS["counterbalance"](**valve),
        ],
    )
    rig = put(rig, ["c_p1", "c_n1", "c_p2", "c_n2", "beta"], [EDGE] * 4 + [BETA])
    for P_2 in (6e6, 1.7e7, 1.79e7):
        P = (jnp.asarray(2e6), jnp.asarray(P_2))
        line = rig.line_init(*P)._replace(drop=(jnp.asarray(0.0), jnp.asarray(1e6)))
        at = point(*P, -1.0)._replace(line=line)
        moved = (jnp.asarray(1e5), jnp.asarray(1e6))
        drops = follow_drops(rig, at, line, jnp.asarray(0.01), moved).drop
        assert np.all(np.isfinite(np.array(drops))) and min(drops) > -1e-6


@pytest.mark.parametrize(("omega", "zeta"), [(6.0, 0.8), (40.0, 0.5), (125.0, 0.95)])
def test_a_signal_filter_is_its_transfer_function(omega, zeta):
    """Of a signal that runs straight from tick to tick, at 100 Hz."""
    h, rng = 1e-2, np.random.default_rng(3)
    y = 5e6 + np.cumsum(rng.normal(0, 2e5, 150))
    y[:3] = y[0]
    t = h * np.arange(y.size)
    channel = EFFECTS["signal_filter"](tau=1 / omega, zeta=zeta)
    got, _ = channel.run(jnp.asarray(y)[None], jnp.zeros(1), jnp.full((1, 149), h))
    system = TransferFunction([omega**2], [1, 2 * zeta * omega, omega**2])
    want = lsim(system, y - y[0], t)[1] + y[0]
    assert np.max(np.abs(np.asarray(got)[0] - want)) < 1e-6 * np.ptp(y)


def test_a_signal_filter_begins_as_after_a_long_ramp():
    omega, zeta, slope, h = 20.0, 0.7, 3e6, 1e-2
    channel = EFFECTS["signal_filter"](tau=1 / omega, zeta=zeta)
    t = h * np.arange(60)
    y = 5e6 + slope * t + 4e5 * np.where(t > 0.2, t - 0.2, 0.0)
    ramp = jnp.full((1, 59), h)
    got, _ = channel.run(jnp.asarray(y)[None], jnp.full(1, slope), ramp)

    def rates(s, z):
        now = np.interp(s, t, y)
        return z[1], omega**2 * (now - z[0]) - 2 * zeta * omega * z[1]

    begun = (y[0] - 2 * zeta / omega * slope, slope)
    out = solve_ivp(rates, (0, t[-1]), begun, t_eval=t, rtol=1e-10, max_step=h)
    assert np.allclose(np.asarray(got)[0], out.y[0], rtol=0, atol=5.0)


def logged_pressures(omega, zeta, noise):
    """A supply that follows its load, and its filtered reading, at 100 Hz."""
    h, rng = 1e-2, np.random.default_rng(5)
    t = h * np.arange(3000)
    load = np.repeat(rng.uniform(3e6, 12e6, 60), 50)
    pump = TransferFunction([1], [0.05**2, 0.1, 1])
    true = lsim(pump, load - load[0], t)[1] + load[0]
    logger = TransferFunction([omega**2], [1, 2 * zeta * omega, omega**2])
    read = lsim(logger, true - true[0], t)[1] + true[0]
    return t, true, read + noise * rng.normal(size=t.size)


@pytest.mark.parametrize(("omega", "zeta"), [(15.0, 0.9), (40.0, 0.7), (100.0, 0.6)])
def test_what_a_signal_filter_took_is_had_back(omega, zeta):
    """From a log with noise: all but a tenth of what lies between reading and truth."""
    t, true, read = logged_pressures(omega, zeta, noise=5e3)
    slope, bend = derivatives(t, read).T
    got = EFFECTS["signal_filter"](tau=1 / omega, zeta=zeta).ahead(read, slope, bend)

    def rms(y):
        return np.sqrt(np.mean((y - true)[100:-100] ** 2))

    assert rms(np.asarray(got)) < 0.1 * rms(read)


@pytest.mark.parametrize(("omega", "zeta"), [(15.0, 0.9), (40.0, 0.7), (100.0, 0.6)])
def test_a_signal_filter_goes_on_from_its_reading(omega, zeta):
    """Begun at any tick of a filtered signal it reads what the log does."""
    t, true, read = logged_pressures(omega, zeta, noise=0.0)
    slope = derivatives(t, read)[:, 0]
    channel = EFFECTS["signal_filter"](tau=1 / omega, zeta=zeta)
    first = np.arange(200, 2900, 31)
    at = first[:, None] + np.arange(30)
    h = jnp.full((len(first), 29), 1e-2)
    known = (jnp.asarray(read[first]), jnp.asarray(slope[first]))
    y, line = jnp.asarray(true[at]), jnp.asarray(np.diff(true[at][:, :2])[:, 0] / 1e-2)

    def rms(got):
        return np.sqrt(np.mean((np.asarray(got) - read[at]) ** 2))

    assert rms(channel.run(y, line, h, known)[0]) < 0.1 * rms(
        channel.run(y, line, h)[0]
    )


def test_windows_begin_ahead_of_what_filtered_them():
    """At the true pressures, off which the log is several bar, within a tenth."""
    t, true, read = logged_pressures(25.0, 0.8, noise=5e3)
    both = derivatives(t, read)
    at = np.arange(200, 2900, 31)[:, None] + np.arange(30)
    y, dy = jnp.asarray(read[at]), jnp.asarray(both[at])
    empty = Windows(*[None] * len(Windows._fields))
    w = empty._replace(
        P_a1=y,
        P_a2=2 * y,
        P_s=y,
        dP=jnp.stack([dy, 2 * dy, dy], 2),
        filtered=jnp.ones(len(y)),
    )
    rig = SimpleNamespace(sensor_P=(EFFECTS["signal_filter"](tau=1 / 25, zeta=0.8),))
    shown = jnp.stack([y[:, 0], 2 * y[:, 0]], axis=1)

    got = np.asarray(at_start(rig, w, shown + 1e5)) - 1e5
    wanted = np.stack([true[at[:, 0]], 2 * true[at[:, 0]]], axis=1)
    off = np.sqrt(np.mean((np.asarray(shown) - wanted) ** 2, axis=0))
    assert off[0] > 5e5
    assert np.all(np.sqrt(np.mean((got - wanted) ** 2, axis=0)) < 0.1 * off)

    none = SimpleNamespace(sensor_P=())
    assert np.array_equal(np.asarray(at_start(none, w, shown)), np.asarray(shown))
