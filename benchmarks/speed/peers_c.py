"""The closed loop in C: scalar, and side by side in the lanes of vector registers."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable

import numpy as np

from hydrojax.control.loop import Loop, Scenario
from hydrojax.control.simulation import PARTS

from .build_c import dtype, library, names
from .numbers import KEPT, columns, delay, numbers

LANES = {"double": (8, 32), "float": (16, 64)}
"""Instances side by side: one vector of 512 bits at least, and four of them at most, so
that one works while another waits."""

_POINTERS = (
    "numbers", "F_d", "noise", "P_s", "P_r", "x", "v", "rms", "out", "moved",
)  # fmt: skip


def _structure(real: str) -> type[ctypes.Structure]:
    """`Run` of loop.c."""
    number = {"double": ctypes.c_double, "float": ctypes.c_float}[real]
    whole = ("instances", "samples", "whole", "threads")
    fields = [*((n, ctypes.c_int) for n in whole), ("share", number), ("h", number)]
    fields += [(n, ctypes.c_void_p) for n in _POINTERS]
    return type("Run", (ctypes.Structure,), {"_fields_": fields})


def lanes_for(instances: int, real: str = "double") -> int:
    """Lanes that are quick for so many instances: a power of two within `LANES`."""
    least, most = LANES[real]
    return min(max(1 << (instances - 1).bit_length(), least), most)


def prepare(
    loop: Loop,
    scenario: Scenario,
    real: str = "double",
    lanes: int = 1,
    threads: int | None = None,
    signals: bool = False,
) -> Callable[[], tuple[np.ndarray, np.ndarray | None]]:
    """A closed loop in C, ready to be run.

    Args:
        loop: its leaves are scalars or [B]: B instances in one scenario.
        scenario: as `hydrojax.control.loop.run` takes it.
        real: C's `double` or `float`.
        lanes: instances side by side; 1 is plain scalar C, else see `lanes_for`.
        threads: at most so many groups of lanes at a time; None is one per core.
        signals: whether the signals are written too.

    Returns:
        What runs it: RMS of F_d - F [B], N, with F the true force, and the signals
        [B, N, len(KEPT)], SI, or None.

    Raises:
        RuntimeError: no C compiler.
        ValueError: a loop that the peers have not; see `numbers`.
    """
    c, kind = library("loop.c", real, lanes), dtype(real)
    c.loop_numbers.restype = ctypes.c_char_p
    given = numbers(loop)
    table = np.atleast_2d(np.stack([given[n] for n in names(c.loop_numbers())]).T).T
    b, n = table.shape[1], scenario.F_d.shape[0]
    whole, share = delay(loop.rig, float(loop.h) / PARTS)
    arrays = [np.ascontiguousarray(a, kind) for a in (table, *columns(scenario))]
    rms = np.empty(b, kind)
    out = np.empty((b, n, len(KEPT)), kind) if signals else None
    at = [a.ctypes.data if a is not None else None for a in (*arrays, rms, out)]
    workers = threads or os.cpu_count() or 1
    run = _structure(real)(b, n, whole, workers, share, float(loop.h), *at, None)

    def call():
        _ = arrays  # kept alive: the structure holds bare addresses
        c.run_loop(ctypes.byref(run))
        return rms, out

    return call
