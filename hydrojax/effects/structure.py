"""Effects of the structure: compliance and play of the rod, mass, weight."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.parameters import param, spread
from hydrojax.plant.effect import ForceEffect, StretchEffect


class RodCompliance(StretchEffect):
    """Rod and mount that give (M3): the piston stands `F/k` ahead of the encoder.

    Stored as `1/k` so that absent is 0.
    """

    name = "rod_compliance"
    give: Float[Array, ""] = param(
        "m/N",
        0.0,
        0.0,
        1e-5,
        "stiffness of the rod",
        strength=True,
        size=5e-9,
        outside=("k", "N/m"),
    )

    def stretch(self, F):
        return self.give * F


class Backlash(StretchEffect):
    """Play of width `b` between piston and load (M4): `b/2 tanh(F/F_w)`.

    The play is crossed where F changes sign, over a force of about `F_w`.
    """

    name = "backlash"
    b: Float[Array, ""] = param(
        "m",
        0.0,
        0.0,
        5e-3,
        "width",
        strength=True,
        size=1e-5,
        grid=spread(3e-5, 5e-3, 6),
    )
    F_w: Float[Array, ""] = param(
        "N", 30.0, 2.0, 1e3, "force that crosses it", grid=(10.0, 30.0, 100.0)
    )

    def stretch(self, F):
        return 0.5 * self.b * jnp.tanh(F / self.F_w)


class PayloadInertia(ForceEffect):
    """Mass between piston and load cell (M1): `-m a`."""

    name = "payload_inertia"
    residual_axis = "a"
    m: Float[Array, ""] = param("kg", 0.0, 0.0, 1e5, "mass", strength=True, size=5.0)

    def force(self, at):
        return -self.m * at.a


class GravityLoad(ForceEffect):
    """Weight of that mass about the joint (M2): `w sin(psi + psi_0)`.

    Stored as `w_s = w cos(psi_0)` and `w_c = w sin(psi_0)`, which are linear.
    """

    name = "gravity_load"
    needs = ("F", "psi")
    residual_axis = "psi"
    radius: Float[Array, ""] = eqx.field(
        default=1.0, converter=lambda x: jnp.asarray(x, float)
    )
    w_s: Float[Array, ""] = param(
        "N", 0.0, -1e6, 1e6, "w cos(psi_0)", strength=True, size=50.0
    )
    w_c: Float[Array, ""] = param(
        "N", 0.0, -1e6, 1e6, "w sin(psi_0)", strength=True, size=50.0
    )

    def force(self, at):
        psi = at.x / self.radius
        return self.w_s * jnp.sin(psi) + self.w_c * jnp.cos(psi)
