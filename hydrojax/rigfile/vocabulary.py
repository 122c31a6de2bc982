"""What a rig file may hold: its keys with their units, and the known parameters."""

from __future__ import annotations

from collections.abc import Mapping

from hydrojax.effects import EFFECTS, offered
from hydrojax.errors import InputError
from hydrojax.parameters import Spec, specs
from hydrojax.plant.chambers import Chambers
from hydrojax.plant.friction import Friction
from hydrojax.plant.valve import AbstractValve, MeteringEdges

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


def base_specs(valve: AbstractValve | None = None) -> dict[str, Spec]:
    """The base model's parameters, by name: those of valve, chambers and friction.

    Args:
        valve: None for the paper's four metering edges.

    Raises:
        InputError: no valve, or one with a parameter that chambers or friction have.
    """
    if valve is not None and not isinstance(valve, AbstractValve):
        raise InputError(
            f"valve: invalid {valve!r}: expected an instance of an AbstractValve"
        )
    own = specs(MeteringEdges if valve is None else valve)
    rest = {**specs(Chambers), **specs(Friction)}
    if shared := sorted(own.keys() & rest.keys()):
        raise InputError(
            f"valve: {type(valve).__name__} declares {shared[0]}, which the chambers "
            "or the friction have; rename it"
        )
    return own | rest


BASE: Mapping[str, Spec] = base_specs()
"""The base model's parameters with the paper's valve, by name."""


def effect_specs() -> dict[str, dict[str, Spec]]:
    """The parameters of every effect, by the effect's name.

    Effects that installed packages offer belong to it, and those of files that
    `effects.load_effects` has read.

    Raises:
        InputError: an installed package offers an effect that cannot be used.
    """
    offered()
    return {name: specs(effect) for name, effect in EFFECTS.items()}
