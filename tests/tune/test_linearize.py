"""The linearised loop against scipy, closed forms and its own simulation.

The truth of a response is a NumPy model of the sampled loop built here: hold, delay
and spool as an exact matrix exponential, the law by hand; the truth of a signal's
spectrum is `scipy.signal`.
"""

from __future__ import annotations

from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import linalg, signal

from hydrojax.paper.records import reference
from hydrojax.programs.compiled import program
from hydrojax.rigfile.quantities import open_setting, quantities
from hydrojax.tune import linearize, measure, metrics, operating_point

SPEC, _ = reference()
OMEGA, ZETA = 1257.0, 0.7
HERTZ = metrics.grid(1000.0)


@pytest.fixture(scope="module")
def setting():
    return open_setting(SPEC)


@pytest.fixture(scope="module")
def known(setting):
    return quantities(SPEC, setting)


@pytest.fixture(scope="module")
def system():
    return program(lambda s: linearize.system(s, operating_point.initial_state(s)))


@pytest.fixture(scope="module")
def states(setting, system):
    return linearize.find_states(jax.tree.map(lambda a: a[None], system(setting)))


@pytest.fixture(scope="module")
def response(states):
    hertz = jnp.asarray(HERTZ)

    def one(s):
        small = linearize.system(s, operating_point.initial_state(s), states)
        return linearize.frequency_response(small, hertz), linearize.radius(small)

    return program(one)


def change(setting, known, **values):
    for name, value in values.items():
        setting = known[name.replace("__", ".")].put(setting, value)
    return setting


def without_friction(setting, known):
    return change(
        setting, known, k_fp=0.0, k_fn=0.0, k_fp_lower=0.0, k_fn_lower=0.0
    )  # fmt: skip


def plain_loop(k_p, k_f, friction, delay=1e-3, h=1e-3):
    """The reference rig's loop at rest, in NumPy: A and B of its sampled step, F's row.

    States: drive force P, spool and its rate, the command before. Both chambers as
    one: at the first order only P moves. `friction` is presliding's slope.
    """
    beta, half = 8.5e8, 0.1
    x_1, x_2 = half + 12e-3, half + 18e-3
    c_p1, c_n1, c_p2, c_n2 = 2.24e-9, 2.15e-9, 2.27e-9, 2.11e-9
    P_s, P_r, P_0 = 14e6, 0.25e6, (14e6 + 0.25e6) / 2
    into, out = np.sqrt(P_s - P_0), np.sqrt(P_0 - P_r)
    gains = (
        c_p1 * into / x_1 + c_n2 * out / x_2,
        c_n1 * out / x_1 + c_p2 * into / x_2,
    )
    # A volt of command, after the law's inverse of its own side, is -1 of virtual.
    ways = []
    for g in gains:
        per_volt = beta * g  # N/s per V, downward
        A_c = np.array([
            [0, -per_volt, 0, 0],
            [0, 0, 1, 0],
            [0, -(OMEGA**2), -2 * ZETA * OMEGA, OMEGA**2],
            [0, 0, 0, 0],
        ])  # fmt: skip
        ways.append((linalg.expm(A_c * h), 1 / g))
    k_1, slope = 1 / beta, 1 / (1 + friction)

    def one(E, per_virtual):
        # P_d = (1 + f) F_d with a matched estimate; F = P / (1 + f).
        A, B = np.zeros((5, 5)), np.zeros(5)  # P, spool, rate, old command, old P_d
        A[:3, :3] = E[:3, :3]
        A[:3, 3] = E[:3, 3]
        virtual_F_d = k_1 * (1 + friction) / h + k_p * (1 + friction) + k_f
        A[3, 0] = per_virtual * (k_p + k_f * slope)
        A[3, 4] = per_virtual * k_1 / h
        B[3] = -per_virtual * virtual_F_d
        B[4] = 1 + friction
        return A, B

    assert delay == h
    both = [one(*w) for w in ways]
    A, B = (sum(m[i] for m in both) / 2 for i in (0, 1))
    return A, B, np.array([slope, 0, 0, 0, 0])


@pytest.mark.parametrize("free", [False, True], ids=["presliding", "no friction"])
def test_the_response_is_a_numpy_model_s(setting, known, response, free):
    kappa = 1.18e-4 * 1e-3
    s = without_friction(setting, known) if free else setting
    H, radius = response(s)
    values = []
    for f in (0.0, 0.0) if free else (0.7, 0.65):  # on either side of F = 0
        A, B, C = plain_loop(1.2 * kappa, 2.4 * kappa, f)
        z = np.exp(2j * np.pi * HERTZ * 1e-3)
        values.append([C @ np.linalg.solve(w * np.eye(5) - A, B) for w in z])
    want = np.mean(values, axis=0)
    low = HERTZ < 200  # the step's own parts average the spool: of second order
    off = np.abs(np.asarray(H)[:, 0, 0] / want - 1)
    assert off[low].max() < 0.02
    A, _, _ = plain_loop(1.2 * kappa, 2.4 * kappa, 0.0 if free else 0.675)
    assert float(radius) == pytest.approx(np.abs(np.linalg.eigvals(A)).max(), rel=5e-3)


def test_few_states_are_all_of_them(setting, system, states, response):
    """What is left out, and what is merged, changes nothing."""
    full = linearize.frequency_response(system(setting), jnp.asarray(HERTZ))
    assert len(set(states.group)) < 10
    np.testing.assert_allclose(full, response(setting)[0], atol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("F_0", [0.0, 300.0])
def test_small_measured_is_linearised_within_2_percent(setting, known, response, F_0):
    s = change(
        setting, known, F_0=F_0, amplitude=2.0, noise__F=0.0, noise__P_a1=0.0,
        noise__P_a2=0.0,
    )  # fmt: skip
    given = measure.multisine(1000.0, period=1.0, lines=24)
    got = measure.measure(s, given, frozen=True)
    H: Any = np.asarray(response(s)[0])[:, 0, 0]
    at = np.interp(given.hertz, HERTZ, H.real) + 1j * np.interp(
        given.hertz, HERTZ, H.imag
    )
    assert np.max(np.abs(np.asarray(got["response"]) / at - 1)) < 0.02
    assert float(got["saturation"]) == float(got["violations"]) == 0


@pytest.mark.parametrize(("delay", "low", "high"), [(0.5e-3, 20, 23), (1e-3, 18, 20.5)])
def test_linear_checks_without_friction(setting, known, response, delay, low, high):
    """About the 22.8 and 20.3 Hz of a continuous loop with 1.0 and 1.5 ms of delay.

    Half a period of it is the hold's; a tenth below, since the sampled law feeds the
    rate of P_d forward as a difference. With presliding it is 16.3 Hz at 1 ms.
    """
    s = change(without_friction(setting, known), known, valve_delay__tau_u=delay)
    H, _ = response(s)
    band = float(metrics.band_within(jnp.asarray(HERTZ), H[:, 0, 0]))
    assert low < band < high


def test_the_edge_without_friction_is_near_600_rad_per_s(setting, known, states):
    """At 1 ms of computing and half a period of hold, 1.5 ms in all."""

    def one(total):
        s = change(without_friction(setting, known), known, k_p=total / 3)
        s = change(s, known, k_f=2 * total / 3)
        return linearize.radius(
            linearize.system(s, operating_point.initial_state(s), states)
        )

    totals = np.arange(4.0, 9.0, 0.1)
    radii = np.asarray(program(jax.vmap(one))(jnp.asarray(totals)))
    edge = totals[np.argmax(radii >= 1)] / 0.01
    assert 570 < edge < 650


def test_margins_are_scipy_s():
    """A sampled loop whose margins are found by root finding on scipy's response."""
    h = 1e-3
    b, a, _ = cast(Any, signal.cont2discrete)(([200.0 * 600], [1.0, 600.0, 0.0]), h)
    b = np.concatenate([[0.0, 0.0], np.atleast_1d(np.squeeze(b))])  # two late

    def L(f):
        z = np.exp(2j * np.pi * np.atleast_1d(f) * h)
        return np.polyval(b, z) / np.polyval(a, z) / z**2

    b = b[2:]
    hertz = np.geomspace(0.5, 499, 2000)
    gain, phase, delay = metrics.margins(jnp.asarray(hertz), jnp.asarray(L(hertz)))
    fine = np.geomspace(0.5, 499, 400_000)
    value = L(fine)
    cross = np.flatnonzero(np.diff(np.sign(np.abs(value) - 1)))[0]
    lead = np.pi + np.unwrap(np.angle(value))[cross]
    turn = np.flatnonzero(np.diff(np.sign(value.imag)) * (value.real[1:] < 0))[0]
    assert float(gain) == pytest.approx(-20 * np.log10(abs(value[turn])), abs=0.05)
    assert float(phase) == pytest.approx(np.rad2deg(lead), abs=0.2)
    assert float(delay) == pytest.approx(lead / 2 / np.pi / fine[cross], rel=0.01)


def test_bandwidths_of_a_butterworth_low_pass_by_closed_form():
    """Second order: |H|^2 is 1 / (1 + (f/40)^4), and the phase is -90 deg at 40 Hz."""
    hertz = metrics.grid(1000.0, 2000)
    H = np.zeros((hertz.size, 2, 5), complex)
    b, a = cast(Any, signal.butter)(2, 40.0, analog=True)
    H[:, 0, 0] = signal.freqs(b, a, hertz)[1]
    H[:, 1, 1] = 0.5
    found = metrics.loop_metrics(jnp.asarray(hertz), jnp.asarray(H), jnp.asarray(0.5))
    for name, fall in (("within_1dB", 1.0), ("minus_3dB", 3.0)):
        want = 40 * (10 ** (fall / 10) - 1) ** 0.25
        assert float(found[name]) == pytest.approx(want, rel=1e-4), name
    assert float(found["lag_90"]) == pytest.approx(40.0, rel=1e-4)


@pytest.mark.parametrize(
    ("leads", "phase", "delay"),
    [
        ((20, 70, 100), 20, 20 / 360 / 10),
        ((100, 40, 70), 40, 40 / 360 / 20),  # where the gain rises through 1
        ((70, 100, 30), 30, 30 / 360 / 30),
        ((30, 100, 45), 30, 45 / 360 / 30),  # least delay at another crossing
        ((70, 100, -15), 15, 100 / 360 / 20),  # behind -180 degrees: nearest to it
    ],
)
def test_margins_are_the_least_of_all_gain_crossings(leads, phase, delay):
    """The gain falls through 1 at 10 Hz, rises at 20 Hz and falls again at 30 Hz.

    `leads` is by how many degrees the phase is above -180 at each.
    """
    hertz = np.array([9.0, 11.0, 19.0, 21.0, 29.0, 31.0])
    size = 10 ** (np.array([6.0, -6.0, -6.0, 6.0, 6.0, -6.0]) / 20)
    L = size * np.exp(1j * np.deg2rad(np.repeat(leads, 2) - 180.0))
    _, got, late = metrics.margins(jnp.asarray(hertz), jnp.asarray(L))
    assert float(got) == pytest.approx(phase)
    assert float(late) == pytest.approx(delay)


def test_noise_s_response_and_coherence_are_scipy_s():
    rng = np.random.default_rng(3)
    given = measure.white_noise(1000.0, seconds=9.0, lines=500)
    x = np.asarray(given.shape)
    y = signal.lfilter([0.3], [1, -0.7], x) + 0.2 * rng.normal(size=x.size)
    H, coherence = measure.estimate_response(given, jnp.asarray(x), jnp.asarray(y))
    cut = {"fs": 1000.0, "nperseg": 1000}
    late = slice(given.skip, None)
    hertz, cross = signal.csd(x[late], y[late], **cut)
    want = cross / signal.welch(x[late], **cut)[1]
    seen = signal.coherence(x[late], y[late], **cut)[1]
    i = np.round(given.hertz).astype(int)
    np.testing.assert_allclose(H, want[i], rtol=1e-9)
    np.testing.assert_allclose(coherence, seen[i], rtol=1e-9)


@pytest.mark.slow
def test_slope_of_the_bandwidth_is_its_difference(setting, known, states):
    hertz = jnp.asarray(HERTZ)

    def band(gains):
        s = change(setting, known, k_p=gains[0], k_f=gains[1], k_1=gains[2])
        small = linearize.system(s, operating_point.initial_state(s), states)
        return metrics.band_within(
            hertz, linearize.frequency_response(small, hertz)[:, 0, 0]
        )

    value, slope = program(band), program(jax.jacfwd(band))
    here = np.array([1.2, 2.4, 0.008])
    exact = np.asarray(slope(jnp.asarray(here)))
    for i in range(3):
        step = np.zeros(3)
        step[i] = 1e-5 * here[i]
        rise = value(jnp.asarray(here + step)) - value(jnp.asarray(here - step))
        assert float(rise) / (2 * step[i]) == pytest.approx(exact[i], rel=1e-5)


@pytest.mark.slow
def test_a_free_mass_loses_the_band_near_18_hz():
    from dataclasses import replace

    spec = replace(SPEC, output_load={"mass": 150.0, "stiffness": 2e6, "damping": 2e3})
    s = open_setting(spec)
    found = program(lambda s: linearize.system(s, operating_point.initial_state(s)))(s)
    H = np.abs(
        np.asarray(linearize.frequency_response(found, jnp.asarray(HERTZ)))[:, 0, 0]
    )
    band = (HERTZ > 8) & (HERTZ < 40)
    i = np.argmin(np.where(band, H, np.inf))
    # The load's own: sqrt(k / m), where its force is least.
    assert HERTZ[i] == pytest.approx(np.sqrt(2e6 / 150) / 2 / np.pi, rel=0.05)
    assert 20 * np.log10(H[i]) < -5
