"""Bristle, switch, friction and output force against scipy and the paper's formulas."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import root_scalar

from hydrojax.plant.friction import Friction, Sliding, run_linear

FRICTION = {
    "k_cp": 900.0,
    "k_cn": 1200.0,
    "k_0": 100.0,
    "k_vp": 3e3,
    "k_vn": -2e3,
    "k_fp": 0.7,
    "k_fn": 0.6,
}


@pytest.fixture(scope="module")
def friction():
    return Friction(**FRICTION)


def run_bristle(friction, dx, start=0.0):
    z = [start]
    for keep, add in zip(*map(np.asarray, friction.bristle_map(dx)), strict=True):
        z.append(keep * z[-1] + add)
    return np.array(z)


def bristle_rate(v, z, z_ss):
    """(4)."""
    return v - abs(v) / z_ss * z


# -- the bristle --


@pytest.mark.parametrize("z_ss", [2e-6, 60e-6, 1e-3])
def test_bristle_follows_its_equation(z_ss):
    """Speed turns round at grid points, so the closed form is exact."""
    omega, size = 2 * np.pi * 5, 4e-4  # a reversal every 100 ms
    t = np.linspace(0, 0.5, 201)
    dx = np.diff(-size * np.cos(omega * t))
    got = run_bristle(Friction(z_ss=z_ss), dx, 0.3 * z_ss)
    z, want = 0.3 * z_ss, [0.3 * z_ss]
    for a, b in zip(t[:-1], t[1:], strict=True):
        out = solve_ivp(
            lambda s, z: bristle_rate(size * omega * np.sin(omega * s), z, z_ss),
            (a, b),
            [z],
            method="LSODA",
            rtol=1e-10,
            atol=1e-10 * z_ss,
        )
        z = out.y[0, -1]
        want.append(z)
    assert np.ptp(want) > 0.3 * z_ss
    assert np.max(np.abs(got - want)) < 1e-7 * z_ss


def test_bristle_between_grid_points_costs_little():
    """A reversal inside a step is an error of second order in the step."""
    z_ss, omega, size = 60e-6, 2 * np.pi * 11, 2.5e-4

    def run(n):
        dx = np.diff(size * np.sin(omega * np.linspace(0.0, 0.2, n + 1) + 0.4))
        return run_bristle(Friction(z_ss=z_ss), dx)[:: n // 200]

    truth = run(200 * 64)
    error = [np.max(np.abs(run(200 * n) - truth)) / z_ss for n in (1, 4)]
    assert error[0] < 0.02
    assert error[1] < error[0] / 8


def test_bristle_depends_on_displacement_alone(friction):
    """Two steps one way are one; the closed form of a monotone stretch."""
    z_0, way = 2e-5, np.array([1e-5, 3e-6, 8e-5, 2e-5])
    for sign in (1, -1):
        z = run_bristle(friction, sign * way, z_0)[-1]
        keep = np.exp(-np.sum(way) / 60e-6)
        assert z == pytest.approx(z_0 * keep + sign * 60e-6 * (1 - keep), rel=1e-12)


def test_bristle_is_stable_where_explicit_euler_is_not():
    z_ss, v, h = 2e-6, 0.03, 1e-3
    dx = np.full(50, v * h)
    euler = 0.5 * z_ss
    for _ in dx:
        euler = euler + h * bristle_rate(v, euler, z_ss)
    got = run_bristle(Friction(z_ss=z_ss), dx, 0.5 * z_ss)
    assert abs(euler) > 1e6 * z_ss
    assert np.all(np.abs(got) <= z_ss) and got[-1] == pytest.approx(z_ss)


def test_bristle_follows_the_piston_at_standstill(friction):
    """From rest, its slope is that of differences: 1."""

    def bent(dx):
        keep, add = friction.bristle_map(dx)
        return keep * 0.0 + add

    step = 1e-12
    want = (bent(step) - bent(-step)) / (2 * step)
    assert want == pytest.approx(1.0, rel=1e-6)
    assert float(jax.grad(bent)(0.0)) == pytest.approx(float(want), rel=1e-6)


def test_bristle_rate_is_the_papers(friction):
    for v in (0.02, -0.01, 0.0):
        want = bristle_rate(v, 3e-5, 60e-6)
        assert friction.z_rate(3e-5, v) == pytest.approx(want, rel=1e-12)


# -- the filtered speed and the switch --


def test_filtered_speed_rises_as_an_exponential(friction):
    t = np.linspace(0, 0.3, 61)
    speed, got = 0.01, []
    for _ in t[1:]:
        keep, add = friction.speed_map(-0.03 * 5e-3, 5e-3)
        speed = keep * speed + add
        got.append(speed)
    want = 0.03 + (0.01 - 0.03) * np.exp(-10 * t[1:])
    assert np.allclose(got, want, rtol=1e-12)


def test_filtered_speed_follows_its_equation():
    rng = np.random.default_rng(0)
    v, h = rng.normal(0, 0.02, 40), rng.uniform(5e-4, 4e-3, 40)
    friction = Friction(L_rate=25.0)
    got = want = 0.004
    for speed, step in zip(v, h, strict=True):
        keep, add = friction.speed_map(speed * step, step)
        got = keep * got + add
        want = solve_ivp(
            lambda _, w, speed=speed: 25.0 * (abs(speed) - w),
            (0, step),
            [want],
            rtol=1e-11,
            atol=1e-15,
        ).y[0, -1]
        assert got == pytest.approx(want, rel=1e-9)


def test_switch_is_one_at_rest_and_falls_with_the_cube(friction):
    speed = np.array([0.0, 1e-4, 1 / 300, 0.01, 0.1])
    want = 1 / (1 + (300 * speed) ** 3)
    assert np.allclose(friction.switch(speed), want, rtol=1e-14)
    assert friction.switch(0.0) == 1 and friction.switch(1 / 300) == pytest.approx(0.5)


# -- linear recursions --


@pytest.mark.parametrize("n", [1, 2, 3, 4, 7, 13, 16, 97, 100, 101, 1009])
def test_run_linear_is_the_plain_loop(n):
    rng = np.random.default_rng(n)
    keep, add = rng.uniform(-1, 1, (2, 3, n)), rng.normal(size=(2, 3, n))
    start = rng.normal(size=(2, 3))
    state, want = start, []
    for i in range(n):
        state = keep[..., i] * state + add[..., i]
        want.append(state)
    got = jax.jit(run_linear)(jnp.asarray(keep), jnp.asarray(add), jnp.asarray(start))
    assert got.shape == (2, 3, n)
    assert np.allclose(got, np.stack(want, axis=-1), rtol=1e-11, atol=1e-12)


def test_run_linear_runs_one_series_and_forgets_where_it_keeps_nothing():
    add = jnp.arange(1.0, 12.0)
    got = run_linear(jnp.zeros(11), add, jnp.asarray(99.0))
    assert np.array_equal(got, add)


# -- friction while sliding --


def paper_friction(z, v, z_ss=60e-6):
    """(1)-(3) with phi = -1, the friction parameters above."""

    def select(y):
        return 1.0 if y > 0 else 0.0

    def g(y):
        return 1.0 if y >= z_ss else y / z_ss if y > 0 else 0.0

    k = FRICTION
    return (
        k["k_cp"] * g(z) * select(z)
        - k["k_cn"] * g(-z) * select(-z)
        + k["k_0"]
        + (k["k_vp"] * select(v) + k["k_vn"] * select(-v)) * -1 * v
    )


@pytest.mark.parametrize("z", [-1e-4, -60e-6, -2e-5, 0.0, 1e-9, 3e-5, 60e-6, 9e-5])
@pytest.mark.parametrize("v", [-0.03, -1e-4, 0.0, 2e-3, 0.03])
def test_sliding_friction_is_the_papers(friction, z, v):
    at = Sliding(*(np.float64(0.0) for _ in Sliding._fields))
    got = friction.sliding_force(at._replace(z=np.float64(z), v=np.float64(v)))
    assert got == pytest.approx(paper_friction(z, v), rel=1e-12)


# -- the output force --


def paper_output(P, f_c, L, delta=1 / 900):
    """The root of (22) with (5)-(7), found by bracketing."""

    def gap(F):
        k = FRICTION["k_fp"] if F > 0 else FRICTION["k_fn"]
        return F + L * k * F / (1 + delta * abs(F)) - (P - (1 - L) * f_c)

    far = abs(P) + abs(f_c) + 1.0
    return root_scalar(gap, bracket=(-far, far), xtol=1e-13, rtol=1e-14).root


@pytest.mark.parametrize("L", [0.0, 1e-6, 0.3, 0.9, 1.0])
def test_output_force_is_the_root(friction, L):
    P = np.r_[0.0, np.outer([1, -1], np.logspace(-9, 5, 29)).ravel()]
    for f_c in (0.0, 850.0, -1100.0):
        got = np.asarray(friction.output_force(P, f_c, L))
        want = [paper_output(p, f_c, L) for p in P]
        assert np.allclose(got, want, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("L", [0.0, 0.3, 1.0])
def test_what_acts_at_rest_is_lost_on_the_way_to_the_output(friction, L):
    """As a drive that is weaker by it: beside f_s, of which the share L(t) acts."""
    for P in (-900.0, 5.0, 400.0):
        got = float(friction.output_force(P, 850.0, L, 120.0))
        assert got == pytest.approx(paper_output(P - L * 120.0, 850.0, L), rel=1e-9)


def test_output_force_where_drive_and_friction_cancel(friction):
    """F near zero with both far from it."""
    for gap in (0.0, 1e-6, -1e-6, 1e-2, -1e-2):
        P = 0.6 * 900.0 + gap
        got = float(friction.output_force(P, 900.0, 0.4))
        assert got == pytest.approx(paper_output(P, 900.0, 0.4), abs=1e-10)


@pytest.mark.parametrize("delta", [1e-6, 1 / 900, 10.0])
def test_output_force_for_any_saturation(delta):
    friction = Friction(k_fp=FRICTION["k_fp"], k_fn=FRICTION["k_fn"], delta=delta)
    P = np.outer([1, -1], np.logspace(-6, 5, 23)).ravel()
    got = np.asarray(friction.output_force(P, 0.0, 0.8))
    want = [paper_output(p, 0.0, 0.8, delta) for p in P]
    assert np.allclose(got, want, rtol=1e-9, atol=1e-12)


def test_output_force_has_its_gradient_near_zero(friction):
    slope = jax.grad(friction.output_force)
    for P, k in ((1e-9, 0.7), (-1e-9, 0.6), (1e-300, 0.7)):
        assert slope(P, 0.0, 0.8) == pytest.approx(1 / (1 + 0.8 * k), rel=1e-6)


@pytest.mark.parametrize("L", [0.0, 0.8, 1.0])
def test_output_force_has_its_gradient_at_zero(friction, L):
    """Finite, and not dead: between the slopes of either side."""
    slope = float(jax.grad(friction.output_force)(0.0, 0.0, L))
    sides = sorted(1 / (1 + L * k) for k in (0.7, 0.6))
    assert sides[0] * (1 - 1e-12) <= slope <= sides[1] * (1 + 1e-12)


def test_output_force_has_its_gradients(friction):
    """Against central differences, in every argument and parameter."""

    def force(delta, k_fp, k_fn, P, f_c, L):
        model = Friction(delta=delta, k_fp=k_fp, k_fn=k_fn)
        return model.output_force(P, f_c, L)

    for P in (700.0, -500.0, 5e3):
        at = np.array([1 / 900, 0.7, 0.6, P, 850.0, 0.4])
        got = np.array(jax.grad(force, argnums=range(6))(*at))
        for i, size in enumerate([1e-3, 0.5, 0.5, 500.0, 500.0, 0.5]):
            step = np.eye(6)[i] * size * 1e-5
            want = (force(*(at + step)) - force(*(at - step))) / (2e-5 * size)
            assert got[i] == pytest.approx(float(want), rel=1e-6, abs=1e-9)
