"""Controllers to compare the adaptive law with."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.control.base import AbstractController, Measured, clamp
from hydrojax.parameters import param


class PIController(AbstractController):
    """Proportional-integral control of the output force, with anti-windup.

    Attributes:
        k_p: proportional gain, V/N or 1/N.
        k_i: integral gain, V/(N s) or 1/(N s).
        u_max: where the command saturates, V or 1; the integral then stands still.
    """

    k_p: Float[Array, ""] = param("{u}/N", 1e-3, 0.0, 1.0, "proportional gain")
    k_i: Float[Array, ""] = param("{u}/(N*s)", 1e-2, 0.0, 100.0, "integral gain")
    u_max: Float[Array, ""] = param(
        "{u}", 10.0, 0.0, 100.0, "where the command saturates"
    )

    def init(self, measured: Measured, F_d: Float[Array, ""]) -> Float[Array, ""]:
        """No error has been integrated, N s."""
        return jnp.zeros_like(measured.F)

    def step(
        self,
        memory: Float[Array, ""],
        measured: Measured,
        F_d: Float[Array, ""],
        h: Float[Array, ""],
    ) -> tuple[Float[Array, ""], Float[Array, ""], dict[str, Float[Array, ""]]]:
        """One sample; records the error of the force, N."""
        error = F_d - measured.F
        integral = memory + h * error
        u = -(self.k_p * error + self.k_i * integral)
        memory = jnp.where(jnp.abs(u) < self.u_max, integral, memory)
        return memory, clamp(u, -self.u_max, self.u_max), {"error": error}
