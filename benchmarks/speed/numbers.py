"""A closed loop as plain numbers, which is all that the peers are given.

A `Loop` goes in whose leaves are scalars or [B] (B instances); a dictionary of float64
arrays of one shape comes out. What does not change during a run is worked out here
once: the spool's exact step, the share of the filtered speed that a part keeps.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hydrojax.control.base import Estimates
from hydrojax.control.inverting import mean_area
from hydrojax.control.loop import Loop, Scenario
from hydrojax.control.simulation import PARTS
from hydrojax.effects.valve import QUEUE, ValveDelay, ValveLag
from hydrojax.parameters import values
from hydrojax.plant.load import Driven
from hydrojax.plant.places import PLACES
from hydrojax.plant.rig import Rig

KEPT = ("u", "P_a1", "P_a2", "F", *Estimates._fields)
"""What a peer can write at each sample, SI: the command, true pressures and force, and
the estimates that made the command."""

KEEP = ("u", "true_P_a1", "true_P_a2", "true_F", *Estimates._fields)
"""The same in the words of `hydrojax.control.loop.run`."""

Numbers = dict[str, np.ndarray]


def plant(rig: Rig) -> Numbers:
    """Valve, chambers and friction of a rig, SI.

    Raises:
        ValueError: an effect that the peers have not.
    """
    for place in PLACES:
        for effect in getattr(rig, place):
            if not isinstance(effect, (ValveDelay, ValveLag)):
                raise ValueError(f"the peers have no effect {effect.name!r}")
    c = rig.chambers
    given = values(rig.valve) | values(rig.mechanics)
    given |= {"area_1": c.area_1, "area_2": c.area_2, "beta": c.beta}
    given |= {"act_1": rig.force_area_1, "act_2": rig.force_area_2}
    given |= {"half_1": c.length / 2 + c.delta_1, "half_2": c.length / 2 + c.delta_2}
    out = {name: np.asarray(v, float) for name, v in given.items()}
    return out | worked_out(out)


def worked_out(n: Numbers) -> Numbers:
    """What the inner loops want instead of dividing: valve constants over areas."""
    edges = ("p1", "n1", "p2", "n2")
    over = {f"d_{e}": n[f"c_{e}"] / n[f"area_{e[1]}"] for e in edges}
    return over | {"per_z_ss": 1 / n["z_ss"]}


def spool(rig: Rig, h: float) -> Numbers:
    """The exact step of the spool over `h` seconds under a held command.

    `off` and `rate` (times tau) become `yy off + yr rate` and `ry off + rr rate`; the
    mean opening is the command plus `m_y` and `m_r` times what both lost.
    """
    lags = [c for c in rig.command if isinstance(c, ValveLag)]
    tau, zeta = (
        (np.asarray(lags[0].tau, float), np.asarray(lags[0].zeta, float))
        if lags
        else (np.zeros(()), np.zeros(()))
    )
    zeta = np.clip(zeta, 0.0, 0.999)
    absent = tau <= 0
    s, w = h / np.where(absent, 1.0, tau), np.sqrt(1 - zeta**2)
    fade = np.where(absent, 0.0, np.exp(-zeta * s))
    cos, sin = fade * np.cos(w * s), fade * np.sin(w * s) / w
    return {
        "yy": cos + zeta * sin, "yr": sin, "ry": -sin, "rr": cos - zeta * sin,
        "m_y": 2 * zeta * tau / h, "m_r": tau / h, "tau": tau, "zeta": zeta,
    }  # fmt: skip


def delay(rig: Rig, h: float) -> tuple[int, float]:
    """By how many whole parts of `h` seconds a command is late, and a share of one.

    Raises:
        ValueError: the instances differ in it.
    """
    late = [np.unique(c.tau_u) for c in rig.command if isinstance(c, ValveDelay)]
    if not late:
        return 0, 0.0
    if late[0].size != 1:
        raise ValueError("the peers take one valve_delay for all instances")
    parts = min(float(late[0][0]) / h, QUEUE - 1)
    whole = min(int(parts), QUEUE - 2)
    return whole, parts - whole


def numbers(loop: Loop) -> Numbers:
    """All numbers of a closed loop, each of one shape: () or [B].

    Those of the law's own rig carry the prefix `n_`; `up_` and `down_` are its valve
    constants by the side that opens, `chi_` its areas over their mean.

    Raises:
        ValueError: a load or an effect that the peers have not.
    """
    if not isinstance(loop.load, Driven):
        raise ValueError("the peers have no load but a driven one")
    law, rig, h = loop.law, loop.rig, float(loop.h)
    n = plant(law.nominal)
    w_1, w_2 = n["act_1"] / n["area_1"], n["act_2"] / n["area_2"]
    mean = np.asarray(mean_area(law.nominal), float)
    out = plant(rig) | spool(rig, h / PARTS)
    out["keep"] = np.exp(-out["L_rate"] * h / PARTS)
    out |= {f"n_{name}": v for name, v in n.items()}
    out |= {"n_keep": np.exp(-n["L_rate"] * h), "h": np.asarray(h)}
    out |= {"chi_1": w_1 * n["area_1"] / mean, "chi_2": w_2 * n["area_2"] / mean}
    out |= {"up_1": w_1 * n["c_p1"], "up_2": w_2 * n["c_n2"]}
    out |= {"down_1": w_1 * n["c_n1"], "down_2": w_2 * n["c_p2"]}
    for name in ("k_p", "k_f", "u_max", "tau_d", "tau_v"):
        out[name] = getattr(law, name)
    for name in Estimates._fields:
        out[f"rate_{name}"] = getattr(law.rate, name)
        out[f"lower_{name}"] = getattr(law.lower, name)
        out[f"upper_{name}"] = getattr(law.upper, name)
    for name in ("P_a1", "P_a2", "P_s", "F", "step"):
        out[f"noise_{name}"] = getattr(loop.sensors, name)
    out |= {"P_return": law.P_r, "P_start": loop.P_start}
    shape = np.broadcast_shapes(*(np.shape(v) for v in out.values()))
    return {name: np.broadcast_to(v, shape).astype(float) for name, v in out.items()}


def columns(scenario: Scenario) -> Iterator[np.ndarray]:
    """F_d [N], noise [N, 4], P_s, P_r [N, 2], x [N, parts, 3], v [N, parts].

    Raises:
        ValueError: another number of parts than the simulator's own.
    """
    if scenario.environment.v.shape[1] != PARTS:
        raise ValueError(f"the peers take {PARTS} parts a control period")
    for a in (
        scenario.F_d,
        scenario.noise,
        scenario.P_s,
        scenario.P_r,
        *scenario.environment[:2],
    ):
        yield np.ascontiguousarray(a, float)
