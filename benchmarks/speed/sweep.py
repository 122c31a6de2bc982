"""A sweep by XLA and by generated C, compiling included."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from .cold import fresh
from .measured import Section
from .timing import figure, interleave, ratio, spread

SIDES = (64, 128, 256, 384)
"""Gains on each of two axes; a cell runs for 4000 periods."""


def whole(side: int, worth: float) -> dict[str, Any]:
    """Seconds of a sweep over k_p and k_f of the reference rig, and what ran it."""
    import numpy as np

    from hydrojax.paper.records import reference
    from hydrojax.rigfile.quantities import open_setting, quantities
    from hydrojax.tune import native
    from hydrojax.tune.axes import make_axes
    from hydrojax.tune.plan import Plan, with_excitations
    from hydrojax.tune.sweep import run_sweep

    native.WORTH = worth
    spec, _ = reference()
    setting = open_setting(spec)
    known = quantities(spec, setting)
    axes = make_axes(
        {name: np.geomspace(0.25, 4, side) for name in ("k_p", "k_f")}, known
    )
    plan = with_excitations(Plan(setting, axes, known, ("multisine",)))
    began = time.perf_counter()
    data = run_sweep(plan)
    return {"sweep_s": time.perf_counter() - began, "by": data.attrs["multisine_runs"]}


def run(quick: bool, progress: Callable[[str], None]) -> Section:
    """Rows of both at each size, and how many times longer XLA takes."""
    section = Section()
    for side in SIDES[:2] if quick else SIDES:
        last: dict[str, dict[str, Any]] = {}

        def of(name: str, worth: float, side: int = side, last: Any = last) -> float:
            last[name] = fresh("sweep:whole", {"side": side, "worth": worth})
            return last[name]["sweep_s"]

        programs = {"XLA": lambda of=of: of("XLA", 1e30), "C": lambda of=of: of("C", 0)}
        per = interleave(
            programs,
            1 if quick else 3,
            lambda i, n, side=side: progress(f"{side}^2 cells, round {i + 1} of {n}"),
        )
        case = f"sweep of {side * side} cells"
        for name, seconds in per.items():
            row = {"case": case, "program": name, "unit": "s"}
            row |= {
                "ready_s": last[name]["start_s"],
                "peak_mib": last[name]["peak_mib"],
            }
            section.rows.append(row | asdict(spread(seconds)))
        section.figures.append(
            figure(f"{case}: XLA over C", ratio(per["XLA"], per["C"]), "times")
        )
        section.note(f"{case}: run by {last['C']['by']}")
    return section
