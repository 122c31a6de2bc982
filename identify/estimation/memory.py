"""What all windows of a batch have in common, once for each set of values.

What friction remembers of the motion, and where the command has the spool: both over
whole segments, compiled, on all cores, along what moves them and nothing else; and kept
for the values of the last few calls, which often differ in nothing that it depends on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from hydrojax.identify.estimation.columns import Basis, ParametricRig
from hydrojax.identify.estimation.drive import SpoolPath, openings_by, rows_of
from hydrojax.identify.estimation.pieces import at_once
from hydrojax.identify.estimation.sensitivity import (
    Recalled,
    memory_along,
    memory_names,
    recall,
    recall_along,
)
from hydrojax.parameters import put
from hydrojax.plant.places import PLACES, opening_names
from hydrojax.plant.replay import Cut, Motion, Opened, Past, openings
from hydrojax.programs.compiled import program_of_pytrees

KEPT = 8
"""Values for which something is kept, of friction and spool together."""

SMALL = 2**26
"""Bytes that are kept at most for one of them: logs of minutes, not of hours."""

ABREAST = 4
"""Moves of the spool that are run at once: each run takes the opening along."""

MOVES = 8
"""Moves of the spool that programs have room for: few of what the command passes
through are fitted together. More, and they have room for all."""

Store = dict[bytes, tuple[Any, dict[int, Any]]]
"""By the values it depends on, what was worked out, and its derivatives by single
parameters."""


def recalled(
    model: ParametricRig,
    values: Float[Array | np.ndarray, "n"],
    directions: Basis | None,
    motion: Motion,
    simulate: bool,
    stores: tuple[Store, Store],
) -> Recalled:
    """What friction remembers and where the spool stands, along the directions, or
    nothing of that; without `simulate` no spool. `stores` are for the one and the
    other.
    """
    past, by, along = _friction(model, values, directions, motion, stores[0])
    if not simulate:
        return Recalled(past, by, along, None)
    hydraulic = None if directions is None else np.asarray(directions.hydraulic)
    return Recalled(
        past, by, along, spool_of(model, values, hydraulic, motion, stores[1])
    )


def _friction(
    model: ParametricRig,
    values: Float[Array | np.ndarray, "n"],
    directions: Basis | None,
    motion: Motion,
    store: Store,
) -> tuple[Past, Past | None, Float[np.ndarray, "moved columns"]]:
    """What friction remembers, and how it moves, as in `Recalled`."""
    along, moved = np.zeros((0, 0)), []
    if directions is not None:
        along = np.asarray(memory_along(model, directions))
        moved = [int(i) for i in np.flatnonzero(np.any(along != 0, axis=1))]

    def part(which: int) -> Past:
        if which < 0:
            return run_recall(model, values, motion)
        by = run_recall_along(model, values, np.int32(which), motion)
        return jax.tree.map(np.asarray, by)

    def make(anew: bool, lacks: list[int]) -> tuple[Past | None, list[Past]]:
        found = at_once(part, [-1] * anew + lacks)
        return (found[0] if anew else None), found[anew:]

    key = _key(b"friction", model, values, memory_names(model.rig))
    past, by = _remembered(store, key, moved, make)
    if directions is None:
        return past, None, along
    spare = max(len(moved) % 2, 4 - len(moved))  # few programs serve any number
    by += [jax.tree.map(lambda a: np.zeros(a.shape), past)] * spare
    stacked = jax.tree.map(lambda *a: jnp.asarray(np.stack(a)), *by)
    return past, stacked, np.pad(along[moved], ((0, spare), (0, 0)))


def spool_of(
    model: ParametricRig,
    values: Float[Array | np.ndarray, "n"],
    hydraulic: Float[np.ndarray, "n_1 k"] | None,
    motion: Motion,
    store: Store,
    cut: Cut | None = None,
) -> SpoolPath:
    """Where the command has the spool over whole segments, or over a cut of them; and
    how the hydraulic directions move it, or nothing of that.
    """
    path, at = _of_command(model, values)
    rows = rows_of(
        model, np.zeros((model.hydraulic, 0)) if hydraulic is None else hydraulic
    )
    moved = [int(i) for i in np.flatnonzero(np.any(rows != 0, axis=1))]

    def part(which: Sequence[int]) -> tuple[tuple, tuple]:
        moves = np.zeros((ABREAST, len(rows)))
        moves[np.arange(len(which)), which] = 1.0
        found = run_openings_by(path, at, moves, motion, cut)
        return jax.tree.map(np.asarray, found)

    def make(anew: bool, lacks: list[int]) -> tuple[tuple, list[tuple]]:
        if not lacks:
            return run_openings(path, at, motion, cut), []
        groups = [lacks[i : i + ABREAST] for i in range(0, len(lacks), ABREAST)]
        (now, *_), bys = zip(*at_once(part, groups), strict=True)
        each = [
            tuple(o[i] for o in by)
            for group, by in zip(groups, bys, strict=True)
            for i in range(len(group))
        ]
        return now, each

    key = _key(b"spool" if cut is None else b"cut", path, at, path.names)
    now, each = _remembered(store, key, moved, make)
    if hydraulic is None:
        room = 0
    else:
        room = MOVES if len(moved) <= MOVES < len(rows) else len(rows)
    by = tuple(np.zeros((room, *o.shape)) for o in now)
    for into, *found in zip(by, *each, strict=True):
        for row, own in zip(into, found, strict=False):
            row[:] = own
    along = np.pad(rows[moved], ((0, room - len(moved)), (0, 0)))
    now, by = jax.tree.map(jnp.asarray, (now, by))
    return SpoolPath(now, by, along)


def _of_command(
    model: ParametricRig, values: Float[Array | np.ndarray, "n"]
) -> tuple[ParametricRig, Float[np.ndarray, "m"]]:
    """The model and its values with nothing but what the command passes through: one
    program serves rigs that differ in all else.
    """
    others = [name for name, place in PLACES.items() if not place.opens]
    rig = eqx.tree_at(
        lambda r: [getattr(r, name) for name in others],
        model.rig,
        [()] * len(others),
        is_leaf=lambda x: isinstance(x, tuple),
    )
    names = opening_names(rig)
    where = np.array([model.names.index(n) for n in names], int)
    scale = np.asarray(model.scale)[where]
    return ParametricRig(rig, names, len(names), scale), np.asarray(values)[where]


def _key(
    kind: bytes,
    model: ParametricRig,
    values: Float[Array | np.ndarray, "n"],
    names: Sequence[str],
) -> bytes:
    own = np.asarray(values)[[model.names.index(n) for n in names]]
    return kind + own.tobytes()


def _remembered(
    store: Store,
    key: bytes,
    moved: list[int],
    make: Callable[[bool, list[int]], tuple[PyTree | None, list[PyTree]]],
) -> tuple[PyTree, list[PyTree]]:
    """What is kept under a key, and its derivatives by the parameters `moved`.

    `make` is asked for what is not there: for the thing itself, or not, and for some
    derivatives.
    """
    now, by = store.pop(key, (None, {}))
    lacks = [i for i in moved if i not in by]
    if now is None or lacks:
        made, more = make(now is None, lacks)
        now = made if now is None else now
        by = by | dict(zip(lacks, more, strict=True))
    if sum(a.nbytes for a in jax.tree.leaves((now, by))) < SMALL:
        store[key] = (now, by)
    for old in list(store)[:-KEPT]:
        store.pop(old, None)
    return now, [by[i] for i in moved]


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


@program_of_pytrees
def run_openings(
    model: ParametricRig,
    values: Float[Array | np.ndarray, "n"],
    motion: Motion,
    cut: Cut | None,
) -> Opened:
    """`openings`, compiled."""
    return openings(put(model.rig, model.names, values), motion, cut)


@program_of_pytrees
def run_openings_by(
    model: ParametricRig,
    values: Float[Array | np.ndarray, "n"],
    moves: Float[Array | np.ndarray, "moved names"],
    motion: Motion,
    cut: Cut | None,
) -> tuple[Opened, Opened]:
    """`openings_by`, compiled."""
    return openings_by(model, values, moves, motion, cut)
