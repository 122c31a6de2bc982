"""A reference rig, and short synthetic logs with motion known in closed form."""

import gc
import hashlib
import os
import resource
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import pytest

from hydrojax import cli
from hydrojax.jax_setup import resident, set_up_jax
from hydrojax.parameters import parameter_specs, put
from hydrojax.plant.layout import LAYOUTS
from hydrojax.plant.replay import Motion, Windows
from hydrojax.plant.rig import Rig, bare_rig
from hydrojax.programs import compiled as programs
from hydrojax.programs.compiled import make_room
from tests import generator

CACHE_HOME = Path(tempfile.gettempdir()) / "hydrojax-tests"
"""Compiled programs are kept here between runs, in a folder `hydrojax`."""


def _pin() -> None:
    """One core for each of the suite's workers, so that none compiles two programs at
    once, which is what takes most memory.
    """
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    if worker and hasattr(os, "sched_setaffinity"):
        own = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {own[int(worker.removeprefix("gw")) % len(own)]})


_pin()
gc.set_threshold(*cli.COLLECTED)
set_up_jax(CACHE_HOME / "hydrojax")
programs.HELD = 2**30  # tests take rigs of many structures by turns
programs.FULL = 2**30  # whatever the machine has, a worker has 1.5 GiB

GEOMETRY = {"area": 1.18e-3, "chamber_length": 0.2}

REFERENCE = {
    "c_p1": 2.24e-9,
    "c_n1": 2.15e-9,
    "c_p2": 2.27e-9,
    "c_n2": 2.11e-9,
    "beta": 8.5e8,
    "delta_1": 12e-3,
    "delta_2": 18e-3,
    "k_cp": 900.0,
    "k_cn": 1200.0,
    "k_0": 100.0,
    "k_vp": 3e3,
    "k_vn": -2e3,
    "k_fp": 0.7,
    "k_fn": 0.6,
    "z_ss": 60e-6,
    "delta": 1 / 900,
    "L_slope": 300.0,
    "L_rate": 10.0,
}
"""The rig whose constants agree with all that the paper prints; SI."""


class Wave(NamedTuple):
    """A mean and a sum of sines, with any derivative."""

    mean: float
    size: np.ndarray
    omega: np.ndarray
    phase: np.ndarray

    def __call__(self, t, order: int = 0) -> np.ndarray:
        angle = np.multiply.outer(t, self.omega) + self.phase + order * np.pi / 2
        mean = self.mean if order == 0 else 0.0
        return mean + (self.size * self.omega**order * np.sin(angle)).sum(-1)


class Drive(NamedTuple):
    """What drives a replay, and the closed form of it: `waves[segment][name](t)`."""

    motion: Motion
    windows: Windows
    P_0: np.ndarray
    waves: list[dict[str, Wave]]


LEAD, SCORED, PRE, TICKS = 20, 40, 15, 130
CUT = ((0, 10), (0, 65), (1, 30))
"""The windows: segment and first tick of each."""


def draw_waves(rng: np.random.Generator) -> dict[str, Wave]:
    """Signals of one segment; speed, command and bristle cross zero many times."""

    def wave(mean, sizes, hertz):
        omega = 2 * np.pi * np.asarray(hertz) * rng.uniform(0.9, 1.1, len(hertz))
        return Wave(mean, np.asarray(sizes), omega, rng.uniform(0, 2 * np.pi, 2))

    return {
        "x": wave(2e-3, [2.5e-4, 0.6e-4], [11.0, 23.0]),
        "u": wave(0.02, [0.5, 0.3], [17.0, 41.0]),
        "P_s": wave(14e6, [2e5, 1e5], [7.0, 19.0]),
        "P_r": wave(0.25e6, [1e4, 1e4], [5.0, 13.0]),
        "F": wave(30.0, [300.0, 50.0], [19.0, 37.0]),
    }


def make_drive(substeps: int = 1, jitter: float = 0.0, seed: int = 0) -> Drive:
    """Three windows of 20 + 40 ticks of 1 ms, cut from two segments of 130 ticks.

    `jitter` is the relative unevenness of the ticks.
    """
    rng = np.random.default_rng(seed)
    waves = [draw_waves(rng) for _ in range(2)]
    # Ticks of each segment, `PRE` of them ahead of its start.
    h = 1e-3 * (1 + jitter * rng.uniform(-1, 1, (2, PRE + TICKS)))
    t = 4.0 + np.cumsum(h, axis=1)

    def within(s: int, ticks: slice, points: int) -> np.ndarray:
        """Position at `points` even steps of each of these ticks, both ends too."""
        share = np.arange(points + 1) / points
        start, end = t[s, ticks], t[s, ticks.start + 1 : ticks.stop + 1]
        return waves[s]["x"](start[:, None] + share * (end - start)[:, None])

    whole = slice(0, PRE + TICKS - 1)
    motion = Motion(
        u=np.stack([waves[s]["u"](t[s]) for s in range(2)]),
        runs_on=np.zeros(2),
        dx=np.stack([np.diff(within(s, whole, 4), axis=1) for s in range(2)]),
        h=np.diff(t, axis=1),
        speed0=np.array([2e-3, 5e-3]),
        v=np.stack([waves[s]["x"](t[s], 1) for s in range(2)]),
        F=np.stack([waves[s]["F"](t[s]) for s in range(2)]),
        P_0=(np.full(2, 6e6), np.full(2, 6e6)),
    )

    n = LEAD + SCORED
    cuts = [(s, slice(PRE + i, PRE + i + n)) for s, i in CUT]

    def signal(name: str, order: int = 0) -> np.ndarray:
        return np.stack([waves[s][name](t[s, at], order) for s, at in cuts])

    def ahead(s: int, at: slice) -> slice:
        return slice(at.start - PRE, at.start)

    gaps = np.diff(t, axis=1, append=t[:, -1:] + 1e-3)
    windows = Windows(
        seg=np.array([s for s, _ in CUT]),
        first=np.array([PRE + i for _, i in CUT]),
        before_h=np.stack([gaps[s, ahead(s, at)] for s, at in cuts]),
        P_before=np.full((len(cuts), PRE, 2), 6e6),
        u=signal("u"),
        h=np.stack([gaps[s, at] for s, at in cuts]),
        P_s=signal("P_s"),
        P_r=signal("P_r"),
        t=np.stack([t[s, at] for s, at in cuts]),
        x=signal("x"),
        v=signal("x", 1),
        a=signal("x", 2),
        F=signal("F"),
        x_fine=np.stack(
            [within(s, slice(at.start, at.stop - 1), 2 * substeps) for s, at in cuts]
        ),
        P_a1=rng.uniform(5e6, 7e6, (len(cuts), n)),
        P_a2=rng.uniform(5e6, 7e6, (len(cuts), n)),
        dP=rng.uniform(-1, 1, (len(cuts), n, 3, 2)) * np.array([1e7, 1e9]),
        measured=np.zeros((len(cuts), SCORED, 3)),
        filtered=np.ones(len(cuts)),
    )
    P_0 = rng.uniform(6e6, 8e6, (len(cuts), 2))
    return Drive(motion, windows, P_0, waves)


def set_reference(rig: Rig) -> Rig:
    """The rig at those of the reference parameters that it has."""
    known = {n: v for n, v in REFERENCE.items() if n in parameter_specs(rig)}
    return put(rig, list(known), np.array(list(known.values())))


PROGRAMS_KEPT = 0.1
"""Share of the kernel's mappings that programs may take from one module to the next."""

FILLS = 2**30
"""Bytes of a worker from which programs go between two tests: 1 GiB, on which the
next program comes, some 0.4 GiB while it is compiled."""

GROWS = 2**28
"""Bytes by which it has to grow before they go again: not all of it is programs."""

_full = [FILLS]


@pytest.fixture(autouse=True, scope="module")
def room() -> Iterator[None]:
    """What a module compiled goes when it is done, if it was much."""
    yield
    make_room(PROGRAMS_KEPT)


@pytest.fixture(autouse=True)
def room_in_module() -> Iterator[None]:
    """What a test compiled goes when it is done, if the worker has grown large."""
    yield
    if resident(os.getpid()) > _full[0]:
        make_room(0.0)
        _full[0] = max(FILLS, resident(os.getpid()) + GROWS)


@pytest.fixture(scope="session")
def rig() -> Rig:
    """The reference rig: pull-pull, without effects."""
    return set_reference(bare_rig(LAYOUTS["pull-pull"], GEOMETRY))


@pytest.fixture(scope="session")
def reference() -> Callable[[Rig], Rig]:
    """What puts the reference parameters into a rig of any layout."""
    return set_reference


@pytest.fixture(scope="session")
def drive() -> Callable[..., Drive]:
    """What makes a synthetic log; see `make_drive`."""
    return make_drive


@pytest.fixture(scope="session")
def cache_home() -> Path:
    """Where the tests' compiled programs are, as XDG_CACHE_HOME has it."""
    return CACHE_HOME


@pytest.fixture(scope="session")
def recorded(tmp_path_factory) -> Callable[..., Path]:
    """What records a case of the generator: rig.toml, three logs, truth.json.

    A case is recorded once for all workers, which read it only.
    """
    home = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        home = home.parent

    def record(seed: int, effects=None, seconds: float = 12.0) -> Path:
        key = repr((seed, effects, seconds)).encode()
        case = home / f"case-{hashlib.sha256(key).hexdigest()[:16]}"
        if not case.exists():
            made = tmp_path_factory.mktemp("case")
            generator.write_case(made, seed, effects, seconds)
            with suppress(OSError):  # another worker was faster
                made.rename(case)
        return case

    return record


@pytest.fixture
def compiled() -> Iterator[list[str]]:
    """Grows by one for each program that took half a second or more to compile."""
    heard: list[str] = []

    def hear(event: str, **_: object) -> None:
        if event == "/jax/compilation_cache/cache_misses":
            heard.append(event)

    jax.monitoring.register_event_listener(hear)
    yield heard
    jax.monitoring.unregister_event_listener(hear)


class Said(NamedTuple):
    """What a run of the command line left behind."""

    code: int
    out: str
    err: str


@pytest.fixture
def call(monkeypatch, capsys, cache_home) -> Callable[..., Said]:
    """Runs the command line in this process."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache_home))

    def run(*arguments: object) -> Said:
        monkeypatch.setattr(sys, "argv", ["hydrojax", *map(str, arguments)])
        capsys.readouterr()
        code = 0
        try:
            cli.main()
        except SystemExit as end:
            code = end.code or 0
        return Said(code, *capsys.readouterr())

    return run


# -- effects --


@pytest.fixture
def vocabulary():
    """The effects that are known; what a test adds goes when it ends."""
    from hydrojax.effects import EFFECTS  # its numbers are doubles: after the set-up

    before = dict(EFFECTS)
    yield EFFECTS
    EFFECTS.clear()
    EFFECTS.update(before)


# -- memory --

GOAL_MIB = 1536

PEAKS = pytest.StashKey[dict[str, float]]()


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Each worker reports the most memory that it held."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    output = getattr(session.config, "workeroutput", None)
    if output is not None:
        output["peak_mib"] = peak
        return
    peaks = session.config.stash.setdefault(PEAKS, {})
    if not peaks:
        peaks["main"] = peak


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node, error) -> None:
    """The main process hears of a worker's peak as it stops."""
    peaks = node.config.stash.setdefault(PEAKS, {})
    peaks[node.gateway.id] = getattr(node, "workeroutput", {}).get("peak_mib", 0.0)


def pytest_terminal_summary(terminalreporter, exitstatus, config) -> None:
    """Print the workers' peaks beside the goal."""
    for name, peak in sorted(config.stash.get(PEAKS, {}).items()):
        over = " (over the goal of 1.5 GiB)" if peak > GOAL_MIB else ""
        terminalreporter.write_line(f"{name}: at most {peak:.0f} MiB{over}")
