"""Servovalve, two chambers, friction and sensors of a hydraulic cylinder whose motion
is imposed.

The equations are those of Zhu, Dupuis and Piedboeuf (adaptive output force control of
hydraulic cylinders); numbers in parentheses are theirs. SI units throughout, volts for
the command. Every departure from the paper is a field of `Plant` with a value at which
it is exactly absent (`ABSENT`).

Choices where a law leaves freedom:
- order on the command: delay, null bias, hysteresis (play), spool stiction, rate limit,
  spool lag, flow curve, and only then the lands' overlaps (they sit at the ports,
  behind the spool);
- an edge's opening is max(u - o, 0), o its overlap; underlap is o < 0 on all four
  edges, so the flow gain doubles inside the underlap (Merritt) and the openings keep
  the extra width outside of it;
- pressures are gauge; the absolute pressure in the entrained-air law is P + 1 atm;
- the supply drop acts on the flow through both supply edges, and is solved for at every
  evaluation;
- Stribeck and pressure add to the Coulomb level k_c; position and drift multiply that
  sum. All of f_c, viscous and bristle damping too, is gated by 1 - L as in (7). Bristle
  damping and speed terms see the encoder's speed;
- frictional lag: the film, and with it the speed in the Stribeck and phi(v) v terms, is
  |v| seen through tau_h;
- payload and gravity act between piston and cell, and the F of (5)(6) is the force in
  the load cell;
- the rod is a Kelvin-Voigt solid, F = k y + k tau y', tau = 0.1 ms; volumes, bristles
  and the gate L see x + y;
- backlash: the piston crosses the gap with no force in the cell, held back only by a
  thin film;
- pressure bias and load cell gain come after the sensors' lags.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

ATM = 101325.0
CORE = 1e3  # Pa, laminar core of an orifice in the rig without faults
ROD_TAU = 1e-4  # s, loss of a compliant rod
# N/m, of the contact behind a backlash where the rod itself is rigid
PIN_STIFFNESS = 1e10
FILM = 5e3  # N s/m, film that slows the piston inside a backlash gap
N_STATE = 17
FINE = 10  # outputs per sample


class Plant(NamedTuple):
    """True constants of a rig (SI), faults included."""

    # the paper's rig
    area_1: float  # m^2, 0 for a single chamber
    area_2: float
    length: float  # m
    delta_1: float
    delta_2: float
    radius: float  # m
    P_r: float  # Pa
    u_max: float  # V
    beta: float  # Pa
    c_p1: float  # m^3/(s V Pa^0.5)
    c_n1: float
    c_p2: float
    c_n2: float
    k_cp: float  # N
    k_cn: float
    k_0: float
    k_vp: float  # N s/m
    k_vn: float
    k_fp: float
    k_fn: float
    z_ss: float  # m
    delta: float  # 1/N
    # command
    u_0: float = 0.0  # V, null bias
    # V, overlap of each edge: supply to 1, 1 to return, supply to 2, 2 to return
    o_p1: float = 0.0
    o_n1: float = 0.0
    o_p2: float = 0.0
    o_n2: float = 0.0
    u_h: float = 0.0  # V, half-width of the play
    tau_u: float = 0.0  # s
    omega_v: float = np.inf  # rad/s
    zeta_v: float = 0.7
    r_v: float = np.inf  # V/s
    e_u: float = 1.0  # exponent of the flow curve
    u_st: float = 0.0  # V, spool stiction
    # flow
    dP_t: float = 0.0  # Pa
    c_il: float = 0.0  # m^3/(s Pa)
    c_el: float = 0.0
    k_s: float = 0.0  # Pa s^2/m^6
    s_pc: float = 0.0  # pressure compensation, 0 to 1
    dP_pc: float = 6e5  # Pa, its margin
    pc_all: float = 0.0  # 1: compensated on all four edges, 0: on the supply edges
    cb_chamber: float = 0.0  # counterbalance on chamber 1 or 2, 0 for none
    cb_ratio: float = 3.0  # pilot ratio
    cb_set: float = 0.0  # Pa
    cb_span: float = 1e6  # Pa from closed to full
    cb_c: float = 0.0  # m^3/(s Pa^0.5) at full opening
    k_q: float = 0.0  # 1/Pa, flow force: opening / (1 + k_q dP)
    R_r: float = 0.0  # Pa s^2/m^6, return line drop
    c_w: float = 0.0  # m^3/(s Pa), worn groove between the chambers around x_w
    x_w: float = 0.0
    w_w: float = 0.01
    # m^3/(s Pa^2), rod gland leak of chamber 2, grows with pressure squared and with x
    c_g: float = 0.0
    # fluid
    V_0: float = 0.0  # m^3
    alpha: float = 0.0
    n_air: float = 1.2
    a_warm: float = 0.0  # beta falls by this share with tau_warm
    tau_warm: float = 10.0
    V_h: float = 0.0  # m^3 at the valve end of each hose
    I_h: float = 1e7  # kg/m^4, inertance
    R_h: float = 0.0  # Pa s/m^3
    P_vap: float = -1e5  # Pa gauge
    # friction
    b: float = 0.0  # N s/m
    k_st: float = 0.0  # N
    v_s: float = 0.01  # m/s
    sigma_1: float = 0.0  # N s/m
    tau_h: float = 0.0  # s
    kappa: float = 0.0  # N/Pa
    kappa_v: float = 0.0  # N s/(m Pa)
    a_x: float = 0.0  # position: level (1 + a_x sin(2 pi x/lambda_x + phase_x))
    lambda_x: float = 0.1
    phase_x: float = 0.0
    a_t: float = 0.0
    tau_t: float = 10.0
    k_d: float = 0.0  # N, static level gained in a long dwell
    tau_d: float = 2.0
    z_d: float = 1e-3  # m of travel that wipe it out
    # force path
    m: float = 0.0  # kg
    w: float = 0.0  # N
    psi_0: float = 0.0
    k_rod: float = np.inf  # N/m
    gap: float = 0.0  # m
    k_g: float = 0.0  # N, sticking guide between piston and cell, around x_g
    z_g: float = 3e-4
    x_g: float = 0.0
    w_g: float = 0.03
    k_stop: float = 0.0  # N/m
    x_stop: float = 1.0
    # 1/rad^2, lever: piston at radius (psi + r_2 psi^3), rod speed to match
    r_2: float = 0.0
    # sensors
    tau_F: float = 0.0
    eps_F: float = 0.0
    tau_P: float = 0.0
    b_1: float = 0.0
    b_2: float = 0.0
    h_F: float = 0.0  # share of the load cell's hysteresis
    d_F: float = 100.0  # N, its half-width
    hum_1: float = 0.0  # Pa, mains hum on P_a1
    f_hum: float = 50.0


class Control(NamedTuple):
    """Force loop: the rate of force it asks for, and the constants it believes in."""

    K: float  # rad/s
    K_i: float  # rad^2/s^2
    preview: float  # s
    k_c: float  # N of Coulomb friction fed forward
    beta: float
    c: float


ABSENT = Plant._field_defaults


@njit(cache=True)
def _edge(c, k, o, dP, compensated):
    """Flow [m^3/s] through one metering edge of gain `k` and opening `o` [V] under the
    drop `dP` [Pa], signed.
    """
    if o <= 0.0:
        return 0.0
    o = o / (1.0 + c.k_q * abs(dP))
    if compensated and c.s_pc > 0.0 and dP > c.dP_pc:
        return k * o * np.sqrt(dP ** (1.0 - c.s_pc) * c.dP_pc**c.s_pc)
    core = max(CORE, c.dP_t)
    return k * o * dP / (dP * dP + core * core) ** 0.25


@njit(cache=True)
def _drain(c, k, o, P, P_pilot, P_r, guarded):
    """Flow [m^3/s] out of a chamber to return; a counterbalance valve stands in series
    where `guarded`.
    """
    if guarded and P_r < P and o > 0.0:
        x = min(max((P + c.cb_ratio * P_pilot - c.cb_set) / c.cb_span, 0.0), 1.0)
        k_v, k_b = k * o, c.cb_c * x
        return _edge(
            c, k_v * k_b / np.sqrt(k_v * k_v + k_b * k_b), 1.0, P - P_r, c.pc_all > 0.0
        )
    return _edge(c, k, o, P - P_r, c.pc_all > 0.0)


@njit(cache=True)
def flows(c, s, P_1, P_2, P_s):
    """Flows [m^3/s] into both chambers, (12)(13), at spool position `s` [V] and the
    pressures at the valve [Pa].
    """
    if c.e_u != 1.0 and s != 0.0:
        s = np.sign(s) * c.u_max * (abs(s) / c.u_max) ** c.e_u
    p_1, n_1, p_2, n_2 = s - c.o_p1, -s - c.o_n1, -s - c.o_p2, s - c.o_n2
    if c.area_1 == 0.0:
        p_1, n_1 = 0.0, 0.0
    if c.k_s > 0.0:
        lo, hi = min(P_1, P_2, P_s), P_s
        for _ in range(36):
            mid = 0.5 * (lo + hi)
            q = _edge(c, c.c_p1, p_1, mid - P_1, True) + _edge(
                c, c.c_p2, p_2, mid - P_2, True
            )
            if mid + c.k_s * q * abs(q) > P_s:
                hi = mid
            else:
                lo = mid
        P_s = 0.5 * (lo + hi)
    P_r = c.P_r
    if c.R_r > 0.0:
        lo, hi = P_r, max(P_1, P_2, P_r)
        for _ in range(36):
            mid = 0.5 * (lo + hi)
            q = _drain(c, c.c_n1, n_1, P_1, P_2, mid, False) + _drain(
                c, c.c_n2, n_2, P_2, P_1, mid, False
            )
            if mid - c.R_r * q * abs(q) > P_r:
                hi = mid
            else:
                lo = mid
        P_r = 0.5 * (lo + hi)
    Q_1 = _edge(c, c.c_p1, p_1, P_s - P_1, True) - _drain(
        c, c.c_n1, n_1, P_1, P_2, P_r, c.cb_chamber == 1.0
    )
    Q_2 = _edge(c, c.c_p2, p_2, P_s - P_2, True) - _drain(
        c, c.c_n2, n_2, P_2, P_1, P_r, c.cb_chamber == 2.0
    )
    return Q_1, Q_2


@njit(cache=True)
def bulk_modulus(c, P, t):
    """Effective bulk modulus [Pa] at gauge pressure `P` [Pa] and time `t` [s]."""
    beta = c.beta * (1.0 - c.a_warm * (1.0 - np.exp(-t / c.tau_warm)))
    if c.alpha > 0.0:
        p = max(P + ATM, 1e3)
        return 1.0 / (
            1.0 / beta + c.alpha * (ATM / p) ** (1.0 / c.n_air) / (c.n_air * p)
        )
    return beta


@njit(cache=True)
def gate(v_f):
    """L of (7) at the filtered speed `v_f` [m/s]."""
    return 1.0 / (1.0 + (300.0 * v_f) ** 3)


@njit(cache=True)
def sliding_friction(c, y, x, v, t):
    """f_c of (3) [N] with its faults; `y` the state, `x`, `v` the encoder's motion."""
    speed = y[6] if c.tau_h > 0.0 else abs(v)
    mean = (y[0] + y[1]) if c.area_1 == 0.0 else 0.5 * (y[0] + y[1])
    extra = c.kappa * mean + c.k_d * y[16]
    if c.k_st > 0.0:
        extra += c.k_st * np.exp(-((speed / c.v_s) ** 2))
    shape = 1.0
    if c.a_x != 0.0:
        shape *= 1.0 + c.a_x * np.sin(2.0 * np.pi * x / c.lambda_x + c.phase_x)
    if c.a_t != 0.0:
        shape *= 1.0 + c.a_t * (np.exp(-t / c.tau_t) - 1.0)
    g = min(max(y[2] / c.z_ss, -1.0), 1.0)
    level = c.k_cp if g > 0.0 else c.k_cn
    f = (
        (level + extra) * shape * g
        + c.k_0
        - (c.k_vp if v > 0.0 else c.k_vn) * np.sign(v) * speed
    )
    f += (c.b + c.kappa_v * mean) * v
    if c.sigma_1 > 0.0:
        f += c.sigma_1 * (v - abs(v) * y[2] / c.z_ss)
    return f


@njit(cache=True)
def output_force(c, y, x, v, a, t):
    """Force [N] in the load cell: (22) with (3)-(7), solved for F. Returns F and what
    is left before presliding.
    """
    gate_ = gate(y[3])
    P = c.area_2 * y[1] - c.area_1 * y[0]
    load = c.m * a
    if c.w != 0.0:
        load += c.w * np.sin(x / c.radius + c.psi_0)
    if c.k_g > 0.0:
        near = np.exp(-(((x - c.x_g) / c.w_g) ** 2))
        load += c.k_g * near * y[15] / c.z_g * (1.0 + 0.8 * np.exp(-((v / 2e-3) ** 2)))
    if c.k_stop > 0.0:
        load += c.k_stop * (max(x - c.x_stop, 0.0) - max(-x - c.x_stop, 0.0))
    R = P - (1.0 - gate_) * sliding_friction(c, y, x, v, t) - load
    B = gate_ * (c.k_fp if R > 0.0 else c.k_fn)
    r = abs(R)
    q = 1.0 + B - c.delta * r
    root = np.sqrt(q * q + 4.0 * c.delta * r)
    F = 2.0 * r / (q + root) if q > 0.0 else (root - q) / (2.0 * c.delta)
    return F * np.sign(R), R


@njit(cache=True)
def rates(c, y, dy, spool, x, v, a, P_s, t):
    """Time derivative of the state. Returns the true force in the cell [N]; `spool` [V]
    is the command it follows.

    State: 0 P_a1, 1 P_a2, 2 z, 3 filtered speed, 4 spool, 5 its speed, 6 film speed, 7
    rod deflection, 8 lagged F, 9 and 10 lagged pressures, 11 and 12 valve-end pressures
    of the hoses, 13 and 14 their flows, 15 guide bristle, 16 share of the dwell.
    """
    dy[:] = 0.0
    s = spool
    if c.omega_v < 1e9:
        s = y[4]
        dy[4] = y[5]
        dy[5] = c.omega_v**2 * (spool - y[4]) - 2.0 * c.zeta_v * c.omega_v * y[5]
    F, R = output_force(c, y, x, v, a, t)
    v_p, x_p = v, x
    if c.k_rod < 1e12 or c.gap > 0.0:
        k = min(c.k_rod, PIN_STIFFNESS)
        stretch = y[7] - min(max(y[7], -0.5 * c.gap), 0.5 * c.gap)
        touching = (
            c.gap == 0.0 or (stretch > 0.0 and F >= 0.0) or (stretch < 0.0 and F <= 0.0)
        )
        if touching:
            dy[7] = (F - k * stretch) / (k * ROD_TAU)
        else:
            dy[7] = R / FILM
            F = 0.0
        v_p, x_p = v + dy[7], x + y[7]
    dy[2] = v_p - abs(v_p) * y[2] / c.z_ss
    dy[3] = 10.0 * (abs(v_p) - y[3])
    if c.tau_h > 0.0:
        dy[6] = (abs(v) - y[6]) / c.tau_h
    V_1 = c.area_1 * (0.5 * c.length + c.delta_1 - x_p) + c.V_0
    V_2 = c.area_2 * (0.5 * c.length + c.delta_2 + x_p) + c.V_0
    if c.V_h > 0.0:
        q_1, q_2 = flows(c, s, y[11], y[12], P_s)
        Q_1, Q_2 = y[13], y[14]
        dy[11] = bulk_modulus(c, y[11], t) / c.V_h * (q_1 - Q_1)
        dy[12] = bulk_modulus(c, y[12], t) / c.V_h * (q_2 - Q_2)
        dy[13] = (y[11] - y[0] - c.R_h * Q_1) / c.I_h if c.area_1 > 0.0 else 0.0
        dy[14] = (y[12] - y[1] - c.R_h * Q_2) / c.I_h
    else:
        Q_1, Q_2 = flows(c, s, y[0], y[1], P_s)
    across = c.c_il + (
        c.c_w * np.exp(-(((x - c.x_w) / c.w_w) ** 2)) if c.c_w > 0.0 else 0.0
    )
    Q_l = across * (y[0] - y[1])
    if c.area_1 > 0.0:
        Q_1 += -Q_l - c.c_el * (y[0] - c.P_r)
        dy[0] = bulk_modulus(c, y[0], t) / V_1 * (Q_1 + c.area_1 * v_p)
    Q_2 += Q_l - c.c_el * (y[1] - c.P_r)
    if c.c_g > 0.0:
        Q_2 -= c.c_g * max(y[1], 0.0) ** 2 * max(0.5 + x / c.length, 0.0)
    dy[1] = bulk_modulus(c, y[1], t) / V_2 * (Q_2 - c.area_2 * v_p)
    if c.tau_F > 0.0:
        dy[8] = (F - y[8]) / c.tau_F
    if c.tau_P > 0.0:
        dy[9] = (y[0] - y[9]) / c.tau_P
        dy[10] = (y[1] - y[10]) / c.tau_P
    if c.k_g > 0.0:
        dy[15] = v - abs(v) * y[15] / c.z_g
    if c.k_d > 0.0:
        dy[16] = (
            max(1.0 - abs(v) / 2e-4, 0.0) * (1.0 - y[16]) / c.tau_d
            - abs(v) * y[16] / c.z_d
        )
    return F


@njit(cache=True)
def motion(c, knots, dt, t):
    """Piston position [m], speed [m/s], acceleration [m/s^2] at `t`; `knots` the
    cubics' coefficients, `dt` apart.
    """
    i = min(max(int(t / dt), 0), knots.shape[1] - 1)
    s = t - i * dt
    k0, k1, k2, k3 = knots[0, i], knots[1, i], knots[2, i], knots[3, i]
    x = ((k0 * s + k1) * s + k2) * s + k3
    v = (3.0 * k0 * s + 2.0 * k1) * s + k2
    a = 6.0 * k0 * s + 2.0 * k1
    if c.r_2 != 0.0:
        psi = x / c.radius
        slope = 1.0 + 3.0 * c.r_2 * psi * psi
        a = slope * a + 6.0 * c.r_2 * psi * v * v / c.radius
        v = slope * v
        x = x + c.radius * c.r_2 * psi**3
    return x, v, a


@njit(cache=True)
def sample_at(values, dt, t):
    """Linear interpolation of `values` on a grid of `dt`."""
    i = min(max(int(t / dt), 0), values.size - 2)
    s = min(max(t / dt - i, 0.0), 1.0)
    return (1.0 - s) * values[i] + s * values[i + 1]


@njit(cache=True)
def command(c, k, F_d, dt, T, t, P_1, P_2, F, P_s, knots, integral):
    """Valve voltage from the force loop: (18)(23) with a PI force error instead of
    adaptation. Returns u, error.
    """
    error = sample_at(F_d, dt, t) - F
    slope = (sample_at(F_d, dt, t + T) - sample_at(F_d, dt, t - T)) / (2.0 * T)
    x, v, a = motion(c, knots, dt, t + k.preview)
    want = slope + k.K * error + k.K_i * integral + k.K * k.k_c * np.tanh(v / 3e-3)
    V_1 = max(c.area_1 * (0.5 * c.length - x), 1e-6)
    V_2 = c.area_2 * (0.5 * c.length + x)
    stiff = k.beta * (c.area_1**2 / V_1 + c.area_2**2 / V_2)
    need = want + stiff * v
    floor = 0.03 * P_s
    if need < 0.0:
        d_1, d_2 = np.sqrt(max(P_s - P_1, floor)), np.sqrt(max(P_2 - c.P_r, floor))
    else:
        d_1, d_2 = np.sqrt(max(P_1 - c.P_r, floor)), np.sqrt(max(P_s - P_2, floor))
    gain = k.beta * k.c * (c.area_1 * d_1 / V_1 + c.area_2 * d_2 / V_2)
    u = -need / gain
    return min(max(u, -c.u_max), c.u_max), error


@njit(cache=True)
def _step(y_k, y, h, k):
    """y_k = y + h k, in place."""
    for s in range(y.size):
        y_k[s] = y[s] + h * k[s]


@njit(cache=True)
def simulate(c, k, closed, T, n_sub, knots, P_s, dt, F_d, u, noise, start, hold, every):
    """Run the rig over a log.

    c, k: Plant and Control. closed: draw the command (into `u`, whose values add to it)
    or replay `u` as it is. T: sample period [s]; n_sub: integration steps per period, a
    multiple of FINE. knots, P_s, F_d: motion, supply [Pa] and wanted force [N] on a
    grid of `dt` [s]. noise: (n, 3) noise of P_a1, P_a2, F that the controller sees.
    start: pressures [Pa] at t = 0. hold: (n, 2) pressures to restart from every `every`
    samples (0: never). Returns (n * FINE, 5): P_a1, P_a2, F as their sensors give them
    without noise, then the true pressures.
    """
    n = u.size
    h = T / n_sub
    out = np.empty((n * FINE, 5))
    y = np.zeros(N_STATE)
    y[0], y[1] = start[0], start[1]
    y[9], y[10], y[11], y[12] = y[0], y[1], y[0], y[1]
    x, v, a = motion(c, knots, dt, 0.0)
    y[8], _ = output_force(c, y, x, v, a, 0.0)
    y[7] = y[8] / min(c.k_rod, PIN_STIFFNESS) + 0.5 * c.gap * np.sign(y[8])
    k1, k2, k3, k4 = (
        np.empty(N_STATE),
        np.empty(N_STATE),
        np.empty(N_STATE),
        np.empty(N_STATE),
    )
    y_k = np.empty(N_STATE)
    play, stuck, slewed, cell, integral = 0.0, 0.0, 0.0, y[8], 0.0
    void_1, void_2 = 0.0, 0.0
    each = n_sub // FINE
    for i in range(n):
        if every > 0 and i % every == 0:
            y[0], y[1] = hold[i, 0], hold[i, 1]
            y[11], y[12] = y[0], y[1]
            void_1, void_2 = 0.0, 0.0
        for j in range(n_sub):
            t = i * T + j * h
            x, v, a = motion(c, knots, dt, t)
            ps = sample_at(P_s, dt, t)
            if j % each == 0:
                F = rates(c, y, k1, slewed, x, v, a, ps, t)
                cell = min(max(cell, F - c.d_F), F + c.d_F)
                row = i * FINE + j // each
                out[row, 0] = (y[9] if c.tau_P > 0.0 else y[0]) + c.b_1
                if c.hum_1 > 0.0:
                    out[row, 0] += c.hum_1 * np.sin(2.0 * np.pi * c.f_hum * t)
                out[row, 1] = (y[10] if c.tau_P > 0.0 else y[1]) + c.b_2
                F_m = y[8] if c.tau_F > 0.0 else F
                out[row, 2] = (1.0 + c.eps_F) * (F_m + c.h_F * (cell - F))
                out[row, 3], out[row, 4] = y[0], y[1]
                if j == 0 and closed:
                    drive, error = command(
                        c,
                        k,
                        F_d,
                        dt,
                        T,
                        t,
                        out[row, 0] + noise[i, 0],
                        out[row, 1] + noise[i, 1],
                        out[row, 2] + noise[i, 2],
                        ps,
                        knots,
                        integral,
                    )
                    u[i] = min(max(u[i] + drive, -c.u_max), c.u_max)
                    if abs(u[i]) < c.u_max:
                        integral += T * error
            late = int(np.floor((t + 0.5 * h - c.tau_u) / T + 1e-9))
            w = (u[late] if late >= 0 else u[0]) + c.u_0
            play = min(max(play, w - c.u_h), w + c.u_h)
            if abs(play - stuck) > c.u_st:
                stuck = play
            was = slewed
            slewed += min(max(stuck - slewed, -c.r_v * h), c.r_v * h)
            if c.r_v > 1e9:
                was = slewed
            half = 0.5 * (was + slewed)
            rates(c, y, k1, was, x, v, a, ps, t)
            x, v, a = motion(c, knots, dt, t + 0.5 * h)
            ps = sample_at(P_s, dt, t + 0.5 * h)
            _step(y_k, y, 0.5 * h, k1)
            rates(c, y_k, k2, half, x, v, a, ps, t + 0.5 * h)
            _step(y_k, y, 0.5 * h, k2)
            rates(c, y_k, k3, half, x, v, a, ps, t + 0.5 * h)
            x, v, a = motion(c, knots, dt, t + h)
            ps = sample_at(P_s, dt, t + h)
            _step(y_k, y, h, k3)
            rates(c, y_k, k4, slewed, x, v, a, ps, t + h)
            for s in range(N_STATE):
                y[s] += h / 6.0 * (k1[s] + 2.0 * k2[s] + 2.0 * k3[s] + k4[s])
            # Below the vapour pressure a void opens; it is refilled before the
            # pressure rises again.
            if y[0] < c.P_vap or void_1 > 0.0:
                V = (c.area_1 * (0.5 * c.length + c.delta_1 - x) + c.V_0) / c.beta
                void_1 += (c.P_vap - y[0]) * V
                y[0] = c.P_vap - min(void_1, 0.0) / V
                void_1 = max(void_1, 0.0)
            if y[1] < c.P_vap or void_2 > 0.0:
                V = (c.area_2 * (0.5 * c.length + c.delta_2 + x) + c.V_0) / c.beta
                void_2 += (c.P_vap - y[1]) * V
                y[1] = c.P_vap - min(void_2, 0.0) / V
                void_2 = max(void_2, 0.0)
    return out
