"""A log's windows as the replay's peers take them, and the parameters they move."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike

from hydrojax.effects.valve import ValveLag
from hydrojax.plant.replay import Motion, Windows
from hydrojax.plant.rig import PARTS, Rig

from .numbers import Numbers, plant, spool, worked_out

NAMES = (
    "c_p1", "c_n1", "c_p2", "c_n2", "beta", "delta_1", "delta_2",
    "k_cp", "k_cn", "k_0", "k_vp", "k_vn", "k_fp", "k_fn", "z_ss", "delta",
)  # fmt: skip
"""The sixteen parameters, in the order of `replay(params)`; SI."""

PRESSURES = frozenset(NAMES[:7])
FRICTION = frozenset({"z_ss"})
STAGES = [2 if n in FRICTION else 1 if n in PRESSURES else 0 for n in NAMES]
"""What a parameter changes: readings (0), pressures too (1), or the bristle (2)."""

AHEAD = 260
"""Ticks of command ahead of a window that the peers run a spool through."""

STEP = 1e-6
"""Of forward differences, relative to the parameter, or to its scale where it is 0."""


class Replay(NamedTuple):
    """A rig and the log that drives it, `P_0` [W, 2] the windows' first pressures."""

    rig: Rig
    motion: Motion
    windows: Windows
    P_0: np.ndarray

    @property
    def lag(self) -> bool:
        """Whether a spool stands on the command's path.

        Raises:
            ValueError: something else does, or the spool and uneven ticks.
        """
        if not self.rig.command:
            return False
        if len(self.rig.command) > 1 or not isinstance(self.rig.command[0], ValveLag):
            raise ValueError("this peer has no other command channel than valve_lag")
        h = np.ravel(self.windows.h[:, :-1])
        if np.ptp(h) > 1e-9 * h[0]:
            raise ValueError("this peer wants even ticks for a valve_lag")
        return True


def ahead(replay: Replay) -> np.ndarray:
    """The command ahead of each window, [W, `AHEAD`], held where the log begins."""
    w = replay.windows
    first = np.asarray(w.first)[:, None] + np.arange(-AHEAD, 0)
    return np.asarray(replay.motion.u)[np.asarray(w.seg)[:, None], np.maximum(first, 0)]


def start(replay: Replay) -> Numbers:
    """The rig's numbers, the spool's over a part of a tick among them."""
    h = float(replay.windows.h[0, 0]) / PARTS
    half = np.asarray(replay.rig.chambers.length, float) / 2
    return plant(replay.rig) | spool(replay.rig, h) | {"half": half}


def numbers_at(start: Numbers, params: ArrayLike) -> Numbers:
    """The numbers at `params` [m, 16]; each [m] or ()."""
    params = np.asarray(params, float)
    out = start | dict(zip(NAMES, params.T, strict=True))
    out |= {f"half_{i}": out["half"] + out[f"delta_{i}"] for i in (1, 2)}
    return out | worked_out(out)


def steps(params: np.ndarray) -> np.ndarray:
    """The differences' steps at `params` [16]; where one is 0, its step is 1e-9."""
    return np.where(params == 0, 1e-9, STEP * np.abs(params))


def moved(params: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`params`, then each of them moved in turn, [17, 16]; the steps [16]."""
    step = steps(params)
    sets = np.concatenate([params[None], params + np.diag(step)])
    return sets, sets.diagonal(-1) - params


def from_ticks(replay: Replay) -> np.ndarray:
    """Where each window starts in all segments laid end to end, [W]."""
    length = replay.motion.dx.shape[1] + 1
    w = replay.windows
    return np.asarray(w.seg) * length + np.asarray(w.first)
