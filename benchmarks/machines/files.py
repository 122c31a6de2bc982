"""A machine's folder: rig.toml, three logs, truth.json, and later result.json."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from . import record, rigs

RESULT, TRUTH, RIG = "result.json", "truth.json", "rig.toml"


def folder_of(out: Path, seed: int) -> Path:
    """Where a seed's machine lies."""
    return out / f"machine_{seed:02d}"


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)


def write(recording: record.Recording, folder: Path) -> None:
    """Write one machine; the truth comes last and says that all is there."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, log in recording.logs.items():
        np.savetxt(
            folder / f"{name}.csv",
            log + 0.0,  # no negative zeros
            fmt=record.FORMATS,
            delimiter=",",
            header=record.HEADER,
            comments="",
        )
    write_text(folder / RIG, rigs.rig_text(recording.machine))
    write_text(folder / TRUTH, rigs.truth_text(recording.machine))


def missing(out: Path, seeds: Iterable[int]) -> list[int]:
    """Seeds whose machines are not recorded yet."""
    return [s for s in seeds if not (folder_of(out, s) / TRUTH).exists()]


def read(folder: Path, name: str) -> dict | None:
    """A JSON file of a folder, or None where there is none."""
    path = folder / name
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None
