"""The sampled closed loop as a linear system at its operating point.

The Jacobian of the loop's own step, from the desired force of one sample to the output
force of the next: the hold, the delay's queue, the spool, filters and sensors are in
it because they are in the step. `system` freezes the adaptation
(`operating_point.frozen`): the response to a force that is small and short. With it
live (`live_system`) the estimates are states: integral action, which can make a loop
oscillate that is stable without it.

At rest three things have a corner: the valve's lands and the law's inverse of them at
u = 0, and presliding at F = 0. The Jacobian is the mean of those on both sides, the
first harmonic that one such corner gives a small sine. The Coulomb level does not show
at rest, since L(t) is 1 there; a deadband shows as a loop that is dead.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Complex, Float

from hydrojax.control.base import AbstractController, Measured
from hydrojax.control.loop import step_loop
from hydrojax.jax_setup import cores
from hydrojax.rigfile.quantities import Setting
from hydrojax.tune import operating_point

INPUTS = ("F_d", "u", "P_a1", "P_a2", "F")
"""Desired force (N), what is added to the command (V or 1), and the noise of three
sensors, standard normal numbers."""

OUTPUTS = ("F", "u")
"""The output force itself (N) and the command with what was added to it."""

NUDGE = 1e-6
"""Distance from a corner at which its sides are evaluated, as a share of u_max."""

STAYS = 1e-4
"""Distance from 1 within which a live loop's eigenvalue is that of what stays put: a
growth or decay over more than ten thousand samples."""


class Tapped(AbstractController):
    """A controller to whose command something is added."""

    law: AbstractController
    push: Float[Array, ""]
    u_max: Float[Array, ""]

    def init(self, measured: Measured, F_d: Float[Array, ""]) -> Any:
        """As the controller's."""
        return self.law.init(measured, F_d)

    def step(
        self,
        memory: Any,
        measured: Measured,
        F_d: Float[Array, ""],
        h: Float[Array, ""],
    ) -> tuple[Any, Float[Array, ""], dict[str, Float[Array, ""]]]:
        """As the controller's, but for the command."""
        memory, u, signals = self.law.step(memory, measured, F_d, h)
        return memory, u + self.push, signals


class System(NamedTuple):
    """`s' = A s + B i`, `o = C s + D i` from sample to sample.

    The five inputs and two outputs are `INPUTS` and `OUTPUTS`; `h` s. Stacked systems
    have leading axes.
    """

    A: Float[Array, "*batch n n"]
    B: Float[Array, "*batch n 5"]
    C: Float[Array, "*batch 2 n"]
    D: Float[Array, "*batch 2 5"]
    h: Float[Array, "*batch"]


def _sides(setting: Setting, carry: Any) -> list[tuple[Any, float]]:
    """The state on both sides of rest's corners, and what F_d is nudged by, N."""
    out = []
    for sign in (1.0, -1.0):
        nudge = -sign * NUDGE * setting.loop.law.u_max
        command = jax.tree.map(
            lambda a, b: jnp.where(a == 0, b, a),
            carry.plant.command,
            setting.loop.rig.command_init(nudge),
        )
        P_1, P_2 = carry.plant.P
        plant = carry.plant._replace(command=command, P=(P_1, P_2 + sign))
        out.append((carry._replace(plant=plant), sign * 1e-2))
    return out


class States(NamedTuple):
    """Which numbers of the memory are states: `at` [k], and of them the first of each
    group that is always equal; `group` [k] says of each to which it belongs.
    """

    at: tuple[int, ...]
    group: tuple[int, ...]


def _jacobian(
    setting: Setting, carry: Any, nudge: Array, states: States | None
) -> System:
    flat, unravel = ravel_pytree(carry)
    if states is None:
        every = tuple(range(flat.size))
        states = States(every, every)
    index, group = np.array(states.at), np.array(states.group)
    lead = index[[states.group.index(g) for g in range(max(states.group) + 1)]]
    loop = setting.loop

    def advance(off, i):
        noise = jnp.stack([i[2], i[3], jnp.zeros_like(i[4]), i[4]])
        one = operating_point.scenario(
            setting, (setting.F_0 + i[0])[None], noise[None], jnp.zeros(1)
        )
        tapped = eqx.tree_at(
            lambda lo: lo.law, loop, Tapped(loop.law, i[1], loop.law.u_max)
        )
        state = unravel(flat.at[index].add(off[group]))
        new, now = step_loop(tapped, state, operating_point.moment(one, 0))
        return ravel_pytree(new)[0][lead], jnp.stack([now["true_F"], now["u"]])

    i = jnp.zeros(len(INPUTS)).at[0].set(nudge)
    (A, B), (C, D) = jax.jacfwd(advance, argnums=(0, 1))(jnp.zeros(lead.size), i)
    return System(A, B, C, D, loop.h)


def system(setting: Setting, carry: Any, states: States | None = None) -> System:
    """The loop's linear system with its adaptation frozen; see `live_system`."""
    held = eqx.tree_at(lambda s: s.loop, setting, operating_point.frozen(setting.loop))
    return live_system(held, carry, states)


def live_system(setting: Setting, carry: Any, states: States | None = None) -> System:
    """The loop's linear system, its adaptation at work.

    Args:
        setting: the loop and its point.
        carry: the memory there, as `operating_point.initial_state` gives it.
        states: which numbers of the memory matter, as `find_states` gives it; all if
            None.
    """
    sides = jax.tree.map(lambda *a: jnp.stack(a), *_sides(setting, carry))
    both = jax.vmap(lambda side: _jacobian(setting, *side, states=states))(sides)
    return jax.tree.map(lambda a: jnp.mean(a, axis=0), both)


def find_states(systems: System) -> States:
    """Which numbers of the memory lie between an input and an output.

    Args:
        systems: full ones, stacked [m, ...], of settings that span those to come.

    What no input reaches is constant; what reaches no output has no influence: the
    queue beyond the delay, mean pressures, estimates. Of numbers that are always equal,
    such as a reading without lag and the signal it reads, one is kept.
    """
    rows = np.concatenate([np.asarray(systems.A), np.asarray(systems.B)], axis=-1)
    A, B, C = (np.any(np.asarray(a) != 0, axis=0) for a in systems[:3])
    reached, seen = B.any(axis=1), C.any(axis=0)
    for _ in range(A.shape[0]):
        reached = reached | (A @ reached)
        seen = seen | (seen @ A)
    at = np.flatnonzero(reached & seen)
    group, leads = [], []
    for i in at:
        size = np.max(np.abs(rows[:, i]))
        same = (
            g
            for g, lead in enumerate(leads)
            if np.max(np.abs(rows[:, i] - rows[:, lead])) <= 1e-13 * size
        )
        g = next(same, len(leads))
        if g == len(leads):
            leads.append(i)
        group.append(g)
    return States(tuple(int(i) for i in at), tuple(group))


def frequency_response(
    s: System, hertz: Float[Array, "lines"]
) -> Complex[Array, "lines 2 5"]:
    """Frequency response from every input to every output."""
    n = s.A.shape[0]
    z = jnp.exp(2j * jnp.pi * hertz * s.h)

    def one(z):
        return s.C @ jnp.linalg.solve(z * jnp.eye(n) - s.A, s.B.astype(complex)) + s.D

    return jax.vmap(one)(z)


def responses(
    s: System, hertz: Float[np.ndarray, "lines"]
) -> Complex[np.ndarray, "rows lines 2 5"]:
    """`frequency_response` of stacked systems of NumPy arrays: nothing is compiled."""

    def some(s: System) -> Complex[np.ndarray, "rows lines 2 5"]:
        z = np.exp(2j * np.pi * hertz * s.h[:, None])
        away = z[..., None, None] * np.eye(s.A.shape[-1]) - s.A[:, None]
        inside = np.linalg.solve(away, s.B[:, None].astype(complex))
        return np.asarray(s.C)[:, None] @ inside + np.asarray(s.D)[:, None]

    each = zip(*(np.array_split(np.asarray(a), cores()) for a in s), strict=True)
    with ThreadPoolExecutor(cores()) as pool:
        parts = list(pool.map(lambda own: some(System(*own)), each))
    return np.concatenate(parts)


def reduced(s: System, states: States) -> System:
    """Stacked full systems, of NumPy arrays, on these states alone."""
    at, group = np.array(states.at), np.array(states.group)
    lead = at[np.unique(group, return_index=True)[1]]
    put = np.eye(lead.size)[group]  # each state's column goes to its group's
    return System(
        s.A[:, lead][:, :, at] @ put, s.B[:, lead], s.C[:, :, at] @ put, s.D, s.h
    )


def largest_eigenvalue(s: System) -> Float[np.ndarray, "rows"]:
    """The largest |eigenvalue| of stacked live systems but those of what stays put.

    Estimates that nothing distinguishes, such as the Coulomb level and the offset at a
    constant speed, stay put together: eigenvalues of 1 that rounding spreads. inf where
    there is no system: its point was never reached.
    """
    A = np.asarray(s.A)
    there = np.asarray(np.all(np.isfinite(A), axis=(-2, -1)))
    values = np.linalg.eigvals(np.where(there[..., None, None], A, 0.0))
    most = np.max(np.where(np.abs(values - 1) < STAYS, 0.0, np.abs(values)), axis=-1)
    return np.where(there, most, np.inf)


def radius(s: System) -> Float[Array, ""]:
    """The largest |eigenvalue| but those of what stays put: below 1, it is stable.

    A mean pressure with the valve shut, or a free mass's place, stays put: an
    eigenvalue of 1 within 1e-7.
    """
    values = jnp.linalg.eigvals(s.A)
    return jnp.max(jnp.where(jnp.abs(values - 1) < 1e-7, 0.0, jnp.abs(values)))
