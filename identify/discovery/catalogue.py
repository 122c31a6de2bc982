"""A folder of effects that were found as curves: the next trace searches them too."""

from __future__ import annotations

import re
from collections.abc import Container, Sequence
from dataclasses import replace
from pathlib import Path

from hydrojax.effects import EFFECTS
from hydrojax.errors import InputError
from hydrojax.identify.discovery.effect_file import class_name, effect_file
from hydrojax.identify.results.curve import FoundCurve
from hydrojax.report.files import write_one

NAMED = re.compile(r'^    name = "(\w+)"$', re.MULTILINE)
"""How a file of the folder names an effect."""


def keep(folder: Path, rig: str, curves: Sequence[FoundCurve]) -> Path:
    """Write curves into a folder of effects, in one file, under names of the rig's.

    Args:
        folder: is made where there is none; what is in it stays as it is.
        rig: the rig's name, which opens those of file and effects.
        curves: at least one.

    Returns:
        The file.

    Raises:
        InputError: the folder cannot be written to.
    """
    own = re.sub(r"\W+", "_", rig.lower(), flags=re.ASCII).strip("_")
    own = own if own[:1].isalpha() else f"rig_{own}".rstrip("_")
    files = list(folder.glob("*.py"))
    there = {path.stem for path in files}
    names = {n for path in files for n in NAMED.findall(path.read_text("utf-8"))}
    path = folder / f"{_free(own, there)}.py"
    named: list[FoundCurve] = []
    for curve in curves:
        taken = {*EFFECTS, *names, *(c.name for c in named)}
        named.append(_renamed(curve, _free(f"{own}_{curve.name}", taken)))
    try:
        write_one(path, effect_file(rig, named).encode())
    except OSError as err:
        raise InputError(
            f"{folder}: cannot be written: {err.strerror}; name another folder"
        ) from err
    return path


def _free(name: str, taken: Container[str]) -> str:
    """The name, with the first number behind it that makes it one of its own."""
    number, out = 1, name
    while out in taken:
        number += 1
        out = f"{name}_{number}"
    return out


def _renamed(curve: FoundCurve, name: str) -> FoundCurve:
    """The curve, and its class, under another name."""
    source = curve.source.replace(
        f"class {class_name(curve.name)}(", f"class {class_name(name)}(", 1
    ).replace(f'name = "{curve.name}"', f'name = "{name}"', 1)
    return replace(curve, name=name, source=source)
