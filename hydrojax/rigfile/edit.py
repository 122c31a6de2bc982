"""A rig file with new values in it: comments, order and all else as they were."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import tomlkit
from tomlkit.items import InlineTable, Table

from hydrojax import units
from hydrojax.effects import EFFECTS
from hydrojax.effects.fluid import PressureCompensation
from hydrojax.parameters import Spec, specs
from hydrojax.rigfile.plain import text
from hydrojax.rigfile.schema import LOGS, RigFile
from hydrojax.rigfile.sections import LOAD_PARAMETERS, Entry
from hydrojax.rigfile.valve import MARGIN

Values = Mapping[str, float]


def rewrite(
    spec: RigFile,
    values: Values,
    added: Sequence[str] = (),
    controller: Mapping[str, object] | None = None,
    name: str = "",
) -> str:
    """The text of a rig file in which some values are replaced.

    A parameter that has a range keeps it, so that the file can be fitted again; where
    the new value lies outside, the range is widened to hold it. The stretch over which
    profiles are laid (`build.over_travel`) is written where an effect has one.

    Args:
        spec: the file, as `RigFile.load` read it.
        values: by name (`beta`, `valve_lag.tau`), SI; those the file gives are
            replaced, and those of effects in `added` are written with their ranges, as
            are those that its own effects leave out, where not at their default.
        added: effects that the file does not declare.
        controller: keys of [controller] to set, as a rig file writes them.
        name: a new name for the rig, if any.
    """
    document = tomlkit.parse(spec.text)
    if name:
        document["name"] = name
    for section, fields, known in _tables(document, spec):
        prefix = f"{section}." if section else ""
        for key in list(fields):
            if key == LOGS and EFFECTS[section].of_the_logger:
                continue
            field, turned = _field(key, known)
            old = (spec.effects[section] if section else spec.parameters)[field]
            value = values.get(prefix + field, old.start)
            # What did not change stays as it was written.
            if value != old.start and not (turned and value == 0):
                _set(fields, key, value, known[field], turned, spec.command_unit)
        for field, s in known.items() if section else ():
            value = values.get(prefix + field, s.default)
            if field not in spec.effects[section] and value != s.default:
                fields[field] = _entry(value, s, spec.command_unit)
    _rewrite_margin(document, spec, values)
    for key, old in spec.output_load.items():
        value = values.get(f"load.{key}", old)
        if value != old:
            known = LOAD_PARAMETERS[key]
            _set(document["load"], key, value, known, False, spec.command_unit)
    if added:
        _declare(document, spec, values, added)
    laid = [EFFECTS[e].__dataclass_fields__ for e in (*spec.effects, *added)]
    if "x_from" in spec.geometry and any("x_from" in fields for fields in laid):
        geometry = document.setdefault("geometry", tomlkit.table())
        for key in ("x_from", "x_to"):
            geometry.setdefault(key, text(spec.geometry[key], "m"))
    if controller:
        table = document.setdefault("controller", tomlkit.table())
        for key, value in controller.items():
            table[key] = value
    return tomlkit.dumps(document)


def _declare(
    document: tomlkit.TOMLDocument,
    spec: RigFile,
    values: Mapping[str, float],
    added: Sequence[str],
) -> None:
    """Write effects that the file does not declare into a rig file's document."""
    effects = document.setdefault("effects", tomlkit.table(is_super_table=True))
    for effect in added:
        effects[effect] = _effect(effect, values, spec.command_unit)
        if spec.filtered and EFFECTS[effect].of_the_logger:
            effects[effect][LOGS] = list(spec.filtered)


def with_lines(content: str, lines: Mapping[str, Mapping[str, object]]) -> str:
    """A rig file's text in which some lines are written, or written anew.

    Args:
        content: the text.
        lines: by section and key; a value that is a mapping is written inline.
    """
    document = tomlkit.parse(content)
    for section, entries in lines.items():
        table = document.setdefault(section, tomlkit.table())
        for key, value in entries.items():
            if isinstance(value, Mapping):
                inline = tomlkit.inline_table()
                inline.update(value)
                value = inline
            table[key] = value
    return tomlkit.dumps(document)


def identified(spec: RigFile, values: dict[str, float]) -> RigFile:
    """The rig file with its own parameters, and its effects', at identified values."""
    base = dict(spec.parameters)
    effects = {name: dict(given) for name, given in spec.effects.items()}
    for name, value in values.items():
        effect, _, field = name.rpartition(".")
        if effect and effect not in effects:
            continue
        table = effects[effect] if effect else base
        old = table.get(field)
        table[field] = Entry(value, None, old.unit if old else "")
    return replace(spec, parameters=base, effects=effects)


def _tables(document, spec: RigFile):
    """(effect or "", its table, what is known of its parameters) of a document."""
    if "parameters" in document:
        yield "", document["parameters"], spec.base
    for effect in spec.effects:
        if effect in document.get("effects", {}):
            yield effect, document["effects"][effect], specs(EFFECTS[effect])


def _rewrite_margin(document, spec: RigFile, values: Values) -> None:
    """The margin of a valve that [valve] calls compensated."""
    name, known = PressureCompensation.name, specs(PressureCompensation)[MARGIN]
    if name not in spec.effects or name in document.get("effects", {}):
        return
    given, valve = spec.effects[name].get(MARGIN), document["valve"]
    old = given.start if given else known.default
    value = values.get(f"{name}.{MARGIN}", old)
    if value == old:
        return
    if given:
        _set(valve, "margin", value, known, False, spec.command_unit)
    else:
        valve["margin"] = _entry(value, known, spec.command_unit)


def _field(key: str, known: Mapping[str, Spec]) -> tuple[str, bool]:
    """A key's field, and whether the file gives its reciprocal."""
    for field, s in known.items():
        if s.outside and s.outside[0] == key and key not in known:
            return field, True
    return key, False


def _shown(s: Spec, turned: bool, command: str) -> str:
    unit = s.outside[1] if turned and s.outside else s.unit
    return units.with_command(unit, command)


def _set(
    fields: Table, key: str, value: float, s: Spec, turned: bool, command: str
) -> None:
    unit = _shown(s, turned, command)
    shown = 1 / value if turned else value
    old = fields[key]
    if not isinstance(old, (dict, Table, InlineTable)):
        fields[key] = text(shown, unit)
        return
    old["start"] = text(shown, unit)
    shown = units.quantity(old["start"], unit, key)  # as it will be read
    ends = [units.quantity(end, unit, key) for end in old["range"]]
    if not ends[0] <= shown <= ends[1]:
        old["range"] = [
            text(end, unit) for end in (min(ends[0], shown), max(ends[1], shown))
        ]


def _effect(name: str, values: Values, command: str) -> Table:
    """A table of an effect: each parameter with the range its declaration gives."""
    table = tomlkit.table()
    for field, s in specs(EFFECTS[name]).items():
        value = values.get(f"{name}.{field}", s.default)
        table[field] = _entry(value, s, command)
    table.add(tomlkit.nl())
    return table


def _entry(value: float, s: Spec, command: str) -> InlineTable:
    """A parameter with the range its declaration gives."""
    entry = tomlkit.inline_table()
    unit = _shown(s, False, command)
    entry["start"] = text(min(max(value, s.lower), s.upper), unit)
    entry["range"] = [text(end, unit) for end in (s.lower, s.upper)]
    return entry
