"""The replay: the one step in pieces, against scipy, by order, by layout, in lanes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import root_scalar

from hydrojax.effects import EFFECTS
from hydrojax.parameters import get, parameter_specs, put
from hydrojax.plant import stretch
from hydrojax.plant.effect import LevelEffect
from hydrojax.plant.layout import LAYOUTS
from hydrojax.plant.replay import (
    STRETCH,
    before_filters,
    friction_memory,
    line_start,
    opened_in,
    openings,
    pressures,
    readings,
)
from hydrojax.plant.rig import add, bare_rig
from hydrojax.plant.state import State, StepInput
from hydrojax.plant.step import start, step

DIFFERENTIAL = {"area_1": 1.96e-3, "area_2": 1.18e-3, "chamber_length": 0.2}
NAMES = ("c_p1", "c_n1", "c_p2", "c_n2", "beta", "delta_1", "delta_2")


def arrays(log):
    return jax.tree.map(jnp.asarray, log[:3])


def replay(rig, log):
    """What the sensors read, [W, T, 3]."""
    motion, w, P_0 = log
    past = friction_memory(rig, motion).within(w)
    return readings(rig, w, *pressures(rig, motion, w, P_0), past)


# -- the one step --


def everything(rig):
    """Every effect at once, each strength about half its typical size."""
    rig = add(rig, [effect() for effect in EFFECTS.values()])
    spec = parameter_specs(rig)
    strengths = [name for name, s in spec.items() if s.strength]
    share = np.linspace(0.3, 0.9, len(strengths))
    rig = put(rig, strengths, share * [spec[name].scale for name in strengths])
    # Late: what is early a replay knows, and a step has to foresee.
    return put(rig, ["channel_skew.tau_s"], [-0.4e-3])


def by_steps(rig, log):
    """The step scanned over each window, [W, lead+T-1, 3], from its first tick."""
    motion, w, P_0 = log
    ticks = w.u.shape[1]
    P = pressures(rig, motion, w, P_0)
    past = friction_memory(rig, motion)
    silent = eqx.tree_at(
        lambda r: [r.sensor_P, r.sensor_F],
        rig,
        [(), ()],
        is_leaf=lambda part: isinstance(part, tuple),
    )
    unscored = w._replace(measured=jnp.zeros((len(P_0), ticks, 3)))
    true = readings(silent, unscored, *P, past.within(w))

    def sensors(channels, y):
        return rig.sense_init(channels, y[:, 0], (y[:, 1] - y[:, 0]) / w.h[:, 0])[0]

    def gauge(i):
        """What the last channel remembers is known from the reading."""
        y, channels = true[..., i], rig.gauge(i)
        if not channels:
            return ()
        first, slope = y[:, 0], (y[:, 1] - y[:, 0]) / w.h[:, 0]
        memories, first = rig.sense_init(channels[:-1], first, slope)
        read = ((w.P_a1, w.P_a2)[i][:, 0], w.dP[:, 0, i, 0])
        return (*memories, channels[-1].resume(first, slope, read)[0])

    _, memories = jax.lax.scan(
        lambda m, tick: (rig.command_step(m, *tick)[0], m),
        rig.command_init(motion.u[:, 0]),
        (motion.u[:, :-1].T, motion.h.T),
    )
    state = State(
        command=jax.tree.map(lambda a: a[w.first, w.seg], memories),
        P=(P_0[:, 0], P_0[:, 1]),
        z=past.z[w.seg, w.first],
        speed=past.speed[w.seg, w.first],
        sensor_P=tuple(gauge(i) for i in range(2)),
        sensor_F=sensors(rig.sensor_F, true[..., 2]),
        lacking=(0 * P_0[:, 0], 0 * P_0[:, 1]),
        line=line_start(rig, w, opened_in(rig, openings(rig, motion), w)),
        slips=tuple(slip[w.seg, w.first] for slip in past.slips),
        turned=jax.tree.map(lambda a: a[w.seg, w.first], past.turned),
    )
    index = w.seg[:, None], w.first[:, None] + jnp.arange(1, ticks)
    w = before_filters(rig, w)
    along = StepInput(
        h=w.h[:, :-1],
        u=w.u[:, :-1],
        P_s=jnp.stack([w.P_s[:, :-1], w.P_s[:, 1:]], axis=-1),
        P_r=jnp.stack([w.P_r[:, :-1], w.P_r[:, 1:]], axis=-1),
        x=w.x_fine,
        dx=motion.dx[w.seg[:, None], w.first[:, None] + jnp.arange(ticks - 1)],
        v=w.v[:, 1:],
        a=w.a[:, 1:],
        t=w.t[:, 1:],
        F=jnp.stack([w.F[:, :-1], w.F[:, 1:]], axis=-1),
        F_rate=stretch.rate(motion.F, motion.h)[index],
    )
    along = jax.tree.map(lambda a: jnp.moveaxis(a, 1, 0), along)
    _, signals = jax.lax.scan(lambda s, tick: step(rig, s, tick), state, along)
    out = jnp.stack([signals[name] for name in ("P_a1", "P_a2", "F")], axis=-1)
    return jnp.moveaxis(out, 0, 1)


class Settling(LevelEffect):
    """A level that falls while the piston goes one way."""

    name = "settling"
    residual_axis = "t"
    of_turns = True

    def level(self, at, base):
        return 80.0 * jnp.exp(-at.since / 0.05) + 2e4 * at.way


@pytest.mark.parametrize(
    ("dress", "substeps"),
    [
        pytest.param(lambda rig: rig, 1, id="bare"),
        pytest.param(lambda rig: add(rig, [Settling()]), 1, id="turns"),
        pytest.param(everything, 2, id="full", marks=pytest.mark.slow),
    ],
)
def test_steps_give_what_the_pieces_give(rig, drive, dress, substeps):
    rig, log = dress(rig), arrays(drive(substeps, jitter=0.05))
    whole, steps = map(
        np.asarray, jax.jit(lambda r: (replay(r, log), by_steps(r, log)))(rig)
    )
    steps = steps[:, -whole.shape[1] :]
    size = np.max(np.abs(whole), axis=(0, 1))
    assert np.max(np.abs(steps - whole) / size) < 1e-9


@pytest.mark.parametrize(
    "ticks",
    [
        pytest.param(0, marks=pytest.mark.slow),
        7,
        pytest.param(40, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("others", [{}, {"valve_lag": 2e-3, "valve_hysteresis": 0.1}])
def test_a_late_command_is_an_earlier_one(rig, drive, ticks, others):
    """By whole ticks: the command's columns are moved, held at the first."""
    motion, w, P_0 = arrays(drive())
    path = [EFFECTS[name](value) for name, value in others.items()]
    rest = add(rig, path)
    late = add(rig, [EFFECTS["valve_delay"](ticks * 1e-3), *path])
    moved = motion.u[:, np.maximum(np.arange(motion.u.shape[1]) - ticks, 0)]
    earlier = motion._replace(u=moved)
    for got, wanted in zip(
        pressures(late, motion, w, P_0), pressures(rest, earlier, w, P_0), strict=True
    ):
        assert np.allclose(got, wanted, rtol=0, atol=1e-3)  # Pa, of 7 MPa


def test_a_rig_starts_at_rest(rig, drive):
    """Held at rest with the valve shut, nothing moves."""
    rig = everything(rig)
    lane = jnp.full(2, 1.0)
    off = (
        "internal_leakage.c_il", "external_leakage.c_el", "valve_bias.u_0",
        "underlap.u_ul", "pressure_sensor_bias.b_1", "pressure_sensor_bias.b_2",
        "pressure_sensor_gain.eps_1", "pressure_sensor_gain.eps_2",
    )  # fmt: skip
    rig = put(rig, off, [0.0] * len(off))
    pair = jnp.stack([14e6 * lane] * 2, axis=-1)
    still = StepInput(
        h=1e-3 * lane,
        u=0 * lane,
        P_s=pair,
        P_r=pair * 0 + 0.25e6,
        x=jnp.full((2, 3), 1e-3),
        dx=jnp.zeros((2, 4)),
        v=0 * lane,
        a=0 * lane,
        t=0 * lane,
    )
    state, _ = start(rig, still, (6e6 * lane, 7e6 * lane))
    after, signals = jax.jit(lambda s, tick: step(rig, s, tick))(state, still)
    assert np.allclose(after.P, state.P, rtol=1e-14)
    # A rod that gives is solved for, to rounding.
    assert np.all(np.abs(after.z) < 1e-18) and np.all(np.abs(after.speed) < 1e-18)
    assert np.allclose(signals["P_a1"], 6e6, rtol=1e-12)
    assert np.allclose(signals["P_a2"], 7e6, rtol=1e-12)


# -- the pressures against scipy --


def solve_pressures(rig, log, areas):
    """(12)-(15) in plain NumPy, the command held, the supply linear over a tick."""
    c_p1, c_n1, c_p2, c_n2, beta, delta_1, delta_2 = np.asarray(get(rig, NAMES))
    w, out = log.windows, []

    def rates(t, P, i, k, x):
        u = w.u[i, k]
        share = (t - w.t[i, k]) / (w.t[i, k + 1] - w.t[i, k])
        P_s = w.P_s[i, k] + share * (w.P_s[i, k + 1] - w.P_s[i, k])
        P_r = w.P_r[i, k] + share * (w.P_r[i, k + 1] - w.P_r[i, k])
        if u > 0:
            q_1 = c_p1 * np.sqrt(P_s - P[0]) * u
            q_2 = -c_n2 * np.sqrt(P[1] - P_r) * u
        else:
            q_1 = c_n1 * np.sqrt(P[0] - P_r) * u
            q_2 = -c_p2 * np.sqrt(P_s - P[1]) * u
        v = x(t, 1)
        return (
            beta / (areas[0] * (0.1 + delta_1 - x(t))) * (q_1 + areas[0] * v),
            beta / (areas[1] * (0.1 + delta_2 + x(t))) * (q_2 - areas[1] * v),
        )

    for i, P in enumerate(log.P_0):
        x = log.waves[w.seg[i]]["x"]
        scenario = [P]
        for k in range(w.u.shape[1] - 1):
            span = (w.t[i, k], w.t[i, k + 1])
            P = solve_ivp(
                rates, span, P, args=(i, k, x), method="DOP853", rtol=1e-11, atol=1e-3
            ).y[:, -1]
            scenario.append(P)
        out.append(scenario)
    return np.array(out)  # [W, T, 2]


CHAMBERED = [
    ("pull-pull", {"area": 1.18e-3, "chamber_length": 0.2}, (1.18e-3, 1.18e-3)),
    ("differential", DIFFERENTIAL, (1.96e-3, 1.18e-3)),
]


def pressure_errors(rig, drive, truth, substeps):
    """Greatest error relative to the pressure, over windows, ticks and chambers."""
    log = arrays(drive(substeps, jitter=0.05))
    got = np.stack(jax.jit(pressures)(rig, *log), axis=-1)
    return np.max(np.abs(got / truth - 1))


@pytest.mark.parametrize(("layout", "geometry", "areas"), CHAMBERED)
def test_pressures_follow_their_equations(reference, drive, layout, geometry, areas):
    """Against an adaptive solver, and of second order in the step."""
    rig = reference(bare_rig(LAYOUTS[layout], geometry))
    truth = solve_pressures(rig, drive(jitter=0.05), areas)
    assert truth.min() > 0.5e6 and truth.max() < 13.5e6
    steps = np.array([1, 2, 4, 8])
    errors = [pressure_errors(rig, drive, truth, n) for n in steps]
    assert errors[0] < 1e-5
    order = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order > 1.8


# -- layouts --


def output_force(P, f_c, L, k_fp=0.7, k_fn=0.6, delta=1 / 900):
    def gap(F):
        k = k_fp if F > 0 else k_fn
        return F + L * k * F / (1 + delta * abs(F)) - (P - (1 - L) * f_c)

    return root_scalar(gap, bracket=(-1e6, 1e6), xtol=1e-10).root


def forces(rig, log, drive_force):
    """F at the scored ticks by (1)-(7), (16), (22); the drive force from the log."""
    motion, w, _ = arrays(log)
    past = jax.jit(friction_memory)(rig, motion)
    z, speed = np.asarray(past.z), np.asarray(past.speed)
    windows, ticks, _ = log.windows.measured.shape
    out = np.zeros((windows, ticks))
    lead = log.windows.x.shape[1] - ticks
    for i, k in np.ndindex(windows, ticks):
        at = (log.windows.seg[i], log.windows.first[i] + lead + k)
        v, bristle = log.windows.v[i, lead + k], np.clip(z[at] / 60e-6, -1, 1)
        level = 900.0 if bristle > 0 else 1200.0
        f_c = level * bristle + 100.0 - (3e3 if v > 0 else -2e3) * v
        L = 1 / (1 + (300 * speed[at]) ** 3)
        P = drive_force(log.windows.P_a1[i, lead + k], log.windows.P_a2[i, lead + k])
        out[i, k] = output_force(P, f_c, L)
    return out


@pytest.mark.parametrize(
    ("layout", "geometry", "drive_force"),
    [
        ("pull-pull", {"area": 1.18e-3}, lambda a, b: 1.18e-3 * (b - a)),
        ("differential", DIFFERENTIAL, lambda a, b: 1.18e-3 * b - 1.96e-3 * a),
        ("single", {"area": 1.3e-3}, lambda a, b: 1.3e-3 * b),
        ("driven-axis", None, lambda a, b: b),
    ],
)
def test_force_from_given_pressures(reference, drive, layout, geometry, drive_force):
    """What each layout makes of the pressures; P_a2 is P itself on a driven axis."""
    rig, log = reference(bare_rig(LAYOUTS[layout], geometry)), drive()
    if layout == "driven-axis":
        w = log.windows
        w = w._replace(P_a1=0 * w.P_a1, P_a2=(w.P_a2 - 6e6) / 1e3)
        log = log._replace(windows=w)
    motion, w, _ = arrays(log)
    past = jax.jit(friction_memory)(rig, motion).within(w)
    got = jax.jit(readings)(rig, w, w.P_a1, w.P_a2, past)
    want = forces(rig, log, drive_force)
    assert np.allclose(got[..., 2], want, rtol=1e-9, atol=1e-6)
    lead = w.x.shape[1] - w.scored
    assert np.array_equal(got[..., 0], w.P_a1[:, lead:])
    assert np.array_equal(got[..., 1], w.P_a2[:, lead:])


def test_a_missing_area_is_refused():
    with pytest.raises(KeyError, match="area_1"):
        bare_rig(LAYOUTS["differential"], {"area": 1e-3})


# -- lanes --


def test_lanes_are_a_loop(rig, drive):
    log, names = arrays(drive()), ["beta", "c_p1", "k_cp", "z_ss", "valve_lag.tau"]
    rig = add(rig, [EFFECTS["valve_lag"]()])
    rng = np.random.default_rng(1)
    size = np.array([8.5e8, 2.2e-9, 900.0, 60e-6, 5e-4])
    lanes = jnp.asarray(size * rng.uniform(0.8, 1.2, (4, 5)))

    def run(values):
        return replay(put(rig, names, values), log)

    together, one = jax.jit(jax.vmap(run))(lanes), jax.jit(run)
    for lane, got in zip(lanes, together, strict=True):
        assert np.allclose(got, one(lane), rtol=1e-11, atol=1e-9)
    assert np.max(np.abs(together[0] - together[1])) > 1.0


# -- the command long ahead of a window --


def slewed(u, h, omega, zeta, r_v, ahead, on=0.0, fine=40):
    """A rate-limited spool's place at the end of every tick, by small steps.

    Its rate stays at the limit while more is asked for, and leaves it at once; or that
    of the command ahead of it does. Over a tick the command goes the share `on` of the
    way to the next.
    """
    y, rate, dt, out, ramp = u[0], 0.0, h / fine, [], u[0]
    for begin, end in zip(u, np.append(u[1:], u[-1]), strict=True):
        for i in range(fine):
            goal = begin + on * (end - begin) * (i + 0.5) / fine
            ramp += min(max(goal - ramp, -r_v * dt), r_v * dt)
            rate += (
                dt * omega * (omega * ((ramp if ahead else goal) - y) - 2 * zeta * rate)
            )
            rate = rate if ahead else min(max(rate, -r_v), r_v)
            y += dt * rate
        out.append(y)
    return np.array(out)


def operated(n, h):
    """A lever that never rests: sums of sines, driven from end to end."""
    t = h * np.arange(n)
    waves = [np.sin(2 * np.pi * f * t + p) for f, p in ((0.13, 0), (0.4, 1), (1.1, 2))]
    return np.clip(1.2 * waves[0] + 0.6 * waves[1] + 0.5 * waves[2], -0.9, 0.9)


@pytest.mark.parametrize("on", [0.0, 1.0])
@pytest.mark.parametrize("s", [0.0, 1.0])
@pytest.mark.parametrize(("r_v", "most"), [(1.0, 5e-3), (2.0, 2e-3), (5.0, 2e-3)])
def test_stretches_see_what_a_slow_spool_remembers(rig, drive, r_v, most, s, on):
    h, omega, zeta = 0.01, 40.0, 0.8
    u = operated(6000, h)
    place = slewed(u, h, omega, zeta, r_v, s == 0, on)
    slow = add(rig, [EFFECTS["valve_rate_limit"](), EFFECTS["valve_lag"]()])
    slow = put(
        slow,
        ["valve_lag.tau", "valve_lag.zeta", "valve_rate_limit.slew"]
        + ["valve_rate_limit.s"],
        [1 / omega, zeta, 1 / r_v, s],
    )
    motion = drive().motion
    motion = motion._replace(
        u=u[None], h=np.full((1, len(u) - 1), h), runs_on=np.array([on])
    )
    up, down = openings(slow, motion)
    got = np.asarray(up - down)[0]
    ends = np.append(u[0], place[:-1])
    off = np.abs(got - (ends[1:] + ends[:-1]) / 2)
    if on and s == 0:
        # A line is stairs of a quarter of a tick to a ramp, which lie up to an eighth
        # of a tick behind it.
        most += h / 8 * np.max(np.abs(np.diff(u))) / h
    assert len(off) > 3 * STRETCH and np.max(off) < most


@pytest.mark.parametrize("late", [0.0, 0.0037, 0.013])
def test_a_command_that_runs_on_is_a_straight_line_between_ticks(rig, drive, late):
    """Its mean over each tick, late by so many seconds; it stood ahead of the first."""
    rng = np.random.default_rng(0)
    n, h = 700, 5e-3
    u, t = rng.uniform(-2, 2, n), h * np.arange(n)
    rig = add(rig, [EFFECTS["valve_delay"](tau_u=late)] if late else [])
    motion = drive().motion._replace(
        u=u[None], h=np.full((1, n - 1), h), runs_on=np.ones(1)
    )
    fine = h * np.arange(40 * (n - 1) + 1) / 40
    line = np.interp(fine - late, t, u)
    middles = ((line[1:] + line[:-1]) / 2).reshape(-1, 40).mean(axis=1)
    got = openings(rig, motion)
    spool = np.asarray(got[0] - got[1] if late else got[0])[0]
    assert np.allclose(spool, middles, rtol=0, atol=2e-3)


def played(u, u_h):
    """The output of a play of half-width `u_h`, from rest in its middle."""
    out, y = [], u[0]
    for now in u:
        y = min(max(y, now - u_h), now + u_h)
        out.append(y)
    return np.array(out)


@pytest.mark.parametrize(("late", "biased"), [(0, 0.0), (30, 0.2)])
def test_a_play_forgets_nothing_while_the_command_creeps(rig, drive, late, biased):
    """A lever that comes to rest: for thousands of ticks it moves by less than a play,
    which has to know from which side it came.
    """
    h, u_h, n = 2e-3, 0.01, 9000
    begins, ends = (0.0, 0.5, 0.2), (0.5, 0.2, 0.21)
    u = np.concatenate([
        end - (end - begin) * np.exp(-np.arange(n // 3) / 250)
        for begin, end in zip(begins, ends, strict=True)
    ])  # fmt: skip
    loose = add(
        rig,
        [EFFECTS["valve_delay"](tau_u=late * h)] * bool(late)
        + [EFFECTS["valve_bias"](u_0=biased), EFFECTS["valve_hysteresis"](u_h=u_h)],
    )
    motion = drive().motion._replace(
        u=u[None], h=np.full((1, n - 1), h), runs_on=np.zeros(1)
    )
    up, down = openings(loose, motion)
    delayed = np.concatenate([np.full(late, u[0]), u[: n - late]])
    off = np.abs(np.asarray(up - down)[0] - (played(delayed, u_h) + biased)[:-1])
    assert np.max(off) < 1e-9
    assert n > 10 * STRETCH


def test_the_width_of_a_play_moves_the_opening_as_differences_say(rig, drive):
    h, n = 2e-3, 4000
    u = 0.3 * np.exp(-np.arange(n) / 900) + 0.01 * np.sin(np.arange(n) / 300)
    motion = drive().motion._replace(
        u=u[None], h=np.full((1, n - 1), h), runs_on=np.zeros(1)
    )

    def opened(u_h):
        loose = add(rig, [EFFECTS["valve_hysteresis"](u_h=u_h)])
        up, down = openings(loose, motion)
        return up - down

    at, step = 0.008, 1e-6
    slope = jax.jvp(opened, (jnp.asarray(at),), (jnp.asarray(1.0),))[1]
    between = (opened(at + step) - opened(at - step)) / (2 * step)
    # Where the play is taken up between two ticks the two differ for a tick.
    assert np.mean(np.abs(slope - between) > 1e-6) < 0.01
    assert np.ptp(between) > 0.5
