"""Lines of a rig file that mend an input, and how a message has them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from hydrojax.logs.tables import Channel
from hydrojax.rigfile.edit import text, with_lines
from hydrojax.rigfile.schema import RigFile
from hydrojax.rigfile.sections import GEOMETRY

Lines = Mapping[str, Mapping[str, Any]]
"""By section and key, what a rig file should say there; plain values of TOML."""


def columns(spec: RigFile, names: Sequence[str], **more: Any) -> Lines:
    """[channels] that reads signals in another way.

    Args:
        spec: the rig file as it is.
        names: the signals.
        more: what a channel says beside what it says already.
    """
    entries = {}
    for name in names:
        given = spec.channels.get(name, Channel(column=name))
        entries[name] = given.model_dump(exclude_defaults=True) | more
    return {"channels": entries}


def scaled(spec: RigFile, names: Sequence[str], factor: float) -> Lines:
    """[channels] that reads signals times a factor."""
    entries = {}
    for name in names:
        given = spec.channels.get(name, Channel(column=name))
        entries |= columns(spec, [name], scale=given.scale * factor)["channels"]
    return {"channels": entries}


def resized(spec: RigFile, names: Sequence[str], factor: float) -> Lines:
    """[geometry] or [supply] that has sizes times a factor, as well known as before."""
    lines: dict[str, dict[str, str]] = {}
    for name in names:
        section, unit, old = "supply", "Pa", spec.line.get(name, 0.0)
        if name in GEOMETRY:
            section, unit, old = "geometry", GEOMETRY[name], spec.geometry[name]
        line = known(factor * old, unit, abs(factor) * spec.tolerances.get(name, 0.0))
        lines.setdefault(section, {})[name] = line
    return lines


def known(value: float, unit: str, tolerance: float) -> str:
    """A plain quantity with its tolerance, in the same unit, if there is one."""
    if not (tolerance and value):
        return text(value, unit)
    return f"{text(value, unit)} +- {100 * tolerance / abs(value):.3g} %"


def turned(spec: RigFile, names: Sequence[str]) -> Lines:
    """[channels] that reads signals with the other sign.

    The position that a sensor reads at mid-stroke changes its sign with it.
    """
    entries = {}
    for name in names:
        given = spec.channels.get(name, Channel(column=name))
        entries |= columns(spec, [name], invert=not given.invert)["channels"]
    lines: Lines = {"channels": entries}
    if names[0] == "x" and spec.geometry.get("x_mid"):
        return {**lines, **resized(spec, ["x_mid"], -1.0)}
    return lines


def exchanged(spec: RigFile, one: str, other: str) -> Lines:
    """[channels] that reads two signals from each other's columns."""
    own = {n: spec.channels.get(n, Channel(column=n)) for n in (one, other)}
    pairs = {one: own[other], other: own[one]}
    return {
        "channels": {n: c.model_dump(exclude_defaults=True) for n, c in pairs.items()}
    }


def written(lines: Lines) -> str:
    """The lines as a rig file has them, on one line of a message."""
    return " and ".join(
        f"[{section}] " + "; ".join(f"{k} = {_plain(v)}" for k, v in own.items())
        for section, own in lines.items()
    )


def _plain(value: Any) -> str:
    if isinstance(value, Mapping):
        own = ", ".join(f"{k} = {_plain(v)}" for k, v in value.items())
        return f"{{ {own} }}"
    return json.dumps(value)


def applied(spec: RigFile, lines: Lines) -> RigFile:
    """The rig file with these lines in it.

    Raises:
        InputError: they make none; see `RigFile.from_text`.
    """
    new = spec.with_text(with_lines(spec.text, lines))
    # That of the logs, where the file does not give it.
    return replace(new, command_unit=spec.command_unit)
