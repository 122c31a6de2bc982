"""`trace` on a case with a hidden effect, against refitting it with every candidate."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .cold import fresh
from .measured import Section
from .timing import Goal, figure, ratio, spread

HIDDEN = "internal_leakage"
SIZE = 3.0
"""The effect that is hidden, in units of a size that matters."""

FEW = {True: 2, False: 8}
"""Candidates that a quick and a full run refit. Each compiles programs of its own; a
process that refitted all ran out of room for code."""


def make_case(folder: str, seconds: float) -> None:
    """Record the case into a folder of its own under `folder`."""
    from benchmarks.trace.cases import CaseSpec, write_cases
    from benchmarks.trace.tracing import declare

    spec = CaseSpec("case", "effect", {HIDDEN: SIZE})
    bad = write_cases([spec], Path(folder), declare, seconds)
    if bad:
        raise RuntimeError(str(bad))


def twice(call: Callable[[], Any]) -> tuple[Any, dict[str, float]]:
    """What a call returns, and its seconds the first time and again."""
    first = time.perf_counter()
    found = call()
    again = time.perf_counter()
    call()
    ended = time.perf_counter()
    return found, {"first_s": again - first, "again_s": ended - again}


def traced(folder: str) -> dict[str, Any]:
    """Trace the case twice: reading the logs, fits, verdict."""
    from benchmarks.trace.tracing import trace_folder
    from hydrojax.identify.api import applicable
    from hydrojax.identify.case import open_case

    place = Path(folder) / "case"
    row, seconds = twice(lambda: trace_folder(place, oracle=False, baselines=False))
    case = open_case(place / "rig.toml", sorted(place.glob("fit*.csv")))
    return seconds | {
        "named": [e["name"] for e in row["named"]],
        "candidates": len(applicable(case)),
    }


def refitted(folder: str, count: int) -> dict[str, Any]:
    """Refit the declared model and `count` candidates twice."""
    from benchmarks.trace.baselines import refit_case
    from hydrojax.effects import EFFECTS

    names = list(EFFECTS)
    names = [HIDDEN, *(n for n in names if n != HIDDEN)]
    names = names[:count]
    place = Path(folder) / "case"
    found, seconds = twice(lambda: refit_case(place, lambda what: None, names))
    return seconds | {"named": found["named"], "fits": 1 + len(names)}


def run(quick: bool, progress: Callable[[str], None]) -> Section:
    """Trace one case, cold and warm, and refit every candidate (or a few of them)."""
    section, seconds, rounds = Section(), 6.0 if quick else 12.0, 1 if quick else 3
    with tempfile.TemporaryDirectory(prefix="hydrojax-speed.") as folder:
        progress("record a case")
        fresh("trace:make_case", {"folder": folder, "seconds": seconds})
        cache, at = str(Path(folder) / "cache"), {"folder": folder}
        progress("trace, and fill a cache on disk")
        fresh("trace:traced", at, cache)
        runs: dict[str, list[dict[str, Any]]] = {"without": [], "with": []}
        for i in range(rounds):
            for kind, where in (("without", ""), ("with", cache)):
                progress(f"trace, {kind} a cache: {i + 1} of {rounds}")
                runs[kind].append(fresh("trace:traced", at, where))
        progress("refit the candidates")
        refits = fresh("trace:refitted", at | {"count": FEW[quick]})
    _figures(section, runs, refits)
    return section


def _figures(
    section: Section, runs: dict[str, list[dict[str, Any]]], refits: dict[str, Any]
) -> None:
    """Seconds and ratios; a few refits stand for all, each at their mean."""
    one = runs["without"][0]
    share = (1 + one["candidates"]) / refits["fits"]
    cold = [r["first_s"] for r in runs["without"]]
    warm = [r["again_s"] for r in runs["without"]]
    filled = [r["first_s"] for r in runs["with"]]
    for says, values, unit, goal in (
        ("trace, cold, all in", cold, "s", Goal(30)),
        ("trace, cold, with a cache on disk", filled, "s", None),
        ("trace, warm", warm, "s", None),
        ("trace, peak memory", [r["peak_mib"] for r in runs["without"]], "MiB", None),
        ("refit of each, cold", [share * refits["first_s"]], "s", None),
        ("refit of each, warm", [share * refits["again_s"]], "s", None),
        ("refit of each, peak memory", [refits["peak_mib"]], "MiB", None),
    ):
        section.figures.append(figure(says, spread(values), unit, goal))
    for kind, key, own in (("cold", "first_s", cold), ("warm", "again_s", warm)):
        over = ratio([share * refits[key]] * len(own), own)
        says = f"refit of each over trace, {kind}"
        section.figures.append(figure(says, over, "times", Goal(10, most=False)))
    section.note(
        f"{one['candidates']} candidates; hidden: {HIDDEN}; trace named "
        f"{', '.join(one['named']) or 'nothing'}; {refits['fits']} fits were timed, "
        f"and stand for all; BIC named {', '.join(refits['named']) or 'nothing'}."
    )
