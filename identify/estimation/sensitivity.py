"""What a model predicts in windows, and how each direction moves that.

Forward mode in the stages of the replay, each with its own derivatives: memory of the
motion once for all windows, the command's path, pressures by integration, force tick by
tick (so that two partial derivatives serve every column that acts through the
pressures), sensors last. Each stage is run along what moves it and along nothing else.
"""

from __future__ import annotations

from functools import partial
from itertools import permutations
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from hydrojax.identify.estimation.columns import (
    NUISANCE,
    READINGS,
    SUPPLY_BLOCKS,
    Basis,
    Batch,
    ParametricRig,
)
from hydrojax.parameters import get, put, specs
from hydrojax.plant.places import opening_names
from hydrojax.plant.replay import (
    Motion,
    Past,
    Windows,
    at_start,
    forces,
    friction_memory,
    openings,
    pressures_behind,
    sensed,
)
from hydrojax.plant.rig import Rig

SLOPE_SPREAD = 1e6
"""How well the slope of a first reading is known, Pa/s. Wide: a sensor of 8 kPa at
100 Hz, smoothed at 13 Hz, leaves a fifth of it as noise, and smoothing takes more off
where a valve has just opened."""


def memory_names(rig: Rig) -> tuple[str, ...]:
    """The parameters on which what friction remembers depends."""
    moved = (
        f"{effect.name}.{field}"
        for effect in (*rig.stretch, *rig.velocity, *rig.hysteresis)
        for field in specs(effect)
        if getattr(effect, "remembered", None) is None or field in effect.remembered
    )
    return ("z_ss", "L_rate", *moved)


class Recalled(NamedTuple):
    """What friction sees of the motion over the whole log, and its derivatives by those
    of `memory_names` that the directions move, on a first axis.

    Attributes:
        past: what it sees.
        by: the derivatives; with no directions to move along, none.
        along: how the directions move those parameters.
    """

    past: Past
    by: Past | None
    along: Float[Array | np.ndarray, "moved columns"]


def memory_along(
    model: ParametricRig, directions: Basis
) -> Float[Array | np.ndarray, "names columns"]:
    """How the directions move each of `memory_names`; NumPy's where they are known."""
    traced = any(isinstance(d, Tracer) for d in directions)
    xp = jnp if traced else np
    hydraulic, other = directions if traced else map(np.asarray, directions)
    pair = (hydraulic, other)
    off = [xp.zeros((len(a), b.shape[1])) for a, b in permutations(pair)]
    every = xp.block([[hydraulic, off[0]], [off[1], other]])
    return every[np.array([model.names.index(m) for m in memory_names(model.rig)])]


def recall(
    model: ParametricRig, values: Float[Array | np.ndarray, "n"], motion: Motion
) -> Past:
    """What friction remembers of the motion, once for all windows."""
    return friction_memory(put(model.rig, model.names, values), motion)


def recall_along(
    model: ParametricRig,
    values: Float[Array | np.ndarray, "n"],
    which: Int[Array, ""] | np.integer | int,
    motion: Motion,
) -> Past:
    """The derivative of `recall` by one of `memory_names`."""
    here = put(model.rig, model.names, values)

    def along(name: str) -> Past:
        def memory(of):
            return friction_memory(put(here, (name,), of), motion)

        return jax.jvp(memory, (get(here, (name,)),), (jnp.ones(1),))[1]

    each = [partial(along, name) for name in memory_names(here)]
    return each[which]() if isinstance(which, int) else jax.lax.switch(which, each)


class Pressures(NamedTuple):
    """Both pressures (Pa), and their derivatives along k_1 hydraulic directions and
    each of the windows' own unknowns (`NUISANCE`).
    """

    P: tuple[Float[Array, "windows ticks"], Float[Array, "windows ticks"]]
    by: tuple[Float[Array, "k windows ticks"], Float[Array, "k windows ticks"]]


ABREAST = 2
"""Derivatives of the spool's opening that are run at once: a fit moves a few of the 15
or so parameters that the command passes through in a trace, and each run takes the
opening itself along."""

Opened = tuple[Float[Array, "ticks windows"], ...]
"""The spool's opening, as `Point` has it."""

OpenedBy = tuple[Float[Array, "columns ticks windows"], ...]
"""Its derivatives."""


def opened_along(
    model: ParametricRig,
    values: Float[Array, "n"],
    hydraulic: Float[Array, "n_1 k"],
    w: Windows,
) -> tuple[Opened, OpenedBy]:
    """The spool's opening, and how it moves along hydraulic directions.

    Only what the command passes through and the edges' lands move it: no other
    derivative is run, nor those by what no direction moves. `ABREAST` of them run at
    once.
    """
    here = put(model.rig, model.names[: model.hydraulic], values[: model.hydraulic])
    names = opening_names(here)
    opened, k = openings(here, w), hydraulic.shape[1]
    if not names or not k:
        return opened, jax.tree.map(lambda a: jnp.zeros((k, *a.shape)), opened)
    rows = hydraulic[np.array([model.names.index(name) for name in names])]
    at = get(here, names)
    moves = jnp.any(rows != 0, axis=1)
    first = jnp.argsort(~moves)  # what moves ahead of what does not
    more = -len(names) % ABREAST

    def in_parts(a):
        padded = jnp.pad(a[first], ((0, more), *[(0, 0)] * (a.ndim - 1)))
        return padded.reshape(-1, ABREAST, *a.shape[1:])

    def along(d):
        return jax.jvp(lambda of: openings(put(here, names, of), w), (at,), (d,))[1]

    def still() -> OpenedBy:
        return jax.tree.map(lambda a: jnp.zeros((ABREAST, *a.shape)), opened)

    def part(of):
        moved, each = of
        return jax.lax.cond(jnp.any(moved), lambda: jax.vmap(along)(each), still)

    by = jax.lax.map(part, (in_parts(moves), in_parts(jnp.eye(len(names)))))

    def combined(a):
        a = a.reshape(-1, *a.shape[2:])[: len(names)]
        return jnp.tensordot(rows[first].T, a, axes=1)

    return opened, jax.tree.map(combined, by)


def driven_pressures(
    model: ParametricRig,
    values: Float[Array, "n"],
    directions: Basis,
    batch: Batch,
    simulate: bool,
) -> Pressures:
    """The pressures along the hydraulic directions, the two initial pressures (per
    Pa), and the supply's error in each block (per standard deviation of its mean); what
    the sensors read at first moves none.

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

    opened, by = opened_along(model, values, directions.hydraulic, w)
    # What each window has of its own does not move the spool.
    own = 2 + SUPPLY_BLOCKS
    by = jax.tree.map(lambda a: jnp.pad(a, ((0, own), (0, 0), (0, 0))), by)

    def run(d, P_shift, supply, opened):
        # What does not move the rig has no derivative by it to be run along.
        move = directions.hydraulic @ d if k_1 else 0.0
        at = put(rig, names[:n], values[:n] + move)
        moved = w._replace(P_s=w.P_s + of_mean * supply[block])
        P_0 = at_start(at, moved, batch.P_0 + P_shift)
        return pressures_behind(at, moved, P_0, opened)

    def along(e, by):
        parts = (e[:k_1], e[k_1 : k_1 + 2], e[k_1 + 2 :], by)
        return jax.jvp(run, zero, parts)

    zero = (jnp.zeros(k_1), jnp.zeros(2), jnp.zeros(SUPPLY_BLOCKS), opened)
    P, by = jax.vmap(along, out_axes=(None, 0))(jnp.eye(k_1 + own), by)
    still = ((0, READINGS), (0, 0), (0, 0))
    return Pressures(P, (jnp.pad(by[0], still), jnp.pad(by[1], still)))


def sensitivities(
    model: ParametricRig,
    values: Float[Array, "n"],
    directions: Basis,
    w: Windows,
    pressure: Pressures,
    recalled: Recalled,
) -> tuple[Float[Array, "windows ticks 3"], Float[Array, "columns windows ticks 3"]]:
    """Predictions and their derivatives along k + `NUISANCE` columns, SI.

    The columns are those of `directions`, then what each window has of its own, the
    first readings per Pa and their slopes per `SLOPE_SPREAD`;
    `pressure` is of these windows, `recalled` of the motion they are cut from.
    """
    names, n = model.names, model.hydraulic
    here = put(model.rig, names, values)
    past = recalled.past.within(w)
    k_1, k_2 = directions.hydraulic.shape[1], directions.other.shape[1]
    P_1, P_2 = pressure.P

    def moved(d):
        return put(here, names[n:], values[n:] + directions.other @ d) if k_2 else here

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
    if recalled.by is not None:
        by_memory = _through_memory(here, w, pressure.P, past, recalled.by)
        by_memory = jnp.tensordot(recalled.along.T, by_memory, axes=1)
        d_F = d_F.at[: k_1 + k_2].add(by_memory)

    def read(d, P_1, P_2, F, first):
        # What filters the supply's reading too moves pressures and readings both.
        at = values[:n] + directions.hydraulic @ d[:k_1]
        begun = w._replace(
            P_a1=w.P_a1.at[:, 0].add(first[0]),
            P_a2=w.P_a2.at[:, 0].add(first[1]),
            dP=w.dP.at[:, 0, :2, 0].add(SLOPE_SPREAD * first[2:]),
        )
        return sensed(put(moved(d[k_1:]), names[:n], at), begun, P_1, P_2, F)

    k = k_1 + k_2
    at = (jnp.zeros(k), P_1, P_2, F, jnp.zeros(READINGS))
    last = jnp.eye(k + NUISANCE, READINGS, READINGS - k - NUISANCE)
    return jax.vmap(lambda *along: jax.jvp(read, at, along), out_axes=(None, 0))(
        jnp.eye(k + NUISANCE, k), *d_P, d_F, last
    )


def _partial(f, at: Array) -> tuple[Array, Array]:
    """Value and derivative of a function of each element by itself."""
    return jax.jvp(f, (at,), (jnp.ones_like(at),))


def _through_memory(
    here: Rig, w: Windows, P: tuple[Array, Array], past: Past, by: Past
) -> Float[Array, "names windows ticks"]:
    """How the force moves with each of what moves what friction remembers."""

    def one(by):
        along = (by.within(w),)
        return jax.jvp(lambda p: forces(here, w, *P, p), (past,), along)[1]

    return jax.vmap(one)(by)
