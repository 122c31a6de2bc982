"""A rig stepped from outside, one communication step at a time.

A log says where the piston will be at a tick's end; another simulator does not. So the
motion over a step is what is known at its start: constant acceleration from there,
`x + v s + a s^2 / 2`. Command and supply are held.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hydrojax.control.simulation import PARTS
from hydrojax.plant.friction import Sliding
from hydrojax.plant.rig import Rig
from hydrojax.plant.state import State, StepInput

SAME = 1e-6
"""Relative difference up to which two lengths of a step are the same."""


class Drive(NamedTuple):
    """What drives the plant from the start of a step; SI.

    `u` is the valve command (V or 1), `P` the drive force (N) where there is no valve;
    `x`, `v`, `a` are the piston's as the encoder sees it, `P_s` and `P_r` the supply's.
    """

    u: Array
    x: Array
    v: Array
    a: Array
    P_s: Array
    P_r: Array
    P: Array


def has_queue(rig: Rig) -> bool:
    """Whether something in the rig remembers so many ticks, not so much time."""
    return any(c.counts_ticks for c in (*rig.command, *rig.sensor_P, *rig.sensor_F))


def ticks_of(step: float, period: float) -> tuple[int, float]:
    """How many equal ticks a step (s) is cut into, none longer than `period`, and h."""
    whole = round(step / period)
    if whole and abs(step / period - whole) < SAME:
        return whole, period
    count = int(np.ceil(step / period))
    return count, step / count


def tick_from(drive: Drive, t: Array, since: Array, h: Array) -> StepInput:
    """The tick that begins `since` seconds into a step, at time `t`.

    The pressures are solved in as many parts of it as in the closed loop.
    """
    fine = since + h * jnp.linspace(0.0, 1.0, 2 * PARTS + 1)
    x = drive.x + drive.v * fine + drive.a / 2 * fine**2
    both = jnp.ones(2)
    return StepInput(
        h=h,
        u=jnp.asarray(drive.u, float),
        P_s=drive.P_s * both,
        P_r=drive.P_r * both,
        x=x,
        dx=jnp.diff(x[:: 2 * PARTS // 4]),
        v=drive.v + drive.a * (since + h),
        a=jnp.asarray(drive.a, float),
        t=t + h,
    )


@jax.jit
def start(rig: Rig, drive: Drive, P_a1: Array, P_a2: Array) -> tuple[State, dict]:
    """At rest where `drive` begins: the state, and what the sensors read."""
    drive = Drive._make(jnp.asarray(d, float) for d in drive)
    P_a1, P_a2 = (jnp.asarray(p, float) for p in (P_a1, P_a2))
    state = rig.init(drive.u, P_a1, P_a2, drive.x)
    zero = jnp.zeros_like(P_a1)
    at = Sliding(zero, drive.x, zero, zero, zero, zero, zero, P_a1, P_a2, drive.P_s)
    signals = (P_a1, P_a2, rig.output_force(at))
    paths = (rig.gauge(0), rig.gauge(1), rig.sensor_F)
    read = [rig.sense_init(c, y, zero)[1] for c, y in zip(paths, signals, strict=True)]
    return state, dict(zip(("P_a1", "P_a2", "F"), read, strict=True))


@partial(jax.jit, static_argnames=("count", "valve"))
def advance(
    rig: Rig, state: State, drive: Drive, t: Array, h: Array, count: int, valve: bool
) -> tuple[State, dict]:
    """`count` ticks of length `h` from time `t`: the state, and what the sensors read.

    As `Rig.step`, but that a rod which gives is solved for, and that without a valve
    the drive force is given.
    """
    drive = Drive._make(jnp.asarray(d, float) for d in drive)

    def body(state: State, i: Array) -> tuple[State, dict]:
        tick = tick_from(drive, t + i * h, i * h, h)
        if valve:
            command, opening = rig.command_step(state.command, tick.u, h)
            state = rig.act(state._replace(command=command), opening, tick)
        else:
            state = rig.slide(state, tick)._replace(P=(0 * drive.P, drive.P))
        F = rig.output_force(rig.sliding(state, tick))
        return rig.read(state, F, h)

    state, read = jax.lax.scan(body, state, jnp.arange(count, dtype=float))
    return state, {name: scenario[-1] for name, scenario in read.items()}
