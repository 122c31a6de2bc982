"""What a model predicts in windows, and how each direction moves that.

In the stages of the replay, each with its own derivatives: memory of the motion and the
command's path once for all windows, pressures by integration (see `drive`), force tick
by tick (so that two partial derivatives serve every column that acts through the
pressures), sensors last. Each stage is run along what moves it and along nothing else.
"""

from __future__ import annotations

from functools import partial
from itertools import chain, permutations
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from hydrojax.identify.estimation.columns import (
    NUISANCE,
    READINGS,
    Basis,
    ParametricRig,
)
from hydrojax.identify.estimation.drive import Pressures, SpoolPath
from hydrojax.parameters import get, put, specs
from hydrojax.plant.replay import (
    Motion,
    Past,
    Windows,
    forces,
    friction_memory,
    sensed,
)
from hydrojax.plant.rig import Rig

SLOPE_SPREAD = 1e6
"""How well the slope of a first reading is known, Pa/s. Wide: a sensor of 8 kPa at
100 Hz, smoothed at 13 Hz, leaves a fifth of it as noise, and smoothing takes more off
where a valve has just opened."""


def memory_names(rig: Rig) -> tuple[str, ...]:
    """The parameters on which what friction remembers depends."""
    return tuple(chain(*_memory_groups(rig)))


def _memory_groups(rig: Rig) -> list[tuple[str, ...]]:
    """`memory_names` by what has them: what they do is worked out alike."""
    moved = (
        tuple(
            f"{effect.name}.{field}"
            for field in specs(effect)
            if getattr(effect, "remembered", None) is None or field in effect.remembered
        )
        for effect in (*rig.stretch, *rig.velocity, *rig.hysteresis)
    )
    return [("z_ss",), ("L_rate",), *filter(None, moved)]


class Recalled(NamedTuple):
    """What is had once for all windows: what friction sees of the motion over the whole
    log, and its derivatives by those of `memory_names` that the directions move, on a
    first axis; and the spool.

    Attributes:
        past: what friction sees.
        by: the derivatives; with no directions to move along, none.
        along: how the directions move those parameters.
        spool: where it stands; None where the pressures are the log's.
    """

    past: Past
    by: Past | None
    along: Float[Array | np.ndarray, "moved columns"]
    spool: SpoolPath | None


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
    groups = _memory_groups(here)
    first = np.cumsum([0, *map(len, groups)])

    def along(i: int) -> Past:
        def memory(of):
            return friction_memory(put(here, groups[i], of), motion)

        move = (jnp.arange(first[i], first[i + 1]) == which) + 0.0
        return jax.jvp(memory, (get(here, groups[i]),), (move,))[1]

    # A branch for all parameters of an effect: one for each takes longer to compile.
    each = [partial(along, i) for i in range(len(groups))]
    group = np.repeat(np.arange(len(groups)), np.diff(first))
    if isinstance(which, int):
        return each[group[which]]()
    return jax.lax.switch(jnp.asarray(group)[which], each)


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
