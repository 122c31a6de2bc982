"""Controllers that know a nominal rig, and invert its valve."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.control.base import AbstractController, Measured, clamp
from hydrojax.plant.rig import Rig
from hydrojax.plant.valve import metering_edges

LEAST_DROP = 1e4
"""Pressure drop (Pa) below which (18) is inverted as if there were this much: the
measured pressure may touch P_s or P_r, where the valve's gain vanishes."""


class InvertingController(AbstractController):
    """A controller that asks for a virtual input, and inverts the valve for it (18).

    The virtual input is the rate of the output force that the valve is to make, over
    the bulk modulus, m^2/s, before what the piston sweeps is taken off.

    Attributes:
        nominal: the rig without effects; of it the controller uses the valve, the
            chambers' lengths (10)(11) and the areas (16).
        P_r: nominal return pressure, Pa.
    """

    nominal: eqx.AbstractVar[Rig]
    P_r: eqx.AbstractVar[Float[Array, ""]]

    def chi(self, x: Float[Array, "..."]) -> Float[Array, "..."]:
        """What (19) calls chi, 1/m.

        With two areas, `A_a chi` is `A_1/x_a1 + A_2/x_a2`, A_a their mean over the
        chambers that push.
        """
        x_1, x_2 = self.nominal.chambers.lengths(x)
        areas = self.nominal.chambers.area_1, self.nominal.chambers.area_2
        w_1, w_2 = self._pushing()
        mean = mean_area(self.nominal)
        return (w_1 * areas[0] / x_1 + w_2 * areas[1] / x_2) / mean

    def command(
        self, virtual: Float[Array, "..."], measured: Measured
    ) -> Float[Array, "..."]:
        """u* from u by (18), saturated."""
        x_1, x_2 = self.nominal.chambers.lengths(measured.x)
        w_1, w_2 = self._pushing()

        def root(drop):
            return jnp.sqrt(jnp.maximum(drop, LEAST_DROP))

        c = metering_edges(self.nominal.valve)
        up = w_1 * c.c_p1 * root(measured.P_s - measured.P_a1) / x_1
        up = up + w_2 * c.c_n2 * root(measured.P_a2 - self.P_r) / x_2
        down = w_1 * c.c_n1 * root(measured.P_a1 - self.P_r) / x_1
        down = down + w_2 * c.c_p2 * root(measured.P_s - measured.P_a2) / x_2
        u = -virtual / jnp.where(virtual < 0, up, down)
        return clamp(u, -self.u_max, self.u_max)

    def _pushing(self) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """How much of each chamber's pressure reaches P: 1, or 0 where it is open."""
        n = self.nominal
        return (
            n.force_area_1 / n.chambers.area_1,
            n.force_area_2 / n.chambers.area_2,
        )


def mean_area(rig: Rig) -> Float[Array, "..."]:
    """A_a of (16)-(23): the mean area of the chambers that push, m^2."""
    c = rig.chambers
    w_1, w_2 = rig.force_area_1 / c.area_1, rig.force_area_2 / c.area_2
    return (w_1 * c.area_1 + w_2 * c.area_2) / (w_1 + w_2)
