"""What a sweep goes over: axes in words, and plants that could be the rig."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hydrojax.errors import InputError
from hydrojax.plant.named import get, parameter_specs
from hydrojax.rigfile.quantities import Quantity, Setting, find

MOST_AXES = 4
SPREAD = 0.2
"""Half-width (relative) within which the parameters of an ensemble lie."""

SPREAD_OVER = (
    "beta", "c_p1", "c_n1", "c_p2", "c_n2",
    "k_cp", "k_cn", "k_0", "k_vp", "k_vn", "k_fp", "k_fn",
)  # fmt: skip
"""Bulk modulus, valve constants and friction: what an ensemble varies."""


@dataclass(frozen=True)
class Axis:
    """A quantity and the values [n] it takes, in the quantity's unit."""

    quantity: Quantity
    values: np.ndarray
    log: bool = False

    @property
    def name(self) -> str:
        """The quantity's."""
        return self.quantity.name


@dataclass(frozen=True)
class Plants:
    """Plants: values [m, len(names)] of parameters, SI; and where they come from."""

    names: tuple[str, ...]
    values: np.ndarray
    says: str


def read_axis(word: str, known: Mapping[str, Quantity], where: str = "--over") -> Axis:
    """`name=start:stop:count`, `name=start:stop:count:log` or `name=a,b,c`.

    Raises:
        InputError: an unknown quantity, or words that are no values of it.
    """
    name, sign, text = word.partition("=")
    where = f"{where} {word!r}"
    if not sign or not text.strip():
        raise InputError(f"{where}: write NAME=START:STOP:COUNT, such as k_p=0.2:4:48")
    quantity = find(known, name.strip(), where)
    parts = [p.strip() for p in text.split(":")]
    log = parts[-1] == "log"
    if len(parts) == 1:
        values = [quantity.number(p, where) for p in text.split(",")]
        if len(set(values)) < len(values):
            raise InputError(f"{where}: a value is there twice; drop one")
        return Axis(quantity, np.array(values))
    if len(parts) != 3 + (len(parts) == 4 and parts[3] in ("log", "lin")):
        raise InputError(f"{where}: write START:STOP:COUNT, and :log if so spaced")
    start, stop = (quantity.number(p, where) for p in parts[:2])
    count = int(parts[2]) if parts[2].isdigit() else 0
    if count < 2 or start == stop:
        raise InputError(f"{where}: give two ends and a count of 2 or more")
    if log and min(start, stop) <= 0:
        raise InputError(f"{where}: a log scale needs both ends above 0")
    space = np.geomspace if log else np.linspace
    return Axis(quantity, space(start, stop, count), log)


def read_axes(words: Sequence[str], known: Mapping[str, Quantity]) -> list[Axis]:
    """The axes of a sweep.

    Raises:
        InputError: none, too many, or one twice.
    """
    axes = [read_axis(word, known) for word in words]
    if not 1 <= len(axes) <= MOST_AXES:
        raise InputError(f"--over: give 1 to {MOST_AXES} axes, not {len(axes)}")
    names = [a.name for a in axes]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"--over: {name} is there twice; drop one")
    return axes


def cells(axes: Sequence[Axis]) -> np.ndarray:
    """Every combination, the last axis fastest, [prod(lengths), len(axes)]."""
    return np.array(list(itertools.product(*(a.values for a in axes))))


def ensemble(
    setting: Setting, count: int, spread: float = SPREAD, seed: int = 0
) -> Plants:
    """The rig itself, and others within `spread` of it: uniform, each for itself.

    Args:
        setting: whose plant is the first.
        count: of all plants.
        spread: relative half-width for every parameter of `SPREAD_OVER`.
        seed: of the draw.
    """
    here = np.asarray(get(setting.loop.rig, SPREAD_OVER))
    rng = np.random.default_rng([seed, 21])
    factor = 1 + spread * rng.uniform(-1, 1, (count, here.size))
    factor[0] = 1.0
    says = f"{count} plants, ±{100 * spread:g} % on β, valve constants and friction"
    return Plants(SPREAD_OVER, here * factor, says)


def from_report(setting: Setting, folder: Path, count: int, seed: int = 0) -> Plants:
    """Plants drawn from what `identify` or `trace` found, the found one first.

    Args:
        setting: whose rig has the report's parameters.
        folder: with `report.json`.
        count: of all plants.
        seed: of the draw.

    Raises:
        InputError: no report, or one without anything that was fitted.
    """
    path = folder / "report.json"
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        found = dict(report["parameters"])
        for effect in report["effects"]:
            own = effect["parameters"].items()
            found |= {f"{effect['name']}.{name}": p for name, p in own}
    except (OSError, ValueError, KeyError, TypeError) as err:
        raise InputError(
            f"{path}: no report of identify or trace; name the folder that --out gave"
        ) from err
    known = parameter_specs(setting.loop.rig)
    free = [n for n, p in found.items() if p.get("std") and n in known]
    if not free:
        raise InputError(f"{path}: nothing in it was fitted; use --spread instead")
    middle = np.array([found[n]["value"] for n in free])
    std = np.array([found[n]["std"] for n in free])
    root, says = np.diag(std), "without correlations, which the report does not hold"
    full = report.get("covariance")
    if full and set(free) <= set(full["names"]):
        at = [full["names"].index(n) for n in free]
        matrix = np.array(full["matrix"], float)[np.ix_(at, at)]
        # Of the correlations: the parameters are forty powers of ten apart in square.
        each = np.sqrt(np.diag(matrix))
        size, turn = np.linalg.eigh(matrix / np.outer(each, each))
        root = each[:, None] * turn * np.sqrt(np.maximum(size, 0))
        says = "from its covariance"
    rng = np.random.default_rng([seed, 22])
    values = middle + rng.normal(size=(count, middle.size)) @ root.T
    values[0] = middle
    low = np.array([known[n].lower for n in free])
    high = np.array([known[n].upper for n in free])
    values = np.clip(values, low, high)
    return Plants(tuple(free), values, f"{count} plants as {path.parent} found, {says}")
