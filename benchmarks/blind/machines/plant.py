"""A differential cylinder behind a proportional valve, integrated by classical
Runge-Kutta with a fixed step.

Everything is SI. Command and overlaps are in command units (1 or V), flow gains in
m^3/(s*unit*sqrt(Pa)).

Signs: x is counted from mid-stroke and grows as chamber 2 (bore side) fills; a positive
command fills chamber 1 (rod side) and drains chamber 2, so it drives x down. P = A_2
P_2 - A_1 P_1 is the drive force, F the force handed on to the load. Pressures are
gauge; absolute pressure is gauge + 101325 Pa.

Order on the command path: dead time, null bias, play (hysteresis of solenoid and
spool), rate limit, spool dynamics, then the overlap of each metering edge and the curve
of its opening. This is the order in which the parts sit in a valve: overlap and opening
curve belong to the lands of the spool, hence after its dynamics.
"""

import numpy as np
from numba import njit

P_ATM = 101325.0  # Pa
POLYTROPIC = 1.4  # index of the entrained air and of accumulator gas
CORE = 1.0e4  # Pa, below this pressure drop an orifice turns laminar

# name: value at which the part is absent (or, for the machine itself, a harmless
# placeholder)
FIELDS = {
    # cylinder: areas m^2, stroke m, assembly offsets m (they hold hoses too), extra
    # volume m^3
    "area_1": 4e-3,
    "area_2": 6e-3,
    "stroke": 0.6,
    "delta_1": 0.05,
    "delta_2": 0.05,
    "V_0": 0.0,
    # fluid: bulk modulus Pa, volume share of air at ambient pressure
    "beta": 1e9,
    "alpha": 0.0,
    # valve edges: p from supply, n to tank
    "c_p1": 1e-6,
    "c_n1": 1e-6,
    "c_p2": 1e-6,
    "c_n2": 1e-6,
    "u_full": 1.0,
    "tau_u": 0.0,
    "u_0": 0.0,
    "u_h": 0.0,
    "r_v": np.inf,
    "omega_v": np.inf,
    "zeta_v": 0.7,
    "o_p1": 0.0,
    "o_n1": 0.0,
    "o_p2": 0.0,
    "o_n2": 0.0,
    "e_flow": 1.0,
    "s_comp": 0.0,
    "dP_0": 6e5,
    "k_s": 0.0,
    # counterbalance valve out of chamber 2: c 0 means none is fitted
    "cb_c": 0.0,
    "cb_set": 1e7,
    "cb_ratio": 3.0,
    "cb_full": 1e7,
    "cb_tau": 0.05,
    # leakage m^3/(s*Pa)
    "c_il": 0.0,
    "c_el": 0.0,
    "c_dl": 0.0,
    # supply: source Pa, sag Pa*s/m^3, lag s, tank Pa
    "P_src": 2e7,
    "R_src": 0.0,
    "tau_src": 0.03,
    "P_r": 3e5,
    # friction between piston and load cell
    "k_c": 500.0,
    "k_0": 0.0,
    "b": 1000.0,
    "z_ss": 2e-4,
    "k_st": 0.0,
    "v_s": 0.01,
    "kappa": 0.0,
    "kappa_v": 0.0,
    "pos_a": 0.0,
    "pos_phase": 0.0,
    "pad": 0.0,
    # between piston and load cell
    "m": 0.0,
    "w": 0.0,
    "w_psi": 0.0,
    "w_radius": 1.0,
    "compliance": 0.0,
    "gap": 0.0,
    "contact_damping": 2e4,
    # load beyond the load cell
    "mass": 1000.0,
    "W": 0.0,
    "W_slope": 0.0,
    "load_b": 0.0,
    "load_c": 0.0,
    "press_k": 0.0,
    "press_x": 0.0,
    # parts that no table of effects names
    "rv_G": 0.0,
    "rv_crack": 4e7,
    "regen_c": 0.0,
    "acc_V": 0.0,
    "acc_P": 5e6,
    "acc_c": 0.0,
    "hose_V": 0.0,
    "hose_I": 1e7,
    "hose_R": 1e9,
    "makeup_c": 0.0,
    "makeup_P": 0.0,
    "therm_a": 0.0,
    "therm_tau": 30.0,
    "ripple_P": 0.0,
    "ripple_f": 20.0,
    "other_P": 0.0,
    "other_T": 9.0,
    "flow_force": 0.0,
}
DTYPE = np.dtype([(name, np.float64) for name in FIELDS])

# states
P1, P2, X, V, Z, Y, YD, GAP, PS, CB, OIL, PV1, QH1, PV2, QH2 = range(15)
N_STATES = 15
# recorded columns
RECORD = ("P_1", "P_2", "P_s", "x", "v", "a", "F", "y", "Q_1", "Q_2", "v_piston")


def parameters(**values):
    """A numba record of all fields, absent parts at their absent value."""
    rec = np.zeros(1, DTYPE)
    for name, absent in FIELDS.items():
        rec[name] = values.get(name, absent)
    unknown = set(values) - set(FIELDS)
    if unknown:
        raise KeyError(f"unknown parameters {sorted(unknown)}")
    return rec


@njit(cache=True)
def orifice(g, dp):
    """Flow (m^3/s) of a turbulent orifice of gain g (m^3/(s*sqrt(Pa))) with a laminar
    core.
    """
    return g * dp / (dp * dp + CORE * CORE) ** 0.25


@njit(cache=True)
def opening(y, overlap, p):
    """Opening of one edge (command units) for the spool position y counted in its
    opening direction.
    """
    a = max(y - overlap, 0.0)
    if p.e_flow != 1.0 and a > 0.0:
        a = p.u_full * (a / p.u_full) ** p.e_flow
    return a


@njit(cache=True)
def meter_in(g, dp, p):
    """Flow from supply through an edge of gain g. A pressure compensator, where fitted,
    sits upstream of this edge.
    """
    if p.s_comp > 0.0 and dp > p.dP_0:
        dp = dp ** (1.0 - p.s_comp) * p.dP_0**p.s_comp
    if p.k_s > 0.0:
        g = g / np.sqrt(1.0 + p.k_s * g * g)
    return orifice(g, dp)


@njit(cache=True)
def bulk_modulus(pressure, p):
    """Effective bulk modulus (Pa) of oil with free air at a gauge pressure (Pa)."""
    if p.alpha == 0.0:
        return p.beta
    q = max(pressure + P_ATM, 2e3)
    return 1.0 / (
        1.0 / p.beta + p.alpha * (P_ATM / q) ** (1.0 / POLYTROPIC) / (POLYTROPIC * q)
    )


@njit(cache=True)
def supply_at_valve(t, ps, p):
    """Supply pressure (Pa) that the valve sees: logged pressure less ripple and other
    consumers downstream of it.
    """
    if p.ripple_P != 0.0:
        ps += p.ripple_P * np.sin(2.0 * np.pi * p.ripple_f * t)
    if p.other_P != 0.0:
        ps -= (
            p.other_P
            * 0.5
            * (1.0 + np.tanh(8.0 * (np.sin(2.0 * np.pi * t / p.other_T) - 0.3)))
        )
    return ps


@njit(cache=True)
def flows(t, s, p, out):
    """Flows (m^3/s) into port 1 (out[0]) and port 2 (out[1]) and from supply (out[2]);
    out[3] counterbalance aim.
    """
    y = s[Y]
    hose = p.hose_V > 0.0
    port_1 = s[PV1] if hose else s[P1]
    port_2 = s[PV2] if hose else s[P2]
    ps = supply_at_valve(t, s[PS], p)
    warm = 1.0
    if p.therm_a != 0.0:
        warm = 1.0 + p.therm_a * (1.0 - np.exp(-t / p.therm_tau))
    if p.flow_force > 0.0:
        drop = ps - port_1 if y > 0.0 else ps - port_2
        y *= 1.0 / (1.0 + p.flow_force * max(drop, 0.0))
    in_1 = meter_in(warm * p.c_p1 * opening(y, p.o_p1, p), ps - port_1, p)
    in_2 = meter_in(warm * p.c_p2 * opening(-y, p.o_p2, p), ps - port_2, p)
    out_1 = orifice(warm * p.c_n1 * opening(-y, p.o_n1, p), port_1 - p.P_r)
    g = warm * p.c_n2 * opening(y, p.o_n2, p)
    out[3] = min(max((port_2 + p.cb_ratio * port_1 - p.cb_set) / p.cb_full, 0.0), 1.0)
    if p.cb_c > 0.0 and port_2 > p.P_r:
        g_cb = p.cb_c * max(s[CB], 0.0)
        g = g * g_cb / np.sqrt(g * g + g_cb * g_cb + 1e-30)
    out_2 = orifice(g, port_2 - p.P_r)
    out[0] = in_1 - out_1
    out[1] = in_2 - out_2
    out[2] = in_1 + in_2
    if p.regen_c > 0.0 and y > 0.0 and port_2 > port_1:
        q = orifice(p.regen_c * opening(y, p.o_n2, p), port_2 - port_1)
        out[0] += q
        out[1] -= q


@njit(cache=True)
def chamber_flows(s, p, out):
    """Add to out[0], out[1] what enters the chambers past the valve; out[4] is the
    accumulator's share.
    """
    leak = p.c_il * (s[P1] - s[P2])
    if p.c_dl > 0.0:
        leak -= p.c_dl * max(s[P2] - s[P1], 0.0)
    out[0] += -leak - p.c_el * (s[P1] - p.P_r)
    out[1] += leak - p.c_el * (s[P2] - p.P_r)
    if p.rv_G > 0.0:
        out[1] -= p.rv_G * max(s[P2] - p.rv_crack, 0.0)
    if p.makeup_c > 0.0 and s[P1] < p.makeup_P:
        out[0] += orifice(p.makeup_c, p.makeup_P - s[P1])
    out[4] = 0.0
    if p.acc_c > 0.0:
        gas = p.acc_P * (p.acc_V / max(p.acc_V - s[OIL], 0.02 * p.acc_V)) ** POLYTROPIC
        out[4] = orifice(p.acc_c, s[P2] - gas)
        if s[OIL] <= 0.0 and out[4] < 0.0:
            out[4] = 0.0
        out[1] -= out[4]


@njit(cache=True)
def load_force(x, v, p):
    """Force (N) of the load against positive x, inertia apart: weight at a lever that
    changes with x, drag, tool.
    """
    f = (
        p.W * (1.0 + p.W_slope * x / p.stroke)
        + p.load_b * v
        + p.load_c * np.tanh(v / 5e-3)
    )
    if p.press_k > 0.0:
        f += p.press_k * max(x - p.press_x, 0.0)
    return f


@njit(cache=True)
def friction_level(s, x, v, p):
    """Coulomb level of the seals (N)."""
    level = p.k_c
    if p.pos_a != 0.0:
        level *= 1.0 + p.pos_a * np.cos(2.0 * np.pi * x / p.stroke + p.pos_phase)
    if p.k_st != 0.0:
        level += p.k_st * np.exp(-((v / p.v_s) ** 2))
    level += p.kappa * 0.5 * (s[P1] + s[P2])
    if p.pad != 0.0:
        level += p.pad * abs(p.W) * max(0.5 + x / p.stroke, 0.0)
    return level


@njit(cache=True)
def derivative(t, s, u, p, imposed, motion, d, out):
    """Time derivative d of the states s at command u (past play and rate limit).

    Where imposed, motion holds x, v, a and the supply pressure. out[5] is the force at
    the load cell, out[6] the acceleration of the load, out[7] the piston's velocity.
    """
    x, v = (motion[0], motion[1]) if imposed else (s[X], s[V])
    if imposed:
        s[PS] = motion[3]
    if not np.isfinite(p.omega_v):
        s[Y] = u
        d[Y] = 0.0
        d[YD] = 0.0
    else:
        d[Y] = s[YD]
        d[YD] = p.omega_v * p.omega_v * (u - s[Y]) - 2.0 * p.zeta_v * p.omega_v * s[YD]
    flows(t, s, p, out)
    q_valve_1, q_valve_2 = out[0], out[1]
    if p.hose_V > 0.0:
        out[0] = s[QH1]
        out[1] = s[QH2]
    chamber_flows(s, p, out)

    drive = p.area_2 * s[P2] - p.area_1 * s[P1]
    viscous = p.b + p.kappa_v * 0.5 * (s[P1] + s[P2])
    f_dry = friction_level(s, x, v, p) * s[Z] / p.z_ss + p.k_0
    weight = p.w * np.sin(x / p.w_radius + p.w_psi)
    load = load_force(x, v, p)
    if p.compliance == 0.0 and p.gap == 0.0:
        d[GAP] = 0.0
        through = drive - f_dry - viscous * v
    else:
        k = 1.0 / p.compliance if p.compliance > 0.0 else 1e9
        spring = k * (max(s[GAP] - 0.5 * p.gap, 0.0) + min(s[GAP] + 0.5 * p.gap, 0.0))
        d[GAP] = (drive - f_dry - viscous * v - spring) / (p.contact_damping + viscous)
        through = spring + p.contact_damping * d[GAP]
    a = motion[2] if imposed else (through - weight - load) / (p.mass + p.m)
    v_piston = v + d[GAP]
    x_piston = x + s[GAP]
    d[X] = v
    d[V] = a
    d[Z] = v_piston - abs(v_piston) * s[Z] / p.z_ss
    out[5] = through - p.m * a - weight
    out[6] = a
    out[7] = v_piston

    volume_1 = p.area_1 * (0.5 * p.stroke + p.delta_1 - x_piston) + p.V_0
    volume_2 = p.area_2 * (0.5 * p.stroke + p.delta_2 + x_piston) + p.V_0
    d[P1] = bulk_modulus(s[P1], p) / volume_1 * (out[0] + p.area_1 * v_piston)
    d[P2] = bulk_modulus(s[P2], p) / volume_2 * (out[1] - p.area_2 * v_piston)
    d[PS] = 0.0 if imposed else (p.P_src - p.R_src * out[2] - s[PS]) / p.tau_src
    d[CB] = (out[3] - s[CB]) / p.cb_tau
    d[OIL] = out[4]
    if p.hose_V > 0.0:
        d[PV1] = bulk_modulus(s[PV1], p) / p.hose_V * (q_valve_1 - s[QH1])
        d[PV2] = bulk_modulus(s[PV2], p) / p.hose_V * (q_valve_2 - s[QH2])
        d[QH1] = (s[PV1] - s[P1] - p.hose_R * s[QH1]) / p.hose_I
        d[QH2] = (s[PV2] - s[P2] - p.hose_R * s[QH2]) / p.hose_I
    else:
        d[PV1], d[PV2], d[QH1], d[QH2] = d[P1], d[P2], 0.0, 0.0


@njit(cache=True)
def command_at(t, u, rate):
    """The command between its samples: straight lines, held before the first and past
    the last.
    """
    r = t * rate
    if r <= 0.0:
        return u[0]
    k = int(r)
    if k >= u.size - 1:
        return u[u.size - 1]
    return u[k] + (r - k) * (u[k + 1] - u[k])


@njit(cache=True)
def run(
    params, u, rate, substeps, every, operator, x_ref, motion, restart, restart_every
):
    """Integrate over the whole log.

    u: command at the log's rate (Hz). substeps: steps per sample; every: steps between
    recorded rows. operator: (on, loop gain in 1/m, dead-zone jump, joystick rad/s,
    limit, quantum, plan weight); when on, u is the planned deflection on entry and the
    true command on return. motion: (steps + 1, 4) of x, v, a, P_s, or empty for a free
    motion. restart: rows of P_1, P_2 put in each restart_every steps (0: only the
    first). Returns the record, the motion of each step, and the command.
    """
    p = params[0]
    n = u.size
    steps = (n - 1) * substeps
    h = 1.0 / (rate * substeps)
    imposed = motion.shape[0] > 0
    u = u.copy()
    plan = u.copy()
    rec = np.empty((steps // every + 1, 11))
    path = np.empty((0 if imposed else steps + 1, 4))
    s = np.zeros(N_STATES)
    k1 = np.zeros(N_STATES)
    k2 = np.zeros(N_STATES)
    k3 = np.zeros(N_STATES)
    k4 = np.zeros(N_STATES)
    out = np.zeros(8)
    m0 = np.zeros(4)
    mh = np.zeros(4)
    m1 = np.zeros(4)
    s[P1], s[P2] = restart[0, 0], restart[0, 1]
    s[PV1], s[PV2] = s[P1], s[P2]
    s[X] = motion[0, 0] if imposed else x_ref[0]
    s[PS] = p.P_src
    s[CB] = min(max((s[P2] + p.cb_ratio * s[P1] - p.cb_set) / p.cb_full, 0.0), 1.0)
    if p.acc_c > 0.0:
        s[OIL] = max(
            p.acc_V * (1.0 - (p.acc_P / max(s[P2], 1.0)) ** (1.0 / POLYTROPIC)), 0.0
        )
    if operator[0] > 0.0:
        u[0] = 0.0
    play = command_at(0.0, u, rate) + p.u_0
    limited = play
    s[Y] = play
    if p.compliance > 0.0:
        s[GAP] = p.compliance * (p.area_2 * s[P2] - p.area_1 * s[P1])
    stick = np.zeros(2)
    for i in range(steps + 1):
        t = i * h
        k = i // substeps
        if operator[0] > 0.0 and i % substeps == 0 and k < n - 1:
            want = operator[6] * plan[k + 1] - operator[1] * (x_ref[k + 1] - s[X])
            want = min(max(want, -operator[4]), operator[4])
            w = operator[3] / rate
            stick[0] += w * (want - stick[0])
            stick[1] += w * (stick[0] - stick[1])
            held = np.sign(stick[1]) * max(abs(stick[1]) - 0.006 * p.u_full, 0.0)
            cmd = held + operator[2] * np.tanh(held / (0.02 * p.u_full))
            u[k + 1] = np.round(cmd / operator[5]) * operator[5]
        if (
            restart_every > 0
            and i % restart_every == 0
            and i // restart_every < restart.shape[0]
        ):
            s[P1], s[P2] = (
                restart[i // restart_every, 0],
                restart[i // restart_every, 1],
            )
            s[PV1], s[PV2] = s[P1], s[P2]
        if imposed:
            m0[:] = motion[i]
        derivative(t, s, limited, p, imposed, m0, k1, out)
        if i % every == 0:
            row = rec[i // every]
            row[0] = s[PV1] if p.hose_V > 0.0 else s[P1]
            row[1] = s[PV2] if p.hose_V > 0.0 else s[P2]
            row[2] = s[PS]
            row[3] = m0[0] if imposed else s[X]
            row[4] = m0[1] if imposed else s[V]
            row[5], row[6], row[7] = out[6], out[5], s[Y]
            row[8], row[9], row[10] = out[0], out[1], out[7]
        if not imposed:
            path[i, 0], path[i, 1], path[i, 2], path[i, 3] = s[X], s[V], out[6], s[PS]
        if i == steps:
            break
        raw = command_at(t + h - p.tau_u, u, rate) + p.u_0
        play = min(max(play, raw - p.u_h), raw + p.u_h)
        before = limited
        limited = before + min(max(play - before, -p.r_v * h), p.r_v * h)
        middle = 0.5 * (before + limited)
        if imposed:
            m1[:] = motion[i + 1]
            for j in range(3):
                mh[j] = 0.5 * (m0[j] + m1[j])
            mh[0] += 0.125 * h * (m0[1] - m1[1])
            mh[1] += 0.125 * h * (m0[2] - m1[2])
            mh[3] = 0.5 * (m0[3] + m1[3])
        derivative(t + 0.5 * h, s + 0.5 * h * k1, middle, p, imposed, mh, k2, out)
        derivative(t + 0.5 * h, s + 0.5 * h * k2, middle, p, imposed, mh, k3, out)
        derivative(t + h, s + h * k3, limited, p, imposed, m1, k4, out)
        s += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return rec, path, u
