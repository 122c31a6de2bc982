"""Draws machines: what they are built of, what they do, what their rig file omits."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .laws import Parameters, lever

BAR = 1e5
LITRE = 1e-3
EVERYWHERE = ("valve_deadband", "valve_delay", "valve_lag", "entrained_air")
SOME = (
    "valve_rate_limit",
    "flow_curve",
    "pressure_compensation",
    "counterbalance",
    "signal_filter",
    "internal_leakage",
)
SHARE = 0.25
"""Share of machines that have each of `SOME`, and of those after `LATER` whose edges
to the return have overlaps of their own."""
LATER = 49
"""From this seed on they may: those before stay what they were."""

ABSENT = {
    "r_v": 1e3,
    "k": 0.0,
    "p": 1.0,
    "compensated": 0.0,
    "dP_c": 1.0,
    "has_line": 0.0,
    "P_set": 0.0,
    "ratio": 1.0,
    "dP_full": 1.0,
    "c_out": 0.0,
    "c_check": 0.0,
    "V_line": 1.0,
    "tau_pilot": 1.0,
    "c_il": 0.0,
    "o_n1": 0.0,
    "o_n2": 0.0,
}
"""Parameters of effects that a machine does not have. SI."""


@dataclass(frozen=True)
class Machine:
    """One machine as it is.

    Attributes:
        seed: of all that was drawn.
        attempt: how many draws of this seed were rejected before.
        parameters: of the plant under the load of the fitted logs.
        truth: each effect's parameters by the names of hydrojax's rig file, SI.
        left_out: effects that the rig file does not declare.
        delay: dead time, s.
        filter: frequency in Hz and damping of the logger's low-pass, or None.
        load: the validation log's load, as a multiple of the fitted logs'.
        noise: standard deviation of the logged pressures, Pa.
        lsb: their resolution, Pa.
        speed: of the piston at full command, m/s.
        P_static: least and most pressure that holds the load, over the stroke and
            both loads, Pa.
    """

    seed: int
    attempt: int
    parameters: Parameters
    truth: dict[str, dict[str, float]]
    left_out: tuple[str, ...]
    delay: float
    filter: tuple[float, float] | None
    load: float
    noise: float
    lsb: float
    speed: float
    P_static: tuple[float, float]

    def loaded(self, share: float) -> Parameters:
        """Parameters with `share` times the load."""
        p = self.parameters
        return p._replace(inertia=p.inertia * share, moment=p.moment * share)


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """Log-uniform."""
    return float(low * (high / low) ** rng.random())


def draw(seed: int, attempt: int = 0) -> Machine:
    """The machine of a seed; the next attempt's where a recording was no good."""
    rng = np.random.default_rng([2026, seed, attempt])
    has = [*EVERYWHERE, *(name for name in SOME if rng.random() < SHARE)]
    if seed >= LATER and rng.random() < SHARE:
        has.append("return_overlap")
    # So that thirds stay thirds over consecutive seeds, and redraws do not bend them.
    count = (0, 1, int(rng.integers(2, 4)))[seed % 3]
    left_out = tuple(sorted(str(n) for n in rng.choice(has, count, replace=False)))
    geometry = _cylinder(rng)
    load = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.15, 0.4)) + 1.0
    geometry |= _boom(rng, geometry)
    speed = _between(rng, 0.1, 0.35)
    truth: dict[str, dict[str, float]] = {
        "valve_deadband": {
            "u_dbp": _between(rng, 0.03, 0.2),
            "u_dbn": _between(rng, 0.03, 0.2),
        },
        "valve_delay": {"tau_u": round(_between(rng, 0.02, 0.12), 4)},
        "valve_lag": {
            "omega": _between(rng, 22.0, 80.0),
            "zeta": float(rng.uniform(0.5, 0.95)),
        },
        "entrained_air": {"alpha": _between(rng, 1e-3, 1.5e-2)},
    }
    values = ABSENT | geometry | _pump(rng, "pressure_compensation" in has)
    values |= truth["valve_deadband"] | truth["valve_lag"] | truth["entrained_air"]
    values |= _some(rng, has, truth, values, speed)
    forces = _weights(values, (1.0, load))
    values |= _edges(values, speed, forces)
    if "counterbalance" in has:
        values |= _over_centre(rng, truth, values, speed, max(forces))
    low, high = min(forces), max(forces)
    side = values["A_2"] if values["holding"] else values["A_1"]
    coarse = rng.random() < 1 / 6
    return Machine(
        seed=seed,
        attempt=attempt,
        parameters=Parameters(**values),
        truth=truth,
        left_out=left_out,
        delay=truth["valve_delay"]["tau_u"],
        filter=(
            (truth["signal_filter"]["omega"] / math.tau, truth["signal_filter"]["zeta"])
            if "signal_filter" in truth
            else None
        ),
        load=load,
        noise=_between(rng, 0.03, 0.1) * BAR,
        lsb=400 * BAR / (4096 if coarse else 16384),
        speed=speed,
        P_static=(low / side, high / side),
    )


def _cylinder(rng) -> dict[str, float]:
    """Areas, stroke, volumes and oil."""
    bore = round(rng.uniform(0.07, 0.13), 3)
    rod = round(bore * rng.uniform(0.55, 0.75), 3)
    full = math.pi / 4 * bore**2
    return {
        "A_1": full - math.pi / 4 * rod**2,
        "A_2": full,
        "stroke": round(_between(rng, 0.4, 0.9), 2),
        "V_1": _between(rng, 0.5, 2.5) * LITRE,
        "V_2": _between(rng, 0.5, 2.5) * LITRE,
        "beta": _between(rng, 0.7e9, 1.6e9),
        "holding": float(rng.random() < 0.75),
        "coulomb": full * rng.uniform(1.0, 3.0) * BAR,
        "viscous": full * _between(rng, 1e5, 1e6),
    }


def _boom(rng, c: dict[str, float]) -> dict[str, float]:
    """Pins, inertia and weight: a static pressure and a reflected mass decide them."""
    length = c["stroke"] + rng.uniform(0.35, 0.5)
    first, swing = np.radians(rng.uniform(40, 60)), np.radians(rng.uniform(55, 75))
    # Two sides of a triangle from the third at both ends of the stroke.
    both = (length + c["stroke"]) ** 2 - length**2
    both /= 2 * (np.cos(first) - np.cos(first + swing))
    total = math.sqrt(length**2 + 2 * both * (np.cos(first) + 1))
    apart = math.sqrt(length**2 + 2 * both * (np.cos(first) - 1))
    level = first + swing * rng.uniform(0.3, 0.8)
    pins = {
        "arm_a": (total + apart) / 2,
        "arm_b": (total - apart) / 2,
        "length": length,
        "cos_0": float(np.cos(level)),
        "sin_0": float(np.sin(level)),
    }
    bare = Parameters(**(dict.fromkeys(Parameters._fields, 0.0) | pins | {"moment": 1}))
    arm, weight, _ = lever(c["stroke"] / 2, bare)
    pressure = _between(rng, 30, 90) * BAR
    # Where chamber 1 bears the weight, that pulls the rod out.
    force = pressure * (c["A_2"] if c["holding"] else -c["A_1"])
    return pins | {
        "inertia": _between(rng, 2e3, 2e4) * float(arm) ** 2,
        "moment": force / float(weight),
    }


def _pump(rng, compensated: bool) -> dict[str, float]:
    """Supply; a compensated valve mostly has a load-sensing pump."""
    senses = float(rng.random() < (0.8 if compensated else 0.4))
    return {
        "senses": senses,
        "P_max": rng.uniform(150, 250) * BAR,
        "margin": rng.uniform(15, 25) * BAR,
        "P_least": 20 * BAR,
        "tau_pump": rng.uniform(0.04, 0.1) if senses else rng.uniform(0.01, 0.03),
        "P_r": 2 * BAR,
        "sag": 0.0,
    }


def _some(rng, has, truth, values, speed) -> dict[str, float]:
    """Effects that only some machines have, but the over-centre valve."""
    own: dict[str, float] = {}
    if "valve_rate_limit" in has:
        own["r_v"] = _between(rng, 1.0, 5.0)
        truth["valve_rate_limit"] = {"r_v": own["r_v"]}
    if "flow_curve" in has:
        own |= {"k": float(rng.uniform(0.3, 0.9)), "p": float(rng.uniform(1.5, 3.0))}
        truth["flow_curve"] = {"k": own["k"], "p": own["p"]}
    if "pressure_compensation" in has:
        own |= {"compensated": 1.0, "dP_c": float(rng.uniform(5, 12)) * BAR}
        truth["pressure_compensation"] = {"s": 1.0, "dP_0": own["dP_c"]}
    if "signal_filter" in has:
        truth["signal_filter"] = {
            "omega": math.tau * _between(rng, 2.0, 10.0),
            "zeta": float(rng.uniform(0.6, 0.95)),
        }
    if "return_overlap" in has:
        # From open at centre, but for the chamber that holds the load, to twice the
        # partner's overlap.
        lands, least = truth["valve_deadband"], (-1.3, -0.8)
        least_1, least_2 = least if values["holding"] else least[::-1]
        own["o_n1"] = lands["u_dbn"] * float(rng.uniform(least_1, 1.0))
        own["o_n2"] = lands["u_dbp"] * float(rng.uniform(least_2, 1.0))
        truth["return_overlap"] = {n: own[n] for n in ("o_n1", "o_n2")}
    if "internal_leakage" in has:
        rated = values["A_2"] * speed
        own["c_il"] = _between(rng, 0.01, 0.05) * rated / (100 * BAR)
        truth["internal_leakage"] = {"c_il": own["c_il"]}
    return own


def _weights(values: dict[str, float], loads) -> list[float]:
    """Size of the weight's force on the rod over the stroke and the loads, N."""
    p = Parameters(**({"c_p1": 0, "c_n1": 0, "c_p2": 0, "c_n2": 0} | values))
    strokes = np.linspace(0.05, 0.95, 19) * p.stroke
    return [abs(float(load * lever(x, p)[1])) for x in strokes for load in loads]


def _edges(values: dict[str, float], speed: float, forces) -> dict[str, float]:
    """Metering edges that give the speed at full command, and pressures that hold.

    The edge that drains the bearing chamber is so narrow that the other one stays
    under pressure with the heaviest load; the one that drains the other chamber leaves
    20 bar in it.
    """
    heavy, light = max(forces), min(forces)
    middle, BARS = 0.5 * (heavy + light), 20 * BAR
    A_b, A_o = values["A_2"], values["A_1"]  # bearing, other
    if not values["holding"]:
        A_b, A_o = A_o, A_b
    P_max, P_r = values["P_max"], values["P_r"]
    lowered = BARS + (heavy - middle) / A_o
    bears = (middle + A_o * lowered) / A_b
    lifted = (middle + A_o * BARS) / A_b
    if values["compensated"]:
        drops = values["dP_c"], values["dP_c"]
    elif values["senses"]:
        drops = values["margin"], values["margin"]
    else:
        drops = max(P_max - lifted, 1.0), max(P_max - lowered, 1.0)
    # At full command the opening is less than 1 by the overlap.
    full = speed / (1 - max(values["u_dbp"], values["u_dbn"]))
    feeds_b = A_b * full / math.sqrt(drops[0])
    feeds_o = A_o * full / math.sqrt(drops[1])
    drains_b = A_b * full / math.sqrt(bears - P_r)
    drains_o = A_o * full / math.sqrt(BARS - P_r)
    sag = 0.03 * P_max / (A_b * speed) if not values["senses"] else 0.0
    if values["holding"]:
        edges = {"c_p2": feeds_b, "c_n2": drains_b, "c_p1": feeds_o, "c_n1": drains_o}
    else:
        edges = {"c_p1": feeds_b, "c_n1": drains_b, "c_p2": feeds_o, "c_n2": drains_o}
    return edges | {"sag": sag}


def _over_centre(rng, truth, values, speed, heaviest) -> dict[str, float]:
    """An over-centre valve on the bearing chamber, set above what it must hold."""
    side = "2" if values["holding"] else "1"
    area = values["A_" + side]
    c_out = area * speed / math.sqrt(_between(rng, 8, 20) * BAR)
    own = {
        "P_set": heaviest / area * rng.uniform(1.2, 1.4),
        "ratio": _between(rng, 2.0, 5.0),
        "dP_full": rng.uniform(80, 200) * BAR,
        "c_out": c_out,
        "c_check": 1.5 * c_out,
        "V_line": _between(rng, 0.4, 3.0) * LITRE,
        "tau_pilot": _between(rng, 0.02, 0.2),
    }
    truth["counterbalance"] = {
        # What it loses 100 bar beyond its setting.
        "k_" + side: (own["dP_full"] / (100 * BAR) / c_out) ** 2,
        "P_set": own["P_set"],
        "ratio": own["ratio"],
        "dP_full": own["dP_full"],
        "tau": own["tau_pilot"],
        "V_line": own["V_line"],
    }
    return own | {"has_line": 1.0}
