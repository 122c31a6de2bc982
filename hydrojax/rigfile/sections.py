"""The sections of a rig file as TOML has them: their shapes, quantities as written."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Annotated, Any, NoReturn

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from hydrojax.errors import InputError
from hydrojax.logs.signals import Channel
from hydrojax.plant.layout import LAYOUTS

ControllerValue = str | int | float | list[str | int | float]
"""A quantity, a number in the paper's unit, or two bounds of either."""


def _known_layout(name: str) -> str:
    if name not in LAYOUTS:
        raise ValueError(f"unknown layout {name!r}")
    return name


class Sections(BaseModel):
    """A rig file's sections, each as TOML gives it."""

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


def read_sections(path: str, text: str) -> Sections:
    """The sections of a rig file's text, of the right shape; quantities as written.

    Raises:
        InputError: no TOML, or not of that shape; `path` opens the line.
    """
    try:
        tree = tomllib.loads(text)
    except ValueError as err:
        detail = " ".join(str(err).split())
        raise InputError(f"{path}: not TOML: {detail}; correct that line") from err
    check_known(f"{path}:", tree, Sections.model_fields, "key or section")
    try:
        return Sections.model_validate(tree)
    except ValidationError as err:
        _refuse(path, tree, err)


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
        f"{where} {key}: invalid value {first['input']!r}: expected {shape}"
    ) from None


def check_known(
    where: str, given: Iterable[str], known: Iterable[str], what: str
) -> None:
    """Refuse the first name that is not known, and suggest the nearest."""
    known = list(known)
    for name in given:
        if name not in known:
            near = get_close_matches(name, known, n=1, cutoff=0.5)
            mend = f"did you mean {near[0]!r}?" if near else f"known: {known}"
            raise InputError(f"{where} unknown {what} {name!r}; {mend}")
