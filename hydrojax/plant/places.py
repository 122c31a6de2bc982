"""The places of a rig at which an effect can act: one table, in signal-path order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import equinox as eqx

from hydrojax.parameters import paths
from hydrojax.plant.chambers import Point
from hydrojax.plant.effect import (
    CommandChannel,
    ComplianceEffect,
    Effect,
    FlowEffect,
    ForceEffect,
    FrictionForce,
    HysteresisForce,
    LevelEffect,
    LineEffect,
    OrificeEffect,
    ReturnEdgeEffect,
    SensorChannel,
    SpeedEffect,
    StretchEffect,
    SupplyEffect,
    SwitchEffect,
    VolumeEffect,
)
from hydrojax.plant.friction import Sliding


@dataclass(frozen=True)
class Place:
    """A place of a rig at which effects act.

    Attributes:
        name: the attribute of `Rig` that holds the effects, and what an effect's
            `place` says.
        base: the class from which effects at this place derive.
        method: what an effect there must define, or None if each of the base's methods
            has a default.
        trial: arguments of `method` at which a user's effect is tried, SI, with nonzero
            values of everything; None where a call alone shows nothing.
        hydraulic: whether the chamber pressures depend on the effect.
        opens: whether the edges' opening depends on the effect.
        gauge: whether the effect changes what the pressure sensors read.
        besides: what else an effect there must define.
    """

    name: str
    base: type[Effect]
    method: str | None
    trial: tuple | None = None
    hydraulic: bool = False
    opens: bool = False
    gauge: bool = False
    besides: tuple[str, ...] = ()

    @property
    def shows_in_pressures(self) -> bool:
        """Whether logged chamber pressures depend on an effect at this place."""
        return self.hydraulic or self.gauge


# Numbers, since an array here would start JAX on import.
_AT = Point._make((5e6, 6.5e6, 14e6, 0.25e6, (0.4, 0.1), 0.02, 0.01, (), 0.3))
_SLIDING = Sliding._make((
    7.0, 0.02, 0.004, 0.6, 5e-5, -2e-3, 3e-3, 5e6, 6.5e6, 14e6, 0.0, 5.75e6, (),
    0.3, 1e-3, (2e-2, 0.1, 0.6), 400.0, 0.0, 0.0,
))  # fmt: skip

PLACES: Mapping[str, Place] = MappingProxyType(
    {
        place.name: place
        for place in (
            Place("command", CommandChannel, "step", hydraulic=True, opens=True),
            Place(
                "returns", ReturnEdgeEffect, "overlap", (), hydraulic=True, opens=True
            ),
            Place("orifice", OrificeEffect, None, hydraulic=True),
            Place("supply", SupplyEffect, "drop", (3e-9, 9e6), hydraulic=True),
            Place("line", LineEffect, "loss", hydraulic=True, besides=("volume",)),
            Place("flow", FlowEffect, "flow", (_AT,), hydraulic=True),
            Place("volume", VolumeEffect, "volume", (), hydraulic=True),
            Place("compliance", ComplianceEffect, "compliance", (3e6,), hydraulic=True),
            Place("stretch", StretchEffect, "stretch", (400.0,), hydraulic=True),
            Place("velocity", SpeedEffect, "follow"),
            Place("level", LevelEffect, "level", (_SLIDING, 900.0)),
            Place("friction", FrictionForce, "force", (_SLIDING,)),
            Place("switch", SwitchEffect, "presliding", (0.3,)),
            Place("hysteresis", HysteresisForce, "force", (4e-5,), besides=("reach",)),
            Place("force", ForceEffect, "force", (_SLIDING,)),
            Place("sensor_P", SensorChannel, "step", gauge=True),
            Place("sensor_F", SensorChannel, "step"),
        )
    }
)
"""Where an effect can act, by name, in the order of the signal path."""


def place_of(effect: Effect | type[Effect]) -> Place:
    """The place at which an effect acts."""
    return PLACES[effect.place]


def hydraulic_names(rig: eqx.Module) -> frozenset[str]:
    """Names of the parameters on which the chamber pressures depend.

    Those of the logger are among them: by these the true supply pressure is had from
    the logged one.
    """
    parts = {place.name for place in PLACES.values() if place.hydraulic}
    parts |= {"valve", "chambers"}
    found = paths(rig).items()
    return frozenset(
        name for name, path in found if path[0] in parts or _of_the_logger(rig, path)
    )


def _of_the_logger(rig: eqx.Module, path: tuple) -> bool:
    place, *index = path
    return place == "sensor_P" and getattr(rig, place)[index[0]].of_the_logger


def opening_names(rig: eqx.Module) -> tuple[str, ...]:
    """Names of the parameters on which the edges' opening depends, in order."""
    parts = {place.name for place in PLACES.values() if place.opens}
    return tuple(name for name, path in paths(rig).items() if path[0] in parts)


def flow_names(rig: eqx.Module) -> tuple[str, ...]:
    """Names of the parameters on which the pressures' step depends, by the edges'
    opening and the supply given, in order.
    """
    apart = {*opening_names(rig), *gauge_names(rig)}
    own = hydraulic_names(rig)
    return tuple(name for name in paths(rig) if name in own and name not in apart)


def gauge_names(rig: eqx.Module) -> frozenset[str]:
    """Names of the parameters of the pressure sensors.

    Residuals of the pressures depend on them, the pressures themselves do not.
    """
    parts = {place.name for place in PLACES.values() if place.gauge}
    return frozenset(name for name, path in paths(rig).items() if path[0] in parts)
