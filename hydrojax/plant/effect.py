"""What an effect is at each place of a rig: the base classes to derive from.

An effect adds to the paper's model what a rig has beside it. Where in the rig it acts
decides what it must compute; `hydrojax.plant.places` lists the places.
"""

from __future__ import annotations

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from hydrojax.plant.chambers import Point
from hydrojax.plant.friction import Sliding
from hydrojax.plant.scan import in_one_kernel


class Effect(eqx.Module):
    """What the paper's model lacks: absent, and alive, when its strengths are zero.

    `name` is what files and reports call it; `place` is where in a rig it acts;
    `needs` what log and rig must have for it to show (signals, "loadcell" for a logged
    F, "rod_force" for that or both pressures, "differential" for a cylinder of two
    areas, as machines have, "edges" for a valve of four metering edges);
    `residual_axis` the signal against which its residual stands out.
    """

    name: ClassVar[str]
    place: ClassVar[str]
    needs: ClassVar[tuple[str, ...]]
    residual_axis: ClassVar[str]
    of_the_logger: ClassVar[bool] = False
    """Whether it is in what the logger writes, behind all that a sensor does itself."""


class CommandChannel(Effect):
    """A channel on the valve command: `init(u) -> memory`, `step(memory, u, h)`."""

    place = "command"
    needs = ("u",)
    residual_axis = "u"
    counts_ticks: ClassVar[bool] = False
    """Whether its memory counts ticks, so that all must have one length."""
    of_the_edges: ClassVar[bool] = False
    """Whether it says how edges open, wherever the spool stands: return edges that
    overlap more than the others see a spool that stands further back here."""

    def init(self, u: Float[Array, "*batch"]) -> Any:
        """Memory at rest under the command `u`."""
        return ()

    def step(self, memory, u: Float[Array, "*batch"], h: Float[Array, "*batch"]):
        """One step of length `h`: new memory and the mean of the output over it."""
        raise NotImplementedError

    def parts(
        self, memory, us: list[Float[Array, "*batch"]], h: Float[Array, "*batch"], *more
    ):
        """A tick cut into steps of length `h`: new memory, and each step's mean.

        What `step` takes besides comes last.
        """
        out = []
        for u in us:
            memory, u = self.step(memory, u, h, *more)
            out.append(u)
        return memory, out


class CommandDelay(CommandChannel):
    """A command that comes late and is otherwise the same: `lag() -> s`, zero or more.

    A replay knows the command ahead of its windows, and reads it as late as it came:
    no queue of ticks stands between.
    """

    def lag(self) -> Float[Array, ""]:
        """By how much, s."""
        raise NotImplementedError


class LastingChannel(CommandChannel):
    """A channel that forgets nothing while the command moves little, however long.

    A replay begins anew every so many ticks, from what `follow` says of all before:
    `resume(memory, state)` is the memory that goes on from there. `follow` sees the
    command as it was logged ({u}): what stands ahead of the channel may delay or shift
    it, and no more.
    """

    def follow(self, u: Float[Array, "*batch n"]) -> Float[Array, "*batch n"]:
        """Its state after each of `n` steps under a held command."""
        raise NotImplementedError

    def resume(self, memory, state: Float[Array, "*batch"]):
        """The memory at rest, in another state."""
        raise NotImplementedError


class SpoolLimit(CommandChannel):
    """A limit of a rate: `slowness() -> s/{u}`, 1 over it, zero for none.

    Alone on the command's path it acts by its own `step`. Beside a spool the share
    `inside()` of it limits that spool's own rate, and the rest the command ahead.
    """

    def slowness(self) -> Float[Array, ""]:
        """The least time in which the command or the spool moves by one, s/{u}."""
        raise NotImplementedError

    def inside(self) -> Float[Array, ""] | float:
        """The share that is the spool's own: 1 all, 0 none."""
        return 1.0


class Spool(CommandChannel):
    """The spool's own motion: `step(memory, u, h, slowness)`.

    What limits its rate holds while it moves, so that it runs at the limit at once and
    settles behind it; a limit ahead of it or behind would add both delays, or neither.
    """

    def step(
        self, memory, u: Float[Array, "*batch"], h: Float[Array, "*batch"],
        slowness: ArrayLike = 0.0,
    ):  # fmt: skip
        """One step of length `h`, with at most `h / slowness` of the way."""
        raise NotImplementedError


class OrificeEffect(Effect):
    """Changes the valve's four edges: how far they open, how laminar they are.

    `opening(spool) -> (open_p, open_n)` is added to the openings toward either side,
    `core() -> Pa^2` to the square of the laminar core.
    """

    place = "orifice"
    needs = ("u",)

    def opening(
        self, spool: Float[Array, "*batch"]
    ) -> tuple[Float[Array, "*batch"] | float, Float[Array, "*batch"] | float]:
        """What is added to the openings when the spool stands at `spool`."""
        return 0.0, 0.0

    def core(self) -> Float[Array, "*batch"] | float:
        """What is added to the square of the laminar core, Pa^2."""
        return 0.0


class ReturnEdgeEffect(Effect):
    """Lets the edges to the return open elsewhere than those from the supply.

    `overlap() -> (o_1, o_2)` is by how much further the spool goes until chamber 1, and
    chamber 2, opens to the return than until the edge that opens with it does, in the
    command's unit. It acts behind the spool and ahead of all that is `of_the_edges`;
    what has a memory there remembers the way of the edges from the supply.
    """

    place = "returns"
    needs = ("u",)

    def overlap(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """By how much further, for chambers 1 and 2."""
        raise NotImplementedError


class LineEffect(Effect):
    """A valve of its own in the lines between the metering edges and the chambers.

    `init(P_1, P_2)` is its memory after a long rest at these pressures,
    `step(memory, P_1, P_2, h)` that over a tick of length `h` that begins at them.
    What leaves chamber i as a flow Q loses `r_i Q^2` in it, `loss(memory)` being both
    r_i. What enters loses `r_i Q sqrt(Q^2 + q^2)`, by `check(memory)` and, for q,
    `check_laminar()`. `volume()` is what lies between it and the edges, of what the
    chambers hold in all.
    """

    place = "line"
    needs = ("u",)

    def init(self, P_1: Float[Array, "*batch"], P_2: Float[Array, "*batch"]) -> Any:
        """Memory after a long rest at these pressures, Pa."""
        return ()

    def step(
        self,
        memory,
        P_1: Float[Array, "*batch"],
        P_2: Float[Array, "*batch"],
        h: Float[Array, "*batch"],
    ):
        """Memory over a tick of length `h` (s) that begins at these pressures, Pa."""
        return memory

    def loss(self, memory) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Loss of what leaves chambers 1 and 2, Pa s^2/m^6."""
        raise NotImplementedError

    def check(self, memory) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Loss of what enters chambers 1 and 2 by its check valves, Pa s^2/m^6."""
        return jnp.zeros(()), jnp.zeros(())

    def check_laminar(self) -> Float[Array, "..."]:
        """Flow below which the check valves' loss is laminar, m^3/s."""
        return jnp.zeros(())

    def volume(self) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """What the lines of chambers 1 and 2 hold between it and the edges, m^3."""
        raise NotImplementedError


class SupplyEffect(Effect):
    """A pressure drop ahead of the valve: `drop(conductance, available) -> Pa`; or one
    behind it, in the return: `back(conductance, available)`.
    """

    place = "supply"
    needs = ("u",)

    def drop(
        self, conductance: Float[Array, "*batch"], available: Float[Array, "*batch"]
    ) -> Float[Array, "*batch"]:
        """Pressure lost when `conductance sqrt(.)` draws on `available`, Pa."""
        raise NotImplementedError

    def back(
        self, conductance: Float[Array, "*batch"], available: Float[Array, "*batch"]
    ) -> Float[Array, "*batch"] | float:
        """The same behind an edge that drains; none unless it says otherwise."""
        return 0.0


class FlowEffect(Effect):
    """Adds flows into the two chambers: `flow(at) -> (q_1, q_2)`, m^3/s."""

    place = "flow"
    needs = ("u",)

    def flow(self, at: Point) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Flows into chambers 1 and 2 at a point, m^3/s."""
        raise NotImplementedError


class VolumeEffect(Effect):
    """Adds to what the chambers hold: `volume() -> (V_1, V_2)`, m^3."""

    place = "volume"
    needs = ("u",)

    def volume(self) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Volume beside the stroke of chambers 1 and 2, m^3."""
        raise NotImplementedError


class ComplianceEffect(Effect):
    """Adds compliance of the fluid beside 1/beta: `compliance(P) -> 1/Pa`."""

    place = "compliance"
    needs = ("u",)

    def compliance(self, P: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Compliance beside 1/beta at gauge pressure `P`, 1/Pa."""
        raise NotImplementedError


class StretchEffect(Effect):
    """Lets the piston stand apart from the encoder: `stretch(F) -> m`, rising with F.

    Chambers and friction see the piston. In a replay the logged force drives it, or
    what the logged pressures push with where there is none; in simulation the plant's
    own.
    """

    place = "stretch"
    needs = ("u", "rod_force")
    residual_axis = "F"

    def stretch(self, F: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """How far the piston stands ahead of the encoder under `F` (N), m."""
        raise NotImplementedError


class SpeedEffect(Effect):
    """A speed that friction sees in place of `abs(v)`: `follow(before, now, h)`."""

    place = "velocity"
    needs = ("F",)

    def follow(
        self,
        before: Float[Array, "*batch"],
        now: Float[Array, "*batch"],
        h: Float[Array, "*batch"],
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """The step of the speed that friction sees as `w -> keep w + add`, m/s.

        The speed (m/s) goes from `before` to `now` within `h` seconds.
        """
        raise NotImplementedError

    def turns(self) -> tuple[Float[Array, ""] | float, Float[Array, ""] | float]:
        """Of its lag, what friction that goes with the velocity itself sees: the share
        that turns with the bristle, and the one that turns with the velocity.
        """
        return 1.0, 0.0


class LevelEffect(Effect):
    """Adds to the Coulomb level: `level(at, base) -> N`."""

    place = "level"
    needs = ("F",)
    of_turns: ClassVar[bool] = False
    """Whether it asks for `at.since`, `at.way` and `at.ages`, remembered only then."""

    def level(
        self, at: Sliding, base: Float[Array, "*batch"]
    ) -> Float[Array, "*batch"]:
        """What is added to the Coulomb level `base` (N) of this direction."""
        raise NotImplementedError


class FrictionForce(Effect):
    """Adds a friction force inside f_c: `force(at) -> N`; and in presliding, where f_c
    has faded: `at_rest(at) -> N`, of which the share L(t) acts.
    """

    place = "friction"
    needs = ("F",)
    of_turns: ClassVar[bool] = False
    """Whether it asks for `at.since`, `at.way` and `at.ages`, remembered only then."""

    def force(self, at: Sliding) -> Float[Array, "*batch"]:
        """Friction force beside the paper's f_c, N."""
        raise NotImplementedError

    def at_rest(self, at: Sliding) -> Float[Array, "*batch"] | float:
        """Friction force beside the paper's f_s, N; none unless it says otherwise."""
        return 0.0


class SwitchEffect(Effect):
    """Changes the switch L(t) between presliding and sliding: `presliding(L) -> 1`."""

    place = "switch"
    needs = ("F",)

    def presliding(self, L: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """What takes the place of L(t), 1 in presliding and 0 in sliding."""
        raise NotImplementedError


class HysteresisForce(Effect):
    """Adds a friction force that remembers the way, not the speed: a stop operator.

    Its deflection `w` (m) follows the piston and is held at `reach()` either way;
    `force(w) -> N`, rising with it, opposes motion toward positive x. It stands beside
    f_c, and no switch L(t) takes it away at rest. `deflection(f)` is where it stands
    when it holds `f` (N): in a replay it begins at what drive and output force leave.
    """

    place = "hysteresis"
    needs = ("F",)
    residual_axis = "x"
    remembered: ClassVar[tuple[str, ...] | None] = None
    """Parameters on which `reach` and `deflection` depend; None for all."""

    def reach(self) -> Float[Array, ""]:
        """The deflection at which it slides, m."""
        raise NotImplementedError

    def force(self, w: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """The force at a deflection (m), N."""
        raise NotImplementedError

    def deflection(self, f: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """A deflection (m) at which it holds `f` (N); 0 unless it says otherwise."""
        return 0 * f


class ForceEffect(Effect):
    """Adds a force between piston and load cell: `force(at) -> N`."""

    place = "force"
    needs = ("F",)

    def force(self, at: Sliding) -> Float[Array, "*batch"]:
        """Force added to what the load cell feels, N."""
        raise NotImplementedError


class SensorChannel(Effect):
    """A channel on a sensor: `init(y, slope)`, `step(memory, y, h)`.

    A channel at `sensor_P` stands on both gauges; where they differ, `of_chamber`
    says which channel a gauge has.
    """

    counts_ticks: ClassVar[bool] = False
    """Whether its memory counts ticks, so that all must have one length."""

    def of_chamber(self, i: int) -> SensorChannel:
        """This channel as the gauge of chamber 1 (`i` = 0) or 2 (`i` = 1) has it."""
        return self

    def ahead(
        self, y: Float[Array, "*batch"], slope: Float[Array, "*batch"],
        bend: Float[Array, "*batch"],
    ) -> Float[Array, "*batch"]:  # fmt: skip
        """What stands ahead of a channel that every logged pressure passes, where its
        reading is `y`, of first and second derivative `slope` and `bend`.
        """
        return y

    def of_supply(self) -> Float[Array, ""] | float:
        """How much of it P_s passes as well: 1 for all of it, 0 for nothing."""
        return 1.0

    def init(
        self, y: Float[Array, "*batch"], slope: Float[Array, "*batch"]
    ) -> tuple[Any, Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Memory, reading and the reading's slope after a long run along a line."""
        return (), y, slope

    def resume(
        self, y: Float[Array, "*batch"], slope: Float[Array, "*batch"],
        read: tuple[Float[Array, "*batch"], Float[Array, "*batch"]],
    ) -> tuple[Any, Float[Array, "*batch"], Float[Array, "*batch"]]:  # fmt: skip
        """`init` where the reading and its slope are known: `read`."""
        return self.init(y, slope)

    def step(self, memory, y: Float[Array, "*batch"], h: Float[Array, "*batch"]):
        """One tick of length `h` at whose end the signal is `y`: memory, reading."""
        raise NotImplementedError

    def forgets(self) -> bool | Bool[Array, ""]:
        """Whether a reading depends on no more of the past than the signal one tick
        before, as where a lag is absent: all ticks are then run side by side.
        """
        return False

    def run(
        self,
        y: Float[Array, "windows n"],
        slope: Float[Array, "windows"],
        h: Float[Array, "windows n-1"],
        read: tuple[Float[Array, "windows"], Float[Array, "windows"]] | None = None,
    ) -> tuple[Float[Array, "windows n"], Float[Array, "windows"]]:
        """Readings of a known signal `y` [W, n], from the first tick on.

        `slope` [W] is how it ran before, `h` [W, n-1] the ticks, `read` the reading at
        the first tick and its slope where they are known. Returns the readings and how
        they ran before.
        """
        begin = (y[:, 0], slope)
        memory, first, slope = (
            self.init(*begin) if read is None else self.resume(*begin, read)
        )
        now, before, still = y[:, 1:], y[:, :-1], jnp.zeros_like(y[:, 1:])

        def side_by_side():
            return self.step(self.init(before, still)[0], now, h)[1]

        def one_by_one():
            tick = in_one_kernel(lambda memory, given: self.step(memory, *given))
            return jax.lax.scan(tick, memory, (now.T, h.T))[1].T

        forgets = self.forgets()
        if isinstance(forgets, bool):
            rest = side_by_side() if forgets else one_by_one()
        else:
            rest = jax.lax.cond(forgets, side_by_side, one_by_one)
        return jnp.concatenate([first[:, None], rest], axis=1), slope
