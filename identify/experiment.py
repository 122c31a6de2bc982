"""What an experiment would identify, computed before it is recorded.

The information about the parameters follows from the model: it is that of the replay
that `identify` would run on the log. Amplitudes of sines in the desired force and in
the motion give the run in closed loop, the run gives the replay's windows, and these
give the standard deviations of the parameters, all differentiable.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hydrojax.control.loop import Loop, Scenario
from hydrojax.control.simulation import PARTS
from hydrojax.identify.estimation.columns import Batch, ParametricRig, basis, slot_names
from hydrojax.identify.estimation.misfit import sums
from hydrojax.identify.preparation.windows import PRE, QUARTERS
from hydrojax.plant.load import EnvironmentMotion
from hydrojax.plant.replay import Motion, Windows

FORCE_HZ = (0.1, 0.23, 0.5, 1.1, 2.3, 4.7, 9.0, 16.0, 27.0, 45.0)
MOTION_HZ = (0.07, 0.13, 0.23, 0.41, 0.73, 1.3, 2.3)
"""Frequencies of the sines whose amplitudes are found."""

LEAD, WINDOW = 20, 250
"""Ticks of a replay window that are run but not compared, and those that are."""

SLACK = 0.05
"""Share of the supply's range, and of the command's, that is to stay unused."""

ENOUGH = 0.005
"""Relative standard deviation below which a better one is worth little."""

PENALTY = 1e4
"""Weight of the mean square excess over the rig's limits, against the log of a
standard deviation."""

RIDGE = 1e-3
"""Prior information on each parameter, per scale squared: the variance of an
unidentifiable one stays finite."""

Trajectory = Callable[[Float[Array, "*t"], int], Float[Array, "*t"]]
"""The motion (m) at times (s), or its derivative of some order."""

Phases = tuple[Float[np.ndarray, "forces"], Float[np.ndarray, "motions"]]
"""Of the sines in force and in motion, rad."""


@dataclass(frozen=True)
class ExcitationLimits:
    """Limits of the excitation.

    Attributes:
        force: largest desired force, N.
        speed: largest speed of the piston, m/s.
        travel: largest distance of the piston from mid-stroke, m.
        seconds: length of the experiment, s.
    """

    force: float = 800.0
    speed: float = 0.025
    travel: float = 0.02
    seconds: float = 8.0


class Waves(NamedTuple):
    """Amplitudes of the sines in force (N) and motion (m)."""

    force: Float[Array, "forces"]
    motion: Float[Array, "motions"]


class Setup(NamedTuple):
    """The model, its values (SI), the free parameters, and those of interest; sample
    period (s), return and supply pressure (Pa).
    """

    model: ParametricRig
    values: Float[Array, "n"]
    names: tuple[str, ...]
    wanted: tuple[str, ...]
    h: float
    P_r: float
    P_s: float


def _share(logits: Array) -> Array:
    """Positive shares that sum to less than one."""
    return jax.nn.softmax(jnp.append(logits, -2.0))[:-1]


def waves(design: Float[Array, "logits"], limits: ExcitationLimits) -> Waves:
    """Amplitudes from logits, those of the force first.

    At any phases the sums of sines keep the limits of force, speed and travel.
    """
    n = len(FORCE_HZ)
    w = 2 * jnp.pi * jnp.array(MOTION_HZ)
    speed = _share(design[n:])
    reach = jnp.maximum(
        jnp.sum(speed) / limits.speed, jnp.sum(speed / w) / limits.travel
    )
    return Waves(limits.force * _share(design[:n]), speed / w / reach)


def excitation(
    at: Waves, phases: Phases, n: int, setup: Setup
) -> tuple[Scenario, Trajectory]:
    """The scenario with these amplitudes, without noise, and its motion."""
    w_F = 2 * np.pi * np.array(FORCE_HZ)
    w_x = 2 * np.pi * np.array(MOTION_HZ)

    def path(t, nu):
        angle = jnp.multiply(t[..., None], w_x) + phases[1] + nu * np.pi / 2
        return jnp.sum(at.motion * w_x**nu * jnp.sin(angle), axis=-1)

    t = jnp.arange(n) * setup.h
    F_d = jnp.sum(at.force * jnp.sin(t[:, None] * w_F + phases[0]), axis=-1)
    part = np.arange(PARTS)[:, None] + np.array([0.0, 0.5, 1.0])
    halves = t[:, None, None] + setup.h / PARTS * part
    environment = EnvironmentMotion(
        path(halves, 0), path(halves[..., 2], 1), path(halves[..., 2], 2)
    )
    flat = jnp.ones((n, 2))
    return Scenario(
        t, F_d, jnp.zeros((n, 4)), setup.P_s * flat, setup.P_r * flat, environment
    ), path


def log_batch(
    table: Float[Array, "ticks 4"],
    path: Trajectory,
    noise: Float[np.ndarray, "3"],
    supply: float,
    setup: Setup,
) -> Batch:
    """The windows that `identify` would cut from a run's log.

    `table` holds u (V), P_a1, P_a2 (Pa) and F (N).
    """
    n = table.shape[0]
    t = jnp.arange(n) * setup.h
    first = np.arange(PRE, n - LEAD - WINDOW, WINDOW)
    index = first[:, None] + np.arange(LEAD + WINDOW)
    quarters = t[:-1, None] + setup.h * np.arange(QUARTERS + 1) / QUARTERS
    fine = t[index[:, :-1]][..., None] + setup.h * np.array([0.0, 0.5, 1.0])
    like = jnp.ones(index.shape)
    windows = Windows(
        seg=jnp.zeros(len(first), int),
        first=jnp.asarray(first),
        before_h=setup.h * jnp.ones((len(first), PRE)),
        P_before=table[first[:, None] - PRE + np.arange(PRE), 1:3],
        u=table[index, 0],
        h=setup.h * like,
        P_s=setup.P_s * like,
        P_r=setup.P_r * like,
        t=t[index],
        x=path(t[index], 0),
        v=path(t[index], 1),
        a=path(t[index], 2),
        F=table[index, 3],
        x_fine=path(fine, 0),
        P_a1=table[index, 1],
        P_a2=table[index, 2],
        dP=_derivatives(table[:, 1:3], setup.h)[index],
        measured=jnp.zeros((len(first), WINDOW, 3)),
        filtered=jnp.ones(len(first)),
    )
    dx = jnp.diff(path(quarters, 0), axis=1)[None]
    v = path(t, 1)[None]
    ticks = setup.h * jnp.ones((1, n - 1))
    motion = Motion(
        u=table[None, :, 0],
        runs_on=jnp.zeros(1),
        dx=dx,
        h=ticks,
        speed0=jnp.abs(v[:, 0]),
        v=v,
        F=table[None, :, 3],
        P_0=(table[:1, 1], table[:1, 2]),
    )
    return Batch(
        motion,
        windows,
        table[first, 1:3],
        jnp.asarray(noise),
        jnp.asarray(supply),
        jnp.ones(len(first)),
    )


def _derivatives(P: Float[Array, "ticks 2"], h: float) -> Float[Array, "ticks 3 2"]:
    """First and second derivative of P_a1, P_a2 and a supply that stands still."""
    slope = jnp.asarray(jnp.gradient(P, h, axis=0))
    along = jnp.stack([slope, jnp.asarray(jnp.gradient(slope, h, axis=0))], axis=-1)
    return jnp.pad(along, ((0, 0), (0, 1), (0, 0)))


def information(setup: Setup, batch: Batch) -> tuple[Float[Array, "k k"], list[str]]:
    """Information matrix of the columns, per scale, and their names in its order."""
    first = sum(setup.model.names.index(n) < setup.model.hydraulic for n in setup.names)
    slots = (first, len(setup.names) - first)
    directions = basis(setup.model, setup.names, slots)
    gram = sums(setup.model, setup.values, directions, batch, True).gram
    order = [n for n in slot_names(setup.model, setup.names, slots) if n is not None]
    total = jnp.sum(gram, axis=0)[:-1, :-1]
    return total + RIDGE * jnp.eye(len(order)), order


def variances(
    information: Float[Array, "k k"], order: list[str], wanted: Sequence[str]
) -> Float[Array, "wanted"]:
    """Variance of each parameter of interest, all others free, per scale squared."""
    variance = jnp.diag(jnp.linalg.inv(information))
    return variance[np.array([order.index(n) for n in wanted])]


def excess(
    table: Float[Array, "ticks 4"], loop: Loop, setup: Setup, force: float
) -> Float[Array, ""]:
    """Mean square excess of pressures, command and force over their limits."""
    margin = SLACK * (setup.P_s - setup.P_r)
    low, high = setup.P_r + margin - table[:, 1:3], table[:, 1:3] - (setup.P_s - margin)
    full = jnp.abs(table[:, :1]) / loop.law.u_max - (1 - SLACK)
    # Beyond the loop's resonance the force exceeds the desired one.
    high_force = jnp.abs(table[:, 3:]) / force - 1
    over = jnp.concatenate(
        [low / setup.P_s, high / setup.P_s, full, high_force], axis=1
    )
    return jnp.mean(jnp.maximum(over, 0.0) ** 2)
