"""A sweep's runs in C that is written of the simulator's own step.

The C is compiled once for a sweep and runs 32 cells side by side. That takes a C
compiler and some seconds, so it is for sweeps in which it saves more (`WORTH`). What it
finds in some cells (`CHECKED`) is held to XLA's, and XLA runs the sweep where they
differ.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hydrojax.errors import InputError
from hydrojax.export.codegen.graph import DOUBLE, LANE, TICK, Graph
from hydrojax.export.codegen.running import flat, stepper
from hydrojax.export.codegen.scalarise import scalarise
from hydrojax.programs.compiled import program
from hydrojax.tune import measure, operating_point
from hydrojax.tune.plan import Plan

WORTH = 6e7
"""Control periods, of all cells together, from which C pays: XLA takes longer by what
it takes to write, compile and check it (`python -m benchmarks.speed --only sweep`)."""

CHECKED = 100
"""Cells, spread over the sweep, in which C is held to XLA."""

ALIKE = 1e-9
"""Part of a signal's largest value by which C may differ from XLA."""

NUDGE = 1e-12
"""Part by which the desired force is changed to see whether XLA's own run parts from
itself: a loop that does not come to rest (a limit cycle) lets the last digit grow."""

OWN = 100.0
"""How many times farther than from its own nudged run C may be from XLA's: it rounds in
every period."""

Runs = Callable[[Float[np.ndarray, "cells columns"]], Float[np.ndarray, "n 4 cells"]]
"""The signals `measure.KEEP` of cells, SI."""

Measured = Callable[[Float[np.ndarray, "cells columns"]], dict[str, Any]]
"""What `measure.measure` gives of cells."""


def measured(
    plan: Plan, given: measure.Excitation, settle: int
) -> tuple[Measured | None, str]:
    """What measures a plan's cells under an excitation in C, if it is to be used.

    Args:
        plan: whose cells.
        given: the excitation.
        settle: samples in which an operating point settles.

    Returns:
        None where XLA is to be used, and in words what runs the cells and why.
    """
    rows = plan.table()
    if jax.default_backend() != "cpu" or jax.local_device_count() > 1:
        return None, f"XLA, {jax.local_device_count()} {jax.default_backend()}"
    if len(rows) * given.shape.size < WORTH:
        return None, "XLA"
    try:
        runs = native_runs(plan, given, settle)
    except InputError as reason:
        return None, f"XLA ({reason})"
    figures = jax.jit(
        jax.vmap(
            lambda row, table: measure.figures(plan.at(row), given, table),
            in_axes=(0, 2),
        )
    )

    def call(rows):
        return figures(jnp.asarray(rows), jnp.asarray(runs(rows)))

    rows = plan.table()
    rows = rows[np.linspace(0, len(rows) - 1, min(CHECKED, len(rows))).astype(int)]
    by_xla = jax.jit(
        jax.vmap(
            lambda row, shape: measure.run_excited(
                plan.at(row), replace(given, shape=shape), plan.frozen, settle
            ),
            in_axes=(0, None),
        )
    )
    theirs, nudged = (
        np.asarray(by_xla(rows, given.shape * by)) for by in (1.0, 1.0 + NUDGE)
    )
    alike, words = compared(np.moveaxis(runs(rows), -1, 0), theirs, nudged)
    return (call if alike else None), words


def compared(
    ours: Float[np.ndarray, "cells n signals"],
    theirs: Float[np.ndarray, "cells n signals"],
    nudged: Float[np.ndarray, "cells n signals"],
) -> tuple[bool | None, str]:
    """Whether C runs cells as XLA does, and in words what is to run them and why.

    None where no cell can tell: a digit that differs grows in all of them.

    Args:
        ours: signals by C.
        theirs: the same by XLA.
        nudged: by XLA, of a desired force that differs by `NUDGE`.
    """
    size = np.max(np.abs(theirs), axis=1, keepdims=True)

    def apart(one: np.ndarray) -> np.ndarray:
        """By cell the largest difference, over the largest value of its signal."""
        same = (one == theirs) | (np.isnan(one) & np.isnan(theirs))
        with np.errstate(invalid="ignore", over="ignore"):
            off = np.abs(one - theirs) / np.where(size > 0, size, 1.0)
        off = np.where(same, 0.0, np.nan_to_num(off, nan=np.inf))
        return np.minimum(off.max((1, 2)), 2.0)  # as far as two runs can be

    off, own = apart(ours), apart(nudged)
    parted = int(np.sum(own > ALIKE))
    if parted == len(own):
        return None, "XLA (in none of its cells can C be held to it)"
    if (off > np.maximum(ALIKE, OWN * own)).any():
        return False, f"XLA (C differs from it by up to {off.max():.0e} of a signal)"
    words = f"C, as XLA to {ALIKE:.0e} in {len(off) - parted} cells"
    if parted:
        words += f"; in {parted} more XLA's own runs part when they are nudged"
    return True, words


def native_runs(plan: Plan, given: measure.Excitation, settle: int) -> Runs:
    """What runs cells of a plan under an excitation in C.

    Args:
        plan: whose cells.
        given: the excitation.
        settle: samples in which an operating point settles.

    Raises:
        InputError: no C compiler, or a loop with an operation that has no form in C.
    """
    row = plan.table()[0]

    def first(row):
        return operating_point.initial_state(plan.at(row), settle=settle)

    def step(row, carry, now):
        return measure.step_excited(plan.at(row), plan.frozen, carry, now)

    def begin(row):
        return flat(first(row))

    n = given.shape.size
    t = np.arange(n) * float(plan.setting.loop.h)
    course = np.column_stack([given.shape, given.noise, t])
    state = jax.eval_shape(first, row)
    now = (jnp.zeros(()), jnp.zeros(4), jnp.zeros(()))
    size = sum(a.size for a in jax.tree.leaves(state))
    alike = [False] * size if settle else begin_alike(begin, row)
    run = stepper(step, state, np.asarray(row), now, alike, "sweep")
    started = program(jax.vmap(begin))

    def runs(rows):
        states = np.asarray(started(jnp.asarray(rows)))
        # One thread: the chunks of a sweep share the cores.
        return run(rows.T, states.T, course, 1)[0]

    return runs


def begin_alike(
    begin: Callable[..., Float[Array, "numbers"]], row: Any, *shared: Any
) -> list[bool]:
    """Of the numbers with which a cell begins, which are the same in all.

    Args:
        begin: `begin(row, *shared)` gives the numbers.
        row: what differs between cells.
        shared: pytrees of what does not.
    """
    graph, given = Graph(), []
    for owner, zone, tree in (("r", LANE, row), ("c", TICK, shared)):
        for a in jax.tree.leaves(tree):
            count = len(given)
            ids = [
                graph.given(f"{owner}{count}_{i}", DOUBLE, zone) for i in range(a.size)
            ]
            given.append(np.array(ids, np.int64).reshape(a.shape))
    (made,) = scalarise(graph, jax.make_jaxpr(begin)(row, *shared), given)
    zones = graph.zone(graph.live(made.tolist()))
    return [not zones[at] & LANE for at in made.tolist()]
