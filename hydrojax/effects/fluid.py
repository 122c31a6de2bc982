"""Effects of lines and fluid: supply, valves in the lines, leakage, compliance."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.parameters import param
from hydrojax.plant.effect import (
    ComplianceEffect,
    FlowEffect,
    LineEffect,
    SupplyEffect,
    VolumeEffect,
)
from hydrojax.plant.powers import log, power

P_0 = 101_325.0
"""Atmospheric pressure (Pa): the reference of entrained air."""


OPENED = 1e7
"""Pressure (Pa) beyond its setting at which a counterbalance valve's losses are given.
Given where it is wholly open they would be known only from logs that open it so."""

SHUT = 1e-3
"""How far, over that, a counterbalance valve that is shut still opens: what leaks."""

RELIEF = (5.5e6, 9e6, 1.5e7, 2.5e7)
"""Settings (Pa) from which a relief valve is looked for: one just below the highest
pressure of a log shows it, one above that has no derivative, and one below all of it is
a leakage."""


def _lost_in_line(
    k: Float[Array, ""],
    conductance: Float[Array, "*batch"],
    available: Float[Array, "*batch"],
) -> Float[Array, "*batch"]:
    """What a line loses, `k Q^2` (Pa), in series with an edge, `Q = conductance
    sqrt(.)` (m^3/(s Pa^0.5)), of all that is available over both (Pa).
    """
    load = k * conductance**2
    return available * load / (1 + load)


class SupplyLineDrop(SupplyEffect):
    """Turbulent loss ahead of the valve (C7, C8): `P_s - k_s Q_s^2` stands at it."""

    name = "supply_line_drop"
    residual_axis = "abs(u)"
    k_s: Float[Array, ""] = param(
        "Pa*s^2/m^6", 0.0, 0.0, 1e18, "line loss", strength=True, size=2e13
    )

    def drop(
        self, conductance: Float[Array, "*batch"], available: Float[Array, "*batch"]
    ) -> Float[Array, "*batch"]:
        """Pressure lost when `conductance sqrt(.)` draws on `available`, Pa."""
        return _lost_in_line(self.k_s, conductance, available)


class ReturnLineDrop(SupplyEffect):
    """Turbulent loss behind the valve (C9): `P_r + k_r Q_r^2` stands at it."""

    name = "return_line_drop"
    residual_axis = "abs(u)"
    k_r: Float[Array, ""] = param(
        "Pa*s^2/m^6", 0.0, 0.0, 1e18, "line loss", strength=True, size=2e13
    )

    def drop(
        self, conductance: Float[Array, "*batch"], available: Float[Array, "*batch"]
    ) -> Float[Array, "*batch"]:
        """Nothing is lost ahead of the valve."""
        return 0.0 * available

    def back(
        self, conductance: Float[Array, "*batch"], available: Float[Array, "*batch"]
    ) -> Float[Array, "*batch"]:
        """Pressure lost when `conductance sqrt(.)` drains under `available`, Pa."""
        return _lost_in_line(self.k_r, conductance, available)


class PressureCompensation(SupplyEffect):
    """A compensator ahead of the edges that draw on the supply: proportional valves.

    It takes what exceeds its margin: of a drop `d` over `dP_0` it leaves
    `d^(1-s) dP_0^s`: an orifice at s = 0, a flow set by the opening alone at s = 1, and
    one that falls as the drop grows beyond that (overcompensated). Below the margin it
    stands open. It holds the load, as its check valve does: where the supply stands
    below the chamber it lets the share `1 - s` flow back.
    """

    name = "pressure_compensation"
    needs = ("u",)
    residual_axis = "P_s"
    # Less is what the flow's force on a spool does (`benchmarks.trace`).
    s: Float[Array, ""] = param(
        "1", 0.0, 0.0, 1.3, "share of the drop", strength=True, size=0.1, minimum=0.1
    )
    dP_0: Float[Array, ""] = param(
        "Pa", 7e5, 1e5, 3e6, "margin", grid=(4e5, 1e6), prior=5e5
    )

    def drop(
        self, conductance: Float[Array, "*batch"], available: Float[Array, "*batch"]
    ) -> Float[Array, "*batch"]:
        """Pressure taken of `available`, Pa; whatever the `conductance` is."""
        over = jnp.maximum(available / self.dP_0, 1.0)
        taken = -jnp.expm1(-self.s * log(over))
        return available * jnp.where(available < 0, jnp.minimum(self.s, 1.0), taken)


class Counterbalance(LineEffect):
    """Over-centre valve in the line of each chamber: throttles what leaves it.

    It opens with the chamber's pressure and, `ratio` times, with the other chamber's,
    which comes with the lag `tau` of a damped pilot line: by
    `p = P_i + ratio P_j - P_set`, or by `dP_full` where that is less. Outflow Q loses
    `k_i Q^2 (10 MPa / p)^2` in it, none at `k_i = 0` (no valve in the line of chamber
    i), and inflow loses `check_loss k_i Q sqrt(Q^2 + check_flow^2)` in its check
    valve, whose poppet has not opened fully at a small flow. `V_line` of what a chamber
    holds lies between valve and edge, at a pressure of its own.
    """

    name = "counterbalance"
    needs = ("u", "differential")
    residual_axis = "P_a1 + P_a2"
    k_1: Float[Array, ""] = param(
        "Pa*s^2/m^6", 0.0, 0.0, 1e19, "loss 10 MPa beyond its setting, chamber 1",
        strength=True, size=4.5e13, grid=(7e11, 7e12, 7e15, 7e12, 0.0),
    )  # fmt: skip
    k_2: Float[Array, ""] = param(
        "Pa*s^2/m^6", 0.0, 0.0, 1e19, "loss 10 MPa beyond its setting, chamber 2",
        strength=True, size=4.5e13, grid=(7e11, 7e12, 7e15, 0.0, 7e12),
    )  # fmt: skip
    P_set: Float[Array, ""] = param(
        "Pa", 1.5e7, 2e6, 4e7, "setting", grid=(8e6, 1.5e7, 2.5e7, 8e6)
    )
    ratio: Float[Array, ""] = param("1", 3.0, 0.5, 12.0, "pilot ratio", prior=2.0)
    # Far off: a valve that logs do not show wholly open may open further in others.
    dP_full: Float[Array, ""] = param(
        "Pa", 4e7, 5e5, 6e7, "pressure from shut to open",
        grid=(4e7, 4e7, 4e7, 1e7), prior=2e7,
    )  # fmt: skip
    tau: Float[Array, ""] = param("s", 0.05, 1e-3, 0.5, "lag of the pilot", prior=0.1)
    V_line: Float[Array, ""] = param(
        "m^3", 5e-4, 1e-5, 2e-2, "volume of a line between valve and edges", prior=5e-4
    )
    check_loss: Float[Array, ""] = param(
        "1", 0.0, 0.0, 10.0, "loss of what enters, over k", prior=1.0
    )
    check_flow: Float[Array, ""] = param(
        "m^3/s", 3e-4, 0.0, 1e-1, "flow that enters below which its loss is laminar",
        prior=1e-3,
    )  # fmt: skip

    def _opens(self, own, pilot):
        beyond = (own + self.ratio * pilot - self.P_set) / OPENED
        return jnp.clip(beyond, SHUT, self.dP_full / OPENED)

    def init(self, P_1, P_2):
        return (P_2, P_1), (self._opens(P_1, P_2), self._opens(P_2, P_1))

    def step(self, memory, P_1, P_2, h):
        """Pilot pressures at the tick's end, and the shares by their means over it."""
        fade = jnp.exp(-h / self.tau)
        mean = (1 - fade) * self.tau / h
        off = [late - now for late, now in zip(memory[0], (P_2, P_1), strict=True)]
        ends = (P_2 + fade * off[0], P_1 + fade * off[1])
        shares = (
            self._opens(P_1, P_2 + mean * off[0]),
            self._opens(P_2, P_1 + mean * off[1]),
        )
        return ends, shares

    def loss(self, memory):
        share_1, share_2 = memory[1]
        return self.k_1 / share_1**2, self.k_2 / share_2**2

    def check(self, memory):
        return self.check_loss * self.k_1, self.check_loss * self.k_2

    def check_laminar(self):
        return self.check_flow

    def volume(self):
        return self.V_line, self.V_line


class InternalLeakage(FlowEffect):
    """Laminar leakage from chamber 1 to 2 (C1): `c_il (P_a1 - P_a2)`."""

    name = "internal_leakage"
    residual_axis = "P_a1 - P_a2"
    c_il: Float[Array, ""] = param(
        "m^3/(s*Pa)", 0.0, 0.0, 1e-9, "leakage", strength=True, size=2e-13
    )

    def flow(self, at):
        q = self.c_il * (at.P_a1 - at.P_a2)
        return -q, q


class ExternalLeakage(FlowEffect):
    """Laminar leakage of each chamber to the return (C2): `c_el (P_i - P_r)`."""

    name = "external_leakage"
    residual_axis = "P_a1 + P_a2"
    c_el: Float[Array, ""] = param(
        "m^3/(s*Pa)", 0.0, 0.0, 1e-9, "leakage", strength=True, size=2e-13
    )

    def flow(self, at):
        return -self.c_el * (at.P_a1 - at.P_r), -self.c_el * (at.P_a2 - at.P_r)


class PortRelief(FlowEffect):
    """Relief valve from each chamber to the return, as mobile machines have them.

    Above its setting, in proportion to what is above: `g_i (P_i - P_r - P_seti)`.
    """

    name = "port_relief"
    residual_axis = "P_a1 + P_a2"
    g_1: Float[Array, ""] = param(
        "m^3/(s*Pa)", 0.0, 0.0, 3e-9, "flow over pressure, chamber 1", strength=True,
        size=1e-12,
    )  # fmt: skip
    g_2: Float[Array, ""] = param(
        "m^3/(s*Pa)", 0.0, 0.0, 3e-9, "flow over pressure, chamber 2", strength=True,
        size=1e-12,
    )  # fmt: skip
    P_set1: Float[Array, ""] = param(
        "Pa", 1.5e7, 2.5e6, 4.5e7, "setting, chamber 1", grid=RELIEF
    )
    P_set2: Float[Array, ""] = param(
        "Pa", 1.5e7, 2.5e6, 4.5e7, "setting, chamber 2", grid=RELIEF
    )

    def flow(self, at):
        over = (at.P_a1 - at.P_r - self.P_set1, at.P_a2 - at.P_r - self.P_set2)
        opened = [jnp.maximum(p, 0.0) for p in over]
        return -self.g_1 * opened[0], -self.g_2 * opened[1]


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
    """Free air in oil (C4): `1/beta + alpha (p_0/p)^(1/n) / (n p)`, `p` absolute."""

    name = "entrained_air"
    residual_axis = "P_a1 + P_a2"
    alpha: Float[Array, ""] = param(
        "1", 0.0, 0.0, 0.3, "air content at 1 atm", strength=True, size=2e-3
    )
    n: Float[Array, ""] = param(
        "1", 1.2, 1.0, 1.4, "polytropic exponent", prior=0.1, whole=True
    )

    def compliance(self, P: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Compliance beside 1/beta at gauge pressure `P`, 1/Pa."""
        p = jnp.maximum(P, 0.0) + P_0
        return self.alpha * power(P_0 / p, 1 / self.n) / (self.n * p)
