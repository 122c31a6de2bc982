"""The vocabulary of effects: every effect by the name that files and reports use."""

from __future__ import annotations

from ..channels import (
    LoadcellGain,
    LoadcellLag,
    PressureSensorLag,
    ValveBias,
    ValveDeadband,
    ValveDelay,
    ValveHysteresis,
    ValveLag,
)
from ..params import Effect
from .hydraulic import EntrainedAir, ExternalLeakage, InternalLeakage, SupplyLineDrop
from .mechanical import (
    BristleDamping,
    FrictionDrift,
    GravityLoad,
    PayloadInertia,
    PositionFriction,
    PressureFriction,
    Stribeck,
    ViscousFriction,
)

EFFECTS: dict[str, type[Effect]] = {
    effect.name: effect
    for effect in (
        # The order on the command's path: the delay holds what the controller wrote,
        # the spool lags and sticks, its null is off, and the lands overlap last.
        ValveDelay,
        ValveHysteresis,
        ValveLag,
        ValveBias,
        ValveDeadband,
        SupplyLineDrop,
        InternalLeakage,
        ExternalLeakage,
        EntrainedAir,
        ViscousFriction,
        Stribeck,
        BristleDamping,
        PressureFriction,
        PositionFriction,
        FrictionDrift,
        PayloadInertia,
        GravityLoad,
        LoadcellLag,
        LoadcellGain,
        PressureSensorLag,
    )
}

__all__ = ["EFFECTS", "Effect"]
