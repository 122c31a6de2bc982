"""Friction bounds on disk: the content of bounds.json, and the picture."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hydrojax import units
from hydrojax.rigfile import controller
from hydrojax.workflows.friction_bounds import Bounds

COLOURS = {
    "paper": "0.75", "box": "#E69F00", "refined": "#0072B2", "rig file": "#009E73",
}  # fmt: skip


def content(found: Bounds) -> dict[str, Any]:
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
        "coverage": found.coverage,
        "proposed": found.proposed,
        "tracking_rms_N": {"fitted": found.fitted, "others": found.others},
    }


def bounds_figure(found: Bounds) -> Figure:
    """Each parameter's fits, and the bounds around them."""
    n = len(found.box.names)
    fig = Figure(
        figsize=(8.0, 1.1 + 0.155 * n * (1 + len(found.bounds))), layout="constrained"
    )
    axes = np.atleast_1d(fig.subplots(n, 1))
    for i, (ax, name) in enumerate(zip(axes, found.box.names, strict=True)):
        _draw(ax, found, i, name)
    fig.legend(loc="outside upper center", ncols=5, fontsize=8, frameon=False)
    return fig


def _draw(ax: Any, found: Bounds, i: int, name: str) -> None:
    """A parameter's fits and bounds; the first parameter's have the labels."""
    unit = controller.written_unit(name)
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
    ax.set_ylim(0.3 - len(found.bounds), 2.1)
    ax.set_ylabel(name, rotation=0, ha="right", va="center")
    ax.set_xlabel("" if unit == "1" else f"[{unit.replace('*', '·')}]", labelpad=0)
    ax.tick_params(labelsize=8)
    ax.xaxis.label.set_size(8)
