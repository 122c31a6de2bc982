"""The axes of a sweep: quantities and the values they take."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Float

from hydrojax.errors import CELLS, InputError
from hydrojax.rigfile.quantities import Quantity, find

MAX_AXES = 4


@dataclass(frozen=True)
class Axis:
    """A quantity and the values it takes, in the quantity's unit."""

    quantity: Quantity
    values: Float[np.ndarray, "n"]

    @property
    def name(self) -> str:
        """The quantity's."""
        return self.quantity.name


def make_axes(
    axes: Mapping[str, ArrayLike | Sequence[float] | Sequence[str]],
    known: Mapping[str, Quantity],
) -> list[Axis]:
    """The axes of a sweep.

    Args:
        axes: values by name: numbers in the quantity's own unit (gains in the paper's,
            all else SI), or texts with a unit.
        known: what can be named.

    Raises:
        InputError: no axis or too many, an unknown quantity, a value that it cannot
            take, a value twice.
    """
    if not 1 <= len(axes) <= MAX_AXES:
        raise InputError(f"invalid axes: expected 1 to {MAX_AXES}, got {len(axes)}")
    out = []
    for name, given in axes.items():
        quantity = find(known, name, f"axis {name}")
        values = [quantity.number(x, f"axis {name}") for x in _each(given)]
        if len(set(values)) < len(values) or not values:
            raise InputError(f"axis {name}: expected values that differ, at least one")
        out.append(Axis(quantity, np.array(values)))
    cells = math.prod(axis.values.size for axis in out)
    if cells > CELLS:
        raise InputError(
            f"axes: {cells} cells are more than {CELLS}; take fewer values"
        )
    return out


def _each(given: Any) -> list[float | str]:
    """The values of an axis one by one; those of a pint quantity with their unit."""
    unit = getattr(given, "units", None)
    if unit is None or not hasattr(given, "magnitude"):
        return np.atleast_1d(np.asarray(given)).tolist()
    return [f"{x!r} {unit}" for x in np.atleast_1d(given.magnitude).tolist()]


def cells(axes: Sequence[Axis]) -> Float[np.ndarray, "cells axes"]:
    """Every combination, the last axis fastest."""
    return np.array(list(itertools.product(*(a.values for a in axes))))
