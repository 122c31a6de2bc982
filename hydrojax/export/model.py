"""A rig that another program drives: its variables by name.

What an FMU says of itself comes from here; no word of the FMI is in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hydrojax import units
from hydrojax.export.stepping import has_queue
from hydrojax.export.tree import meaning, plant
from hydrojax.parameters import parameter_specs
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
    if not layout.driven:
        line |= {"P"}
    absent = layout.unmeasured
    return frozenset(line).union(absent, (f"{p}_start" for p in absent))


@dataclass(frozen=True)
class DrivenRig:
    """A rig as another program sees it.

    Attributes:
        spec: the rig file.
        rig: the plant with its effects.
        period: the longest tick, s.
        counts_ticks: whether something in it remembers so many ticks, not so much time.
        inputs, outputs, starts, parameters: its variables.
        held: what the inputs are where nothing is set.
        rest: what the starts are.
    """

    spec: RigFile
    rig: Rig
    period: float
    counts_ticks: bool
    inputs: Names
    outputs: Names
    starts: Names
    parameters: Names
    held: Mapping[str, float]
    rest: Mapping[str, float]

    @property
    def has_valve(self) -> bool:
        """Whether a valve drives it; else the drive force `P` does, or nothing."""
        return self.spec.layout.has_valve


def driven_rig(spec: RigFile) -> DrivenRig:
    """What another program drives.

    Raises:
        InputError: the rig cannot be run, in one line.
    """
    rig, period, P_a1 = _at_rest(spec)
    P_a2 = P_a1 * float(rig.force_area_1 / rig.force_area_2)
    return DrivenRig(
        spec=spec,
        rig=rig,
        period=period,
        counts_ticks=has_queue(rig),
        inputs=_shown(INPUTS, spec),
        outputs=_shown(OUTPUTS, spec),
        starts=_shown(STARTS, spec),
        parameters=_shown(_parameters(rig, spec), spec),
        held=dict.fromkeys(INPUTS, 0.0) | spec.line,
        rest={"P_a1_start": P_a1, "P_a2_start": max(P_a2, spec.line["P_r"])},
    )


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
