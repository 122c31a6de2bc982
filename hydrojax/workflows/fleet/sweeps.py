"""A sweep's chunks on the workers of a cluster."""

from __future__ import annotations

import pickle
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from hydrojax.effects import load_effects
from hydrojax.jax_setup import LOOPS, set_up_jax, user_cache
from hydrojax.tune import plan, sweep
from hydrojax.workflows.fleet.cluster import client, share_out


@dataclass(frozen=True)
class Unit:
    """One chunk: the words that make the plan, with whole paths, and which it is."""

    sweep: str  # by which a worker knows the plan again
    words: bytes  # pickled
    effects: tuple[str, ...]
    out: str
    method: str
    number: int


def share_sweep(
    words: tuple[Any, ...],
    effects: Sequence[Path],
    out: Path,
    address: str,
    progress: sweep.Progress | None = None,
) -> None:
    """Have the chunks that a sweep's folder lacks worked out by a cluster.

    `run.sweep_rig` with the same words then finds them; a chunk whose workers were lost
    again and again is left to it.

    Args:
        words: arguments of `run.plan_sweep`, in its order.
        effects: files with a user's own effects.
        out: the sweep's folder, which every worker sees under the same path.
        address: of the scheduler, or local:N.
        progress: called with the chunks done and their total number.

    Raises:
        InputError: words, a folder or an address that will not do.
    """
    rig, *middle, report, frozen = words
    report = report and Path(report).absolute()
    whole = pickle.dumps((Path(rig).absolute(), *middle, report, frozen))
    own = tuple(str(Path(p).absolute()) for p in effects)
    left = sweep.left(plan.plan_sweep(*words), out)
    if not left:
        return
    done = 0

    def hear(_: Unit) -> None:
        nonlocal done
        done += 1
        if progress:
            progress(done, len(left))

    own_name = uuid.uuid4().hex  # the same words may come to mean another rig
    units = (Unit(own_name, whole, own, str(out.absolute()), *each) for each in left)
    with client(address) as found:
        share_out(units, work_out, found, hear, lambda unit, _: unit)


def work_out(unit: Unit) -> Unit:
    """Work out a chunk and keep it; what the worker has compiled serves the next."""
    _worker(unit.sweep, unit.words, unit.effects, unit.out)(unit.method, unit.number)
    return unit


@lru_cache(maxsize=1)
def _worker(
    _sweep: str, words: bytes, effects: tuple[str, ...], out: str
) -> Callable[[str, int], None]:
    set_up_jax(user_cache(), LOOPS)
    for path in effects:
        load_effects(path)
    return sweep.chunk_worker(plan.plan_sweep(*pickle.loads(words)), Path(out))
