"""What the benchmark's plant can hide, and how large each effect is at size 1.

Size 1 is a size that matters: it raises the declared model's validation error to some
two or three times a channel's noise on the logs of this benchmark. Sizes scale
`strengths` up and `inverse` down (a slower spool is a larger effect).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

LARGEST = math.inf
"""The size that stands for the largest values that the field's literature names."""

Values = dict[str, float]
Effects = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class Kind:
    """One effect of the plant.

    Attributes:
        at_1: its parameters at size 1, SI (commands in V).
        strengths: parameters that grow with size.
        inverse: parameters that fall with size.
        known: parameters of the rig that are known, and held at the value given (None:
            at the truth), because no log could tell the effect from them.
        largest: parameters at the size `LARGEST`, where they are not those of size 3.
    """

    at_1: Values
    strengths: tuple[str, ...] = ()
    inverse: tuple[str, ...] = ()
    known: Mapping[str, float | None] = field(default_factory=dict)
    largest: Mapping[str, float] = field(default_factory=dict)

    def scaled(self, size: float) -> Values:
        """Parameters at a size; at 0 the effect is absent."""
        if size == LARGEST:
            return self.scaled(3.0) | dict(self.largest)
        out = dict(self.at_1)
        for name in self.strengths:
            out[name] *= size
        for name in self.inverse:
            out[name] /= size
        return out


def _one(known: Mapping[str, float | None] | None = None, **values: float) -> Kind:
    return Kind(values, (next(iter(values)),), known=known or {})


NAMED: dict[str, Kind] = {
    "valve_bias": _one(u_0=0.005),
    "valve_deadband": Kind({"u_dbp": 0.012, "u_dbn": 0.009}, ("u_dbp", "u_dbn")),
    "valve_hysteresis": _one(u_h=0.01),
    "valve_delay": _one(tau_u=0.3e-3),
    "valve_lag": Kind({"omega": 4000.0, "zeta": 0.7}, (), ("omega",)),
    "internal_leakage": _one(c_il=3e-14),
    "external_leakage": _one(c_el=1e-14),
    "supply_line_drop": _one(k_s=1.5e14),
    "entrained_air": _one(alpha=0.02, n=1.2),
    "viscous_friction": _one({"k_vp": 0.0, "k_vn": 0.0}, b=1200.0, s=0.0),
    "stribeck": _one(k_st=40.0, v_s=4e-3),
    "bristle_damping": _one(sigma_1=1.2e4),
    "pressure_friction": _one(kappa=1.9e-5, kappa_v=0.0),
    "position_friction": _one(a=0.02, wavelength=0.02),
    "friction_drift": _one(a=0.03, tau=6.0),
    "payload_inertia": _one(m=8.0),
    "gravity_load": _one(w=50.0, psi_0=0.8),
    "loadcell_lag": _one(tau_F=0.4e-3),
    "loadcell_gain": _one(eps=0.03),
    "pressure_sensor_lag": _one(tau_P=0.8e-3),
    "valve_rate_limit": Kind({"r_v": 300.0}, (), ("r_v",)),
    "orifice_transition": _one(dP_t=6e5),
    "underlap": _one(u_ul=0.02),
    "dead_volume": _one({"delta_1": None, "delta_2": None}, V_0=3e-5),
    "frictional_lag": _one(tau_h=0.08),
    "rod_compliance": Kind({"k": 4e7}, (), ("k",)),
    "backlash": _one(b=3e-6),
    "pressure_sensor_bias": Kind({"b_1": 1e5, "b_2": -6e4}, ("b_1", "b_2")),
    "channel_skew": _one(tau=0.4e-3),
}
"""Effects of the product's vocabulary, those that the mix of cases is drawn from."""

LATER: dict[str, Kind] = {
    "film_friction": Kind(
        {"k_h": 25.0, "kappa_h": 0.0, "n": 0.5},
        ("k_h",),
        largest={"k_h": 400.0, "n": 0.65},
    ),
    "friction_at_rest": Kind({"s": 0.1}, ("s",), largest={"s": 1.0}),
    "loadcell_bias": _one(b=10.0),
    "pressure_sensor_gain": Kind(
        {"eps_1": 0.01, "eps_2": -0.006},
        ("eps_1", "eps_2"),
        largest={"eps_1": 0.05, "eps_2": 0.02},
    ),
    "port_relief": Kind(
        {"g_1": 5e-14, "g_2": 5e-14, "P_set1": 7.2e6, "P_set2": 7.4e6},
        ("g_1", "g_2"),
        largest={"g_1": 1e-11, "g_2": 1e-11},
    ),
    "return_line_drop": Kind({"k_r": 1.5e14}, ("k_r",), largest={"k_r": 2e15}),
}
"""Effects that joined the vocabulary when the mix had been drawn: `--more later=N`."""

OUTSIDE: dict[str, Kind] = {
    "spool_flow_force": _one(k_q=3e-9),
    "valve_dither": _one(volts=0.3, hertz=87.0),
    "scored_bore": _one(c_il=2e-13, width=4e-3),
    "end_cushion": _one(k=3e4, x_from=7e-3),
    "dwell_friction": _one(a=0.12, tau=1.5, v_d=1.5e-3),
    "side_load": _one(a=0.05, hertz=0.37),
    "loadcell_crosstalk": _one(force=8.0),
    "mains_hum": Kind({"force": 6.0, "pressure": 2.5e4}, ("force", "pressure")),
    "warming_valve": _one(a=0.03, tau=8.0),
    "eccentric_joint": _one(e=4e-6, wavelength=7e-3),
    "tap_resonance": Kind({"omega": 500.0, "zeta": 0.12}, (), ("omega",)),
}
"""Effects that no vocabulary here names."""

UNNAMED: dict[str, Kind] = {
    "settling_friction": _one(a=0.06, way=1.5e-3),
    "sprung_linkage": _one(k=9e-3, reach=0.1),
    "gas_pocket": _one(c=9e-11, P_0=6.5e6),
    "rate_and_state": _one(f=64.0, theta=0.02, D=1e-3),
    "hardening_spring": _one(k=1.2e8),
    "bent_bridge": _one(c=1e-4),
    "one_way_seal": _one(c=3.2e-14),
    "simple_spool": _one(tau=0.17e-3),
    "wiper_pressure": _one(kappa=5.3e-5),
    "pump_shake": _one(f=8.2, hertz=11.0),
    "creeping_hose": _one(C=1.6e-14, tau=0.2),
    "notched_spool": _one(k=0.023, width=0.5),
    "quadratic_drag": _one(c=2.8e5),
    "sticky_cell": _one(a=0.15, reach=60.0),
    "tapered_bore": _one(b=1.2e5),
    "weeping_rod": _one(k=1.7e-11),
    "rusty_patch": _one(f=50.0, x_from=2e-3),
    "drifting_null": _one(u_0=3.5e-3, tau=5.0),
    "rolling_seal": _one(f=46.0, reach=3e-4),
    "warming_gauge": _one(b=1e5, tau=6.0),
    "swollen_land": _one(kappa=1.9e-5, width=4e-3),
    "cracked_piston": _one(k=2.6e-11),
    "one_way_stribeck": _one(f=55.0, v_s=4e-3),
    "tether_drag": _one(c=3.3e5),
    "coarse_converter": _one(lsb=0.05),
    "warming_oil": _one(a=0.11, tau=6.0),
    "relaxing_seal": _one(f=95.0, tau=0.1),
    "creeping_cell": _one(a=0.15, tau=0.5),
    "bell_mouthed_bore": _one(c=9e-12, x_from=2e-3),
    "loaded_bearing": _one(mu=0.0625),
    "rack_cogging": _one(f=12.5, pitch=2e-3),
    "pressure_null": _one(u_0=0.017),
    "softening_hose": _one(k=3e-17),
    "thick_oil": _one(b=1.1e4, tau=5.0),
    "warming_cell": _one(b=80.0, tau=6.0),
    "warming_seal": _one(c=5e-14, tau=6.0),
    "lip_seal": _one(kappa=3.2e-5),
    "soft_hose": _one(k=1.4e4, tau=1.0),
    "sticking_spool": _one(u_s=0.037),
    "dragged_oil": _one(k=5.6e-5),
    "polished_bore": _one(f=140.0, way=0.05),
    "bent_gauge": _one(c=1e-9),
}
"""More of these, which no mix draws from: what an engineer may meet at each place, the
places by turns, so that the first few are of all. Laws in `plant` and `unnamed`.
"""

SIZES = (0.3, 1.0, 3.0)

_LARGEST: dict[str, Values] = {
    "valve_bias": {"u_0": 0.3},
    "valve_deadband": {"u_dbp": 1.0, "u_dbn": 0.6},
    "valve_hysteresis": {"u_h": 0.15},
    "valve_delay": {"tau_u": 2e-3},
    "valve_lag": {"omega": 188.0, "zeta": 0.8},
    "internal_leakage": {"c_il": 1e-11},
    "external_leakage": {"c_el": 1e-12},
    "supply_line_drop": {"k_s": 2e15},
    "viscous_friction": {"b": 5000.0, "s": 1.0},
    "stribeck": {"k_st": 800.0, "v_s": 1e-2},
    "bristle_damping": {"sigma_1": 1e5},
    "pressure_friction": {"kappa": 4e-5},
    "position_friction": {"a": 0.25, "wavelength": 0.05},
    "friction_drift": {"a": 0.3, "tau": 40.0},
    "payload_inertia": {"m": 20.0},
    "gravity_load": {"w": 500.0},
    "loadcell_lag": {"tau_F": 5e-3},
    "loadcell_gain": {"eps": 0.08},
    "pressure_sensor_lag": {"tau_P": 8e-3},
    "underlap": {"u_ul": 0.2},
    "dead_volume": {"V_0": 1e-4},
    "frictional_lag": {"tau_h": 0.3},
    "rod_compliance": {"k": 5e6},
    "backlash": {"b": 1e-4},
    "pressure_sensor_bias": {"b_1": 5e5, "b_2": -3e5},
    "channel_skew": {"tau": 3e-3},
}
NAMED = {n: replace(k, largest=_LARGEST.get(n, {})) for n, k in NAMED.items()}

ALL = NAMED | LATER | OUTSIDE | UNNAMED

ENDS: dict[str, dict[str, float]] = {
    "valve_deadband": {"u_dbp": 5.0},
    "valve_hysteresis": {"u_h": 2.0},
    "valve_delay": {"tau_u": 0.15},
    "valve_lag": {"omega": 20.0},
    "valve_rate_limit": {"r_v": 5.0},
    "backlash": {"b": 5e-3},
    "loadcell_lag": {"tau_F": 0.1},
    "pressure_sensor_lag": {"tau_P": 0.1},
    "channel_skew": {"tau": 3e-3},
}
"""Ends of the ranges of effects whose residual is not monotone in their strength."""


def _ratio(kind: Kind, values: dict[str, float]) -> float:
    """The size at which an effect's first parameter that scales is as given."""
    name = next(n for n in (*kind.strengths, *kind.inverse) if n in values)
    ratio = values[name] / kind.at_1[name]
    return ratio if name in kind.strengths else 1 / ratio


def largest(name: str) -> tuple[float, float]:
    """The sizes at the largest of the literature, and at the range's end."""
    kind = NAMED[name]
    known = _ratio(kind, kind.scaled(LARGEST))
    return known, _ratio(kind, ENDS[name]) if name in ENDS else known
