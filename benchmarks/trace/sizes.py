"""Effects of any size: drawn log-uniformly from a third of what shows to the largest.

By turns the largest is what the field's literature names and the end of the range that
the library searches. What is published is a curve for each effect: named right against
size.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from .cases import CaseSpec
from .catalogue import LARGEST, NAMED, Kind

SMALLEST = 1 / 3
"""Of the size that matters."""

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


def sized(names: Sequence[str]) -> Iterator[CaseSpec]:
    """Every effect in turn, each time at a size of its own."""
    i = 0
    while True:
        for name in names:
            rng = np.random.default_rng([i, *name.encode()])
            top = max(largest(name)[i % 2], 1.0)
            size = math.exp(rng.uniform(math.log(SMALLEST), math.log(top)))
            size = float(f"{size:.3g}")
            yield CaseSpec(f"sized-{name}-{size:g}-{i}", "sized", {name: size})
        i += 1


def curve(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown: each effect's cases by size, and what was named."""
    lines = ["| effect | size | named | cannot tell from | worst channel |"]
    lines.append("|---|---|---|---|---|")
    done = [r for r in rows if r["kind"] == "sized" and r.get("ok")]
    for r in sorted(done, key=lambda r: next(iter(r["sizes"].items()))):
        ((name, size),) = r["sizes"].items()
        named = " + ".join(e["name"] for e in r["named"]) or r["verdict"]
        alike = ", ".join(n for e in r["named"] for n in e["cannot_tell_from"])
        worst = max(c["after"] / c["noise"] for c in r["channels"].values())
        lines.append(f"| {name} | {size:.3g} | {named} | {alike} | {worst:.2f} |")
    right = [[e["name"] for e in r["named"]] == list(r["sizes"]) for r in done]
    lines.append(f"\nNamed right: {sum(right)} of {len(right)}.")
    return "\n".join(lines) + "\n"
