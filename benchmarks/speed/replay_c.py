"""The replay over windows and its Jacobian in C: scalar, or windows side by side."""

from __future__ import annotations

import ctypes
import os
from dataclasses import dataclass

import numpy as np
from jaxtyping import ArrayLike

from .build_c import dtype, library, names
from .numbers import Numbers
from .replays import NAMES, STAGES, Replay, ahead, from_ticks, moved, numbers_at, start

_WHOLE = (
    "windows", "ticks", "substeps", "before", "segments", "length", "lag", "threads",
)  # fmt: skip
_ARRAYS = ("u", "h", "P_s", "P_r", "v", "x", "earlier", "P_0", "dx", "tick", "speed0")


class _Log(ctypes.Structure):
    """`Log` of replay.c."""

    _fields_ = [
        *((n, ctypes.c_int) for n in _WHOLE),
        *((n, ctypes.c_void_p) for n in (*_ARRAYS, "from", "room")),
    ]


@dataclass(frozen=True)
class Compiled:
    """A log laid out for C; `replay` and `jacobian` run on it."""

    library: ctypes.CDLL
    log: _Log
    arrays: list[np.ndarray]  # the log holds bare addresses
    order: list[str]
    given: Replay
    start: Numbers
    base: np.ndarray
    slopes: np.ndarray

    def _numbers(self, params: np.ndarray) -> np.ndarray:
        n = numbers_at(self.start, params)
        rows = [np.broadcast_to(n[name], len(params)) for name in self.order]
        return np.ascontiguousarray(np.stack(rows, axis=1), self.base.dtype)

    def _scored(self, out: np.ndarray) -> np.ndarray:
        """[..., 3, ticks, windows] as [W, T, 3, ...], without a copy."""
        w = self.given.windows
        lead = out.shape[-2] - w.scored
        cut = out[..., lead:, : len(self.given.P_0)]
        return np.moveaxis(cut, (-1, -2, -3), (0, 1, 2))

    def replay(self, params: ArrayLike) -> np.ndarray:
        """P_a1, P_a2, F, [W, T, 3], at `params` [16] (`NAMES`), SI.

        A view of a buffer that the next call writes to.
        """
        numbers = self._numbers(np.asarray(params, float)[None])
        self.library.run_replay(ctypes.byref(self.log), _at(numbers), _at(self.base))
        return self._scored(self.base)

    def jacobian(self, params: ArrayLike) -> np.ndarray:
        """Its derivative by forward differences, [W, T, 3, 16]; a view likewise.

        Threads take parameters. What a parameter does not change is not run again.
        """
        sets, step = moved(np.asarray(params, float))
        numbers, step = self._numbers(sets), step.astype(self.base.dtype)
        stage = np.array(STAGES, np.int32)
        self.library.run_jacobian(
            ctypes.byref(self.log), _at(numbers), _at(stage), _at(step), len(NAMES),
            _at(self.base), _at(self.slopes),
        )  # fmt: skip
        return self._scored(self.slopes)


def _at(a: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(a.ctypes.data)


def prepare(given: Replay, lanes: int = 1, threads: int | None = None) -> Compiled:
    """A replay in C (double), ready to be run.

    Args:
        given: a pull-pull rig without effects or with a valve_lag, and its log.
        lanes: windows side by side; 1 is plain scalar C, 8 fills a vector of 512 bits.
        threads: that share windows, or parameters; None is one per core.

    Raises:
        RuntimeError: no C compiler.
        ValueError: a rig or log that the peers have not.
    """
    c, w, m = library("replay.c", "double", lanes), given.windows, given.motion
    c.replay_numbers.restype = ctypes.c_char_p
    count, ticks = np.shape(w.u)
    padded = -(-count // lanes) * lanes

    def turned(a: ArrayLike) -> np.ndarray:
        """[W, ...] as [..., padded]: beyond the last window it is repeated."""
        a = np.asarray(a, dtype("double"))
        a = np.pad(a, [(0, padded - count)] + [(0, 0)] * (a.ndim - 1), mode="edge")
        return np.ascontiguousarray(np.moveaxis(a, 0, -1))

    before = ahead(given)
    arrays = [turned(a) for a in (w.u, w.h, w.P_s, w.P_r, w.v, w.x_fine, before)]
    arrays += [turned(given.P_0)]
    arrays += [np.ascontiguousarray(a, float) for a in (m.dx, m.h, m.speed0)]
    arrays += [turned(from_ticks(given)).astype(np.int32)]
    segments, steps, _ = m.dx.shape
    substeps = (w.x_fine.shape[-1] - 1) // 2
    workers = threads or os.cpu_count() or 1
    whole = (padded, ticks, substeps, before.shape[1], segments, steps + 1)
    log = _Log(*whole, given.lag, workers, *(a.ctypes.data for a in arrays))
    c.room_for.restype = ctypes.c_long
    arrays += [np.empty(2 * c.room_for(ctypes.byref(log)))]
    log.room = arrays[-1].ctypes.data
    base = np.empty((3, ticks, padded))
    slopes = np.empty((len(NAMES), *base.shape))
    order = names(c.replay_numbers())
    return Compiled(c, log, arrays, order, given, start(given), base, slopes)
