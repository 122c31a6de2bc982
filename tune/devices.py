"""Rows of a program shared out over devices."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, PartitionSpec


def on_all_devices(f: Callable[..., Any]) -> Callable[..., Any]:
    """`f` of rows [N, ...], with the rows shared out over this process's devices.

    Each works out its own rows, and nothing passes between them. N has to be a multiple
    of `jax.local_device_count()`: GPUs, or CPU devices if XLA was asked for several.
    """
    rows = PartitionSpec("rows")
    mesh = Mesh(np.array(jax.local_devices()), ("rows",))
    return jax.shard_map(f, mesh=mesh, in_specs=rows, out_specs=rows, check_vma=False)
