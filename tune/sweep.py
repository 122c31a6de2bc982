"""A sweep: one program over all cells, in chunks that are kept as they are done."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from hydrojax.jax_setup import cores
from hydrojax.programs.compiled import make_room, program
from hydrojax.rigfile.quantities import Setting
from hydrojax.tune import linearize, measure, metrics, native, operating_point
from hydrojax.tune.chunks import Chunks
from hydrojax.tune.dataset import dataset
from hydrojax.tune.devices import on_all_devices
from hydrojax.tune.plan import Plan, chunk_size, tag_of

Progress = Callable[[int, int], None]
"""Called with the cells that are done, and their total number."""


class _Work:
    """The compiled programs of a plan."""

    def __init__(self, plan: Plan):
        self.plan = plan
        self.rows = plan.table()
        some = jax.vmap(plan.at)(jnp.asarray(_corners(self.rows)))
        rate = float(jnp.max(1 / some.loop.h))
        self.settle = (
            0 if operating_point.still(some) else round(operating_point.SETTLE * rate)
        )
        self.hertz = metrics.grid(float(jnp.min(1 / some.loop.h)))
        self.run_by: dict[str, str] = {}
        if "linear" in plan.methods:
            self.linear = self._linear(some)

    def _linear(self, some: Setting) -> Callable[..., Any]:
        full = program(
            jax.vmap(
                lambda s: linearize.system(
                    s, operating_point.initial_state(s, settle=self.settle)
                )
            )
        )
        states = linearize.find_states(full(some))
        hertz = jnp.asarray(self.hertz)

        def one(row):
            s = self.plan.at(row)
            system = linearize.system(
                s, operating_point.initial_state(s, settle=self.settle), states
            )
            H = linearize.frequency_response(system, hertz)
            found = metrics.loop_metrics(hertz, H, linearize.radius(system))
            return found | {"response": H[:, 0, 0]}

        return program(jax.vmap(one))

    def _measured(self, method: str) -> Callable[..., Any]:
        given = self.plan.excitations[method]
        in_c, self.run_by[method] = native.measured(self.plan, given, self.settle)
        if in_c is not None:
            return in_c

        def one(row):
            s = self.plan.at(row)
            return measure.measure(s, given, self.plan.frozen, self.settle)

        return jax.jit(on_all_devices(jax.vmap(one)))

    def run(self, method: str, save: Callable[[int, dict], None], done: set[int],
            progress: Callable[[int], None]) -> None:  # fmt: skip
        """Every chunk of a method that is not done yet."""
        size = chunk_size(self.plan, method)
        todo = [i for i in range(-(-len(self.rows) // size)) if i not in done]
        if not todo:
            return
        work = self.linear if method == "linear" else self._measured(method)

        def one(i: int) -> None:
            rows = self.rows[i * size : (i + 1) * size]
            full = np.concatenate([rows, np.repeat(rows[-1:], size - len(rows), 0)])
            out = jax.tree.map(np.asarray, work(jnp.asarray(full)))
            save(i, {n: v[: len(rows)] for n, v in out.items()})
            progress(len(rows))

        # LAPACK in two runs at once can lock up XLA's pool of threads; it is fast
        # enough alone. Simulations share the cores, or the devices.
        if method == "linear":
            for i in todo:
                one(i)
        else:
            one(todo[0])
            with ThreadPoolExecutor(cores()) as pool:
                list(pool.map(one, todo[1:]))


def _corners(rows: np.ndarray, most: int = 24) -> np.ndarray:
    """Cells that span all: each column's ends, and some in between."""
    rng = np.random.default_rng(0)
    ends = np.concatenate([rows.argmin(0), rows.argmax(0)])
    chosen = np.unique(np.concatenate([[0, len(rows) - 1], ends,
                                       rng.integers(0, len(rows), 4)]))  # fmt: skip
    return rows[chosen[:most]]


def run_sweep(
    plan: Plan, folder: Path | None = None, progress: Progress | None = None
) -> xr.Dataset:
    """Sweep, or go on with a sweep, or find it done.

    Args:
        plan: as `with_excitations` gives it.
        folder: where chunks are kept and `sweep.nc` is written; None keeps nothing.
        progress: called with the cells done and their total number.

    Raises:
        InputError: the folder holds another sweep.
    """
    make_room()
    chunks = _chunks_of(plan, folder)
    chunks.claim()
    kept = chunks.whole(plan.methods)
    if kept is not None:
        return kept
    count = len(plan.table())
    total, gone = count * len(plan.methods), 0
    work: _Work | None = None
    found: dict[str, dict[str, np.ndarray]] = {}

    def tell_more(n: int) -> None:
        nonlocal gone
        gone += n
        if progress:
            progress(gone, total)

    for method in plan.methods:
        parts: dict[int, dict[str, np.ndarray]] = {}
        size, tag = chunk_size(plan, method), tag_of(plan, method)
        for i in range(-(-count // size)):
            kept = chunks.read(tag, i)
            if kept is not None:
                parts[i] = kept
                tell_more(len(next(iter(kept.values()))))
        if len(parts) * size < count:
            work = work or _Work(plan)

            def save(i, out, parts=parts, tag=tag):
                parts[i] = out
                chunks.write(tag, i, out)

            work.run(method, save, set(parts), tell_more)
        found[method] = {
            name: np.concatenate([parts[i][name] for i in sorted(parts)])
            for name in parts[0]
        }
    data = dataset(plan, found)
    for method, words in (work.run_by if work else {}).items():
        data.attrs[f"{method}_runs"] = words
    chunks.finish(data)
    return data


def left(plan: Plan, folder: Path) -> list[tuple[str, int]]:
    """Method and number of every chunk that a folder has not yet.

    Raises:
        InputError: the folder holds another sweep.
    """
    chunks = _chunks_of(plan, folder)
    chunks.claim()
    if chunks.whole(plan.methods) is not None:
        return []
    return [
        (method, i)
        for method in plan.methods
        for i in range(_count(plan, method))
        if not chunks.has(tag_of(plan, method), i)
    ]


def chunk_worker(plan: Plan, folder: Path) -> Callable[[str, int], None]:
    """What works out one chunk and keeps it, for workers that share a sweep out.

    Args:
        plan: as `with_excitations` gives it.
        folder: of the sweep, the same for all workers.
    """
    work, chunks = _Work(plan), _chunks_of(plan, folder)

    def do(method: str, i: int) -> None:
        tag = tag_of(plan, method)
        if not chunks.has(tag, i):
            others = set(range(_count(plan, method))) - {i}
            work.run(
                method,
                lambda i, out: chunks.write(tag, i, out),
                others,
                lambda _: None,
            )

    return do


def _count(plan: Plan, method: str) -> int:
    """How many chunks a method has."""
    return -(-int(np.prod(plan.shape)) // chunk_size(plan, method))


def _chunks_of(plan: Plan, folder: Path | None) -> Chunks:
    return Chunks(folder, plan.question(), plan.key())
