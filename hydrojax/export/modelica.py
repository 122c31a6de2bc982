"""A rig as a Modelica record: parameters with the types of the Modelica library.

Modelica's unit expressions have whole exponents only (Modelica specification, unit
expressions), so the valve constants, which hold the root of a pressure, are plain
`Real`; their unit stands in the description, as every unit does.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from hydrojax.export.template import fill
from hydrojax.export.tree import check_names, identifier, rig_tree
from hydrojax.rigfile.schema import RigFile

TYPES = {
    "m": "Length", "m^2": "Area", "m^3": "Volume", "m/s": "Velocity", "s": "Time",
    "kg": "Mass", "N": "Force", "Pa": "Pressure", "Hz": "Frequency", "rad": "Angle",
    "V": "Voltage", "N/m": "TranslationalSpringConstant",
    "N*s/m": "TranslationalDampingConstant",
}  # fmt: skip
"""Types of Modelica.Units.SI by unit. `Mass` has a least value of 0, the others of
these have none: offsets and biases may be negative."""

PREFIXES = {
    "geometry": "", "supply": "", "valve": "valve_", "parameters": "", "effects": "",
    "controller": "law_", "load": "load_", "sensors": "noise_",
}  # fmt: skip
"""What a section's names open with: the rig and its law both have a `k_cp`."""


def modelica_of(spec: RigFile) -> str:
    """One record, one line a parameter; its file has the record's name.

    Names are the rig file's; `law_` opens those of [controller], `load_` of [load],
    `noise_` of [sensors], `valve_` of [valve], and an effect's name those of its own.

    Raises:
        InputError: an effect of the user's own has a name that Modelica cannot take.
    """
    check_names(spec, "Modelica")
    tree = rig_tree(spec)
    sections = []
    for section, prefix in PREFIXES.items():
        lines = [_line(prefix + n, leaf) for n, leaf in _leaves(tree[section])]
        if lines:
            sections.append((section, lines))
    return fill(
        "record.mo.jinja",
        name=identifier(spec.name),
        rig=string(spec.name),
        layout=string(spec.layout.name),
        command=string(spec.command_unit),
        sections=sections,
    )


def _leaves(section: dict[str, Any]) -> Iterable[tuple[str, dict[str, Any]]]:
    """The quantities of a section, those of an effect under its name."""
    for name, leaf in section.items():
        if "value" in leaf:
            yield name, leaf
        else:
            yield from ((f"{name}_{inner}", sub) for inner, sub in _leaves(leaf))


def _line(name: str, leaf: dict[str, Any]) -> str:
    """One parameter's declaration."""
    value, unit = leaf["value"], leaf["unit"]
    pair = isinstance(value, list)
    kind, attribute = _type(unit)
    shown = "{" + ", ".join(map(repr, value)) + "}" if pair else repr(value)
    description = ": ".join(part for part in (leaf.get("says"), f"[{unit}]") if part)
    if not leaf["given"]:
        description += ", default"
    size = f"[{len(value)}]" if pair else ""
    return f"parameter {kind} {name}{size}{attribute} = {shown} {string(description)};"


def _type(unit: str) -> tuple[str, str]:
    """A unit's type and, where the library has none, the attribute that says it."""
    if unit in TYPES:
        return f"Modelica.Units.SI.{TYPES[unit]}", ""
    if re.search(r"\^\d*\.", unit):
        return "Real", ""
    return "Real", f'(unit="{unit.replace("^", "").replace("*", ".")}")'


def string(text: str) -> str:
    """Text as a string of Modelica's, on one line."""
    flat = " ".join(text.split())
    return '"' + flat.replace("\\", "\\\\").replace('"', '\\"') + '"'
