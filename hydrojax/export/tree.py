"""A rig file as a plain tree of numbers with units: what every format writes.

SI throughout. Where the file is silent stands the default that hydrojax itself takes,
marked `given: False`, since a reader without hydrojax could not look it up.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from hydrojax import units
from hydrojax.effects import EFFECTS
from hydrojax.errors import InputError
from hydrojax.logs.tables import SIGNALS
from hydrojax.parameters import Spec, get, specs
from hydrojax.plant.places import hydraulic_names
from hydrojax.plant.rig import Rig
from hydrojax.rigfile.build import build_loop, build_rig
from hydrojax.rigfile.controller import (
    KEYS,
    LAWS,
    PAPER,
    default_bounds,
    file_keys,
    key_unit,
    kind_of,
    si,
    valve_gain,
    written_unit,
)
from hydrojax.rigfile.schema import RigFile
from hydrojax.rigfile.sections import GEOMETRY, LOAD, Entry

FORMAT = "hydrojax-rig/1"

TAKEN = ("Real", "Integer", "Boolean", "String")
"""Names that open with a capital and mean something in Modelica."""

Tree = dict[str, Any]


def rig_tree(spec: RigFile) -> Tree:
    """The content of a rig file: nested dicts of text, and of quantities.

    A quantity is `{"value", "unit", "given"}`: a number (in `controller` it may be two
    bounds), its SI unit as text, and whether the file gives it. Parameters also have
    `says`, and `range` (two numbers) where they are free to be fitted.

    Raises:
        InputError: an invalid key, unit or value in [controller].
    """
    rig = plant(spec)
    return {
        "format": FORMAT,
        "name": spec.name,
        "layout": spec.layout.name,
        "command_unit": spec.command_unit,
        "geometry": _given(spec.geometry, GEOMETRY),
        "supply": {
            name: {"value": v, "unit": "Pa", "given": name in spec.supply}
            for name, v in spec.line.items()
        },
        "valve": _table(spec),
        "parameters": _parameters(spec, rig),
        "effects": {
            name: _fields(rig, specs(EFFECTS[name]), entries, spec, f"{name}.")
            for name, entries in spec.effects.items()
        },
        "controller": _controller(spec),
        "load": _given(spec.output_load, LOAD),
        "sensors": _given(spec.sensors, signal_units(spec)),
        "channels": {
            name: {
                "column": c.column,
                "unit": c.unit or "",
                "invert": c.invert,
                "delay": c.delay,
                "scale": c.scale,
            }
            for name, c in spec.channels.items()
        },
    }


def plant(spec: RigFile) -> Rig:
    """The rig of a file with the effects it declares, as a closed loop runs it."""
    return build_rig(spec)


def signal_units(spec: RigFile) -> dict[str, str]:
    """The SI unit of every signal on this rig."""
    return {n: units.with_command(u, spec.command_unit) for n, u in SIGNALS.items()}


def identifier(name: str) -> str:
    """A name that C, Modelica and MATLAB take, as near to `name` as they allow."""
    joined = "_".join(re.findall(r"[A-Za-z0-9]+", name))
    if not joined[:1].isalpha() or joined in TAKEN:
        joined = f"Rig_{joined}".rstrip("_")
    return (joined[0].upper() + joined[1:])[:60]


def check_names(spec: RigFile, what: str) -> None:
    """Refuse names of a user's own effects that another language cannot take.

    Raises:
        InputError: a name with other signs than letters, figures and `_`, or one
            that does not open with a letter.
    """
    for effect in spec.effects:
        for name in (effect, *specs(EFFECTS[effect])):
            if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,59}", name):
                raise InputError(
                    f"{spec.path}: [effects.{effect}]: {what} cannot have the name "
                    f"{name!r}; rename it with letters, figures and _, a letter first"
                )


def meaning(s: Spec) -> str:
    """What a parameter is, as it is stored."""
    if s.outside is None:
        return s.description
    name, unit = s.outside
    return f"1/{name}; {name}: {s.description}, {unit}"


def defaults_taken(keys: Tree) -> Iterable[str]:
    """The names in one section of a tree that the file does not give."""
    return (name for name, leaf in keys.items() if not leaf["given"])


def _given(values: dict[str, float], wants: dict[str, str]) -> Tree:
    return {
        name: {"value": value, "unit": wants[name], "given": True}
        for name, value in values.items()
    }


def _table(spec: RigFile) -> Tree:
    """The columns of a flow table, where the valve has one."""
    columns = spec.table._asdict() if spec.table else {}
    return {
        name: {"value": list(rows), "unit": spec.command_unit, "given": True}
        for name, rows in columns.items()
    }


def _parameters(spec: RigFile, rig: Rig) -> Tree:
    """The base model's; an axis without chambers has only friction."""
    drop = frozenset() if spec.layout.has_valve else hydraulic_names(rig)
    known = {name: s for name, s in spec.base.items() if name not in drop}
    return _fields(rig, known, spec.parameters, spec)


def _fields(
    rig: Rig,
    known: dict[str, Spec],
    entries: dict[str, Entry],
    spec: RigFile,
    prefix: str = "",
) -> Tree:
    """Parameters of one module, with what is declared of them."""
    values = np.asarray(get(rig, [prefix + name for name in known])).tolist()
    out: Tree = {}
    for (name, s), value in zip(known.items(), values, strict=True):
        entry = entries.get(name)
        out[name] = {
            "value": entry.start if entry else value,
            "unit": units.with_command(s.unit, spec.command_unit),
            "given": entry is not None,
            "says": units.with_command(meaning(s), spec.command_unit),
        }
        if entry and entry.range:
            out[name]["range"] = list(entry.range)
    return out


def _controller(spec: RigFile) -> Tree:
    """Every key of [controller], the file's or the default; bounds as two values.

    A rig without a valve has no loop: only what its file says. Of another controller
    than the paper's law these are the gains it declares, and what the file says of the
    loop.
    """
    given = file_keys(spec)
    if kind_of(spec) not in LAWS and spec.layout.has_valve:
        return _loop_keys(spec, given) | _declared(spec)
    ends = _defaults(spec) | given if spec.layout.has_valve else given
    out: Tree = {}
    for name, (lower, upper) in ends.items():
        value = [lower, upper] if KEYS[name].pair else lower
        unit = si(key_unit(name, spec))
        out[name] = {"value": value, "unit": unit, "given": name in given}
    return {name: out[name] for name in KEYS if name in out}


def _loop_keys(spec: RigFile, given: Mapping[str, tuple[float, float]]) -> Tree:
    return {
        name: {"value": value, "unit": si(key_unit(name, spec)), "given": True}
        for name, (value, _) in given.items()
    }


def _declared(spec: RigFile) -> Tree:
    law = build_loop(spec).law
    return {
        name: {
            "value": float(getattr(law, name)),
            "unit": units.with_command(known.unit, spec.command_unit),
            "given": name in spec.controller,
        }
        for name, known in specs(law).items()
    }


def _defaults(spec: RigFile) -> dict[str, tuple[float, float]]:
    """What the closed loop takes for each key that the file does not give."""
    loop = build_loop(spec)
    nominal = loop.law.nominal
    kappa = valve_gain(file_keys(spec), nominal)
    step = float(loop.sensors.step) / spec.geometry.get("radius", 1.0)
    alone = {
        name: units.to_si(value, written_unit(name), si(written_unit(name)), name)
        for name, value in PAPER.items()
    } | {"kappa": kappa, "u_max": float(loop.law.u_max), "resolution": step}
    ends = {name: (value, value) for name, value in alone.items()}
    for name, (lower, upper) in default_bounds(nominal).items():
        scale = kappa if KEYS[name].volts else 1.0
        ends[name] = (lower / scale, upper / scale)
    return ends
