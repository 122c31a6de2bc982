"""The adaptive output-force law of the paper, sampled: (18), (23)-(30).

SI inside: `u` of (23) is the virtual input in m^2/s, so that the gains carry
m^2/(s N). The paper prints them in volts per kN; the door (`build`) multiplies by the
nominal valve gain once.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.control.base import (
    AbstractController,
    Estimates,
    Gain,
    Measured,
    clamp,
    gain,
)
from hydrojax.control.inverting import InvertingController, mean_area
from hydrojax.plant.friction import Theta
from hydrojax.plant.rig import Rig

VALVE_GAIN = Gain(
    "m^2/(s*V)", math.nan, 0.0, math.inf,
    "nominal valve gain: virtual input per volt of the law", key="kappa", positive=True,
)  # fmt: skip
"""What turns the volts of the paper's gains (`Gain.volts`) into SI. By default it is
such that `VOLT_SECONDS_PER_KILONEWTON` is 1/beta."""

VOLT_SECONDS_PER_KILONEWTON = 0.01
"""The paper's k_1. With the default valve gain this is 1/beta of any rig: the paper's
gains then make a loop of 360 rad/s on it."""


class Memory(NamedTuple):
    """What the law remembers between samples, SI."""

    estimates: Estimates
    x: Float[Array, "*batch"]
    v: Float[Array, "*batch"]
    z: Float[Array, "*batch"]
    speed: Float[Array, "*batch"]
    P_d: Float[Array, "*batch"]
    P_d_rate: Float[Array, "*batch"]


class ControllerSignals(NamedTuple):
    """What the law made of one sample: the signals of (23)-(25), SI."""

    P: Float[Array, "*batch"]
    P_d: Float[Array, "*batch"]
    P_d_rate: Float[Array, "*batch"]
    v: Float[Array, "*batch"]
    swept: Float[Array, "*batch"]
    virtual: Float[Array, "*batch"]


class Safeguards(eqx.Module):
    """What keeps an adaptation from drifting, beside its bounds; the paper has none.

    Each does nothing at its default. See P. A. Ioannou and J. Sun, Robust Adaptive
    Control, 1996, chapter 8.

    Attributes:
        dead_zone: N; an error teaches only by what it has beyond this.
        leakage: 1/s; at this rate an estimate returns to midway between its bounds.
        saturated: share of the rates that is left while the command saturates; 0 stops
            the adaptation then.
    """

    dead_zone: Float[Array, ""] = gain(
        "N", 0.0, 0.0, 1e4, "error up to which nothing is adapted"
    )
    leakage: Float[Array, ""] = gain(
        "1/s", 0.0, 0.0, 100.0, "rate at which estimates return midway"
    )
    saturated: Float[Array, ""] = gain(
        "1", 1.0, 0.0, 1.0, "share of the rates left while the command saturates"
    )

    def error(self, e: Float[Array, "..."]) -> Float[Array, "..."]:
        """What an error (N) teaches with."""
        return e - clamp(e, -self.dead_zone, self.dead_zone)

    def returned(
        self, estimates: Estimates, lower: Estimates, upper: Estimates,
        h: Float[Array, "..."],
    ) -> Estimates:  # fmt: skip
        """Estimates after `h` seconds in which nothing is learnt."""
        keep = jnp.exp(-self.leakage * h)
        ends = zip(estimates, lower, upper, strict=True)
        return Estimates(*((a + b) / 2 + keep * (e - (a + b) / 2) for e, a, b in ends))


class Law(InvertingController):
    """The controller: gains, adaptation, and the nominal rig.

    An estimate starts midway between its bounds. It is adapted where its rate is
    above zero, frozen where the rate is zero, and off where both bounds are zero.

    Attributes:
        nominal: the rig without effects, but with those of L(t); of it the law uses
            the valve (18), the chambers' lengths (10)(11), the areas (16), and z_ss,
            delta, L(t).
        k_p, k_f: m^2/(s N).
        rate: rho_1, rho_a, c_1 ... c_7 of (28)-(30), SI.
        lower, upper: the bounds of the nine estimates, SI.
        P_r: nominal return pressure, Pa.
        u_max: where the command saturates, V or 1.
        tau_d: time constant of the filtered difference that stands for the rate of
            P_d, s; 0 is the plain difference.
        tau_v: the same for the velocity from the position, s.
        safeguards: of the adaptation; None as in the paper.
    """

    nominal: Rig
    rate: Estimates
    lower: Estimates
    upper: Estimates
    P_r: Float[Array, ""]
    k_p: Float[Array, ""] = gain(
        "m^2/(s*N)", 1.4e-7, 0.0, 1e-4, "gain on the pressure error",
        written="V/kN", volts=True,
    )  # fmt: skip
    k_f: Float[Array, ""] = gain(
        "m^2/(s*N)", 2.8e-7, 0.0, 1e-4, "gain on the force error",
        written="V/kN", volts=True,
    )  # fmt: skip
    u_max: Float[Array, ""] = gain(
        "{u}", 10.0, 0.0, 100.0, "where the command saturates", positive=True
    )
    tau_d: Float[Array, ""] = gain(
        "s", 0.0, 0.0, 1.0, "time constant of the rate of P_d"
    )
    tau_v: Float[Array, ""] = gain(
        "s", 0.0, 0.0, 1.0, "time constant of the velocity from the position"
    )
    safeguards: Safeguards | None = None

    def init(self, measured: Measured, F_d: Float[Array, "..."]) -> Memory:
        """At rest, at the first sample."""
        middle = jax.tree.map(lambda a, b: (a + b) / 2, self.lower, self.upper)
        estimates = Estimates(
            *(jnp.broadcast_to(m, jnp.shape(measured.x)) for m in middle)
        )
        zero = jnp.zeros_like(measured.x)
        P_d = self.desired(estimates, zero, zero, zero, F_d)[0]
        return Memory(estimates, measured.x, zero, zero, zero, P_d, zero)

    def step(
        self,
        memory: Memory,
        measured: Measured,
        F_d: Float[Array, "..."],
        h: Float[Array, "..."],
    ) -> tuple[Memory, Float[Array, "..."], dict[str, Float[Array, "..."]]]:
        """One sample: new memory, the command u* (V or 1), and what led to it.

        Recorded are the fields of `ControllerSignals`, the nine estimates that made the
        command, and L, the switch L(t) of (22).

        The estimates of this sample make the command; what it teaches them holds from
        the next on.
        """
        dx = measured.x - memory.x
        v = (self.tau_v * memory.v + dx) / (self.tau_v + h)
        friction = self.nominal.mechanics
        keep, add = friction.bristle_map(dx)
        z = keep * memory.z + add
        keep, add = friction.speed_map(dx, h)
        speed = keep * memory.speed + add

        P_d, row = self.desired(memory.estimates, z, v, speed, F_d)
        gone = self.tau_d * memory.P_d_rate + P_d - memory.P_d
        P_d_rate = gone / (self.tau_d + h)
        P = self.nominal.drive_force(measured.P_a1, measured.P_a2)
        swept = self.chi(measured.x) * v
        k_1, A_a = memory.estimates[:2]
        virtual = (
            k_1 * P_d_rate
            + A_a * swept
            + self.k_p * (P_d - P)
            + self.k_f * (F_d - measured.F)
        )
        u = self.command(virtual, measured)
        estimates = self._adapted(
            memory.estimates, (P_d - P, F_d - measured.F), (P_d_rate, swept), row, u, h
        )
        signals = {
            **ControllerSignals(P, P_d, P_d_rate, v, swept, virtual)._asdict(),
            **memory.estimates._asdict(),
            "L": self.nominal.presliding(speed),
        }
        memory = Memory(estimates, measured.x, v, z, speed, P_d, P_d_rate)
        return memory, u, signals

    def _adapted(
        self,
        estimates: Estimates,
        errors: tuple[Float[Array, "..."], Float[Array, "..."]],
        pressure_row: tuple[Float[Array, "..."], Float[Array, "..."]],
        force_row: Theta,
        u: Float[Array, "..."],
        h: Float[Array, "..."],
    ) -> Estimates:
        """What one sample teaches: (28)-(30), errors of P and F in N."""
        guard = self.safeguards
        if guard is not None:
            left = jnp.where(jnp.abs(u) < self.u_max, 1.0, guard.saturated)
            errors = (left * guard.error(errors[0]), left * guard.error(errors[1]))
            estimates = guard.returned(estimates, self.lower, self.upper, h)
        lead = Estimates(
            *(errors[0] * y for y in pressure_row), *(errors[1] * y for y in force_row)
        )
        each = zip(estimates, lead, self.rate, self.lower, self.upper, strict=True)
        return Estimates(*(project(*one, h) for one in each))

    def desired(
        self,
        estimates: Estimates,
        z: Float[Array, "..."],
        v: Float[Array, "..."],
        speed: Float[Array, "..."],
        F_d: Float[Array, "..."],
    ) -> tuple[Float[Array, "..."], Theta]:
        """P_d (N) of (24)(25), and the row of (26) that made it."""
        L = self.nominal.presliding(speed)
        row = self.nominal.mechanics.regressor(z, v, L, F_d)
        f = sum(y * k for y, k in zip(row, estimates.theta_f, strict=True))
        return F_d + f, row


def adaptive_law(controller: AbstractController) -> Law:
    """The controller, which must be the paper's law.

    Raises:
        TypeError: it is another.
    """
    if not isinstance(controller, Law):
        raise TypeError(
            f"invalid controller {type(controller).__name__}: expected the paper's "
            "law, hydrojax.control.adaptive.Law"
        )
    return controller


def truth(rig: Rig) -> Estimates:
    """What the nine estimates are estimates of, SI: the plant's own values."""
    friction = (getattr(rig.mechanics, name) for name in Theta._fields)
    return Estimates(1 / rig.chambers.beta, mean_area(rig), *friction)


def project(
    theta: Float[Array, "..."],
    s: Float[Array, "..."],
    rate: Float[Array, "..."],
    lower: Float[Array, "..."],
    upper: Float[Array, "..."],
    h: Float[Array, "..."],
) -> Float[Array, "..."]:
    """The function P of (28)-(30) over `h` seconds: `theta' = rate s kappa`.

    kappa is 0 where theta is at a bound and s points outward: the bound itself is then
    the step's end, and a step that would cross one ends on it.
    """
    return clamp(theta + h * rate * s, lower, upper)
