"""A sweep's runs in C that is written of the simulator's own step.

The C is compiled once for a sweep and runs 32 cells side by side. That takes a C
compiler and some seconds, so it is for sweeps in which it saves more (`WORTH`). What it
finds in the first cells (`CHECKED`) is held to XLA's, and XLA runs the sweep where they
differ.
"""

from __future__ import annotations

import ctypes
import os
import tempfile
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hydrojax.errors import InputError
from hydrojax.export.codegen.compiler import shared_library
from hydrojax.export.codegen.graph import DOUBLE, LANE, Graph
from hydrojax.export.codegen.lanes import FLAGS, laned
from hydrojax.export.codegen.scalarise import scalarise
from hydrojax.programs.compiled import program
from hydrojax.tune import measure, operating_point
from hydrojax.tune.plan import Plan

WORTH = 6e7
"""Control periods, of all cells together, from which C pays: XLA takes longer by what
it takes to write, compile and check it (`python -m benchmarks.speed --only sweep`)."""

CHECKED = 100
"""Cells in which C's figures are held to XLA's."""

ALIKE = 1e-9
"""Part of a signal's largest value by which C may differ from XLA."""

EARLY = 50
"""Periods in which all cells have to be alike. Later, a loop that does not come to rest
(a limit cycle) lets the last digit grow until two runs part, and says nothing."""

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

    off, parted = compared(plan, given, settle, runs)
    if off > ALIKE:
        return None, f"XLA (C differs from it by {off:.0e} of a signal)"
    words = f"C, as XLA to {ALIKE:.0e} in {min(CHECKED, len(rows))} cells"
    if parted:
        words += f", but for {parted} that do not come to rest"
    return call, words


def compared(
    plan: Plan, given: measure.Excitation, settle: int, runs: Runs
) -> tuple[float, int]:
    """How far C is from XLA in the first cells.

    Returns:
        The largest difference over the largest value of its signal in the first
        `EARLY` periods, and the number of cells that are not `ALIKE` later.
    """
    rows = plan.table()[:CHECKED]
    by_xla = jax.jit(
        jax.vmap(
            lambda row: measure.run_excited(plan.at(row), given, plan.frozen, settle)
        )
    )
    theirs, ours = np.asarray(by_xla(rows)), np.moveaxis(runs(rows), -1, 0)
    off = np.abs(ours - theirs) / np.max(np.abs(theirs[:, :EARLY]), 1, keepdims=True)
    both = np.isnan(ours) & np.isnan(theirs)
    off = np.where(both, 0.0, np.nan_to_num(off, nan=np.inf))
    return float(off[:, :EARLY].max()), int((off.max((1, 2)) > ALIKE).sum())


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
    run = _library(made.source).run
    run.argtypes = [ctypes.c_long] * 2 + [ctypes.c_void_p] * 5 + [ctypes.c_int]
    started = program(jax.vmap(begin))

    def runs(rows):
        count = len(rows)
        states = np.asarray(started(jnp.asarray(rows))).T
        out = np.empty((n, made.kept, count))
        arrays = [np.ascontiguousarray(a, float) for a in (rows.T, states, course)]
        last = np.empty_like(arrays[1])
        pointers = [a.ctypes.data for a in (*arrays, out, last)]
        if run(count, n, *pointers, 1):
            raise MemoryError("no memory for the course of the loop")
        return out

    return runs


def _alike(begin: Callable[..., Any], row: Any) -> list[bool]:
    """Of the numbers with which a cell begins, which are the same in all."""
    graph = Graph()
    given = [graph.given(f"r{i}", DOUBLE, LANE) for i in range(row.size)]
    (made,) = scalarise(graph, jax.make_jaxpr(begin)(row), [np.array(given)])
    zones = graph.zone(graph.live(made.tolist()))
    return [not zones[at] & LANE for at in made.tolist()]


def _library(source: str) -> ctypes.CDLL:
    data = shared_library({"sweep.c": source}, FLAGS, "sweep")
    with tempfile.NamedTemporaryFile(suffix=".so", delete=False) as file:
        file.write(data)
    try:
        return ctypes.CDLL(file.name)
    finally:
        os.unlink(file.name)
