"""A sweep: one program over all cells, in chunks that are kept as they are done."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from hydrojax.errors import InputError
from hydrojax.jax_setup import make_room
from hydrojax.rigfile.fingerprint import code_fingerprint
from hydrojax.rigfile.quantities import Quantity, Setting
from hydrojax.tune import linearize, measure, metrics, operating_point
from hydrojax.tune.axes import Axis, Plants, cells
from hydrojax.tune.chunks import Chunks
from hydrojax.tune.dataset import dataset, save_dataset
from hydrojax.tune.program import on_all_devices, program

METHODS = ("linear", "multisine", "noise")
MEMORY = 256e6
"""Bytes that a chunk's signals may take."""

MADE_BY = (
    linearize.system, linearize.response, linearize.radius, metrics.merits,
    measure.measure, measure.multisine, measure.white_noise, operating_point.still,
)  # fmt: skip
"""The functions that make a sweep's figures: their code is part of its key."""

Progress = Callable[[int, int], None]
"""Called with the cells that are done, and their total number."""


@dataclass(frozen=True)
class Plan:
    """What a sweep does.

    Attributes:
        setting: the rig at its operating point; the axes change it.
        axes: 1 to 4.
        known: every quantity by name.
        methods: of `METHODS`.
        plants: an ensemble, if there is one.
        frozen: whether adaptation stands still when it is measured too.
        rig: its name.
        unit: of the command.
        chunk: cells in a chunk; 0 is by memory.
        excitations: of the methods that measure; made when None.
    """

    setting: Setting
    axes: list[Axis]
    known: Mapping[str, Quantity]
    methods: tuple[str, ...] = ("linear",)
    plants: Plants | None = None
    frozen: bool = False
    rig: str = ""
    unit: str = "V"
    chunk: int = 0
    excitations: dict[str, measure.Excitation] = field(default_factory=dict)

    @property
    def shape(self) -> tuple[int, ...]:
        """Plants first, if there are any, then the axes."""
        lead = (len(self.plants.values),) if self.plants else ()
        return (*lead, *(a.values.size for a in self.axes))

    def table(self) -> np.ndarray:
        """Values of the axes and of the plants' parameters in every cell."""
        grid = cells(self.axes)
        if self.plants is None:
            return grid
        own = np.repeat(self.plants.values, len(grid), axis=0)
        return np.hstack([np.tile(grid, (len(self.plants.values), 1)), own])

    def at(self, row: Any) -> Setting:
        """The setting of one cell. The axes come last: they overrule a plant."""
        s, n = self.setting, len(self.axes)
        if self.plants is not None:
            for i, name in enumerate(self.plants.names):
                s = Quantity(name, "", "", parameter=name).put(s, row[n + i])
        for i, axis in enumerate(self.axes):
            s = axis.quantity.put(s, row[i])
        return s

    def key(self) -> str:
        """What the sweep depends on, in a few letters: the question and the code."""
        code = code_fingerprint(self.setting, MADE_BY)
        return hashlib.sha256(f"{self.question()} {code}".encode()).hexdigest()[:16]

    def question(self) -> str:
        """What is asked, in a few letters: rig, operating point, axes and plants."""
        seen = hashlib.sha256()
        for leaf in jax.tree.leaves((self.setting, self.table())):
            seen.update(np.asarray(leaf).tobytes())
        words = (str(jax.tree.structure(self.setting)), self.frozen, self.shape)
        words += tuple(a.name for a in self.axes)
        seen.update(repr(words).encode())
        return seen.hexdigest()[:16]


def _tag(plan: Plan, method: str) -> str:
    """What a chunk of a method is called, but for its number."""
    size, given = chunk_size(plan, method), plan.excitations.get(method)
    if given is None:
        return f"{method}-{size}"
    seen = hashlib.sha256(given.shape.tobytes() + given.noise.tobytes())
    return f"{method}-{size}-{seen.hexdigest()[:8]}"


def prepare(plan: Plan) -> Plan:
    """The plan with its excitations and nothing left that cannot be done.

    Raises:
        InputError: measuring at a rate that is swept, or at no amplitude.
    """
    measured = [m for m in plan.methods if m != "linear"]
    if measured and any(a.name == "rate" for a in plan.axes):
        raise InputError(
            "--over rate: what is measured has its own sampling; add --by linear"
        )
    rate = float(1 / plan.setting.loop.h)
    make = {"multisine": measure.multisine, "noise": measure.white_noise}
    made = {m: plan.excitations.get(m) or make[m](rate) for m in measured}
    return Plan(**{**plan.__dict__, "excitations": made})


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
        if "linear" in plan.methods:
            self.linear = self._linear(some)

    def _linear(self, some: Setting) -> Callable[..., Any]:
        full = program(
            jax.vmap(
                lambda s: linearize.system(
                    s, operating_point.start(s, settle=self.settle)
                )
            )
        )
        states = linearize.find_states(full(some))
        hertz = jnp.asarray(self.hertz)

        def one(row):
            s = self.plan.at(row)
            system = linearize.system(
                s, operating_point.start(s, settle=self.settle), states
            )
            H = linearize.response(system, hertz)
            found = metrics.merits(hertz, H, linearize.radius(system))
            return found | {"response": H[:, 0, 0]}

        return program(jax.vmap(one))

    def _measured(self, method: str) -> Callable[..., Any]:
        given = self.plan.excitations[method]

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
            with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
                list(pool.map(one, todo[1:]))


def _corners(rows: np.ndarray, most: int = 24) -> np.ndarray:
    """Cells that span all: each column's ends, and some in between."""
    rng = np.random.default_rng(0)
    ends = np.concatenate([rows.argmin(0), rows.argmax(0)])
    chosen = np.unique(np.concatenate([[0, len(rows) - 1], ends,
                                       rng.integers(0, len(rows), 4)]))  # fmt: skip
    return rows[chosen[:most]]


def chunk_size(plan: Plan, method: str) -> int:
    """Cells in a chunk, as many on every device."""
    if method == "linear":
        each, most = metrics.LINES * 10 * 16 * 4.0, 256
    else:
        each = plan.excitations[method].shape.size * len(measure.KEEP) * 8 * 3.0
        most = 128
    fits = plan.chunk or int(min(max(MEMORY // each, 16), most, np.prod(plan.shape)))
    devices = jax.local_device_count()
    return -(-fits // devices) * devices


def run(
    plan: Plan, folder: Path | None = None, progress: Progress | None = None
) -> xr.Dataset:
    """Sweep, or go on with a sweep, or find it done.

    Args:
        plan: as `prepare` gives it.
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
        size, tag = chunk_size(plan, method), _tag(plan, method)
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
    if folder is not None:
        save_dataset(data, folder / "sweep.nc")
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
        if not chunks.has(_tag(plan, method), i)
    ]


def chunk_worker(plan: Plan, folder: Path) -> Callable[[str, int], None]:
    """What works out one chunk and keeps it, for workers that share a sweep out.

    Args:
        plan: as `prepare` gives it.
        folder: of the sweep, the same for all workers.
    """
    work, chunks = _Work(plan), _chunks_of(plan, folder)

    def do(method: str, i: int) -> None:
        tag = _tag(plan, method)
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
