"""Balances of flow and force over short windows of a log: no simulation.

Over a window with a smooth weight w, chamber i keeps what flows into it,

    sum w (+-A dx) = sum w (Q_i(u, P_i, P_s, P_r) h - V_i(x) dP_i / beta),

and the output force is what the pressures push less the friction (22). Both are linear
in the constants that a rig file leaves open (1/beta, the valve's four, friction's
seven), so that a fit is one small least-squares problem (the weak form; M. Shinbrot,
Transactions of the ASME 79, 1957). Ticks are even: `EvenTicks` says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

from hydrojax.identify.checking.regression import Table, window_sums

EDGES = ("c_p1", "c_n1", "c_p2", "c_n2")
OFFSETS = ("delta_1", "delta_2")
FLOW = (*EDGES, "beta", *OFFSETS)
FRICTION = ("k_cp", "k_cn", "k_0", "k_vp", "k_vn", "k_fp", "k_fn")
NOT_NEGATIVE = (*EDGES, "beta", "k_cp", "k_cn", "k_fp", "k_fn")
"""What no rig has below zero."""
PUSHES = {"push_1": 1.0, "push_2": 1.0}
"""What the pressures push is known, but for areas and gauges."""

SETTLE = 1.0
"""Seconds until bristle and filtered speed no longer depend on where they began."""


@dataclass(frozen=True)
class EvenTicks:
    """Signals of one stretch without gaps at even ticks, SI.

    `x` is the position from mid-stroke, `P` the two chamber pressures; NaN where a
    signal was not logged.
    """

    h: float
    u: Float[np.ndarray, "ticks"]
    x: Float[np.ndarray, "ticks"]
    P: Float[np.ndarray, "ticks 2"]
    P_s: Float[np.ndarray, "ticks"]
    P_r: Float[np.ndarray, "ticks"]
    F: Float[np.ndarray, "ticks"]


@dataclass(frozen=True)
class Geometry:
    """Areas of the chambers and those on which pressures push, m^2; length, m."""

    chambers: tuple[float, float]
    force: tuple[float, float]
    length: float


@dataclass(frozen=True)
class Shape:
    """Where the force is not linear: bristle (m), its saturation (1/N), switch L(t)."""

    z_ss: float
    delta: float
    L_slope: float
    L_rate: float


def _root(drop: np.ndarray) -> np.ndarray:
    return np.sign(drop) * np.sqrt(np.abs(drop))


# -- flow --


@dataclass(frozen=True)
class _Ticks:
    """What moves in a tick, and stands in its middle; [n, 2] by chamber."""

    h: float
    u: np.ndarray
    opens: np.ndarray  # toward the supply
    shuts: np.ndarray  # toward the return
    fill: np.ndarray  # Pa^0.5
    drain: np.ndarray
    P: np.ndarray
    P_r: np.ndarray
    dP: np.ndarray
    swept: np.ndarray  # m^3
    volume: np.ndarray  # m^3, without the offsets
    area: np.ndarray

    @classmethod
    def of(cls, s: EvenTicks, g: Geometry) -> _Ticks:
        def middle(y):
            return (y[1:] + y[:-1]) / 2

        toward, area = np.array([-1.0, 1.0]), np.array(g.chambers)
        P, P_r, u = middle(s.P), middle(s.P_r)[:, None], s.u[:-1, None]
        way = np.hstack([u, -u])
        volume = area * (g.length / 2 + toward * middle(s.x)[:, None])
        return cls(
            s.h, s.u[:-1], np.maximum(way, 0), np.maximum(-way, 0),
            _root(middle(s.P_s)[:, None] - P), _root(P - P_r), P, P_r,
            np.diff(s.P, axis=0), toward * area * np.diff(s.x)[:, None], volume, area,
        )  # fmt: skip

    def table(
        self, ticks: int, both: Mapping[str, np.ndarray], own: Mapping[str, np.ndarray]
    ) -> Table:
        """Rows of chamber 1, then of 2; each column is [n, 2].

        What stands in `own` has a constant for each chamber, whose name ends with its
        number, and is nothing in the rows of the other.
        """
        each = np.stack([self.swept, *both.values(), *own.values()], axis=2)
        first, second = window_sums(each, ticks).transpose(1, 2, 0)
        rows = iter(zip(first, second, strict=True))
        y = np.concatenate(next(rows))
        columns = {n: np.concatenate(next(rows)) for n in both}
        for name, (one, other) in zip(own, rows, strict=True):
            columns[f"{name}1"] = np.concatenate([one, np.zeros_like(other)])
            columns[f"{name}2"] = np.concatenate([np.zeros_like(one), other])
        return Table(y, columns)


def flow_table(s: EvenTicks, g: Geometry, ticks: int) -> Table:
    """What the motion displaces in each chamber, m^3, and what makes it up.

    Coefficients: the valve's constants, 1/beta under `beta`, and delta/beta under
    `delta_1` and `delta_2`.
    """
    t = _Ticks.of(s, g)
    own = {
        "c_p": t.opens * t.fill * t.h,
        "c_n": -t.shuts * t.drain * t.h,
        "delta_": -t.area * t.dP,
    }
    return t.table(ticks, {"beta": -t.volume * t.dP}, own)


FLOW_RIVALS: Mapping[str, tuple[str, ...]] = {
    "internal_leakage": ("internal_leakage",),
    "external_leakage": ("external_leakage",),
    "entrained_air": ("entrained_air",),
    "underlap": ("laps_p1", "laps_n1", "laps_p2", "laps_n2"),
    "supply_line_drop": ("drop_p1", "drop_n1", "drop_p2", "drop_n2"),
    "valve_lag": ("late_p1", "late_n1", "late_p2", "late_n2"),
    "valve_hysteresis": ("play_1", "play_2"),
    "pressure_compensation": ("even_p1", "even_n1", "even_p2", "even_n2"),
}
"""Columns that stand for what effects of the hydraulics do, to first order."""


def flow_rivals(s: EvenTicks, g: Geometry, ticks: int) -> Table:
    """The columns of `FLOW_RIVALS` on the rows of `flow_table`."""
    t = _Ticks.of(s, g)
    supply, drain = t.opens * t.fill * t.h, -t.shuts * t.drain * t.h
    turning = np.sign(np.diff(t.u, prepend=t.u[0]))[:, None]
    both = {
        "internal_leakage": (t.P[:, ::-1] - t.P) * t.h,
        "external_leakage": -(t.P - t.P_r) * t.h,
        "entrained_air": -t.volume * t.dP / np.maximum(t.P, 1e5),
    }
    own = {
        "laps_p": (t.opens > 0) * t.fill * t.h,
        "laps_n": (t.shuts > 0) * -t.drain * t.h,
        "drop_p": supply * t.opens**2,
        "drop_n": drain * t.shuts**2,
        "late_p": np.diff(supply, axis=0, prepend=supply[:1]),
        "late_n": np.diff(drain, axis=0, prepend=drain[:1]),
        "even_p": t.opens * 1e3 * t.h,
        "even_n": -t.shuts * 1e3 * t.h,
        "play_": turning * np.where(t.opens > 0, t.fill, t.drain) * t.h,
    }
    return t.table(ticks, both, own)


# -- force --


def _bristle(dx: np.ndarray, z_ss: float) -> np.ndarray:
    """Deflection over z_ss after each displacement (4), from none; [n + 1]."""
    keep = np.exp(-np.abs(dx) / z_ss)
    steps = zip(keep.tolist(), (np.sign(dx) * (1 - keep)).tolist(), strict=True)
    each = accumulate(steps, lambda z, s: s[0] * z + s[1], initial=0.0)
    return np.fromiter(each, float, len(dx) + 1)


def _switch(dx: np.ndarray, h: float, shape: Shape) -> np.ndarray:
    """L(t): 1 in presliding, 0 in sliding; [n + 1]."""
    keep, speed = np.exp(-shape.L_rate * h), np.abs(dx) / h
    first = speed[: max(int(0.2 / h), 1)].mean()
    slow = np.concatenate(
        [[first], lfilter([1 - keep], [1, -keep], speed, zi=[keep * first])[0]]
    )
    return 1 / (1 + (shape.L_slope * slow) ** 3)


def _friction(s: EvenTicks, shape: Shape) -> tuple[np.ndarray, ...]:
    """Speed, bristle over z_ss, and the share that slides; [ticks]."""
    return _slid(s.x.tobytes(), s.h, shape)


@lru_cache(maxsize=4)  # the positions of a few logs, which may be long
def _slid(x: bytes, h: float, shape: Shape) -> tuple[np.ndarray, ...]:
    """That of a position (doubles, m) every h seconds: mostly one that other signals
    are tried beside.
    """
    at = np.frombuffer(x)
    dx = np.diff(at)
    return np.gradient(at, h), _bristle(dx, shape.z_ss), 1 - _switch(dx, h, shape)


def _force_rows(s: EvenTicks, y: np.ndarray, each: Mapping, ticks: int) -> Table:
    sums = window_sums(np.stack([y, *each.values()], axis=1), ticks)
    late = sums[int(SETTLE / s.h / max(ticks // 2, 1)) :]
    return Table(late[:, 0], dict(zip(each, late[:, 1:].T, strict=True)))


def force_table(s: EvenTicks, g: Geometry, shape: Shape, ticks: int) -> Table:
    """The output force, N, and what makes it up: `push_1`, `push_2` (at 1 each) and
    friction's constants, with the measured force in presliding.
    """
    v, turn, slide = _friction(s, shape)
    stick = (1 - slide) * s.F / (1 + shape.delta * np.abs(s.F))
    each = {
        "push_1": -g.force[0] * s.P[:, 0],
        "push_2": g.force[1] * s.P[:, 1],
        "k_cp": -slide * np.maximum(turn, 0),
        "k_cn": -slide * np.minimum(turn, 0),
        "k_0": -slide,
        "k_vp": slide * np.maximum(v, 0),
        "k_vn": slide * np.minimum(v, 0),
        "k_fp": -np.maximum(stick, 0),
        "k_fn": -np.minimum(stick, 0),
    }
    return _force_rows(s, s.F, each, ticks)


FORCE_RIVALS: Mapping[str, tuple[str, ...]] = {
    "payload_inertia": ("inertia",),
    "stribeck": ("stribeck",),
    "film_friction": ("film",),
    "friction_at_rest": ("rest_p", "rest_n"),
    "pressure_friction": ("by_pressure",),
    "friction_drift": ("by_time",),
    "pressure_sensor_bias": ("constant",),
    "loadcell_bias": ("constant",),
    "gravity_load": ("constant", "place", "place_2"),
    "position_friction": ("by_place", "by_place_2", "by_place_3", "by_place_4"),
    "loadcell_lag": ("late_force",),
    "pressure_sensor_lag": ("late_push",),
    "bristle_damping": ("bristle_rate",),
}
"""Columns that stand for what effects on the force do, to first order."""


def force_rivals(s: EvenTicks, g: Geometry, shape: Shape, ticks: int) -> Table:
    """The columns of `FORCE_RIVALS` on the rows of `force_table`."""
    v, turn, slide = _friction(s, shape)
    push = s.P @ np.array([-g.force[0], g.force[1]])
    place = (s.x - s.x.mean()) / max(float(np.std(s.x)), 1e-12)
    t = np.arange(len(s.x)) / len(s.x)
    each = {
        "inertia": np.gradient(v, s.h),
        "stribeck": -slide * turn * np.exp(-((v / 4e-3) ** 2)),
        "film": -slide * np.sign(v) * np.sqrt(np.abs(v)),
        "rest_p": -(1 - slide) * np.maximum(turn, 0),
        "rest_n": -(1 - slide) * np.minimum(turn, 0),
        "by_pressure": -slide * turn * np.sum(s.P, axis=1),
        "by_time": -slide * turn * t,
        "constant": np.ones_like(t),
        "place": place,
        "place_2": place**2,
        "by_place": -slide * turn * place,
        "by_place_2": -slide * turn * place**2,
        "by_place_3": -slide * turn * place**3,
        "by_place_4": -slide * turn * place**4,
        "late_force": np.gradient(s.F, s.h),
        "late_push": np.gradient(push, s.h),
        "bristle_rate": -slide * (v - np.abs(v) * turn),
    }
    return _force_rows(s, s.F, each, ticks)
