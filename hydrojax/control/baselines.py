"""Controllers to compare the adaptive law with, each tuned by the same command."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.control.base import AbstractController, Measured, clamp
from hydrojax.control.inverting import InvertingController, mean_area
from hydrojax.parameters import param
from hydrojax.plant.rig import Rig

START = 20.0
"""Bandwidth at which a PI loop of a rig starts, rad/s."""

FAST = 100.0
"""The same of loops through the valve's inverse, without integral action: what the
valve's map is off by makes an error of the force that is the smaller the faster."""


class PIMemory(NamedTuple):
    """The integral of the force error (N s), and the piston's last place and speed."""

    integral: Float[Array, "*batch"]
    x: Float[Array, "*batch"]
    v: Float[Array, "*batch"]


class PIController(AbstractController):
    """Proportional-integral control of the output force with velocity feedforward.

    Attributes:
        k_p: proportional gain, V/N or 1/N.
        k_i: integral gain, V/(N s) or 1/(N s).
        k_v: command per speed of the piston, V s/m or s/m: it passes what is swept.
        tau_v: time constant of the velocity from the position, s.
        u_max: where the command saturates, V or 1; the integral then stands still.
    """

    k_p: Float[Array, ""] = param("{u}/N", 1e-3, 0.0, 1.0, "proportional gain")
    k_i: Float[Array, ""] = param("{u}/(N*s)", 1e-2, 0.0, 100.0, "integral gain")
    k_v: Float[Array, ""] = param(
        "{u}*s/m", 0.0, 0.0, 1e3, "feedforward of the piston's velocity"
    )
    tau_v: Float[Array, ""] = param(
        "s", 0.0, 0.0, 1.0, "time constant of the velocity from the position"
    )
    u_max: Float[Array, ""] = param(
        "{u}", 10.0, 0.0, 100.0, "where the command saturates"
    )

    @classmethod
    def for_rig(
        cls, nominal: Rig, line: Mapping[str, float], full: float
    ) -> PIController:
        """Gains for a rig: a slow loop, and the speed fed forward.

        Args:
            nominal: the rig without effects.
            line: `P_s` and `P_r`, Pa.
            full: the command at full opening, V or 1.
        """
        own = LinearizingController.for_rig(nominal, line, full)
        still = jnp.zeros(())
        P = jnp.asarray((line["P_s"] + line["P_r"]) / 2)
        middle = Measured(P, P, jnp.asarray(line["P_s"]), still, still)
        per_volt = -1 / own.command(jnp.ones(()) * 1e-9, middle) * 1e-9
        k_p = START / (per_volt * nominal.chambers.beta)
        swept = mean_area(nominal) * own.chi(still)
        return cls(
            k_p=k_p,
            k_i=k_p * START / 4,
            k_v=swept / per_volt,
            tau_v=jnp.asarray(TAU_V),
            u_max=jnp.asarray(full),
        )

    def init(self, measured: Measured, F_d: Float[Array, ""]) -> PIMemory:
        """No error has been integrated, and nothing moves."""
        zero = jnp.zeros_like(measured.F)
        return PIMemory(zero, measured.x, zero)

    def step(
        self,
        memory: PIMemory,
        measured: Measured,
        F_d: Float[Array, ""],
        h: Float[Array, ""],
    ) -> tuple[PIMemory, Float[Array, ""], dict[str, Float[Array, ""]]]:
        """One sample; records the error of the force, N, and the speed, m/s."""
        error = F_d - measured.F
        v = (self.tau_v * memory.v + measured.x - memory.x) / (self.tau_v + h)
        integral = memory.integral + h * error
        u = -(self.k_p * error + self.k_i * integral + self.k_v * v)
        integral = jnp.where(jnp.abs(u) < self.u_max, integral, memory.integral)
        u = clamp(u, -self.u_max, self.u_max)
        return PIMemory(integral, measured.x, v), u, {"error": error, "v": v}


TAU_V = 0.005
"""Time constant with which the velocity of a rig starts, s: an encoder's steps make a
plain difference rough."""


class LinearizingController(InvertingController):
    """Proportional control of the force through the inverse of the valve (18).

    The force error asks for a rate of the force, the piston's sweep is added, and the
    measured pressures say what command makes that flow. Nothing is adapted, and no
    friction is known.

    Attributes:
        nominal: the rig without effects: valve, lengths, areas, bulk modulus.
        P_r: nominal return pressure, Pa.
        k_e: rate at which an error of the force dies away, 1/s.
        k_v: share of the piston's sweep that is fed forward.
        tau_v: time constant of the velocity from the position, s.
        u_max: where the command saturates, V or 1.
    """

    nominal: Rig
    P_r: Float[Array, ""]
    k_e: Float[Array, ""] = param("1/s", FAST, 0.0, 1e3, "rate of the force error")
    k_v: Float[Array, ""] = param(
        "1", 1.0, 0.0, 2.0, "share of the piston's sweep fed forward"
    )
    tau_v: Float[Array, ""] = param(
        "s", TAU_V, 0.0, 1.0, "time constant of the velocity from the position"
    )
    u_max: Float[Array, ""] = param(
        "{u}", 10.0, 0.0, 100.0, "where the command saturates"
    )

    @classmethod
    def for_rig(
        cls, nominal: Rig, line: Mapping[str, float], full: float
    ) -> LinearizingController:
        """The controller of a rig; see `PIController.for_rig`."""
        P_r = jnp.asarray(line["P_r"], float)
        return cls(nominal=nominal, P_r=P_r, u_max=jnp.asarray(full))

    def init(self, measured: Measured, F_d: Float[Array, ""]) -> Any:
        """The piston's place and speed: it stands."""
        return measured.x, jnp.zeros_like(measured.x)

    def step(
        self,
        memory: Any,
        measured: Measured,
        F_d: Float[Array, ""],
        h: Float[Array, ""],
    ) -> tuple[Any, Float[Array, ""], dict[str, Float[Array, ""]]]:
        """One sample; records the error of the force, N, and the virtual input."""
        v = (self.tau_v * memory[1] + measured.x - memory[0]) / (self.tau_v + h)
        error = F_d - measured.F
        virtual = self.virtual(self.k_e * error, measured, v)
        u = self.command(virtual, measured)
        return (measured.x, v), u, {"error": error, "virtual": virtual}

    def virtual(
        self, rate: Float[Array, ""], measured: Measured, v: Float[Array, ""]
    ) -> Float[Array, ""]:
        """The virtual input (m^2/s) for a rate of the force (N/s) at a speed."""
        swept = mean_area(self.nominal) * self.chi(measured.x) * v
        return rate / self.nominal.chambers.beta + self.k_v * swept


class BacksteppingMemory(NamedTuple):
    """The piston's place and speed, F_d and its rate, the spool as wanted, its rate,
    and the spool as the model has it.
    """

    x: Float[Array, "*batch"]
    v: Float[Array, "*batch"]
    F_d: Float[Array, "*batch"]
    F_d_rate: Float[Array, "*batch"]
    wanted: Float[Array, "*batch"]
    wanted_rate: Float[Array, "*batch"]
    spool: Float[Array, "*batch"]


class BacksteppingController(LinearizingController):
    """Backstepping control of the force over a spool of first order.

    The spool that makes `F' = F_d' + k_e (F_d - F)` is wanted; the command makes the
    spool go there at the rate `k_x`, by the inverse of its lag `tau_s`. With the term
    `k_c`, `e^2 / 2` and a multiple of the spool error's square are together a Lyapunov
    function. As in N. Nakkarat and S. Kuntanapreeda, Control Engineering Practice 17,
    2009, with the spool from its model and the valve's inverse (18).

    Attributes:
        k_x: rate at which the spool's error dies away, 1/s.
        k_c: command per force error, V/N or 1/N.
        tau_s: time constant of the spool, s.
        tau_d: time constant of the two derivatives, s.
    """

    k_x: Float[Array, ""] = param("1/s", 200.0, 0.0, 1e4, "rate of the spool's error")
    k_c: Float[Array, ""] = param("{u}/N", 0.0, 0.0, 1.0, "coupling of the two errors")
    tau_s: Float[Array, ""] = param("s", 0.003, 1e-4, 1.0, "time constant of the spool")
    tau_d: Float[Array, ""] = param(
        "s", 0.005, 0.0, 1.0, "time constant of the derivatives"
    )

    def init(self, measured: Measured, F_d: Float[Array, ""]) -> BacksteppingMemory:
        """At rest, the spool where it is wanted."""
        zero = jnp.zeros_like(measured.x)
        error = F_d - measured.F
        spool = self.command(self.virtual(self.k_e * error, measured, zero), measured)
        return BacksteppingMemory(
            measured.x, zero, F_d + zero, zero, spool, zero, spool
        )

    def step(
        self,
        memory: BacksteppingMemory,
        measured: Measured,
        F_d: Float[Array, ""],
        h: Float[Array, ""],
    ) -> tuple[BacksteppingMemory, Float[Array, ""], dict[str, Float[Array, ""]]]:
        """One sample; records the force error (N), the spool wanted and modelled."""

        def slope(tau, before, now, then):
            return (tau * before + now - then) / (tau + h)

        v = slope(self.tau_v, memory.v, measured.x, memory.x)
        F_d_rate = slope(self.tau_d, memory.F_d_rate, F_d, memory.F_d)
        error = F_d - measured.F
        virtual = self.virtual(F_d_rate + self.k_e * error, measured, v)
        wanted = self.command(virtual, measured)
        rate = slope(self.tau_d, memory.wanted_rate, wanted, memory.wanted)
        gone = wanted - memory.spool
        u = memory.spool + self.tau_s * (rate + self.k_x * gone) - self.k_c * error
        u = clamp(u, -self.u_max, self.u_max)
        spool = u + jnp.exp(-h / self.tau_s) * (memory.spool - u)
        memory = BacksteppingMemory(
            measured.x, v, F_d + jnp.zeros_like(v), F_d_rate, wanted, rate, spool
        )
        return memory, u, {"error": error, "wanted": wanted, "spool": spool}
