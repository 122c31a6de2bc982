"""The vocabulary of effects: every effect by the name that files and reports use."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TypeVar

from jaxtyping import Array

from hydrojax.effects import registry
from hydrojax.effects.fluid import (
    Counterbalance,
    DeadVolume,
    EntrainedAir,
    ExternalLeakage,
    InternalLeakage,
    PortRelief,
    PressureCompensation,
    ReturnLineDrop,
    SupplyLineDrop,
)
from hydrojax.effects.friction import (
    BristleDamping,
    FilmFriction,
    FrictionalLag,
    FrictionAtRest,
    FrictionDrift,
    MaxwellSlip,
    PositionFriction,
    PressureFriction,
    Stribeck,
    ViscousFriction,
)
from hydrojax.effects.sensors import (
    ChannelSkew,
    LoadcellBias,
    LoadcellGain,
    LoadcellLag,
    PressureSensorBias,
    PressureSensorGain,
    PressureSensorLag,
    SignalFilter,
)
from hydrojax.effects.splines import curve
from hydrojax.effects.structure import (
    Backlash,
    GravityLoad,
    PayloadInertia,
    RodCompliance,
)
from hydrojax.effects.valve import (
    FlowCurve,
    OrificeTransition,
    ReturnOverlap,
    Underlap,
    ValveBias,
    ValveDeadband,
    ValveDelay,
    ValveHysteresis,
    ValveLag,
    ValveRateLimit,
)
from hydrojax.errors import InputError
from hydrojax.parameters import param
from hydrojax.plant.effect import (
    CommandChannel,
    ComplianceEffect,
    Effect,
    FlowEffect,
    ForceEffect,
    FrictionForce,
    HysteresisForce,
    LastingChannel,
    LevelEffect,
    OrificeEffect,
    SensorChannel,
    SpeedEffect,
    StretchEffect,
    SupplyEffect,
    SwitchEffect,
    VolumeEffect,
)

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
        FlowCurve,
        ReturnOverlap,
        OrificeTransition,
        Underlap,
        Counterbalance,
        SupplyLineDrop,
        ReturnLineDrop,
        PortRelief,
        PressureCompensation,
        InternalLeakage,
        ExternalLeakage,
        DeadVolume,
        EntrainedAir,
        ViscousFriction,
        FilmFriction,
        FrictionAtRest,
        Stribeck,
        BristleDamping,
        FrictionalLag,
        PressureFriction,
        PositionFriction,
        FrictionDrift,
        MaxwellSlip,
        PayloadInertia,
        GravityLoad,
        RodCompliance,
        Backlash,
        LoadcellLag,
        LoadcellGain,
        LoadcellBias,
        ChannelSkew,
        PressureSensorLag,
        PressureSensorGain,
        PressureSensorBias,
        SignalFilter,
    )
}


Own = TypeVar("Own", bound=Effect)


def effect(cls: type[Own]) -> type[Own]:
    """Check an effect and add it to the vocabulary; a decorator, also in a notebook.

    Rig files, identification, the trace and the reports then know it by its `name`. A
    class that is defined again, as when a cell is run again, replaces the one before.

    Args:
        cls: derived from one of the base classes of this module, such as
            `FrictionForce`.

    Returns:
        The class itself.

    Raises:
        InputError: the class is not a valid effect, or its name is taken; in one line
            that says what to change.

    Examples:
        >>> @effect
        ... class QuadraticDrag(FrictionForce):
        ...     name = "quadratic_drag"
        ...     residual_axis = "v"
        ...     c: Array = param("N*s^2/m^2", 0.0, 0.0, 1e8, "drag", strength=True)
        ...
        ...     def force(self, at):
        ...         return self.c * at.v * abs(at.v)
    """
    return registry.effect(cls, EFFECTS)


def load_effects(path: str | Path) -> dict[str, type[Effect]]:
    """Add the effects that a Python file defines; it may be read again.

    Args:
        path: of the file, or of a folder of such files; every class in it that derives
            from an effect is taken.

    Returns:
        Its effects, by name.

    Raises:
        InputError: a file cannot be read or run, defines no effect, or one that cannot
            be taken; a folder without any; in one line, with the mend.
    """
    path = Path(path)
    files = sorted(path.glob("*.py")) if path.is_dir() else [path]
    if not files:
        raise InputError(f"{path}: holds no Python file with effects; name another")
    found: dict[str, type[Effect]] = {}
    for file in files:
        found |= registry.load_effects(file, EFFECTS)
    return found


@cache
def offered() -> dict[str, type[Effect]]:
    """Add, once, the effects that installed packages offer; see `registry.offered`."""
    return registry.offered(EFFECTS)


__all__ = [
    "EFFECTS",
    "Array",
    "CommandChannel",
    "ComplianceEffect",
    "Effect",
    "FlowEffect",
    "ForceEffect",
    "FrictionForce",
    "HysteresisForce",
    "LastingChannel",
    "LevelEffect",
    "OrificeEffect",
    "SensorChannel",
    "SpeedEffect",
    "StretchEffect",
    "SupplyEffect",
    "SwitchEffect",
    "VolumeEffect",
    "curve",
    "effect",
    "load_effects",
    "offered",
    "param",
]
