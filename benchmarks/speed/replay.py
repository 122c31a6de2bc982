"""The replay of a log in windows, and its derivative by sixteen parameters."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from .children import Children, Program
from .logs import predict, problem, replayed
from .loop import CORES, Build, on
from .measured import Section, agrees, compare, measure, quickest
from .timing import Goal

FORWARD = "replay, hydrojax"
GRAM = "Gram, hydrojax"


# -- programs --


def _size(y: Any) -> np.ndarray:
    """RMS by channel of predictions [W, T, 3]: what is compared of an answer."""
    return np.sqrt(np.mean(np.square(y), axis=(0, 1)))


def own_forward(folder: str) -> Build:
    """The product's replay, [W, T, 3]."""
    import jax
    import jax.numpy as jnp

    from hydrojax.parameters import put

    from .replays import NAMES

    made, start = problem(folder), jnp.asarray(replayed(folder)[1])
    batch = jax.tree.map(jnp.asarray, made.batch)

    def build():
        @jax.jit
        def run(params, batch):
            return predict(put(made.model.rig, NAMES, params), batch)

        return lambda: _size(run(start, batch).block_until_ready())

    return build


def own_gram(folder: str, count: int = 16) -> Build:
    """The product's Gram matrix and gradient over `count` parameters, windows' starts
    eliminated: what one step of a fit is made of.
    """
    import jax
    import jax.numpy as jnp

    from hydrojax.identify.estimation.columns import basis
    from hydrojax.identify.estimation.misfit import sums

    from .replays import NAMES

    made, model = problem(folder), problem(folder).model
    names = NAMES[:count]
    first = sum(model.names.index(n) < model.hydraulic for n in names)
    directions = basis(model, names, (first, count - first))
    values = jnp.asarray(made.initial_values())
    given = jax.tree.map(jnp.asarray, made.batch)

    def build():
        @jax.jit
        def run(values, directions, batch):
            return jnp.sum(sums(model, values, directions, batch, True).gram, axis=0)

        return lambda: [float(run(values, directions, given)[-1, -1])]

    return build


@cache
def peer(folder: str, tool: str, lanes: int = 1, threads: int = 1) -> tuple[Any, Any]:
    """A peer's replay, ready, and the starts."""
    given, start = replayed(folder)
    if tool == "C":
        from . import replay_c

        return replay_c.prepare(given, lanes, threads), start
    if tool == "numba":
        from . import replay_numba

        return replay_numba.prepare(given), start
    from . import replay_casadi

    return replay_casadi.prepare(given), start


def gram(residual: np.ndarray, J: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Gram matrix [17, 17] of whitened [J, residual], from [W, T, 3, 16], [W, T, 3]."""
    stack = np.concatenate([J, residual[..., None]], axis=-1) / noise[:, None]
    flat = stack.reshape(-1, stack.shape[-1])
    return flat.T @ flat


def forward(folder: str, **which: Any) -> Build:
    """A peer's replay."""
    replayed(folder)

    def build():
        made, start = peer(folder, **which)
        return lambda: _size(made.replay(start))

    return build


def jacobian(folder: str, summed: bool, **which: Any) -> Build:
    """A peer's Jacobian, and if it is `summed` its Gram matrix and gradient too."""
    b = problem(folder).batch
    measured, noise = np.asarray(b.windows.measured), np.asarray(b.noise)

    def build():
        made, start = peer(folder, **which)

        def call():
            J = made.jacobian(start)
            if not summed:
                return None
            return np.diagonal(gram(measured - made.replay(start), J, noise))[:16]

        return call

    return build


# -- the group --


def programs(folder: str) -> list[Program]:
    """All replays, Jacobians and Gram matrices."""
    at = {"folder": folder}
    tools = {
        "C, 1 thread": {"tool": "C", "lanes": 1, "threads": 1},
        **{
            f"C lanes, {on(n)}": {"tool": "C", "lanes": 8, "threads": n}
            for n in (1, CORES)
        },
        "numba": {"tool": "numba"},
        "CasADi": {"tool": "casadi"},
    }
    out = [
        Program(FORWARD, "fits", "replay:own_forward", at),
        Program(GRAM, "fits", "replay:own_gram", at),
        Program(f"{GRAM}, default flags", "default", "replay:own_gram", at),
    ]
    for name, which in tools.items():
        worker, given = which["tool"], at | which
        out.append(
            Program(f"replay, {name}", "default", "replay:forward", given, worker)
        )
        for what, summed in (("Jacobian", False), ("Gram", True)):
            also = {"summed": summed, **given}
            called = f"{what}, {name}"
            out.append(Program(called, "default", "replay:jacobian", also, worker))
    return out


def run(quick: bool, progress: Callable[[str], None]) -> Section:
    """Time replay, Jacobian and Gram matrix on one log."""
    from .cold import fresh

    section, seconds = Section(), 8.0 if quick else 60.0
    with tempfile.TemporaryDirectory(prefix="hydrojax-speed.") as name:
        progress("simulate a log")
        fresh("logs:write_case", {"folder": name, "seconds": seconds})
        folder = str(Path(name))
        # hydrojax's Gram matrix has columns eliminated that the peers' do not have.
        checks = (
            agrees({"replay": 1e-9}, FORWARD),
            agrees({GRAM: 1e-6}, GRAM),
            agrees({"Gram, C": 1e-3, "Gram, numba": 1e-3}, "Gram, C, 1 thread"),
        )
        with Children(progress) as children:
            per = measure(
                children, section, f"log of {seconds:g} s", programs(folder),
                3 if quick else 9, lambda n, a: "".join(c(n, a) for c in checks),
                unit=("ms", 1e3),
            )  # fmt: skip
    best, alone, lanes = (
        quickest(per, f"{what}, C lanes") for what in ("Gram", "Jacobian", "replay")
    )
    for says, of, to, goal in (
        ("Gram matrix and gradient over the replay", GRAM, FORWARD, Goal(8)),
        ("Gram matrix and gradient over C lanes with differences", GRAM, best, Goal(2)),
        ("the same over C's Jacobian alone", GRAM, alone, None),
        ("replay over C lanes", FORWARD, lanes, None),
        ("numba with differences over hydrojax", "Gram, numba", GRAM, None),
        ("CasADi over hydrojax", "Gram, CasADi", GRAM, None),
        ("default flags over hydrojax", f"{GRAM}, default flags", GRAM, None),
    ):
        compare(section, per, says, of, to, goal)
    section.note(
        "Jacobian: 16 parameters, C and numba by forward differences, CasADi exact; "
        "Gram: its products, in NumPy for the peers. hydrojax's has five more columns "
        "in each window, its own start and supply, which it eliminates."
    )
    return section
