"""Effects of working machines' valves and loggers, against closed forms and scipy."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import TransferFunction, lsim

from hydrojax.effects import EFFECTS as KNOWN
from hydrojax.plant.chambers import Point
from hydrojax.plant.effect import InLine
from hydrojax.plant.layout import LAYOUTS
from hydrojax.plant.rig import add, bare_rig

EFFECTS: dict[str, Any] = KNOWN
"""Each class with the method of its own place."""

GEOMETRY = {"area_1": 4.3e-3, "area_2": 6.4e-3, "chamber_length": 0.6}
P_S, P_R, C = 18e6, 0.2e6, 2.2e-9


def point(P_1, P_2, u):
    at = map(np.float64, (P_1, P_2, P_S, P_R))
    return Point(*at, (np.float64(u),), np.float64(0.0), np.float64(0.0))


def flows(effect, at):
    """Flows into both chambers, at rest."""
    rig = add(bare_rig(LAYOUTS["differential"], GEOMETRY), [effect])
    lines = [InLine(e, e.init(at.P_a1, at.P_a2)) for e in rig.line]
    return np.array(rig.valve.flows(at, rig.supply, (*rig.orifice, *lines)))


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


def test_a_counterbalance_valve_opens_by_its_pilot():
    """In series with the edge; shut below its setting but for a leak; by thirds of its
    way; open; the other way free.
    """
    own = 2 * C
    effect = EFFECTS["counterbalance"](
        k_2=1 / own**2, P_set=1.2e7, ratio=3.0, dP_full=9e6
    )
    for pilot, share in ((1e6, 0.01), (3e6, 1 / 3), (4e6, 2 / 3), (8e6, 1.0)):
        q = flows(effect, point(pilot, 6e6, 0.5))
        lost = 1 / (C * 0.5) ** 2 + 1 / (own * share) ** 2
        want = -np.sqrt((6e6 - P_R) / lost)
        assert q[1] == pytest.approx(want, rel=1e-5)
        assert q[0] == pytest.approx(C * 0.5 * np.sqrt(P_S - pilot), rel=1e-5)
    lifted = flows(effect, point(1e6, 6e6, -0.5))
    assert lifted[1] == pytest.approx(C * 0.5 * np.sqrt(P_S - 6e6), rel=1e-5)
    assert lifted[0] == pytest.approx(-C * 0.5 * np.sqrt(1e6 - P_R), rel=1e-5)


def test_a_counterbalance_valve_comes_late():
    """Its poppet after a step of the pilot, and its mean over each tick, in closed
    form.
    """
    tau, h = 0.08, 0.01
    effect = EFFECTS["counterbalance"](
        k_2=1e16, P_set=1.2e7, ratio=3.0, dP_full=9e6, tau=tau
    )
    memory = effect.init(np.float64(3e6), np.float64(6e6))
    first, last = 1 / 3, 2 / 3
    for i in range(20):
        memory = effect.step(memory, np.float64(4e6), np.float64(6e6), h)
        ends = np.array([i, i + 1]) * h
        share = last + (first - last) * np.exp(-ends / tau)
        # The integral of what falls off, over the tick.
        mean = last + (first - last) * -np.diff(np.exp(-ends / tau))[0] * tau / h
        assert float(memory[0][1]) == pytest.approx(share[1], rel=1e-12)
        assert float(memory[1][1]) == pytest.approx(mean, rel=1e-12)


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
