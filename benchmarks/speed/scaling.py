"""How cost and memory grow: with the log, the batch, the parameters, the candidates."""

from __future__ import annotations

import io
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .children import Children, Failed, Program
from .cold import fresh
from .logs import opened
from .loop import CHUNK, Build
from .measured import Section
from .timing import Goal, figure, slope, spread

BUDGET = 600.0
"""Seconds that a sweep may take before it starts nothing larger."""

LONGEST = {"goal": 6144.0, "minutes": 600}
"""MiB that a fit of so many minutes may take."""

Point = dict[str, float]
Tell = Callable[[str], None]


# -- programs --


def fit_long(folder: str) -> dict[str, Any]:
    """Read a log and fit it twice; seconds of each, and the log's own size."""
    from hydrojax.identify.api import fit_case

    began = time.perf_counter()
    case = opened(folder)
    read = time.perf_counter()
    fit_case(case, starts=1)
    first = time.perf_counter()
    fit_case(case, starts=1)
    log = case.fit_logs[0]
    held = log.time.nbytes + sum(y.nbytes for y in log.signals.values())
    return {
        "read_s": read - began,
        "first_s": first - read,
        "fit_s": time.perf_counter() - first,
        "log_mib": held / 2**20,
    }


def scores(folder: str, count: int) -> Build:
    """The windows' sums along every parameter of a model with `count` candidates:
    what a trace looks at before it refits any.
    """
    from hydrojax.identify.api import applicable
    from hydrojax.identify.estimation.known import free_parameters
    from hydrojax.identify.estimation.problem import Problem
    from hydrojax.rigfile.build import build_rig

    case = opened(folder)
    names = [n for n in applicable(case) if n not in case.spec.effects][:count]
    made = Problem.of(build_rig(case.spec, names), free_parameters(case.spec), case.fit)
    values, n = made.initial_values(), made.model.hydraulic
    columns = (made.model.names, (n, len(made.model.names) - n))

    def score() -> float:
        found = made.evaluate(values, *columns, made.batch)
        return float(np.asarray(found.gram[0, -1, -1]))

    def build():
        return score

    return build


# -- sweeps --


def noting(section: Section, name: str) -> Callable[[str], None]:
    """What notes a remark on the sweep of this name."""
    return lambda text: section.note(f"{name}: {text}")


def sweep(
    points: Sequence[float],
    at: Callable[[float], Point],
    note: Callable[[str], None],
    budget: float = BUDGET,
) -> list[Point]:
    """`at` of each point, smallest first, until the next would break the budget or one
    fails (of memory, most likely: nothing larger would fit); `note` hears of it.
    """
    out: list[Point] = []
    began = time.perf_counter()
    last = 0.0
    for i, x in enumerate(points):
        grown = last * (x / points[i - 1] if i else 1.0)
        if time.perf_counter() - began + grown > budget:
            note(f"stopped before {x:g}: it would take more than {budget:.0f} s")
            break
        start = time.perf_counter()
        try:
            out.append({"x": x, **at(x)})
        except Failed as error:
            note(f"stopped at {x:g}: {error}")
            break
        last = time.perf_counter() - start
    return out


def by_length(section: Section, quick: bool, progress: Tell) -> list[Point]:
    """Identification against the log's length, min."""
    minutes = (0.2, 0.5, 1.0) if quick else (1, 4, 15, 60, 240, 600)

    def at(x: float) -> Point:
        progress(f"identify a log of {x:g} min")
        with tempfile.TemporaryDirectory(prefix="hydrojax-speed.") as folder:
            fresh("logs:write_case", {"folder": folder, "seconds": 60 * x})
            found = fresh("scaling:fit_long", {"folder": folder})
        kept = ("read_s", "fit_s", "log_mib")
        own = {k: found[k] for k in kept}
        seconds = found["read_s"] + found["fit_s"]
        return {"seconds": seconds, "mib": found["peak_mib"], **own}

    return sweep(minutes, at, noting(section, "log length"))


def _in_workers(
    children: Children, progress: Tell, rounds: int, make: Callable[[int], Program]
) -> Callable[[float], Point]:
    """A point by a program that `make` gives for it."""

    def at(x: float) -> Point:
        program = make(int(x))
        said = children.prepare(program)
        seconds = children.time([program.name], rounds, program.name)[program.name]
        children.forget(program.name)
        return {
            "seconds": spread(seconds).median,
            "mib": said["peak_mib"],
            "ready_s": said["ready_s"],
        }

    return at


def by_batch(section: Section, quick: bool, progress: Tell) -> list[Point]:
    """The closed loop of a second against the number of instances."""
    sizes = (1, 16, 256, 1024) if quick else tuple(10**n for n in range(7))

    def program(batch: int) -> Program:
        given = {"batch": batch, "samples": 200 if quick else 1000, "chunk": CHUNK}
        return Program(f"{batch} instances", "loops", "loop:own", given)

    with Children(progress) as children:
        at = _in_workers(children, progress, 3, program)
        return sweep(sizes, at, noting(section, "batch size"))


def by_columns(
    section: Section, quick: bool, progress: Tell
) -> tuple[list[Point], list[Point]]:
    """A fit's Gram matrix against the parameters, and a trace's sums against the
    candidates.
    """
    counts = (2, 16) if quick else (1, 2, 4, 8, 16)
    candidates = (1, 4) if quick else (1, 2, 4, 8, 16, 28)
    with tempfile.TemporaryDirectory(prefix="hydrojax-speed.") as name:
        folder = str(Path(name))
        progress("simulate a log")
        fresh("logs:write_case", {"folder": folder, "seconds": 8 if quick else 60})

        def gram(n: int) -> Program:
            given = {"folder": folder, "count": n}
            return Program(f"{n} parameters", "fits", "replay:own_gram", given)

        def score(n: int) -> Program:
            given = {"folder": folder, "count": n}
            return Program(f"{n} candidates", "fits", "scaling:scores", given)

        with Children(progress) as children:
            grams = _in_workers(children, progress, 5, gram)
            sums = _in_workers(children, progress, 3, score)
            return (
                sweep(counts, grams, noting(section, "parameters")),
                sweep(candidates, sums, noting(section, "candidates")),
            )


# -- the group --


def run(quick: bool, progress: Tell) -> Section:
    """All sweeps: points, slopes, and a picture of each."""
    section = Section()
    columns, candidates = by_columns(section, quick, progress)
    sweeps = {
        "log length": ("min", by_length(section, quick, progress)),
        "batch size": ("instances", by_batch(section, quick, progress)),
        "parameters": ("columns", columns),
        "candidates": ("effects", candidates),
    }
    for name, (unit, points) in sweeps.items():
        if not points:
            section.note(f"{name}: not one point could be run")
            continue
        section.points[name] = {"unit": unit, "points": points}
        for key in ("seconds", "mib"):
            if len(points) > 1:
                grows = slope([p["x"] for p in points], [p[key] for p in points])
                says = f"{name}: slope of log {key} over log {unit}"
                section.figures.append(figure(says, spread([grows]), "1"))
        section.plots[f"{name.replace(' ', '_')}.png"] = picture(name, unit, points)
    _memory(section)
    section.note(
        "A log's time is reading and a warm fit; candidates are scored, not refitted. "
        "Logs over a minute repeat one, with noise of their own, after gaps of 1 s."
    )
    return section


def _memory(section: Section) -> None:
    """What identification takes beyond the log: of the longest, and how it grows."""
    points = section.points.get("log length", {}).get("points", [])
    if not points:
        return
    last = points[-1]
    goal = Goal(LONGEST["goal"]) if last["x"] >= LONGEST["minutes"] else None
    says = f"memory of identify, log of {last['x']:g} min"
    section.figures.append(figure(says, spread([last["mib"]]), "MiB", goal))
    if len(points) > 1:
        grown, log = (last[k] - points[0][k] for k in ("mib", "log_mib"))
        says = "memory of identify: growth over the log's own growth"
        section.figures.append(figure(says, spread([grown / log]), "times"))


def picture(name: str, unit: str, points: Sequence[Point]) -> bytes:
    """Seconds and MiB over what was changed, both on log scales, as PNG."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    plain = FuncFormatter(lambda value, _: f"{value:,.6g}")
    x = [p["x"] for p in points]
    drawing = Figure(figsize=(7.2, 2.8), layout="constrained")
    for axes, key, label in zip(
        drawing.subplots(1, 2), ("seconds", "mib"), ("s", "peak MiB"), strict=True
    ):
        y = [p[key] for p in points]
        axes.loglog(x, y, "o-")
        low, high = min(y), max(y)
        if high < 5 * low:  # what is flat is to look flat
            middle = (low * high) ** 0.5
            axes.set_ylim(middle / 3, middle * 3)
        subs = (1, 2, 5) if high < 30 * low else (1,)
        axes.yaxis.set_major_locator(LogLocator(subs=subs))
        axes.yaxis.set_major_formatter(plain)
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set(xlabel=f"{name} [{unit}]", ylabel=label)
        if len(x) > 1:
            axes.set_title(f"slope {slope(x, y):.2f}", fontsize=9)
        axes.grid(True, alpha=0.3)
    out = io.BytesIO()
    drawing.savefig(out, format="png", dpi=130)
    return out.getvalue()
