"""The closed loop: sensors, law, valve path, plant and load in one `lax.scan`.

At each sample the sensors are read, the law decides, and its command is held while the
plant acts over the tick (`hydrojax.plant.step`). A compute delay is the `valve_delay`
effect of the rig, a spool its `valve_lag`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.control.base import Measured, gain
from hydrojax.plant import step as plant_step
from hydrojax.plant.load import AbstractLoad, EnvironmentMotion
from hydrojax.plant.rig import Rig
from hydrojax.plant.state import State, StepInput


class Sensors(eqx.Module):
    """Standard deviations of the noise, and the encoder's step; SI.

    `step` is the step of the position in m, 0 for none; a rig file gives it as an angle
    where its geometry has a radius.
    """

    P_a1: Float[Array, ""]
    P_a2: Float[Array, ""]
    P_s: Float[Array, ""]
    F: Float[Array, ""]
    step: Float[Array, ""] = gain(
        "m", 0.0, 0.0, 1.0, "step of the position sensor",
        key="resolution", written="rad",
    )  # fmt: skip

    def read(self, truth: Measured, noise: Float[Array, "..."]) -> Measured:
        """The readings of `truth` with `noise` [..., 4], standard normal numbers."""
        sizes = (self.P_a1, self.P_a2, self.P_s, self.F)
        read = [
            y + s * noise[..., i]
            for i, (y, s) in enumerate(zip(truth, sizes, strict=False))
        ]
        return Measured(*read, x=quantise(truth.x, self.step))


def quantise(x: Float[Array, "..."], step: Float[Array, "..."]) -> Float[Array, "..."]:
    """`x` rounded to multiples of `step` (0: as it is), with the derivative of `x`.

    The derivative of the rounding itself is zero almost everywhere.
    """
    size = jnp.where(step > 0, step, 1.0)
    rounded = jnp.where(step > 0, jnp.round(x / size) * size, x)
    return x + jax.lax.stop_gradient(rounded - x)


class Scenario(NamedTuple):
    """What a run is given: N samples; SI.

    `t`, `F_d` [N]; `noise` [N, 4] standard normal numbers for P_a1, P_a2, P_s, F;
    `P_s`, `P_r` [N, 2] at both ends of each tick; `environment` its motion,
    `x` [N, parts, 3], `v`, `a` [N, parts].
    """

    t: Float[Array, "N"]
    F_d: Float[Array, "N"]
    noise: Float[Array, "N 4"]
    P_s: Float[Array, "N 2"]
    P_r: Float[Array, "N 2"]
    environment: EnvironmentMotion


class Loop(eqx.Module):
    """A rig, the controller that commands it, its load and its sensors.

    `law` is an `AbstractController`, by default the paper's; `h` is the control period,
    s; `P_start` the pressure of chamber 1 at the start, Pa.
    """

    rig: Rig
    law: Any  # an AbstractController; typed so that its own gains can be reached
    load: AbstractLoad
    sensors: Sensors
    P_start: Float[Array, ""]
    h: Float[Array, ""] = gain(
        "s", 1e-3, 0.0, math.inf, "sampling rate",
        key="rate", outside=("rate", "Hz"), positive=True,
    )  # fmt: skip


class _Carry(NamedTuple):
    plant: State
    law: Any
    gauges: tuple[
        Float[Array, ""], Float[Array, ""]
    ]  # the gauges' readings, before noise
    cell: Float[Array, ""]  # the load cell's reading, before noise
    F: Float[Array, ""]


def _inputs(loop: Loop, row: Scenario, u: Float[Array, ""]) -> StepInput:
    """One row of a scenario as the plant takes it, under the command `u`."""
    environment = row.environment
    return StepInput(
        h=loop.h,
        u=u,
        P_s=row.P_s,
        P_r=row.P_r,
        x=environment.x,
        dx=None,
        v=environment.v,
        a=environment.a,
        t=row.t + loop.h,
    )


def start_loop(loop: Loop, scenario: Scenario) -> _Carry:
    """At rest at the first sample, with the desired force on the output."""
    zero, F = jnp.zeros_like(loop.h), scenario.F_d[0]
    friction = loop.rig.mechanics
    k_f = jnp.where(F > 0, friction.k_fp, friction.k_fn)
    # At rest L is 1: all of the friction is the presliding kind, (22).
    P = F + k_f * F / (1 + friction.delta * jnp.abs(F))
    P_a2 = (P + loop.rig.force_area_1 * loop.P_start) / loop.rig.force_area_2
    first = jax.tree.map(lambda a: a[0], scenario)
    inputs = _inputs(loop, first, zero)
    plant, read = plant_step.start(loop.rig, inputs, (loop.P_start, P_a2), loop.load)
    x = first.environment.x[0, 0]
    truth = Measured(read["P_a1"], read["P_a2"], first.P_s[0], read["F"], x)
    law = loop.law.init(loop.sensors.read(truth, first.noise), first.F_d)
    gauges = (read["P_a1"], read["P_a2"])
    return _Carry(plant, law, gauges, read["F"], read["true_F"])


def step_loop(
    loop: Loop, carry: _Carry, row: Scenario
) -> tuple[_Carry, dict[str, Float[Array, ""]]]:
    """One sample: sense, decide, act until the next.

    Args:
        loop: what is run.
        carry: as `start_loop` or the sample before left it.
        row: one row of a scenario.

    Returns:
        What the next sample begins with, and scalars by name, SI: the readings and the
        command as logged (`x P_a1 P_a2 P_s F u`), the truth behind them (`true_x true_v
        true_P_a1 true_P_a2 true_F`), and what the controller records.
    """
    motion = carry.plant.motion
    truth = Measured(*carry.gauges, row.P_s[0], carry.cell, motion.x)
    seen = loop.sensors.read(truth, row.noise)
    law, u, made = loop.law.step(carry.law, seen, row.F_d, loop.h)
    now = {
        **made,
        "u": u,
        **seen._asdict(),
        "true_x": motion.x,
        "true_v": motion.v,
        "true_P_a1": carry.plant.P[0],
        "true_P_a2": carry.plant.P[1],
        "true_F": carry.F,
    }
    inputs = _inputs(loop, row, u)
    plant, read = plant_step.step(loop.rig, carry.plant, inputs, loop.load)
    gauges = (read["P_a1"], read["P_a2"])
    return _Carry(plant, law, gauges, read["F"], read["true_F"]), now


def signal_names(loop: Loop, scenario: Scenario) -> tuple[str, ...]:
    """What a run can give at each sample: see `step_loop`."""

    def one(loop: Loop, scenario: Scenario) -> dict[str, Float[Array, ""]]:
        tick = jax.tree.map(lambda a: a[0], scenario)
        return step_loop(loop, start_loop(loop, scenario), tick)[1]

    return tuple(eqx.filter_eval_shape(one, loop, scenario))


def run(
    loop: Loop, scenario: Scenario, keep: tuple[str, ...]
) -> Float[Array, "N signals"]:
    """The signals `keep` at every sample, SI; to be jitted or vmapped.

    One array comes out of the scan, since several of one shape are copied whole at
    every step by some versions of XLA's CPU compiler.
    """

    def body(carry, tick):
        carry, now = step_loop(loop, carry, tick)
        return carry, jnp.stack([now[name] for name in keep])

    return jax.lax.scan(body, start_loop(loop, scenario), scenario)[1]
