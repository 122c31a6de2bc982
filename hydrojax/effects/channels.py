"""What composes on a signal's path: the command's way to the spool, and the sensors.

A channel maps `(memory, signal) -> (memory, signal)` over one tick and is the identity
when its strengths are zero, with a live derivative there. On the command's path the
signal is the *mean* over the step, since a chamber integrates it; a sensor's signal is
its value at the end of the tick, taken as linear in between.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from hydrojax.parameters import Effect, param

QUEUE = 16
"""Ticks of command that a delay holds: it reaches back one less, 15 ms at 1 kHz."""


class CommandChannel(Effect):
    """A channel on the valve command: `init(u) -> memory`, `step(memory, u, h)`."""

    place = "command"
    needs = ("u",)
    residual_axis = "u"

    def init(self, u: Array) -> Any:
        """Memory at rest under the command `u`."""
        return ()

    def step(self, memory, u: Array, h: Array):
        """One step of length `h`: new memory and the mean of the output over it."""
        raise NotImplementedError

    def parts(self, memory, us: list[Array], h: Array):
        """A tick cut into steps of length `h`: new memory, and each step's mean."""
        out = []
        for u in us:
            memory, u = self.step(memory, u, h)
            out.append(u)
        return memory, out


class ValveDelay(CommandChannel):
    """`u(t - tau_u)` of a held command (V13); exact for the mean over a step.

    It is first on the command's path, where the command is the same in all parts of a
    tick: so it needs to remember ticks only, and what the others make of a command
    they make of a late one.
    """

    name = "valve_delay"
    residual_axis = "u_rate"
    tau_u: Array = param(
        "s", 0.0, 0.0, 0.011, "command delay", strength=True, size=1e-3
    )

    def init(self, u):
        return jnp.broadcast_to(u[..., None], (*jnp.shape(u), QUEUE))

    def step(self, memory, u, h):
        memory, (u,) = self.parts(memory, [u], h)
        return memory, u

    def parts(self, memory, us, h):
        u, n = us[0], len(us)
        memory = jnp.concatenate([u[..., None], memory[..., :-1]], axis=-1)
        # No further back than the queue: a longer delay reads its oldest command.
        steps = jnp.minimum(jnp.broadcast_to(self.tau_u / h, u.shape), n * (QUEUE - 1))
        whole = jnp.floor(steps)
        share = (steps - whole)[..., None]
        # Each part is a mean of two held commands, its own and the one a part older.
        back = jnp.arange(n, -1, -1) + whole[..., None].astype(int)
        held = jnp.take_along_axis(memory, jnp.minimum(back // n, QUEUE - 1), axis=-1)
        mean = held[..., 1:] + share * (held[..., :-1] - held[..., 1:])
        return memory, [mean[..., i] for i in range(n)]


class ValveBias(CommandChannel):
    """`u + u_0` (V6)."""

    name = "valve_bias"
    u_0: Array = param("{u}", 0.0, -3.0, 3.0, "null bias", strength=True, size=0.05)

    def step(self, memory, u, h):
        return memory, u + self.u_0


class ValveHysteresis(CommandChannel):
    """Play of half-width `u_h` (V7): the output moves only when pushed."""

    name = "valve_hysteresis"
    residual_axis = "u_rate"
    u_h: Array = param(
        "{u}", 0.0, 0.0, 2.0, "half-width of the play", strength=True, size=0.05
    )

    def init(self, u):
        return u

    def step(self, memory, u, h):
        # Where nothing pushes the memory stays, its derivative with it: at u_h = 0
        # that is the one-sided derivative, which a clip would halve.
        lag = memory - u
        stay = jnp.where(lag < -self.u_h, u - self.u_h, memory)
        out = jnp.where(lag > self.u_h, u + self.u_h, stay)
        return out, out


class ValveRateLimit(CommandChannel):
    """Spool that moves no faster than `r_v` (V2); exact for the mean over a step.

    Stored as `slew = 1/r_v` so that absent is 0: under a held command the spool runs
    along a ramp, and the area it loses, `slew du abs(du) / 2`, is linear in `slew`.
    """

    name = "valve_rate_limit"
    residual_axis = "u_rate"
    slew: Array = param(
        "s/{u}",
        0.0,
        0.0,
        0.2,
        "largest rate of the spool",
        strength=True,
        size=2e-3,
        grid=(1e-2,),
        outside=("r_v", "{u}/s"),
    )

    def init(self, u):
        return u

    def step(self, memory, u, h):
        gap = u - memory
        size = jnp.abs(gap)
        need = self.slew * size  # seconds to get there
        late = need > h
        slew = jnp.where(late, self.slew, 1.0)
        way = jnp.where(gap < 0, -1.0, 1.0) * h / slew
        end = jnp.where(late, memory + way, u)
        ramp = u - 0.5 * gap * need / h
        return end, jnp.where(late, memory + way / 2, ramp)


class ValveLag(CommandChannel):
    """Second-order spool (V1), exact for a held command and averaged over the tick.

    Stored as `tau = 1/omega` so that absent is 0. The mean over the tick keeps the
    derivative alive there, which the value at the tick's end would not. `zeta` is
    taken up to 1: a slower spool than critical is seen as critical.
    """

    name = "valve_lag"
    residual_axis = "u_rate"
    tau: Array = param(
        "s",
        0.0,
        0.0,
        0.05,
        "spool natural frequency",
        strength=True,
        size=5e-4,
        outside=("omega", "rad/s"),
    )
    zeta: Array = param("1", 0.7, 0.2, 0.99, "spool damping ratio", prior=0.2)

    def init(self, u):
        return u, jnp.zeros_like(u)

    def step(self, memory, u, h):
        y, rate = memory  # the spool's place, and its rate times tau
        off = y - u
        absent = self.tau <= 0
        s = h / jnp.where(absent, 1.0, self.tau)
        zeta = jnp.clip(self.zeta, 0.0, 0.999)
        w = jnp.sqrt(1 - zeta**2)
        fade = jnp.where(absent, 0.0, jnp.exp(-zeta * s))
        cos, sin = fade * jnp.cos(w * s), fade * jnp.sin(w * s) / w
        off_new = (cos + zeta * sin) * off + sin * rate
        rate_new = -sin * off + (cos - zeta * sin) * rate
        # Integral of the offset over the tick, from A^-1 (e^{Ah} - 1).
        area = self.tau * (2 * zeta * (off - off_new) + (rate - rate_new))
        return (u + off_new, rate_new), u + area / h


class ValveDeadband(CommandChannel):
    """Overlap of the lands (V4), a width of its own on each side."""

    name = "valve_deadband"
    u_dbp: Array = param(
        "{u}", 0.0, 0.0, 5.0, "overlap, u > 0", strength=True, size=0.05
    )
    u_dbn: Array = param(
        "{u}", 0.0, 0.0, 5.0, "overlap, u < 0", strength=True, size=0.05
    )

    def step(self, memory, u, h):
        up = jnp.where(u > self.u_dbp, u - self.u_dbp, 0.0)
        return memory, up + jnp.where(u < -self.u_dbn, u + self.u_dbn, 0.0)


class SensorChannel(Effect):
    """A channel on a sensor: `init(y, slope)`, `step(memory, y, h)`.

    A channel at `sensor_P` stands on both gauges; where they differ, `of_chamber`
    says which channel a gauge has.
    """

    def of_chamber(self, i: int) -> SensorChannel:
        """This channel as the gauge of chamber 1 (`i` = 0) or 2 (`i` = 1) has it."""
        return self

    def init(self, y: Array, slope: Array) -> tuple[Any, Array, Array]:
        """Memory, reading and the reading's slope after a long run along a line."""
        return (), y, slope

    def step(self, memory, y: Array, h: Array):
        """One tick of length `h` at whose end the signal is `y`: memory, reading."""
        raise NotImplementedError

    def scenario(self, y: Array, slope: Array, h: Array) -> tuple[Array, Array]:
        """Readings of a known course `y` [W, n], from the first tick on.

        `slope` [W] is how it ran before, `h` [W, n-1] the ticks. Returns the readings
        and how they ran before.
        """
        memory, first, slope = self.init(y[:, 0], slope)
        _, rest = jax.lax.scan(
            lambda m, tick: self.step(m, *tick), memory, (y[:, 1:].T, h.T)
        )
        return jnp.concatenate([first[:, None], rest.T], axis=1), slope


class _Lag(SensorChannel):
    """First-order lag of a signal that is linear over each tick, exact."""

    def lag(self) -> Array:
        """The time constant, s."""
        raise NotImplementedError

    def init(self, y, slope):
        out = y - self.lag() * slope
        return (y, out), out, slope

    def step(self, memory, y, h):
        before, out = memory
        tau = self.lag()
        absent = tau <= 0
        fade = jnp.where(absent, 0.0, jnp.exp(-h / jnp.where(absent, 1.0, tau)))
        drag = tau * (y - before) / h
        out = y - drag + (out - before + drag) * fade
        return (y, out), out


class LoadcellLag(_Lag):
    """First-order lag of the load cell (S1)."""

    name = "loadcell_lag"
    place = "sensor_F"
    needs = ("loadcell",)
    residual_axis = "F_rate"
    tau_F: Array = param("s", 0.0, 0.0, 0.1, "time constant", strength=True, size=5e-4)

    def lag(self):
        return self.tau_F


class LoadcellGain(SensorChannel):
    """Gain error of the load cell (S3): `F_m = (1 + eps) F`."""

    name = "loadcell_gain"
    place = "sensor_F"
    needs = ("loadcell",)
    residual_axis = "F"
    eps: Array = param("1", 0.0, -0.5, 0.5, "gain error", strength=True, size=0.01)

    def init(self, y, slope):
        return (), (1 + self.eps) * y, (1 + self.eps) * slope

    def step(self, memory, y, h):
        return memory, (1 + self.eps) * y


class PressureSensorLag(_Lag):
    """First-order lag of both pressure sensors (S5)."""

    name = "pressure_sensor_lag"
    place = "sensor_P"
    needs = ("u", "P_a1", "P_a2")
    residual_axis = "P_rate"
    tau_P: Array = param("s", 0.0, 0.0, 0.1, "time constant", strength=True, size=5e-4)

    def lag(self):
        return self.tau_P


class _Offset(SensorChannel):
    """A reading that is off by a constant."""

    b: Array

    def init(self, y, slope):
        return (), y + self.b, slope

    def step(self, memory, y, h):
        return memory, y + self.b


class PressureSensorBias(SensorChannel):
    """Constant error of each pressure sensor (S4): `P_m = P + b`.

    A bias shifts the drive force as `k_0` does and the flows hardly, so few logs tell
    it from the base model's own parameters.
    """

    name = "pressure_sensor_bias"
    place = "sensor_P"
    needs = ("u", "P_a1", "P_a2")
    residual_axis = "P_a1 + P_a2"
    b_1: Array = param("Pa", 0.0, -2e6, 2e6, "bias of P_a1", strength=True, size=5e4)
    b_2: Array = param("Pa", 0.0, -2e6, 2e6, "bias of P_a2", strength=True, size=5e4)

    def of_chamber(self, i):
        return _Offset((self.b_1, self.b_2)[i])


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
    tau_s: Array = param(
        "s", 0.0, -3e-3, 3e-3, "F logged ahead of its time", strength=True, size=2e-4
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

    def scenario(self, y, slope, h):
        t = jnp.pad(jnp.cumsum(h, axis=1), ((0, 0), (1, 0)))
        return jax.vmap(_along_lines)(y, t, t + self.tau_s), slope


def _along_lines(y: Array, t: Array, at: Array) -> Array:
    """`y` [n] at the times `t`, read `at` others along lines, also beyond its ends."""
    i = jnp.clip(jnp.searchsorted(t, at, side="right") - 1, 0, t.size - 2)
    return y[i] + (at - t[i]) * (y[i + 1] - y[i]) / (t[i + 1] - t[i])
