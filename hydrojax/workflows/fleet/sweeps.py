"""A sweep's chunks on the workers of a cluster."""

from __future__ import annotations

import pickle
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from hydrojax.effects import load_effects
from hydrojax.errors import InputError
from hydrojax.jax_setup import LOOPS, set_up_jax, user_cache
from hydrojax.rigfile.schema import RigFile
from hydrojax.tune import sweep
from hydrojax.tune.api import plan_sweep
from hydrojax.workflows.fleet.cluster import client, share_out


@dataclass(frozen=True)
class Unit:
    """One chunk: the arguments that make the plan, and which chunk it is."""

    sweep: str  # by which a worker knows the plan again
    arguments: bytes  # pickled
    effects: tuple[str, ...]
    out: str
    method: str
    number: int


def share_sweep(
    rig: RigFile,
    arguments: Mapping[str, Any],
    effects: Sequence[Path],
    out: Path,
    address: str,
    progress: sweep.Progress | None = None,
) -> None:
    """Have the chunks that a sweep's folder lacks computed by a cluster.

    `tune.api.sweep` with the same arguments then finds them; a chunk whose workers were
    lost again and again is left to it.

    Args:
        rig: the rig file.
        arguments: the others of `tune.api.plan_sweep`, by name.
        effects: files with a user's own effects.
        out: the sweep's folder, which every worker sees under the same path.
        address: of the scheduler, or local:N.
        progress: called with the chunks done and their total number.

    Raises:
        InputError: invalid arguments, folder or address; or a controller or a valve
            that workers cannot import.
    """
    _refuse_script(rig)
    whole = pickle.dumps((rig, dict(arguments)))
    own = tuple(str(Path(p).absolute()) for p in effects)
    left = sweep.left(plan_sweep(rig, **arguments), out)
    if not left:
        return
    done = 0

    def count_one(_: Unit) -> None:
        nonlocal done
        done += 1
        if progress:
            progress(done, len(left))

    own_name = uuid.uuid4().hex  # the same arguments may come to mean another rig
    units = (Unit(own_name, whole, own, str(out.absolute()), *each) for each in left)
    with client(address) as found:
        share_out(units, work_out, found, count_one, lambda unit, _: unit)


def _refuse_script(rig: RigFile) -> None:
    """Refuse a controller or a valve that a worker could not import."""
    for own in (rig.law, rig.valve):
        name, module = type(own).__qualname__, type(own).__module__
        if module == "__main__" or "<locals>" in name:
            raise InputError(
                f"--cluster: {name} is defined in the running script or notebook, "
                "which workers cannot import; move it to a file of its own and import "
                "it from there"
            )


def work_out(unit: Unit) -> Unit:
    """Compute a chunk and keep it; what the worker has compiled serves the next."""
    _worker(unit.sweep, unit.arguments, unit.effects, unit.out)(
        unit.method, unit.number
    )
    return unit


@lru_cache(maxsize=1)
def _worker(
    _sweep: str, arguments: bytes, effects: tuple[str, ...], out: str
) -> Callable[[str, int], None]:
    set_up_jax(user_cache(), LOOPS)
    for path in effects:
        load_effects(path)
    try:
        rig, more = pickle.loads(arguments)
    except (ImportError, AttributeError) as error:
        raise InputError(
            f"--cluster: a worker cannot import the controller or the valve: {error}; "
            "install its module where the workers run"
        ) from error
    return sweep.chunk_worker(plan_sweep(rig, **more), Path(out))
