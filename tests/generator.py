"""A second plant for the tests: records logs of a rig and shares no code with hydrojax.

Plain NumPy and floats. Valve (12)(13), chambers (10)(11)(14)(15), drive force (16),
friction (1)-(7), output force (22); the loop that drives it uses the inverse valve
(17)-(19) with proportional terms as in (23), without adaptation. SI units throughout.

Sampling: at tick k the sensors are read and the log row is written; the command u of
that row is held until tick k + 1. Between ticks the pressures take SUBSTEPS Heun steps.
The bristle and the filtered speed are at zero when a log begins. Motion is given.

Conventions where an effect's law leaves room: pressures are absolute; viscous, Stribeck
and bristle-damping forces stand inside f_c (3), so they carry the factor 1 - L;
presliding friction sees the piston's force, before gravity and inertia enter; the
command passes play, delay, slew, spool, bias, deadband, in that order; Q_s of the
supply line is the flow through the edge that draws on it, and P_s is logged ahead of
the line; what stretches between piston and encoder feels the piston's force; there
the bristle follows the piston in every substep, what depends on speed sees the piston's
mean one over the last tick (a massless piston would chatter where friction falls with
its own speed) and goes along a line from tick to tick; a film that comes late follows
the speed, whatever its sign, and acts along the bristle; a skewed channel is skewed in
the log only, the loop reads it in time.

Run as `python -m tests.generator --out DIR --seed 3 --effect internal_leakage`.
"""

import argparse
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import expm
from scipy.signal import lfilter

TICK, SUBSTEPS = 1e-3, 20
STEP = TICK / SUBSTEPS
U_MAX = 10.0  # V
NOISE_P, NOISE_F = 9e3, 2.5  # Pa, N
ENCODER = 2 * math.pi / 2**23  # rad
L_SLOPE, L_RATE = 300.0, 10.0  # s/m, 1/s

Rig = dict[str, float]
Effects = dict[str, dict[str, float]]
Log = dict[str, np.ndarray]

# Each effect's first parameter is its strength: at 0 it is absent, or at infinity.
AT_INFINITY = ("valve_lag", "valve_rate_limit", "rod_compliance")
CATALOGUE: Effects = {
    "valve_bias": {"u_0": 0.15},
    "valve_deadband": {"u_db": 0.15},
    "valve_hysteresis": {"u_h": 0.1},
    "valve_delay": {"tau_u": 1.3e-3},
    "valve_lag": {"omega": 2 * math.pi * 60, "zeta": 0.7},
    "valve_rate_limit": {"r_v": 400.0},
    "orifice_transition": {"dP_t": 2e6},
    "underlap": {"u_ul": 0.1},
    "internal_leakage": {"c_il": 1e-12},
    "external_leakage": {"c_el": 3e-13},
    "supply_line_drop": {"k_s": 9e13},
    "dead_volume": {"V_0": 2e-5},
    "entrained_air": {"alpha": 0.005, "n": 1.2, "p_0": 1.013e5},
    "viscous_friction": {"b": 1500.0},
    "stribeck": {"k_st": 250.0, "v_s": 5e-3},
    "bristle_damping": {"sigma_1": 3e4},
    "frictional_lag": {"tau_h": 0.03},
    "pressure_friction": {"kappa": 1.9e-5, "kappa_v": 0.0},
    "position_friction": {"a": 0.15, "wavelength": 0.02},
    "friction_drift": {"a": 0.15, "tau": 8.0},
    "payload_inertia": {"m": 15.0},
    "gravity_load": {"w": 150.0, "psi_0": 0.8},
    "rod_compliance": {"k": 5e7},
    "backlash": {"b": 3e-5, "F_w": 20.0},
    "loadcell_lag": {"tau_F": 3e-3},
    "loadcell_gain": {"eps": 0.02},
    "channel_skew": {"tau_s": -1e-3},
    "pressure_sensor_lag": {"tau_P": 3e-3},
    "pressure_sensor_bias": {"b_1": 1.5e5, "b_2": -1e5},
}
# Truths that no catalogue names: force at a fixed frequency, friction that has grown
# while the piston stood still, a pulsating flow into chamber 1, drag with the speed's
# square.
UNNAMED: Effects = {
    "force_ripple": {"force": 35.0, "frequency": 13.0},
    "dwell": {"a": 0.3, "tau": 2.0, "v_d": 2e-3},
    "flow_pulsation": {"flow": 1.5e-6, "frequency": 7.3},
    "quadratic_drag": {"c": 2e5},
}
TYPICAL = CATALOGUE | UNNAMED

RANGES = {  # name: (unit, lower end, upper end), as in the recorded cases
    "beta": ("Pa", 1e8, 3e9),
    **{c: ("m^3/(s*V*Pa^0.5)", 2e-10, 2e-8) for c in ("c_p1", "c_n1", "c_p2", "c_n2")},
    **{d: ("m", 0.0, 0.05) for d in ("delta_1", "delta_2")},
    **{k: ("N", 0.0, 4000.0) for k in ("k_cp", "k_cn")},
    "k_0": ("N", -800.0, 800.0),
    **{k: ("N*s/m", -3e4, 3e4) for k in ("k_vp", "k_vn")},
    **{k: ("", 0.0, 3.0) for k in ("k_fp", "k_fn")},
    "z_ss": ("m", 2e-6, 5e-4),
    "delta": ("1/N", 1e-4, 1e-2),
}
COLUMNS = {  # signal: (unit, SI value of it, format)
    "time": ("s", 1.0, "%.3f"),
    "u": ("V", 1.0, "%.5f"),
    "psi": ("rad", 1.0, "%.7f"),
    **{p: ("bar", 1e5, "%.4f") for p in ("P_a1", "P_a2", "P_s")},
    **{f: ("kN", 1e3, "%.6f") for f in ("F", "F_d")},
}


def strengths(effects: Effects) -> Effects:
    """Parameters of every effect: those given, typical ones beside, or its absence."""
    if unknown := set(effects) - set(TYPICAL):
        raise KeyError(f"no such effect: {sorted(unknown)}; known: {sorted(TYPICAL)}")
    absent = {
        name: {next(iter(p)): math.inf if name in AT_INFINITY else 0.0}
        for name, p in TYPICAL.items()
    }
    absent["pressure_sensor_bias"]["b_2"] = 0.0
    return {n: TYPICAL[n] | effects.get(n, absent[n]) for n in TYPICAL}


def draw_rig(seed: int) -> Rig:
    """True values, SI, of a random rig near the reference rig."""
    rng = np.random.default_rng([seed, 0])
    while True:
        lands = 2.2e-9 * rng.uniform(0.8, 1.25) * np.exp(rng.uniform(-0.2, 0.2, 4))
        c_p1, c_n1, c_p2, c_n2 = (float(c) for c in lands)
        if all(0.7 < a / b < 1.4 for a, b in ((c_p1, c_n2), (c_p2, c_n1))):
            break  # both chambers settle well between P_r and P_s
    spans = {
        "beta": (6.5e8, 1.1e9),
        **dict.fromkeys(("delta_1", "delta_2"), (8e-3, 25e-3)),
        **dict.fromkeys(("k_cp", "k_cn"), (700.0, 1400.0)),
        "k_0": (-100.0, 100.0),
        **dict.fromkeys(("k_vp", "k_vn"), (2000.0, 5000.0)),
        **dict.fromkeys(("k_fp", "k_fn"), (0.5, 1.1)),
        "z_ss": (50e-6, 80e-6),
        "delta": (1 / 1100, 1 / 700),
    }
    fixed = {"area": 1.18e-3, "chamber_length": 0.2, "radius": 0.085, "P_r": 2.5e5}
    drawn = {name: float(rng.uniform(*span)) for name, span in spans.items()}
    lands = {"c_p1": c_p1, "c_n1": c_n1, "c_p2": c_p2, "c_n2": c_n2}
    return fixed | lands | drawn


def nominal_rig(rig: Rig, seed: int, error: float) -> Rig:
    """What a rig file would say: values off by up to `error`, no offsets known."""
    rng = np.random.default_rng([seed, 1])
    off = {n: float(1 + rng.uniform(-error, error)) for n in RANGES}
    guess = {n: float(f"{v * off.get(n, 1.0):.4g}") for n, v in rig.items()}
    return guess | {"delta_1": 0.015, "delta_2": 0.015, "k_0": 0.0}


def multisine(rng: np.random.Generator, t: np.ndarray, f: np.ndarray, amplitude):
    """Sum of sines of random phase at the frequencies f [Hz]."""
    total = np.zeros_like(t)
    phases = rng.uniform(0, 2 * np.pi, len(f))
    for one, phase, a in zip(f, phases, amplitude, strict=True):
        total += a * np.sin(2 * np.pi * one * t + phase)
    return total


def motion(rng: np.random.Generator, t: np.ndarray) -> CubicSpline:
    """Piston position [m]: moves of up to 30 mm/s, dwells, and a wiggle of 5-30 Hz."""
    where, when = rng.uniform(-0.013, 0.013), rng.uniform(0.1, 0.5)
    x = np.full_like(t, where)
    while when < t[-1]:
        goal = -math.copysign(rng.uniform(0.006, 0.014), where)
        peak = math.exp(rng.uniform(math.log(10e-3), math.log(30e-3)))
        span = max(1.875 * abs(goal - where) / peak, 0.25)
        s = np.clip((t - when) / span, 0, 1)
        x += (goal - where) * s**3 * (10 - 15 * s + 6 * s**2)
        where, when = goal, when + span + rng.uniform(0.1, 2.0)
    f = rng.uniform(5, 30, 50)
    speeds = 1.6e-3 * np.minimum(1, (13 / f) ** 4)  # m/s of each sine
    swell = np.sin(2 * np.pi * t / rng.uniform(4, 7) + rng.uniform(0, 6.28))
    wiggle = multisine(rng, t, f, speeds / (2 * np.pi * f))
    return CubicSpline(t, x + (0.6 + 0.4 * swell) * wiggle)


def supply(rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Supply pressure [Pa]: 11.5 to 16.5 MPa in a slow swing, with some ripple."""
    swing = 2.3e6 * np.sin(2 * np.pi * t / rng.uniform(8, 13) + rng.uniform(0, 6.28))
    ripple = multisine(rng, t, rng.uniform(1, 30, 8), np.full(8, 2e4))
    return 14e6 + swing + ripple + rng.normal(0, 1e4, len(t))


def reference(rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Desired force [N], 0.1 to 20 Hz, some 400 N RMS."""
    f = np.exp(rng.uniform(np.log(0.1), np.log(20), 40))
    amplitude = 1 / (1 + f / 2)
    amplitude *= 400 / math.sqrt(np.sum(amplitude**2) / 2)
    return multisine(rng, t, f, amplitude)


def bristle(x: np.ndarray, z_ss: float) -> np.ndarray:
    """Bristle deflection [m] (4) at each tick, exact in each step's displacement."""
    dx = np.diff(x)
    decay = np.exp(-np.abs(dx) / z_ss)
    gain = np.sign(dx) * z_ss * (1 - decay)
    z, out = 0.0, [0.0]
    for d, g in zip(decay.tolist(), gain.tolist(), strict=True):
        z = z * d + g
        out.append(z)
    return np.array(out[::SUBSTEPS])


def lowpass(y: np.ndarray, rate: float, h: float, start: float) -> np.ndarray:
    """First-order lag of y at `rate` [1/s], sampled every h, beginning at start."""
    e = math.exp(-rate * h)
    mean = (y[1:] + y[:-1]) / 2
    tail = lfilter([1 - e], [1, -e], mean, zi=[e * start])[0]
    return np.concatenate([[start], tail])


def seal(rig: Rig, e: Effects, t, x, v, z, slow, film, rest) -> tuple:
    """Coulomb level [N] at no pressure, its growth with it, the rest of f_c [N], L [-].

    The growth is in N/Pa. Of time [s], place [m], velocity [m/s], bristle [m], filtered
    speed, the film's speed [m/s] and how long the piston has stood still; numbers or
    arrays.
    """
    extra = e["stribeck"]["k_st"] * np.exp(-((film / e["stribeck"]["v_s"]) ** 2))
    level = np.where(z > 0, rig["k_cp"], rig["k_cn"]) + extra
    place, drift = e["position_friction"], e["friction_drift"]
    level = level * (1 + place["a"] * np.sin(2 * np.pi * x / place["wavelength"]))
    level = level * (1 + drift["a"] * (np.exp(-t / drift["tau"]) - 1))
    level = level * (1 + e["dwell"]["a"] * rest)
    seen = v + np.clip(z / rig["z_ss"], -1, 1) * (film - np.abs(v))
    others = rig["k_0"] - np.where(seen > 0, rig["k_vp"], rig["k_vn"]) * seen
    others = others + e["viscous_friction"]["b"] * seen
    others = others + e["quadratic_drag"]["c"] * seen * np.abs(seen)
    rate = v - np.abs(v) * z / rig["z_ss"]
    others = others + e["bristle_damping"]["sigma_1"] * rate
    grows = e["pressure_friction"]
    growth = grows["kappa"] + grows["kappa_v"] * film
    return level, growth, others, 1 / (1 + (L_SLOPE * slow) ** 3)


def standing(e: Effects, v: np.ndarray) -> np.ndarray:
    """How long the piston has stood still, 0 to 1, at each tick."""
    still = 1 / (1 + (v / e["dwell"]["v_d"]) ** 2)
    return lowpass(still, 1 / e["dwell"]["tau"], TICK, 1.0)


def friction(rig: Rig, e: Effects, t, x, v) -> tuple[np.ndarray, ...]:
    """The parts of (3) and (7) that motion alone decides, at each tick.

    Coulomb force [N] at no pressure and its growth [N/Pa], the rest of f_c [N], and L.
    `x` [m] and `v` [m/s] are on the fine grid, `t` [s] at the ticks.
    """
    z, speed = bristle(x, rig["z_ss"]), np.abs(v)
    slow = lowpass(speed, L_RATE, STEP, 0.0)[::SUBSTEPS]
    film, tau_h = speed, e["frictional_lag"]["tau_h"]
    if tau_h:
        film = lowpass(speed, 1 / tau_h, STEP, speed[0])
    x, v, film = x[::SUBSTEPS], v[::SUBSTEPS], film[::SUBSTEPS]
    level, growth, *rest = seal(rig, e, t, x, v, z, slow, film, standing(e, v))
    turn = np.clip(z / rig["z_ss"], -1, 1)
    return turn * level, turn * growth, *rest


def piston_force(drive: float, k_p: float, k_n: float, delta: float) -> float:
    """The F [N] of F + k F / (1 + delta |F|) = drive, k by the sign of F (5)(6)(22).

    Times (1 + delta |F|) it is a quadratic in |F| with one positive root.
    """
    size = abs(drive)
    half = 1 + (k_p if drive > 0 else k_n) - delta * size
    root = 2 * size / (half + math.sqrt(half * half + 4 * delta * size))
    return math.copysign(root, drive)


def pressure_rates(rig: Rig, e: Effects) -> Callable[..., tuple]:
    """The right-hand side of (14)(15) with (12)(13) and the effects on flow, Pa/s."""
    c_p1, c_n1, c_p2, c_n2 = (rig[c] for c in ("c_p1", "c_n1", "c_p2", "c_n2"))
    beta, p_r, sqrt = rig["beta"], rig["P_r"], math.sqrt
    c_il, c_el = e["internal_leakage"]["c_il"], e["external_leakage"]["c_el"]
    k_s = e["supply_line_drop"]["k_s"]
    alpha, n, p_0 = (e["entrained_air"][k] for k in ("alpha", "n", "p_0"))
    lap, laminar = e["underlap"]["u_ul"], e["orifice_transition"]["dP_t"] ** 2

    def root(drop: float) -> float:
        """Square root of a pressure drop, laminar below dP_t."""
        if laminar:
            return drop / (drop * drop + laminar) ** 0.25
        return sqrt(max(drop, 0.0))

    def modulus(p: float) -> float:
        """Bulk modulus [Pa] of oil with air in it."""
        p = max(p, 1e4)
        return 1 / (1 / beta + alpha * (p_0 / p) ** (1 / n) / (n * p))

    def flow(edge: float, drop: float, loss: float) -> float:
        """Q of Q = edge root(drop - loss Q^2), m^3/s."""
        return edge * root(drop / (1 + loss * edge * edge))

    def rates(p1, p2, u, p_s, v1, v2, swept, pulse):
        """Opening u [V], volumes v1, v2 [m^3], swept flow A v [m^3/s]."""
        up, down = max(lap + u, 0.0), max(lap - u, 0.0)
        q1 = q2 = 0.0
        if up:
            q1 += flow(c_p1 * up, p_s - p1, k_s)
            q2 -= flow(c_n2 * up, p2 - p_r, 0.0)
        if down:
            q1 -= flow(c_n1 * down, p1 - p_r, 0.0)
            q2 += flow(c_p2 * down, p_s - p2, k_s)
        cross = c_il * (p1 - p2)
        b1, b2 = (modulus(p1), modulus(p2)) if alpha else (beta, beta)
        q1 += -cross - c_el * (p1 - p_r) + pulse
        q2 += cross - c_el * (p2 - p_r)
        return b1 * (q1 + swept) / v1, b2 * (q2 - swept) / v2

    return rates


def gives(e: Effects) -> bool:
    """Whether anything gives between piston and encoder."""
    return math.isfinite(e["rod_compliance"]["k"]) or e["backlash"]["b"] > 0


class Soft:
    """Chambers, bristle and force where rod or play give, from tick to tick.

    The piston stands s(F) ahead of the encoder. In each substep the pressures go as if
    it did not, and then F is found at which piston, oil and bristle agree. `parts`, as
    from `friction`, grows by one row a tick.
    """

    def __init__(self, rig: Rig, e: Effects, t, x, v):
        self.rig, self.e, self.rates = rig, e, pressure_rates(rig, e)
        self.t, self.x, self.v = t.tolist(), x[::SUBSTEPS].tolist(), v[::SUBSTEPS]
        self.dx = np.diff(x).tolist()
        self.rest = standing(e, self.v)
        self.z = self.slow = 0.0
        self.film = abs(float(self.v[0]))
        self.now = self.seal(0, float(self.v[0]))
        self.parts: tuple[list, ...] = ([0.0], [0.0], *([p] for p in self.now[2:]))

    def start(self, force: float) -> None:
        """At rest under the piston's force [N]."""
        self.force, self.s = force, self.stretch(force)
        self.s_before = self.s

    def stretch(self, force: float) -> float:
        """How far the piston stands ahead of the encoder [m]."""
        play = self.e["backlash"]
        swing = play["b"] / 2 * math.tanh(force / play["F_w"])
        return force / self.e["rod_compliance"]["k"] + swing

    def seal(self, k: int, v: float) -> list[float]:
        """What `seal` returns at tick k, where the piston's speed is v."""
        tau_h = self.e["frictional_lag"]["tau_h"]
        film = self.film if tau_h else abs(v)
        at = (self.t[k], self.x[k], v, self.z, self.slow, film, self.rest[k])
        return [float(part) for part in seal(self.rig, self.e, *at)]

    def tick(self, k: int, p1: float, p2: float, openings, drive):
        """Chamber pressures [Pa] at tick k + 1, from those at tick k."""
        w, self.s_before = (self.s - self.s_before) / TICK, self.s
        ends = np.abs(self.v[k : k + 2] + w)
        self.slow = float(lowpass(ends, L_RATE, TICK, self.slow)[1])
        if tau_h := self.e["frictional_lag"]["tau_h"]:
            self.film = float(lowpass(ends, 1 / tau_h, TICK, self.film)[1])
        before, self.now = self.now, self.seal(k + 1, float(self.v[k + 1]) + w)
        stiff = self.stiffness(p1, p2, openings[0][0], drive[0])
        for j in range(SUBSTEPS):
            part = (j + 1) / SUBSTEPS
            pairs = zip(before, self.now, strict=True)
            parts = [a + part * (b - a) for a, b in pairs]
            free = integrate(self.rates, p1, p2, openings[j : j + 1], drive[j : j + 2])
            p1, p2 = self.settle(free, stiff, parts, self.dx[k * SUBSTEPS + j])
        level, growth, others, ell = self.now
        turn = max(-1.0, min(1.0, self.z / self.rig["z_ss"]))
        now = (turn * level, turn * growth, others, ell)
        for column, value in zip(self.parts, now, strict=True):
            column.append(value)
        return p1, p2

    def stiffness(self, p1, p2, opening, here) -> tuple[float, float]:
        """What a metre of the piston's own changes in the pressures [Pa/m]."""
        p_s, v1, v2, swept, pulse = here
        area = self.rig["area"]
        still = self.rates(p1, p2, opening, p_s, v1, v2, swept, pulse)
        moving = self.rates(p1, p2, opening, p_s, v1, v2, swept + area, pulse)
        return moving[0] - still[0], moving[1] - still[1]

    def settle(self, free, stiff, parts, dx) -> tuple[float, float]:
        """Pressures [Pa] where the force, the stretch and the bristle agree."""
        rig, z_ss = self.rig, self.rig["z_ss"]
        level, growth, others, ell = parts
        level += growth * sum(free) / 2

        def state(force):
            moved = self.stretch(force) - self.s
            way = dx + moved
            keep = math.exp(-abs(way) / z_ss)
            z = self.z * keep + math.copysign(z_ss * (1 - keep), way)
            p1, p2 = free[0] + stiff[0] * moved, free[1] + stiff[1] * moved
            turn = max(-1.0, min(1.0, z / z_ss))
            f_c = turn * level + others
            drive = rig["area"] * (p2 - p1) - (1 - ell) * f_c
            k_p, k_n = ell * rig["k_fp"], ell * rig["k_fn"]
            return force - piston_force(drive, k_p, k_n, rig["delta"]), p1, p2, z

        force = falsi(lambda f: state(f)[0], self.force)
        _, p1, p2, self.z = state(force)
        self.force, self.s = force, self.stretch(force)
        return p1, p2


def falsi(gap: Callable[[float], float], start: float) -> float:
    """The root of a rising function by the Illinois rule; it is met by `start - gap`
    at the latest, where nothing gives.
    """
    a, g_a = start, gap(start)
    if g_a == 0.0:
        return a
    b = a - g_a
    g_b = gap(b)
    for _ in range(60):
        if abs(g_b) < 1e-7 or g_a == g_b:
            break
        c = b - g_b * (b - a) / (g_b - g_a)
        g_c = gap(c)
        if g_c * g_b < 0:
            a, g_a = b, g_b
        else:
            g_a /= 2
        b, g_b = c, g_c
    return b


class Valve:
    """From the command, held over a tick, to the opening [V] in its substeps."""

    def __init__(self, e: Effects):
        self.play, self.dead = e["valve_hysteresis"]["u_h"], e["valve_deadband"]["u_db"]
        self.bias, self.late = e["valve_bias"]["u_0"], e["valve_delay"]["tau_u"] / STEP
        self.held, self.spool = 0.0, np.zeros(2)
        self.past = [0.0] * (int(self.late) + 1)
        self.reach, self.slewed = e["valve_rate_limit"]["r_v"] * STEP, 0.0
        w, zeta = e["valve_lag"]["omega"], e["valve_lag"]["zeta"]
        self.lag = math.isfinite(w)
        if self.lag:
            self.map = expm(STEP * np.array([[0, 1], [-w * w, -2 * zeta * w]])).tolist()

    def opening(self, u: float) -> float:
        """Bias, then deadband [V]."""
        u += self.bias
        return math.copysign(max(abs(u) - self.dead, 0.0), u)

    def openings(self, u: float) -> list[tuple[float, float]]:
        """(opening at the start, at the end) of each substep under the command u."""
        self.held = u = min(max(self.held, u - self.play), u + self.play)
        slews = math.isfinite(self.reach)
        if not self.late and not self.lag and not slews:
            return [(self.opening(u), self.opening(u))] * SUBSTEPS
        part = self.late % 1
        line = self.past + [u] * SUBSTEPS
        self.past = line[SUBSTEPS:]
        steps = range(SUBSTEPS)
        u_late = [(1 - part) * line[j + 1] + part * line[j] for j in steps]
        if slews:
            u_slow = [self.slewed]
            for goal in u_late:
                step = min(max(goal - u_slow[-1], -self.reach), self.reach)
                u_slow.append(u_slow[-1] + step)
            self.slewed = u_slow[-1]
            if not self.lag:
                ends = [self.opening(y) for y in u_slow]
                return list(zip(ends[:-1], ends[1:], strict=True))
            u_late = [(a + b) / 2 for a, b in zip(u_slow[:-1], u_slow[1:], strict=True)]
        if not self.lag:
            return [(o, o) for o in map(self.opening, u_late)]
        (a, b), (c, d) = self.map
        y, w = self.spool
        pairs = []
        for goal in u_late:
            before, gap = y, y - goal
            y, w = goal + a * gap + b * w, c * gap + d * w
            pairs.append((self.opening(before), self.opening(y)))
        self.spool = (y, w)
        return pairs


class ForceLoop:
    """Force controller at 1 kHz after (17)-(19) and (23), knowing the nominal rig."""

    k_p, k_f = 1.0e-3, 2.0e-3  # V/N

    def __init__(self, nominal: Rig):
        self.rig, self.v, self.drag, self.x = nominal, 0.0, 0.0, None

    def command(self, psi, p1, p2, p_s, force, wanted, wanted_rate) -> float:
        """Valve voltage from what the sensors say and the desired force [N, N/s]."""
        r = self.rig
        x = r["radius"] * psi
        self.v += 0.7 * ((x - (x if self.x is None else self.x)) / TICK - self.v)
        self.x = x
        x1 = r["chamber_length"] / 2 + r["delta_1"] - x
        x2 = r["chamber_length"] / 2 + r["delta_2"] + x
        drive = r["area"] * (p2 - p1)
        self.drag += 0.05 * (drive - force - self.drag)
        volts = self.k_p * (wanted + self.drag - drive) + self.k_f * (wanted - force)
        virtual = wanted_rate / r["beta"] + r["area"] * self.v * (1 / x1 + 1 / x2)
        virtual += volts * 1.18e-4  # m^2/s per V
        if virtual < 0:
            up, down = (r["c_p1"], p_s - p1, x1), (r["c_n2"], p2 - r["P_r"], x2)
        else:
            up, down = (r["c_p2"], p_s - p2, x2), (r["c_n1"], p1 - r["P_r"], x1)
        gain = sum(c * math.sqrt(max(dp, 1e5)) / x for c, dp, x in (up, down))
        return min(max(-virtual / gain, -U_MAX), U_MAX)


def sensor_lag(tau: float) -> Callable[[float, float, float], float]:
    """Exact step over a tick of tau m' = y - m [s] for y linear in time."""
    if tau == 0:
        return lambda m, y0, y1: y1
    e = math.exp(-TICK / tau)
    mean = tau / TICK * (1 - e)
    return lambda m, y0, y1: e * m + (mean - e) * y0 + (1 - mean) * y1


def force_at(rig: Rig, parts, given) -> Callable:
    """Force [N] at the load cell at tick k from the chamber pressures there.

    `parts` are friction's, as lists; `given` [N] is what motion and time add behind
    the piston.
    """
    coulomb, growth, others, presliding = parts
    given = given.tolist()

    def force(k: int, p1: float, p2: float) -> float:
        ell = presliding[k]
        f_c = coulomb[k] + growth[k] * (p1 + p2) / 2 + others[k]
        drive = rig["area"] * (p2 - p1) - (1 - ell) * f_c
        k_p, k_n = ell * rig["k_fp"], ell * rig["k_fn"]
        return piston_force(drive, k_p, k_n, rig["delta"]) + given[k]

    return force


def given_force(rig: Rig, e: Effects, t, x, accel) -> np.ndarray:
    """Gravity, inertia [N] and the unnamed ripple, between piston and load cell."""
    load, ripple = e["gravity_load"], e["force_ripple"]
    total = load["w"] * np.sin(x / rig["radius"] + load["psi_0"])
    total -= e["payload_inertia"]["m"] * accel
    return total + ripple["force"] * np.sin(2 * np.pi * ripple["frequency"] * t)


def environment(rig: Rig, e: Effects, t, p_s, x, v) -> list[tuple]:
    """What drives `rates` besides opening and pressures, on the fine grid t [s]."""
    half, spare = rig["chamber_length"] / 2, e["dead_volume"]["V_0"]
    v1 = rig["area"] * (half + rig["delta_1"] - x) + spare
    v2 = rig["area"] * (half + rig["delta_2"] + x) + spare
    hum = e["flow_pulsation"]
    pulse = hum["flow"] * np.sin(2 * np.pi * hum["frequency"] * t)
    columns = (p_s, v1, v2, rig["area"] * v, pulse)
    return list(zip(*(c.tolist() for c in columns), strict=True))


def integrate(rates, p1: float, p2: float, openings, drive) -> tuple[float, float]:
    """Chamber pressures [Pa] a tick later, by Heun's rule."""
    for (start, end), here, there in zip(openings, drive[:-1], drive[1:], strict=True):
        a1, a2 = rates(p1, p2, start, *here)
        b1, b2 = rates(p1 + STEP * a1, p2 + STEP * a2, end, *there)
        p1 += STEP * (a1 + b1) / 2
        p2 += STEP * (a2 + b2) / 2
    return p1, p2


def record(
    rig: Rig, seed: int, seconds: float = 12.0, effects: Effects | None = None
) -> Log:
    """One log, SI: the signals of COLUMNS, one row a tick."""
    e = strengths(effects or {})
    streams = [np.random.default_rng([seed, 2, i]) for i in range(4)]
    count = round(seconds / TICK)
    t, fine = np.arange(count) * TICK, np.arange((count - 1) * SUBSTEPS + 1) * STEP
    path, p_s = motion(streams[0], t), supply(streams[1], t)
    x, v = path(fine), path(fine, 1)
    wanted = reference(streams[2], t)
    noise = streams[3].normal(size=(count, 4)) * [NOISE_P, NOISE_P, NOISE_P, NOISE_F]
    psi = np.round(path(t) / rig["radius"] / ENCODER) * ENCODER
    given = given_force(rig, e, t, path(t), path(t, 2))
    soft = Soft(rig, e, t, x, v) if gives(e) else None
    parts = soft.parts if soft else [p.tolist() for p in friction(rig, e, t, x, v)]
    force = force_at(rig, parts, given)
    drive = environment(rig, e, fine, np.interp(fine, t, p_s), x, v)

    rates, valve = pressure_rates(rig, e), Valve(e)
    loop = ForceLoop(nominal_rig(rig, 0, 0.1))
    sensor_p = sensor_lag(e["pressure_sensor_lag"]["tau_P"])
    sensor_f = sensor_lag(e["loadcell_lag"]["tau_F"])
    share = 1 + e["loadcell_gain"]["eps"]
    b_1, b_2 = (e["pressure_sensor_bias"][b] for b in ("b_1", "b_2"))
    inputs = (psi, noise, p_s, wanted, np.gradient(wanted, TICK))
    p1, p2 = start_pressures(rig, float(p_s[0]), float(wanted[0] - given[0]))
    past = seen = (p1, p2, force(0, p1, p2))
    if soft:
        soft.start(past[2] - float(given[0]))
    rows = []
    ticks = zip(*(i.tolist() for i in inputs), strict=True)
    for k, (angle, n, line, *goal) in enumerate(ticks):
        now = (p1, p2, force(k, p1, p2))
        lags = zip((sensor_p, sensor_p, sensor_f), seen, past, now, strict=True)
        seen, past = tuple(lag(*m) for lag, *m in lags), now
        truth = (seen[0] + b_1, seen[1] + b_2, line, share * seen[2])
        read = [value + error for value, error in zip(truth, n, strict=True)]
        rows.append((loop.command(angle, *read, *goal), *read))
        openings = valve.openings(rows[-1][0])
        here = drive[k * SUBSTEPS : (k + 1) * SUBSTEPS + 1]
        if k + 1 == count:
            break
        if soft:
            p1, p2 = soft.tick(k, p1, p2, openings, here)
        else:
            p1, p2 = integrate(rates, p1, p2, openings, here)
    u, p_a1, p_a2, p_line, measured = np.array(rows).T
    if skew := e["channel_skew"]["tau_s"]:
        error = noise[:, 3]
        measured = CubicSpline(t, measured - error)(t + skew) + error
    signals = (t, u, psi, p_a1, p_a2, p_line, measured, wanted)
    return dict(zip(COLUMNS, signals, strict=True))


def start_pressures(rig: Rig, p_s: float, force: float):
    """Pressures [Pa] that hold the force [N] at L = 1, chamber 1 at half of P_s."""
    k_f = rig["k_fp"] if force > 0 else rig["k_fn"]
    drive = force + k_f * force / (1 + rig["delta"] * abs(force))
    return p_s / 2, p_s / 2 + drive / rig["area"]


def write_log(path: Path, log: Log) -> None:
    """The log as CSV, in the units of COLUMNS."""
    header = ",".join(f"{name} [{unit}]" for name, (unit, *_) in COLUMNS.items())
    table = np.column_stack([log[n] / size for n, (_, size, _) in COLUMNS.items()])
    formats = [form for *_, form in COLUMNS.values()]
    np.savetxt(path, table, formats, ",", header=header, comments="")


def rig_file(name: str, nominal: Rig) -> str:
    """The rig file, TOML, of a nominal rig."""
    lines = [
        f'name = "{name}"\nlayout = "pull-pull"\n\n[geometry]',
        f'area = "{nominal["area"]} m^2"',
        f'chamber_length = "{nominal["chamber_length"]} m"',
        f'radius = "{nominal["radius"]} m"',
        f'\n[supply]\nP_s = "1.4e+07 Pa"\nP_r = "{nominal["P_r"]:g} Pa"',
        '\n[sensors]\nP_a1 = "9 kPa"\nP_a2 = "9 kPa"\nF = "2.5 N"\n\n[parameters]',
    ]
    for parameter, (unit, *ends) in RANGES.items():
        start, *span = (f"{v:g} {unit}".strip() for v in (nominal[parameter], *ends))
        bounds = json.dumps(span)
        lines.append(f'{parameter} = {{ start = "{start}", range = {bounds} }}')
    return "\n".join(lines) + "\n"


def write_case(
    folder: str | Path,
    seed: int,
    effects: Effects | None = None,
    seconds: float = 12.0,
    nominal_error: float = 0.25,
) -> None:
    """Write rig.toml, fit_1.csv, fit_2.csv, validate.csv and truth.json to a folder."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    rig, effects = draw_rig(seed), effects or {}
    nominal = nominal_rig(rig, seed, nominal_error)
    (folder / "rig.toml").write_text(rig_file(folder.name, nominal))
    for i, name in enumerate(("fit_1", "fit_2", "validate")):
        log = record(rig, 1000 * seed + i, seconds, effects)
        write_log(folder / f"{name}.csv", log)
    full = {name: strengths(effects)[name] for name in effects}
    truth = {"seed": seed, "rig": rig, "effects": full}
    (folder / "truth.json").write_text(json.dumps(truth, indent=2) + "\n")


def main(arguments: list[str] | None = None) -> None:
    """Command line: write one case."""
    parser = argparse.ArgumentParser(description="Record the logs of a random rig.")
    parser.add_argument("--out", required=True, metavar="DIR")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=12.0)
    parser.add_argument("--nominal-error", type=float, default=0.25)
    parser.add_argument("--effect", action="append", default=[], choices=TYPICAL)
    given = parser.parse_args(arguments)
    effects = {name: TYPICAL[name] for name in given.effect}
    write_case(given.out, given.seed, effects, given.seconds, given.nominal_error)


if __name__ == "__main__":
    main()
