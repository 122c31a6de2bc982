"""Effects of the valve: on the command's path to the spool, and on its edges."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.effects.second_order import free_motion
from hydrojax.parameters import param, spread
from hydrojax.plant.effect import (
    CommandChannel,
    CommandDelay,
    LastingChannel,
    OrificeEffect,
    ReturnEdgeEffect,
    Spool,
    SpoolLimit,
)
from hydrojax.plant.friction import run_stop
from hydrojax.plant.powers import power

QUEUE = 16
"""Ticks of command that a delay holds in a plant that steps, unless told otherwise: it
reaches back one less."""

LONGEST = 0.15
"""The longest delay, s: a field bus, a soft controller and a slow pilot together."""


LEAST = 1e-9
"""Movement of a command that a play of no width sees ({u}), and share of a play's
half-width that none does: what is less is rounding."""


class ValveDelay(CommandDelay):
    """`u(t - tau_u)` of a held command (V13); exact for the mean over a step.

    It is first on the command's path, where the command is the same in all parts of a
    tick: so it needs to remember ticks only, and what the others make of a command
    they make of a late one.
    """

    name = "valve_delay"
    residual_axis = "u_rate"
    counts_ticks = True
    tau_u: Float[Array, ""] = param(
        "s",
        0.0,
        0.0,
        LONGEST,
        "command delay",
        strength=True,
        size=1e-3,
        grid=spread(1e-3, LONGEST, 14),
    )
    queue: int = eqx.field(static=True, default=QUEUE)

    def lag(self):
        return self.tau_u

    def init(self, u):
        return jnp.broadcast_to(u[..., None], (*jnp.shape(u), self.queue))

    def step(self, memory, u, h):
        memory, (u,) = self.parts(memory, [u], h)
        return memory, u

    def parts(self, memory, us, h, *more):
        u, n = us[0], len(us)
        memory = jnp.concatenate([u[..., None], memory[..., :-1]], axis=-1)
        # No further back than the queue: a longer delay reads its oldest command.
        steps = jnp.minimum(
            jnp.broadcast_to(self.tau_u / h, u.shape), n * (self.queue - 1)
        )
        whole = jnp.floor(steps)
        share = (steps - whole)[..., None]
        # Each part is a mean of two held commands, its own and the one a part older.
        back = jnp.arange(n, -1, -1) + whole[..., None].astype(int)
        held = jnp.take_along_axis(
            memory, jnp.minimum(back // n, self.queue - 1), axis=-1
        )
        mean = held[..., 1:] + share * (held[..., :-1] - held[..., 1:])
        return memory, [mean[..., i] for i in range(n)]


class ValveBias(CommandChannel):
    """`u + u_0` (V6)."""

    name = "valve_bias"
    u_0: Float[Array, ""] = param(
        "{u}", 0.0, -3.0, 3.0, "null bias", strength=True, size=0.05
    )

    def step(self, memory, u, h):
        return memory, u + self.u_0


class ValveHysteresis(LastingChannel):
    """Play (V7): the output follows only where `abs(u - output)` exceeds `u_h`."""

    name = "valve_hysteresis"
    residual_axis = "u_rate"
    u_h: Float[Array, ""] = param(
        "{u}",
        0.0,
        0.0,
        2.0,
        "half-width of the play",
        strength=True,
        size=0.05,
        grid=spread(0.05, 2.0, 5),
    )

    def init(self, u):
        return u, 0 * u

    def follow(self, u):
        moves = -jnp.diff(u) / jnp.maximum(self.u_h, LEAST)
        begun, one = 0 * u[..., :1], jnp.ones(())
        return jnp.concatenate(
            [begun, run_stop(moves[None], one, begun[..., 0])], axis=-1
        )

    def resume(self, memory, state):
        return memory[0], state

    def step(self, memory, u, h):
        # Followed is how far the output is from the command, over the play: at u_h = 0
        # it says where the command went last, which is the one-sided derivative, and
        # what comes ahead of the play passes it.
        before, off = memory
        off = off - (u - before) / jnp.maximum(self.u_h, LEAST)
        # Not a clip, which would halve a derivative at the ends: where the command
        # stands still there, what is late ahead of the play is still catching up.
        end = 1 - LEAST
        off = jnp.where(off > end, 1.0, jnp.where(off < -end, -1.0, off))
        return (u, off), u + self.u_h * off


class ValveRateLimit(SpoolLimit):
    """Command with `abs(du/dt) <= r_v` (V2); exact for the mean over a step.

    Beside `valve_lag` the ramp stands ahead of that spool (`s = 0`, as a valve's
    electronics make it) or is the largest speed of the spool itself (`s = 1`, as a
    pilot's flow makes it). Alone both are the same, and `s` says nothing.

    Stored as `slew = 1/r_v` so that absent is 0: a held command is run after along a
    ramp, and the area lost, `slew du abs(du) / 2`, is linear in `slew`. Of any other
    `s` the share `1 - s` of what the ramp takes off the command is taken off ahead, and
    the spool's largest speed is `r_v / s`.
    """

    name = "valve_rate_limit"
    residual_axis = "u_rate"
    slew: Float[Array, ""] = param(
        "s/{u}",
        0.0,
        0.0,
        2.0,
        "largest rate of the command",
        strength=True,
        size=2e-3,
        grid=spread(3e-3, 2.0, 7),
        outside=("r_v", "{u}/s"),
    )
    s: Float[Array, ""] = param(
        "1",
        0.0,
        0.0,
        1.0,
        "share of it in the spool",
        prior=0.5,
        grid=(0.0, 1.0),
        whole=True,
    )

    def slowness(self):
        return self.slew

    def inside(self):
        return self.s

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


class ValveLag(Spool):
    """Second-order spool (V1): `s'' + 2 zeta omega s' + omega^2 s = omega^2 u`.

    Exact for a held command. Stored as `tau = 1/omega` so that absent is 0. The mean
    over the tick keeps the derivative alive there, which the value at the tick's end
    would not.
    """

    name = "valve_lag"
    residual_axis = "u_rate"
    tau: Float[Array, ""] = param(
        "s",
        0.0,
        0.0,
        0.05,
        "spool natural frequency",
        strength=True,
        size=5e-4,
        grid=spread(1e-3, 0.05, 6),
        outside=("omega", "rad/s"),
    )
    zeta: Float[Array, ""] = param("1", 0.7, 0.2, 3.0, "spool damping ratio", prior=0.2)

    def init(self, u):
        return u, jnp.zeros_like(u)

    def step(self, memory, u, h, slowness=0.0):
        y, rate = memory  # the spool's place, and its rate times tau
        off, absent = y - u, self.tau <= 0
        tau, zeta = jnp.where(absent, 1.0, self.tau), self.zeta
        slowness = jnp.asarray(slowness)
        limited = (slowness > 0) & ~absent
        top = tau / jnp.where(limited, slowness, 1.0)
        # At its limit it runs on until the spring no longer pushes it beyond.
        way = jnp.where(rate < 0, -1.0, 1.0)
        to_go = way * (-2 * zeta * rate - off)
        held = limited & (jnp.abs(rate) >= (1 - 1e-9) * top) & (to_go > 0)
        first = jnp.where(held, jnp.minimum(tau * to_go / top, h), 0.0)
        begun = off + rate * first / tau
        left = h - first
        off_new, rate_new = self._free(begun, rate, left / tau, absent)
        fast = limited & (jnp.abs(rate_new) > top)
        aim = jnp.where(rate_new < 0, -top, top)
        # And from when it reaches it: rates change nearly straight over a part.
        share = (aim - rate) / jnp.where(fast, rate_new - rate, 1.0)
        until = jnp.where(fast, left * jnp.clip(share, 0.0, 1.0), left)
        there, reached = self._free(begun, rate, until / tau, absent)
        rate_new = jnp.where(fast, aim, reached)
        rest = left - until
        off_new = there + rate_new * rest / tau
        # Integral of the offset over the tick; that of free motion from
        # A^-1 (e^{At} - 1).
        area = self.tau * (2 * zeta * (begun - there) + (rate - reached))
        run_on = first * (off + begun) / 2 + rest * (there + off_new) / 2
        # A spool without inertia jumps, and loses the area of a ramp.
        need = jnp.where(absent, slowness * jnp.abs(off), 0.0)  # seconds to get there
        late = need > h
        most = jnp.where(off > 0, -1.0, 1.0) * h / jnp.where(late, slowness, 1.0)
        end = u + jnp.where(absent, 0.0, off_new)
        mean = u + (area + run_on + 0.5 * off * need) / h
        memory = jnp.where(late, y + most, end), rate_new
        return memory, jnp.where(late, y + most / 2, mean)

    def _free(self, off, rate, s, absent):
        """Offset and rate (times tau) after a time `s` (times omega) without a limit; a
        spool without inertia is there at once.
        """
        cos, sin = (jnp.where(absent, 0.0, p) for p in free_motion(self.zeta, s))
        return (
            (cos + self.zeta * sin) * off + sin * rate,
            -sin * off + (cos - self.zeta * sin) * rate,
        )


class ValveDeadband(CommandChannel):
    """Overlap (V4): opening `max(u - u_dbp, 0)`, and `min(u + u_dbn, 0)` below zero."""

    name = "valve_deadband"
    of_the_edges = True
    u_dbp: Float[Array, ""] = param(
        "{u}",
        0.0,
        0.0,
        5.0,
        "overlap, u > 0",
        strength=True,
        size=0.05,
        grid=spread(0.05, 4.0, 6),
    )
    u_dbn: Float[Array, ""] = param(
        "{u}",
        0.0,
        0.0,
        5.0,
        "overlap, u < 0",
        strength=True,
        size=0.05,
        grid=spread(0.05, 4.0, 6),
    )

    def step(self, memory, u, h):
        up = jnp.where(u > self.u_dbp, u - self.u_dbp, 0.0)
        return memory, up + jnp.where(u < -self.u_dbn, u + self.u_dbn, 0.0)


class ReturnOverlap(ReturnEdgeEffect):
    """Overlap of each edge to the return, beyond that of the edge that opens with it
    (V4, V5).

    With `valve_deadband` these are the four overlaps of a valve: `u_dbp` and `u_dbn` of
    the edges from the supply to chambers 1 and 2, `u_dbn + o_n1` and `u_dbp + o_n2` of
    those from them to the return. One below zero is open at centre, to the return.
    What `underlap` adds is taken where the edges from the supply stand, for all four.
    """

    name = "return_overlap"
    needs = ("u", "edges", "differential")
    residual_axis = "u"
    o_n1: Float[Array, ""] = param(
        "{u}", 0.0, -5.0, 5.0, "overlap, chamber 1", strength=True, size=0.05
    )
    o_n2: Float[Array, ""] = param(
        "{u}", 0.0, -5.0, 5.0, "overlap, chamber 2", strength=True, size=0.05
    )

    def overlap(self):
        return self.o_n1, self.o_n2


class FlowCurve(CommandChannel):
    """Opening that is a curve of the command, as its notches are cut (V9).

    Of the share `s` of full command it opens `(1 - k) s + k s^p`: all at full command,
    and near zero little. `u_full` is full command.
    """

    name = "flow_curve"
    of_the_edges = True
    needs = ("u",)
    residual_axis = "abs(u)"
    u_full: Float[Array, ""] = eqx.field(
        default=1.0, converter=lambda x: jnp.asarray(x, float)
    )
    k: Float[Array, ""] = param(
        "1", 0.0, -1.0, 1.0, "share of the curve", strength=True, size=0.1, whole=True
    )
    p: Float[Array, ""] = param(
        "1", 2.5, 1.02, 5.0, "exponent of the curve", grid=(1.6, 3.0), prior=1.0
    )

    def step(self, memory, u, h):
        share = jnp.where(u < 0, -u, u) / self.u_full
        shut = share == 0
        curve = power(jnp.where(shut, 1.0, share), self.p - 1)
        curve = jnp.where(shut, 0.0, curve)
        return memory, u * (1 + self.k * (curve - 1))


def _numbers(rows) -> tuple[Float[Array, ""], ...]:
    return tuple(jnp.asarray(row, float) for row in rows)


class FlowTable(CommandChannel):
    """Opening by a table of the command, straight between its rows, held beyond them.

    A rig file's [valve] gives it; no trace adds it. `command` rises, and `opening` is
    the command at which a linear valve opens as far.
    """

    name = "flow_table"
    of_the_edges = True
    command: tuple[Float[Array, ""], ...] = eqx.field(converter=_numbers)
    opening: tuple[Float[Array, ""], ...] = eqx.field(converter=_numbers)

    def step(self, memory, u, h):
        at, opens = self.command, self.opening
        rows = range(len(at) - 1)
        slopes = [(opens[i + 1] - opens[i]) / (at[i + 1] - at[i]) for i in rows]
        u = jnp.clip(u, at[0], at[-1])
        out = opens[0] + slopes[0] * (u - at[0])
        for i in rows[1:]:
            bend = slopes[i] - slopes[i - 1]
            out = out + bend * jnp.where(u > at[i], u - at[i], 0.0)
        return memory, out


class OrificeTransition(OrificeEffect):
    """Laminar flow below a drop `dP_t` (V10): `Q = c u d / (d^2 + dP_t^2)^(1/4)`.

    It lacks `(dP_t / d)^2 / 4` of the turbulent flow: it depends on the square, which
    is what is stored, for the derivative to `dP_t` itself dies at zero.
    """

    name = "orifice_transition"
    residual_axis = "P_a1 - P_a2"
    dP_t2: Float[Array, ""] = param(
        "Pa^2", 0.0, 0.0, 1e14, "square of dP_t", strength=True, size=2.5e11
    )

    def core(self):
        return self.dP_t2


class Underlap(OrificeEffect):
    """Open centre (V5): both sides open at `u = 0`, one beyond `u_ul`.

    Within `u_ul` an edge opens by `g_ul (u + u_ul)`, beyond it as far for every step of
    the command as an edge without underlap. Lands that are too short have a `g_ul` of
    1: they stay open by `u_ul` more at any command. With 1/2 what the underlap adds has
    gone at `u_ul`. A step over which the spool changes sign is taken at its mean.
    """

    name = "underlap"
    residual_axis = "u"
    u_ul: Float[Array, ""] = param(
        "{u}", 0.0, 0.0, 5.0, "command at which one side has shut", strength=True,
        size=0.05, grid=(0.02, 0.05, 0.12, 0.3, 0.8),
    )  # fmt: skip
    g_ul: Float[Array, ""] = param(
        "1", 1.0, 0.25, 1.5, "opening per command within u_ul, over that beyond it",
        grid=(1.0, 0.5),
    )  # fmt: skip

    def opening(self, spool):
        def more(u):
            # At the edge of being shut it opens: the one-sided derivative at zero.
            near = self.g_ul * (u + self.u_ul)
            opened = jnp.where(
                u <= self.u_ul, near, u + (2 * self.g_ul - 1) * self.u_ul
            )
            opened = jnp.where(u + self.u_ul >= 0, opened, 0.0)
            return opened - jnp.where(u >= 0, u, 0.0)

        return more(spool), more(-spool)
