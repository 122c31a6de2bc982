"""The benchmark's laws as curves: what a search would have to find."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

Law = Callable[[np.ndarray], np.ndarray]
E = Mapping[str, float]

P_R = 2.5e5  # Pa, the return pressure of the benchmark's rigs


def _air(P: np.ndarray, e: E) -> np.ndarray:
    p, p_0, n = np.maximum(P, 0.0) + 101_325.0, 101_325.0, e["n"]
    return e["alpha"] * (p_0 / p) ** (1 / n) / (n * p)


def _pocket(P: np.ndarray, e: E) -> np.ndarray:
    return np.where(e["P_0"] < P, e["c"] * (e["P_0"] / np.maximum(P, 1.0)) ** 2, 0.0)


def _bell(s: np.ndarray, width: float) -> np.ndarray:
    return np.exp(-((s / width) ** 2))


SHARES: dict[str, tuple[str, Callable[[np.ndarray, E], np.ndarray]]] = {
    "position_friction": (
        "x",
        lambda x, e: e["a"] * np.sin(2 * np.pi / e["wavelength"] * x),
    ),
    "friction_drift": ("t", lambda t, e: e["a"] * np.expm1(-t / e["tau"])),
    "settling_friction": ("way", lambda s, e: e["a"] * np.exp(-s / e["way"])),
    "side_load": (
        "t",
        lambda t, e: e["a"] * np.abs(np.sin(2 * np.pi * e["hertz"] * t)),
    ),
}
"""Levels that are a share of the Coulomb level: the signal, and the share."""

VALVE: dict[str, dict[str, Callable[[np.ndarray, E], np.ndarray]]] = {
    "drifting_null": {"head_t": lambda t, e: -e["u_0"] * np.expm1(-t / e["tau"])},
    "pressure_null": {"head_P_s": lambda P, e: e["u_0"] * (P / 14e6 - 1)},
    "warming_valve": {"through_t": lambda t, e: -e["a"] * np.expm1(-t / e["tau"])},
}
"""What the valve does, of a spool elsewhere (V) or edges of another size (a share)."""

CURVES: dict[str, dict[str, Callable[[np.ndarray, E], np.ndarray]]] = {
    "stribeck": {"level_v": lambda v, e: e["k_st"] * _bell(v, e["v_s"])},
    "one_way_stribeck": {"level_v": lambda v, e: e["f"] * _bell(v, e["v_s"]) * (v > 0)},
    "viscous_friction": {
        "friction_v": lambda v, e: e["b"] * v,
        "level_v": lambda v, e: e["b"] * np.abs(v),
    },
    "pressure_friction": {"level_P_mean": lambda P, e: e["kappa"] * P},
    "wiper_pressure": {"level_P_net": lambda P, e: e["kappa"] * np.abs(P)},
    "lip_seal": {"level_P_a1": lambda P, e: e["kappa"] * P},
    "rusty_patch": {
        "level_x": lambda x, e: e["f"] * (1 + np.tanh((x - e["x_from"]) / 3e-4)) / 2
    },
    "relaxing_seal": {"level_since": lambda t, e: e["f"] * np.exp(-t / e["tau"])},
    "rate_and_state": {
        "level_age_1000um": lambda A, e: e["f"] * np.log1p(A / e["theta"])
    },
    "tapered_bore": {"friction_per_v_x": lambda x, e: e["b"] * x},
    "thick_oil": {"friction_per_v_t": lambda t, e: e["b"] * np.exp(-t / e["tau"])},
    "quadratic_drag": {"friction_v": lambda v, e: e["c"] * np.abs(v) * v},
    "swollen_land": {
        "level_per_P_mean_x": lambda x, e: e["kappa"] * _bell(x, e["width"])
    },
    "payload_inertia": {"force_a": lambda a, e: -e["m"] * a},
    "gravity_load": {"force_x": lambda x, e: e["w"] * np.sin(x / 0.085 + e["psi_0"])},
    "end_cushion": {"force_x": lambda x, e: -e["k"] * np.maximum(x - e["x_from"], 0)},
    "rack_cogging": {
        "force_x": lambda x, e: -e["f"] * np.sin(2 * np.pi * x / e["pitch"])
    },
    "hardening_spring": {"force_x": lambda x, e: -e["k"] * x**3},
    "tether_drag": {"force_v": lambda v, e: -e["c"] * np.abs(v) * v},
    "pump_shake": {"force_t": lambda t, e: e["f"] * np.sin(2 * np.pi * e["hertz"] * t)},
    "bent_bridge": {"force_F": lambda F, e: e["c"] * np.abs(F) * F},
    "loadcell_gain": {"force_F": lambda F, e: e["eps"] * F},
    "warming_cell": {"force_t": lambda t, e: -e["b"] * np.expm1(-t / e["tau"])},
    "rolling_seal": {"hysteresis_w_300um": lambda w, e: e["f"] * (w / e["reach"]) ** 3},
    "external_leakage": {"flow_P": lambda P, e: -e["c_el"] * (P - P_R)},
    "internal_leakage": {"flow_across_P_net": lambda P, e: e["c_il"] * P},
    "one_way_seal": {"flow_across_P_net": lambda P, e: e["c"] * np.minimum(P, 0.0)},
    "cracked_piston": {
        "flow_across_P_net": lambda P, e: e["k"] * np.sign(P) * np.sqrt(np.abs(P))
    },
    "weeping_rod": {
        "flow_1_P_a1": lambda P, e: -e["k"] * np.sqrt(np.maximum(P - P_R, 0.0))
    },
    "dragged_oil": {"flow_v": lambda v, e: -e["k"] * np.abs(v)},
    "warming_seal": {
        "flow_across_per_P_net_t": lambda t, e: -e["c"] * np.expm1(-t / e["tau"])
    },
    "scored_bore": {
        "flow_across_per_P_net_x": lambda x, e: e["c_il"] * _bell(x, e["width"])
    },
    "bell_mouthed_bore": {
        "flow_across_per_P_net_x": lambda x, e: e["c"] * np.maximum(x - e["x_from"], 0)
    },
    "entrained_air": {"compliance_P": _air},
    "softening_hose": {"compliance_P": lambda P, e: e["k"] * P},
    "gas_pocket": {"compliance_P": _pocket},
    "valve_bias": {"command_u": lambda u, e: 0 * u + e["u_0"]},
    "notched_spool": {
        "command_u": lambda u, e: -e["k"] * u * np.exp(-np.abs(u) / e["width"])
    },
    "sprung_linkage": {
        "command_back_100m": lambda w, e: -e["k"] * (w / e["reach"]) ** 3
    },
}
"""Effects that a curve is, by the names of the terms that can be it."""


def laws(name: str, e: E, rig: Mapping[str, float]) -> dict[str, Law]:
    """The truth as a curve, by the names of the terms that can be it; SI.

    What is a share of the Coulomb level is a curve in N only if both directions have
    one level: the mean of them stands for it.
    """
    of = {f"free_{term}": law for term, law in CURVES.get(name, {}).items()}
    out: dict[str, Law] = {n: lambda s, law=law: law(s, e) for n, law in of.items()}
    if name in SHARES:
        signal, share = SHARES[name]
        level = (rig["k_cp"] + rig["k_cn"]) / 2
        out[f"free_level_per_level_{signal}"] = lambda s: share(s, e)
        out[f"free_level_{signal}"] = lambda s: level * share(s, e)
    for term, law in VALVE.get(name, {}).items():
        out[f"free_flow_per_{term}"] = lambda s, law=law: law(s, e)
    return out
