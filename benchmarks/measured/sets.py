"""The measured sets: what drives them, what is predicted, how they are split."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy.interpolate import make_smoothing_spline
from scipy.signal import decimate

SKIPPED = 50
"""Ticks at the start of a log that do not count, half a second: models begin there."""


@dataclass(frozen=True)
class Run:
    """One log at even ticks.

    Attributes:
        t: time, s.
        u: what drives it.
        y: what is predicted.
        first: the first tick whose error counts.
    """

    t: Float[np.ndarray, "ticks"]
    u: Float[np.ndarray, "ticks inputs"]
    y: Float[np.ndarray, "ticks"]
    first: int = SKIPPED


@dataclass(frozen=True)
class Measured:
    """A measured set.

    Attributes:
        folder: of the set, below the folder of all data.
        task: what is predicted from what.
        unit: of errors.
        size: of that unit in what is predicted.
        source: who recorded it, and where it is had.
        runs: `part` ("fit" or "validate") -> the runs; see `read`.
        peers: names of the other models.
    """

    folder: str
    task: str
    unit: str
    size: float
    source: str
    runs: Callable[[Path, str], list[Run]]
    peers: tuple[str, ...] = ("ARX", "subspace (N4SID)", "NARX (SysIdentPy)", "GRU")

    def read(self, data: Path, part: str) -> list[Run]:
        """The runs of a part, "fit" or "validate"."""
        return self.runs(data / self.folder, part)


def _thinned(t: np.ndarray, columns: np.ndarray, factor: int) -> Run:
    """Every `factor`-th tick, without what lies beyond; the last column is output."""
    low = decimate(columns, factor, ftype="fir", axis=0)
    return Run(t[::factor], low[:, :-1], low[:, -1])


def _emps(folder: Path, part: str) -> list[Run]:
    table = pd.read_csv(folder / f"{part}.csv").to_numpy()
    return [_thinned(table[:, 0], table[:, [2, 1]], 10)]


def _damper(folder: Path, part: str) -> list[Run]:
    runs = []
    for path in sorted(folder.glob(f"{part}*.csv")):
        t, x, P = pd.read_csv(path).to_numpy().T
        runs.append(_thinned(t, np.stack([x, _speed(t, x), 1e3 * P], axis=1), 8))
    return runs


def _seal(folder: Path, part: str) -> list[Run]:
    """Times are uneven: taken to 100 Hz along straight lines."""
    runs = []
    for path in sorted(folder.glob(f"{part}*.csv")):
        table = pd.read_csv(path).to_numpy()
        t, x, P, F = table[np.diff(table[:, 0], prepend=-np.inf) > 0].T
        even = np.arange(t[0], t[-1], 0.01)
        x, P, F = (np.interp(even, t, a) for a in (x, P, F))
        runs.append(Run(even, np.stack([x, _speed(even, x), P], axis=1), F))
    return runs


def _arm(folder: Path, part: str) -> list[Run]:
    """Its first half, or all of it with the second counted; a tick is not said to be
    how long.
    """
    table = pd.read_csv(folder / "log.csv").to_numpy()
    if part == "fit":
        return [Run(np.arange(512.0), table[:512, :1], table[:512, 1])]
    return [Run(np.arange(1024.0), table[:, :1], table[:, 1], first=512)]


def _speed(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Speed of a position at even ticks, below some 10 Hz."""
    lam = 1 / ((t[1] - t[0]) * (2 * np.pi * 10) ** 4)
    return make_smoothing_spline(t, x, lam=lam)(t, 1)


def _of_a_seal(folder: str) -> Measured:
    source = "E. Zillen, 3D-printed pneumatic actuators, CC0-1.0"
    peers = (*Measured.peers, "regression of each run")
    return Measured(folder, "motion, pressure → force", "N", 1.0, source, _seal, peers)


SETS: Mapping[str, Measured] = MappingProxyType(
    {
        "EMPS": Measured(
            "emps", "drive force → position", "mm", 1e-3,
            "A. Janot, M. Gautier, M. Brunot, 2019; nonlinearbenchmark.org", _emps,
        ),
        "KDN seal": _of_a_seal("zillen-kdn"),
        "circular seal": _of_a_seal("zillen-circle"),
        "O-ring 257": _of_a_seal("zillen-o-ring257"),
        "friction damper": Measured(
            "arts-friction-damper", "motion → force", "kN", 1e3,
            "ARTS-Laboratory, Dataset-Friction-Damper-with-Backlash, CC BY-SA 4.0",
            _damper,
        ),
        "robot arm": Measured(
            "sjoberg-arm", "valve opening → pressure", "1", 1.0,
            "J. Sjöberg et al., 1995; with the code of several papers", _arm,
        ),
    }
)  # fmt: skip
"""By name, in the order of the table."""
