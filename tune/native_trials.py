"""The runs in which gains are tried, in C that is written of the simulator's own step.

The C takes about as long to write and compile as XLA's program of the same runs, and is
made for many rows side by side.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from hydrojax.control.loop import Loop, Scenario, start_loop, step_loop
from hydrojax.errors import InputError
from hydrojax.export.codegen.running import flat, stepper
from hydrojax.jax_setup import cores
from hydrojax.tune.native import begin_alike

Runs = Callable[
    [Float[np.ndarray, "rows numbers"], Int[np.ndarray, "rows"], Scenario],
    Float[np.ndarray, "rows N signals"],
]
"""Runs rows, each in one of the stacked scenarios."""


def trial_runs(
    loop_of: Callable[[Any], Loop],
    row: Float[np.ndarray, "numbers"],
    scenarios: Scenario,
    keep: tuple[str, ...],
) -> Runs:
    """What runs loops in scenarios in C.

    Args:
        loop_of: the loop of a row of numbers.
        row: one row.
        scenarios: stacked; others of the same length may be run.
        keep: signals that are kept.

    Raises:
        InputError: no C compiler, or a loop with an operation that has no form in C.
    """
    if jax.default_backend() != "cpu":
        raise InputError(f"runs on {jax.default_backend()}")

    def first(row, now):
        one = jax.tree.map(lambda a: a[None], now)
        return start_loop(loop_of(row), one)

    def begin(row, now):
        return flat(first(row, now))

    def step(row, carry, now):
        carry, read = step_loop(loop_of(row), carry, now)
        return carry, jnp.stack([read[name] for name in keep])

    now = jax.tree.map(lambda a: np.zeros(a.shape[2:]), scenarios)
    state = jax.eval_shape(first, row, now)
    alike = begin_alike(begin, row, now)
    run = stepper(step, state, row, now, alike, "tune")
    beginning = jax.jit(jax.vmap(begin, in_axes=(0, None)))

    def runs(rows, which, scenarios):
        out = np.empty((len(rows), *scenarios.F_d.shape[1:], len(keep)))
        for k in np.unique(which):
            mine = which == k
            own = jax.tree.map(lambda a, k=k: np.asarray(a[k]), scenarios)
            course = [a.reshape(a.shape[0], -1) for a in jax.tree.leaves(own)]
            start = beginning(rows[mine], jax.tree.map(lambda a: a[0], own))
            kept, _ = run(rows[mine].T, np.asarray(start).T, np.hstack(course), cores())
            out[mine] = np.moveaxis(kept, -1, 0)
        return out

    return runs
