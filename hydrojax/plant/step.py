"""The step of a rig: the closed loop, an FMU and a user's own loop all call it.

`start` puts a rig at rest, `step` moves it over one tick. What gives between piston and
encoder (a rod, a play) is solved for in each part of a tick unless the force that
stretches it was logged.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.plant.chambers import Lines, Point, refilled
from hydrojax.plant.friction import Sliding
from hydrojax.plant.hydraulics import pressure_step
from hydrojax.plant.load import AbstractLoad, Prescribed, environment_of
from hydrojax.plant.rig import Rig
from hydrojax.plant.state import State, StepInput
from hydrojax.plant.stretch import ahead
from hydrojax.plant.turned import at_rest

HALVINGS = 24
"""Of the bracket that holds the force: to 1e-7 of a tick's change."""

ABREAST = 4
"""Parts of a tick up to which they are written out one behind the other; of more a loop
is made, which compiles as fast as one part. Closed loops have four."""

Signals = dict[str, Float[Array, "*batch"]]
"""`P_a1`, `P_a2` (Pa) and `F` (N) as the sensors read them, and `true_F` (N), the
output force itself."""


def start(
    rig: Rig,
    inputs: StepInput,
    P: tuple[Float[Array, "*batch"], Float[Array, "*batch"]],
    load: AbstractLoad | None = None,
) -> tuple[State, Signals]:
    """A rig at rest at the start of a tick.

    Args:
        rig: the plant.
        inputs: the first tick. The command's path is at rest under its `u`; bristle,
            filtered speed and what has hysteresis are zero.
        P: pressures of chambers 1 and 2, Pa, of one shape.
        load: what moves the piston; None for `Prescribed`.

    Returns:
        The state, and what the sensors read after a long rest.
    """
    load = load or Prescribed()
    first = load.parts(inputs)[0]
    rest, x = jnp.zeros_like(P[0]), first.x[..., 0]

    slips = (rest,) * len(rig.hysteresis)

    def force(v: Array, a: Array) -> Array:
        at = Sliding(rest, x, v, a, rest, v, rest, *P, inputs.P_s[..., 0], slips=slips)
        return rig.output_force(at)

    still = force(rest, rest)
    motion = load.begin(environment_of(first), first.h, force)
    F = force(motion.v, motion.a) if motion else still
    films = (len(rig.velocity) + 2,) if rig.velocity else ()
    state = State(
        command=rig.command_init(inputs.u),
        P=P,
        z=rest,
        speed=jnp.zeros((*rest.shape, *films), rest.dtype),
        sensor_P=tuple(
            rig.sense_init(rig.gauge(i), p, rest)[0] for i, p in enumerate(P)
        ),
        sensor_F=rig.sense_init(rig.sensor_F, still, rest)[0],
        rod=(still,) if rig.stretch else (),
        motion=motion,
        lacking=(rest, rest),
        line=rig.line_init(*P),
        slips=slips,
        turned=at_rest(rest) if rig.asks_of_turns else None,
    )
    paths = {"P_a1": (rig.gauge(0), P[0]), "P_a2": (rig.gauge(1), P[1])}
    paths["F"] = (rig.sensor_F, F)
    read = {name: rig.sense_init(*path, rest)[1] for name, path in paths.items()}
    return state, read | {"true_F": F}


def step(
    rig: Rig, state: State, inputs: StepInput, load: AbstractLoad | None = None
) -> tuple[State, Signals]:
    """Act over one tick, then sense at its end.

    Elementwise over any leading axes; to be scanned, jitted, vmapped, differentiated.

    Args:
        rig: the plant.
        state: where it stands, from `start` or the step before.
        inputs: what drives it over the tick.
        load: what moves the piston; None for `Prescribed`: as `inputs` has it.

    Returns:
        The new state, and what the sensors read at the tick's end.
    """
    load = load or Prescribed()
    parts = load.parts(inputs)
    command, openings = rig.openings(state.command, inputs.u, inputs.h, len(parts))
    state = state._replace(command=command)

    def one(
        state: State, at: tuple[tuple[Float[Array, "*batch"], ...], StepInput]
    ) -> tuple[State, Signals]:
        opening, part = at
        moved = load.piston(state.motion, part)
        state = act(rig, state, opening, moved)

        def force(v: Array, a: Array) -> Array:
            F = rig.output_force(rig.sliding(state, moved._replace(v=v, a=a)))
            if load.meets_stops and moved.P is None:
                F = F + rig.chambers.end_stop(moved.x[..., -1])
            return F

        motion, F = load.advance(
            state.motion, moved.x, environment_of(part), part.h, force
        )
        state, signals = rig.read(state._replace(motion=motion), F, part.h)
        return state, signals | {"true_F": F}

    each = list(zip(openings, parts, strict=True))
    if len(each) > ABREAST:
        rows = jax.tree.map(lambda *a: jnp.stack(a), *each)
        state, signals = jax.lax.scan(one, state, rows)
        return state, {name: y[-1] for name, y in signals.items()}
    signals: Signals = {}
    for at in each:
        state, signals = one(state, at)
    return state, signals


def act(
    rig: Rig,
    state: State,
    opening: tuple[Float[Array, "*batch"], ...],
    inputs: StepInput,
) -> State:
    """Pressures, bristle and filtered speed after a tick under `opening`."""
    if rig.stretch and inputs.F is None:
        F = _stretching_force(rig, state, opening, inputs)
        inputs = inputs._replace(F=jnp.stack([state.rod[0], F], axis=-1))
        state = state._replace(rod=(F,))
    P, line = _pressures(rig, state, opening, inputs)
    state = _with_pressures(rig.slide(state, inputs), P, inputs)
    return state._replace(line=line)


def _pressures(
    rig: Rig, state: State, opening: tuple[Array, ...], inputs: StepInput
) -> tuple[tuple[Array, Array], Lines | None]:
    """Both pressures at the tick's end, Pa; a drive force that is given as P_a2.

    As `pressure_step` has them: less what a chamber lacks; with what is in the lines.
    """
    if inputs.P is not None:
        return (0 * inputs.P, inputs.P / rig.force_area_2), state.line
    P = (state.P[0] + state.lacking[0], state.P[1] + state.lacking[1])
    return pressure_step(rig, P, opening, inputs, state.line)


def _with_pressures(state: State, P: tuple[Array, Array], inputs: StepInput) -> State:
    """The state with pressures from `_pressures`, and what they lack aside."""
    if inputs.P is not None:
        return state._replace(P=P)
    full = (refilled(P[0]), refilled(P[1]))
    return state._replace(P=full, lacking=(P[0] - full[0], P[1] - full[1]))


def _pressure_rates_per_speed(
    rig: Rig,
    P: tuple[Array, Array],
    opening: tuple[Array, ...],
    inputs: StepInput,
    line: Lines | None,
) -> tuple[Array, Array]:
    """By how much the pressures rise when the piston moves on, Pa/m."""
    if inputs.P is not None:
        return jnp.zeros_like(P[0]), jnp.zeros_like(P[1])

    def rates(v: Array) -> tuple[Array, Array]:
        x = inputs.x[..., -1]
        ends = (inputs.P_s[..., 1], inputs.P_r[..., 1])
        at = Point(*P, *ends, opening, x, v, line, inputs.t)
        return rig.pressure_rates(at)

    still, moving = rates(jnp.zeros_like(P[0])), rates(jnp.ones_like(P[0]))
    return moving[0] - still[0], moving[1] - still[1]


def _stretching_force(
    rig: Rig, state: State, opening: tuple[Array, ...], inputs: StepInput
) -> Array:
    """The output force at the end of a tick that starts in `state`, N.

    What stretches gives way as the force rises; pressures fall and the bristle bends
    with it. So F lies between the force at the tick's start and that of a rod which
    does not give. Solved by halving, and by one of Newton's steps for the derivative.
    """
    F_0 = state.rod[0]
    held = inputs._replace(F=jnp.stack([F_0, F_0], axis=-1))
    P, _ = _pressures(rig, state, opening, held)
    per_metre = _pressure_rates_per_speed(rig, P, opening, inputs, state.line)
    begun = (state, inputs, P, per_metre)

    def follows(F, rig, begun):
        state, inputs, P, per_metre = begun
        moved = ahead(rig.stretch, F) - ahead(rig.stretch, state.rod[0])
        P = tuple(p + d * moved for p, d in zip(P, per_metre, strict=True))
        inputs = inputs._replace(F=jnp.stack([state.rod[0], F], axis=-1))
        state = _with_pressures(rig.slide(state, inputs), P, inputs)
        return rig.output_force(rig.sliding(state, inputs))

    def over(F, rig, begun):
        return F - follows(F, rig, begun)

    free = follows(F_0, rig, begun)
    fixed = jax.lax.stop_gradient((rig, begun))

    def halve(_, bracket):
        low, high = bracket
        middle = (low + high) / 2
        above = over(middle, *fixed) > 0
        return jnp.where(above, low, middle), jnp.where(above, middle, high)

    ends = jax.lax.stop_gradient((jnp.minimum(F_0, free), jnp.maximum(F_0, free)))
    low, high = jax.lax.fori_loop(0, HALVINGS, halve, ends)
    F = (low + high) / 2
    value, slope = jax.jvp(lambda F: over(F, rig, begun), (F,), (jnp.ones_like(F),))
    return F - value / jax.lax.stop_gradient(slope)
