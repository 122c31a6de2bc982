"""What a sweep does: its axes, methods, ensemble, excitations and chunks."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from hydrojax.errors import CELLS, InputError
from hydrojax.export.codegen.lanes import LANES
from hydrojax.rigfile.fingerprint import code_fingerprint
from hydrojax.rigfile.quantities import Quantity, Setting
from hydrojax.tune import linearize, measure, metrics, operating_point
from hydrojax.tune.axes import Axis, cells
from hydrojax.tune.ensemble import Plants

METHODS = ("linear", "multisine", "noise")
MEMORY = 40e6
"""Bytes that a chunk's signals may take: with more, the system hands over fresh memory
for every chunk."""

MADE_BY = (
    linearize.system,
    linearize.frequency_response,
    linearize.radius,
    metrics.loop_metrics,
    measure.measure,
    measure.multisine,
    measure.white_noise,
    operating_point.still,
)
"""The functions that make a sweep's figures: their code is part of its key."""


@dataclass(frozen=True)
class Plan:
    """What a sweep does.

    Attributes:
        setting: the rig at its operating point; the axes change it.
        axes: 1 to 4.
        known: every quantity by name.
        methods: of `METHODS`.
        plants: an ensemble, if there is one.
        frozen: whether adaptation stands still when it is measured too.
        rig: its name.
        unit: of the command.
        chunk: cells in a chunk; 0 is by memory.
        excitations: of the methods that measure; made when None.
    """

    setting: Setting
    axes: list[Axis]
    known: Mapping[str, Quantity]
    methods: tuple[str, ...] = ("linear",)
    plants: Plants | None = None
    frozen: bool = False
    rig: str = ""
    unit: str = "V"
    chunk: int = 0
    excitations: dict[str, measure.Excitation] = field(default_factory=dict)

    @property
    def shape(self) -> tuple[int, ...]:
        """Plants first, if there are any, then the axes."""
        lead = (len(self.plants.values),) if self.plants else ()
        return (*lead, *(a.values.size for a in self.axes))

    def table(self) -> Float[np.ndarray, "cells columns"]:
        """Values of the axes and of the plants' parameters in every cell."""
        grid = cells(self.axes)
        if self.plants is None:
            return grid
        own = np.repeat(self.plants.values, len(grid), axis=0)
        return np.hstack([np.tile(grid, (len(self.plants.values), 1)), own])

    def at(self, row: Any) -> Setting:
        """The setting of one cell. The axes come last: they overrule a plant."""
        s, n = self.setting, len(self.axes)
        if self.plants is not None:
            for i, name in enumerate(self.plants.names):
                s = Quantity(name, "", "", parameter=name).put(s, row[n + i])
        for i, axis in enumerate(self.axes):
            s = axis.quantity.put(s, row[i])
        return s

    def key(self) -> str:
        """What the sweep depends on, in a few letters: the question and the code."""
        code = code_fingerprint(self.setting, MADE_BY)
        return hashlib.sha256(f"{self.question()} {code}".encode()).hexdigest()[:16]

    def question(self) -> str:
        """What is asked, in a few letters: rig, operating point, axes and plants."""
        seen = hashlib.sha256()
        for leaf in jax.tree.leaves((self.setting, self.table())):
            seen.update(np.asarray(leaf).tobytes())
        words = (str(jax.tree.structure(self.setting)), self.frozen, self.shape)
        words += tuple(a.name for a in self.axes)
        seen.update(repr(words).encode())
        return seen.hexdigest()[:16]


def tag_of(plan: Plan, method: str) -> str:
    """What a chunk of a method is called, but for its number."""
    size, given = chunk_size(plan, method), plan.excitations.get(method)
    if given is None:
        return f"{method}-{size}"
    seen = hashlib.sha256(given.shape.tobytes() + given.noise.tobytes())
    return f"{method}-{size}-{seen.hexdigest()[:8]}"


def with_excitations(plan: Plan) -> Plan:
    """The plan with its excitations, checked.

    Raises:
        InputError: measuring at a rate that is swept, or at no amplitude.
    """
    if (cells := math.prod(plan.shape)) > CELLS:
        raise InputError(
            f"sweep: {cells} cells over axes and plants are more than {CELLS}; take "
            "fewer values or plants"
        )
    measured = [m for m in plan.methods if m != "linear"]
    if measured and any(a.name == "rate" for a in plan.axes):
        raise InputError(
            "axis rate: a measurement has one sampling rate; use the method linear "
            "alone (--by linear)"
        )
    rate = float(1 / plan.setting.loop.h)
    make = {"multisine": measure.multisine, "noise": measure.white_noise}
    made = {m: plan.excitations.get(m) or make[m](rate) for m in measured}
    return Plan(**{**plan.__dict__, "excitations": made})


def chunk_size(plan: Plan, method: str) -> int:
    """Cells in a chunk: as many on every device, and in groups of `LANES` if more."""
    if method == "linear":
        each, most = metrics.LINES * 10 * 16 * 4.0, 256
    else:
        each = plan.excitations[method].shape.size * len(measure.KEEP) * 8 * 3.0
        most = 128
    fits = plan.chunk or int(min(max(MEMORY // each, 16), most, np.prod(plan.shape)))
    if not plan.chunk and fits > LANES:
        fits -= fits % LANES
    devices = jax.local_device_count()
    return -(-fits // devices) * devices
