"""What is compiled for a tuning: a few programs over rows of numbers.

A row is a set of gains on a plant at a point. Programs are compiled for a fixed number
of rows, and longer tables are cut into such chunks, so that nothing compiles anew when
a descent, its slopes or a check ask for more. All else of a tuning is NumPy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from hydrojax.control.loop import Scenario, run
from hydrojax.errors import InputError
from hydrojax.jax_setup import cores
from hydrojax.parameters import put
from hydrojax.programs.compiled import program
from hydrojax.rigfile.quantities import Quantity, Setting
from hydrojax.tune import linearize, native, native_trials, operating_point

KEEP = ("true_F", "u")
"""Signals of a run: the output force, N, and the command."""


class Rows(NamedTuple):
    """Gains in their units, the plant's parameters, and the speed, m/s."""

    gains: Float[np.ndarray, "rows gains"]
    plant: Float[np.ndarray, "rows parameters"]
    v: Float[np.ndarray, "rows"]


def setting_at(
    setting: Setting, free: Sequence[Quantity], names: Sequence[str],
    gains: Any, plant: Any, v: Any,
) -> Setting:  # fmt: skip
    """The setting with these gains, parameters of the plant, and speed."""
    rig = put(setting.loop.rig, names, plant)
    s = eqx.tree_at(lambda q: (q.loop.rig, q.v), setting, (rig, v))
    for i, quantity in enumerate(free):
        s = quantity.put(s, gains[i])
    return s


class Programs:
    """Operating points, linear systems and runs of rows.

    Args:
        setting: whose runs are made in C, where that can be.
        free: the quantities that change.
        names: of the plant's parameters.
        settle: samples in which a point that is not at rest settles.
        size: rows in a chunk.
        scenarios: of the runs, stacked.

    Attributes:
        run_by: in words, what makes the runs of `setting`.
    """

    def __init__(
        self, setting: Setting, free: Sequence[Quantity], names: Sequence[str],
        settle: int, size: int, scenarios: Scenario,
    ):  # fmt: skip
        self.size, self.setting = size, setting
        self.run_by, self._alike = "", None

        def place(setting, row):
            return setting_at(setting, free, names, *row)

        def loop_of(numbers):
            row = numbers[: len(free)], numbers[len(free) :], setting.v
            return place(setting, row).loop

        def settled(setting, row):
            return operating_point.initial_state(place(setting, row), settle=settle)

        def linear(setting, row, carry):
            s = place(setting, row)
            return linearize.live_system(s, operating_point.matched(s, carry))

        def simulated(setting, row, which, scenarios):
            scenario = jax.tree.map(lambda a: a[which], scenarios)
            scenario = scenario._replace(P_s=jnp.full_like(scenario.P_s, setting.P_s))
            return run(place(setting, row).loop, scenario, KEEP)

        over = (None, 0)
        self._settled = program(jax.vmap(settled, in_axes=over))
        self._linear = program(jax.vmap(linear, in_axes=(None, 0, 0)))
        self._run = jax.jit(jax.vmap(simulated, in_axes=(None, 0, 0, None)))

        # It compiles while the main thread has other programs made.
        row = np.ones(len(free) + len(names))
        pool = ThreadPoolExecutor(1)
        self._in_c = pool.submit(
            native_trials.trial_runs, loop_of, row, scenarios, KEEP
        )
        pool.shutdown(wait=False)

    def settle(self, setting: Setting, rows: Rows) -> Any:
        """The memory of each row at its operating point."""
        return self._chunks(lambda r: self._settled(setting, r), (rows,))

    def systems(self, setting: Setting, rows: Rows, carries: Any) -> linearize.System:
        """The full linear system of each row, its adaptation live, as NumPy arrays.

        Args:
            setting: what all rows share.
            rows: the rows.
            carries: the memory of each at its point; the estimates in it are set anew.
        """
        return self._chunks(lambda r, c: self._linear(setting, r, c), (rows, carries))

    def runs(
        self, setting: Setting, rows: Rows, which: Int[np.ndarray, "rows"],
        scenarios: Scenario,
    ) -> Float[np.ndarray, "rows N 2"]:  # fmt: skip
        """The signals `KEEP` of each row in one of the stacked scenarios.

        The rows' speed is not used: the scenario moves the piston.
        """
        if setting is self.setting and self._alike is None:
            self._choose(rows, scenarios)
        if setting is self.setting and self._alike:
            return self._by_c(rows, which, scenarios)
        return self._by_xla(setting, rows, which, scenarios)

    def _by_xla(self, setting, rows, which, scenarios):
        return self._chunks(
            lambda r, k: self._run(setting, r, k, scenarios), (rows, which)
        )

    def _by_c(self, rows, which, scenarios):
        numbers = np.hstack([rows.gains, rows.plant])
        P_s = np.full_like(scenarios.P_s, self.setting.P_s)
        return self._in_c.result()(numbers, which, scenarios._replace(P_s=P_s))

    def _choose(self, rows, scenarios):
        """What makes the runs from now on: C, if it makes those of these rows as XLA
        does, in every scenario some, `native.CHECKED` at most. Open still where none of
        them can tell.
        """
        kinds = len(scenarios.F_d)
        some = min(rows.v.size, native.CHECKED // kinds)
        rows = repeat(rows, np.tile(np.arange(some), kinds))
        which = np.repeat(np.arange(kinds), some)
        nudged = scenarios._replace(F_d=scenarios.F_d * (1 + native.NUDGE))
        theirs, parted = (
            self._by_xla(self.setting, rows, which, s) for s in (scenarios, nudged)
        )
        try:
            ours = self._by_c(rows, which, scenarios)
        except InputError as reason:
            self._alike, self.run_by = False, f"XLA ({reason})"
        else:
            self._alike, self.run_by = native.compared(ours, theirs, parted)

    def _chunks(self, work: Callable[..., Any], table: tuple[Any, ...]) -> Any:
        table = jax.tree.map(np.asarray, table)
        count = jax.tree.leaves(table)[0].shape[0]

        def chunk(start: int) -> Any:
            index = np.minimum(np.arange(start, start + self.size), count - 1)
            part = jax.tree.map(lambda a: jnp.asarray(a[index]), table)
            done = jax.tree.map(np.asarray, work(*part))
            return jax.tree.map(lambda a: a[: min(self.size, count - start)], done)

        with ThreadPoolExecutor(cores()) as pool:
            out = list(pool.map(chunk, range(0, count, self.size)))
        return jax.tree.map(lambda *a: np.concatenate(a), *out)


def repeat(tree: Any, index: Int[np.ndarray, "rows"]) -> Any:
    """Rows of a stacked tree, picked by their index."""
    return jax.tree.map(lambda a: np.asarray(a)[index], tree)
