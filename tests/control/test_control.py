"""The adaptive law against the paper's formulas (18)-(30), written out in floats."""

from __future__ import annotations

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hydrojax.control.adaptive import Law, project
from hydrojax.control.base import Estimates, Measured
from hydrojax.control.inverting import mean_area
from hydrojax.plant.chambers import Point
from hydrojax.plant.friction import Friction, Sliding
from hydrojax.plant.layout import LAYOUTS
from hydrojax.plant.rig import bare_rig
from hydrojax.plant.valve import LAMINAR_CORE

SEVEN = ("k_cp", "k_cn", "k_0", "k_vp", "k_vn", "k_fp", "k_fn")
NINE = ("k_1", "A_a", *SEVEN)

AREAS = {
    "pull-pull": (1.18e-3, 1.18e-3),
    "differential": (1.45e-3, 1.05e-3),
    "single": (0.0, 1.3e-3),
}
"""Areas on which the pressures of chambers 1 and 2 push, m^2; 0 of an open chamber."""


# -- the law once more, in floats --


class PlainLaw:
    """(4), (18), (19), (23)-(30) with `math` alone.

    `flip` names one sign to be turned round: a comparison that does not see that
    compares nothing.
    """

    def __init__(self, given: dict, areas: tuple[float, float], flip: str = ""):
        self.g, self.areas = given, areas
        self.sign = {
            name: -1.0 if name == flip else 1.0
            for name in ("k_p", "k_f", "swept", "P_d_rate", "valve", *NINE)
        }
        self.estimates = {n: (given["lower"][n] + given["upper"][n]) / 2 for n in NINE}
        self.x = None

    def regressor(self, v, F_d):
        """(26) with (1), (2), (6), phi = -1 and the printed L(t)."""
        g = self.g
        L = 1 / (1 + (g["L_slope"] * self.speed) ** 3)
        ratio = self.z / g["z_ss"]
        phi = F_d / (1 + g["delta"] * abs(F_d))
        return (
            (1 - L) * min(max(ratio, 0.0), 1.0),
            -(1 - L) * min(max(-ratio, 0.0), 1.0),
            1 - L,
            (1 - L) * -v if v > 0 else 0.0,
            (1 - L) * -v if v < 0 else 0.0,
            L * phi if F_d > 0 else 0.0,
            L * phi if F_d < 0 else 0.0,
        )

    def desired(self, v, F_d):
        """P_d by (24)(25), and the row."""
        row = self.regressor(v, F_d)
        return F_d + sum(
            y * self.estimates[n] for y, n in zip(row, SEVEN, strict=True)
        ), row

    def step(self, F_d, P_1, P_2, P_s, F, x, h):
        g, e = self.g, self.estimates
        if self.x is None:
            self.x, self.v, self.z, self.speed = x, 0.0, 0.0, 0.0
            self.P_d, self.P_d_rate = self.desired(0.0, F_d)[0], 0.0
        dx, self.x = x - self.x, x
        self.v += h / (g["tau_v"] + h) * (dx / h - self.v)
        fade = math.exp(-abs(dx) / g["z_ss"])
        end = math.copysign(g["z_ss"], dx) if dx else self.z
        self.z = end + (self.z - end) * fade
        held = abs(dx) / h
        self.speed = held + (self.speed - held) * math.exp(-g["L_rate"] * h)

        P_d, row = self.desired(self.v, F_d)
        self.P_d_rate += h / (g["tau_d"] + h) * ((P_d - self.P_d) / h - self.P_d_rate)
        self.P_d = P_d

        A_1, A_2 = self.areas
        P = A_2 * P_2 - A_1 * P_1
        x_1 = g["length"] / 2 + g["delta_1"] - x
        x_2 = g["length"] / 2 + g["delta_2"] + x
        s = self.sign
        # beta (Q_2/x_2 - Q_1/x_1) less beta times this times v is the rate of P.
        total = A_1 / x_1 + A_2 / x_2
        pushing = [a for a in self.areas if a]
        swept = total / (sum(pushing) / len(pushing)) * self.v
        virtual = (
            s["P_d_rate"] * e["k_1"] * self.P_d_rate
            + s["swept"] * e["A_a"] * swept
            + s["k_p"] * g["k_p"] * (P_d - P)
            + s["k_f"] * g["k_f"] * (F_d - F)
        )

        def root(drop):
            return math.sqrt(max(drop, 1e4))

        first = 1.0 if A_1 else 0.0
        if virtual < 0:
            gain = first * g["c_p1"] * root(P_s - P_1) / x_1
            gain += g["c_n2"] * root(P_2 - g["P_r"]) / x_2
        else:
            gain = first * g["c_n1"] * root(P_1 - g["P_r"]) / x_1
            gain += g["c_p2"] * root(P_s - P_2) / x_2
        u = -s["valve"] * virtual / gain
        out = {
            "u": min(max(u, -g["u_max"]), g["u_max"]),
            "P": P, "P_d": P_d, "P_d_rate": self.P_d_rate, "v": self.v,
            "swept": swept, "virtual": virtual, "z": self.z, "speed": self.speed,
            **e,
        }  # fmt: skip

        teach = {"k_1": (P_d - P) * self.P_d_rate, "A_a": (P_d - P) * swept}
        teach |= {n: (F_d - F) * y for n, y in zip(SEVEN, row, strict=True)}
        self.estimates = {n: self.projected(n, e[n], s[n] * teach[n], h) for n in NINE}
        return out

    def projected(self, name, theta, s, h):
        """The function P of (28)-(30)."""
        a, b = self.g["lower"][name], self.g["upper"][name]
        if (theta <= a and s <= 0) or (theta >= b and s >= 0):
            return theta
        return min(max(theta + h * self.g["rate"][name] * s, a), b)


PLANT = {
    "c_p1": 2.24e-9, "c_n1": 2.15e-9, "c_p2": 2.27e-9, "c_n2": 2.11e-9,
    "beta": 8.5e8, "delta_1": 12e-3, "delta_2": 18e-3, "z_ss": 60e-6,
    "delta": 1 / 900, "L_slope": 300.0, "L_rate": 10.0,
    "k_cp": 1250.0, "k_cn": 850.0, "k_0": 100.0, "k_vp": 3e3, "k_vn": 4e3,
    "k_fp": 0.7, "k_fn": 0.65,
}  # fmt: skip

KAPPA = 1.18e-4

GIVEN = PLANT | {
    "length": 0.2, "P_r": 0.25e6, "u_max": 3.0, "tau_d": 0.0, "tau_v": 0.0,
    "k_p": 1.2e-3 * KAPPA, "k_f": 2.4e-3 * KAPPA,
    "rate": {
        "k_1": 3e-12 * KAPPA, "A_a": 0.7 * KAPPA, "k_cp": 400.0, "k_cn": 400.0,
        "k_0": 100.0, "k_vp": 1e6, "k_vn": 1e6, "k_fp": 4e-4, "k_fn": 4e-4,
    },
    "lower": {
        "k_1": 0.7 / 8.5e8, "A_a": 6 * KAPPA, "k_cp": 0.0, "k_cn": 0.0, "k_0": -500.0,
        "k_vp": -1e4, "k_vn": -1e4, "k_fp": 0.3, "k_fn": 0.3,
    },
    "upper": {
        "k_1": 1.6 / 8.5e8, "A_a": 15 * KAPPA, "k_cp": 2e3, "k_cn": 2e3, "k_0": 500.0,
        "k_vp": 1e4, "k_vn": 1e4, "k_fp": 1.1, "k_fn": 1.1,
    },
}  # fmt: skip
"""A plant and a law for it, SI."""


def make_nominal(layout: str, plant: dict = PLANT):
    """The plant as hydrojax has it."""
    a_1, a_2 = AREAS[layout]
    geometry = {"chamber_length": 0.2, "area": a_2, "area_1": a_1, "area_2": a_2}
    rig = bare_rig(LAYOUTS[layout], geometry)
    for part in ("valve", "chambers", "mechanics"):
        fields = [n for n in plant if hasattr(getattr(rig, part), n)]
        rig = eqx.tree_at(
            lambda r, part=part, fields=fields: [
                getattr(getattr(r, part), n) for n in fields
            ],
            rig,
            [jnp.asarray(plant[n], float) for n in fields],
        )
    return rig


def make_law(given: dict, layout: str) -> Law:
    """The law as hydrojax has it."""

    def array(name):
        return jnp.asarray(given[name], float)

    def nine(name):
        return Estimates(*(jnp.asarray(given[name][n], float) for n in NINE))

    return Law(
        nominal=make_nominal(layout, {k: v for k, v in given.items() if k in PLANT}),
        k_p=array("k_p"),
        k_f=array("k_f"),
        rate=nine("rate"),
        lower=nine("lower"),
        upper=nine("upper"),
        P_r=array("P_r"),
        u_max=array("u_max"),
        tau_d=array("tau_d"),
        tau_v=array("tau_v"),
    )


# -- made-up measured signals --

SAMPLES, H = 3000, 1e-3


class Signals(NamedTuple):
    """[n] each, SI."""

    F_d: np.ndarray
    P_a1: np.ndarray
    P_a2: np.ndarray
    P_s: np.ndarray
    F: np.ndarray
    x: np.ndarray


def make_signals(areas: tuple[float, float]) -> Signals:
    """3 s in which every branch is taken: rest, creep and 3 cm/s both ways, pressures
    that touch P_s and P_r, force errors that drive estimates to their bounds.
    """
    rng = np.random.default_rng(7)
    t = H * np.arange(SAMPLES)
    moving = np.clip((t - 0.3) / 0.2, 0, 1)
    x = 0.01 * moving * np.sin(2 * np.pi * 0.45 * t)
    x += moving * 1e-4 * np.sin(2 * np.pi * 11 * t)
    x = np.round(x / 1e-7) * 1e-7
    F_d = 300 * np.sin(2 * np.pi * 0.8 * t) + 60 * np.sin(2 * np.pi * 9 * t)
    F = F_d + 90 * np.sin(2 * np.pi * 3.1 * t) + 2.5 * rng.normal(size=SAMPLES)
    drive = F + 900 * np.tanh(np.gradient(x, t) / 1e-3) + 200 * np.sin(61 * t)
    P_2 = 7e6 + 6.9e6 * np.sin(2 * np.pi * 0.3 * t) ** 3
    if areas[0]:
        P_1 = (areas[1] * P_2 - drive) / areas[0]
    else:
        P_2, P_1 = drive / areas[1] + 3e5, np.full(SAMPLES, 1e5)
    noise = 9e3 * rng.normal(size=(3, SAMPLES))
    P_s = 14e6 + 2e5 * np.sin(30 * t) + noise[2]
    return Signals(F_d, P_1 + noise[0], P_2 + noise[1], P_s, F, x)


@jax.jit
def _walk(law: Law, signals: Signals, h: jax.Array):
    def row(s):
        return Measured(s.P_a1, s.P_a2, s.P_s, s.F, s.x)

    def body(memory, s):
        memory, u, made = law.step(memory, row(s), s.F_d, h)
        out = {"u": u, "z": memory.z, "speed": memory.speed}
        return memory, out | made

    first = jax.tree.map(lambda a: a[0], signals)
    start = law.init(row(first), first.F_d)
    return jax.lax.scan(body, start, signals)[1]


FILTERS = {"plain": {}, "filtered": {"tau_d": 3e-3, "tau_v": 2e-3}}
CASES = [(layout, name) for layout in AREAS for name in FILTERS]


def plain_walk(layout: str, filters: str, flip: str = "") -> dict[str, np.ndarray]:
    law = PlainLaw(GIVEN | FILTERS[filters], AREAS[layout], flip)
    rows = zip(*make_signals(AREAS[layout]), strict=True)
    walked = [law.step(*map(float, row), H) for row in rows]
    return {name: np.array([w[name] for w in walked]) for name in walked[0]}


def library_walk(layout: str, filters: str) -> dict[str, np.ndarray]:
    law = make_law(GIVEN | FILTERS[filters], layout)
    signals = jax.tree.map(jnp.asarray, make_signals(AREAS[layout]))
    return {k: np.asarray(v) for k, v in _walk(law, signals, jnp.asarray(H)).items()}


@pytest.fixture(scope="module")
def walks():
    """What the formulas and what the library make of the signals, by case."""
    return {case: (plain_walk(*case), library_walk(*case)) for case in CASES}


def misses(want: np.ndarray, got: np.ndarray) -> float:
    """Largest difference as a share of the signal's size."""
    return float(np.max(np.abs(got - want)) / np.max(np.abs(want)))


EQUATIONS = {
    "(4) bristle": ("z",),
    "L(t) filtered speed": ("speed",),
    "(16) drive force": ("P",),
    "(19) chi v": ("v", "swept"),
    "(24)(25)(26) P_d": ("P_d",),
    "rate of P_d": ("P_d_rate",),
    "(23) virtual input": ("virtual",),
    "(18) valve inverse": ("u",),
    "(28) k_1": ("k_1",),
    "(29) A_a": ("A_a",),
    "(30) theta_f": SEVEN,
}


@pytest.mark.parametrize("case", CASES, ids="-".join)
@pytest.mark.parametrize("equation", EQUATIONS)
def test_the_law_is_the_papers(walks, equation, case):
    want, got = walks[case]
    for name in EQUATIONS[equation]:
        assert np.ptp(want[name]) > 0, f"{name} rests: the test could not fail"
        assert misses(want[name], got[name]) < 1e-11, name


def test_the_signals_take_every_branch(walks):
    """What the test above rests on."""
    for case in CASES:
        got = walks[case][1]
        at_ends = np.abs(got["u"]) == GIVEN["u_max"]
        assert 0.01 < np.mean(at_ends) < 0.9
        assert np.any(got["virtual"] < 0) and np.any(got["virtual"] > 0)
        for name in NINE:
            low, high = GIVEN["lower"][name], GIVEN["upper"][name]
            assert low <= got[name].min() and got[name].max() <= high
        bound = [
            n for n in NINE
            if np.any(got[n] == GIVEN["lower"][n])
            or np.any(got[n] == GIVEN["upper"][n])
        ]  # fmt: skip
        assert len(bound) >= 4, bound
    signals = make_signals(AREAS["pull-pull"])
    for P in (signals.P_a1, signals.P_a2):
        assert np.any(signals.P_s - P < 1e4) or np.any(P - GIVEN["P_r"] < 1e4)


@pytest.mark.parametrize(
    "flip", ["k_p", "k_f", "swept", "P_d_rate", "valve", "k_1", "A_a", *SEVEN]
)
def test_a_sign_turned_round_is_seen(walks, flip):
    wrong = plain_walk("pull-pull", "filtered", flip)
    got = walks["pull-pull", "filtered"][1]
    assert max(misses(wrong[n], got[n]) for n in ("u", *NINE)) > 1e-3


# -- (22): the plant's friction is the regressor times theta_f --


def test_22_friction_is_linear_in_theta_f():
    """f_f = P - F of the plant is Y(F) theta_f, by the paper's own (3), (5), (7)."""
    rng = np.random.default_rng(3)
    n = 4000
    theta = {k: PLANT[k] for k in SEVEN}
    friction = Friction(
        **theta, z_ss=PLANT["z_ss"], delta=PLANT["delta"], L_slope=300.0, L_rate=10.0
    )
    z = rng.uniform(-1.4, 1.4, n) * PLANT["z_ss"]
    v = rng.uniform(-0.03, 0.03, n)
    v[:50] = 0.0
    speed = np.abs(rng.normal(size=n)) * 4e-3
    P = rng.normal(size=n) * 1500
    rest = np.zeros(n)
    at = Sliding(rest, rest, v, rest, z, rest, speed, rest, rest, rest)
    L = friction.switch(speed)
    F = np.asarray(friction.output_force(P, friction.sliding_force(at), L))
    row = friction.regressor(*map(jnp.asarray, (z, v, L, F)))
    f_f = sum(np.asarray(y) * theta[k] for y, k in zip(row, SEVEN, strict=True))
    assert np.allclose(P - F, f_f, rtol=1e-9, atol=1e-8)

    def g(a):
        return np.clip(a / PLANT["z_ss"], 0, 1)

    f_c = theta["k_cp"] * g(z) - theta["k_cn"] * g(-z) + theta["k_0"]
    f_c -= np.where(v > 0, theta["k_vp"], theta["k_vn"]) * v
    f_s = np.where(F > 0, theta["k_fp"], theta["k_fn"]) * F / (1 + np.abs(F) / 900)
    L = 1 / (1 + (300 * speed) ** 3)
    assert np.allclose(f_f, (1 - L) * f_c + L * f_s, rtol=1e-12, atol=1e-9)
    assert np.ptp(F[F > 0]) > 1000 and np.ptp(F[F < 0]) > 1000


# -- (17)(18): the valve inverse and the plant --


@pytest.mark.parametrize("layout", AREAS)
def test_17_the_plant_gives_what_the_law_asks_for(layout):
    """The command through the plant's lands: P' = beta (u - A chi v), both signs."""
    rng = np.random.default_rng(11)
    n = 2000
    law = make_law(GIVEN | {"u_max": 1e3}, layout)
    P_1, P_2 = rng.uniform(0.6e6, 13.6e6, (2, n))
    x, v = rng.uniform(-0.05, 0.05, n), rng.uniform(-0.05, 0.05, n)
    virtual = rng.normal(size=n) * 1e-3
    P_s = np.full(n, 14e6)
    u = law.command(virtual, Measured(P_1, P_2, P_s, 0 * x, x))
    u = np.asarray(u)
    assert np.all(np.sign(u) == -np.sign(virtual))
    at = Point(P_1, P_2, P_s, 0 * x + GIVEN["P_r"], (u,), x, v)
    rates = law.nominal.pressure_rates(at)
    got = np.asarray(law.nominal.drive_force(*rates))
    A_1, A_2 = AREAS[layout]
    total = A_1 / (0.1 + 12e-3 - x) + A_2 / (0.1 + 18e-3 + x)  # A chi of (19)
    want = 8.5e8 * (virtual - total * v)
    core = (LAMINAR_CORE / 0.35e6) ** 2 / 4  # what the laminar core costs at most
    assert np.all(np.abs(got - want) <= 8.5e8 * np.abs(virtual) * core * 1.01 + 1e-3)
    split = float(mean_area(law.nominal)) * np.asarray(law.chi(x))
    assert np.allclose(split, total, rtol=1e-13)


@pytest.mark.parametrize("layout", AREAS)
def test_18_pressures_beyond_the_supply_do_not_blow_up(layout):
    law = make_law(GIVEN | {"u_max": 10.0}, layout)
    ends = [-2e6, 0.0, 0.25e6 - 1.0, 0.25e6, 0.25e6 + 1e4, 7e6, 14e6, 14e6 + 1.0, 2e7]
    P_1, P_2, virtual = (
        jnp.asarray(a.ravel())
        for a in np.meshgrid(ends, ends, [-1e-2, -1e-9, 0.0, 1e-9, 1e-2])
    )

    def command(virtual, P_1, P_2, P_s, x):
        return law.command(virtual, Measured(P_1, P_2, P_s, 0.0, x))

    P_s, x = 0 * P_1 + 14e6, 0 * P_1
    lanes = jax.vmap(jax.value_and_grad(command, argnums=(0, 1, 2, 3, 4)))
    u, slopes = lanes(virtual, P_1, P_2, P_s, x)
    assert np.all(np.abs(u) <= 10.0)
    assert np.any(np.abs(u) == 10.0)
    for slope in slopes:
        assert np.all(np.isfinite(slope))
    assert np.all(np.asarray(u)[np.asarray(virtual) == 0] == 0)


# -- (28)-(30): the projection --


def test_30_projection_is_held_and_free():
    """kappa is 0 at a bound that s points out of, 1 elsewhere; nothing leaves."""
    rng = np.random.default_rng(5)
    n, h = 5000, 1e-3
    a = rng.normal(size=n)
    b = a + np.abs(rng.normal(size=n))
    b[:300] = a[:300]
    theta = rng.uniform(a, b)
    theta[1000:2000], theta[2000:3000] = a[1000:2000], b[2000:3000]
    s, rate = rng.normal(size=n) * 10, np.abs(rng.normal(size=n)) * 10
    new = np.asarray(project(theta, s, rate, a, b, h))
    assert np.all((new >= a) & (new <= b))
    stopped = ((theta <= a) & (s <= 0)) | ((theta >= b) & (s >= 0))
    assert np.array_equal(new[stopped], theta[stopped])
    free = theta + h * rate * s
    inside = ~stopped & (free > a) & (free < b)
    assert stopped.sum() > 500 and inside.sum() > 500
    assert np.array_equal(new[inside], free[inside])


ARGS = ("theta", "s", "rate", "lower", "upper")


@pytest.mark.parametrize(
    ("at", "want"),
    [
        ((-1.0, -5.0, 2.0, -1.0, 1.0), {"lower": 1.0}),  # held at the lower bound
        ((1.0, 5.0, 2.0, -1.0, 1.0), {"upper": 1.0}),
        ((-1.0, 0.0, 2.0, -1.0, 1.0), {"lower": 1.0}),
        ((1.0, 0.0, 2.0, -1.0, 1.0), {"upper": 1.0}),
        ((0.9999, 5.0, 2.0, -1.0, 1.0), {"upper": 1.0}),  # stopped on its way
        ((0.2, 5.0, 2.0, -1.0, 1.0), {"theta": 1.0, "s": 2e-3, "rate": 5e-3}),
        ((-1.0, 5.0, 2.0, -1.0, 1.0), {"theta": 1.0, "s": 2e-3, "rate": 5e-3}),
    ],
)
def test_30_projection_has_whole_derivatives(at, want):
    got = jax.grad(lambda a: project(*a, 1e-3))(tuple(map(jnp.asarray, at)))
    for name, slope in zip(ARGS, got, strict=True):
        assert float(slope) == pytest.approx(want.get(name, 0.0), abs=1e-15), name


def test_gain_and_bounds_alone_say_adapted_frozen_or_off():
    given = GIVEN | {k: dict(GIVEN[k]) for k in ("rate", "lower", "upper")}
    given["rate"]["k_cp"] = 0.0  # frozen midway
    given["lower"]["k_cn"] = given["upper"]["k_cn"] = 700.0  # frozen there
    given["lower"]["k_0"] = given["upper"]["k_0"] = 0.0  # off
    signals = jax.tree.map(jnp.asarray, make_signals(AREAS["pull-pull"]))
    got = _walk(make_law(given, "pull-pull"), signals, jnp.asarray(H))
    assert np.all(got["k_cp"] == 1000.0)
    assert np.all(got["k_cn"] == 700.0)
    assert np.all(got["k_0"] == 0.0)
    assert np.ptp(got["k_vp"]) > 100.0


def test_the_law_starts_at_rest_and_midway():
    law = make_law(GIVEN, "pull-pull")
    seen = Measured(*map(jnp.asarray, (7e6, 7e6, 14e6, 0.0, 3e-3)))
    memory = law.init(seen, jnp.asarray(250.0))
    for name in NINE:
        middle = (GIVEN["lower"][name] + GIVEN["upper"][name]) / 2
        assert float(getattr(memory.estimates, name)) == pytest.approx(middle)
    # L = 1 at rest: all of the friction is the presliding kind.
    want = 250 * (1 + 0.7 / (1 + 250 / 900))
    assert float(memory.P_d) == pytest.approx(want, rel=1e-12)
    assert not any(float(a) for a in (memory.v, memory.z, memory.speed))
    memory, _, made = law.step(memory, seen, jnp.asarray(250.0), jnp.asarray(H))
    assert float(made["v"]) == float(made["P_d_rate"]) == 0.0
