"""What a log can hold that its rig file leaves out: how each effect is drawn, from just
visible to large.

A draw takes the machine, a strength s from 0 (barely visible) to 1 (as large as is
realistic) and a dict of fixed random numbers, and returns the plant's fields and the
sensor settings that it sets. At the fields' default values the effect is exactly
absent.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np


def between(low, high, s):
    """Geometric interpolation from low (s = 0) to high (s = 1)."""
    return low * (high / low) ** s


@dataclass
class Effect:
    """An effect: its draw, and what it asks of the machine."""

    name: str
    draw: Callable
    known: bool = True  # named in the tables of effects
    needs_force: bool = False  # seen in the load cell alone
    needs_weight: bool = False
    needs_level: bool = False  # needs a load that changes the sign of the force
    excludes: tuple = ()


@dataclass
class Drawn:
    """What an effect sets: fields of the plant, settings of the sensors."""

    plant: dict = field(default_factory=dict)
    sensor: dict = field(default_factory=dict)


def _deadband(m, s, r):
    width = m.plant["u_full"] * between(0.01, 0.2, s)
    edges = ("o_p1", "o_n2", "o_p2", "o_n1")
    if r["style"] < 0.2:  # open at centre
        width = m.plant["u_full"] * between(0.005, 0.03, s)
        return Drawn({e: -width * (0.7 + 0.6 * r[i]) for i, e in enumerate(edges)})
    if r["style"] < 0.6:  # one width per side
        plus, minus = width * (0.6 + 0.4 * r[0]), width * (0.6 + 0.4 * r[1])
        return Drawn({"o_p1": plus, "o_n2": plus, "o_p2": minus, "o_n1": minus})
    return Drawn({e: width * (0.6 + 0.4 * r[i]) for i, e in enumerate(edges)})


def _compensation(m, s, r):
    share, margin = 0.1 + 0.85 * s, 4e5 + 6e5 * r[0]
    gain = (0.4 * m.plant["P_src"] / margin) ** (
        0.5 * share
    )  # keeps the flow at a usual drop
    return Drawn(
        {
            "s_comp": share,
            "dP_0": margin,
            "c_p1": m.plant["c_p1"] * gain,
            "c_p2": m.plant["c_p2"] * gain,
        }
    )


def _counterbalance(m, s, r):
    p = m.plant
    load = p["W"] / p["area_2"]
    return Drawn(
        {
            "cb_c": p["c_n2"] * p["u_full"] * between(4.0, 1.0, s),
            "cb_set": load * (1.2 + 0.4 * r[0]) + 1e6,
            "cb_ratio": 2.0 + 5.0 * r[1],
            "cb_full": between(4e6, 1.2e7, s),
            "cb_tau": 0.02 + 0.06 * r[2],
        }
    )


def _dead_volume(m, s, r):
    p = m.plant
    volume = min(p["area_2"] * p["stroke"] * between(0.03, 1.0, s), 5e-3)
    return Drawn(
        {"V_0": volume, "delta_1": 0.005 + 0.01 * r[0], "delta_2": 0.005 + 0.01 * r[1]}
    )


def _sign(r, i):
    return 1.0 if r[i] > 0.5 else -1.0


def _sensor_bias(m, s, r):
    bias = between(2e4, 6e5, s)
    one, two = bias * _sign(r, 0), bias * _sign(r, 1)
    if r["style"] < 0.3:
        two = 0.0
    elif r["style"] < 0.6:
        one = 0.0
    return Drawn(sensor={"bias_1": one, "bias_2": two})


def _skew(m, s, r):
    names = ["P_a1", "P_a2", "x"] + (["F"] if m.has_force else [])
    tau = between(0.002, 0.05, s) * _sign(r, 1)
    return Drawn(
        sensor={"skew_channel": names[int(r[0] * len(names))], "skew_tau": tau}
    )


def _pressure_friction(m, s, r):
    p = m.plant
    values = {"kappa": p["k_c"] * between(0.1, 1.0, s) / 1e7}
    if r["style"] < 0.3:
        values["kappa_v"] = p["b"] * between(0.1, 1.0, s) / 1e7
    return Drawn(values)


def _gravity(m, s, r):
    p = m.plant
    return Drawn(
        {
            "w": max(p["W"], 0.1 * p["P_src"] * p["area_2"])
            * between(0.003, 0.05, s)
            * _sign(r, 0),
            "w_radius": p["stroke"] * (0.5 + 0.7 * r[1]),
            "w_psi": r[2] - 0.5,
        }
    )


def _compliance(m, s, r):
    value = between(3e-9, 6e-8, s)
    return Drawn({"compliance": value, "contact_damping": max(2e4, 3e-4 / value)})


def _relief(m, s, r):
    p = m.plant
    flow = p["area_2"] * m.speed
    return Drawn({"rv_G": flow / 2e6, "rv_crack": m.highest_P2 * (0.98 - 0.35 * s)})


def _accumulator(m, s, r):
    p = m.plant
    return Drawn(
        {
            "acc_V": p["area_2"] * p["stroke"] * between(0.005, 0.15, s),
            "acc_P": m.rest_P2 * (0.4 + 0.4 * r[0]),
            "acc_c": p["c_p2"] * p["u_full"] * (0.05 + 0.3 * r[1]),
        }
    )


def _hose(m, s, r):
    length, area = between(1.5, 12.0, s), np.pi / 4 * (0.012 + 0.01 * r[0]) ** 2
    resistance = 8 * np.pi * 0.04 * length / area**2  # laminar, 40 mPa s
    return Drawn(
        {
            "hose_V": 0.5 * length * area,
            "hose_I": 870.0 * length / area,
            "hose_R": resistance,
        }
    )


TABLE = [
    Effect("valve_deadband", _deadband, excludes=("supply_line_drop",)),
    Effect("flow_curve", lambda m, s, r: Drawn({"e_flow": between(1.06, 2.3, s)})),
    Effect("pressure_compensation", _compensation, excludes=("supply_line_drop",)),
    Effect("counterbalance", _counterbalance, needs_weight=True),
    Effect("valve_delay", lambda m, s, r: Drawn({"tau_u": between(0.003, 0.15, s)})),
    Effect(
        "valve_lag",
        lambda m, s, r: Drawn(
            {"omega_v": 2 * np.pi * between(40.0, 3.0, s), "zeta_v": 0.5 + 0.6 * r[0]}
        ),
    ),
    Effect(
        "valve_rate_limit",
        lambda m, s, r: Drawn({"r_v": m.plant["u_full"] * between(8.0, 0.6, s)}),
    ),
    Effect(
        "valve_hysteresis",
        lambda m, s, r: Drawn({"u_h": m.plant["u_full"] * between(0.002, 0.04, s)}),
    ),
    Effect(
        "valve_bias",
        lambda m, s, r: Drawn(
            {"u_0": m.plant["u_full"] * between(0.002, 0.04, s) * _sign(r, 0)}
        ),
    ),
    Effect(
        "internal_leakage", lambda m, s, r: Drawn({"c_il": between(2e-13, 2e-11, s)})
    ),
    Effect(
        "external_leakage", lambda m, s, r: Drawn({"c_el": between(2e-13, 1e-11, s)})
    ),
    Effect("dead_volume", _dead_volume),
    Effect("entrained_air", lambda m, s, r: Drawn({"alpha": between(5e-4, 0.03, s)})),
    Effect(
        "supply_line_drop",
        lambda m, s, r: Drawn(
            {"k_s": between(1e5, 4e6, s) / (m.plant["area_2"] * m.speed) ** 2}
        ),
        excludes=("pressure_compensation", "valve_deadband"),
    ),
    Effect(
        "signal_filter",
        lambda m, s, r: Drawn(
            sensor={
                "filter_omega": 2 * np.pi * between(20.0, 1.5, s),
                "filter_zeta": 0.6 + 0.4 * r[0],
                "filter_channels": ("P_a1", "P_a2"),
            }
        ),
        excludes=("pressure_sensor_lag",),
    ),
    Effect(
        "stribeck",
        lambda m, s, r: Drawn(
            {"k_st": m.plant["k_c"] * between(0.1, 0.8, s), "v_s": 0.002 + 0.013 * r[0]}
        ),
        needs_force=True,
    ),
    Effect(
        "viscous_friction",
        lambda m, s, r: Drawn({"b": between(300.0, 1e4, s)}),
        needs_force=True,
    ),
    Effect("pressure_friction", _pressure_friction, needs_force=True),
    Effect(
        "position_friction",
        lambda m, s, r: Drawn(
            {"pos_a": between(0.05, 0.3, s), "pos_phase": 2 * np.pi * r[0]}
        ),
        needs_force=True,
    ),
    Effect(
        "payload_inertia",
        lambda m, s, r: Drawn({"m": m.plant["mass"] * between(0.005, 0.3, s)}),
        needs_force=True,
    ),
    Effect("gravity_load", _gravity, needs_force=True),
    Effect("pressure_sensor_bias", _sensor_bias),
    Effect(
        "pressure_sensor_lag",
        lambda m, s, r: Drawn(sensor={"tau_P": between(0.002, 0.05, s)}),
        excludes=("signal_filter",),
    ),
    Effect("channel_skew", _skew),
    Effect(
        "backlash",
        lambda m, s, r: Drawn({"gap": between(5e-5, 2e-3, s), "contact_damping": 1e5}),
        needs_level=True,
        excludes=("rod_compliance",),
    ),
    Effect("rod_compliance", _compliance, excludes=("backlash",)),
]
OUTSIDE = [
    Effect("relief_valve", _relief, known=False),
    Effect(
        "regenerative_valve",
        lambda m, s, r: Drawn({"regen_c": m.plant["c_n2"] * between(0.05, 0.8, s)}),
        known=False,
        needs_weight=True,
    ),
    Effect("accumulator_at_port", _accumulator, known=False),
    Effect("hose_wave", _hose, known=False),
    Effect(
        "makeup_check_valve",
        lambda m, s, r: Drawn(
            {
                "makeup_c": m.plant["c_p1"] * m.plant["u_full"] * 0.5,
                "makeup_P": m.lowest_P1 + between(2e5, 2e6, s),
            }
        ),
        known=False,
    ),
    Effect(
        "one_way_leak",
        lambda m, s, r: Drawn({"c_dl": between(5e-13, 2e-11, s)}),
        known=False,
    ),
    Effect(
        "boom_pad_friction",
        lambda m, s, r: Drawn({"pad": between(0.005, 0.06, s)}),
        known=False,
        needs_force=True,
        needs_weight=True,
    ),
    Effect(
        "oil_warming",
        lambda m, s, r: Drawn(
            {
                "therm_a": between(0.02, 0.25, s) * _sign(r, 0),
                "therm_tau": 10.0 + 30.0 * r[1],
            }
        ),
        known=False,
    ),
    Effect(
        "pump_ripple",
        lambda m, s, r: Drawn(
            {"ripple_P": between(2e5, 2.5e6, s), "ripple_f": 6.0 + 20.0 * r[0]}
        ),
        known=False,
    ),
    Effect(
        "other_consumer",
        lambda m, s, r: Drawn(
            {"other_P": between(3e5, 4e6, s), "other_T": 6.0 + 8.0 * r[0]}
        ),
        known=False,
    ),
    Effect(
        "flow_force",
        lambda m, s, r: Drawn({"flow_force": between(2e-9, 4e-8, s)}),
        known=False,
    ),
]
ALL = {e.name: e for e in TABLE + OUTSIDE}
