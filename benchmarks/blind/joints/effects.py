"""What a rig may hold beyond the paper's model: each effect at its largest, and how its
size scales.

An effect is {field of `Plant`: (value at its largest, mode)}; modes: "lin" value * s,
"inv" value / s, "from" value reached from the rig's own value in proportion to s, "fix"
as it is. Fields that begin with "logger." belong to the recorder and not to the rig.
"""

import numpy as np

RIG_NEEDS = {
    "internal_leakage": {"two": True},
    "worn_groove": {"two": True},
    "counterbalance": {"two": True},
    "gravity_load": {"by_angle": True},
    "lever_geometry": {"by_angle": True},
    "dead_volume": {"holds_offsets": True},
    "viscous_friction": {"holds_k_v": True},
}

ABSORBED = {
    "dead_volume": "delta_1 and delta_2 shift by V_0/A; told apart only because "
    "the rig file holds them",
    "viscous_friction": "k_vp and k_vn fall by b; told apart only because the rig "
    "file holds them",
    "underlap": "the same as valve_deadband with four equal negative overlaps",
    "valve_lag": "much like valve_delay of 2 zeta/omega where the log holds little "
    "above omega",
    "valve_delay": "much like a valve_lag with 2 zeta/omega = tau_u where the log "
    "holds little at high frequency",
    "rod_compliance": "near to a lower beta or a dead volume",
    "loadcell_gain": "near to the friction constants where force and friction go "
    "together",
    "frictional_lag": "near to stribeck at one frequency of reversal",
    "entrained_air": "near to a lower beta where the mean pressure hardly moves",
    "pressure_sensor_bias": "in F a constant, which k_0 takes; in the flows a "
    "change of the drops",
}


def draw_effect(rng, name, rig):
    """The effect `name` at its largest on `rig`: {field: (value, mode)}."""
    c, u = rig.plant, rng.uniform
    side = rng.choice([-1.0, 1.0])
    k_c = 0.5 * (c.k_cp + c.k_cn)
    lands = ("c_p1", "c_n1", "c_p2", "c_n2")
    gain = float(np.mean([getattr(c, land) for land in lands]))
    rated = gain * c.u_max * np.sqrt(0.5 * rig.P_s)
    reach = 0.34 * c.length
    area = max(c.area_1, c.area_2)
    if name == "valve_bias":
        return {"u_0": (side * 0.03 * c.u_max, "lin")}
    if name == "valve_deadband":
        d = u(0.3, 0.8) * c.u_max * 0.1 * np.array([1.0, u(0.6, 1.4)])
        if u() < 0.6:
            return {
                "o_p1": (d[0], "lin"),
                "o_n2": (d[0], "lin"),
                "o_n1": (d[1], "lin"),
                "o_p2": (d[1], "lin"),
            }
        return {
            name_: (d[0] * u(0.3, 1.5), "lin")
            for name_ in ("o_p1", "o_n2", "o_n1", "o_p2")
        }
    if name == "valve_hysteresis":
        return {"u_h": (0.03 * c.u_max, "lin")}
    if name == "valve_delay":
        return {"tau_u": (max(u(4e-3, 2e-2), 1.0 / rig.rate), "lin")}
    if name == "valve_lag":
        return {
            "omega_v": (2.0 * np.pi * u(10.0, 40.0), "inv"),
            "zeta_v": (u(0.5, 1.0), "fix"),
        }
    if name == "valve_rate_limit":
        return {"r_v": (u(4.0, 12.0) * c.u_max, "inv")}
    if name == "orifice_transition":
        return {"dP_t": (u(1e6, 3e6), "lin")}
    if name == "underlap":
        d = 0.06 * c.u_max
        return {edge: (-d, "lin") for edge in ("o_p1", "o_n1", "o_p2", "o_n2")}
    if name == "internal_leakage":
        return {"c_il": (0.2 * rated / (0.5 * rig.P_s), "lin")}
    if name == "external_leakage":
        return {"c_el": (0.05 * rated / (0.5 * rig.P_s), "lin")}
    if name == "supply_line_drop":
        return {"k_s": (0.2 * rig.P_s / rated**2, "lin")}
    if name == "dead_volume":
        return {"V_0": (u(5e-5, 1e-4), "lin")}
    if name == "entrained_air":
        return {"alpha": (0.02, "lin"), "n_air": (u(1.0, 1.4), "fix")}
    if name == "viscous_friction":
        return {"b": (u(0.5, 1.0) * 1e4, "lin")}
    if name == "stribeck":
        return {
            "k_st": (0.8 * k_c, "lin"),
            "v_s": (np.exp(u(np.log(2e-3), np.log(2e-2))), "fix"),
        }
    if name == "bristle_damping":
        return {"sigma_1": (3e5, "lin")}
    if name == "frictional_lag":
        return {"tau_h": (0.3, "lin")}
    if name == "pressure_friction":
        if u() < 0.7:
            return {"kappa": (0.5 * k_c / (0.5 * rig.P_s), "lin")}
        return {"kappa_v": (0.5 * k_c / (0.5 * rig.P_s * rig.v_max), "lin")}
    if name == "position_friction":
        return {
            "a_x": (0.25, "lin"),
            "lambda_x": (2.0 * reach / u(0.8, 2.5), "fix"),
            "phase_x": (u(0.0, 6.28), "fix"),
        }
    if name == "friction_drift":
        return {"a_t": (u(0.2, 0.4), "lin"), "tau_t": (u(5.0, 20.0), "fix")}
    if name == "payload_inertia":
        return {"m": (30.0, "lin")}
    if name == "gravity_load":
        return {"w": (200.0, "lin"), "psi_0": (u(-1.5, 1.5), "fix")}
    if name == "rod_compliance":
        return {"k_rod": (5e6, "inv")}
    if name == "backlash":
        return {"gap": (2e-4, "lin")}
    if name == "loadcell_lag":
        return {"tau_F": (1.0 / (2.0 * np.pi * 40.0), "lin")}
    if name == "loadcell_gain":
        return {"eps_F": (side * 0.04, "lin")}
    if name == "pressure_sensor_lag":
        return {"tau_P": (1.0 / (2.0 * np.pi * 40.0), "lin")}
    if name == "pressure_sensor_bias":
        return {
            "b_1": (side * u(0.3, 1.0) * 2e5 * (c.area_1 > 0.0), "lin"),
            "b_2": (u(-1.0, 1.0) * 2e5, "lin"),
        }
    if name == "channel_skew":
        channel = "F" if c.area_1 == 0.0 else str(rng.choice(["F", "P_a1", "P_a2"]))
        return {
            "logger.skew": (side * max(5e-3, 1.0 / rig.rate), "lin"),
            "logger.skew_channel": (channel, "fix"),
        }
    if name == "flow_curve":
        e = u(1.2, 1.7)
        fields = {"e_u": (e, "from")}
        return fields | {
            land: (getattr(c, land) * 0.25 ** (1.0 - e), "from") for land in lands
        }
    if name == "pressure_compensation":
        margin, everywhere = u(4e5, 1e6), float(u() < 0.5)
        fields = {
            "s_pc": (u(0.7, 1.0), "lin"),
            "dP_pc": (margin, "fix"),
            "pc_all": (everywhere, "fix"),
        }
        more = (0.5 * rig.P_s / margin) ** (0.5 * fields["s_pc"][0])
        edges = lands if everywhere else ("c_p1", "c_p2")
        return fields | {land: (getattr(c, land) * more, "from") for land in edges}
    if name == "counterbalance":
        return {
            "cb_chamber": (float(rng.integers(1, 3)), "fix"),
            "cb_ratio": (u(2.0, 4.0), "fix"),
            "cb_set": (u(0.8, 1.2) * rig.P_s, "fix"),
            "cb_span": (u(0.8, 1.3) * rig.P_s, "fix"),
            "cb_c": (0.6 * gain * c.u_max, "inv"),
        }
    if name == "signal_filter":
        channels = ["F"] if c.area_1 == 0.0 or u() < 0.4 else ["P_a1", "P_a2"]
        return {
            "logger.omega": (2.0 * np.pi * u(4.0, 12.0), "inv"),
            "logger.zeta": (u(0.6, 1.0), "fix"),
            "logger.channels": (channels, "fix"),
            "logger.log": (str(rng.choice(["fit_1", "validate"])), "fix"),
        }
    if name == "hose_dynamics":
        V, I_h = u(2e-5, 6e-5), u(2e7, 8e7)
        return {
            "V_h": (V, "lin"),
            "I_h": (I_h, "lin"),
            "R_h": (0.2 * np.sqrt(c.beta * I_h / V), "fix"),
        }
    if name == "gland_leak":
        return {"c_g": (0.08 * rated / (0.5 * rig.P_s) ** 2, "lin")}
    if name == "flow_force":
        return {"k_q": (0.25 / rig.P_s, "lin")}
    if name == "spool_stiction":
        return {"u_st": (0.03 * c.u_max, "lin")}
    if name == "loadcell_hysteresis":
        return {"h_F": (0.1, "lin"), "d_F": (u(0.1, 0.4) * 0.1 * area * rig.P_s, "fix")}
    if name == "sticking_guide":
        return {
            "k_g": (u(0.2, 0.5) * k_c + 40.0, "lin"),
            "x_g": (u(-0.5, 0.5) * reach, "fix"),
            "w_g": (u(0.2, 0.5) * reach, "fix"),
        }
    if name == "fluid_warming":
        return {"a_warm": (0.4, "lin"), "tau_warm": (u(4.0, 15.0), "fix")}
    if name == "sensor_hum":
        return {"hum_1": (10.0 * rig.noise["P_a1"], "lin"), "f_hum": (50.0, "fix")}
    if name == "worn_groove":
        return {
            "c_w": (0.3 * rated / (0.5 * rig.P_s), "lin"),
            "x_w": (u(-0.5, 0.5) * reach, "fix"),
            "w_w": (u(0.1, 0.3) * reach, "fix"),
        }
    if name == "dwell_friction":
        return {
            "k_d": (0.6 * k_c, "lin"),
            "tau_d": (u(0.5, 2.0), "fix"),
            "z_d": (u(0.5e-3, 4e-3), "fix"),
        }
    if name == "return_line_drop":
        return {"R_r": (0.15 * rig.P_s / rated**2, "lin")}
    if name == "lever_geometry":
        return {"r_2": (side * 0.12 * (c.radius / reach) ** 2, "lin")}
    raise KeyError(name)


TABLE = (
    "valve_bias",
    "valve_deadband",
    "valve_hysteresis",
    "valve_delay",
    "valve_lag",
    "valve_rate_limit",
    "orifice_transition",
    "underlap",
    "internal_leakage",
    "external_leakage",
    "supply_line_drop",
    "dead_volume",
    "entrained_air",
    "viscous_friction",
    "stribeck",
    "bristle_damping",
    "frictional_lag",
    "pressure_friction",
    "position_friction",
    "friction_drift",
    "payload_inertia",
    "gravity_load",
    "rod_compliance",
    "backlash",
    "loadcell_lag",
    "loadcell_gain",
    "pressure_sensor_lag",
    "pressure_sensor_bias",
    "channel_skew",
    "flow_curve",
    "pressure_compensation",
    "counterbalance",
    "signal_filter",
)

OUTSIDE = (
    "hose_dynamics",
    "gland_leak",
    "flow_force",
    "spool_stiction",
    "loadcell_hysteresis",
    "sticking_guide",
    "fluid_warming",
    "sensor_hum",
    "worn_groove",
    "dwell_friction",
    "return_line_drop",
    "lever_geometry",
)


def at_size(effect, s, plant):
    """Values of the effect's fields at the share `s` (0 to 1] of its largest."""
    values = {}
    for key, (largest, mode) in effect.items():
        if mode == "lin":
            values[key] = largest * s
        elif mode == "inv":
            values[key] = largest / s
        elif mode == "from":
            own = getattr(plant, key)
            values[key] = own * (largest / own) ** s
        else:
            values[key] = largest
    return values
