"""What needs both identification and tuning: the law's friction bounds from logs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from hydrojax import units
from hydrojax.control.loop import Loop, Scenario
from hydrojax.errors import InputError
from hydrojax.identify import api
from hydrojax.identify.case import Case
from hydrojax.identify.estimation.box import (
    Box,
    Stretch,
    fit_stretches,
    friction_names,
    smallest_box,
)
from hydrojax.identify.results.closed_loop import identified
from hydrojax.logs.log import Log
from hydrojax.rigfile import controller, scenarios
from hydrojax.rigfile.build import build_loop
from hydrojax.rigfile.edit import rewrite, text
from hydrojax.rigfile.schema import RigFile
from hydrojax.tune.ensemble import Plants
from hydrojax.tune.refine import refine, tracking, with_bounds

MOST_SECONDS = 6.0
"""How much of each log is run in closed loop, s."""


@dataclass(frozen=True)
class Bounds:
    """Bounds of theta_f in three ways, and how the law tracks with each; SI.

    `bounds` by way ("paper", "box", "refined"): lower and upper, [n] each; `fitted` and
    `others` by way: RMS tracking error over plants and courses of the logs that took
    part, and of those that did not (empty without any), N.
    """

    box: Box
    fits: list[Stretch]
    other_fits: list[Stretch]
    bounds: dict[str, tuple[np.ndarray, np.ndarray]]
    fitted: dict[str, float]
    others: dict[str, float]
    rig_file: str


def friction_bounds(
    case: Case,
    confidence: float = 0.95,
    stretch: float = 2.0,
    progress: Callable[[str], None] = lambda _: None,
) -> Bounds:
    """The law's bounds of theta_f from many fits, then refined through the loop.

    Args:
        case: the rig and its logs; those kept for the check give plants on which the
            three ways are compared and which take no part in finding them.
        confidence: that the box holds the next stretch's theta_f.
        stretch: length of a fit, s.
        progress: called with a line of text at each stage.

    Raises:
        InputError: nothing of friction is free, or the logs are too short.
    """
    state = api.fit_case(case, 1, progress)
    names = friction_names(state.problem)
    progress("fit friction in every stretch")
    logs = [log.name for log in case.fit_logs]
    fits = fit_stretches(state.problem, state.point, case.fit, logs, stretch)
    other_fits: list[Stretch] = []
    if case.held_out:
        values = state.point.values
        check = state.check.restarted(state.check.sums_at(values), values)
        check = replace(check, free=state.problem.free)
        others = [log.name for log in case.check_logs]
        other_fits = fit_stretches(check, state.point, case.check, others, stretch)
    free = [state.problem.free[n] for n in names]
    limits = [(f.lower, f.upper) for f in free]
    box = smallest_box(names, fits, confidence, limits)

    spec = identified(case.spec, state.named)
    loop = build_loop(spec)
    plants = Plants(names, np.array([f.theta for f in fits]))
    loop, scenarios = _scenarios(spec, loop, case.fit_logs)
    progress("refine the bounds")
    paper = controller.default_bounds(loop.law.nominal)
    lowest, highest = (np.array([paper[n][i] for n in names]) for i in (0, 1))
    ways: dict[str, tuple[np.ndarray, np.ndarray]] = {
        "paper": (lowest, highest),
        "box": (box.lower, box.upper),
    }
    ways["refined"] = refine(loop, plants, scenarios, *ways["box"], limits, progress)

    def errors(which: Plants, on: Scenario) -> dict[str, float]:
        out = {}
        for way, ends in ways.items():
            each = tracking(with_bounds(loop, names, *ends), which, on)
            out[way] = float(np.sqrt(np.mean(each**2)))
        return out

    progress("compare them")
    fitted, elsewhere = errors(plants, scenarios), {}
    if other_fits:
        rest = Plants(names, np.array([f.theta for f in other_fits]))
        elsewhere = errors(rest, _scenarios(spec, loop, case.check_logs)[1])
    lower, upper = ways["refined"]
    keys = {
        n: [_paper_unit(n, a), _paper_unit(n, b)]
        for n, a, b in zip(names, lower, upper, strict=True)
    }
    file = rewrite(case.spec, state.named, controller=keys)
    return Bounds(box, fits, other_fits, ways, fitted, elsewhere, file)


def _paper_unit(name: str, value: float) -> str:
    """A bound as [controller] has it."""
    unit = controller.KEYS[name].unit
    factor = units.to_si(1.0, unit, controller.si(unit), name)
    return text(float(value) / factor, unit)


def _scenarios(
    spec: RigFile, loop: Loop, logs: tuple[Log, ...]
) -> tuple[Loop, Scenario]:
    """Every log's start as a course, of equal length, stacked."""
    for log in logs:
        if "F_d" not in log.signals:
            raise InputError(
                f"{log.name}: no column F_d: bounds are refined on what the loop was "
                "asked for; give logs that have it"
            )
    rerun = [scenarios.rerun(spec, loop, log, MOST_SECONDS) for log in logs]
    found = [scenario for scenario, _ in rerun if scenario is not None]
    if not found:
        raise InputError(f"{logs[0].name}: no two seconds without a gap to run again")
    least = min(c.F_d.size for c in found)
    cut = [jax.tree.map(lambda a: a[:least], c) for c in found]
    return rerun[0][1], jax.tree.map(lambda *a: jnp.stack(a), *cut)


def json_of(found: Bounds) -> dict[str, Any]:
    """The content of bounds.json; SI."""
    ways = {
        way: {
            n: [float(a), float(b)]
            for n, a, b in zip(found.box.names, *ends, strict=True)
        }
        for way, ends in found.bounds.items()
    }
    return {
        "format": "hydrojax-bounds/1",
        "confidence": found.box.confidence,
        "stretches": [
            {"log": f.log, "start": f.start, "seconds": f.seconds}
            | dict(zip(found.box.names, f.theta.tolist(), strict=True))
            for f in found.fits
        ],
        "bounds": ways,
        "tracking_rms_N": {"fitted": found.fitted, "others": found.others},
    }


COLOURS = {"paper": "0.75", "box": "#E69F00", "refined": "#0072B2"}


def bounds_figure(found: Bounds) -> Figure:
    """Each parameter's fits, and the three bounds around them."""
    n = len(found.box.names)
    fig = Figure(figsize=(8.0, 1.1 + 0.62 * n), layout="constrained")
    axes = np.atleast_1d(fig.subplots(n, 1))
    for i, (ax, name) in enumerate(zip(axes, found.box.names, strict=True)):
        unit = controller.KEYS[name].unit
        factor = units.to_si(1.0, unit, controller.si(unit), name)
        for row, (way, (low, high)) in enumerate(found.bounds.items()):
            ax.plot(
                np.array([low[i], high[i]]) / factor, [-row, -row], "|-",
                color=COLOURS[way], lw=4, ms=9, solid_capstyle="butt",
                label=f"{way} bounds" if i == 0 else None,
            )  # fmt: skip
        for fits, mark, label in (
            (found.fits, "o", "stretches"),
            (found.other_fits, "^", "stretches that took no part"),
        ):
            if fits:
                at = np.array([f.theta[i] for f in fits]) / factor
                std = np.sqrt([f.covariance[i, i] for f in fits]) / factor
                rows = 1 + 0.5 * (mark == "^") + np.zeros(at.size)
                ax.errorbar(
                    at, rows, xerr=std, fmt=mark, color="black", ms=3, lw=0.6,
                    label=label if i == 0 else None,
                )  # fmt: skip
        ax.set_yticks([])
        ax.set_ylim(-2.7, 2.1)
        ax.set_ylabel(name, rotation=0, ha="right", va="center")
        ax.set_xlabel("" if unit == "1" else f"[{unit.replace('*', '·')}]", labelpad=0)
        ax.tick_params(labelsize=8)
        ax.xaxis.label.set_size(8)
    fig.legend(loc="outside upper center", ncols=5, fontsize=8, frameon=False)
    return fig
