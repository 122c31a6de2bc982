"""A rig stepped from outside, one communication step at a time.

A log says where the piston will be at a tick's end; another simulator does not. So the
motion over a step is what is known at its start: constant acceleration from there,
`x + v s + a s^2 / 2`. Command and supply are held.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.control.simulation import PARTS
from hydrojax.plant.rig import Rig
from hydrojax.plant.state import StepInput


class Drive(NamedTuple):
    """What drives the plant from the start of a step; SI.

    `u` is the valve command (V or 1), `P` the drive force (N; None where a
    valve drives), `x`, `v`, `a` are the piston's as the encoder sees it, `P_s` and
    `P_r` the supply's.
    """

    u: Float[Array, ""]
    x: Float[Array, ""]
    v: Float[Array, ""]
    a: Float[Array, ""]
    P_s: Float[Array, ""]
    P_r: Float[Array, ""]
    P: Float[Array, ""] | None


def has_queue(rig: Rig) -> bool:
    """Whether something in the rig remembers so many ticks, not so much time."""
    return any(c.counts_ticks for c in (*rig.command, *rig.sensor_P, *rig.sensor_F))


def inputs_from(
    drive: Drive, t: Float[Array, ""], since: Float[Array, ""], h: Float[Array, ""]
) -> StepInput:
    """What drives the tick that begins `since` seconds into a step, at time `t`.

    The pressures are solved in as many parts of it as in the closed loop.
    """
    fine = since + h * jnp.linspace(0.0, 1.0, 2 * PARTS + 1)
    x = drive.x + drive.v * fine + drive.a / 2 * fine**2
    both = jnp.ones(2)
    return StepInput(
        h=h,
        u=drive.u,
        P_s=drive.P_s * both,
        P_r=drive.P_r * both,
        x=x,
        dx=jnp.diff(x[:: 2 * PARTS // 4]),
        v=drive.v + drive.a * (since + h),
        a=drive.a,
        t=t + h,
        P=drive.P,
    )
