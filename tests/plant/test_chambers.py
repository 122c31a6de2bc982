"""Flows and pressure rates against the paper's formulas, in plain NumPy."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hydrojax.effects import EFFECTS
from hydrojax.parameters import get, put
from hydrojax.plant.chambers import Chambers, Point
from hydrojax.plant.layout import LAYOUTS
from hydrojax.plant.rig import bare_rig
from hydrojax.plant.valve import per_fourth_root, root_flow

LANDS = ("c_p1", "c_n1", "c_p2", "c_n2")
FAR = 1e-6
"""What the laminar core may cost at drops of megapascals, relative."""


def point(u: float = 0.0, opening: tuple[float, ...] = (), **other: float) -> Point:
    at = {
        "P_a1": 5e6,
        "P_a2": 6.5e6,
        "P_s": 14e6,
        "P_r": 0.25e6,
        "x": 4e-3,
        "v": 0.02,
    }
    at = {name: np.float64(value) for name, value in (at | other).items()}
    return Point(**at, opening=tuple(np.float64(o) for o in opening or (u,)))


def paper_flows(c: dict[str, float], at: Point, u: float) -> tuple[Any, Any]:
    """(12)(13), case by case."""
    if u > 0:
        return (
            c["c_p1"] * np.sqrt(at.P_s - at.P_a1) * u,
            -c["c_n2"] * np.sqrt(at.P_a2 - at.P_r) * u,
        )
    if u < 0:
        return (
            c["c_n1"] * np.sqrt(at.P_a1 - at.P_r) * u,
            -c["c_p2"] * np.sqrt(at.P_s - at.P_a2) * u,
        )
    return 0.0, 0.0


def lands_of(rig) -> dict[str, float]:
    return dict(zip(LANDS, np.asarray(get(rig, LANDS)), strict=True))


# -- the root --


def test_root_becomes_the_papers_as_its_core_vanishes():
    drop = np.array([1.0, 1e3, 1e5, 5e6, 2e7])
    error = [
        np.max(np.abs(root_flow(drop, core) / np.sqrt(drop) - 1))
        for core in (1e-2, 1e-4)
    ]
    assert error[1] < 1e-8
    assert error[0] / error[1] == pytest.approx(1e4, rel=0.05)  # falls as core^2


def test_root_costs_what_is_said():
    drop = np.array([1e4, 1e5, 5e6])
    lost = 1 - np.asarray(root_flow(drop)) / np.sqrt(drop)
    assert lost[0] == pytest.approx(0.01, rel=0.05)
    assert lost[1:] == pytest.approx((2e3 / drop[1:]) ** 2 / 4, rel=1e-3)


def test_root_is_odd_and_rises():
    drop = np.linspace(-1e6, 1e6, 4001)
    root = np.asarray(root_flow(drop))
    assert np.array_equal(root, -root[::-1])
    assert np.all(np.diff(root) > 0)


def test_root_has_a_finite_slope_everywhere():
    slope = jax.vmap(jax.grad(root_flow))
    drop = np.array([-1e7, -1e3, -1e-9, 0.0, 1e-300, 1e-9, 1e3, 1e7])
    got = np.asarray(slope(drop))
    assert np.all(np.isfinite(got)) and np.all(got > 0)
    assert got[3] == pytest.approx(2e3**-0.5)


# -- the lands --


@pytest.mark.parametrize("u", [3.0, 0.1, 0.0, -0.1, -7.0])
def test_flows_are_the_papers(rig, u):
    at = point(u)
    flows = rig.valve.flows(at)
    assert np.allclose(flows, paper_flows(lands_of(rig), at, u), rtol=FAR, atol=0)


@pytest.mark.parametrize(
    ("land", "chamber", "u"),
    [("c_p1", 0, 2.0), ("c_n1", 0, -2.0), ("c_p2", 1, -2.0), ("c_n2", 1, 2.0)],
)
def test_each_land_meters_its_own_edge(rig, land, chamber, u):
    """No other way of the spool and no other chamber feels a land."""

    def flows(c, u):
        return np.asarray(put(rig, [land], [c]).valve.flows(point(u)))

    c = lands_of(rig)[land]
    once, twice = flows(c, u), flows(2 * c, u)
    assert twice[chamber] == pytest.approx(2 * once[chamber])
    assert twice[1 - chamber] == once[1 - chamber]
    assert np.array_equal(flows(c, -u), flows(2 * c, -u))


def test_flow_turns_round_outside_supply_and_return(rig):
    fill, drain = rig.valve.flows(point(1.0, P_a1=15e6, P_a2=0.1e6))
    c = lands_of(rig)
    assert fill == pytest.approx(-c["c_p1"] * np.sqrt(1e6), rel=1e-5)
    assert drain == pytest.approx(c["c_n2"] * np.sqrt(0.15e6), rel=1e-4)


def test_a_spool_that_crosses_zero_opens_both_sides(rig):
    both = rig.valve.flows(point(opening=(0.3, 0.2)))
    each = [rig.valve.flows(point(u)) for u in (0.3, -0.2)]
    assert np.allclose(both, np.sum(each, axis=0), rtol=1e-14)


@pytest.mark.parametrize("u", [-0.4, 0.0, 0.4])
def test_a_spool_on_one_side_flows_as_with_both_edges_written_out(rig, u):
    slow = rig.valve.flows(point(opening=(max(u, 0.0), max(-u, 0.0))))
    assert np.allclose(rig.valve.flows(point(u)), slow, rtol=1e-14, atol=0)


def test_fourth_root_is_right_to_the_last_places_over_all_that_can_come():
    a = np.exp(np.random.default_rng(0).uniform(np.log(1e-20), np.log(1e25), 20_000))
    for dtype, ulps in ((np.float64, 4), (np.float32, 4)):
        b = a.astype(dtype)
        got = np.asarray(per_fourth_root(jnp.asarray(b)), np.longdouble)
        off = got * np.sqrt(np.sqrt(b.astype(np.longdouble))) - 1
        assert np.max(np.abs(off)) < ulps * np.finfo(dtype).eps


def test_fourth_root_has_its_derivative_both_ways():
    a = jnp.asarray(3.7e12)
    slope = -0.25 * 3.7e12**-1.25
    assert jax.grad(per_fourth_root)(a) == pytest.approx(slope, rel=1e-14)
    assert jax.jvp(per_fourth_root, (a,), (a,))[1] == pytest.approx(3.7e12 * slope)


# -- the chambers --


def test_rates_are_the_papers(rig):
    at, q_1, q_2 = point(), 3e-6, -2e-6
    rate_1, rate_2 = rig.chambers.rates(at, np.float64(q_1), np.float64(q_2))
    area, beta = 1.18e-3, 8.5e8
    x_1, x_2 = 0.1 + 12e-3 - at.x, 0.1 + 18e-3 + at.x
    assert rate_1 == pytest.approx(beta / (area * x_1) * (q_1 + area * at.v))
    assert rate_2 == pytest.approx(beta / (area * x_2) * (q_2 - area * at.v))


@pytest.mark.parametrize("u", [2.0, 0.0, -2.0])
@pytest.mark.parametrize("v", [0.03, 0.0, -0.01])
def test_net_force_rate_is_the_papers(rig, u, v):
    """(17) with the virtual command (18) and the stiffness (19)."""
    at = point(u, v=v)
    rates = rig.pressure_rates(at)
    x_1, x_2 = 0.1 + 12e-3 - at.x, 0.1 + 18e-3 + at.x
    q_1, q_2 = paper_flows(lands_of(rig), at, u)
    virtual = q_2 / x_2 - q_1 / x_1
    chi = 1 / x_1 + 1 / x_2
    want = 8.5e8 * (virtual - 1.18e-3 * chi * v)
    assert rig.drive_force(*rates) == pytest.approx(want, rel=FAR, abs=1e-6)
    assert np.sign(virtual) == -np.sign(u)


def test_differential_cylinder_has_two_areas(reference):
    rig = reference(
        bare_rig(LAYOUTS["differential"], {"area_1": 2e-3, "area_2": 1.2e-3})
    )
    at = point(-1.5)
    q_1, q_2 = paper_flows(lands_of(rig), at, -1.5)
    half = 0.5  # of the default length
    want = (
        8.5e8 * (q_1 / 2e-3 + at.v) / (half + 12e-3 - at.x),
        8.5e8 * (q_2 / 1.2e-3 - at.v) / (half + 18e-3 + at.x),
    )
    assert np.allclose(rig.pressure_rates(at), want, rtol=FAR)
    assert rig.drive_force(5e6, 6.5e6) == pytest.approx(1.2e-3 * 6.5e6 - 2e-3 * 5e6)


def test_fluid_is_conserved_when_both_chambers_move_together():
    """With the valve shut, pressure follows the volume as `-beta dV/V`."""
    chambers = Chambers(*(np.float64(a) for a in (2e-3, 1e-3, 0.3)))
    at = point(v=0.05, x=-0.02)
    zero = np.float64(0.0)
    rates = chambers.rates(at, zero, zero)
    eps = 1e-6
    for rate, length in zip(rates, (0, 1), strict=True):
        here = chambers.lengths(at.x)[length]
        there = chambers.lengths(at.x + at.v * eps)[length]
        assert rate == pytest.approx(-8.5e8 * np.log(there / here) / eps, rel=1e-5)


# -- effects of the edges and of the volumes --


@pytest.mark.parametrize("drop", [1e4, 3e5, 6e6, -2e6])
def test_a_wider_core_is_laminar_below_it(drop):
    got = root_flow(drop, core=0.0, wider=1e6**2)
    assert got == pytest.approx(drop / (drop**2 + 1e12) ** 0.25, rel=1e-12)


def test_orifice_transition_is_its_formula(rig):
    at = point(2.0)
    c, effect = lands_of(rig), EFFECTS["orifice_transition"](dP_t2=1.5e6**2)

    def root(drop):
        return drop / (drop**2 + 1.5e6**2) ** 0.25

    want = (c["c_p1"] * 2 * root(9e6), -c["c_n2"] * 2 * root(6.25e6))
    got = rig.valve.flows(at, orifices=(effect,))
    assert np.allclose(got, want, rtol=FAR, atol=0)


@pytest.mark.parametrize("g", [1.0, 0.5])
@pytest.mark.parametrize("u", [0.7, 0.2, 0.1, 0.0, -0.05, -0.2, -3.0])
def test_underlap_opens_all_edges_near_zero(rig, u, g):
    """With lands that are too short, and so that it has gone where a side is shut."""
    lap, at = 0.2, point(u)
    c = lands_of(rig)
    if g == 1.0:
        up, down = max(lap + u, 0.0), max(lap - u, 0.0)
    else:
        up, down = (max(s, 0.0) if abs(s) >= lap else (lap + s) / 2 for s in (u, -u))
    supply_1, supply_2 = np.sqrt(at.P_s - at.P_a1), np.sqrt(at.P_s - at.P_a2)
    back_1, back_2 = np.sqrt(at.P_a1 - at.P_r), np.sqrt(at.P_a2 - at.P_r)
    want = (
        c["c_p1"] * up * supply_1 - c["c_n1"] * down * back_1,
        c["c_p2"] * down * supply_2 - c["c_n2"] * up * back_2,
    )
    effect = EFFECTS["underlap"](u_ul=lap, g_ul=g)
    got = rig.valve.flows(at, orifices=(effect,))
    assert np.allclose(got, want, rtol=FAR, atol=1e-18)


def test_dead_volume_adds_to_the_chambers(rig):
    at, flows = point(), (np.float64(3e-6), np.float64(-2e-6))
    effect = EFFECTS["dead_volume"](V_01=2e-5, V_02=3e-5)
    area, beta = 1.18e-3, 8.5e8
    V_1 = area * (0.1 + 12e-3 - at.x) + 2e-5
    V_2 = area * (0.1 + 18e-3 + at.x) + 3e-5
    got = rig.chambers.rates(at, *flows, volumes=(effect,))
    want = (
        beta / V_1 * (flows[0] + area * at.v),
        beta / V_2 * (flows[1] - area * at.v),
    )
    assert np.allclose(got, want, rtol=1e-12)


def test_dead_volume_is_an_assembly_offset_by_another_name(rig):
    """So a log with both offsets free cannot tell it."""
    at, flows = point(), (np.float64(3e-6), np.float64(-2e-6))
    dead = EFFECTS["dead_volume"](V_01=2e-5, V_02=3e-5)
    names = ("delta_1", "delta_2")
    moved = put(rig, names, get(rig, names) + np.array([2e-5, 3e-5]) / 1.18e-3)
    got = rig.chambers.rates(at, *flows, volumes=(dead,))
    assert np.allclose(got, moved.chambers.rates(at, *flows), rtol=1e-13)
