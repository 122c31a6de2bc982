"""The columns of a fit: what a model predicts in windows, and how that moves.

Forward mode in the stages of the replay, each with its own derivatives: memory of the
motion once for all windows, pressures by integration, force tick by tick (so that two
partial derivatives serve every column that acts through the pressures), sensors last.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hydrojax.parameters import get, parameter_specs, put, scales, specs
from hydrojax.plant.places import hydraulic_names
from hydrojax.plant.replay import (
    Motion,
    Past,
    Windows,
    forces,
    friction_memory,
    pressures,
    sensed,
)
from hydrojax.plant.rig import Rig

SUPPLY_BLOCKS = 3
"""Pieces of a window in each of which the supply's measurement error is a constant."""

NUISANCE = 2 + SUPPLY_BLOCKS
"""What each window has of its own: two initial pressures, and the supply's errors."""


class ParametricRig(NamedTuple):
    """A rig and the order of its parameters: hydraulic ones first.

    Attributes:
        rig: the rig.
        names: of its n parameters.
        hydraulic: how many of them, at the head, the pressures depend on.
        scale: unit of the optimiser's coordinate of each parameter, SI.
    """

    rig: Rig
    names: tuple[str, ...]
    hydraulic: int
    scale: Float[np.ndarray, "n"]

    @classmethod
    def of(cls, rig: Rig) -> ParametricRig:
        """The model of a rig, with every parameter it has."""
        spec = parameter_specs(rig)
        first = hydraulic_names(rig)
        names = tuple(sorted(spec, key=lambda n: n not in first))
        return cls(rig, names, len(first), scales(spec[n] for n in names))

    @property
    def values(self) -> Float[Array, "n"]:
        """The rig's own values, SI."""
        return get(self.rig, self.names)


class Batch(NamedTuple):
    """What a fit runs on, as arrays.

    Attributes:
        motion: of whole segments.
        windows: cut from them.
        P_0: first guess of the pressures at each window's first tick, Pa.
        noise: standard deviation of each channel, SI; inf where it is not compared.
        supply_noise: standard deviation of the measured P_s, Pa (0 where the log has
            none): white noise there integrates to a drift of the pressures, which would
            otherwise be taken for a fault of the model.
        weight: of each window; 0 for padding.
    """

    motion: Motion
    windows: Windows
    P_0: Float[Array | np.ndarray, "windows 2"]
    noise: Float[Array | np.ndarray, "3"]
    supply_noise: Float[Array | np.ndarray, ""]
    weight: Float[Array | np.ndarray, "windows"]


class Basis(NamedTuple):
    """Directions in the space of hydraulic parameters, and of the others; SI."""

    hydraulic: Float[Array, "n_1 k_1"]
    other: Float[Array, "n_2 k_2"]


def basis(
    model: ParametricRig, names: tuple[str, ...], slots: tuple[int, int]
) -> Basis:
    """One direction per named parameter, one unit of its scale; spare slots are 0.

    Raises:
        ValueError: more names than slots.
    """
    out = [
        np.zeros((model.hydraulic, slots[0])),
        np.zeros((len(model.names) - model.hydraulic, slots[1])),
    ]
    used = [0, 0]
    for name in names:
        i = model.names.index(name)
        side = int(i >= model.hydraulic)
        if used[side] == slots[side]:
            raise ValueError(f"no slot left for {name}")
        out[side][i - side * model.hydraulic, used[side]] = model.scale[i]
        used[side] += 1
    return Basis(*(jnp.asarray(a) for a in out))


def slot_names(
    model: ParametricRig, names: tuple[str, ...], slots: tuple[int, int]
) -> list[str | None]:
    """Which parameter stands in each column of `basis`, None for a spare one."""
    first = [n for n in names if model.names.index(n) < model.hydraulic]
    rest = [n for n in names if n not in first]
    spare = [[None] * (slots[0] - len(first)), [None] * (slots[1] - len(rest))]
    return [*first, *spare[0], *rest, *spare[1]]


def memory_names(rig: Rig) -> tuple[str, ...]:
    """The parameters on which bristle, filtered speed and films depend."""
    moved = (
        f"{effect.name}.{field}"
        for effect in (*rig.stretch, *rig.velocity)
        for field in specs(effect)
    )
    return ("z_ss", "L_rate", *moved)


class Recalled(NamedTuple):
    """What friction sees of the motion over the whole log, and its derivatives by each
    parameter of `memory_names`, on a first axis.
    """

    past: Past
    by: Past


def recall(model: ParametricRig, values: Float[Array, "n"], motion: Motion) -> Recalled:
    """What friction remembers of the motion: once for all windows."""
    here = put(model.rig, model.names, values)
    names = memory_names(here)

    def memory(of):
        return friction_memory(put(here, names, of), motion)

    at = get(here, names)
    along = jax.vmap(lambda row: jax.jvp(memory, (at,), (row,)), out_axes=(None, 0))
    return Recalled(*along(jnp.eye(len(names))))


class Pressures(NamedTuple):
    """Both pressures (Pa), and their derivatives along k_1 hydraulic directions and
    each of the windows' own unknowns (`NUISANCE`).
    """

    P: tuple[Float[Array, "windows ticks"], Float[Array, "windows ticks"]]
    by: tuple[Float[Array, "k windows ticks"], Float[Array, "k windows ticks"]]


def driven_pressures(
    model: ParametricRig,
    values: Float[Array, "n"],
    directions: Basis,
    batch: Batch,
    simulate: bool,
) -> Pressures:
    """The pressures along the hydraulic directions, the two initial pressures (per
    Pa), and the supply's error in each block (per standard deviation of its mean).

    With `simulate` False they are the log's, and nothing moves them.
    """
    rig, names, n = model.rig, model.names, model.hydraulic
    w = batch.windows
    k_1 = directions.hydraulic.shape[1]
    if not simulate:
        still = jnp.zeros((k_1 + NUISANCE, *w.P_a1.shape))
        return Pressures((w.P_a1, w.P_a2), (still, still))
    ticks = w.P_s.shape[1]
    block = jnp.arange(ticks) * SUPPLY_BLOCKS // ticks
    of_mean = batch.supply_noise / np.sqrt(ticks / SUPPLY_BLOCKS)

    def run(d, P_shift, supply):
        at = put(rig, names[:n], values[:n] + directions.hydraulic @ d)
        moved = w._replace(P_s=w.P_s + of_mean * supply[block])
        return pressures(at, moved, batch.P_0 + P_shift)

    zero = (jnp.zeros(k_1), jnp.zeros(2), jnp.zeros(SUPPLY_BLOCKS))
    return Pressures(
        *jax.vmap(
            lambda e: jax.jvp(run, zero, (e[:k_1], e[k_1 : k_1 + 2], e[k_1 + 2 :])),
            out_axes=(None, 0),
        )(jnp.eye(k_1 + NUISANCE))
    )


def sensitivities(
    model: ParametricRig,
    values: Float[Array, "n"],
    directions: Basis,
    w: Windows,
    pressure: Pressures,
    recalled: Recalled,
) -> tuple[Float[Array, "windows ticks 3"], Float[Array, "columns windows ticks 3"]]:
    """Predictions and their derivatives along k + `NUISANCE` columns, SI.

    The columns are those of `directions`, then what each window has of its own;
    `pressure` is of these windows, `recalled` of the motion they are cut from.
    """
    names, n = model.names, model.hydraulic
    here = put(model.rig, names, values)
    past = recalled.past.within(w)
    k_1, k_2 = directions.hydraulic.shape[1], directions.other.shape[1]
    P_1, P_2 = pressure.P

    def moved(d):
        return put(here, names[n:], values[n:] + directions.other @ d)

    F, F_1 = _partial(lambda p: forces(here, w, p, P_2, past), P_1)
    F_2 = _partial(lambda p: forces(here, w, P_1, p, past), P_2)[1]
    zero = jnp.zeros(k_2)

    def force(d):
        return forces(moved(d), w, P_1, P_2, past)

    own = jax.vmap(lambda e: jax.jvp(force, (zero,), (e,))[1])(jnp.eye(k_2))
    by_1, by_2 = pressure.by
    still = jnp.zeros((k_2, *P_1.shape))
    d_P = [jnp.concatenate([d[:k_1], still, d[k_1:]]) for d in (by_1, by_2)]
    through = F_1 * by_1 + F_2 * by_2
    d_F = jnp.concatenate([through[:k_1], own, through[k_1:]])
    d_F = d_F + _through_memory(model, here, directions, w, pressure.P, recalled)

    def read(d, P_1, P_2, F):
        return sensed(moved(d), w, P_1, P_2, F)

    at = (zero, P_1, P_2, F)
    aside = jnp.zeros((k_1 + NUISANCE, k_2))
    sensor = jnp.concatenate([aside[:k_1], jnp.eye(k_2), aside[k_1:]])
    return jax.vmap(lambda *along: jax.jvp(read, at, along), out_axes=(None, 0))(
        sensor, *d_P, d_F
    )


def _partial(f, at: Array) -> tuple[Array, Array]:
    """Value and derivative of a function of each element by itself."""
    return jax.jvp(f, (at,), (jnp.ones_like(at),))


def _through_memory(
    model: ParametricRig,
    here: Rig,
    directions: Basis,
    w: Windows,
    P: tuple[Array, Array],
    recalled: Recalled,
) -> Array:
    """How the force moves with what friction remembers, [k + NUISANCE, W, lead+T]."""
    past = recalled.past.within(w)

    def one(by):
        along = (by.within(w),)
        return jax.jvp(lambda p: forces(here, w, *P, p), (past,), along)[1]

    k_1, k_2 = directions.hydraulic.shape[1], directions.other.shape[1]
    every = jnp.zeros((len(model.names), k_1 + k_2 + NUISANCE))
    every = every.at[: model.hydraulic, :k_1].set(directions.hydraulic)
    every = every.at[model.hydraulic :, k_1 : k_1 + k_2].set(directions.other)
    rows = np.array([model.names.index(m) for m in memory_names(here)])
    return jnp.tensordot(every[rows].T, jax.vmap(one)(recalled.by), axes=1)
