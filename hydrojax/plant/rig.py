"""A rig: one pytree of plant, signal paths and effects.

`hydrojax.plant.step` moves it; here are the pieces of a step.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.plant import stretch
from hydrojax.plant.chambers import Chambers, Lines, Losses, Point, refilled
from hydrojax.plant.effect import Effect, Spool, SpoolLimit
from hydrojax.plant.friction import Friction, Sliding
from hydrojax.plant.layout import Layout
from hydrojax.plant.places import PLACES
from hydrojax.plant.state import State, StepInput
from hydrojax.plant.valve import AbstractValve, MeteringEdges, NoValve, sides

PARTS = 4
"""Parts of a tick over which the command's path is run: within one, the spool's mean
opening stands for its course."""


class Rig(eqx.Module):
    """The plant of the paper, with what it lacks added as values.

    `force_area_1` and `_2` turn pressures into drive force (16); they differ from the
    chambers' areas only where a chamber is open (`single`).
    """

    valve: AbstractValve
    chambers: Chambers
    mechanics: Friction
    force_area_1: Float[Array, ""]
    force_area_2: Float[Array, ""]
    command: tuple = ()
    returns: tuple = ()
    orifice: tuple = ()
    supply: tuple = ()
    line: tuple = ()
    flow: tuple = ()
    volume: tuple = ()
    compliance: tuple = ()
    stretch: tuple = ()
    velocity: tuple = ()
    level: tuple = ()
    friction: tuple = ()
    switch: tuple = ()
    hysteresis: tuple = ()
    force: tuple = ()
    sensor_P: tuple = ()
    sensor_F: tuple = ()

    # -- the pieces of the step, each elementwise over any leading axes --

    def command_init(self, u: Float[Array, "*batch"]) -> tuple:
        """Memories of the command's path at rest under `u`."""
        memories = []
        for channel in self.command:
            memories.append(channel.init(u))
            _, u = channel.step(memories[-1], u, jnp.ones_like(u))
        return tuple(memories)

    def command_parts(
        self,
        memory: tuple,
        u: Float[Array, "*batch"],
        h: Float[Array, "*batch"],
        parts: int = PARTS,
    ) -> tuple[tuple, list[tuple[Float[Array, "*batch"], ...]]]:
        """The command's way to the spool over one tick, cut into `parts`.

        Returns the memories, and for each part the spool's mean opening; where return
        edges overlap otherwise, behind it as the edge from chamber 2, and that from
        chamber 1, have it.
        """
        return self.command_through(memory, [u] * parts, h / parts)

    def command_through(
        self,
        memory: tuple,
        us: list[Float[Array, "*batch"]],
        h: Float[Array, "*batch"],
    ) -> tuple[tuple, list[tuple[Float[Array, "*batch"], ...]]]:
        """The same for a command that differs from part to part, each `h` s long."""
        limits = [c for c in self.command if isinstance(c, SpoolLimit)]
        spools = [c for c in self.command if isinstance(c, Spool)]
        slowness = sum((c.slowness() * c.inside() for c in limits), start=jnp.zeros(()))
        out, back = [], None
        for channel, m in zip(self.command, memory, strict=True):
            if back is None and channel.of_the_edges:
                back = self._at_returns(us)
            if isinstance(channel, Spool):
                m, us = channel.parts(m, us, h, slowness)
            elif spools and isinstance(channel, SpoolLimit):
                m, late = channel.parts(m, us, h)
                ahead = 1 - channel.inside()
                us = [u + ahead * (w - u) for u, w in zip(us, late, strict=True)]
            else:
                if back is not None:
                    back = [channel.parts(m, way, h)[1] for way in back]
                m, us = channel.parts(m, us, h)
            out.append(m)
        back = self._at_returns(us) if back is None else back
        return tuple(out), list(zip(us, *back, strict=True))

    def _at_returns(
        self, us: list[Float[Array, "*batch"]]
    ) -> list[list[Float[Array, "*batch"]]]:
        """Where the spool stands for the edges from chambers 2 and 1 to the return;
        none where these open as the others do.
        """
        if not self.returns:
            return []
        one, two = (
            sum(o) for o in zip(*(e.overlap() for e in self.returns), strict=True)
        )
        return [[u - two for u in us], [u + one for u in us]]

    def command_step(
        self, memory: tuple, u: Float[Array, "*batch"], h: Float[Array, "*batch"]
    ) -> tuple[tuple, tuple[Float[Array, "*batch"], ...]]:
        """The same over a whole tick.

        Returns the memories and the opening over the tick, as `Point` has it.
        """
        if not (self.command or self.returns):
            return (), (u,)
        memory, openings = self.command_parts(memory, u, h)
        return memory, mean_opening(openings)

    def openings(
        self,
        memory: tuple,
        u: Float[Array, "*batch"],
        h: Float[Array, "*batch"],
        parts: int,
    ) -> tuple[tuple, list[tuple[Float[Array, "*batch"], ...]]]:
        """The memories after a tick, and the opening over each of its `parts`."""
        if parts == 1:
            memory, opening = self.command_step(memory, u, h)
            return memory, [opening]
        memory, spools = self.command_parts(memory, u, h, parts)
        return memory, [s if len(s) == 1 else mean_opening([s]) for s in spools]

    def line_init(
        self, P_1: Float[Array, "*batch"], P_2: Float[Array, "*batch"]
    ) -> Lines | None:
        """What stands in the lines after a long rest at these pressures (Pa)."""
        if not self.line:
            return None
        memory = tuple(effect.init(P_1, P_2) for effect in self.line)
        return Lines(memory, (0 * P_1, 0 * P_2))

    def line_step(
        self,
        line: Lines,
        P_1: Float[Array, "*batch"],
        P_2: Float[Array, "*batch"],
        h: Float[Array, "*batch"],
    ) -> Lines:
        """The same, its memories after `h` s at these pressures."""
        memory = tuple(
            effect.step(m, P_1, P_2, h)
            for effect, m in zip(self.line, line.memory, strict=True)
        )
        return line._replace(memory=memory)

    def line_losses(self, line: Lines) -> tuple[Losses, Losses]:
        """What flows lose in the lines of chambers 1 and 2."""
        one = two = Losses(*[jnp.zeros(())] * 3)
        for effect, memory in zip(self.line, line.memory, strict=True):
            ways = zip(effect.loss(memory), effect.check(memory), strict=True)
            q = effect.check_laminar()
            one, two = (
                Losses(r.out + out, r.into + into, jnp.maximum(r.laminar, q))
                for r, (out, into) in zip((one, two), ways, strict=True)
            )
        return one, two

    def flows(
        self, at: Point
    ) -> tuple[
        tuple[Float[Array, "*batch"], Float[Array, "*batch"]],
        tuple[Float[Array, "..."], Float[Array, "..."]],
    ]:
        """Flows toward both chambers through the edges, (12)(13), and what effects add,
        m^3/s.
        """
        full = at._replace(P_a1=refilled(at.P_a1), P_a2=refilled(at.P_a2))
        edges = full
        if at.line is not None:
            drop_1, drop_2 = at.line.drop
            edges = full._replace(P_a1=full.P_a1 - drop_1, P_a2=full.P_a2 - drop_2)
        one = two = jnp.zeros(())
        for effect in self.flow:
            e_1, e_2 = effect.flow(full)
            one, two = one + e_1, two + e_2
        return self.valve.flows(edges, self.supply, self.orifice), (one, two)

    def pressure_rates(
        self, at: Point
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Rates of both chamber pressures, Pa/s; (12)-(15).

        Below `P_VAPOUR` they are those of the volume that a chamber lacks.
        """
        return self.rates_of(at, self.flows(at))

    def rates_of(
        self, at: Point, flows: tuple
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """The same under flows as `flows` has them."""
        (q_1, q_2), (more_1, more_2) = flows
        return self.chambers.rates(
            at, q_1 + more_1, q_2 + more_2, self.compliance, self.volume, self.line
        )

    def drive_force(
        self, P_a1: Float[Array, "*batch"], P_a2: Float[Array, "*batch"]
    ) -> Float[Array, "*batch"]:
        """Net drive force P, N; (16) with two areas."""
        return self.force_area_2 * P_a2 - self.force_area_1 * P_a1

    def seal_pressure(
        self, P_a1: Float[Array, "*batch"], P_a2: Float[Array, "*batch"]
    ) -> Float[Array, "*batch"]:
        """Mean of the pressures that push on the piston, Pa.

        That of an open chamber, whose force area is zero (`single`), does not. 0 where
        no pressure is known.
        """
        push_1 = jnp.where(self.force_area_1 > 0, 1.0, 0.0)
        push_2 = jnp.where(self.force_area_2 > 0, 1.0, 0.0)
        both = push_1 * P_a1 + push_2 * P_a2
        return both / jnp.maximum(push_1 + push_2, 1.0)

    def output_force(self, at: Sliding) -> Float[Array, "*batch"]:
        """F at the load cell, before the sensor, N; (22) and the added forces."""
        at = at._replace(P_seal=self.seal_pressure(at.P_a1, at.P_a2))
        f_c = self.mechanics.sliding_force(at, self.level, self.friction)
        P = self.drive_force(at.P_a1, at.P_a2)
        rest = sum((e.at_rest(at) for e in self.friction), start=0.0)
        F = self.mechanics.output_force(P, f_c, self.presliding(at.speed), rest)
        at = at._replace(F=F)
        F = F + sum(e.force(at) for e in self.force)
        held = zip(self.hysteresis, at.slips, strict=True)
        return F - sum(e.force(w) for e, w in held)

    def presliding(self, speed: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """L(t), and what effects make of it; `speed` is the filtered |v|."""
        L = self.mechanics.switch(speed)
        for effect in self.switch:
            L = effect.presliding(L)
        return L

    def slide(self, state: State, inputs: StepInput) -> State:
        """What friction remembers after the piston's motion over a tick."""
        dx = stretch.moves(self.stretch, inputs)
        h = inputs.h / dx.shape[-1]
        z, speed = state.z, state.speed[..., 0] if self.velocity else state.speed
        slips = state.slips
        for i in range(dx.shape[-1]):
            keep, add = self.mechanics.bristle_map(dx[..., i])
            z = keep * z + add
            keep, add = self.mechanics.speed_map(dx[..., i], h)
            speed = keep * speed + add
            slips = tuple(
                jnp.clip(w + dx[..., i], -e.reach(), e.reach())
                for e, w in zip(self.hysteresis, slips, strict=True)
            )
        if self.velocity:
            now = jnp.abs(stretch.velocity(self.stretch, inputs))
            films = [now]
            for i, effect in enumerate(self.velocity):
                keep, add = effect.follow(state.speed[..., 1], now, inputs.h)
                films.append(keep * state.speed[..., 2 + i] + add)
            speed = jnp.stack([speed, *films], axis=-1)
        turned = state.turned
        if turned:
            turned = turned.moved(z, jnp.sum(dx, axis=-1), inputs.h)
        return state._replace(z=z, speed=speed, slips=slips, turned=turned)

    @property
    def asks_of_turns(self) -> bool:
        """Whether any effect asks for what is remembered of turns."""
        return any(e.of_turns for e in (*self.level, *self.friction))

    def films(
        self, speed: Float[Array, "*batch"] | Float[Array, "*batch films"]
    ) -> tuple[Float[Array, "*batch"], dict[str, Any]]:
        """The filtered speed, and what `Sliding` says of the films' lag.

        `speed` as in `State`.
        """
        if not self.velocity:
            return speed, {}
        lags = jnp.moveaxis(speed[..., 2:] - speed[..., 1:2], -1, 0)
        turns = [effect.turns() for effect in self.velocity]
        late = {
            name: sum(turn[i] * lag for turn, lag in zip(turns, lags, strict=True))
            for i, name in enumerate(("lag_z", "lag_v"))
        }
        return speed[..., 0], {"lag": jnp.sum(lags, axis=0), **late}

    def sliding(self, state: State, inputs: StepInput) -> Sliding:
        """What friction sees at the end of a tick."""
        v = stretch.velocity(self.stretch, inputs)
        speed, late = self.films(state.speed)
        turned = state.turned.seen() if state.turned else {}
        return Sliding(
            t=inputs.t,
            x=inputs.x[..., -1],
            v=v,
            a=inputs.a,
            z=state.z,
            z_rate=self.mechanics.z_rate(state.z, v),
            speed=speed,
            P_a1=state.P[0],
            P_a2=state.P[1],
            P_s=inputs.P_s[..., 1],
            slips=state.slips,
            **late,
            **turned,
        )

    def read(
        self, state: State, F: Float[Array, "*batch"], h: Float[Array, "*batch"]
    ) -> tuple[State, dict[str, Float[Array, "*batch"]]]:
        """What the sensors say at the end of a tick of length `h`."""
        m_1, P_a1 = self.sense(self.gauge(0), state.sensor_P[0], state.P[0], h)
        m_2, P_a2 = self.sense(self.gauge(1), state.sensor_P[1], state.P[1], h)
        m_F, cell = self.sense(self.sensor_F, state.sensor_F, F, h)
        state = state._replace(sensor_P=(m_1, m_2), sensor_F=m_F)
        return state, {"P_a1": P_a1, "P_a2": P_a2, "F": cell}

    def gauge(self, i: int) -> tuple:
        """The channels on the pressure sensor of chamber 1 (`i` = 0) or 2."""
        own = sorted(self.sensor_P, key=lambda c: c.of_the_logger)
        return tuple(c.of_chamber(i) for c in own)

    def sense_init(
        self, channels: tuple, y: Float[Array, "*batch"], slope: Float[Array, "*batch"]
    ) -> tuple[tuple, Float[Array, "*batch"]]:
        """Memories and reading of a sensor whose signal has run along a line."""
        memories = []
        for channel in channels:
            memory, y, slope = channel.init(y, slope)
            memories.append(memory)
        return tuple(memories), y

    def sense(
        self,
        channels: tuple,
        memory: tuple,
        y: Float[Array, "*batch"],
        h: Float[Array, "*batch"],
    ):
        """One sensor over one tick at whose end the signal is `y`."""
        out = []
        for channel, m in zip(channels, memory, strict=True):
            m, y = channel.step(m, y, h)
            out.append(m)
        return tuple(out), y


def mean_opening(
    spools: list[tuple[Float[Array, "*batch"], ...]],
) -> tuple[Float[Array, "*batch"], ...]:
    """The openings over all parts, as `Point` has them."""
    total = _edges(spools[0])
    for spool in spools[1:]:
        total = tuple(a + b for a, b in zip(total, _edges(spool), strict=True))
    return tuple(a / len(spools) for a in total)


def _edges(spool: tuple[Array, ...]) -> tuple[Array, ...]:
    """How far the edges are open: toward either side, and those to the return."""
    own, *back = spool
    if not back:
        return sides(own)
    two, one = back
    return (*sides(own), sides(two)[0], sides(one)[1])


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


def bare_rig(layout: Layout, geometry: Mapping[str, float] | None = None) -> Rig:
    """A rig without effects, at the default parameters.

    Args:
        layout: one of `LAYOUTS`.
        geometry: in SI, by the keys of [geometry]: the areas that the layout needs
            (m^2), and `chamber_length` (m; 1 m if it is not given).

    Raises:
        KeyError: an area that the layout needs is missing.
    """
    g = geometry or {}
    chamber, force = layout.areas(g)
    length = jnp.asarray(g.get("chamber_length", 1.0), float)
    return Rig(
        valve=MeteringEdges() if layout.has_valve else NoValve(),
        chambers=Chambers(chamber[0], chamber[1], length),
        mechanics=Friction(),
        force_area_1=force[0],
        force_area_2=force[1],
    )
