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
from .catalogue import largest

SMALLEST = 1 / 3
"""Of the size that matters."""


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
