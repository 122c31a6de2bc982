"""The sections of a rig file: what each may hold, and what it gives, checked in SI."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Annotated, Any, NoReturn

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from hydrojax import units
from hydrojax.effects import EFFECTS, offered
from hydrojax.errors import WORD, InputError, check_known, one_line
from hydrojax.logs.tables import LONGEST_DELAY, Channel
from hydrojax.parameters import Spec, specs
from hydrojax.plant.chambers import Chambers
from hydrojax.plant.friction import Friction
from hydrojax.plant.layout import LAYOUTS
from hydrojax.plant.load import TwoMassLoad
from hydrojax.plant.valve import AbstractValve, MeteringEdges

GEOMETRY = {
    "area": "m^2", "area_1": "m^2", "area_2": "m^2",
    "chamber_length": "m", "radius": "m", "x_mid": "m",
    "x_from": "m", "x_to": "m",
}  # fmt: skip
"""What [geometry] may hold, and the SI unit."""

SUPPLY_UNITS = {"P_s": "Pa", "P_r": "Pa"}
"""What [supply] may hold, and the SI unit."""

SUPPLY = {"P_s": 14e6, "P_r": 0.25e6}
"""Supply and return pressure (Pa) where neither log nor rig file has them."""

LOAD_PARAMETERS = specs(TwoMassLoad)
"""What [load] may hold of a load that moves, by name; each may have a range."""

LOAD = {"F": "N"} | {name: s.unit for name, s in LOAD_PARAMETERS.items()}
"""What [load] may hold, and the SI unit; beside it `predicts`."""

PREDICTED = ("x",)
"""What [load] may say it predicts."""

LANDS = tuple(specs(MeteringEdges))
"""The valve constants' names."""

ControllerValue = str | int | float | list[str | int | float]
"""A quantity, a number in the paper's unit, or two bounds of either."""


def _plain_name(name: str) -> str:
    if len(name) > WORD or not name.isprintable():
        raise ValueError("no name")
    return name


def _known_layout(name: str) -> str:
    if name not in LAYOUTS:
        raise ValueError(f"unknown layout {name!r}")
    return name


class Sections(BaseModel):
    """A rig file's sections, each as TOML gives it."""

    model_config = ConfigDict(extra="forbid", strict=True)

    name: Annotated[str, AfterValidator(_plain_name)] = ""
    layout: Annotated[str, AfterValidator(_known_layout)]
    geometry: dict[str, Any] = {}
    supply: dict[str, Any] = {}
    valve: dict[str, Any] = {}
    sensors: dict[str, Any] = {}
    load: dict[str, Any] = {}
    channels: dict[str, Channel] = {}
    parameters: dict[str, Any] = {}
    effects: dict[str, dict[str, Any]] = {}
    controller: dict[str, ControllerValue] = {}


def read_sections(path: str, text: str) -> Sections:
    """The sections of a rig file's text, of the right shape; quantities as written.

    Raises:
        InputError: no TOML, or not of that shape; `path` opens the line.
    """
    try:
        tree = tomllib.loads(text)
    except ValueError as err:
        detail = one_line(" ".join(str(err).split()), WORD)
        raise InputError(f"{path}: not TOML: {detail}; correct that line") from err
    except RecursionError as err:
        raise InputError(
            f"{path}: not a rig file: lists are nested too deeply; delete them"
        ) from err
    check_known(f"{path}:", tree, Sections.model_fields, "key or section")
    try:
        return Sections.model_validate(tree)
    except ValidationError as err:
        _refuse(path, tree, err)


A_FACTOR = "a positive number"
"""What a scale of [channels] is to be."""


def _refuse(path: str, tree: Mapping[str, Any], error: ValidationError) -> NoReturn:
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
            check_known(f"{where} {keys[1]}", [keys[2]], Channel.model_fields, "key")
        if first["type"] == "missing":
            own = tree["channels"][keys[1]]
            check_known(f"{where} {keys[1]}", own, Channel.model_fields, "key")
            raise InputError(
                f"{where} {keys[1]} names no column; write {keys[1]} = "
                '{ column = "..." }'
            ) from None
    shapes = {
        "dict_type": "a table of its own",
        "model_type": 'a table such as { column = "..." }',
        "bool_type": "true or false",
        **dict.fromkeys(("float_type", "greater_than", "less_than"), A_FACTOR),
        "delay": f'a time of at most {LONGEST_DELAY:g} s, such as "5 ms"',
        "value_error": f"at most {WORD} characters that can be printed",
    }
    shape = shapes.get(first["type"], "text in quotes")
    key = ".".join(keys[1:3] if keys[0] == "channels" else keys[1:2] or keys)
    raise InputError(
        f"{where} {key}: invalid value {units.shown(first['input'])}: expected {shape}"
    ) from None


def base_specs(valve: AbstractValve | None = None) -> dict[str, Spec]:
    """The base model's parameters, by name: those of valve, chambers and friction.

    Args:
        valve: None for the paper's four metering edges.

    Raises:
        InputError: no valve, or one with a parameter that chambers or friction have.
    """
    if valve is not None and not isinstance(valve, AbstractValve):
        raise InputError(
            f"valve: invalid {valve!r}: expected an instance of an AbstractValve"
        )
    own = specs(MeteringEdges if valve is None else valve)
    rest = {**specs(Chambers), **specs(Friction)}
    if shared := sorted(own.keys() & rest.keys()):
        raise InputError(
            f"valve: {type(valve).__name__} declares {shared[0]}, which the chambers "
            "or the friction have; rename it"
        )
    return own | rest


def effect_specs() -> dict[str, dict[str, Spec]]:
    """The parameters of every effect, by the effect's name.

    Effects that installed packages offer belong to it, and those of files that
    `effects.load_effects` has read.

    Raises:
        InputError: an installed package offers an effect that cannot be used.
    """
    offered()
    return {name: specs(effect) for name, effect in EFFECTS.items()}


@dataclass(frozen=True)
class Entry:
    """One parameter as the file gives it, in the SI unit its model stores.

    Attributes:
        start: where the search starts, or the value held.
        range: the range it may take; None: held fixed at `start`.
        unit: SI unit of both.
        tolerance: standard deviation with which a held value is known; 0: exactly.
    """

    start: float
    range: tuple[float, float] | None
    unit: str
    tolerance: float = 0.0


@dataclass(frozen=True)
class Given:
    """A parameter as written, beside what is known of it."""

    where: str
    field: str
    spec: Spec
    start: object
    range: tuple[object, object] | None
    reciprocal: bool  # given under `spec.outside`
    tolerance: str = ""


def section_values(
    where: str, given: Mapping[str, object], wants: Mapping[str, str]
) -> dict[str, float]:
    """The quantities of one table in SI; `wants` are its keys and their units.

    Raises:
        InputError: an unknown key, no quantity, or a wrong unit.
    """
    check_known(where, given, wants, "key")
    return {
        key: units.quantity(text, wants[key], f"{where} {key}")
        for key, text in given.items()
    }


def givens(
    where: str, table: Mapping[str, Any], known: Mapping[str, Spec]
) -> list[Given]:
    """The parameters of one table, under the names that the models use.

    Raises:
        InputError: an unknown name, one given twice, or no start beside a range.
    """
    outside = {s.outside[0]: field for field, s in known.items() if s.outside}
    shown = [s.outside[0] if s.outside else field for field, s in known.items()]
    check_known(where, [k for k in table if k not in known], shown, "parameter")
    found: list[Given] = []
    for key, value in table.items():
        field, bounds = outside.get(key, key), None
        start, tolerance = units.parted(value)
        if any(given.field == field for given in found):
            raise InputError(f"{where} {key} gives {field} a second time; drop one")
        if isinstance(value, dict):
            check_known(f"{where} {key}", value, ("start", "range"), "key")
            start, ends = value.get("start"), value.get("range")
            if start is None or not isinstance(ends, list) or len(ends) != 2:
                raise InputError(
                    f"{where} {key} needs a start and a range of two; write {key} = "
                    '{ start = "...", range = ["...", "..."] }'
                )
            bounds = (ends[0], ends[1])
        reciprocal = key in outside and key not in known
        found.append(
            Given(
                f"{where} {key}", field, known[field], start, bounds, reciprocal,
                tolerance,
            )
        )  # fmt: skip
    return found


def unit_of_command(givens: Iterable[Given]) -> str:
    """The command's unit, V or 1, that all the constants agree on.

    Raises:
        InputError: they do not.
    """
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


def _file_unit(given: Given) -> str:
    outside = given.spec.outside
    return outside[1] if given.reciprocal and outside else given.spec.unit


def entry(given: Given, command: str) -> Entry:
    """A parameter in SI, as its model stores it.

    Raises:
        InputError: no quantity, a wrong unit, or a range without the start in it.
    """
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
        start = values[0]
        tolerance = units.tolerance(given.tolerance, start, want, given.where)
        if given.reciprocal:
            start, tolerance = 1.0 / start, tolerance / start**2
        check_possible(given, start, unit)
        return Entry(start, None, unit, tolerance)
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
    check_possible(given, start, unit)
    if lower < 0 <= given.spec.lower:
        raise InputError(
            f"{given.where} range {list(given.range)} goes below 0, where no rig is; "
            "begin it at 0 or above"
        )
    if given.spec.whole and upper > given.spec.upper:
        raise InputError(
            f"{given.where} range {list(given.range)} goes above {given.spec.upper:g}, "
            "which is all there can be of a share; end it there"
        )
    return Entry(start, (lower, upper), unit)


FAR = 1e3
"""How far beyond the range of its declaration a value may lie: machines of another size
are 20 times beyond it, a wrong unit or sign mostly more."""


def check_possible(given: Given, value: float, unit: str) -> None:
    """Refuse a value that no rig has.

    Args:
        given: as written.
        value: in the SI unit its model stores.
        unit: that.

    Raises:
        InputError: it is below 0, or 0, where its declaration is not; above 1 where
            it is a share; or further beyond its declaration than `FAR` times.
    """
    spec = given.spec
    known = f"usually {spec.lower:g} to {spec.upper:g} {unit}".removesuffix(" 1")
    if value == 0 and given.field in LANDS:
        return  # an edge that never opens
    if value < 0 <= spec.lower or value <= 0 < spec.lower:
        raise InputError(
            f"{given.where}: {given.start!r} is not above 0, where every rig is "
            f"({known}); give another"
        )
    if spec.whole and value > spec.upper:
        raise InputError(
            f"{given.where}: {given.start!r} is above {spec.upper:g}, which is all "
            "there can be of a share; give a smaller one"
        )
    most = FAR * max(abs(spec.lower), abs(spec.upper))
    if abs(value) > most or abs(value) < spec.lower / FAR:
        raise InputError(
            f"{given.where}: {given.start!r} is far from what rigs have ({known}); "
            "look at its unit"
        )
