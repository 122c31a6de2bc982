"""Rig files and logs that lie: what is told of a case, and what `check` says of it.

`python -m benchmarks.trace.lies FOLDER` takes cases that were recorded before (the
folders of `python -m benchmarks.trace --out`), tells lies of those in which nothing is
hidden, and prints how many are called by their name; and of every case as it is, how
often an input is blamed that is right.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

Told = tuple[str, list[Any]]
"""The text of a rig file, and logs."""


@dataclass(frozen=True)
class Lie:
    """One lie.

    Attributes:
        name: its kind.
        told: a rig file's text and logs with the lie in them.
        inputs: one of these has to be blamed.
        findings: for one of these reasons.
    """

    name: str
    told: Callable[[str, list[Any]], Told]
    inputs: tuple[str, ...]
    findings: tuple[str, ...]


def _signals(change: Callable[[dict[str, Any]], dict[str, Any]]):
    """A lie of the logs' signals."""

    def told(text: str, logs: list[Any]) -> Told:
        return text, [
            replace(log, signals=log.signals | change(log.signals)) for log in logs
        ]

    return told


def _times(factor: float, *names: str):
    return _signals(lambda s: {n: factor * s[n] for n in names})


def _exchanged(one: str, other: str):
    return _signals(lambda s: {one: s[other], other: s[one]})


def _value(key: str, factor: float):
    """A lie of a plain quantity of the rig file."""

    def told(text: str, logs: list[Any]) -> Told:
        def changed(m: re.Match[str]) -> str:
            return f'{m[1]}"{float(m[2]) * factor:.6g} '

        new, count = re.subn(rf'(?m)^({key} = )"([^ "]+) ', changed, text)
        assert count == 1, key
        return new, logs

    return told


def _without(*keys: str):
    """A rig file that leaves constants out."""

    def told(text: str, logs: list[Any]) -> Told:
        kept = [
            line
            for line in text.splitlines()
            if not line.startswith(tuple(f"{k} = " for k in keys))
        ]
        return "\n".join(kept) + "\n", logs

    return told


def lies_of(layout: str, motion: str) -> list[Lie]:
    """Every lie that can be told of a rig of this layout, logged with this motion."""
    areas = ("area",) if layout == "pull-pull" else ("area_1", "area_2")
    P, every = ("P_a1", "P_a2"), ("P_a1", "P_a2", "P_s")
    valve = ("c_p1", "c_n1", "c_p2", "c_n2")
    coulomb = ("k_cp", "k_cn")
    friction = (*coulomb, "k_0", "k_vp", "k_vn", "k_fp", "k_fn", "z_ss", "delta")
    out = []
    for area in areas:
        for f in (1.02, 0.98):
            out.append(Lie(f"{area} {f - 1:+.0%}", _value(area, f), (*areas, "F"), ("factor",)))
    for f in (1.1, 0.9):
        out.append(Lie(f"P_s {f - 1:+.0%}", _times(f, "P_s"), ("P_s",), ("factor",)))
    for name in ("u", "F", motion, *P):
        out.append(Lie(f"{name} turned round", _times(-1.0, name), (name,), ("sign",)))
    out.append(Lie("pressures turned round", _times(-1.0, *P), P, ("sign",)))
    out.append(Lie("pressures exchanged", _exchanged(*P), P, ("exchanged",)))
    if motion == "psi":
        for what, f in (("degrees for radians", 180 / np.pi), ("radians for degrees", np.pi / 180)):
            out.append(Lie(what, _times(f, motion), (motion,), ("unit",)))
    for what, names, f in (
        ("MPa for bar", every, 10.0), ("bar for MPa", every, 0.1),
        ("MPa for bar, chambers", P, 10.0), ("bar for MPa, chambers", P, 0.1),
        ("bar for Pa", every, 1e5),
    ):
        out.append(Lie(what, _times(f, *names), names, ("unit",)))
    for what, f in (("kN for N", 1e3), ("N for kN", 1e-3)):
        out.append(Lie(what, _times(f, "F"), ("F",), ("unit",)))
    for name in (*P, "F"):
        for f in (10.0, 0.1):
            out.append(Lie(f"noise of {name} x{f:g}", _value(name, f), (name,), ("noise",)))
    out.append(Lie("valve left out", _without(*valve), valve, ("left out",)))
    out.append(Lie("friction left out", _without(*friction), friction, ("left out",)))
    out.append(Lie("k_cp, k_cn left out", _without(*coulomb), coulomb, ("left out",)))
    return out
