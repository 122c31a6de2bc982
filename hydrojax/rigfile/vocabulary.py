"""What a rig file may hold: its keys with their units, and the known parameters."""

from __future__ import annotations

from collections.abc import Mapping

from hydrojax.effects import EFFECTS, offered
from hydrojax.parameters import Spec, specs
from hydrojax.plant.chambers import Chambers
from hydrojax.plant.friction import Friction
from hydrojax.plant.valve import MeteringEdges

GEOMETRY = {
    "area": "m^2", "area_1": "m^2", "area_2": "m^2",
    "chamber_length": "m", "radius": "m", "x_mid": "m",
    "x_from": "m", "x_to": "m",
}  # fmt: skip
"""What [geometry] may hold, and the SI unit."""

SUPPLY_UNITS = {"P_s": "Pa", "P_r": "Pa"}
"""What [supply] may hold, and the SI unit."""

LOAD = {"F": "N", "mass": "kg", "stiffness": "N/m", "damping": "N*s/m"}
"""What [load] may hold, and the SI unit."""

LANDS = tuple(specs(MeteringEdges))
"""The valve constants' names."""

BASE: Mapping[str, Spec] = {
    **specs(MeteringEdges),
    **specs(Chambers),
    **specs(Friction),
}
"""The base model's parameters, by name."""


def effect_specs() -> dict[str, dict[str, Spec]]:
    """The parameters of every effect, by the effect's name.

    Effects that installed packages offer belong to it, and those of files that
    `effects.load_effects` has read.

    Raises:
        InputError: an installed package offers an effect that cannot be used.
    """
    offered()
    return {name: specs(effect) for name, effect in EFFECTS.items()}
