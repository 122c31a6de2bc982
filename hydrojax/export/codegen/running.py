"""Steps in lanes: written as C, compiled for this machine, and run on arrays."""

from __future__ import annotations

import ctypes
import functools
import os
import tempfile
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hydrojax.errors import InputError
from hydrojax.export.codegen.compiler import shared_library
from hydrojax.export.codegen.lanes import FLAGS, Laned, laned

Run = Callable[
    [
        Float[np.ndarray, "numbers B"],
        Float[np.ndarray, "state B"],
        Float[np.ndarray, "T inputs"],
        int,
    ],
    tuple[Float[np.ndarray, "T kept B"], Float[np.ndarray, "state B"]],
]
"""Runs B instances: their rows, first states, the course of all, and how many threads;
gives what is kept of each tick, and the last states."""


def stepper(
    step: Callable[[Any, Any, Any], tuple[Any, Any]],
    state: Any,
    row: Float[np.ndarray, "numbers"],
    tick: Any,
    alike: Sequence[bool],
    wanted_by: str,
) -> Run:
    """What runs a step in C.

    Args:
        step: `step(row, state, tick)` gives the state and an array of what is kept.
        state: of one instance, arrays of any kind or their shapes.
        row: of one instance: what differs between instances.
        tick: of one tick: what changes from tick to tick.
        alike: of the numbers of `flat(state)`, whether all instances begin with the
            same.
        wanted_by: opens an error's line.

    Raises:
        InputError: no C compiler, or a step with an operation that has no form in C.
    """
    leaves, tree = jax.tree.flatten(state)

    def in_numbers(row, numbers, now):
        own = [a.astype(b.dtype) for a, b in zip(numbers, leaves, strict=True)]
        after, kept = step(row, jax.tree.unflatten(tree, own), now)
        return [jnp.asarray(a, float) for a in jax.tree.leaves(after)], kept

    blank = [jnp.zeros(leaf.shape) for leaf in leaves]
    return runner(laned(in_numbers, row, blank, tick, alike), wanted_by)


def flat(state: Any) -> Float[Array, "numbers"]:
    """A state as the numbers that `Run` begins with."""
    return jnp.concatenate(
        [jnp.asarray(a, float).ravel() for a in jax.tree.leaves(state)]
    )


def runner(made: Laned, wanted_by: str) -> Run:
    """What runs a step that was written as C.

    Args:
        made: the step.
        wanted_by: opens an error's line.

    Raises:
        InputError: there is no compiler, it does not compile the C, or the system does
            not load what it made. `Run` raises `MemoryError`.
    """
    c = _library(made.source, wanted_by).run
    c.argtypes = [ctypes.c_long] * 2 + [ctypes.c_void_p] * 5 + [ctypes.c_int]

    def run(rows, begin, course, threads):
        arrays = [np.ascontiguousarray(a, float) for a in (rows, begin, course)]
        ticks, count = len(course), begin.shape[1]
        kept, last = np.empty((ticks, made.kept, count)), np.zeros_like(arrays[1])
        given = [a.ctypes.data for a in arrays]
        out = kept.ctypes.data if made.kept else None
        if c(count, ticks, *given, out, last.ctypes.data, threads):
            raise MemoryError(f"{wanted_by}: no memory for the course of the loop")
        return kept, last

    return run


@functools.cache
def _library(source: str, wanted_by: str) -> ctypes.CDLL:
    data = shared_library({"lanes.c": source}, FLAGS, wanted_by)
    file, path = tempfile.mkstemp(suffix=".so")
    try:
        with os.fdopen(file, "wb") as out:
            out.write(data)
        return ctypes.CDLL(path)
    except OSError as reason:  # a folder from which nothing may run, no OpenMP
        raise InputError(f"{wanted_by}: what was compiled does not load") from reason
    finally:
        os.unlink(path)
