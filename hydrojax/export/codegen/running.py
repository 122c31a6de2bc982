"""C in lanes, compiled for this machine, loaded, and run on arrays."""

from __future__ import annotations

import ctypes
import functools
import os
import tempfile
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from hydrojax.errors import InputError
from hydrojax.export.codegen.compiler import shared_library
from hydrojax.export.codegen.lanes import FLAGS, Laned

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
