"""The tree as text: a rig file again, JSON, and MATLAB's file."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import tomlkit
from scipy.io import savemat

from hydrojax.export.tree import Tree, check_names, rig_tree, signal_units
from hydrojax.rigfile.controller import (
    KEYS,
    KIND,
    LAWS,
    file_keys,
    key_unit,
    kind_of,
    si,
)
from hydrojax.rigfile.schema import RigFile
from hydrojax.rigfile.sections import GEOMETRY, LOAD, Entry


def toml_of(spec: RigFile) -> str:
    """The rig file again: what it gives and nothing else, in SI, to the last digit.

    hydrojax reads it back as the same rig. What the file gives as a reciprocal (a
    spool's `omega`) stands under the name that the model stores (`tau`).
    """
    document = tomlkit.document()
    document["name"] = spec.name
    document["layout"] = spec.layout.name
    pressures = dict.fromkeys(spec.supply, "Pa")
    sections = (
        ("geometry", _quantities(spec.geometry, GEOMETRY, spec.tolerances)),
        ("supply", _quantities(spec.supply, pressures, spec.tolerances)),
        ("sensors", _quantities(spec.sensors, signal_units(spec))),
        ("load", _load(spec)),
        ("valve", _table(spec)),
        ("channels", _channels(spec)),
        ("parameters", _entries(spec.parameters)),
    )
    for name, table in sections:
        if table:
            document[name] = table
    if spec.effects:
        document["effects"] = tomlkit.table(is_super_table=True)
        for name, entries in spec.effects.items():
            table = tomlkit.table()
            table.update(_entries(entries))
            document["effects"][name] = table
    if spec.controller:
        document["controller"] = _controller(spec)
    return tomlkit.dumps(document)


def json_of(spec: RigFile) -> str:
    """`rig_tree` as JSON; docs/interchange.md says what each key means."""
    return json.dumps(rig_tree(spec), indent=1, ensure_ascii=False) + "\n"


def mat_of(spec: RigFile) -> bytes:
    """`rig_tree` as a struct `rig` in a MATLAB file of version 5.

    Raises:
        InputError: an effect of the user's own has a name that MATLAB cannot take.
    """
    check_names(spec, "MATLAB")
    file = io.BytesIO()
    savemat(file, {"rig": _struct(rig_tree(spec))}, format="5", long_field_names=True)
    return file.getvalue()


def _struct(tree: Tree) -> Tree:
    """A tree as savemat takes it: two numbers in a row, and no struct without fields.

    An empty section is left out: a struct of no fields reads back as nothing.
    """
    out: Tree = {}
    for name, leaf in tree.items():
        if isinstance(leaf, Mapping):
            if leaf:
                out[name] = _struct(dict(leaf))
        else:
            out[name] = np.array(leaf, float) if isinstance(leaf, list) else leaf
    return out


def _quantity(value: float, unit: str, tolerance: float = 0.0) -> str:
    """A quantity as a rig file has it, with all the digits that the float has.

    Its tolerance, in the same unit, follows it; 0 is none.
    """
    own = f"{value!r}" if unit == "1" else f"{value!r} {unit}"
    return f"{own} +- {_quantity(tolerance, unit)}" if tolerance else own


def _quantities(
    values: Mapping[str, float],
    wants: Mapping[str, str],
    tolerances: Mapping[str, float] = MappingProxyType({}),
) -> Tree:
    return {
        name: _quantity(value, wants[name], tolerances.get(name, 0.0))
        for name, value in values.items()
    }


def _load(spec: RigFile) -> Tree:
    """The section [load]."""
    out = _quantities(spec.output_load, LOAD)
    for name, ends in spec.load_ranges.items():
        shown = [_quantity(end, LOAD[name]) for end in ends]
        out[name] = {"start": out[name], "range": shown}
    return out | ({"predicts": spec.predicts} if spec.predicts else {})


def _table(spec: RigFile) -> Tree:
    """The section [valve]; what compensates is among the effects."""
    if spec.table is None:
        return {}
    return {"kind": "table"} | {
        name: [_quantity(row, spec.command_unit) for row in rows]
        for name, rows in spec.table._asdict().items()
    }


def _entries(entries: Mapping[str, Entry]) -> Tree:
    out: Tree = {}
    for name, entry in entries.items():
        start = _quantity(entry.start, entry.unit, entry.tolerance)
        if entry.range is None:
            out[name] = start
            continue
        ends = [_quantity(end, entry.unit) for end in entry.range]
        out[name] = _inline({"start": start, "range": ends})
    return out


def _channels(spec: RigFile) -> Tree:
    return {
        name: _inline({k: v for k, v in channel.model_dump().items() if v is not None})
        for name, channel in spec.channels.items()
    }


def _controller(spec: RigFile) -> Tree:
    out: Tree = {}
    for name, ends in file_keys(spec).items():
        unit = si(key_unit(name, spec))
        lower, upper = (_quantity(end, unit) for end in ends)
        out[name] = [lower, upper] if KEYS[name].pair else lower
    kept = spec.controller if kind_of(spec) not in LAWS else {}
    own = {k: v for k, v in spec.controller.items() if k == KIND or k in kept}
    return own | out


def _inline(content: Mapping[str, Any]) -> Any:
    table = tomlkit.inline_table()
    table.update(content)
    return table
