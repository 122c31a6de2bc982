"""The closed loop: hydrojax beside C, numba, diffrax and scipy, gains by instance."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from .children import Children, Program
from .measured import Section, agrees, compare, measure, quickest
from .timing import Goal, figure, spread

CORES = os.cpu_count() or 1
CHUNK = 64
"""Instances that hydrojax runs side by side in one call; calls share the cores."""

H = 1e-3
RUNS, RUN_SECONDS = 4096, 4.0
"""The one call of a sweep by simulation."""

OWN, SINGLE, DEFAULT = "hydrojax", "hydrojax f32", "hydrojax, default flags"
SCALAR, LANES = "C", "C lanes"
GENERATED = "generated lanes"
WITHIN = {
    SINGLE: 1e-2, DEFAULT: 1e-9, "C f32": 1e-2, "C lanes f32": 1e-2,
    SCALAR: 1e-5, LANES: 1e-5, GENERATED: 1e-9, "numba": 1e-5, "diffrax": 1e-3,
}  # fmt: skip
"""How far a program's RMS errors of force may be from hydrojax's, relative. C and numba
step the pressures by the explicit midpoint rule, hydrojax by the exponential one."""


def on(threads: int) -> str:
    """So many threads, in a program's name."""
    return f"{threads} thread{'s' * (threads > 1)}"


# -- programs: each reads its data and returns what builds it --

Build = Callable[[], Callable[[], Any]]


@cache
def case(batch: int, samples: int) -> tuple[Any, Any, np.ndarray]:
    """The reference loop, its course, and two gains for each instance, [B, 2]."""
    from hydrojax.control.simulation import make_scenario
    from hydrojax.control.waveforms import random_sines, sinusoidal_path
    from hydrojax.rigfile.build import build_loop
    from hydrojax.rigfile.schema import RigFile

    file = resources.files("hydrojax") / "paper" / "reference.toml"
    with resources.as_file(file) as path:
        loop = build_loop(RigFile.load(path))
    t = H * np.arange(samples)
    F_d = random_sines(np.random.default_rng(1), t, 250.0)
    scenario = make_scenario(F_d, sinusoidal_path(0.03, 0.7), H, 14e6, 0.25e6, seed=0)
    factors = np.random.default_rng(3).uniform(0.7, 1.2, (batch, 2))
    factors[0] = 1.0
    return loop, scenario, factors * [float(loop.law.k_p), float(loop.law.k_f)]


def _gains(loop: Any) -> list[Any]:
    return [loop.law.k_p, loop.law.k_f]


def _batched(batch: int, samples: int) -> tuple[Any, Any]:
    """The loop with gains [B] (scalars for one instance), and its course."""
    import equinox as eqx
    import jax.numpy as jnp

    loop, scenario, gains = case(batch, samples)
    columns = [jnp.asarray(column) for column in (gains.T if batch > 1 else gains[0])]
    return eqx.tree_at(_gains, loop, columns), scenario


def own(batch: int, samples: int, chunk: int) -> Build:
    """hydrojax: one compiled program over chunks of instances, in a pool of threads."""
    import equinox as eqx
    import jax
    import jax.numpy as jnp

    from hydrojax.control.loop import run

    loop, scenario, gains = case(batch, samples)
    real = jnp.result_type(float)  # single where JAX is
    given = jax.tree.map(lambda a: jnp.asarray(a, real), (loop, scenario))

    def one(row, loop, scenario):
        loop = eqx.tree_at(_gains, loop, [row[0], row[1]])
        F = run(loop, scenario, ("true_F",))[:, 0]
        return jnp.sqrt(jnp.mean((scenario.F_d - F) ** 2))

    # Chunks are for a processor's caches and cores: a GPU is given all at once.
    size = min(chunk or batch, batch) if jax.default_backend() == "cpu" else batch
    rows = [jnp.asarray(gains[i : i + size], real) for i in range(0, batch, size)]

    def build():
        if batch == 1:
            single = jax.jit(one)
            return lambda: [single(rows[0][0], *given).block_until_ready()]
        many = jax.jit(jax.vmap(one, in_axes=(0, None, None)))

        def call(part):
            return many(part, *given).block_until_ready()

        pool = ThreadPoolExecutor(CORES)
        return lambda: np.concatenate([np.asarray(a) for a in pool.map(call, rows)])

    return build


def c(batch: int, samples: int, real: str, lanes: bool, threads: int) -> Build:
    """C, scalar or in lanes."""
    from . import peers_c

    given = _batched(batch, samples)
    side = peers_c.lanes_for(batch, real) if lanes else 1

    def build():
        run = peers_c.prepare(*given, real, side, threads)
        return lambda: run()[0]

    return build


def generated(batch: int, samples: int, threads: int) -> Build:
    """C in lanes that is written of the simulator's step."""
    from . import generated as written

    given = _batched(batch, samples)

    def build():
        run = written.prepare(*given, threads)
        return lambda: run()[0]

    return build


def by_numba(batch: int, samples: int) -> Build:
    """By numba, instances in parallel."""
    from . import peers_numba

    given = _batched(batch, samples)

    def build():
        run = peers_numba.prepare(*given)
        return lambda: run()[0]

    return build


def by_diffrax(batch: int, samples: int) -> Build:
    """By diffrax under a vmap."""
    from . import peers_diffrax

    given = _batched(batch, samples)
    return lambda: peers_diffrax.prepare(*given)


def by_scipy(samples: int) -> Build:
    """By `solve_ivp` of scipy, one instance."""
    from . import peers_scipy

    given = _batched(1, samples)

    def build():
        run = peers_scipy.prepare(*given)
        return lambda: run()[-1]

    return build


# -- the group --


def programs(batch: int, samples: int, few: int) -> list[Program]:
    """All that run a batch; scipy takes `few` samples, and one instance."""
    size = {"batch": batch, "samples": samples}

    def compiled(name: str, real: str, lanes: bool) -> list[Program]:
        return [
            Program(
                f"{name}, {on(n)}", "default", "loop:c",
                {**size, "real": real, "lanes": lanes, "threads": n}, "C",
            )
            for n in dict.fromkeys((1, CORES))
        ]  # fmt: skip

    out = [
        Program(OWN, "loops", "loop:own", {**size, "chunk": CHUNK}),
        Program(SINGLE, "loops f32", "loop:own", {**size, "chunk": CHUNK}),
        Program(DEFAULT, "default", "loop:own", {**size, "chunk": 0}),
        *compiled(SCALAR, "double", False),
        *compiled(LANES, "double", True),
        *compiled("C f32", "float", False),
        *compiled("C lanes f32", "float", True),
        Program("numba", "default", "loop:by_numba", size, "numba"),
        *(
            Program(
                f"diffrax, flags for {kind}",
                kind,
                "loop:by_diffrax",
                size,
                f"diffrax {kind}",
            )
            for kind in ("loops", "fits", "both")
        ),
    ]
    if batch > 1:
        out += [
            Program(f"{GENERATED}, {on(n)}", "default", "loop:generated",
                    {**size, "threads": n}, "C")
            for n in dict.fromkeys((1, CORES))
        ]  # fmt: skip
    if batch == 1:
        one = {"samples": few}
        out.append(Program("scipy", "default", "loop:by_scipy", one, "scipy"))
    return out


def goals(batch: int) -> list[tuple[str, str, str, Goal | None]]:
    """Ratios of a batch: words, whose time, over whose, and what it must be."""
    lanes, scalar = f"{LANES}, {on(CORES)}", f"{SCALAR}, {on(CORES)}"
    own = f"{GENERATED}, {on(CORES)}"
    if batch == 1:
        return [
            ("hydrojax over scalar C", OWN, f"{SCALAR}, 1 thread", Goal(1.4)),
            ("default flags over hydrojax", DEFAULT, OWN, Goal(20, most=False)),
            ("diffrax at its best over hydrojax", "diffrax", OWN, None),
            ("numba over hydrojax", "numba", OWN, None),
            ("scipy over hydrojax", "scipy", OWN, Goal(250, most=False)),
        ]
    if batch <= 32:
        one = f"{LANES}, 1 thread"
        return [
            ("hydrojax over C lanes on one core", OWN, one, Goal(2.0)),
            ("default flags over hydrojax", DEFAULT, OWN, None),
            ("diffrax at its best over hydrojax", "diffrax", OWN, None),
        ]
    large = batch >= 4096
    ahead = Goal(4.5, most=False)
    return [
        ("hydrojax over C lanes", OWN, lanes, Goal(1.15)),
        ("f32: hydrojax over C lanes", SINGLE, f"C lanes f32, {on(CORES)}", Goal(1.3)),
        ("generated lanes over C lanes", own, lanes, Goal(1.15)),
        ("scalar C over hydrojax", scalar, OWN, ahead),
        ("numba over hydrojax", "numba", OWN, ahead),
        ("default flags over hydrojax", DEFAULT, OWN,
         Goal(8, most=False) if large else None),
        ("diffrax at its best over hydrojax", "diffrax", OWN,
         Goal(12, most=False) if large else None),
    ]  # fmt: skip


def run(quick: bool, progress: Callable[[str], None]) -> Section:
    """Time the closed loop at four batch sizes, and one call of many runs."""
    section, samples = Section(), 1000 if quick else 10_000
    few = samples // 5 if quick else samples // 10
    with Children(progress) as children:
        for batch in (1, 16, 256, 4096):
            rounds = 3 if quick else 7 if batch <= 256 else 5
            listed = programs(batch, samples, few)
            work = {
                p.name: p.given.get("batch", 1) * p.given["samples"] for p in listed
            }
            per = measure(
                children, section, f"batch {batch}", listed, rounds,
                agrees(WITHIN, OWN), work, ("ns", 1e9),
            )  # fmt: skip
            for says, of, to, goal in goals(batch):
                best = quickest(per, of) if of == "diffrax" else of
                compare(section, per, f"batch {batch}: {says}", best, to, goal)
        _many_runs(children, section, quick)
    section.note(
        f"ns: per control period and instance, runs of {samples * H:g} s at 1 kHz "
        f"(scipy {few * H:g} s), gains of its own for each instance; hydrojax in "
        f"chunks of {CHUNK} on {CORES} threads."
    )
    return section


def _many_runs(children: Children, section: Section, quick: bool) -> None:
    """The closed-loop runs of a sweep in one call."""
    runs, seconds = (512, 1.0) if quick else (RUNS, RUN_SECONDS)
    called = f"{runs} runs of {seconds:g} s"
    wanted = (OWN, f"{LANES}, {on(CORES)}", f"{LANES}, {on(1)}")
    listed = [p for p in programs(runs, round(seconds / H), 1) if p.name in wanted]
    per = measure(
        children, section, called, listed, 3 if quick else 5, agrees(WITHIN, OWN)
    )
    if OWN in per:
        section.figures.append(figure(f"{called} in one call", spread(per[OWN]), "s"))
    compare(section, per, f"{called}: hydrojax over C lanes", OWN, wanted[1])
