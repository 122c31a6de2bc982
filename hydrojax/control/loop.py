"""The closed loop: sensors, law, valve path, plant and load in one `lax.scan`.

At each sample the sensors are read, the law decides, and its command is held while the
plant acts over the tick in parts: the same pieces of the one step
(`Rig.command_parts`, `act`, `read`) that a log drives in a replay. A compute delay is
the `valve_delay` effect of the rig, a spool its `valve_lag`.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from hydrojax.control.base import Measured
from hydrojax.plant.friction import Sliding
from hydrojax.plant.load import EnvironmentMotion, Load, Motion
from hydrojax.plant.rig import Rig, State, StepInput


class Sensors(eqx.Module):
    """Standard deviations of the noise, and the encoder's step; SI.

    `step` is the step of the position in m, 0 for none.
    """

    P_a1: Array
    P_a2: Array
    P_s: Array
    F: Array
    step: Array

    def read(self, truth: Measured, noise: Array) -> Measured:
        """The readings of `truth` with `noise` [..., 4], standard normal numbers."""
        sizes = (self.P_a1, self.P_a2, self.P_s, self.F)
        read = [
            y + s * noise[..., i]
            for i, (y, s) in enumerate(zip(truth, sizes, strict=False))
        ]
        return Measured(*read, x=quantise(truth.x, self.step))


def quantise(x: Array, step: Array) -> Array:
    """`x` rounded to multiples of `step` (0: as it is), with the derivative of `x`.

    The rounding's own derivative is nothing almost everywhere, which says nothing
    about the position behind it.
    """
    size = jnp.where(step > 0, step, 1.0)
    rounded = jnp.where(step > 0, jnp.round(x / size) * size, x)
    return x + jax.lax.stop_gradient(rounded - x)


class Scenario(NamedTuple):
    """What a run is given: N samples; SI.

    `t`, `F_d` [N]; `noise` [N, 4] standard normal numbers for P_a1, P_a2, P_s, F;
    `P_s`, `P_r` [N, 2] at both ends of each tick; `road` the environment's motion,
    `x` [N, parts, 3], `v`, `a` [N, parts].
    """

    t: Array
    F_d: Array
    noise: Array
    P_s: Array
    P_r: Array
    environment: EnvironmentMotion


class Loop(eqx.Module):
    """A rig, the controller that commands it, its load and its sensors.

    `law` is an `AbstractController`, by default the paper's; `h` is the control period,
    s; `P_start` the pressure of chamber 1 at the start, Pa.
    """

    rig: Rig
    law: Any  # an AbstractController; typed so that its own gains can be reached
    load: Load
    sensors: Sensors
    h: Array
    P_start: Array


class _Carry(NamedTuple):
    plant: State
    motion: Motion
    law: Any
    gauges: tuple[Array, Array]  # what the pressure sensors say, before noise
    cell: Array  # what the load cell says, before noise
    F: Array


def begin(loop: Loop, scenario: Scenario) -> _Carry:
    """At rest at the first sample, with the desired force on the output."""
    zero = jnp.zeros_like(loop.h)
    x, F = scenario.environment.x[0, 0, 0], scenario.F_d[0]
    friction = loop.rig.mechanics
    k_f = jnp.where(F > 0, friction.k_fp, friction.k_fn)
    # At rest L is 1: all of the friction is the presliding kind, (22).
    P = F + k_f * F / (1 + friction.delta * jnp.abs(F))
    P_a2 = (P + loop.rig.force_area_1 * loop.P_start) / loop.rig.force_area_2
    plant = loop.rig.init(zero, loop.P_start, P_a2, x)
    P_s = scenario.P_s[0, 0]

    def force(v: Array, a: Array) -> Array:
        at = Sliding(zero, x, v, a, zero, v, zero, *plant.P, P_s)
        return loop.rig.output_force(at)

    environment = jax.tree.map(lambda r: r[0, 0], scenario.environment)
    motion = loop.load.begin(
        environment, loop.h / scenario.environment.v.shape[-1], force
    )
    F = force(motion.v, motion.a)
    gauges = (
        loop.rig.sense_init(loop.rig.gauge(0), plant.P[0], zero)[1],
        loop.rig.sense_init(loop.rig.gauge(1), plant.P[1], zero)[1],
    )
    cell = loop.rig.sense_init(loop.rig.sensor_F, F, zero)[1]
    truth = Measured(*gauges, P_s, cell, x)
    law = loop.law.init(loop.sensors.read(truth, scenario.noise[0]), scenario.F_d[0])
    return _Carry(plant, motion, law, gauges, cell, F)


def step(loop: Loop, carry: _Carry, tick: Scenario) -> tuple[_Carry, dict[str, Array]]:
    """One sample: sense, decide, act until the next.

    Args:
        loop: what is run.
        carry: as `begin` or the sample before left it.
        tick: one row of a course.

    Returns:
        What the next sample begins with, and scalars by name, SI: the readings and the
        command as logged (`x P_a1 P_a2 P_s F u`), the truth behind them (`true_x true_v
        true_P_a1 true_P_a2 true_F`), and what the controller records.
    """
    truth = Measured(*carry.gauges, tick.P_s[0], carry.cell, carry.motion.x)
    seen = loop.sensors.read(truth, tick.noise)
    law, u, made = loop.law.step(carry.law, seen, tick.F_d, loop.h)
    now = {
        **made,
        "u": u,
        **seen._asdict(),
        "true_x": carry.motion.x,
        "true_v": carry.motion.v,
        "true_P_a1": carry.plant.P[0],
        "true_P_a2": carry.plant.P[1],
        "true_F": carry.F,
    }

    parts = tick.environment.v.shape[-1]
    h = loop.h / parts
    rig, plant, motion, cell, F = (
        loop.rig,
        carry.plant,
        carry.motion,
        carry.cell,
        carry.F,
    )
    command, openings = rig.command_parts(plant.command, u, loop.h, parts)
    plant, gauges = plant._replace(command=command), carry.gauges

    def ends(p: Array, i: int) -> Array:
        return p[0] + jnp.array([i, i + 1]) / parts * (p[1] - p[0])

    def force(plant: State, part: StepInput, v: Array, a: Array) -> Array:
        return rig.output_force(rig.sliding(plant, part._replace(v=v, a=a)))

    for i, spool in enumerate(openings):
        environment = EnvironmentMotion(
            tick.environment.x[i], tick.environment.v[i], tick.environment.a[i]
        )
        x = loop.load.move(motion, environment, h)
        part = StepInput(
            h=h,
            u=u,
            P_s=ends(tick.P_s, i),
            P_r=ends(tick.P_r, i),
            x=x,
            dx=x[2:] - x[:1],
            v=(x[0] - 4 * x[1] + 3 * x[2]) / h,  # of the piston, at the end
            a=environment.a,
            t=tick.t + (i + 1) * h,
        )
        plant = rig.act(plant, (spool,), part)

        force_of = partial(force, plant, part)
        motion, F = loop.load.advance(motion, x, environment, h, force_of)
        plant, read = rig.read(plant, F, h)
        gauges, cell = (read["P_a1"], read["P_a2"]), read["F"]
    return _Carry(plant, motion, law, gauges, cell, F), now


def signal_names(loop: Loop, scenario: Scenario) -> tuple[str, ...]:
    """What a run can give at each sample: see `step`."""

    def one(loop: Loop, scenario: Scenario) -> dict[str, Array]:
        tick = jax.tree.map(lambda a: a[0], scenario)
        return step(loop, begin(loop, scenario), tick)[1]

    return tuple(eqx.filter_eval_shape(one, loop, scenario))


def run(loop: Loop, scenario: Scenario, keep: tuple[str, ...]) -> Array:
    """The signals `keep` at every sample, [N, len(keep)], SI; to be jitted or vmapped.

    One array comes out of the scan, since several of one shape are copied whole at
    every step by some versions of XLA's CPU compiler.
    """

    def body(carry, tick):
        carry, now = step(loop, carry, tick)
        return carry, jnp.stack([now[name] for name in keep])

    return jax.lax.scan(body, begin(loop, scenario), scenario)[1]
