"""What each effect does to the residual: its picture, its look-alikes, how to tell.

`python -m benchmarks.reference.signatures` draws docs/reference/effects/*.png and
writes what it measured beside them, in signatures.json (two minutes, most of it
compiling). One log of a differential cylinder is simulated without any effect, and
replayed with each effect at the strength `at`; what the replays differ by is the
residual that the effect leaves to a model without it, and the declared parameters are
refitted to it, to first order. `python -m benchmarks.reference` puts the pictures into
the page of the effects.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import json
import textwrap
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

import hydrojax as hj
from benchmarks.reference.known import FOLDER, KNOWN, MEASURED
from benchmarks.reference.picture import draw
from hydrojax.effects import EFFECTS
from hydrojax.identify.api import _problems, applicable
from hydrojax.identify.case import Case, open_case
from hydrojax.identify.estimation.problem import Problem
from hydrojax.identify.preparation.noise import CHANNELS
from hydrojax.jax_setup import set_up_jax, user_cache
from hydrojax.parameters import specs
from hydrojax.plant.effect import Effect
from hydrojax.report.text import words


def _rig() -> dict[str, Any]:
    """A differential cylinder with every parameter free that a log identifies."""
    flow = {"start": "2.2e-9 m^3/(s*V*Pa^0.5)",
            "range": ["1e-10 m^3/(s*V*Pa^0.5)", "1e-7 m^3/(s*V*Pa^0.5)"]}  # fmt: skip
    level = {"start": "900 N", "range": ["0 N", "4 kN"]}
    fall = {"start": "2 kN*s/m", "range": ["-100 kN*s/m", "100 kN*s/m"]}
    return {
        "name": "effects",
        "layout": "differential",
        "geometry": {"area_1": "0.9e-3 m^2", "area_2": "1.25e-3 m^2",
                     "chamber_length": "0.2 m", "radius": "0.085 m"},
        "supply": {"P_s": "14 MPa", "P_r": "0.25 MPa"},
        "sensors": {"P_a1": "9 kPa", "P_a2": "9 kPa", "P_s": "9 kPa", "F": "2.5 N"},
        "parameters": {
            **dict.fromkeys(("c_p1", "c_n1", "c_p2", "c_n2"), flow),
            **dict.fromkeys(("k_cp", "k_cn"), level),
            **dict.fromkeys(("k_vp", "k_vn"), fall),
            "beta": {"start": "8.5e8 Pa", "range": ["1e8 Pa", "3e9 Pa"]},
            "k_0": {"start": "100 N", "range": ["-1 kN", "1 kN"]},
            "k_fp": {"start": "0.6", "range": ["0", "2"]},
            "k_fn": {"start": "0.6", "range": ["0", "2"]},
            "z_ss": {"start": "60 um", "range": ["1 um", "1 mm"]},
        },
    }  # fmt: skip


class Bench(NamedTuple):
    """One log without effects, and the model that replays it with any.

    Attributes:
        case: rig and log.
        problem: all effects in it at zero.
        values: the declared values, effects at zero.
        free: names of the declared parameters that are refitted.
        base: what it leaves at `values`.
    """

    case: Case
    problem: Problem
    values: Float[np.ndarray, "n"]
    free: tuple[str, ...]
    base: Float[np.ndarray, "windows ticks 3"]

    def change(self, named: Mapping[str, float]) -> Float[np.ndarray, "all"]:
        """What a model without these values leaves of a log with them, by the noise."""
        values = self.values.copy()
        known = list(self.problem.model.names)
        for name, value in named.items():
            values[known.index(name)] = value
        left = self.base - self.problem.residuals_at(values)
        return (left / self.case.fit.noise).ravel()


def bench() -> Bench:
    """The log, and the model with every effect in it."""
    rig = hj.RigFile.from_dict(_rig())
    run = hj.simulate(
        rig, seconds=16.0, reference=hj.sines("800 N"), motion=hj.wander()
    )
    case = open_case(rig, [run.to_log()])
    problem, _, free, _ = _problems(case, applicable(case))
    values = problem.initial_values()
    return Bench(case, problem, values, free, problem.residuals_at(values))


def columns(at: Bench) -> dict[str, Float[np.ndarray, "strengths all"]]:
    """Per effect what each of its strengths leaves, the whole effect first."""
    out = {}
    for name, known in KNOWN.items():
        shape = {f"{name}.{k}": v for k, v in known.at.items()}
        strengths = [k for k, s in specs(EFFECTS[name]).items() if s.strength]
        own = {f"{name}.{k}": 0.0 for k in strengths}
        whole = at.change(own | shape)
        alone = [
            at.change(own | shape | {f"{name}.{j}": 0.0 for j in strengths if j != k})
            for k in strengths
            if known.at.get(k)
        ]
        out[name] = np.stack([whole, *(alone if len(alone) > 1 else [])])
    return out


def refitted(at: Bench) -> Float[np.ndarray, "all free"]:
    """An orthonormal basis of what the declared parameters can follow."""
    named = dict(zip(at.problem.model.names, at.values, strict=True))
    slopes = []
    for name in at.free:
        step = 1e-3 * abs(named[name])
        slopes.append(at.change({name: named[name] + step}))
    table = np.stack(slopes, axis=1)
    return np.linalg.qr(table / np.linalg.norm(table, axis=0))[0]


def look_alikes(
    left: Mapping[str, Float[np.ndarray, "strengths all"]], least: float = 0.5
) -> dict[str, dict[str, float]]:
    """Per effect the others that take at least this share of its squared residual."""
    out: dict[str, dict[str, float]] = {}
    for name, own in left.items():
        y = own[0] / np.linalg.norm(own[0])
        shares = {}
        for other, table in left.items():
            if other == name:
                continue
            q = np.linalg.qr(table.T)[0]
            shares[other] = float(np.sum((q.T @ y) ** 2))
        kept = sorted(shares.items(), key=lambda s: -s[1])
        out[name] = {n: round(s, 2) for n, s in kept if s >= least}
    return out


def digest(kind: type[Effect]) -> str:
    """Of an effect's code, comments aside, and of the strength at which it is drawn."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(kind)))
    body = (
        tree.body[0].body[1:] if isinstance(tree.body[0], ast.ClassDef) else tree.body
    )
    code = "".join(map(ast.unparse, body))
    text = code + repr(sorted(KNOWN[kind.name].at.items()))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def main() -> None:
    """Draw every effect, and write what was measured."""
    set_up_jax(user_cache())
    at = bench()
    held = columns(at)
    q = refitted(at)
    left = {name: table - (table @ q) @ q.T for name, table in held.items()}
    alike = look_alikes(left)
    FOLDER.mkdir(exist_ok=True)
    found: dict[str, Any] = {}
    for name in KNOWN:
        both = (y[name][0].reshape(at.base.shape) for y in (held, left))
        (FOLDER / f"{name}.png").write_bytes(draw(at.case, name, *both))
        rms = np.sqrt(np.mean(left[name][0].reshape(-1, 3) ** 2, axis=0))
        kept = np.linalg.norm(left[name][0]) / np.linalg.norm(held[name][0])
        found[name] = {
            "digest": digest(EFFECTS[name]),
            "over_noise": dict(zip(CHANNELS, np.round(rms, 2).tolist(), strict=True)),
            "left_by_refit": round(float(kept), 3),
            "look_alikes": alike[name],
        }
        print(words(name), found[name])
    MEASURED.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
