"""What a row of results says: what was seen and named, rightly or not, and how far off.

Proportions come with Wilson's 95 % interval.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from .tracing import comparable

Row = Mapping[str, Any]
POWERFUL = 0.8
MATTERS = 0.02
Z_95 = 1.959963984540054


def wilson(hits: int, of: int, z: float = Z_95) -> tuple[float, float]:
    """Wilson's interval of a proportion; (0, 1) where nothing was counted."""
    if of == 0:
        return 0.0, 1.0
    p, w = hits / of, z * z / of
    middle = (p + w / 2) / (1 + w)
    half = z / (1 + w) * math.sqrt(p * (1 - p) / of + w / (4 * of))
    return max(0.0, middle - half), min(1.0, middle + half)


def share(rows: Sequence[Any], hit: Callable[[Any], bool]) -> str:
    """`hits/of = percent [interval]` over rows."""
    hits, of = sum(bool(hit(r)) for r in rows), len(rows)
    if of == 0:
        return "0/0"
    low, high = wilson(hits, of)
    return f"{hits}/{of} = {hits / of:.0%} [{low:.0%}, {high:.0%}]"


# -- what a row says --


def named(row: Row) -> list[str]:
    """Effects named, the one that took most of the error first."""
    return [e["name"] for e in sorted(row["named"], key=lambda e: -e["gain"])]


def said(row: Row) -> bool:
    """Whether anything was said to be missing."""
    return bool(row["named"]) or row["verdict"] != "nothing missing"


def truth(row: Row) -> str:
    """The one effect of an `effect` case."""
    return next(iter(row["sizes"]), "")


def top_1(row: Row) -> bool:
    """Whether the foremost effect named is the true one."""
    return named(row)[:1] == [truth(row)]


def exact(row: Row) -> bool:
    """Whether what was named is what is true, no more and no less."""
    return set(named(row)) == set(row["sizes"])


def within_alias(row: Row) -> bool:
    """Whether the true effect was named, or said to be one that cannot be told."""
    alike = {n for e in row["named"] for n in e["cannot_tell_from"]}
    return truth(row) in alike | set(named(row))


def power(row: Row) -> float:
    """The power that was reported for the true effect; 0 where none was."""
    return row["candidates"].get(truth(row), {}).get("power") or 0.0


def worst(row: Row, errors: Mapping[str, float] | str) -> float:
    """Largest ratio of a channel's error to its noise."""
    channels = row["channels"]
    if isinstance(errors, str):
        errors = {n: c[errors] for n, c in channels.items()}
    return max(errors[n] / c["noise"] for n, c in channels.items())


def matters(row: Row) -> bool:
    """Whether the true structure lowers some channel's error by 2 % of its noise."""
    true = row.get("oracle") or {}
    channels = row["channels"]
    return any(
        channels[n]["before"] - error > MATTERS * channels[n]["noise"]
        for n, error in true.items()
    )


def size_error(row: Row) -> float | None:
    """Relative error of the true effect's size, where it was named."""
    for e in row["named"]:
        if e["name"] == truth(row):
            true = comparable(e["name"], row["effects"][e["name"]])
            return abs(comparable(e["name"], e["parameters"]) / true - 1)
    return None


def covered(rows: Iterable[Row]) -> tuple[int, int, int]:
    """Parameters whose interval holds the truth, those with an interval, and all."""
    hits = given = total = 0
    for row in rows:
        for p in row["parameters"].values():
            total += 1
            if p["interval"]:
                given += 1
                hits += p["interval"][0] <= p["truth"] <= p["interval"][1]
    return hits, given, total
