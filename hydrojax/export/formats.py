"""The door: a rig and names of formats in, files out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import jax

from hydrojax.errors import InputError, check_known
from hydrojax.export.firmware import firmware_of, not_given
from hydrojax.export.fmu import fmu_of
from hydrojax.export.modelica import modelica_of
from hydrojax.export.text import json_of, mat_of, toml_of
from hydrojax.export.tree import identifier
from hydrojax.rigfile.schema import RigFile

Files = dict[str, bytes]


@dataclass(frozen=True)
class Export:
    """The files of an export by name, and one-line remarks on what is in them."""

    files: Files
    notes: tuple[str, ...]


def _text(name: str, text: str) -> Files:
    return {name: text.encode()}


FORMATS: Mapping[str, Callable[[RigFile], Files]] = {
    "toml": lambda spec: _text("rig.toml", toml_of(spec)),
    "json": lambda spec: _text("rig.json", json_of(spec)),
    "mat": lambda spec: {"rig.mat": mat_of(spec)},
    "modelica": lambda spec: _text(f"{identifier(spec.name)}.mo", modelica_of(spec)),
    "fmu": fmu_of,
    "c": lambda spec: {n: t.encode() for n, t in firmware_of(spec).items()},
}
"""What a rig can be written as: the files, by name."""


def export(spec: RigFile, formats: Iterable[str]) -> Export:
    """A rig in the formats named.

    Args:
        spec: as `RigFile.load` read it.
        formats: of `FORMATS`.

    Raises:
        InputError: an unknown format, or one that this rig cannot be written in.
        RuntimeError: JAX is not in double precision.
    """
    if not jax.config.read("jax_enable_x64"):
        raise RuntimeError(
            "an export needs double precision: before anything else write "
            'jax.config.update("jax_enable_x64", True)'
        )
    wanted = list(dict.fromkeys(formats))
    if not wanted:
        raise InputError(f"--to: name one or more of {', '.join(FORMATS)}")
    check_known("--to:", wanted, FORMATS, "format")
    files: Files = {}
    for name in wanted:
        files |= FORMATS[name](spec)
    return Export(files, tuple(_notes(spec, wanted)))


def _notes(spec: RigFile, formats: Iterable[str]) -> Iterable[str]:
    if "c" in formats:
        missing = list(not_given(spec))
        if missing:
            yield (
                f"c: [controller] gives no {', '.join(missing)}: the law has the "
                "defaults, which law.c shows"
            )
    if "fmu" in formats:
        yield (
            "fmu: .fmu is FMI 2.0, _fmi3.fmu is FMI 3.0; the binary is for this kind "
            "of machine, the sources for any"
        )
