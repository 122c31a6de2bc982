"""The plant's equations: spool, edges, pump, line, chambers and a lever with a load.

Each function takes floats, or arrays of shape [lanes] in every field: the same text is
compiled by Numba for one lane and run by NumPy over many. So no branches, only masks.
SI, pressures over the atmosphere; x grows as the cylinder extends, and chamber 2 with
it. A positive command feeds chamber 1: it retracts.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np


def choose(where, yes, no):
    """Of `yes` and `no` by a mask."""
    return np.where(where, yes, no)


try:
    from numba.extending import overload, register_jitable  # pyright: ignore
except ImportError:  # Numba is optional: NumPy then runs the same text, slowly.

    def register_jitable(function):
        """Leave a function as it is."""
        return function

else:

    @overload(choose)
    def _choose_one(where, yes, no):
        """For floats: Numba's own `where` makes an array of each."""
        return lambda where, yes, no: yes if where else no


ATMOSPHERE = 101325.0
THINNEST = 2e3
"""Absolute pressure, Pa, below which oil and its gas grow no softer."""

POLYTROPE = 1.2
CORE = 5e4
"""Drop, Pa, below which an edge is laminar."""

CHECK_CORE = 3e5
"""Drop, Pa, below which a check valve has not opened fully."""

CREEP = 2e-3
"""Speed, m/s, at which smoothed Coulomb friction is at 70 %."""

STOP = 2e8
"""Stiffness of the end stops, N/m."""

STOP_LOSS = 5.0
"""Their damping: the force grows by this much of itself per m/s, s/m."""


class Parameters(NamedTuple):
    """One machine under one load. Floats, or arrays [lanes].

    `holding` is 1 where chamber 2 bears the load, 0 where chamber 1 does. Flags
    (`compensated`, `has_line`, `senses`) are 0 or 1. An effect's absent value is in
    `sizes.ABSENT`.
    """

    A_1: Any  # m^2, rod side
    A_2: Any  # m^2
    stroke: Any  # m
    V_1: Any  # m^3, dead volume beside the stroke's
    V_2: Any
    beta: Any  # Pa
    alpha: Any  # share of air at the atmosphere
    c_p1: Any  # m^3/(s sqrt(Pa)) at full opening
    c_n1: Any
    c_p2: Any
    c_n2: Any
    u_dbp: Any  # share of full command
    u_dbn: Any
    o_n1: Any  # overlap of an edge to the return beyond that of its partner
    o_n2: Any
    omega: Any  # rad/s
    zeta: Any
    r_v: Any  # 1/s
    k: Any  # flow curve
    p: Any
    compensated: Any
    dP_c: Any  # Pa
    has_line: Any
    holding: Any
    P_set: Any  # Pa
    ratio: Any
    dP_full: Any  # Pa
    c_out: Any  # m^3/(s sqrt(Pa)), over-centre valve full open
    c_check: Any  # its check valve
    V_line: Any  # m^3
    tau_pilot: Any  # s
    c_il: Any  # m^3/(s Pa)
    senses: Any
    P_max: Any  # Pa, the pump's constant or highest pressure
    margin: Any  # Pa
    P_least: Any  # Pa
    sag: Any  # Pa s/m^3
    tau_pump: Any  # s
    P_r: Any  # Pa
    arm_a: Any  # m, pivot to the cylinder's far pin
    arm_b: Any  # m, pivot to its pin on the boom
    length: Any  # m, between pins, retracted
    cos_0: Any  # direction of the load's lever, from arm_a
    sin_0: Any
    inertia: Any  # kg m^2 about the pivot
    moment: Any  # N m, weight times lever; positive pushes the rod in
    coulomb: Any  # N
    viscous: Any  # N s/m


class State(NamedTuple):
    """What is integrated. Floats, or arrays [lanes]."""

    spool: Any  # share of its stroke
    spool_rate: Any  # 1/s
    P_1: Any  # Pa
    P_2: Any
    P_line: Any
    P_s: Any
    P_pilot: Any
    x: Any  # m
    v: Any  # m/s


@register_jitable
def root(drop, core):
    """Signed square root, linear below `core`: at ten times it, 0.25 % too small."""
    return drop / np.sqrt(np.sqrt(drop * drop + core * core))


@register_jitable
def stiffness(pressure, beta, alpha):
    """Bulk modulus of oil with free air, Pa: bubbles are polytropic, none dissolves."""
    absolute = np.maximum(pressure + ATMOSPHERE, THINNEST)
    air = alpha * (ATMOSPHERE / absolute) ** (1.0 / POLYTROPE)
    return 1.0 / (1.0 / beta + air / (POLYTROPE * absolute))


@register_jitable
def opening(spool, p):
    """Opening of the edges at a spool position, 0 to 1: overlap, then notches."""
    return notched(choose(spool > 0.0, spool - p.u_dbp, -spool - p.u_dbn), p)


@register_jitable
def notched(past, p):
    """Opening of an edge whose land is passed by so much of the spool's stroke."""
    share = np.maximum(past, 0.0)
    return share * (1.0 - p.k + p.k * share ** (p.p - 1.0))


@register_jitable
def metered_in(P_s, port, p):
    """Root of the drop that drives flow in, sqrt(Pa).

    A compensator ahead of the edge takes what exceeds its margin, and its check valve
    holds the load where the supply stands below it.
    """
    drop = P_s - port
    held = np.minimum(np.maximum(drop, 0.0), p.dP_c)
    return root(choose(p.compensated > 0.0, held, drop), CORE)


@register_jitable
def over_centre(P_load, P_pilot, P_line, p):
    """Flow from the load's chamber to the line, m^3/s."""
    lifted = (P_load + p.ratio * P_pilot - p.P_set) / p.dP_full
    out = p.c_out * np.minimum(np.maximum(lifted, 0.0), 1.0)
    drop = P_load - P_line
    outward = out * root(np.maximum(drop, 0.0), CORE)
    return outward + p.c_check * root(np.minimum(drop, 0.0), CHECK_CORE)


@register_jitable
def lever(x, p):
    """The boom at a stroke x: its arm, the weight's force on the rod, what it weighs.

    By the triangle of pivot and pins. Returns the arm r = dL/dangle in m, the force in
    N that the weight puts on the rod, and dr/dangle in m.
    """
    length = p.length + x
    both = p.arm_a * p.arm_b
    cos = (p.arm_a**2 + p.arm_b**2 - length * length) / (2.0 * both)
    sin = np.sqrt(np.maximum(1.0 - cos * cos, 1e-6))
    arm = both * sin / length
    change = (both * cos - arm * arm) / length
    weight = p.moment * (cos * p.cos_0 + sin * p.sin_0) / arm
    return arm, weight, change


@register_jitable
def acceleration(s, p):
    """Of the piston, m/s^2."""
    arm, weight, change = lever(s.x, p)
    friction = p.coulomb * s.v / np.sqrt(s.v * s.v + CREEP * CREEP) + p.viscous * s.v
    low, high = np.maximum(-s.x, 0.0), np.maximum(s.x - p.stroke, 0.0)
    stop = low * np.maximum(1.0 - STOP_LOSS * s.v, 0.0)
    stop = STOP * (stop - high * np.maximum(1.0 + STOP_LOSS * s.v, 0.0))
    force = p.A_2 * s.P_2 - p.A_1 * s.P_1 - weight - friction + stop
    spin = s.v / arm
    return force * arm * arm / p.inertia + change * spin * spin


@register_jitable
def rates(s, p, u):
    """Time derivative of every state under a command u."""
    target = np.minimum(np.maximum(u, -1.0), 1.0)
    moved = np.minimum(np.maximum(s.spool_rate, -p.r_v), p.r_v)
    pushed = p.omega * (p.omega * (target - s.spool) - 2.0 * p.zeta * s.spool_rate)

    # Where an over-centre valve stands, the edge sees the line and not the chamber.
    load = choose(p.holding > 0.0, s.P_2, s.P_1)
    port_1 = choose(p.has_line * (1.0 - p.holding) > 0.0, s.P_line, s.P_1)
    port_2 = choose(p.has_line * p.holding > 0.0, s.P_line, s.P_2)

    # One edge feeds at a time; both may drain, where one is open at centre.
    right = s.spool > 0.0
    area = opening(s.spool, p)
    fed = choose(right, port_1, port_2)
    Q_in = area * choose(right, p.c_p1, p.c_p2) * metered_in(s.P_s, fed, p)
    out_1 = notched(-s.spool - p.u_dbn - p.o_n1, p) * p.c_n1
    out_2 = notched(s.spool - p.u_dbp - p.o_n2, p) * p.c_n2
    Q_1 = choose(right, Q_in, 0.0) - out_1 * root(port_1 - p.P_r, CORE)
    Q_2 = choose(right, 0.0, Q_in) - out_2 * root(port_2 - p.P_r, CORE)

    Q_load = p.has_line * over_centre(load, s.P_pilot, s.P_line, p)
    Q_edge = choose(p.holding > 0.0, Q_2, Q_1)
    line = stiffness(s.P_line, p.beta, p.alpha) / p.V_line
    dP_line = p.has_line * line * (Q_edge + Q_load)
    Q_1 = choose(p.has_line * (1.0 - p.holding) > 0.0, -Q_load, Q_1)
    Q_2 = choose(p.has_line * p.holding > 0.0, -Q_load, Q_2)

    leak = p.c_il * (s.P_1 - s.P_2)
    soft_1 = stiffness(s.P_1, p.beta, p.alpha) / (p.V_1 + p.A_1 * (p.stroke - s.x))
    soft_2 = stiffness(s.P_2, p.beta, p.alpha) / (p.V_2 + p.A_2 * s.x)
    dP_1 = soft_1 * (Q_1 + p.A_1 * s.v - leak)
    dP_2 = soft_2 * (Q_2 - p.A_2 * s.v + leak)

    sensed = choose(area > 0.0, fed, p.P_r) + p.margin
    sensed = np.minimum(np.maximum(sensed, p.P_least), p.P_max)
    wanted = choose(p.senses > 0.0, sensed, p.P_max)
    dP_s = (wanted - p.sag * Q_in - s.P_s) / p.tau_pump
    pilot = choose(p.holding > 0.0, s.P_1, s.P_2)
    dP_pilot = (pilot - s.P_pilot) / p.tau_pilot
    return State(
        moved, pushed, dP_1, dP_2, dP_line, dP_s, dP_pilot, s.v, acceleration(s, p)
    )
