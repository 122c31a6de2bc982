"""One case: `trace` on its logs, and what was found beside the truth."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .cases import LOGS

Row = dict[str, Any]


@dataclass(frozen=True)
class Tracing:
    """How a case's folder is traced: with the true structure and baselines or not."""

    oracle: bool = True
    baselines: bool = True

    def __call__(self, folder: Path) -> Row:
        """The row of one case's folder."""
        from hydrojax.jax_setup import set_up_jax, user_cache

        set_up_jax(user_cache())
        return trace_folder(folder, self.oracle, self.baselines)


def trace_folder(folder: Path, oracle: bool = True, baselines: bool = True) -> Row:
    """Trace one case's folder; what was found beside the truth, as plain data."""
    from hydrojax.identify import api
    from hydrojax.identify.case import open_case

    truth = json.loads((folder / "truth.json").read_text())
    fit, check = [folder / name for name in LOGS[:2]], [folder / LOGS[2]]
    began = time.perf_counter()
    case = open_case(folder / "rig.toml", fit, check)
    opened = time.perf_counter()
    outcome = api.trace_case(case)
    seconds = {**outcome.seconds, "open": opened - began}
    row = found(outcome, truth) | {"seconds": seconds}
    if oracle:
        began = time.perf_counter()
        row |= _oracle(folder, row, fit, check)
        seconds["oracle"] = time.perf_counter() - began
    if baselines:
        from . import baselines as others

        began = time.perf_counter()
        row["baselines"] = others.cheap(outcome)
        seconds["baselines"] = time.perf_counter() - began
    return row


def found(outcome: Any, truth: Mapping[str, Any]) -> Row:
    """An outcome and its truth as a row."""
    return {
        **{k: truth[k] for k in ("kind", "sizes", "noise", "shifted", "effects")},
        "verdict": outcome.verdict,
        "sentence": outcome.sentence,
        "named": [
            {
                "name": e.name,
                "parameters": {n: p.value for n, p in e.parameters.items()},
                "p_value": e.p_value,
                "gain": sum(
                    (e.before[n] ** 2 - e.after[n] ** 2) / c.noise**2
                    for n, c in outcome.channels.items()
                ),
                "cannot_tell_from": list(e.cannot_tell_from),
            }
            for e in outcome.effects
        ],
        "candidates": {
            c.name: {"status": c.status, "power": c.power, "p": c.p_value}
            for c in outcome.candidates
        },
        "channels": {
            n: {
                "noise": c.noise,
                "before": c.before,
                "after": c.after,
                "horizons": {run: h.after for run, h in c.horizons.items()},
            }
            for n, c in outcome.channels.items()
        },
        "parameters": {
            n: {
                "truth": truth["rig"][n],
                "value": p.value,
                "interval": p.interval,
                "at_bound": p.at_bound,
                "identified": p.identified,
            }
            for n, p in outcome.parameters.items()
            if p.free and n in truth["rig"]
        },
        "left": [u.description for u in outcome.unexplained],
    }


def _oracle(folder: Path, row: Row, fit, check) -> Row:
    """Validation error with the true structure, by channel, and whence it is."""
    named = {e["name"] for e in row["named"]}
    if not row["sizes"] and row["kind"] != "outside":
        return {"oracle": _column(row, "before"), "oracle_from": "declared"}
    if named == set(row["sizes"]):
        return {"oracle": _column(row, "after"), "oracle_from": "trace"}
    if not (folder / "oracle.toml").exists():
        return {"oracle": None, "oracle_from": ""}
    from hydrojax.identify import api
    from hydrojax.identify.case import open_case

    case = open_case(folder / "oracle.toml", fit, check)
    outcome = api.identify(case, starts=1)
    errors = {n: c.after for n, c in outcome.channels.items()}
    return {"oracle": errors, "oracle_from": "identify"}


def _column(row: Row, key: str) -> dict[str, float]:
    return {n: c[key] for n, c in row["channels"].items()}


def declare(names: Sequence[str]) -> str:
    """TOML that declares effects with the whole range the library gives them.

    Strengths start at their typical size, shapes at their default: not at the truth.
    """
    from hydrojax.effects import EFFECTS
    from hydrojax.parameters import specs
    from hydrojax.units import with_command

    lines = []
    for name in names:
        lines.append(f"\n[effects.{name}]")
        for field, spec in specs(EFFECTS[name]).items():
            start = spec.scale if spec.strength else spec.default
            start = min(max(start, spec.lower), spec.upper)
            unit = with_command(spec.unit, "V")
            ends = [f"{end!r} {unit}" for end in (spec.lower, spec.upper)]
            entry = f'start = "{start!r} {unit}", range = {json.dumps(ends)}'
            lines.append(f"{field} = {{ {entry} }}")
    return "\n".join(lines) + "\n"


def comparable(effect: str, parameters: Mapping[str, float]) -> float:
    """An effect's size as one number, whichever side names its parameters."""
    p = parameters
    if effect == "gravity_load":
        return abs(p["w"]) if "w" in p else math.hypot(p["w_s"], p["w_c"])
    if effect == "position_friction":
        if "wavelength" in p:
            return abs(p["a"])
        waves = [v for n, v in p.items() if n[:2] in ("s_", "c_")]
        return math.sqrt(sum(v * v for v in waves))
    if effect == "orifice_transition" and "dP_t2" in p:
        return math.sqrt(max(p["dP_t2"], 0.0))
    pairs = {
        "valve_deadband": "u_db",
        "dead_volume": "V_0",
        "pressure_sensor_bias": "b_",
        "pressure_sensor_gain": "eps_",
    }
    if effect in pairs:
        same = [abs(v) for n, v in p.items() if n.startswith(pairs[effect])]
        return sum(same) / len(same)
    return abs(next(iter(p.values())))
