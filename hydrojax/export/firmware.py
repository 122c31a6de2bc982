"""The plant and the controller as C99: a header and a source each, with the rig's
numbers; written from their own step by `hydrojax.export.codegen`.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from hydrojax import __version__
from hydrojax.export.codegen.emit import literal
from hydrojax.export.codegen.machine import Code, Field, Machine, code_of
from hydrojax.export.machines import law_machine, plant_machine
from hydrojax.export.model import driven_rig
from hydrojax.export.template import fill
from hydrojax.export.tree import defaults_taken, rig_tree
from hydrojax.rigfile.controller import LAWS, kind_of
from hydrojax.rigfile.schema import RigFile

PLANT = """
A tick is h seconds. u, P_s and P_r are held over it; the piston moves from x with v
and a, which were given since seconds before the tick began. Outputs are what the
sensors read at the tick's end. start: at rest at x and the pressures P_a1 and P_a2,
which step does not read."""
LAW = """
At each sample, h seconds apart, read the sensors, call law_step once, and hold the
command that it returns until the next sample. law_start takes the readings of the
first sample, law_step those of the same sample again. Readings must be finite: the
law does not look for faults of sensors, nor watch over limits of force, pressure or
travel."""


def firmware_of(spec: RigFile) -> dict[str, str]:
    """`plant.h`, `plant.c`, `law.h` and `law.c` for a rig, by name.

    An axis without a valve has no controller.

    Raises:
        InputError: an invalid entry in [controller], or an effect or a controller with
            an operation that has no form in C.
    """
    plant = plant_machine(driven_rig(spec))
    files = text_of("plant", "The plant", PLANT, spec, plant)
    if spec.layout.has_valve:
        files |= text_of("law", "The controller", LAW, spec, law_machine(spec))
    return files


def text_of(
    name: str, title: str, about: str, spec: RigFile, machine: Machine
) -> dict[str, str]:
    """A machine's header and source, by file name."""
    return text_of_code(name, title, about, spec.name, code_of(machine))


def text_of_code(
    name: str, title: str, about: str, rig: str, code: Code
) -> dict[str, str]:
    """The header and source of what `code_of` made, by file name."""
    known = {
        "name": name,
        "title": title,
        "about": about.splitlines(),
        "rig": rig,
        "version": __version__,
        "code": code,
        "structs": _structs(code),
        "starts": {field.name: _starting(field) for field in code.parameters},
    }
    return {
        f"{name}.{kind}": fill(f"codegen/module.{kind}.jinja", **known)
        for kind in ("h", "c")
    }


def _structs(code: Code) -> list[tuple[str, list[Field], str]]:
    return [
        ("parameters", code.parameters, "The numbers of the model."),
        ("constants", code.constants, "What follows from them."),
        ("state", code.state, "What is remembered from tick to tick."),
        ("input", code.inputs, "What is given at each tick."),
        ("output", code.outputs, "What comes out of it."),
    ]


def _starting(field: Field) -> str:
    """The initial numbers of a field, as C initialises it."""
    flat = [literal(v) for v in np.asarray(field.start).ravel().tolist()]
    return f"{{{', '.join(flat)}}}" if np.ndim(field.start) else flat[0]


def not_given(spec: RigFile) -> Iterable[str]:
    """Keys of [controller] for which the paper's law takes a default.

    The sensor's step is none of the law's.
    """
    if kind_of(spec) not in LAWS or not spec.layout.has_valve:
        return ()
    keys = defaults_taken(rig_tree(spec)["controller"])
    return (name for name in keys if name != "resolution")
