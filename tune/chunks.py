"""The folder of a sweep: its chunks as they are done, and what they belong to."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from jaxtyping import Shaped

from hydrojax.errors import InputError

Arrays = Mapping[str, Shaped[np.ndarray, "cells *rest"]]


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

        Raises:
            InputError: the folder holds another sweep.
        """
        if self.folder is None:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        mark = self.folder / "plan.json"
        if mark.exists():
            held = json.loads(mark.read_text())
            if held.get("question") != self.question:
                raise InputError(
                    f"{self.folder}: holds another sweep; name another folder with "
                    "--out, or remove it"
                )
            if held["key"] == self.key:
                return
            (self.folder / "sweep.nc").unlink(missing_ok=True)
            shutil.rmtree(self.folder / "parts", ignore_errors=True)
        mark.write_text(json.dumps({"question": self.question, "key": self.key}) + "\n")

    def whole(self, methods: tuple[str, ...]) -> xr.Dataset | None:
        """The sweep that is done, if it has all of these methods."""
        if self.folder is None or not (self.folder / "sweep.nc").exists():
            return None
        kept = xr.load_dataset(self.folder / "sweep.nc", engine="h5netcdf")
        return kept if set(kept.attrs["methods"].split()) >= set(methods) else None

    def has(self, tag: str, number: int) -> bool:
        """Whether a chunk is done."""
        return self.folder is not None and self._path(tag, number).exists()

    def read(
        self, tag: str, number: int
    ) -> dict[str, Shaped[np.ndarray, "cells *rest"]] | None:
        """A chunk that is done, by name."""
        if not self.has(tag, number):
            return None
        with np.load(self._path(tag, number)) as file:
            return dict(file)

    def write(self, tag: str, number: int, out: Arrays) -> None:
        """Keep a chunk, whole or not at all."""
        if self.folder is None:
            return
        path = self._path(tag, number)
        path.parent.mkdir(exist_ok=True)
        with tempfile.NamedTemporaryFile(
            dir=path.parent, suffix=".draft", delete=False
        ) as file:
            np.savez(file, **out)  # type: ignore[arg-type]
        os.replace(file.name, path)

    def _path(self, tag: str, number: int) -> Path:
        # The key stands in the name: a worker with other code is not believed.
        assert self.folder is not None
        return self.folder / "parts" / f"{tag}-{self.key[:8]}-{number:05d}.npz"
