"""Effects that add in the hydraulics: flows, edges, drops, volumes, compliances."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array

from hydrojax.parameters import Effect, param
from hydrojax.plant.chambers import Point

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
    residual_axis = "P_a1 - P_a2"
    c_il: Array = param(
        "m^3/(s*Pa)", 0.0, 0.0, 1e-9, "leakage", strength=True, size=2e-13
    )

    def flow(self, at):
        q = self.c_il * (at.P_a1 - at.P_a2)
        return -q, q


class ExternalLeakage(FlowEffect):
    """Laminar leakage of each chamber to the return (C2)."""

    name = "external_leakage"
    residual_axis = "P_a1 + P_a2"
    c_el: Array = param(
        "m^3/(s*Pa)", 0.0, 0.0, 1e-9, "leakage", strength=True, size=2e-13
    )

    def flow(self, at):
        return -self.c_el * (at.P_a1 - at.P_r), -self.c_el * (at.P_a2 - at.P_r)


class OrificeEffect(Effect):
    """Changes the valve's four edges: how far they open, how laminar they are.

    `opening(spool) -> (open_p, open_n)` is added to the openings toward either side,
    `core() -> Pa^2` to the square of the laminar core.
    """

    place = "orifice"
    needs = ("u",)

    def opening(self, spool: Array) -> tuple[Array | float, Array | float]:
        """What is added to the openings when the spool stands at `spool`."""
        return 0.0, 0.0

    def core(self) -> Array | float:
        """What is added to the square of the laminar core, Pa^2."""
        return 0.0


class OrificeTransition(OrificeEffect):
    """Laminar flow below a pressure drop `dP_t` (V10).

    The flow lacks `(dP_t / drop)^2 / 4` of the turbulent one: it depends on the square,
    which is what is stored, for the derivative to `dP_t` itself dies at zero.
    """

    name = "orifice_transition"
    residual_axis = "P_a1 - P_a2"
    dP_t2: Array = param(
        "Pa^2", 0.0, 0.0, 1e14, "square of dP_t", strength=True, size=2.5e11
    )

    def core(self):
        return self.dP_t2


class Underlap(OrificeEffect):
    """Edges that are still open by `u_ul` when the spool stands at zero (V5).

    A step over which the spool changes sign is taken at its mean.
    """

    name = "underlap"
    residual_axis = "u"
    u_ul: Array = param(
        "{u}", 0.0, 0.0, 5.0, "opening at zero", strength=True, size=0.05
    )

    def opening(self, spool):
        def more(u):
            # At the edge of being shut it opens: the one-sided derivative at zero.
            return jnp.where(u + self.u_ul >= 0, u + self.u_ul, 0.0) - jnp.where(
                u >= 0, u, 0.0
            )

        return more(spool), more(-spool)


class DeadVolume(Effect):
    """Oil beside the stroke in hoses and manifold (C3): `V_i = A x_i + V_0i`.

    `V_0i / A` is an assembly offset by another name: where `delta_1` and `delta_2`
    are free a log cannot tell them, and only what they sum to is found.
    """

    name = "dead_volume"
    place = "volume"
    needs = ("u",)
    residual_axis = "x"
    V_01: Array = param("m^3", 0.0, 0.0, 0.02, "of chamber 1", strength=True, size=5e-6)
    V_02: Array = param("m^3", 0.0, 0.0, 0.02, "of chamber 2", strength=True, size=5e-6)

    def volume(self) -> tuple[Array, Array]:
        """Volume beside the stroke of chambers 1 and 2, m^3."""
        return self.V_01, self.V_02


class SupplyLineDrop(Effect):
    """Turbulent loss ahead of the valve (C7, C8): `k_s Q_s^2`, in closed form."""

    name = "supply_line_drop"
    place = "supply"
    needs = ("u",)
    residual_axis = "abs(u)"
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
    residual_axis = "P_a1 + P_a2"
    alpha: Array = param(
        "1", 0.0, 0.0, 0.3, "air content at 1 atm", strength=True, size=2e-3
    )
    n: Array = param("1", 1.2, 1.0, 1.4, "polytropic exponent", prior=0.1)

    def compliance(self, P: Array) -> Array:
        """Compliance beside 1/beta at gauge pressure `P`, 1/Pa."""
        p = jnp.maximum(P, 0.0) + P_0
        return self.alpha * (P_0 / p) ** (1 / self.n) / (self.n * p)
