"""Compiling the programs of this room, and sharing their rows out over devices."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, PartitionSpec

OPTIONS: dict[str, Any] = {"xla_cpu_use_fusion_emitters": False}
"""For XLA's CPU compiler. Its fusion emitters abort the whole process on some Jacobians
of a loop's step (a failed check in `SymbolicMap::Compose`, jax 0.10.2), and make the
others slower."""


@cache
def options() -> dict[str, Any] | None:
    """`OPTIONS`, or None where there is no such compiler or it does not know them."""
    if jax.default_backend() != "cpu":
        return None
    try:
        jax.jit(lambda x: x + 1, compiler_options=OPTIONS)(1.0)
    except Exception:  # XLA's own kinds, by version
        return None
    return OPTIONS


def program(f: Callable[..., Any], **more: Any) -> Callable[..., Any]:
    """`jax.jit` with these options, found out about at the first call."""
    made: list[Callable[..., Any]] = []

    def call(*args: Any, **named: Any) -> Any:
        if not made:
            made.append(jax.jit(f, compiler_options=options(), **more))
        return made[0](*args, **named)

    return call


def on_all_devices(f: Callable[..., Any]) -> Callable[..., Any]:
    """`f` of rows [N, ...], with the rows shared out over this process's devices.

    Each works out its own rows, and nothing passes between them. N has to be a multiple
    of `jax.local_device_count()`: GPUs, or CPU devices if XLA was asked for several.
    """
    rows = PartitionSpec("rows")
    mesh = Mesh(np.array(jax.local_devices()), ("rows",))
    return jax.shard_map(f, mesh=mesh, in_specs=rows, out_specs=rows, check_vma=False)
