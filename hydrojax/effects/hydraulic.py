"""Effects that add in the hydraulics: flows, supply drops and compliances."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array

from ..hydraulics import Point
from ..params import Effect, param

P_0 = 101_325.0
"""Atmospheric pressure (Pa): the reference of entrained air."""


class FlowEffect(Effect):
    """Adds flows into the two chambers: `flow(at) -> (q_1, q_2)`, m^3/s."""

    place = "flow"
    needs = ("u",)

    def flow(self, at: Point) -> tuple[Array, Array]:
        """Flows into chambers 1 and 2 at a point, m^3/s."""
        raise NotImplementedError


class InternalLeakage(FlowEffect):
    """Laminar leakage between the chambers (C1)."""

    name = "internal_leakage"
    betrayed_by = "P_a1 - P_a2"
    c_il: Array = param(
        "m^3/(s*Pa)", 0.0, 0.0, 1e-9, "leakage", strength=True, size=2e-13
    )

    def flow(self, at):
        q = self.c_il * (at.P_a1 - at.P_a2)
        return -q, q


class ExternalLeakage(FlowEffect):
    """Laminar leakage of each chamber to the return (C2)."""

    name = "external_leakage"
    betrayed_by = "P_a1 + P_a2"
    c_el: Array = param(
        "m^3/(s*Pa)", 0.0, 0.0, 1e-9, "leakage", strength=True, size=2e-13
    )

    def flow(self, at):
        return -self.c_el * (at.P_a1 - at.P_r), -self.c_el * (at.P_a2 - at.P_r)


class SupplyLineDrop(Effect):
    """Turbulent loss ahead of the valve (C7, C8): `k_s Q_s^2`, in closed form."""

    name = "supply_line_drop"
    place = "supply"
    needs = ("u",)
    betrayed_by = "abs(u)"
    k_s: Array = param(
        "Pa*s^2/m^6", 0.0, 0.0, 1e18, "line loss", strength=True, size=2e13
    )

    def drop(self, conductance: Array, available: Array) -> Array:
        """Pressure lost when `conductance sqrt(.)` draws on `available`, Pa."""
        load = self.k_s * conductance**2
        return available * load / (1 + load)


class EntrainedAir(Effect):
    """Compliance of free air in the oil (C4), polytropic, pressure absolute."""

    name = "entrained_air"
    place = "compliance"
    needs = ("u",)
    betrayed_by = "P_a1 + P_a2"
    alpha: Array = param(
        "1", 0.0, 0.0, 0.3, "air content at 1 atm", strength=True, size=2e-3
    )
    n: Array = param("1", 1.2, 1.0, 1.4, "polytropic exponent", prior=0.1)

    def compliance(self, P: Array) -> Array:
        """Compliance beside 1/beta at gauge pressure `P`, 1/Pa."""
        p = jnp.maximum(P, 0.0) + P_0
        return self.alpha * (P_0 / p) ** (1 / self.n) / (self.n * p)
