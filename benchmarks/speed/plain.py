"""The model in plain Python floats: what numba compiles, and what scipy integrates.

Every function takes the numbers `p` of one instance, with a field for each (`record`),
and works on scalars; SI.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np

from hydrojax.control.base import Estimates
from hydrojax.control.inverting import LEAST_DROP
from hydrojax.control.loop import Loop
from hydrojax.plant.valve import LAMINAR_CORE

from .numbers import Numbers, numbers

try:
    from numba.extending import register_jitable as jitable
except ImportError:  # the functions are then Python's own

    def jitable(function):
        """As it is."""
        return function


CORE = LAMINAR_CORE**2
BOUNDS = ("rate", "lower", "upper")


def records(given: Numbers) -> np.ndarray:
    """The numbers of B instances as a structured array [B], the nine together."""
    alone = [n for n in given if not n.startswith(tuple(f"{b}_" for b in BOUNDS))]
    kinds = [(n, "f8") for n in alone] + [(b, "f8", (9,)) for b in BOUNDS]
    out = np.zeros(np.size(given[alone[0]]), kinds)
    for name in alone:
        out[name] = given[name]
    if f"rate_{Estimates._fields[0]}" in given:
        for bound in BOUNDS:
            columns = [np.atleast_1d(given[f"{bound}_{e}"]) for e in Estimates._fields]
            out[bound] = np.stack(columns, axis=1)
    return out


def record(loop: Loop) -> SimpleNamespace:
    """The numbers of one instance, as Python floats and arrays [9]."""
    row = records(numbers(loop))[0]
    return SimpleNamespace(
        **{n: row[n] if n in BOUNDS else float(row[n]) for n in row.dtype.names}
    )


@jitable
def root_flow(drop):
    """Signed root of a pressure drop with a laminar core, Pa^0.5."""
    return drop / math.sqrt(math.sqrt(drop * drop + CORE))


@jitable
def root_slope(drop):
    """The derivative of `root_flow`."""
    a = drop * drop + CORE
    per = 1 / math.sqrt(math.sqrt(a))
    return per * (0.5 + 0.5 * CORE / a)


@jitable
def bristle(z, dx, z_ss):
    """The bristle after a displacement."""
    if dx == 0.0:
        return z
    keep = math.exp(-abs(dx) / z_ss)
    return keep * z + math.copysign(z_ss, dx) * (1 - keep)


@jitable
def switched(speed, slope):
    """L(t)."""
    return 1 / (1 + (slope * speed) ** 3)


@jitable
def clipped(value, lower, upper):
    """`value` within its bounds."""
    return min(max(value, lower), upper)


@jitable
def output_force(p, drive):
    """F of (22) from `(L, P - (1 - L) f_c)`."""
    L, net = drive
    size = abs(net)
    b = 1 + L * (p.k_fp if net > 0 else p.k_fn) - p.delta * size
    disc = math.sqrt(b * b + 4 * p.delta * size)
    F = 2 * size / (b + disc) if b > 0 else (disc - b) / (2 * p.delta)
    return math.copysign(F, net)


@jitable
def force(p, P_1, P_2, z, speed, v):
    """The output force of the plant."""
    turn = clipped(z / p.z_ss, -1.0, 1.0)
    level = p.k_cp if z > 0 else p.k_cn
    f_c = turn * level + p.k_0 - (p.k_vp if v > 0 else p.k_vn) * v
    L = switched(speed, p.L_slope)
    P = p.act_2 * P_2 - p.act_1 * P_1
    return output_force(p, (L, P - (1 - L) * f_c))


@jitable
def pressure_rates(p, open_p, open_n, P, line, x, v):
    """Rates of the pressures `P`; `line` is (P_s, P_r), the openings are >= 0."""
    (P_1, P_2), (P_s, P_r) = P, line
    q_1 = q_2 = 0.0
    if open_p > 0:
        q_1 += open_p * p.d_p1 * root_flow(P_s - P_1)
        q_2 -= open_p * p.d_n2 * root_flow(P_2 - P_r)
    if open_n > 0:
        q_1 -= open_n * p.d_n1 * root_flow(P_1 - P_r)
        q_2 += open_n * p.d_p2 * root_flow(P_s - P_2)
    return p.beta * (q_1 + v) / (p.half_1 - x), p.beta * (q_2 - v) / (p.half_2 + x)


@jitable
def settling_rates(p, open_p, open_n, P, line, x):
    """Twice the slopes by which the pressures settle, 1/s; see `pressure_rates`."""
    (P_1, P_2), (P_s, P_r) = P, line
    b_1 = b_2 = 0.0
    if open_p > 0:
        b_1 += open_p * p.d_p1 * root_slope(P_s - P_1)
        b_2 += open_p * p.d_n2 * root_slope(P_2 - P_r)
    if open_n > 0:
        b_1 += open_n * p.d_n1 * root_slope(P_1 - P_r)
        b_2 += open_n * p.d_p2 * root_slope(P_s - P_2)
    return 2 * p.beta * b_1 / (p.half_1 - x), 2 * p.beta * b_2 / (p.half_2 + x)


@jitable
def relaxed(z):
    """The share of a slope that is run along it while it settles: (1 - e^-z) / z."""
    beyond = z * (1 / 2 + z / 6)
    return (1 + beyond) / (1 + z * (1 + beyond))


@jitable
def pressure_step(p, open_p, open_n, P, line, middle, x, h):
    """Both pressures after `h` seconds by the exponential midpoint rule.

    `x` is (start, middle, end); `line` and `middle` are (P_s, P_r) at the first two.
    """
    v = (x[2] - x[0]) / h
    a_1, a_2 = pressure_rates(p, open_p, open_n, P, line, x[0], v)
    b_1, b_2 = settling_rates(p, open_p, open_n, P, line, x[0])
    m_1, m_2 = h / 2 * relaxed(b_1 * h / 2) * a_1, h / 2 * relaxed(b_2 * h / 2) * a_2
    half = P[0] + m_1, P[1] + m_2
    a_1, a_2 = pressure_rates(p, open_p, open_n, half, middle, x[1], v)
    return (
        P[0] + h * relaxed(b_1 * h) * (a_1 + b_1 * m_1),
        P[1] + h * relaxed(b_2 * h) * (a_2 + b_2 * m_2),
    )


@jitable
def spool_step(p, y, rate, u):
    """The spool over a part: its place, its rate, its mean opening."""
    off = y - u
    off_new, rate_new = p.yy * off + p.yr * rate, p.ry * off + p.rr * rate
    mean = u + p.m_y * (off - off_new) + p.m_r * (rate - rate_new)
    return u + off_new, rate_new, mean


@jitable
def quantised(x, step):
    """`x` as the encoder has it; ties go to the even step."""
    return np.rint(x / step) * step if step > 0 else x


@jitable
def desired(p, e, z, v, L, F, row):
    """P_d of (24)(25); the row of (26) is written to `row` [7]."""
    g = clipped(z * p.n_per_z_ss, -1.0, 1.0)
    stick = L * F / (1 + p.n_delta * abs(F))
    row[:] = 0.0
    row[0 if z > 0 else 1] = (1 - L) * g
    row[2] = 1 - L
    row[3 if v > 0 else 4] = -(1 - L) * v
    row[5 if F > 0 else 6] = stick
    P_d = F
    for i in range(7):
        P_d += row[i] * e[2 + i]
    return P_d


@jitable
def begin(p, F, x, v, e, row):
    """At rest: pressures, force and the law's memory; the estimates go to `e` [9]."""
    k_f = p.k_fp if F > 0 else p.k_fn
    P = F + k_f * F / (1 + p.delta * abs(F))
    P_1 = p.P_start
    P_2 = (P + p.act_1 * P_1) / p.act_2
    for i in range(9):
        e[i] = (p.lower[i] + p.upper[i]) / 2
    P_d = desired(p, e, 0.0, 0.0, 1.0, F, row)
    seen = quantised(x, p.noise_step)
    return P_1, P_2, force(p, P_1, P_2, 0.0, 0.0, v), (seen, 0.0, 0.0, 0.0, P_d, 0.0)


@jitable
def decide(p, memory, e, row, truth, F_d, noise, h):
    """The law at one sample: its memory and command; the estimates `e` [9] learn.

    `truth` is (P_a1, P_a2, P_s, F, x) before noise.
    """
    P_1, P_2, P_s, F, x = truth
    P_1, P_2 = P_1 + p.noise_P_a1 * noise[0], P_2 + p.noise_P_a2 * noise[1]
    P_s, lack = P_s + p.noise_P_s * noise[2], F_d - (F + p.noise_F * noise[3])
    x = quantised(x, p.noise_step)

    x_old, v_old, z, speed, P_d_old, rate_old = memory
    dx = x - x_old
    v = (p.tau_v * v_old + dx) / (p.tau_v + h)
    z = bristle(z, dx, p.n_z_ss)
    speed = p.n_keep * speed + (1 - p.n_keep) * abs(dx) / h
    P_d = desired(p, e, z, v, switched(speed, p.n_L_slope), F_d, row)
    P_d_rate = (p.tau_d * rate_old + P_d - P_d_old) / (p.tau_d + h)
    miss = P_d - (p.n_act_2 * P_2 - p.n_act_1 * P_1)
    x_1, x_2 = p.n_half_1 - x, p.n_half_2 + x
    swept = (p.chi_1 / x_1 + p.chi_2 / x_2) * v
    virtual = e[0] * P_d_rate + e[1] * swept + p.k_p * miss + p.k_f * lack

    lead_0, lead_1 = miss * P_d_rate, miss * swept
    e[0] = clipped(e[0] + h * p.rate[0] * lead_0, p.lower[0], p.upper[0])
    e[1] = clipped(e[1] + h * p.rate[1] * lead_1, p.lower[1], p.upper[1])
    for i in range(2, 9):
        new = e[i] + h * p.rate[i] * lack * row[i - 2]
        e[i] = clipped(new, p.lower[i], p.upper[i])
    return (x, v, z, speed, P_d, P_d_rate), command(p, virtual, P_1, P_2, P_s, x_1, x_2)


@jitable
def command(p, virtual, P_1, P_2, P_s, x_1, x_2):
    """u* of (18), saturated."""
    if virtual < 0:
        gain = p.up_1 * math.sqrt(max(P_s - P_1, LEAST_DROP)) / x_1
        gain += p.up_2 * math.sqrt(max(P_2 - p.P_return, LEAST_DROP)) / x_2
    else:
        gain = p.down_1 * math.sqrt(max(P_1 - p.P_return, LEAST_DROP)) / x_1
        gain += p.down_2 * math.sqrt(max(P_s - P_2, LEAST_DROP)) / x_2
    return clipped(-virtual / gain, -p.u_max, p.u_max)
