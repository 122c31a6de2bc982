"""Effects of the fluid: supply line, leakage, volumes and compliance."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.parameters import param
from hydrojax.plant.effect import (
    ComplianceEffect,
    FlowEffect,
    SupplyEffect,
    VolumeEffect,
)

P_0 = 101_325.0
"""Atmospheric pressure (Pa): the reference of entrained air."""


class SupplyLineDrop(SupplyEffect):
    """Turbulent loss ahead of the valve (C7, C8): `k_s Q_s^2`, in closed form."""

    name = "supply_line_drop"
    residual_axis = "abs(u)"
    k_s: Float[Array, ""] = param(
        "Pa*s^2/m^6", 0.0, 0.0, 1e18, "line loss", strength=True, size=2e13
    )

    def drop(
        self, conductance: Float[Array, "*batch"], available: Float[Array, "*batch"]
    ) -> Float[Array, "*batch"]:
        """Pressure lost when `conductance sqrt(.)` draws on `available`, Pa."""
        load = self.k_s * conductance**2
        return available * load / (1 + load)


class InternalLeakage(FlowEffect):
    """Laminar leakage between the chambers (C1)."""

    name = "internal_leakage"
    residual_axis = "P_a1 - P_a2"
    c_il: Float[Array, ""] = param(
        "m^3/(s*Pa)", 0.0, 0.0, 1e-9, "leakage", strength=True, size=2e-13
    )

    def flow(self, at):
        q = self.c_il * (at.P_a1 - at.P_a2)
        return -q, q


class ExternalLeakage(FlowEffect):
    """Laminar leakage of each chamber to the return (C2)."""

    name = "external_leakage"
    residual_axis = "P_a1 + P_a2"
    c_el: Float[Array, ""] = param(
        "m^3/(s*Pa)", 0.0, 0.0, 1e-9, "leakage", strength=True, size=2e-13
    )

    def flow(self, at):
        return -self.c_el * (at.P_a1 - at.P_r), -self.c_el * (at.P_a2 - at.P_r)


class DeadVolume(VolumeEffect):
    """Oil beside the stroke in hoses and manifold (C3): `V_i = A x_i + V_0i`.

    `V_0i / A` is an assembly offset by another name: where `delta_1` and `delta_2`
    are free a log does not identify them separately, only their sum.
    """

    name = "dead_volume"
    residual_axis = "x"
    V_01: Float[Array, ""] = param(
        "m^3", 0.0, 0.0, 0.02, "of chamber 1", strength=True, size=5e-6
    )
    V_02: Float[Array, ""] = param(
        "m^3", 0.0, 0.0, 0.02, "of chamber 2", strength=True, size=5e-6
    )

    def volume(self) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Volume beside the stroke of chambers 1 and 2, m^3."""
        return self.V_01, self.V_02


class EntrainedAir(ComplianceEffect):
    """Compliance of free air in the oil (C4), polytropic, pressure absolute."""

    name = "entrained_air"
    residual_axis = "P_a1 + P_a2"
    alpha: Float[Array, ""] = param(
        "1", 0.0, 0.0, 0.3, "air content at 1 atm", strength=True, size=2e-3
    )
    n: Float[Array, ""] = param("1", 1.2, 1.0, 1.4, "polytropic exponent", prior=0.1)

    def compliance(self, P: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Compliance beside 1/beta at gauge pressure `P`, 1/Pa."""
        p = jnp.maximum(P, 0.0) + P_0
        return self.alpha * (P_0 / p) ** (1 / self.n) / (self.n * p)
