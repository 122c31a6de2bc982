"""A rig that another program drives: its variables by name, and where it stands.

What an FMU says of itself comes from here; no word of the FMI is in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from hydrojax import units
from hydrojax.errors import InputError
from hydrojax.export.stepping import SAME, Drive, advance, begin, has_queue, ticks_of
from hydrojax.export.tree import identifier, meaning, plant
from hydrojax.parameters import get, parameter_specs, put
from hydrojax.plant.layout import Layout
from hydrojax.plant.places import hydraulic_names
from hydrojax.plant.rig import Rig
from hydrojax.rigfile.build import build_loop
from hydrojax.rigfile.schema import RigFile

Names = Mapping[str, tuple[str, str]]
"""Variables by name: the SI unit, and what each is."""

INPUTS: Names = {
    "u": ("{u}", "valve command, held over the step"),
    "P": ("N", "net drive force, held over the step"),
    "x": ("m", "piston position at the step's start, 0 at mid-stroke"),
    "v": ("m/s", "piston velocity at the step's start"),
    "a": ("m/s^2", "piston acceleration, held over the step"),
    "P_s": ("Pa", "supply pressure, held over the step"),
    "P_r": ("Pa", "return pressure, held over the step"),
}

OUTPUTS: Names = {
    "P_a1": ("Pa", "pressure of chamber 1, as its sensor reads it"),
    "P_a2": ("Pa", "pressure of chamber 2, as its sensor reads it"),
    "F": ("N", "output force, as the load cell reads it"),
}

STARTS: Names = {
    "P_a1_start": ("Pa", "pressure of chamber 1 at the start"),
    "P_a2_start": ("Pa", "pressure of chamber 2 at the start"),
}

PERIOD = 1e-3
"""Tick of a rig without a controller, s."""


def variables_without(layout: Layout) -> frozenset[str]:
    """The variables that a rig of this layout does not have."""
    line = {"P"} if layout.has_valve else {"u", "P_s", "P_r"}
    absent = layout.unmeasured
    return frozenset(line).union(absent, (f"{p}_start" for p in absent))


class SteppedRig:
    """A rig and where it stands.

    `inputs`, `parameters`, `starts` and `outputs` say which variables there are;
    `drive`, `values`, `rest` and `read` hold their values by name.
    """

    def __init__(self, spec: RigFile) -> None:
        """From a rig file, as `RigFile.load` read it.

        Raises:
            InputError: the rig cannot be run, in one line.
        """
        self.spec, self.identifier = spec, identifier(spec.name)
        self.valve = spec.layout.has_valve
        self.rig, self.period, P_a1 = _at_rest(spec)
        self.queue = has_queue(self.rig)

        known = _parameters(self.rig, spec)
        self.inputs, self.outputs = _shown(INPUTS, spec), _shown(OUTPUTS, spec)
        self.starts, self.parameters = _shown(STARTS, spec), _shown(known, spec)
        self.drive = dict.fromkeys(INPUTS, 0.0) | spec.line
        numbers = np.asarray(get(self.rig, list(known))).tolist()
        self.values = dict(zip(known, numbers, strict=True))
        P_a2 = P_a1 * float(self.rig.force_area_1 / self.rig.force_area_2)
        self.rest = {"P_a1_start": P_a1, "P_a2_start": max(P_a2, spec.line["P_r"])}
        self.read = dict.fromkeys(OUTPUTS, 0.0)
        self._applied = dict(self.values)
        self._state: Any = None
        self._h: float | None = None

    def begin(self) -> None:
        """At rest where the piston is; the sensors read what is there."""
        self._apply()
        P_a1, P_a2 = self.rest.values()
        pressures = (P_a1, P_a2) if self.valve else (0.0, self.drive["P"])
        self._state, read = begin(self.rig, self._drive(), *pressures)
        self._keep(read)
        self._h = None

    def step(self, t: float, length: float) -> None:
        """One communication step of `length` seconds from time `t`.

        Raises:
            InputError: ticks of another length than before, and the rig counts them.
        """
        self._apply()
        count, h = ticks_of(length, self.period)
        if self.queue and self._h and abs(h / self._h - 1) > SAME:
            raise InputError(
                f"{self.spec.name}: a step of {length:g} s makes ticks of {h:g} s, and "
                f"the rig's delay counts in ticks of {self._h:g} s; keep to steps of "
                "one length"
            )
        self._h = h
        drive = self._drive()
        self._state, read = advance(self.rig, self._state, drive, t, h, count)
        self._keep(read)

    def _drive(self) -> Drive:
        given = {name: jnp.asarray(self.drive[name], float) for name in Drive._fields}
        drive = Drive(**given)
        return drive._replace(P=None) if self.valve else drive

    def _apply(self) -> None:
        """Put into the rig what was set since."""
        if self.values != self._applied:
            self.rig = put(
                self.rig, tuple(self.values), np.array(list(self.values.values()))
            )
            self._applied = dict(self.values)

    def _keep(self, read: dict[str, Any]) -> None:
        self.read.update({name: float(read[name]) for name in self.read})


def _shown(names: Names, spec: RigFile) -> Names:
    """The variables that this layout has, in the unit that its command has."""
    absent = variables_without(spec.layout)

    def text(words: str) -> str:
        return units.with_command(words, spec.command_unit)

    return {
        name: (text(unit), text(description))
        for name, (unit, description) in names.items()
        if name not in absent
    }


def _at_rest(spec: RigFile) -> tuple[Rig, float, float]:
    """The rig, the length of a tick (s), and P_a1 at rest (Pa)."""
    if not spec.layout.has_valve:
        return plant(spec), PERIOD, 0.0
    loop = build_loop(spec)
    return loop.rig, float(loop.h), float(loop.P_start)


def _parameters(rig: Rig, spec: RigFile) -> Names:
    """The rig's parameters; without a valve, those of friction and effects."""
    drop = (
        frozenset()
        if spec.layout.has_valve
        else hydraulic_names(rig) & spec.base.keys()
    )
    known = parameter_specs(rig).items()
    return {name: (s.unit, meaning(s)) for name, s in known if name not in drop}
