"""Channels against closed forms, scipy and plain loops."""

from functools import partial
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal
from scipy.integrate import solve_ivp

from hydrojax.effects import CommandChannel, SensorChannel
from hydrojax.effects.sensors import (
    REACH,
    ChannelSkew,
    LoadcellGain,
    LoadcellLag,
    PressureSensorBias,
    PressureSensorLag,
)
from hydrojax.effects.valve import (
    QUEUE,
    ValveBias,
    ValveDeadband,
    ValveDelay,
    ValveHysteresis,
    ValveLag,
    ValveRateLimit,
)
from hydrojax.plant.layout import LAYOUTS
from hydrojax.plant.rig import add, bare_rig
from tests.conftest import GEOMETRY

H = 1e-3
COMMAND = (
    ValveDelay, ValveBias, ValveHysteresis, ValveRateLimit, ValveLag, ValveDeadband,
)  # fmt: skip
SENSOR = (
    LoadcellLag, LoadcellGain, ChannelSkew, PressureSensorLag,
    PressureSensorBias().of_chamber(1),
)  # fmt: skip


def held(n=200, seed=0):
    """A command held over each tick, rough and of both signs."""
    return np.cumsum(np.random.default_rng(seed).normal(0, 0.3, n))


def run(channel: CommandChannel, u, h=H):
    """The mean of the output over each tick, and the memory after each."""

    def step(memory, value):
        memory, mean = channel.step(memory, value, h)
        return memory, (mean, memory)

    u = jnp.asarray(u)
    mean, memory = jax.lax.scan(step, channel.init(u[0]), u)[1]
    return np.asarray(mean), memory


def read(channel: SensorChannel, y, slope, h=H):
    """What the sensor reads at each tick but the first."""
    y = jnp.asarray(y)
    start, *_ = channel.init(y[0], jnp.asarray(slope))
    out = jax.lax.scan(lambda m, value: channel.step(m, value, h), start, y[1:])[1]
    return np.asarray(out)


# -- absent --


@pytest.mark.parametrize("kind", COMMAND)
def test_command_channel_at_zero_is_the_identity(kind):
    u = held()
    assert np.allclose(run(kind(), u)[0], u, rtol=1e-12, atol=0)


@pytest.mark.parametrize("kind", SENSOR)
def test_sensor_channel_at_zero_is_the_identity(kind):
    channel = kind() if isinstance(kind, type) else kind
    y = 5e6 + 1e5 * held()
    got = read(channel, y, (y[1] - y[0]) / H)
    assert np.allclose(got, y[1:], rtol=1e-12, atol=0)


# -- delay --


def delayed_means(u, tau, h):
    """Means over each tick of the held command, `tau` late: exact, by its integral."""
    edges = h * np.arange(-100, len(u) + 1)
    filled = np.r_[np.full(100, u[0]), u]
    integral = np.r_[0.0, np.cumsum(filled * h)]
    late = np.interp(h * np.arange(len(u) + 1) - tau, edges, integral)
    return np.diff(late) / h


@pytest.mark.parametrize("h", [H, H / 4, 1.7e-3])
@pytest.mark.parametrize("share", [0.0, 1e-6, 0.3, 0.999, 1.0, 1.5, 4.25, 10.9])
def test_delay_of_any_time_is_the_exact_mean(share, h):
    u = held()
    got = run(ValveDelay(tau_u=share * h), u, h)[0]
    assert np.allclose(got, delayed_means(u, share * h, h), rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("tau_u", [0.0, 1e-6, 0.0004, 0.0013, 0.0075, 0.013])
def test_a_delay_is_the_exact_mean_over_each_part_of_a_tick(tau_u):
    u = held()
    late = ValveDelay(tau_u=tau_u)

    def tick(memory, value):
        memory, means = late.parts(memory, [value] * 4, H / 4)
        return memory, jnp.stack(means)

    got = jax.lax.scan(tick, late.init(jnp.asarray(u[0])), jnp.asarray(u))[1]
    wanted = delayed_means(np.repeat(u, 4), tau_u, H / 4)
    assert np.allclose(np.ravel(got), wanted, rtol=1e-9, atol=1e-10)


def test_delay_past_its_queue_reads_the_oldest_command():
    u = np.sign(held(seed=3))
    got = run(ValveDelay(tau_u=0.011), u, H / 4)[0]
    assert QUEUE < 0.011 / (H / 4)
    assert np.allclose(got[QUEUE:], u[1 : 1 - QUEUE], rtol=0, atol=1e-12)


# -- slew --


def slewed(u, r_v, h, fine=4000):
    """Means over each tick, and ends, of a spool that runs after the held command."""
    y, means, ends = u[0], [], []
    for value in u:
        s = h * np.arange(fine + 1) / fine
        way = np.minimum(r_v * s, abs(value - y))
        scenario = y + np.sign(value - y) * way
        means.append(np.trapezoid(scenario, s) / h)
        y = scenario[-1]
        ends.append(y)
    return np.array(means), np.array(ends)


@pytest.mark.parametrize("r_v", [20.0, 300.0, 1e3, 1e5])
def test_slew_is_the_exact_mean_of_the_ramp(r_v):
    u = held(60)
    got, place = run(ValveRateLimit(slew=1 / r_v), u)
    means, ends = slewed(u, r_v, H)
    assert np.allclose(got, means, rtol=0, atol=1e-6)
    assert np.allclose(place, ends, rtol=0, atol=1e-12)


def test_slew_does_not_depend_on_how_ticks_are_cut():
    u, channel = held(60), ValveRateLimit(slew=1 / 300.0)
    whole = run(channel, u)[0]
    parts = run(channel, np.repeat(u, 4), H / 4)[0].reshape(-1, 4).mean(1)
    assert np.allclose(whole, parts, rtol=1e-10, atol=1e-12)


# -- lag --


def lag_truth(u, omega, zeta, h, fine=400):
    """Second-order lag of the held command: place at tick ends, means by Simpson."""
    system = signal.StateSpace(
        [[0, 1], [-(omega**2), -2 * zeta * omega]], [[0], [omega**2]], [[1, 0]], 0
    )
    A, B, *_ = signal.cont2discrete((system.A, system.B, system.C, system.D), h / fine)
    weight = np.r_[1, np.tile([4, 2], fine // 2 - 1), 4, 1] / (3 * fine)
    state, means, ends = np.array([u[0], 0.0]), [], []
    for value in u:
        y = [state[0]]
        for _ in range(fine):
            state = A @ state + B[:, 0] * value
            y.append(state[0])
        means.append(weight @ y)
        ends.append(state[0])
    return np.array(means), np.array(ends)


# -- lag and slew --


def spool_truth(u, omega, zeta, r_v, h, ahead, fine=2000):
    """Means over each tick of a spool with inertia whose speed cannot pass `r_v`, or
    behind a command whose rate cannot (`ahead`).
    """
    y, v, step, means, ramp = u[0], 0.0, h / fine, [], u[0]
    for value in u:
        whole = 0.0
        for _ in range(fine):
            ramp += min(max(value - ramp, -r_v * step), r_v * step)
            goal = ramp if ahead else value
            v += step * omega * (omega * (goal - y) - 2 * zeta * v)
            v = v if ahead else min(max(v, -r_v), r_v)
            whole += y + step * v / 2
            y += step * v
        means.append(whole / fine)
    return np.array(means)


def rigged(channels, u, h):
    """Means over each tick at the end of a rig's command path."""
    rig = add(bare_rig(LAYOUTS["pull-pull"], GEOMETRY), channels)
    u = jnp.asarray(u)

    def tick(memory, value):
        memory, means = rig.command_parts(memory, value, h)
        return memory, jnp.mean(jnp.stack([spool for (spool,) in means]))

    return jax.lax.scan(tick, rig.command_init(u[0]), u)[1]


@pytest.mark.parametrize("r_v", [1.6, 5.0, 60.0])
@pytest.mark.parametrize("s", [0.0, 1.0])
def test_a_limit_holds_while_the_spool_moves(r_v, s):
    """Steps of a slow spool at 100 Hz, from inside the limit to far beyond it."""
    u = np.repeat([0.0, 0.9, -0.4, -0.3, 0.0], 25)
    limit = ValveRateLimit(slew=1 / r_v, s=s)
    got = rigged([limit, ValveLag(tau=1 / 30.0, zeta=0.66)], u, 0.01)
    truth = spool_truth(u, 30.0, 0.66, r_v, 0.01, ahead=s == 0)
    assert np.allclose(got, truth, rtol=0, atol=2e-4 if s else 6e-3)
    other = spool_truth(u, 30.0, 0.66, r_v, 0.01, ahead=s == 1)
    assert r_v > 30 or np.max(np.abs(got - other)) > 0.05


def test_a_spool_at_its_limit_has_the_derivatives_that_differences_have():
    u = np.repeat([0.0, 0.9, -0.4, -0.3, 0.0], 25)
    weights = np.random.default_rng(0).normal(size=u.size)

    def of(p):
        limit = ValveRateLimit(slew=p[0], s=1.0)
        return weights @ rigged([limit, ValveLag(tau=p[1], zeta=p[2])], u, 0.01)

    at = jnp.array([1 / 3.0, 1 / 30.0, 0.66])
    got = jax.grad(of)(at)
    steps = 1e-6 * np.diag(at)
    want = [(of(at + d) - of(at - d)) / (2 * d.sum()) for d in steps]
    assert np.allclose(got, want, rtol=1e-4)


def test_a_limit_is_its_own_where_the_spool_has_no_inertia():
    u = held(60)
    for s in (0.0, 0.4, 1.0):
        limit = ValveRateLimit(slew=1 / 300.0, s=s)
        alone = rigged([limit], u, H)
        assert np.ptp(alone - u) > 0.1
        if s in (0.0, 1.0):
            both = rigged([limit, ValveLag()], u, H)
            assert np.allclose(both, alone, rtol=0, atol=1e-12)


def test_both_derivatives_live_where_both_are_absent():
    u, size = held(60), 1e-7

    def by(slew, tau, s):
        return rigged([ValveRateLimit(slew=slew, s=s), ValveLag(tau=tau)], u, H)

    one = jnp.ones(())
    for along, s in product(((one, 0 * one), (0 * one, one)), (0.0, 1.0)):
        ways = partial(by, s=s)
        slope = jax.jvp(ways, (0 * one, 0 * one), along)[1]
        steps = [size * float(a) for a in along]
        found = (ways(*steps) - ways(0.0, 0.0)) / size
        assert np.max(np.abs(found)) > 0.1
        assert np.allclose(slope, found, rtol=1e-3, atol=1e-3 * np.max(np.abs(found)))


@pytest.mark.parametrize("zeta", [0.2, 0.7, 0.99, 0.9999, 1.0, 1.0003, 1.02, 3.0])
@pytest.mark.parametrize("omega", [30.0, 400.0, 2 * np.pi * 200, 8000.0])
def test_lag_is_the_exact_mean_of_the_spool(omega, zeta):
    u = held(25)
    got, (place, _) = run(ValveLag(tau=1 / omega, zeta=zeta), u)
    means, ends = lag_truth(u, omega, zeta, H)
    assert np.allclose(got, means, rtol=0, atol=1e-7 * np.ptp(u))
    assert np.allclose(place, ends, rtol=0, atol=1e-10)


def test_lag_does_not_depend_on_how_ticks_are_cut():
    u = held(30)
    channel = ValveLag(tau=1e-3, zeta=0.6)
    whole = run(channel, u)[0]
    parts = run(channel, np.repeat(u, 4), H / 4)[0].reshape(-1, 4).mean(1)
    assert np.allclose(whole, parts, rtol=1e-10, atol=1e-12)


def test_lag_comes_in_without_a_jump():
    """From absent to a spool far faster than the tick: no step, no NaN."""
    u = held(30)
    for tau in (1e-12, 1e-9, 1e-7):
        change = run(ValveLag(tau=tau, zeta=0.7), u)[0] - u
        before = np.r_[u[0], u[:-1]]
        want = 2 * 0.7 * tau / H * (before - u)  # first order in tau
        assert np.allclose(change, want, rtol=1e-3, atol=1e-14)


@pytest.mark.parametrize("zeta", [0.9990, 0.99950, 1.0, 1.0005, 1.0010, 1.3])
@pytest.mark.parametrize("tau", [0.0, 1e-9, 1e-5, 1e-3, 0.05])
def test_lag_has_its_derivatives_around_critical_damping(tau, zeta):
    """A spool that starts above it is found, too; no kink and no NaN."""
    u = jnp.asarray(held(25))

    def means(tau, zeta):
        channel = ValveLag(tau=tau, zeta=zeta)
        return jax.lax.scan(lambda m, u: channel.step(m, u, H), channel.init(u[0]), u)[
            1
        ]

    by_tau, by_zeta = jax.jacfwd(means, (0, 1))(tau, zeta)
    step = 1e-6
    near = (means(tau, zeta + step) - means(tau, zeta - step)) / (2 * step)
    assert np.allclose(by_zeta, near, rtol=1e-5, atol=1e-7 * np.ptp(u))
    assert np.all(np.isfinite(by_tau)) and (tau < 1e-4 or np.max(np.abs(near)) > 1e-4)


# -- bias, play, deadband --


def test_bias_shifts_the_command():
    u = held()
    assert np.allclose(run(ValveBias(u_0=-0.07), u)[0], u - 0.07, rtol=1e-12)


@pytest.mark.parametrize("half", [0.01, 0.2, 1.0])
def test_play_moves_only_when_pushed(half):
    u = held()
    out, want = u[0], []
    for value in u:
        out = min(max(out, value - half), value + half)
        want.append(out)
    got = run(ValveHysteresis(u_h=half), u)[0]
    assert np.allclose(got, want, rtol=1e-13)
    assert np.any(np.diff(want) == 0) and np.any(np.diff(want) != 0)


@pytest.mark.parametrize(("up", "down"), [(0.1, 0.1), (0.3, 0.05), (0.0, 0.4)])
def test_deadband_takes_its_width_off_each_side(up, down):
    u = np.r_[held(), 0.0, up, -down, up / 2, -down / 2]
    got = run(ValveDeadband(u_dbp=up, u_dbn=down), u)[0]
    assert np.allclose(got, u - np.clip(u, -down, up), rtol=1e-12, atol=1e-15)


# -- sensors --

LAGS = ((LoadcellLag, "tau_F"), (PressureSensorLag, "tau_P"))


@pytest.mark.parametrize(("kind", "field"), LAGS)
@pytest.mark.parametrize("tau", [1e-5, 5e-4, 3e-3, 0.1])
def test_sensor_lag_of_a_ramp_is_its_steady_lag(kind, field, tau):
    t = H * np.arange(50)
    got = read(kind(**{field: tau}), 2.0 + 30 * t, 30.0)
    assert np.allclose(got, 2.0 + 30 * (t[1:] - tau), rtol=1e-11)


@pytest.mark.parametrize(("kind", "field"), LAGS)
@pytest.mark.parametrize("tau", [2e-4, 3e-3])
def test_sensor_lag_follows_its_equation(kind, field, tau):
    """From rest, of a sine that is taken as linear over each tick."""
    omega, t = 2 * np.pi * 35, H * np.arange(80)
    y = np.sin(omega * t)
    got = read(kind(**{field: tau}), y, 0.0)
    state, want = 0.0, []
    for i in range(len(t) - 1):
        out = solve_ivp(
            lambda s, m, i=i: (np.interp(s, t[i : i + 2], y[i : i + 2]) - m) / tau,
            (t[i], t[i + 1]),
            [state],
            rtol=1e-10,
            atol=1e-13,
        )
        state = out.y[0, -1]
        want.append(state)
    assert np.allclose(got, want, rtol=0, atol=1e-8)
    # The sine itself, after the start has died away.
    size, angle = 1 / np.hypot(1, omega * tau), np.arctan(omega * tau)
    steady = size * np.sin(omega * t[40:] - angle)
    assert np.allclose(got[39:], steady, rtol=0, atol=(omega * H) ** 2 / 8)


def test_gain_scales_the_reading():
    y = 1e3 * held()
    assert np.allclose(read(LoadcellGain(eps=0.03), y, 0.0), 1.03 * y[1:], rtol=1e-12)


def test_each_pressure_sensor_has_its_own_bias():
    y, both = 5e6 + 1e5 * held(), PressureSensorBias(b_1=2e4, b_2=-3e4)
    for i, b in enumerate((2e4, -3e4)):
        assert np.allclose(read(both.of_chamber(i), y, 0.0), y[1:] + b, rtol=1e-12)


@pytest.mark.parametrize("tau", [1e-3, 0.4e-3, -0.3e-3, -1e-3, -2.6e-3])
def test_skew_reads_along_the_line_between_ticks(tau):
    """Early: along the last tick's line. Late: between earlier ticks, exactly."""
    t = H * np.arange(60)
    rough = 1e3 * held(60)
    got = read(ChannelSkew(tau_s=tau), rough, 0.0)
    if tau > 0:
        want = rough[1:] + tau * np.diff(rough) / H
    else:
        want = np.interp(t[1:] + tau, t, rough)
    settled = slice(REACH, None)
    assert np.allclose(got[settled], want[settled], rtol=1e-9, atol=1e-9)
    line = read(ChannelSkew(tau_s=tau), 3.0 + 40 * t, 40.0)
    assert np.allclose(line[settled], 3.0 + 40 * (t[1:] + tau)[settled], rtol=1e-12)


def test_skew_past_its_queue_reads_its_oldest():
    y = held(60)
    got = read(ChannelSkew(tau_s=-3e-3), y, 0.0, H / 10)
    assert np.allclose(got[REACH:], y[2 : 2 + len(got) - REACH])


# -- a course that is known --


def scenario(channel, y, h=None):
    """Readings of a known course [n], from every tick."""
    y = jnp.asarray(y)[None]
    h = jnp.full((1, y.shape[1] - 1), H) if h is None else jnp.asarray(h)[None]
    slope = (y[:, 1] - y[:, 0]) / h[:, 0]
    return np.asarray(channel.run(y, slope, h)[0])[0]


@pytest.mark.parametrize("kind", SENSOR)
def test_a_known_course_is_absent_and_otherwise_the_steps(kind):
    channel = kind() if isinstance(kind, type) else kind
    y = 5e6 + 1e5 * held()
    assert np.allclose(scenario(channel, y), y, rtol=1e-12)


@pytest.mark.parametrize(
    "channel", [LoadcellLag(tau_F=2e-3), LoadcellGain(eps=0.1)], ids=["lag", "gain"]
)
def test_a_known_course_is_read_step_by_step(channel):
    y = held()
    assert np.allclose(scenario(channel, y)[1:], read(channel, y, (y[1] - y[0]) / H))


@pytest.mark.parametrize("tau", [3e-3, 1.2e-3, 0.4e-3, -0.3e-3, -1e-3, -3e-3])
@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_skew_of_a_known_course_reads_along_its_lines(tau, jitter):
    """Early as well as late, but for what a window's last ticks do not know."""
    h = H * (1 + jitter * np.random.default_rng(0).uniform(-1, 1, 99))
    t, rough = np.r_[0.0, np.cumsum(h)], 1e3 * held(100)
    got = scenario(ChannelSkew(tau_s=tau), rough, h)
    known = slice(5, -5)
    want = np.interp(t + tau, t, rough)
    assert np.allclose(got[known], want[known], rtol=1e-9, atol=1e-9)
    line = scenario(ChannelSkew(tau_s=tau), 3.0 + 40 * t, h)
    assert np.allclose(line, 3.0 + 40 * (t + tau), rtol=1e-12)
