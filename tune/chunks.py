"""The folder of a sweep: its chunks as they are done, and what they belong to."""

from __future__ import annotations

import hashlib
import io
import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Shaped

from hydrojax.errors import InputError
from hydrojax.report.files import write_one
from hydrojax.tune.dataset import save_dataset

Arrays = Mapping[str, Shaped[np.ndarray, "cells *rest"]]

OWNER = "owner"
"""In a chunk's file: the name that it was written under."""


@dataclass(frozen=True)
class Chunks:
    """What is kept of one sweep.

    Attributes:
        folder: where; None keeps nothing.
        question: hash of what is asked: rig, operating point, axes, plants.
        key: hash of the question and of the code that answers it.
    """

    folder: Path | None
    question: str
    key: str

    def claim(self) -> None:
        """Take the folder for this sweep; what other code has left in it is removed.

        A mark that cannot be read is written anew: chunks say themselves whose they
        are.

        Raises:
            InputError: the folder holds another sweep.
        """
        if self.folder is None:
            return
        mark = self._mark()
        if mark.get("question", self.question) != self.question:
            raise InputError(
                f"{self.folder}: holds another sweep; name another folder with --out, "
                "or remove it"
            )
        if mark.get("key") == self.key:
            return
        (self.folder / "sweep.nc").unlink(missing_ok=True)
        if mark:
            shutil.rmtree(self.folder / "parts", ignore_errors=True)
        self._set_mark("")

    def whole(self, methods: tuple[str, ...]) -> xr.Dataset | None:
        """The sweep that is done, if it has all of these methods and is undamaged."""
        if self.folder is None or not (self.folder / "sweep.nc").is_file():
            return None
        if self._mark().get("sweep") != _hash(self.folder / "sweep.nc"):
            return None
        kept = xr.load_dataset(self.folder / "sweep.nc", engine="h5netcdf")
        return kept if set(kept.attrs["methods"].split()) >= set(methods) else None

    def finish(self, data: xr.Dataset) -> None:
        """Keep the whole sweep."""
        if self.folder is not None:
            save_dataset(data, self.folder / "sweep.nc")
            self._set_mark(_hash(self.folder / "sweep.nc"))

    def has(self, tag: str, number: int) -> bool:
        """Whether a chunk is there."""
        return self.folder is not None and self._path(tag, number).exists()

    def read(
        self, tag: str, number: int
    ) -> dict[str, Shaped[np.ndarray, "cells *rest"]] | None:
        """A chunk that is done, by name; None where it is damaged or another's."""
        if not self.has(tag, number):
            return None
        path = self._path(tag, number)
        try:
            with path.open("rb") as raw, np.load(raw) as file:
                found = dict(file)
            return found if str(found.pop(OWNER)) == path.stem else None
        except Exception:  # NumPy and zipfile have a dozen kinds for a damaged file
            return None

    def write(self, tag: str, number: int, out: Arrays) -> None:
        """Keep a chunk, whole or not at all."""
        if self.folder is None:
            return
        path, store = self._path(tag, number), io.BytesIO()
        np.savez(store, **{**out, OWNER: np.array(path.stem)})  # type: ignore[arg-type]
        write_one(path, store.getvalue())

    def _path(self, tag: str, number: int) -> Path:
        # The key stands in the name: a worker with other code is not believed.
        assert self.folder is not None
        return self.folder / "parts" / f"{tag}-{self.key}-{number:05d}.npz"

    def _mark(self) -> dict[str, Any]:
        """What the folder's plan.json says; nothing where it cannot be read."""
        assert self.folder is not None
        try:
            found = json.loads((self.folder / "plan.json").read_bytes())
        except (OSError, ValueError, RecursionError):
            return {}
        return found if isinstance(found, dict) else {}

    def _set_mark(self, sweep: str) -> None:
        assert self.folder is not None
        mark = {"question": self.question, "key": self.key, "sweep": sweep}
        write_one(self.folder / "plan.json", f"{json.dumps(mark)}\n".encode())


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
