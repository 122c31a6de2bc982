"""The JSON schema of a rig file, from the declarations: editors complete and check."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hydrojax.effects import EFFECTS
from hydrojax.effects.fluid import PressureCompensation
from hydrojax.logs.tables import SIGNALS, Channel
from hydrojax.parameters import Spec, specs
from hydrojax.plant.layout import LAYOUTS
from hydrojax.rigfile import valve
from hydrojax.rigfile.controller import KEYS, KIND, KINDS, written_unit
from hydrojax.rigfile.other_controllers import OTHERS
from hydrojax.rigfile.schema import LOGS
from hydrojax.rigfile.sections import (
    GEOMETRY,
    LOAD,
    LOAD_PARAMETERS,
    PREDICTED,
    SUPPLY_UNITS,
    Sections,
    base_specs,
    effect_specs,
)

MEANINGS: Mapping[str, str] = {
    "name": "Of the rig, in reports.",
    "layout": "pull-pull: two chambers of equal area. differential: area_1 on the rod "
    "side, area_2 on the bore side. single: one pressurised chamber, P_a2. "
    "driven-axis: a drive force P, no pressures. tester: moved from outside against a "
    "load cell, no drive.",
    "geometry": "Known sizes; a tolerance may follow: 1.18e-3 m^2 +- 1 %.",
    "supply": "Pressures where the log has no such channel.",
    "valve": "The kind of the valve; without this section its edges are orifices.",
    "sensors": "Standard deviation of the noise, where it is known.",
    "load": "A force F known without a sensor, or the inertia of closed-loop runs and "
    "of a motion that is predicted.",
    "channels": "Columns of the log by signal: name, unit, sign.",
    "parameters": "What is to be found: start and range; a plain quantity is held.",
    "effects": "Effects that are known: found where they have a range, held otherwise.",
    "controller": "The adaptive law of closed-loop runs, in the paper's units.",
}
"""What each key and section of a rig file is for."""

KEY_MEANINGS: Mapping[str, str] = {
    "geometry.area": "area of each chamber (pull-pull, single)",
    "geometry.area_1": "area of chamber 1, which shrinks as x grows: the rod side",
    "geometry.area_2": "area of chamber 2, which pushes toward positive x: the bore",
    "geometry.chamber_length": "stroke of the piston between its stops",
    "geometry.radius": "of the joint: x = radius * psi",
    "geometry.x_mid": "what the position sensor reads at mid-stroke",
    "geometry.x_from": "start of the stretch over which profiles are laid",
    "geometry.x_to": "end of that stretch",
    "supply.P_s": "supply pressure",
    "supply.P_r": "return pressure",
    "load.F": "force on the output; 0 N says that the axis moves free",
    "load.mass": "of the load on the output, in closed loop or predicted motion",
    "load.stiffness": "of the spring to the load; slack at mid-stroke where motion is "
    "predicted",
    "load.damping": "of the spring to the load",
    "load.second_mass": "of what the load carries through an elastic joint",
    "load.second_stiffness": "of that joint",
    "load.second_damping": "of that joint",
}
"""What each key of [geometry], [supply] and [load] is."""


def rig_schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of a rig file."""
    out = Sections.model_json_schema()
    out["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    out["title"] = "hydrojax rig file"
    sections = out["properties"]
    for name, said in MEANINGS.items():
        sections[name]["description"] = said
        sections[name].pop("title", None)
    sections["layout"]["enum"] = list(LAYOUTS)
    wants = {
        "geometry": GEOMETRY,
        "supply": SUPPLY_UNITS,
        "load": LOAD,
        "sensors": {n: u for n, u in SIGNALS.items() if n != "time"},
    }
    for section, keys in wants.items():
        said = {k: KEY_MEANINGS.get(f"{section}.{k}", f"noise of {k}") for k in keys}
        entries = {k: quantity_schema(u, said[k]) for k, u in keys.items()}
        if section == "load":
            own = parameters(LOAD_PARAMETERS)
            for key, either in own.items():
                entries[key] |= {"anyOf": either["anyOf"]}
            said = "what is an output of the model, and not given by the log"
            entries["predicts"] = {"enum": list(PREDICTED), "description": said}
        sections[section] |= object_schema(entries)
    sections["valve"] |= object_schema(_valve())
    out.pop("$defs", None)
    channel = Channel.model_json_schema() | {"description": "the signal's column"}
    sections["channels"] |= object_schema(dict.fromkeys(SIGNALS, channel))
    sections["parameters"] |= object_schema(parameters(base_specs()))
    logs = {
        "type": "array", "items": {"type": "string"}, "minItems": 1,
        "description": "names of the logs that it is in; all without it",
    }  # fmt: skip
    effects = {
        name: object_schema(
            parameters(known) | ({LOGS: logs} if EFFECTS[name].of_the_logger else {})
        )
        | {"description": EFFECTS[name].__doc__ or ""}
        for name, known in effect_specs().items()
    }
    # Effects of a user's own are known to hydrojax, not to this schema.
    sections["effects"] |= object_schema(effects)
    sections["effects"]["additionalProperties"] = {"type": "object"}
    gains = {name: _gain(name) for name in KEYS}
    for kind in OTHERS.values():
        for name, own in specs(kind).items():
            gains.setdefault(name, quantity_schema(own.unit, own.description))
    named = {
        "enum": list(KINDS),
        "description": "; ".join(map(": ".join, KINDS.items())),
    }
    sections["controller"] |= object_schema({KIND: named} | gains)
    return out


def _valve() -> dict[str, Any]:
    """The keys of [valve]."""
    column = {
        "type": "array", "items": {"type": ["string", "number"]},
        "minItems": 2, "maxItems": valve.MOST,
    }  # fmt: skip
    margin = parameters({"margin": specs(PressureCompensation)[valve.MARGIN]})
    kinds = {"kind": {"enum": list(valve.KINDS)}, "command": column, "opening": column}
    return {
        key: (kinds | margin)[key] | {"description": said}
        for key, said in valve.MEANINGS.items()
    }


def object_schema(entries: Mapping[str, Any]) -> dict[str, Any]:
    """A table with these keys and no others."""
    return {
        "type": "object",
        "properties": dict(entries),
        "additionalProperties": False,
    }


def quantity_schema(unit: str, description: str) -> dict[str, Any]:
    """A number with its unit."""
    plain = [{"type": "number"}] if unit == "1" else []
    shown = unit.replace("{u}", "V")
    return {
        "anyOf": [{"type": "string"}, *plain],
        "description": f"{description}; in {shown}" if unit != "1" else description,
        "examples": [f"1 {shown}" if unit != "1" else "1"],
    }


def parameters(known: Mapping[str, Spec]) -> dict[str, Any]:
    """Parameters by their names, and by those of their reciprocals."""
    out: dict[str, Any] = {}
    for name, spec in known.items():
        out[name] = _parameter(spec.unit, spec.description, spec)
        if spec.outside:
            other, unit = spec.outside
            out[other] = _parameter(unit, f"{spec.description} (1/{name})", None)
    return out


def _parameter(unit: str, description: str, spec: Spec | None) -> dict[str, Any]:
    """One parameter: held, or found within a range."""
    held = quantity_schema(unit, description)
    limits = f"; {spec.lower:g} to {spec.upper:g} at most" if spec else ""
    ends = {"type": "array", "items": {"anyOf": held["anyOf"]}}
    found = object_schema(
        {
            "start": quantity_schema(unit, "where the search starts"),
            "range": ends | {"minItems": 2, "maxItems": 2},
        }
    )
    return {
        "anyOf": [*held["anyOf"], found | {"required": ["start", "range"]}],
        "description": held["description"] + limits,
    }


def _gain(name: str) -> dict[str, Any]:
    """A key of [controller]."""
    one = {"type": ["string", "number"]}
    pair = {"type": "array", "items": one, "minItems": 2, "maxItems": 2}
    kinds = [one, pair] if KEYS[name].pair else [one]
    unit = written_unit(name).replace("{u}", "V")
    return {"anyOf": kinds, "description": f"{KEYS[name].description}; in {unit}"}
