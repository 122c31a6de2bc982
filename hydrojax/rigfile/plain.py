"""A rig as nested dicts, and quantities, as the text of a rig file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import tomlkit

from hydrojax import units
from hydrojax.logs.tables import SIGNALS
from hydrojax.parameters import Spec
from hydrojax.rigfile.sections import GEOMETRY, LOAD, SUPPLY_UNITS

_UNITS: Mapping[str, Mapping[str, str]] = {
    "geometry": GEOMETRY,
    "supply": SUPPLY_UNITS,
    "load": LOAD,
    "valve": {"margin": "Pa"},
    "sensors": SIGNALS,
}


def to_text(
    tree: Mapping[str, Any],
    parameters: Mapping[str, Spec],
    effects: Mapping[str, Mapping[str, Spec]],
) -> str:
    """The TOML of a rig: numbers with the declared unit, pint quantities as text.

    Args:
        tree: the sections of a rig file.
        parameters: what the base model knows, by name.
        effects: what each effect knows, by the effect's name.
    """
    declared = {
        **_UNITS,
        "parameters": _declared(parameters),
        "effects": {name: _declared(known) for name, known in effects.items()},
    }
    return tomlkit.dumps(_written(dict(tree), declared))


def _declared(known: Mapping[str, Spec]) -> dict[str, str]:
    """The unit of every parameter, and of what is given as its reciprocal."""
    out = {name: s.unit for name, s in known.items()}
    return out | {s.outside[0]: s.outside[1] for s in known.values() if s.outside}


def _written(value: Any, declared: Any) -> Any:
    """A branch of the tree as TOML has it; `declared`: its units, as far as known."""
    if isinstance(value, Mapping):
        if isinstance(declared, str):  # start and range of one parameter
            return {str(key): _written(v, declared) for key, v in value.items()}
        known = declared or {}
        return {str(key): _written(v, known.get(key)) for key, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_written(v, declared) for v in value]
    if hasattr(value, "magnitude"):  # a pint quantity
        return f"{float(value.magnitude):.17g} {value.units:C}".strip()
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, float, np.number)):
        number = value if isinstance(value, int) else float(value)
        if not isinstance(declared, str):
            return number
        unit = units.with_command(declared, "V")
        return f"{number!r} {unit}" if unit != "1" else repr(number)
    return value


def text(value: float, unit: str) -> str:
    """A quantity as a rig file has it: six figures and the unit."""
    return f"{value:.6g}" if unit == "1" else f"{value:.6g} {unit}"
