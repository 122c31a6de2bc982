"""A rig: one pytree of plant, signal paths and effects, and its one step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .friction import PAST, Friction, Sliding
from .hydraulics import Chambers, Lands, Point
from .params import Effect

PLACES = (
    "command",
    "orifice",
    "supply",
    "flow",
    "volume",
    "compliance",
    "stretch",
    "velocity",
    "level",
    "friction",
    "force",
    "sensor_P",
    "sensor_F",
)
"""Where an effect can act, in the order of the signal path."""


HYDRAULIC = (
    "lands", "chambers", "command", "orifice", "supply", "flow", "volume",
    "compliance", "stretch",
)  # fmt: skip
"""The parts of a rig on which the pressures depend."""


PARTS = 4
"""Parts of a tick over which the command's path is run: within one, the spool's mean
opening stands for its course."""


class Tick(NamedTuple):
    """What drives the plant over one tick of length `h`; SI.

    `u` is held. `P_s` and `P_r` are [..., 2], at the tick's ends. `x` [..., 2n + 1] is
    the position at the ends and middles of n substeps, `dx` [..., 4] the displacement
    over each quarter, for the bristle; `v`, `a` and `t` hold at the tick's end. `F`
    [..., 2] is the output force at the tick's ends, where it was logged and an effect
    stretches what stands between piston and encoder.
    """

    h: Array
    u: Array
    P_s: Array
    P_r: Array
    x: Array
    dx: Array
    v: Array
    a: Array
    t: Array
    F: Array | None = None


class State(NamedTuple):
    """What the plant remembers: independent quantities only.

    `speed` has the lags `friction.PAST` of the velocity behind it on a last axis where
    an effect asks for them; `rod` holds the force that stretches, where one does.
    """

    command: tuple
    P: tuple[Array, Array]
    z: Array
    speed: Array
    sensor_P: tuple  # of chamber 1, of chamber 2
    sensor_F: tuple
    rod: tuple = ()


def sides(spool: Array) -> tuple[Array, Array]:
    """The spool's opening toward either side, both >= 0."""
    return jnp.where(spool > 0, spool, 0.0), -jnp.where(spool > 0, 0.0, spool)


class Rig(eqx.Module):
    """The plant of the paper, with what it lacks added as values.

    `force_area_1` and `_2` turn pressures into drive force (16); they differ from the
    chambers' areas only where a chamber is open (`single`).
    """

    lands: Lands
    chambers: Chambers
    mechanics: Friction
    force_area_1: Array
    force_area_2: Array
    command: tuple = ()
    orifice: tuple = ()
    supply: tuple = ()
    flow: tuple = ()
    volume: tuple = ()
    compliance: tuple = ()
    stretch: tuple = ()
    velocity: tuple = ()
    level: tuple = ()
    friction: tuple = ()
    force: tuple = ()
    sensor_P: tuple = ()
    sensor_F: tuple = ()

    # -- the pieces of the step, each elementwise over any leading axes --

    def command_init(self, u: Array) -> tuple:
        """Memories of the command's path at rest under `u`."""
        return tuple(c.init(u) for c in self.command)

    def command_parts(
        self, memory: tuple, u: Array, h: Array, parts: int = PARTS
    ) -> tuple[tuple, list[Array]]:
        """The command's way to the spool over one tick, cut into `parts`.

        Returns the memories and the spool's mean opening over each part.
        """
        openings = []
        for _ in range(parts):
            spool, out = u, []
            for channel, m in zip(self.command, memory, strict=True):
                m, spool = channel.step(m, spool, h / parts)
                out.append(m)
            memory = tuple(out)
            openings.append(spool)
        return memory, openings

    def command_step(
        self, memory: tuple, u: Array, h: Array
    ) -> tuple[tuple, tuple[Array, Array]]:
        """The same over a whole tick.

        Returns the memories and the mean openings toward either side, both >= 0.
        """
        parts = PARTS if self.command else 1
        memory, openings = self.command_parts(memory, u, h, parts)
        open_p, open_n = zip(*(sides(spool) for spool in openings), strict=True)
        return memory, (sum(open_p) / parts, sum(open_n) / parts)

    def pressure_rates(self, at: Point) -> tuple[Array, Array]:
        """Rates of both chamber pressures, Pa/s; (12)-(15)."""
        q_1, q_2 = self.lands.flows(at, self.supply, self.orifice)
        for effect in self.flow:
            e_1, e_2 = effect.flow(at)
            q_1, q_2 = q_1 + e_1, q_2 + e_2
        return self.chambers.rates(at, q_1, q_2, self.compliance, self.volume)

    def piston(self, tick: Tick) -> Array:
        """Where the piston stands when the encoder says `tick.x`, m."""
        if not self.stretch or tick.F is None:
            return tick.x
        start, end = tick.F[..., :1], tick.F[..., 1:]
        F = start + jnp.linspace(0.0, 1.0, tick.x.shape[-1]) * (end - start)
        return tick.x + sum(e.stretch(F) for e in self.stretch)

    def pressure_step(
        self, P: tuple[Array, Array], opening: tuple[Array, Array], tick: Tick
    ) -> tuple[Array, Array]:
        """Both pressures over one tick, by the midpoint rule in n substeps.

        Each substep moves the piston by its exact displacement, so what is left of
        the error is the pressures' own, of second order.
        """
        n = (tick.x.shape[-1] - 1) // 2
        h, x = tick.h / n, self.piston(tick)

        def rates(P, k, v):
            part = k / (2 * n)
            p_s, p_r = (
                p[..., 0] + part * (p[..., 1] - p[..., 0]) for p in (tick.P_s, tick.P_r)
            )
            return self.pressure_rates(
                Point(P[0], P[1], p_s, p_r, *opening, x=x[..., k], v=v)
            )

        for i in range(n):
            v = (x[..., 2 * i + 2] - x[..., 2 * i]) / h
            first = rates(P, 2 * i, v)
            middle = tuple(p + h / 2 * r for p, r in zip(P, first, strict=True))
            second = rates(middle, 2 * i + 1, v)
            P = (P[0] + h * second[0], P[1] + h * second[1])
        return P

    def drive_force(self, P_a1: Array, P_a2: Array) -> Array:
        """Net drive force P, N; (16) with two areas."""
        return self.force_area_2 * P_a2 - self.force_area_1 * P_a1

    def output_force(self, at: Sliding) -> Array:
        """F at the load cell, before the sensor, N; (22) and the added forces."""
        f_c = self.mechanics.sliding_force(at, self.level, self.friction)
        P = self.drive_force(at.P_a1, at.P_a2)
        F = self.mechanics.output_force(P, f_c, self.mechanics.switch(at.speed))
        return F + sum(e.force(at) for e in self.force)

    # -- the one step --

    def init(self, u: Array, P_a1: Array, P_a2: Array, x: Array) -> State:
        """At rest at `x` under the command `u`, with pressures `P_a1`, `P_a2`."""
        rest = jnp.zeros_like(P_a1)
        at = Sliding(rest, x, rest, rest, rest, rest, rest, P_a1, P_a2, P_a1 + 1.0)
        F = self.output_force(at)
        gauges = tuple(
            self.sense_init(self.gauge(i), p, rest)[0]
            for i, p in enumerate((P_a1, P_a2))
        )
        cell, _ = self.sense_init(self.sensor_F, F, rest)
        lags = (len(PAST) + 1,) if self.velocity else ()
        speed = jnp.zeros((*rest.shape, *lags), rest.dtype)
        rod = (F,) if self.stretch else ()
        return State(self.command_init(u), (P_a1, P_a2), rest, speed, gauges, cell, rod)

    def step(self, state: State, tick: Tick) -> tuple[State, dict[str, Array]]:
        """Act over one tick, then sense at its end.

        Returns the new state and what the sensors read, `P_a1 P_a2 F` in SI.
        """
        command, opening = self.command_step(state.command, tick.u, tick.h)
        if tick.F is None:  # none was logged: nothing stretches
            tick = tick._replace(F=jnp.zeros_like(tick.P_s))
        state = self.act(state._replace(command=command), opening, tick)
        F = self.output_force(self.sliding(state, tick))
        return self.read(state, F, tick.h)

    def act(self, state: State, opening: tuple[Array, Array], tick: Tick) -> State:
        """Pressures, bristle and filtered speed after a tick under `opening`."""
        z, speed = state.z, state.speed
        h = tick.h / tick.dx.shape[-1]
        for i in range(tick.dx.shape[-1]):
            dx = tick.dx[..., i]
            keep, add = self.mechanics.bristle_map(dx)
            z = keep * z + add
            keep, add = self.speed_map(dx, h)
            speed = keep * speed + add
        moved = state._replace(z=z, speed=speed)
        if self.stretch and tick.F is None:
            F = self.rod_force(moved, opening, tick)
            tick = tick._replace(F=jnp.stack([state.rod[0], F], axis=-1))
            moved = moved._replace(rod=(F,))
        return moved._replace(P=self.pressure_step(state.P, opening, tick))

    def speed_map(self, dx: Array, h: Array) -> tuple[Array, Array]:
        """The filtered speed's step; with the velocity's lags on a last axis."""
        keep, add = self.mechanics.speed_map(dx, h)
        if not self.velocity:
            return keep, add
        lags = self.mechanics.past_map(dx, h)
        pairs = zip((keep, add), lags, strict=True)
        return tuple(
            jnp.stack([jnp.broadcast_to(one, dx.shape), *past], axis=-1)
            for one, past in pairs
        )

    def slip(self, speed: Array, v: Array) -> tuple[Array, Array]:
        """The filtered speed and the velocity that friction sees."""
        if not self.velocity:
            return speed, v
        for effect in self.velocity:
            v = effect.seen(v, speed[..., 1:])
        return speed[..., 0], v

    def rod_force(
        self, moved: State, opening: tuple[Array, Array], tick: Tick
    ) -> Array:
        """The output force at the tick's end, the pressures still at its start, N.

        What stretches gives way as the force rises, and the pressures fall with it:
        `F = F_free - K (s(F) - s(F_0))`, with `K` the oil's stiffness as the output
        feels it, lies between `F_0` and the force of a rod that does not give. Solved
        by halving, and by one of Newton's steps for the derivative.
        """
        F_0 = moved.rod[0]
        ends = (tick.P_s[..., 1], tick.P_r[..., 1])

        def rates(v):
            at = Point(*moved.P, *ends, *opening, x=tick.x[..., -1], v=v)
            return self.pressure_rates(at)

        def force(P):
            return self.output_force(self.sliding(moved._replace(P=P), tick))

        held = tick._replace(F=jnp.stack([F_0, F_0], axis=-1))
        P = self.pressure_step(moved.P, opening, held)
        still, moving = rates(jnp.zeros_like(F_0)), rates(jnp.ones_like(F_0))
        per_metre = tuple(a - b for a, b in zip(still, moving, strict=True))
        free, K = jax.jvp(force, (P,), (per_metre,))

        def over(F):
            moved = sum(e.stretch(F) - e.stretch(F_0) for e in self.stretch)
            return F - free + K * moved

        low, high = jnp.minimum(F_0, free), jnp.maximum(F_0, free)
        for _ in range(24):
            middle = (low + high) / 2
            above = over(middle) > 0
            low, high = jnp.where(above, low, middle), jnp.where(above, middle, high)
        F = jax.lax.stop_gradient((low + high) / 2)
        value, slope = jax.jvp(over, (F,), (jnp.ones_like(F),))
        return F - value / jax.lax.stop_gradient(slope)

    def sliding(self, state: State, tick: Tick) -> Sliding:
        """What friction sees at the end of a tick."""
        rate = self.mechanics.z_rate(state.z, tick.v)
        speed, v = self.slip(state.speed, tick.v)
        return Sliding(
            t=tick.t,
            x=tick.x[..., -1],
            v=v,
            a=tick.a,
            z=state.z,
            z_rate=rate,
            speed=speed,
            P_a1=state.P[0],
            P_a2=state.P[1],
            P_s=tick.P_s[..., 1],
        )

    def read(self, state: State, F: Array, h: Array) -> tuple[State, dict[str, Array]]:
        """What the sensors say at the end of a tick of length `h`."""
        m_1, P_a1 = self.sense(self.gauge(0), state.sensor_P[0], state.P[0], h)
        m_2, P_a2 = self.sense(self.gauge(1), state.sensor_P[1], state.P[1], h)
        m_F, cell = self.sense(self.sensor_F, state.sensor_F, F, h)
        state = state._replace(sensor_P=(m_1, m_2), sensor_F=m_F)
        return state, {"P_a1": P_a1, "P_a2": P_a2, "F": cell}

    def gauge(self, i: int) -> tuple:
        """The channels on the pressure sensor of chamber 1 (`i` = 0) or 2."""
        return tuple(c.of_chamber(i) for c in self.sensor_P)

    def sense_init(
        self, channels: tuple, y: Array, slope: Array
    ) -> tuple[tuple, Array]:
        """Memories and reading of a sensor whose signal has run along a line."""
        memories = []
        for channel in channels:
            memory, y, slope = channel.init(y, slope)
            memories.append(memory)
        return tuple(memories), y

    def sense(self, channels: tuple, memory: tuple, y: Array, h: Array):
        """One sensor over one tick at whose end the signal is `y`."""
        out = []
        for channel, m in zip(channels, memory, strict=True):
            m, y = channel.step(m, y, h)
            out.append(m)
        return tuple(out), y


def add(rig: Rig, effects: Iterable[Effect]) -> Rig:
    """The rig with effects added, each at its own place, in the order given."""
    places: dict[str, list] = {place: list(getattr(rig, place)) for place in PLACES}
    for effect in effects:
        places[effect.place].append(effect)
    new = {place: tuple(e) for place, e in places.items()}
    return eqx.tree_at(
        lambda r: [getattr(r, place) for place in PLACES],
        rig,
        [new[place] for place in PLACES],
        is_leaf=lambda x: isinstance(x, tuple),
    )


def bare_rig(
    layout: str, geometry: Mapping[str, float] | None = None, **parts: Any
) -> Rig:
    """A rig without effects, at the default parameters.

    Args:
        layout: `pull-pull`, `differential`, `single` or `driven-axis`.
        geometry: `area` or `area_1`, `area_2` (m^2), `chamber_length` (m).
        parts: `lands`, `chambers` fields and `mechanics` to replace defaults.

    Raises:
        KeyError: an area that the layout needs is not there.
        ValueError: an unknown layout.
    """
    g = dict(geometry or {})
    if layout == "pull-pull":
        areas, acts = (g["area"], g["area"]), (g["area"], g["area"])
    elif layout == "differential":
        areas = acts = (g["area_1"], g["area_2"])
    elif layout == "single":
        # Chamber 1 is open: it holds fluid at no pressure and pushes nothing.
        areas, acts = (g["area"], g["area"]), (0.0, g["area"])
    elif layout == "driven-axis":
        # The drive force itself: a pressure of P/(1 m^2) on one square metre.
        areas, acts = (1.0, 1.0), (0.0, 1.0)
    else:
        raise ValueError(f"unknown layout {layout!r}")
    length = g.get("chamber_length", 1.0)
    chambers = Chambers(
        *(jnp.asarray(a, float) for a in (*areas, length)),
    )
    return Rig(
        lands=Lands(),
        chambers=chambers,
        mechanics=Friction(),
        force_area_1=jnp.asarray(acts[0], float),
        force_area_2=jnp.asarray(acts[1], float),
    )
