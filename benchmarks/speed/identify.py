"""A whole identification of one log: sixteen parameters, 25 % off, noise of 1 %."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .children import Children, Program
from .cold import fresh
from .loop import CORES
from .measured import Section, compare, measure, quickest
from .timing import Goal, figure, spread

OWN = "hydrojax"
WITHIN = 1e-3
"""How far above the lowest cost a fit may end, relative."""

LEFT_OUT = (
    "jax-sysid is not among them: 1.1.0 wants jax <= 0.4.31 and scipy <= 1.14.1, so it "
    "does not install beside this JAX; it minimises a scalar loss by L-BFGS.",
    "dynax is not among them: it solves a smooth ODE by diffrax with splined inputs, "
    "which this scheme (a held command, a bristle that remembers the log before its "
    "window) is not; its fit is SciPy's least squares with a forward Jacobian.",
)


def programs(folder: str) -> list[Program]:
    """All that fit, besides hydrojax itself, from the starts that it found."""
    at = {"folder": folder}
    lanes = {"tool": "C", "lanes": 8, "threads": CORES}
    return [
        Program("hydrojax, one solve", "fits", "fits:own_once", at),
        Program("optimistix LM", "default", "fits:by_optimistix",
                at | {"normal": False}),
        Program("optimistix LM, product's flags", "fits", "fits:by_optimistix",
                at | {"normal": False}, "optimistix"),
        Program("optimistix LM, normal equations", "fits", "fits:by_optimistix",
                at | {"normal": True}, "optimistix"),
        Program("C lanes, MINPACK", "default", "fits:by_scipy", at | lanes, "C"),
        Program("C lanes, own LM", "default", "fits:by_marquardt", at | lanes, "C"),
        Program("numba, MINPACK", "default", "fits:by_scipy", at | {"tool": "numba"},
                "numba"),
        Program("CasADi, own LM", "default", "fits:by_marquardt",
                at | {"tool": "casadi"}, "casadi"),
    ]  # fmt: skip


class _Judge:
    """Costs of all answers, by hydrojax; who does not reach the lowest is told off."""

    def __init__(self, children: Children, folder: str):
        self.children, self.folder = children, folder
        self.costs: dict[str, float] = {}

    def __call__(self, name: str, answer: Any) -> str:
        given = {"folder": self.folder, "params": answer["params"]}
        program = Program(f"cost of {name}", "fits", "fits:cost", given, "judge")
        self.costs[name] = self.children.prepare(program)["answer"]
        return ""

    def remarks(self) -> dict[str, str]:
        """What a row says of its fit."""
        least = min(self.costs.values())
        return {
            name: ("same minimum" if c <= (1 + WITHIN) * least else "NOT the minimum")
            + f" (cost {c / least - 1:+.1e})"
            for name, c in self.costs.items()
        }


def run(quick: bool, progress: Callable[[str], None]) -> Section:
    """Fit one log in all ways, warm; and hydrojax cold."""
    section, seconds = Section(), 8.0 if quick else 60.0
    rounds = 3 if quick else 7
    with tempfile.TemporaryDirectory(prefix="hydrojax-speed.") as name:
        folder = str(Path(name) / "case")
        progress("simulate a log")
        fresh("logs:write_case", {"folder": folder, "seconds": seconds})
        progress("fill a cache on disk")
        cache = str(Path(name) / "cache")
        first = fresh("fits:cold", {"folder": folder}, cache)
        np.save(Path(folder) / "P_0.npy", first["P_0"])
        with Children(progress) as children:
            own = Program(OWN, "fits", "fits:own", {"folder": folder}, "hydrojax")
            judge = _Judge(children, folder)
            per = measure(
                children, section, f"log of {seconds:g} s, warm",
                [own, *programs(folder)], rounds, judge,
            )  # fmt: skip
        for row in section.rows:
            row["remark"] = judge.remarks()[row["program"]]
        truth = np.load(Path(folder) / "truth.npy")
        worst = float(np.max(np.abs(np.asarray(first["params"]) / truth - 1)))
        _cold(section, folder, cache, 1 if quick else 3, progress)
    at_best = quickest(per, "optimistix")
    for says, of, goal in (
        ("optimistix's LM as it comes over hydrojax", "optimistix LM", None),
        ("optimistix's LM at its best over hydrojax", at_best, Goal(8, most=False)),
        ("numba with differences over hydrojax", "numba, MINPACK", Goal(12, False)),
        ("CasADi over hydrojax", "CasADi, own LM", Goal(6, most=False)),
        ("C lanes with MINPACK over hydrojax", "C lanes, MINPACK", None),
        ("C lanes with our own LM over hydrojax", "C lanes, own LM", None),
        ("one solve over the whole", "hydrojax, one solve", None),
    ):
        compare(section, per, says, of, OWN, goal)
    section.note(
        f"hydrojax finds the windows' start pressures too, in several solves; the "
        f"others are given them. Its worst parameter is {100 * worst:.2g} % off the "
        "truth. CasADi is interpreted."
    )
    for text in LEFT_OUT:
        section.note(text)
    return section


def _cold(
    section: Section,
    folder: str,
    cache: str,
    rounds: int,
    progress: Callable[[str], None],
) -> None:
    """The product in fresh processes: no cache on disk, and one that is full."""
    kinds = {"without": "", "with": cache}
    found: dict[str, list[dict]] = {kind: [] for kind in kinds}
    for i in range(rounds):
        for kind, where in kinds.items():
            progress(f"cold, {kind} a cache: {i + 1} of {rounds}")
            found[kind].append(fresh("fits:cold", {"folder": folder}, where))
    for kind, limit in (("without", 5.0), ("with", 1.0)):
        fits = spread([f["fit_s"] for f in found[kind]])
        says = f"cold fit, {kind} a cache on disk, after start and reading"
        section.figures.append(figure(says, fits, "s", Goal(limit)))
        rest = [f["start_s"] + f["read_s"] for f in found[kind]]
        section.figures.append(
            figure(f"start and reading, {kind} a cache", spread(rest), "s")
        )
        peak = spread([f["peak_mib"] for f in found[kind]])
        section.figures.append(figure(f"peak memory, {kind} a cache", peak, "MiB"))
