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
from jaxtyping import Float

from hydrojax.errors import InputError
from hydrojax.export.codegen.graph import DOUBLE, LANE, Graph
from hydrojax.export.codegen.lanes import laned
from hydrojax.export.codegen.running import runner
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

    off, own = compared(plan, given, settle, runs)
    parted = int(np.sum(own > ALIKE))
    if parted == len(own):
        return None, "XLA (in none of its cells can C be held to it)"
    if (off > np.maximum(ALIKE, OWN * own)).any():
        return None, f"XLA (C differs from it by up to {off.max():.0e} of a signal)"
    words = f"C, as XLA to {ALIKE:.0e} in {len(off) - parted} cells"
    if parted:
        words += f"; in {parted} more XLA's own runs part when they are nudged"
    return call, words


def compared(
    plan: Plan, given: measure.Excitation, settle: int, runs: Runs
) -> tuple[Float[np.ndarray, "some"], Float[np.ndarray, "some"]]:
    """How far C is from XLA in some cells of a plan.

    Returns:
        By cell the largest difference over the largest value of its signal; and the
        same of XLA's own runs whose desired force differs by `NUDGE`.
    """
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
    size = np.max(np.abs(theirs), axis=1, keepdims=True)

    def apart(one: np.ndarray) -> np.ndarray:
        same = (one == theirs) | (np.isnan(one) & np.isnan(theirs))
        off = np.abs(one - theirs) / np.where(size > 0, size, 1.0)
        off = np.where(same, 0.0, np.nan_to_num(off, nan=np.inf))
        return np.minimum(off.max((1, 2)), 2.0)  # as far as two runs can be

    return apart(np.moveaxis(runs(rows), -1, 0)), apart(nudged)


def native_runs(plan: Plan, given: measure.Excitation, settle: int) -> Runs:
    """What runs cells of a plan under an excitation in C.

    Args:
        plan: whose cells.
        given: the excitation.
        settle: samples in which an operating point settles.

    Raises:
        InputError: no C compiler, or a loop with an operation that has no form in C.
    """
    row = jnp.asarray(plan.table()[0])

    def first(row):
        return operating_point.initial_state(plan.at(row), settle=settle)

    state = jax.eval_shape(first, row)
    kinds = [leaf.dtype for leaf in jax.tree.leaves(state)]
    tree = jax.tree.structure(state)

    def as_numbers(carry: Any) -> list[Any]:
        return [jnp.asarray(a, float) for a in jax.tree.leaves(carry)]

    def step(row, numbers, now):
        leaves = [a.astype(k) for a, k in zip(numbers, kinds, strict=True)]
        carry = jax.tree.unflatten(tree, leaves)
        carry, kept = measure.step_excited(plan.at(row), plan.frozen, carry, now)
        return as_numbers(carry), kept

    def begin(row):
        return jnp.concatenate([a.ravel() for a in as_numbers(first(row))])

    n = given.shape.size
    t = np.arange(n) * float(plan.setting.loop.h)
    course = np.column_stack([given.shape, given.noise, t])
    blank = [jnp.zeros(leaf.shape) for leaf in jax.tree.leaves(state)]
    now = (jnp.zeros(()), jnp.zeros(4), jnp.zeros(()))
    size = sum(a.size for a in blank)
    alike = [False] * size if settle else _alike(begin, row)
    made = laned(step, np.asarray(row), blank, now, alike)
    run = runner(made, "sweep")
    started = program(jax.vmap(begin))

    def runs(rows):
        states = np.asarray(started(jnp.asarray(rows)))
        # One thread: the chunks of a sweep share the cores.
        return run(rows.T, states.T, course, 1)[0]

    return runs


def _alike(begin: Callable[..., Any], row: Any) -> list[bool]:
    """Of the numbers with which a cell begins, which are the same in all."""
    graph = Graph()
    given = [graph.given(f"r{i}", DOUBLE, LANE) for i in range(row.size)]
    (made,) = scalarise(graph, jax.make_jaxpr(begin)(row), [np.array(given)])
    zones = graph.zone(graph.live(made.tolist()))
    return [not zones[at] & LANE for at in made.tolist()]
