"""The closed loop in vectors of C that is written of the simulator's own step."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from hydrojax.control.loop import Loop, Scenario, start_loop, step_loop
from hydrojax.export.codegen.lanes import laned
from hydrojax.export.codegen.running import runner

from .numbers import KEEP


def prepare(
    loop: Loop, scenario: Scenario, threads: int = 1, signals: bool = False
) -> Callable[[], tuple[np.ndarray, np.ndarray | None]]:
    """A closed loop as `peers_c.prepare` has it; instances differ in leaves [B].

    Raises:
        InputError: no C compiler, or a loop with an operation that has no form in C.
    """
    leaves, tree = jax.tree.flatten(loop)
    own = [i for i, a in enumerate(leaves) if jnp.ndim(a)]
    rows = np.stack([np.asarray(leaves[i]) for i in own])
    shared = {i: np.asarray(a) for i, a in enumerate(leaves) if i not in own}

    def at(row: jax.Array) -> Loop:
        mixed = {i: row[j] for j, i in enumerate(own)} | shared
        return jax.tree.unflatten(tree, [mixed[i] for i in range(len(leaves))])

    def first(row):
        carry = jax.tree.map(lambda a: jnp.asarray(a, float),
                             start_loop(at(row), scenario))  # fmt: skip
        return carry, jnp.zeros(())

    def step(row, state, tick):
        carry, now = step_loop(at(row), state[0], tick)
        miss = tick.F_d - now["true_F"]
        kept = jnp.stack([now[n] for n in KEEP]) if signals else jnp.zeros(0)
        return (carry, state[1] + miss * miss), kept

    states = jax.jit(jax.vmap(first))(jnp.asarray(rows.T))
    begin = np.concatenate(
        [np.asarray(a).reshape(rows.shape[1], -1) for a in jax.tree.leaves(states)], 1
    ).T.copy()
    one, tick = jax.tree.map(lambda a: a[0], (states, scenario))
    alike = [bool(np.all(row == row[0])) for row in begin]
    end = len(begin) - 1
    made = laned(step, rows[:, 0], one, tick, alike, [end])
    course = np.concatenate(
        [np.asarray(a).reshape(len(scenario.t), -1) for a in jax.tree.leaves(scenario)],
        axis=1,
    )
    run = runner(made, "generated loop")
    n = len(course)

    def call() -> tuple[np.ndarray, np.ndarray | None]:
        table, last = run(rows, begin, course, threads)
        return np.sqrt(last[-1] / n), np.moveaxis(table, -1, 0) if signals else None

    return call
