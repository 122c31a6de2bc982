"""The rig file: TOML or a dict in, checked plain data in SI out."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath
from typing import Any

from hydrojax import units
from hydrojax.control.base import AbstractController
from hydrojax.effects import EFFECTS
from hydrojax.errors import TEXT, WORD, InputError, check_known, file_text, one_line
from hydrojax.logs.tables import SIGNALS, Channel
from hydrojax.parameters import Spec
from hydrojax.plant.layout import LAYOUTS, Layout
from hydrojax.plant.valve import AbstractValve, NoValve
from hydrojax.rigfile import valve as valves
from hydrojax.rigfile.plain import to_text
from hydrojax.rigfile.sections import (
    GEOMETRY,
    LANDS,
    LOAD,
    LOAD_PARAMETERS,
    PREDICTED,
    SUPPLY,
    SUPPLY_UNITS,
    ControllerValue,
    Entry,
    Given,
    base_specs,
    effect_specs,
    entry,
    givens,
    read_sections,
    section_values,
    unit_of_command,
)

PART = ", "
"""Stands between a log's name and which part of it a log is."""


@dataclass(frozen=True)
class RigFile:
    """A rig file, checked, in SI; only what the file gives, no defaults.

    Attributes:
        name: the rig's, or the file's if it gives none.
        layout: one of `hydrojax.plant.layout.LAYOUTS`.
        geometry: area, area_1, area_2 in m^2, chamber_length, radius, x_mid in m;
            x_from and x_to in m, between which profiles along the stroke are laid.
        supply: P_s, P_r in Pa, for logs without these channels.
        sensors: standard deviation of the noise, by signal.
        output_load: the section [load]: F in N, if the load is known without a sensor;
            for closed-loop runs and a predicted motion mass, stiffness and damping (kg,
            N/m, N s/m) of an inertia on the output, and of a second one behind it.
        load_ranges: of those that are to be found from the motion, SI.
        predicts: "x" where the load is to move by itself, and its position is
            predicted; "" where the log's motion is given.
        channels: where signals are in the logs, by the contract's names.
        parameters: the base model's, by name.
        effects: those declared, with the parameters given, by name.
        controller: as written; `hydrojax.rigfile.controller` reads it.
        valve: a valve in place of the paper's four metering edges; [parameters] then
            holds its parameters in place of theirs.
        law: a controller in place of the paper's law, with gains of its own; of
            [controller] its loop has the rate and the resolution.
        command_unit: the valve command's, "V" or "1", as the constants imply; "V" if
            none is given.
        path: the file; what opens the line of an error.
        tolerances: standard deviations with which geometry and supply are known, by
            key, SI; those of parameters are in their entries.
        filtered: names of the logs that passed the logger's filter, where there is one
            (`signal_filter`); all of them where none is named.
        table: how far the edges open at each command, where [valve] has a table; of a
            compensated valve there is `pressure_compensation` among the effects.
        text: the TOML that all of this was read from.
    """

    name: str
    layout: Layout
    geometry: dict[str, float]
    supply: dict[str, float]
    sensors: dict[str, float]
    output_load: dict[str, float]
    channels: dict[str, Channel]
    parameters: dict[str, Entry]
    effects: dict[str, dict[str, Entry]]
    controller: dict[str, ControllerValue]
    command_unit: str
    path: str
    law: AbstractController | None = None
    valve: AbstractValve | None = None
    tolerances: dict[str, float] = field(default_factory=dict)
    predicts: str = ""
    load_ranges: dict[str, tuple[float, float]] = field(default_factory=dict)
    filtered: tuple[str, ...] = ()
    table: valves.Table | None = None
    text: str = field(default="", repr=False, compare=False)

    @classmethod
    def load(cls, path: str | Path, valve: AbstractValve | None = None) -> RigFile:
        """Read a rig file (TOML) and check all that can be checked without a log.

        Effects that installed packages offer are known, and those of files that
        `effects.load_effects` has read.

        Args:
            path: the TOML file.
            valve: as `from_text` has it.

        Raises:
            InputError: the file cannot be read, or see `from_text`.
        """
        if not isinstance(path, (str, os.PathLike)):
            raise InputError(f"a rig file is named by its path, not by {path!r:.40}")
        text = file_text(Path(path), TEXT, "a rig file is a small file of text")
        return cls.from_text(text, str(path), valve)

    @classmethod
    def from_text(
        cls, text: str, path: str = "rig", valve: AbstractValve | None = None
    ) -> RigFile:
        """A rig file from its text.

        Args:
            text: the TOML.
            path: what opens the line of an error; the rig's name if the text has none.
            valve: a valve in place of the paper's four metering edges. [parameters]
                then takes its parameters; those not given are as in this instance.

        Raises:
            InputError: no TOML; an unknown section, key, parameter, effect, signal or
                layout; a missing or wrong unit; a range upside down, or one that leaves
                out the start; a length, area, pressure or noise that cannot be;
                geometry that the layout needs; commands in V here and dimensionless
                there; a section [valve] beside a valve of one's own.
        """
        file = read_rig(text, path, base_specs(valve), effect_specs())
        if valve is not None and "valve" in tomllib.loads(text):
            raise InputError(
                f"{path}: [valve] is of metering edges, not of {type(valve).__name__}; "
                "delete the section"
            )
        return replace(file, valve=valve)

    def with_text(self, text: str) -> RigFile:
        """The rig of another text, with this one's path, valve and controller.

        Raises:
            InputError: see `from_text`.
        """
        return replace(RigFile.from_text(text, self.path, self.valve), law=self.law)

    @classmethod
    def from_dict(
        cls,
        tree: Mapping[str, Any],
        path: str = "rig",
        valve: AbstractValve | None = None,
    ) -> RigFile:
        """A rig file from nested dicts with the keys of the TOML.

        Args:
            tree: a quantity is text ("60 um"), a pint quantity, or a number in the SI
                unit in which it is declared (per volt where it depends on the unit of
                the valve command); in [controller] a number is in the paper's unit.
            path: as `from_text` has it.
            valve: as `from_text` has it.

        Raises:
            InputError: see `from_text`.
        """
        if not isinstance(tree, Mapping):
            raise InputError(f"{path}: {tree!r:.40} is no dict of sections")
        text = to_text(tree, base_specs(valve), effect_specs())
        return cls.from_text(text, path, valve)

    @classmethod
    def from_log(
        cls,
        *logs: str | Path,
        layout: str = "",
        columns: Mapping[str, str] | None = None,
        name: str = "",
        **sizes: units.QuantityLike,
    ) -> RigFile:
        """A commented rig file, drafted from what logs hold; `text` has the comments.

        Args:
            logs: paths of tables, of one rig and one logger.
            layout: one of `LAYOUTS`; guessed from columns and rod without it.
            columns: by signal, where the names do not tell.
            name: of the rig; the first log's without it.
            sizes: `bore`, `rod`, `stroke`, `radius` (where an angle is logged),
                `rated_flow` (of the open valve, at 35 bar over each edge) and `supply`
                (where no pressure of it is logged), each with its unit.

        Raises:
            InputError: a size is missing or invalid, or see `Log.load`.
        """
        from hydrojax.rigfile.draft.sizes import read_sizes
        from hydrojax.rigfile.draft.write import drafted, read_log

        if not logs:
            raise InputError("from_log: no log; name at least one")
        found = read_log(logs, columns or {}, layout, read_sizes(**sizes))
        own, text = drafted(found, name)
        return cls.from_text(text, own)

    def save(self, path: str | Path) -> None:
        """Write the text that this was read from, UTF-8.

        For a file with other values see `hydrojax.rigfile.edit.rewrite`.
        """
        Path(path).write_text(self.text, encoding="utf-8")

    @property
    def base(self) -> dict[str, Spec]:
        """What [parameters] may hold: the base model's parameters, by name."""
        return base_specs(self.valve if self.layout.has_valve else NoValve())

    def passes_filter(self, log: str) -> bool:
        """Whether a log passed the logger's filter, if there is one, by its name."""
        return not self.filtered or bool(self.names_of(log) & set(self.filtered))

    @staticmethod
    def names_of(log: str) -> set[str]:
        """By what names the rig file may call a log: its own, and of a part of a log
        that of the whole, which stands ahead of a comma and which part it is.
        """
        return {log, log.rpartition(PART)[0]}

    @property
    def line(self) -> dict[str, float]:
        """P_s and P_r, Pa: the file's, or `SUPPLY` where it has none."""
        return SUPPLY | self.supply

    @property
    def stroke(self) -> tuple[float, float]:
        """Between which positions profiles along the stroke are laid, m; 0 is mid.

        `x_from` and `x_to` of [geometry]; without them half a chamber's length to
        either side.
        """
        half = self.geometry.get("chamber_length", 1.0) / 2
        return self.geometry.get("x_from", -half), self.geometry.get("x_to", half)


def read_rig(
    text: str,
    path: str,
    parameters: Mapping[str, Spec],
    effects: Mapping[str, Mapping[str, Spec]],
) -> RigFile:
    """Read a rig file's text; `RigFile.load` and `.from_text` do so with what is known.

    A parameter whose `Spec.outside` is set may be given under that name, as the
    reciprocal, or under its own; the entry has its own name and quantity.

    Args:
        text: the TOML.
        path: what opens the line of an error.
        parameters: what the base model knows, by name.
        effects: what each effect knows, by the effect's name.

    Raises:
        InputError: see `RigFile.from_text`.
    """
    file = read_sections(path, text)
    _check_channels(path, file.channels)
    check_known(f"{path}: [effects]", file.effects, effects, "effect")
    layout = LAYOUTS[file.layout]
    filtered, added = _effects(path, file.effects, effects)
    base = _base(f"{path}: [parameters]", file.parameters, parameters, layout)
    kind = valves.check_valve(path, file.valve, layout)
    if kind == "compensated":
        added |= valves.compensation(path, file.valve, file.effects)
    command = unit_of_command([*base, *(g for gs in added.values() for g in gs)])
    sensed = _sensor_units(command)
    geometry, own = _with_tolerances(f"{path}: [geometry]", file.geometry, GEOMETRY)
    load, load_ranges = _load(f"{path}: [load]", file.load)
    supply, also = _with_tolerances(f"{path}: [supply]", file.supply, SUPPLY_UNITS)
    spec = RigFile(
        name=file.name or one_line(Path(path).stem, WORD),
        layout=layout,
        geometry=geometry,
        supply=supply,
        sensors=section_values(f"{path}: [sensors]", file.sensors, sensed),
        output_load=load,
        channels=file.channels,
        parameters={g.field: entry(g, command) for g in base},
        effects={
            name: {g.field: entry(g, command) for g in gs} for name, gs in added.items()
        },
        controller=file.controller,
        command_unit=command,
        path=path,
        tolerances=own | also,
        predicts=file.load.get("predicts", ""),
        load_ranges=load_ranges,
        filtered=filtered,
        table=valves.table_of(path, file.valve, command) if kind == "table" else None,
        text=text,
    )
    _check(spec)
    return spec


def _check_channels(path: str, channels: Mapping[str, Channel]) -> None:
    """Refuse a signal that is not known, and one other than u that is not held."""
    check_known(f"{path}: [channels]", channels, SIGNALS, "signal")
    for name, channel in channels.items():
        if name != "u" and not channel.held:
            raise InputError(
                f"{path}: [channels] {name}.held: only the command u may be held from "
                "row to row; delete the key"
            )


LOGS = "logs"
"""Key of an effect of the logger's: the logs that it is in."""


def _effects(
    path: str,
    effects: Mapping[str, Mapping[str, Any]],
    known: Mapping[str, Mapping[str, Spec]],
) -> tuple[tuple[str, ...], dict[str, list[Given]]]:
    """The logs that the logger's effects are in, and what is given of every effect.

    Raises:
        InputError: no list of names; or see `givens`.
    """
    names: tuple[str, ...] = ()
    tables = {name: dict(table) for name, table in effects.items()}
    for name, table in tables.items():
        if LOGS not in table or not EFFECTS[name].of_the_logger:
            continue
        given = table.pop(LOGS)
        listed = isinstance(given, list) and given
        if not listed or not all(isinstance(n, str) and n for n in given):
            raise InputError(
                f"{path}: [effects.{name}] {LOGS} is no list of logs' names; write "
                f'{LOGS} = ["log_1.csv"], or delete the line if it is in all of them'
            )
        names += tuple(PurePath(n).name for n in given)
    return names, {
        name: givens(f"{path}: [effects.{name}]", table, known[name])
        for name, table in tables.items()
    }


def _base(
    where: str, table: Mapping[str, Any], known: Mapping[str, Spec], layout: Layout
) -> list[Given]:
    """What is given of the base model; no lands where there is no valve."""
    base = givens(where, table, known)
    if unused := [g for g in base if not layout.has_valve and g.field in LANDS]:
        raise InputError(
            f"{unused[0].where}: layout {layout.name!r} has no valve; delete the line"
        )
    return base


def _load(
    where: str, table: Mapping[str, Any]
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """What [load] gives, and the ranges of what is to be found, SI.

    Raises:
        InputError: no quantity, a wrong unit, a range that cannot be, or one of F.
    """
    check_known(where, table, (*LOAD, "predicts"), "key")
    given = {key: value for key, value in table.items() if key != "predicts"}
    ranged = {key: v for key, v in given.items() if isinstance(v, dict)}
    if "F" in ranged:
        raise InputError(f'{where} F is known: give it no range; write F = "0 N"')
    plain = {key: v for key, v in given.items() if key not in ranged}
    values, ranges = section_values(where, plain, LOAD), {}
    for found in givens(where, ranged, LOAD_PARAMETERS):
        own = entry(found, "V")
        values[found.field] = own.start
        if own.range is not None:
            ranges[found.field] = own.range
    return values, ranges


def _sensor_units(command: str) -> dict[str, str]:
    """Unit of each signal's noise, where the command has the unit `command`."""
    known = (name for name in SIGNALS if name != "time")
    return {name: units.with_command(SIGNALS[name], command) for name in known}


def _with_tolerances(
    where: str, given: Mapping[str, object], wants: Mapping[str, str]
) -> tuple[dict[str, float], dict[str, float]]:
    """As `section_values`, and the tolerances of those that have one, SI.

    Raises:
        InputError: see `section_values`; or a tolerance that is not above 0.
    """
    parts = {key: units.parted(text) for key, text in given.items()}
    values = section_values(where, {k: p[0] for k, p in parts.items()}, wants)
    found = {
        key: units.tolerance(written, values[key], wants[key], f"{where} {key}")
        for key, (_, written) in parts.items()
    }
    return values, {key: t for key, t in found.items() if t}


def _check(spec: RigFile) -> None:
    """Refuse what no rig can have, and geometry that the layout lacks."""
    for key in spec.layout.geometry:
        if key not in spec.geometry:
            raise InputError(
                f"{spec.path}: [geometry] {key} is missing, which layout "
                f'{spec.layout.name!r} needs; add {key} = "... {GEOMETRY[key]}"'
            )
    positive = {"geometry": spec.geometry, "sensors": spec.sensors}
    for section, values in positive.items():
        for key, value in values.items():
            if value <= 0.0 and key not in ("x_mid", "x_from", "x_to"):
                raise InputError(
                    f"{spec.path}: [{section}] {key} must be above 0, not {value:g}"
                )
    lower = {f"{key} range": ends[0] for key, ends in spec.load_ranges.items()}
    least = {"supply": spec.supply, "load": spec.output_load | lower}
    for section, values in least.items():
        for key, value in values.items():
            heavy = key.partition(" ")[0] in ("mass", "second_mass")
            if value < 0.0 and key != "F" or (heavy and value == 0.0):
                raise InputError(
                    f"{spec.path}: [{section}] {key} must be "
                    f"{'above' if heavy else 'at least'} 0, not {value:g}; correct it"
                )
    _check_load(spec)
    _check_predicted(spec)
    ends = [spec.geometry[key] for key in ("x_from", "x_to") if key in spec.geometry]
    if len(ends) == 1 or (ends and ends[0] >= ends[1]):
        raise InputError(
            f"{spec.path}: [geometry] x_from and x_to are the ends of a stretch, the "
            "lower first; give both or neither"
        )
    P_s, P_r = (spec.supply.get(key) for key in ("P_s", "P_r"))
    if P_s is not None and P_s <= (P_r or 0.0):
        raise InputError(
            f"{spec.path}: [supply] P_s must be above P_r; exchange or correct them"
        )


def _check_load(spec: RigFile) -> None:
    """Refuse a second mass without what carries it, and ranges that nothing fits."""
    given = spec.output_load
    second = [key for key in given if key.startswith("second_")]
    needs = ("second_mass", "second_stiffness", "mass")
    if second and (lacking := [key for key in needs if key not in given]):
        raise InputError(
            f"{spec.path}: [load] {second[0]} needs {lacking[0]} beside it; add "
            f'{lacking[0]} = "... {LOAD[lacking[0]]}"'
        )
    if spec.load_ranges and not spec.predicts:
        key = next(iter(spec.load_ranges))
        raise InputError(
            f"{spec.path}: [load] {key} has a range, but only a predicted motion can "
            f'find it; add predicts = "{PREDICTED[0]}", or give {key} one value'
        )


def _check_predicted(spec: RigFile) -> None:
    """Refuse a motion to predict that cannot be."""
    if spec.predicts not in ("", *PREDICTED):
        raise InputError(
            f"{spec.path}: [load] predicts: invalid {units.shown(spec.predicts)}: "
            f'expected "{PREDICTED[0]}", or delete the line'
        )
    if spec.predicts and not spec.layout.driven:
        raise InputError(
            f"{spec.path}: [load] predicts: a {spec.layout.name} has no drive that "
            "could move it; delete the line"
        )
    if not spec.layout.driven and "F" in spec.output_load:
        raise InputError(
            f"{spec.path}: [load] F: a {spec.layout.name} measures F; delete the line"
        )
    if spec.predicts and spec.output_load.get("F", 0.0) != 0.0:
        raise InputError(
            f"{spec.path}: [load] F must be 0 N where predicts is given: a load that "
            "moves by itself takes a constant force from k_0 or gravity_load"
        )
