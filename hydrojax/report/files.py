"""Files that belong together: all of them are written, or none."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from hydrojax.errors import InputError

_RECORDS = ("report.json", "tune.json", "bounds.json")
"""Files that say which rig.toml was written beside them."""


def digest(content: bytes) -> str:
    """What identifies a file's content: its SHA-256."""
    return hashlib.sha256(content).hexdigest()


def check_untouched(folder: Path) -> None:
    """Refuse a folder whose rig.toml is not as it was written by an earlier run.

    Raises:
        InputError: somebody wrote or edited it.
    """
    path = folder / "rig.toml"
    if not path.is_file():
        return
    own = digest(path.read_bytes())
    for name in _RECORDS:
        try:
            record = json.loads((folder / name).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            continue
        if isinstance(record, dict) and record.get("rig_toml_sha256") == own:
            return
    raise InputError(
        f"{path}: was edited, or is not of an earlier run, and would be overwritten; "
        "move it away, or name another folder with --out"
    )


def write_all(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files by name into `folder`, made if it is not there.

    They are written beside it first, so that a full disk leaves what was there; files
    of other names stay.

    Raises:
        OSError: they cannot be written.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    beside = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    try:
        for name, content in files.items():
            (beside / name).write_bytes(content)
        folder.mkdir(exist_ok=True)
        for name in files:
            os.replace(beside / name, folder / name)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
