"""Effects of friction: on the Coulomb level, beside it, and on the speed it sees."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.parameters import param, spread
from hydrojax.plant.effect import (
    FrictionForce,
    HysteresisForce,
    LevelEffect,
    SpeedEffect,
    SwitchEffect,
)


class Stribeck(LevelEffect):
    """Rise of the Coulomb level near standstill (F2): `k_st exp(-(v/v_s)^2)`."""

    name = "stribeck"
    residual_axis = "v"
    k_st: Float[Array, ""] = param("N", 0.0, 0.0, 1e4, "rise", strength=True, size=50.0)
    v_s: Float[Array, ""] = param(
        "m/s", 5e-3, 3e-4, 0.1, "Stribeck speed", grid=(1.5e-3, 5e-3, 1.5e-2)
    )

    def level(self, at, base):
        return self.k_st * jnp.exp(-((at.v / self.v_s) ** 2))


class PressureFriction(LevelEffect):
    """Seal friction that grows with pressure (F5): `(kappa + kappa_v abs(v)) P`.

    `P` is the mean of the pressures that push on the piston: `(P_a1 + P_a2) / 2`, or
    the one pressure of a cylinder with an open chamber. A seal knows no supply.
    """

    name = "pressure_friction"
    needs = ("F", "P_a2")
    residual_axis = "P_a1 + P_a2"
    kappa: Float[Array, ""] = param(
        "N/Pa", 0.0, -1e-3, 1e-3, "growth of the level", strength=True, size=5e-6
    )
    kappa_v: Float[Array, ""] = param(
        "N*s/(m*Pa)",
        0.0,
        -1e-2,
        1e-2,
        "growth of viscous friction",
        strength=True,
        size=5e-5,
    )

    def level(self, at, base):
        return (self.kappa + self.kappa_v * jnp.abs(at.v)) * at.P_seal


def _wave(description: str) -> Any:
    return param("1", 0.0, -1.5, 1.5, description, strength=True, size=0.05, prior=0.5)


class PositionFriction(LevelEffect):
    """Coulomb level that varies along the stroke (F6): a wave and two overtones.

    Times `1 + sum_k s_k sin(k y) + c_k cos(k y)`, k = 1 to 3, with
    `y = 2 pi waves (x - x_mid) / (x_to - x_from)`.

    The wavelength is free, so that a bore's own wave is met exactly; at twice the
    travel the three waves follow any smooth profile. `x_from` and `x_to` are the
    travel (m), of the logs that are fitted.
    """

    name = "position_friction"
    residual_axis = "x"
    x_from: Float[Array, ""] = eqx.field(
        default=-0.1, converter=lambda x: jnp.asarray(x, float)
    )
    x_to: Float[Array, ""] = eqx.field(
        default=0.1, converter=lambda x: jnp.asarray(x, float)
    )
    s_1: Float[Array, ""] = _wave("sine")
    c_1: Float[Array, ""] = _wave("cosine")
    s_2: Float[Array, ""] = _wave("sine, first overtone")
    c_2: Float[Array, ""] = _wave("cosine, first overtone")
    s_3: Float[Array, ""] = _wave("sine, second overtone")
    c_3: Float[Array, ""] = _wave("cosine, second overtone")
    waves: Float[Array, ""] = param(
        "1", 1.0, 0.3, 5.0, "waves in the travel", grid=(0.5, 1.0, 2.0)
    )

    def level(self, at, base):
        half = (self.x_to + self.x_from) / 2
        angle = 2 * jnp.pi * self.waves * (at.x - half) / (self.x_to - self.x_from)
        s, c = jnp.sin(angle), jnp.cos(angle)
        s2, c2 = 2 * s * c, c * c - s * s
        wave = self.s_1 * s + self.c_1 * c + self.s_2 * s2 + self.c_2 * c2
        return base * (
            wave + self.s_3 * (s2 * c + c2 * s) + self.c_3 * (c2 * c - s2 * s)
        )


class FrictionDrift(LevelEffect):
    """Coulomb level that drifts (F11): times `1 + a (exp(-t/tau) - 1)`."""

    name = "friction_drift"
    residual_axis = "t"
    a: Float[Array, ""] = param("1", 0.0, -3.0, 3.0, "drift", strength=True, size=0.05)
    tau: Float[Array, ""] = param(
        "s", 10.0, 0.5, 1e3, "time constant", grid=(3.0, 10.0, 40.0)
    )

    def level(self, at, base):
        return base * self.a * jnp.expm1(-at.t / self.tau)


class MaxwellSlip(HysteresisForce):
    """Friction behind a spring and a play (F8): a Maxwell slip element.

    After a turn nothing is felt until the play is crossed, then the force rises in
    proportion up to `f_p` (toward positive x) or `-f_n`, where the element slides. It
    is `z_m` away from the middle then, of which the share `gap` is play. It holds its
    force at rest.
    """

    name = "maxwell_slip"
    f_p: Float[Array, ""] = param(
        "N", 0.0, 0.0, 1e5, "force as it slides, v > 0", strength=True, size=500.0
    )
    f_n: Float[Array, ""] = param(
        "N", 0.0, 0.0, 1e5, "force as it slides, v < 0", strength=True, size=500.0
    )
    z_m: Float[Array, ""] = param(
        "m", 1e-4, 1e-6, 0.05, "deflection as it slides", grid=spread(1e-4, 1e-2, 4)
    )
    gap: Float[Array, ""] = param(
        "1", 0.3, 0.0, 0.95, "share of it that is play", grid=(0.0, 0.5)
    )

    def reach(self):
        return self.z_m

    def force(self, w):
        of = (jnp.abs(w) / self.z_m - self.gap) / (1 - self.gap)
        return jnp.where(w > 0, self.f_p, -self.f_n) * jnp.maximum(of, 0.0)

    def deflection(self, f):
        most = jnp.where(f > 0, self.f_p, self.f_n)
        share = jnp.abs(f) / jnp.where(most > 0, most, 1.0)
        share = jnp.where(most > 0, jnp.minimum(share, 1.0), 1.0)
        # A force near none does not say on which side of the play it stands.
        play = self.gap * jnp.minimum(share / 0.05, 1.0)
        return jnp.sign(f) * self.z_m * (play + (1 - self.gap) * share)


class ViscousFriction(FrictionForce):
    """Viscous friction (F1): `b v` in sliding, `s b v` in presliding.

    With `s = 1` it stands beside all the paper's friction; with `s = 0` it fades with
    the sliding friction, and is the same as a `k_vp` and `k_vn` of `-b`. Where these
    are free, the logs tell `s b` only, and `s` is had from its prior.
    """

    name = "viscous_friction"
    residual_axis = "v"
    b: Float[Array, ""] = param(
        "N*s/m", 0.0, -1e6, 1e6, "viscous", strength=True, size=300.0
    )
    s: Float[Array, ""] = param(
        "1",
        1.0,
        0.0,
        1.0,
        "share of it in presliding",
        prior=0.5,
        grid=(1.0, 0.0),
        whole=True,
    )

    def force(self, at):
        return self.b * at.v

    def at_rest(self, at):
        return self.s * self.b * at.v


class FilmFriction(FrictionForce):
    """Friction of a lubricating film, that grows with a power of the speed.

    `sign(v) (abs(v) / v_0)^n (k_h + kappa_h P)` with `v_0` = 10 mm/s; `P` as for
    `pressure_friction`. Of a soft seal that rides on its film n is 1/2 (Blok's inverse
    theory of hydrodynamic lubrication). Below 0.1 mm/s it is in proportion to the
    speed. Beside a free `k_vp` or `k_vn`, speeds that differ little tell only the sum
    of both, and not n.
    """

    name = "film_friction"
    residual_axis = "v"
    k_h: Float[Array, ""] = param(
        "N", 0.0, 0.0, 1e5, "at 10 mm/s", strength=True, size=50.0
    )
    kappa_h: Float[Array, ""] = param(
        "N/Pa", 0.0, 0.0, 1e-3, "growth with pressure", strength=True, size=5e-6
    )
    n: Float[Array, ""] = param("1", 0.5, 0.05, 0.9, "exponent", grid=(0.2, 0.5, 0.75))

    def force(self, at):
        s = at.v / 0.01
        # A power below 1 has no slope at standstill: it is rounded over 0.1 mm/s.
        grown = s * (s * s + 1e-4) ** ((self.n - 1) / 2)
        return grown * (self.k_h + self.kappa_h * at.P_seal)


class BristleDamping(FrictionForce):
    """Damping of the bristles `sigma_1 dz/dt` (F3), dropped in Remark 2.1."""

    name = "bristle_damping"
    residual_axis = "z_rate"
    sigma_1: Float[Array, ""] = param(
        "N*s/m", 0.0, 0.0, 1e7, "damping", strength=True, size=5e3
    )

    def force(self, at):
        return self.sigma_1 * at.z_rate


class FrictionAtRest(SwitchEffect):
    """Friction that stays at rest (F9): the switch L(t) is `1 - s` times the paper's.

    In the paper's model friction fades as the piston comes to rest, and a share of the
    output force takes its place. Most cylinders hold their friction there: with
    `s = 1` it is that of the bristles (Dahl's model; with `stribeck` and
    `bristle_damping` LuGre's), and `k_fp` and `k_fn` act on nothing.
    """

    name = "friction_at_rest"
    residual_axis = "v"
    s: Float[Array, ""] = param(
        "1",
        0.0,
        0.0,
        1.0,
        "share that does not fade",
        strength=True,
        size=0.1,
        grid=(1.0,),
        whole=True,
    )

    def presliding(self, L):
        return (1 - self.s) * L


class FrictionalLag(SpeedEffect):
    """Friction that follows the speed with a lag (F4), as an oil film's thickness.

    The Coulomb level and what raises it (Stribeck) see the film, whose speed follows
    `abs(v)` with `tau_h`; the bristle does not. Friction that goes with the velocity
    (k_v, viscous) sees the share `k` of the lag. As the motion turns it turns with the
    bristle, and the share `s` of it with the velocity, all at once. The film depends on
    motion alone, long before a window begins, so it is run once over a whole log.
    """

    name = "frictional_lag"
    residual_axis = "a"
    tau_h: Float[Array, ""] = param(
        "s",
        0.0,
        0.0,
        0.5,
        "time constant",
        strength=True,
        size=5e-3,
        minimum=1e-3,
        grid=(0.03, 0.15),
    )
    k: Float[Array, ""] = param(
        "1", 1.0, 0.0, 1.0, "share of it in friction that goes with v",
        prior=0.5, grid=(1.0, 1.0, 0.0), whole=True,
    )  # fmt: skip
    s: Float[Array, ""] = param(
        "1", 0.0, 0.0, 1.0, "share of k that turns with v",
        prior=0.5, grid=(0.0, 1.0, 0.0), whole=True,
    )  # fmt: skip

    def turns(self):
        return self.k * (1 - self.s), self.k * self.s

    def follow(
        self,
        before: Float[Array, "*batch"],
        now: Float[Array, "*batch"],
        h: Float[Array, "*batch"],
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """The film's step as `w -> keep w + add`, exact for a speed along a line.

        The speed (m/s) goes from `before` to `now` within `h` seconds.
        """
        absent = self.tau_h <= 0
        keep = jnp.where(absent, 0.0, jnp.exp(-h / jnp.where(absent, 1.0, self.tau_h)))
        late = self.tau_h * (now - before) / h
        return keep, now - late - keep * (before - late)
