"""Rig files as a user would write them from data sheets: off, with wide ranges."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np

from .sizes import LITRE, Machine

CONDUCTANCE = "m^3/(s*Pa^0.5)"
SPREAD = 0.25
"""How far a start may be from the truth, as a share of it."""

RANGES: dict[str, tuple[str, float, float]] = {
    "beta": ("Pa", 4e8, 1.7e9),
    "valve_deadband.u_dbp": ("", 0.0, 0.3),
    "valve_deadband.u_dbn": ("", 0.0, 0.3),
    "valve_delay.tau_u": ("s", 0.0, 0.15),
    "valve_lag.omega": ("rad/s", 20.5, 400.0),
    "valve_lag.zeta": ("", 0.3, 0.985),
    "entrained_air.alpha": ("", 0.0, 0.05),
    "valve_rate_limit.r_v": ("1/s", 0.3, 30.0),
    "flow_curve.k": ("", 0.0, 1.0),
    "flow_curve.p": ("", 1.2, 4.0),
    "pressure_compensation.s": ("", 0.0, 1.3),
    "pressure_compensation.dP_0": ("Pa", 3e5, 2e6),
    "counterbalance.k_1": ("Pa*s^2/m^6", 1e8, 1e16),
    "counterbalance.k_2": ("Pa*s^2/m^6", 1e8, 1e16),
    "counterbalance.P_set": ("Pa", 5e6, 3.5e7),
    "counterbalance.ratio": ("", 1.0, 12.0),
    "counterbalance.dP_full": ("Pa", 2e6, 5e7),
    "counterbalance.tau": ("s", 0.001, 0.5),
    "counterbalance.V_line": ("m^3", 1e-4, 6e-3),
    "signal_filter.omega": ("rad/s", 3.2, 190.0),
    "signal_filter.zeta": ("", 0.3, 0.98),
    "return_overlap.o_n1": ("", -0.4, 0.4),
    "return_overlap.o_n2": ("", -0.4, 0.4),
    "internal_leakage.c_il": ("m^3/(s*Pa)", 0.0, 1e-10),
}
"""Unit and ends of each range that does not depend on the machine."""


def true_parameters(machine: Machine) -> dict[str, float]:
    """The declared model's own parameters, SI. A line counts as its chamber's oil."""
    p = machine.parameters
    line_1 = p.V_line * p.has_line * (1 - p.holding)
    line_2 = p.V_line * p.has_line * p.holding
    return {
        "beta": p.beta,
        "c_p1": p.c_p1,
        "c_n1": p.c_n1,
        "c_p2": p.c_p2,
        "c_n2": p.c_n2,
        "delta_1": (p.V_1 + line_1) / p.A_1,
        "delta_2": (p.V_2 + line_2) / p.A_2,
    }


def rig_text(machine: Machine) -> str:
    """The rig file: every start off by up to `SPREAD`, no word of what is left out."""
    rng = np.random.default_rng([machine.seed, machine.attempt, 4])
    p = machine.parameters
    lines = [
        f'name = "machine {machine.seed:02d}"',
        'layout = "differential"',
        "",
        "[geometry]",
        f'area_1 = "{p.A_1:.5g} m^2"',
        f'area_2 = "{p.A_2:.5g} m^2"',
        f'chamber_length = "{p.stroke:g} m"',
        f'x_mid = "{p.stroke / 2:g} m"',
        "",
        "[supply]",
        f'P_s = "{p.P_max:.4g} Pa"',
        f'P_r = "{p.P_r:g} Pa"',
        "",
        "[parameters]",
    ]
    areas = {"delta_1": p.A_1, "delta_2": p.A_2}
    for name, value in true_parameters(machine).items():
        start = _off(rng, value)
        if name == "beta":
            lines.append(_entry(name, *RANGES[name], start))
        elif name in areas:
            low, high = 0.2 * LITRE / areas[name], 6 * LITRE / areas[name]
            lines.append(_entry(name, "m", low, high, start))
        else:
            lines.append(_entry(name, CONDUCTANCE, start / 6, start * 6, start))
    for effect, values in machine.truth.items():
        starts = {n: _off(rng, v) for n, v in values.items()}
        if effect not in machine.left_out:
            lines += ["", f"[effects.{effect}]"]
            lines += [
                _entry(n, *RANGES[f"{effect}.{n}"], start)
                for n, start in starts.items()
            ]
    return "\n".join(lines) + "\n"


def _off(rng: np.random.Generator, value: float) -> float:
    return value * float(rng.uniform(1 - SPREAD, 1 + SPREAD))


def _entry(name: str, unit: str, low: float, high: float, start: float) -> str:
    """One line of the file; a start outside its range comes a little inside it."""
    inside = 0.01 * (high - low)
    start = min(max(start, low + (inside if start <= low else 0.0)), high - inside)
    said = [f"{value:.4g} {unit}".rstrip() for value in (start, low, high)]
    return f'{name} = {{ start = "{said[0]}", range = ["{said[1]}", "{said[2]}"] }}'


def truth_text(machine: Machine) -> str:
    """What the machine is, as JSON: names left out, effects, the rest of the plant."""
    truth: Mapping[str, object] = {
        "left_out": machine.left_out,
        "parameters": true_parameters(machine),
        "effects": machine.truth,
        "validation_load": machine.load,
        "pressure_noise": machine.noise,
        "pressure_resolution": machine.lsb,
        "seed": machine.seed,
        "attempt": machine.attempt,
        "plant": machine.parameters._asdict(),
    }
    return json.dumps(truth, indent=1) + "\n"
