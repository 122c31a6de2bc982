"""What all windows of a batch have in common, once for each set of values.

What friction remembers of the motion, and where the command has the spool: both over
whole segments, compiled, on all cores, along what moves them and nothing else.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from hydrojax.identify.estimation.columns import ParametricRig
from hydrojax.identify.estimation.drive import Spool, openings_by, rows_of
from hydrojax.identify.estimation.pieces import at_once
from hydrojax.identify.estimation.sensitivity import recall, recall_along
from hydrojax.parameters import put
from hydrojax.plant.replay import Motion, Opened, Past, openings
from hydrojax.programs.compiled import program_of_pytrees


@program_of_pytrees
def run_recall(
    model: ParametricRig, values: Float[Array | np.ndarray, "n"], motion: Motion
) -> Past:
    """`recall`, compiled."""
    return recall(model, values, motion)


@program_of_pytrees
def run_recall_along(
    model: ParametricRig,
    values: Float[Array | np.ndarray, "n"],
    which: Int[Array, ""] | np.integer | int,
    motion: Motion,
) -> Past:
    """`recall_along`, compiled."""
    return recall_along(model, values, which, motion)


def recall_all(
    model: ParametricRig,
    values: Float[Array | np.ndarray, "n"],
    along: Float[np.ndarray, "names columns"] | None,
    motion: Motion,
) -> tuple[Past, Past | None, Float[np.ndarray, "moved columns"]]:
    """What friction remembers, and how it moves, as in `Recalled`; on all cores.

    `along` is what `memory_along` gives, or None where no derivative is wanted.
    """
    moved = np.flatnonzero(np.any(along != 0, axis=1)) if along is not None else []

    def part(which: int) -> Past:
        if which < 0:
            return run_recall(model, values, motion)
        by = run_recall_along(model, values, np.int32(which), motion)
        return jax.tree.map(np.asarray, by)

    past, *by = at_once(part, [-1, *map(int, moved)])
    if along is None:
        return past, None, np.zeros((0, 0))
    spare = max(len(moved) % 2, 2 - len(moved))  # few programs serve any number
    by += [jax.tree.map(np.zeros_like, past)] * spare
    stacked = jax.tree.map(lambda *a: jnp.asarray(np.stack(a)), *by)
    return past, stacked, np.pad(along[moved], ((0, spare), (0, 0)))


ABREAST = 4
"""Moves of the spool that are run at once: each run takes the opening along."""

MOVES = 8
"""Moves of the spool that programs have room for: few of what the command passes
through are fitted together. More, and they have room for all."""


@program_of_pytrees
def run_openings(
    model: ParametricRig, values: Float[Array | np.ndarray, "n"], motion: Motion
) -> Opened:
    """`openings`, compiled."""
    return openings(put(model.rig, model.names, values), motion)


@program_of_pytrees
def run_openings_by(
    model: ParametricRig,
    values: Float[Array | np.ndarray, "n"],
    moves: Float[np.ndarray, "moved names"],
    motion: Motion,
) -> tuple[Opened, Opened]:
    """`openings_by`, compiled."""
    return openings_by(model, values, moves, motion)


def spool_of(
    model: ParametricRig,
    values: Float[Array | np.ndarray, "n"],
    hydraulic: Float[np.ndarray, "n_1 k"] | None,
    motion: Motion,
) -> Spool:
    """Where the command has the spool, and how the hydraulic directions move it, or
    nothing of that; on all cores.
    """
    if hydraulic is None:
        now = run_openings(model, values, motion)
        none = tuple(jnp.zeros((0, *o.shape)) for o in now)
        return Spool(now, none, np.zeros((0, 0)))
    rows = rows_of(model, hydraulic)
    moved = np.flatnonzero(np.any(rows != 0, axis=1))
    room = MOVES if len(moved) <= MOVES < len(rows) else len(rows)
    along = np.pad(rows[moved], ((0, room - len(moved)), (0, 0)))
    if not len(moved):
        now = run_openings(model, values, motion)
        still = tuple(jnp.zeros((room, *o.shape)) for o in now)
        return Spool(now, still, along)

    def part(first: int) -> tuple[Opened, Opened]:
        which = moved[first : first + ABREAST]
        moves = np.zeros((ABREAST, len(rows)))
        moves[np.arange(len(which)), which] = 1.0
        return jax.tree.map(np.asarray, run_openings_by(model, values, moves, motion))

    (now, *_), bys = zip(*at_once(part, range(0, len(moved), ABREAST)), strict=True)
    by = tuple(np.zeros((room, *o.shape)) for o in now)
    for i, own in enumerate(bys):
        for into, found in zip(by, own, strict=True):
            here = into[i * ABREAST : (i + 1) * ABREAST]
            here[:] = found[: len(here)]
    return Spool(*jax.tree.map(jnp.asarray, (now, by)), along)
