"""The vocabulary of effects: every effect by the name that files and reports use."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from jaxtyping import Array

from hydrojax.effects import registry
from hydrojax.effects.channels import (
    ChannelSkew,
    CommandChannel,
    LoadcellGain,
    LoadcellLag,
    PressureSensorBias,
    PressureSensorLag,
    SensorChannel,
    ValveBias,
    ValveDeadband,
    ValveDelay,
    ValveHysteresis,
    ValveLag,
    ValveRateLimit,
)
from hydrojax.effects.fluid import (
    DeadVolume,
    EntrainedAir,
    ExternalLeakage,
    FlowEffect,
    InternalLeakage,
    OrificeEffect,
    OrificeTransition,
    SupplyLineDrop,
    Underlap,
)
from hydrojax.effects.mechanics import (
    Backlash,
    BristleDamping,
    ForceEffect,
    FrictionalLag,
    FrictionDrift,
    FrictionForce,
    GravityLoad,
    LevelEffect,
    PayloadInertia,
    PositionFriction,
    PressureFriction,
    RodCompliance,
    StretchEffect,
    Stribeck,
    ViscousFriction,
)
from hydrojax.parameters import Effect, param

EFFECTS: dict[str, type[Effect]] = {
    effect.name: effect
    for effect in (
        # The order on the command's path: the delay holds what the controller wrote,
        # the spool sticks, slews and lags, its null is off, the lands overlap last.
        ValveDelay,
        ValveHysteresis,
        ValveRateLimit,
        ValveLag,
        ValveBias,
        ValveDeadband,
        OrificeTransition,
        Underlap,
        SupplyLineDrop,
        InternalLeakage,
        ExternalLeakage,
        DeadVolume,
        EntrainedAir,
        ViscousFriction,
        Stribeck,
        BristleDamping,
        FrictionalLag,
        PressureFriction,
        PositionFriction,
        FrictionDrift,
        PayloadInertia,
        GravityLoad,
        RodCompliance,
        Backlash,
        LoadcellLag,
        LoadcellGain,
        ChannelSkew,
        PressureSensorLag,
        PressureSensorBias,
    )
}


def load_effects(path: str | Path) -> dict[str, type[Effect]]:
    """Add the effects that a Python file defines; see `own.load_effects`."""
    return registry.load_effects(path, EFFECTS)


@cache
def offered() -> dict[str, type[Effect]]:
    """Add, once, the effects that installed packages offer; see `own.offered`."""
    return registry.offered(EFFECTS)


__all__ = [
    "EFFECTS",
    "Array",
    "CommandChannel",
    "Effect",
    "FlowEffect",
    "ForceEffect",
    "FrictionForce",
    "LevelEffect",
    "OrificeEffect",
    "SensorChannel",
    "StretchEffect",
    "load_effects",
    "offered",
    "param",
]
