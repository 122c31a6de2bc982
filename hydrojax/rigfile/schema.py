"""The rig file: TOML in, checked plain data in SI out."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, NoReturn

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from hydrojax import units
from hydrojax.errors import InputError
from hydrojax.logs.signals import SIGNALS, Channel
from hydrojax.parameters import Spec
from hydrojax.plant.layout import LAYOUTS, Layout

ControllerValue = str | int | float | list[str | int | float]
"""A quantity, a number in the paper's unit, or two bounds of either."""

GEOMETRY = {
    "area": "m^2", "area_1": "m^2", "area_2": "m^2",
    "chamber_length": "m", "radius": "m", "x_mid": "m",
    "x_from": "m", "x_to": "m",
}  # fmt: skip
"""What [geometry] may hold, and the SI unit."""

_SUPPLY = {"P_s": "Pa", "P_r": "Pa"}
SUPPLY = {"P_s": 14e6, "P_r": 0.25e6}
"""Supply and return pressure (Pa) where neither log nor rig file has them."""

LOAD = {"F": "N", "mass": "kg", "stiffness": "N/m", "damping": "N*s/m"}
"""What [load] may hold, and the SI unit."""


@dataclass(frozen=True)
class Entry:
    """One parameter as the file gives it, in the SI unit its model stores.

    Attributes:
        start: where the search starts, or the value held.
        range: the range it may take; None: held fixed at `start`.
        unit: SI unit of both.
    """

    start: float
    range: tuple[float, float] | None
    unit: str


@dataclass(frozen=True)
class RigFile:
    """A rig file, checked, in SI; only what the file says, no defaults.

    Attributes:
        name: the rig's, or the file's if it gives none.
        layout: one of `hydrojax.plant.layout.LAYOUTS`.
        geometry: area, area_1, area_2 in m^2, chamber_length, radius, x_mid in m;
            x_from and x_to in m, between which profiles along the stroke are laid.
        supply: P_s, P_r in Pa, for logs without these channels.
        sensors: standard deviation of the noise, by signal.
        load: F in N, if the load is known without a sensor; for closed-loop runs mass,
            stiffness and damping (kg, N/m, N s/m) of an inertia on the output.
        channels: where signals are in the logs, by the contract's names.
        parameters: the base model's, by name.
        effects: those declared, with the parameters given, by name.
        controller: as written; `hydrojax.rigfile.controller` reads it.
        command_unit: the valve command's, "V" or "1", as the constants imply; "V" if
            none is given.
        path: the file.
    """

    name: str
    layout: Layout
    geometry: dict[str, float]
    supply: dict[str, float]
    sensors: dict[str, float]
    load: dict[str, float]
    channels: dict[str, Channel]
    parameters: dict[str, Entry]
    effects: dict[str, dict[str, Entry]]
    controller: dict[str, ControllerValue]
    command_unit: str
    path: str

    @property
    def line(self) -> dict[str, float]:
        """P_s and P_r, Pa: the file's, or `SUPPLY` where it has none."""
        return SUPPLY | self.supply


def _known_layout(name: str) -> str:
    if name not in LAYOUTS:
        raise ValueError(f"unknown layout {name!r}")
    return name


class _Sections(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    name: str = ""
    layout: Annotated[str, AfterValidator(_known_layout)]
    geometry: dict[str, Any] = {}
    supply: dict[str, Any] = {}
    sensors: dict[str, Any] = {}
    load: dict[str, Any] = {}
    channels: dict[str, Channel] = {}
    parameters: dict[str, Any] = {}
    effects: dict[str, dict[str, Any]] = {}
    controller: dict[str, ControllerValue] = {}


@dataclass(frozen=True)
class _Given:
    """A parameter as written, beside what is known of it."""

    where: str
    field: str
    spec: Spec
    start: object
    range: tuple[object, object] | None
    reciprocal: bool  # given under `spec.outside`


def read_rig(
    path: str | Path,
    parameters: Mapping[str, Spec],
    effects: Mapping[str, Mapping[str, Spec]],
) -> RigFile:
    """Read a rig file and check all that can be checked without a log.

    A parameter whose `Spec.outside` is set may be given under that name, as the
    reciprocal, or under its own; the entry has its own name and quantity.

    Args:
        path: the TOML file.
        parameters: what the base model knows, by name.
        effects: what each effect knows, by the effect's name.

    Raises:
        InputError: no TOML; an unknown section, key, parameter, effect, signal or
            layout; a missing or wrong unit; a range upside down, or one that leaves
            out the start; a length, area, pressure or noise that cannot be; geometry
            that the layout needs; commands in V here and dimensionless there.
    """
    path = Path(path)
    file = _sections(path)
    _known(f"{path}: [channels]", file.channels, SIGNALS, "signal")
    _known(f"{path}: [effects]", file.effects, effects, "effect")
    base = _givens(f"{path}: [parameters]", file.parameters, parameters)
    added = {
        name: _givens(f"{path}: [effects.{name}]", table, effects[name])
        for name, table in file.effects.items()
    }
    command = _command_unit([*base, *(g for gs in added.values() for g in gs)])
    noise_units = {
        name: units.with_command(unit, command)
        for name, unit in SIGNALS.items()
        if name != "time"
    }
    spec = RigFile(
        name=file.name or path.stem,
        layout=LAYOUTS[file.layout],
        geometry=_quantities(f"{path}: [geometry]", file.geometry, GEOMETRY),
        supply=_quantities(f"{path}: [supply]", file.supply, _SUPPLY),
        sensors=_quantities(f"{path}: [sensors]", file.sensors, noise_units),
        load=_quantities(f"{path}: [load]", file.load, LOAD),
        channels=file.channels,
        parameters={g.field: _entry(g, command) for g in base},
        effects={
            name: {g.field: _entry(g, command) for g in gs}
            for name, gs in added.items()
        },
        controller=file.controller,
        command_unit=command,
        path=str(path),
    )
    _check(spec)
    return spec


def _sections(path: Path) -> _Sections:
    """The file's sections, of the right shape; the quantities still as written."""
    try:
        tree = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as err:
        raise InputError(f"{path}: cannot be read; check the path") from err
    except ValueError as err:  # not TOML, or not even text
        detail = " ".join(str(err).split())
        raise InputError(f"{path}: not TOML: {detail}; mend that line") from err
    _known(f"{path}:", tree, _Sections.model_fields, "key or section")
    try:
        return _Sections.model_validate(tree)
    except ValidationError as err:
        _refuse(path, tree, err)


def _refuse(path: Path, tree: Mapping[str, Any], error: ValidationError) -> NoReturn:
    """Say the first of pydantic's complaints in one line of ours."""
    first = error.errors()[0]
    keys = [str(key) for key in first["loc"]]
    where = f"{path}: [{keys[0]}]" if len(keys) > 1 else f"{path}:"
    if keys == ["layout"]:
        layouts = tuple(LAYOUTS)
        given = tree.get("layout")
        said = "is missing" if given is None else f"{given!r} is unknown"
        near = get_close_matches(str(given), layouts, n=1)
        mend = f"did you mean {near[0]!r}?" if near else f"write one of {layouts}"
        raise InputError(f"{where} layout {said}; {mend}") from None
    if keys[0] == "channels" and len(keys) == 3:
        if first["type"] == "extra_forbidden":
            _known(f"{where} {keys[1]}", [keys[2]], Channel.model_fields, "key")
        if first["type"] == "missing":
            raise InputError(
                f"{where} {keys[1]} names no column; write {keys[1]} = "
                '{ column = "..." }'
            ) from None
    shapes = {
        "dict_type": "a table of its own",
        "model_type": 'a table such as { column = "..." }',
        "bool_type": "true or false",
    }
    shape = shapes.get(first["type"], "text in quotes")
    key = ".".join(keys[1:3] if keys[0] == "channels" else keys[1:2] or keys)
    raise InputError(
        f"{where} {key}: {first['input']!r} will not do; write {shape}"
    ) from None


def _known(where: str, given: Iterable[str], known: Iterable[str], what: str) -> None:
    """Refuse the first name that is not known, and suggest the nearest."""
    known = list(known)
    for name in given:
        if name not in known:
            near = get_close_matches(name, known, n=1, cutoff=0.5)
            mend = f"did you mean {near[0]!r}?" if near else f"known: {known}"
            raise InputError(f"{where} unknown {what} {name!r}; {mend}")


def _quantities(
    where: str, given: Mapping[str, object], wants: Mapping[str, str]
) -> dict[str, float]:
    _known(where, given, wants, "key")
    return {
        key: units.quantity(text, wants[key], f"{where} {key}")
        for key, text in given.items()
    }


def _givens(
    where: str, table: Mapping[str, Any], specs: Mapping[str, Spec]
) -> list[_Given]:
    """The parameters of one table, under the names that the models use."""
    outside = {s.outside[0]: field for field, s in specs.items() if s.outside}
    shown = [s.outside[0] if s.outside else field for field, s in specs.items()]
    _known(where, [k for k in table if k not in specs], shown, "parameter")
    givens: list[_Given] = []
    for key, value in table.items():
        field, start, bounds = outside.get(key, key), value, None
        if any(given.field == field for given in givens):
            raise InputError(f"{where} {key} gives {field} a second time; drop one")
        if isinstance(value, dict):
            _known(f"{where} {key}", value, ("start", "range"), "key")
            start, ends = value.get("start"), value.get("range")
            if start is None or not isinstance(ends, list) or len(ends) != 2:
                raise InputError(
                    f"{where} {key} needs a start and a range of two; write {key} = "
                    '{ start = "...", range = ["...", "..."] }'
                )
            bounds = (ends[0], ends[1])
        reciprocal = key in outside and key not in specs
        givens.append(
            _Given(f"{where} {key}", field, specs[field], start, bounds, reciprocal)
        )
    return givens


def _command_unit(givens: Iterable[_Given]) -> str:
    """The command's unit, V or 1, that all the constants agree on."""
    found: tuple[str, str] | None = None
    for given in givens:
        want = _file_unit(given)
        if "{u}" not in want:
            continue
        written = units.split(given.start, given.where)[1] or "1"
        wants = {u: units.with_command(want, u) for u in ("V", "1")}
        fitting = [u for u in wants if units.fits(written, wants[u])]
        if not fitting:
            continue  # a wrong unit, which `_entry` refuses
        if found and found[0] not in fitting:
            raise InputError(
                f"{given.where} takes the command in {fitting[0]}, {found[1]} in "
                f"{found[0]}; give all of them for a command in V, or all for 1"
            )
        found = found or (fitting[0], given.field)
    return found[0] if found else "V"


def _file_unit(given: _Given) -> str:
    outside = given.spec.outside
    return outside[1] if given.reciprocal and outside else given.spec.unit


def _entry(given: _Given, command: str) -> Entry:
    want = units.with_command(_file_unit(given), command)
    texts = {"start": given.start}
    if given.range is not None:
        texts |= {"range": given.range[0], "range's end": given.range[1]}
    values = []
    for key, text in texts.items():
        where = f"{given.where} {key}" if given.range else given.where
        value = units.quantity(text, want, where)
        if given.reciprocal and value <= 0.0:
            raise InputError(f"{where}: {text!r} must be above 0; give a larger one")
        values.append(value)
    unit = units.with_command(given.spec.unit, command)
    if given.range is None:
        start = 1.0 / values[0] if given.reciprocal else values[0]
        return Entry(start, None, unit)
    start, lower, upper = values
    if not lower < upper:
        raise InputError(
            f"{given.where} range {list(given.range)} is upside down or empty; put the "
            "smaller first, or give a plain quantity to hold it fixed"
        )
    if not lower <= start <= upper:
        raise InputError(
            f"{given.where} start {given.start!r} is outside its range "
            f"{list(given.range)}; widen the range or move the start"
        )
    if given.reciprocal:
        start, lower, upper = 1.0 / start, 1.0 / upper, 1.0 / lower
    return Entry(start, (lower, upper), unit)


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
                    f"{spec.path}: [{section}] {key} must be above 0, not {value:g}; "
                    "mend it"
                )
    ends = [spec.geometry[key] for key in ("x_from", "x_to") if key in spec.geometry]
    if len(ends) == 1 or (ends and ends[0] >= ends[1]):
        raise InputError(
            f"{spec.path}: [geometry] x_from and x_to are the ends of a stretch, the "
            "lower first; give both or neither"
        )
    P_s, P_r = (spec.supply.get(key) for key in ("P_s", "P_r"))
    if P_s is not None and P_s <= (P_r or 0.0):
        raise InputError(
            f"{spec.path}: [supply] P_s must be above P_r; exchange or mend them"
        )
