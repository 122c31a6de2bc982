"""Effects of the sensors: lags, gains, biases and skew of what is logged."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.effects.second_order import free_motion
from hydrojax.parameters import param, spread
from hydrojax.plant.effect import SensorChannel


class _Lag(SensorChannel):
    """First-order lag of a signal that is linear over each tick, exact."""

    def lag(self) -> Float[Array, "*batch"]:
        """The time constant, s."""
        raise NotImplementedError

    def forgets(self):
        return self.lag() <= 0

    def init(self, y, slope):
        out = y - self.lag() * slope
        return (y, out), out, slope

    def resume(self, y, slope, read):
        out = jnp.where(self.lag() > 0, read[0], y)
        return (y, out), out, read[1]

    def step(self, memory, y, h):
        before, out = memory
        tau = self.lag()
        absent = tau <= 0
        fade = jnp.where(absent, 0.0, jnp.exp(-h / jnp.where(absent, 1.0, tau)))
        drag = tau * (y - before) / h
        out = y - drag + (out - before + drag) * fade
        return (y, out), out


class LoadcellLag(_Lag):
    """First-order lag of the load cell (S1): `tau_F dF_m/dt = F - F_m`."""

    name = "loadcell_lag"
    place = "sensor_F"
    needs = ("loadcell",)
    residual_axis = "F_rate"
    tau_F: Float[Array, ""] = param(
        "s",
        0.0,
        0.0,
        0.1,
        "time constant",
        strength=True,
        size=5e-4,
        grid=spread(2e-3, 0.1, 5),
    )

    def lag(self):
        return self.tau_F


class _Gain(SensorChannel):
    """A reading that is off by a factor."""

    eps: Float[Array, ""]

    def forgets(self):
        return True

    def init(self, y, slope):
        return (), (1 + self.eps) * y, (1 + self.eps) * slope

    def step(self, memory, y, h):
        return memory, (1 + self.eps) * y


class LoadcellGain(_Gain):
    """Gain error of the load cell (S3): `F_m = (1 + eps) F`."""

    name = "loadcell_gain"
    place = "sensor_F"
    needs = ("loadcell",)
    residual_axis = "F"
    eps: Float[Array, ""] = param(
        "1", 0.0, -0.5, 0.5, "gain error", strength=True, size=0.01
    )


class _Offset(SensorChannel):
    """A reading that is off by a constant."""

    b: Float[Array, ""]

    def forgets(self):
        return True

    def init(self, y, slope):
        return (), y + self.b, slope

    def step(self, memory, y, h):
        return memory, y + self.b


class LoadcellBias(_Offset):
    """Constant error of the load cell (S2): `F_m = F + b`.

    Where friction stays at rest it is the same as `k_0` of the other sign, and is not
    named; in the paper's model, where `k_0` fades at rest, this does not.
    """

    name = "loadcell_bias"
    place = "sensor_F"
    needs = ("loadcell",)
    residual_axis = "v"
    b: Float[Array, ""] = param("N", 0.0, -1e4, 1e4, "bias", strength=True, size=10.0)


class PressureSensorLag(_Lag):
    """First-order lag of both pressure sensors (S5): `tau_P dP_m/dt = P - P_m`."""

    name = "pressure_sensor_lag"
    place = "sensor_P"
    needs = ("u", "P_a1", "P_a2")
    residual_axis = "P_rate"
    tau_P: Float[Array, ""] = param(
        "s",
        0.0,
        0.0,
        0.1,
        "time constant",
        strength=True,
        size=5e-4,
        grid=spread(2e-3, 0.1, 5),
    )

    def lag(self):
        return self.tau_P


class SignalFilter(SensorChannel):
    """Second-order low-pass of every logged pressure: the logger's, not the rig's; in
    all logs, or in those that the key `logs` of a rig file names.

    P_s may be one of them, by the share `s`: what stood ahead of the filter is had from
    the reading's own first two derivatives.

    Exact for a signal that is linear over each tick. Stored as `tau = 1/omega` so that
    absent is 0.
    """

    of_the_logger = True
    name = "signal_filter"
    place = "sensor_P"
    needs = ("u", "P_a1", "P_a2")
    residual_axis = "P_rate"
    tau: Float[Array, ""] = param(
        "s",
        0.0,
        0.0,
        0.5,
        "filter's natural frequency",
        strength=True,
        size=5e-3,
        minimum=8e-3,
        grid=(0.02, 0.1),
        outside=("omega", "rad/s"),
    )
    zeta: Float[Array, ""] = param(
        "1", 0.7, 0.3, 3.0, "filter's damping ratio", prior=0.2
    )
    s: Float[Array, ""] = param(
        "1", 1.0, 0.0, 1.0, "whether P_s passed it too: 1, or 0", prior=0.5, whole=True
    )

    def of_supply(self):
        return self.s

    def forgets(self):
        return self.tau <= 0

    def init(self, y, slope):
        late = y - 2 * self.zeta * self.tau * slope
        return (y, late, slope * self.tau), late, slope

    def ahead(self, y, slope, bend):
        return y + self.tau * (2 * self.zeta * slope + self.tau * bend)

    def resume(self, y, slope, read):
        out = jnp.where(self.tau > 0, read[0], y)
        return (y, out, read[1] * self.tau), out, read[1]

    def step(self, memory, y, h):
        before, out, rate = memory  # the reading, and its rate times tau
        slope = (y - before) / h
        behind = 2 * self.zeta * self.tau * slope
        off, moving = out - before + behind, rate - self.tau * slope
        absent = self.tau <= 0
        zeta = self.zeta
        cos, sin = (
            jnp.where(absent, 0.0, part)
            for part in free_motion(zeta, h / jnp.where(absent, 1.0, self.tau))
        )
        new = (cos + zeta * sin) * off + sin * moving
        moving = -sin * off + (cos - zeta * sin) * moving
        out = y - behind + new
        return (y, out, moving + self.tau * slope), out


class PressureSensorBias(SensorChannel):
    """Constant error of each pressure sensor (S4): `P_m = P + b`.

    A bias shifts the drive force as `k_0` does and the flows hardly, so few logs
    distinguish it from the base model's own parameters.
    """

    name = "pressure_sensor_bias"
    place = "sensor_P"
    needs = ("u", "P_a1", "P_a2")
    residual_axis = "P_a1 + P_a2"
    b_1: Float[Array, ""] = param(
        "Pa", 0.0, -2e6, 2e6, "bias of P_a1", strength=True, size=5e4
    )
    b_2: Float[Array, ""] = param(
        "Pa", 0.0, -2e6, 2e6, "bias of P_a2", strength=True, size=5e4
    )

    def of_chamber(self, i):
        return _Offset((self.b_1, self.b_2)[i])


class PressureSensorGain(SensorChannel):
    """Gain error of each pressure sensor (S4): `P_m = (1 + eps) P`."""

    name = "pressure_sensor_gain"
    place = "sensor_P"
    needs = ("u", "P_a1", "P_a2")
    residual_axis = "P_a1 + P_a2"
    eps_1: Float[Array, ""] = param(
        "1", 0.0, -0.5, 0.5, "gain error of P_a1", strength=True, size=0.01
    )
    eps_2: Float[Array, ""] = param(
        "1", 0.0, -0.5, 0.5, "gain error of P_a2", strength=True, size=0.01
    )

    def of_chamber(self, i):
        return _Gain((self.eps_1, self.eps_2)[i])


REACH = 16
"""Ticks that a late channel can reach back."""


class ChannelSkew(SensorChannel):
    """Force that is logged out of step with the other channels (S8): `F(t + tau_s)`.

    `tau_s` > 0: the reading is ahead of its time; < 0: it is late. Between ticks the
    force runs straight, as it nearly does under a held command. A replay knows what
    comes, but for a window's last ticks; a plant that steps does not, and takes what is
    early along the line of the last tick: right up to about a tick.
    """

    name = "channel_skew"
    place = "sensor_F"
    needs = ("loadcell",)
    residual_axis = "F_rate"
    counts_ticks = True
    tau_s: Float[Array, ""] = param(
        "s",
        0.0,
        -3e-3,
        3e-3,
        "F logged ahead of its time",
        strength=True,
        size=2e-4,
        grid=(-3e-3, -1.5e-3, 1.5e-3, 3e-3),
    )

    def init(self, y, slope):
        past = jnp.broadcast_to(y[..., None], (*jnp.shape(y), REACH))
        return past, y + self.tau_s * slope, slope

    def step(self, memory, y, h):
        memory = jnp.concatenate([y[..., None], memory[..., :-1]], axis=-1)
        late = jnp.minimum(jnp.broadcast_to(-self.tau_s / h, y.shape), REACH - 1)
        whole = jnp.clip(jnp.floor(late), 0, REACH - 2).astype(int)[..., None]
        newer = jnp.take_along_axis(memory, whole, axis=-1)[..., 0]
        older = jnp.take_along_axis(memory, whole + 1, axis=-1)[..., 0]
        return memory, newer + (late - whole[..., 0]) * (older - newer)

    def run(self, y, slope, h, read=None):
        t = jnp.pad(jnp.cumsum(h, axis=1), ((0, 0), (1, 0)))
        return jax.vmap(_along_lines)(y, t, t + self.tau_s), slope


def _along_lines(
    y: Float[Array, "n"], t: Float[Array, "n"], at: Float[Array, "n"]
) -> Float[Array, "n"]:
    """`y` [n] at the times `t`, read `at` others along lines, also beyond its ends."""
    i = jnp.clip(jnp.searchsorted(t, at, side="right") - 1, 0, t.size - 2)
    return y[i] + (at - t[i]) * (y[i + 1] - y[i]) / (t[i + 1] - t[i])
