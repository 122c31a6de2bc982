"""The bounds of friction over a fleet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from hydrojax.identify.estimation.box import Box, FrictionStretch, smallest_box
from hydrojax.plant.friction import Theta
from hydrojax.workflows.fleet.merged import FEW

LITTLE = 3.0
"""Multiple of the fleet's median standard deviation above which a fit is too uncertain
to be counted: a few such fits would pass for the scatter of all."""

BOXED = 5000
"""Most fits that friction's bounds are cut from."""


@dataclass(frozen=True)
class FleetBounds:
    """Friction's bounds over the fleet.

    `units` [n] of the box's parameters; `values` [K, n] of the K fits that it is cut
    from, of `of` fits that have friction at all.
    """

    box: Box
    units: tuple[str, ...]
    values: Float[np.ndarray, "fits n"]
    of: int


def friction_box(
    records: Sequence[dict[str, Any]], confidence: float = 0.95
) -> FleetBounds | None:
    """The smallest box that holds the next run's friction at a confidence.

    Of the friction parameters those that most fits identify; of the fits those that
    identify all of these, with about the common standard deviation. The fits' own
    uncertainty is taken out of their scatter. None where they are fewer than `FEW`.
    """
    good = [r for r in records if r.get("friction")]
    names = tuple(
        n for n in Theta._fields if 2 * sum(_identifies(r, n) for r in good) > len(good)
    )
    fits = [r for r in good if all(_identifies(r, n) for n in names)]
    if not names or len(fits) < FEW:
        return None
    stretches = [_stretch(r, names) for r in fits]
    std = np.sqrt([np.diag(s.covariance) for s in stretches])
    clear = np.all(std <= LITTLE * np.median(std, axis=0), axis=1)
    if np.count_nonzero(clear) < FEW:
        return None
    stretches = [s for s, known in zip(stretches, clear, strict=True) if known]
    ranges = [[r["friction"]["ranges"][n] for n in names] for r in fits]
    low, high = np.min(ranges, axis=0)[:, 0], np.max(ranges, axis=0)[:, 1]
    limits = list(zip(low.tolist(), high.tolist(), strict=True))
    box = smallest_box(names, stretches, confidence, limits)
    units = tuple(fits[0]["parameters"][n]["unit"] for n in names)
    return FleetBounds(box, units, np.array([s.theta for s in stretches]), len(good))


def _identifies(record: dict[str, Any], name: str) -> bool:
    p = record["parameters"].get(name)
    return bool(p and p["identified"]) and name in record["friction"]["ranges"]


def _stretch(record: dict[str, Any], names: tuple[str, ...]) -> FrictionStretch:
    """A fit's friction; what ended at its range's end has no spread of its own."""
    own = record["friction"]
    covariance = np.zeros((len(names), len(names)))
    inside = [n for n in names if n in own["inside"]]
    at = [own["inside"].index(n) for n in inside]
    to = [names.index(n) for n in inside]
    if inside:
        covariance[np.ix_(to, to)] = np.array(own["covariance"])[np.ix_(at, at)]
    theta = np.array([record["parameters"][n]["value"] for n in names])
    return FrictionStretch("", 0.0, 0.0, theta, covariance)
