"""Logs as runs of a load that moves by itself: what drives it, and where it was."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hydrojax.identify.case import Case
from hydrojax.identify.preparation.data import SETTLE
from hydrojax.identify.preparation.segments import over_ticks, segment
from hydrojax.logs.log import Log
from hydrojax.plant.load import Inertia
from hydrojax.plant.rig import Rig
from hydrojax.plant.state import StepInput
from hydrojax.rigfile.recording import longest

STIFFEST = 0.3
"""Phase (rad) that the fastest oscillation may go through in one part of a tick: the
leapfrog rule, stable up to 2, is then 0.4 % off in its frequency."""

MOST_PARTS = 64
"""Parts of a tick at most."""


SIGNALS = {"x": "m", "P_a1": "Pa", "P_a2": "Pa", "F": "N"}
"""What a moving load's model predicts, and its unit."""


class Course(NamedTuple):
    """R runs of N ticks, one for each log, padded with their last row; SI.

    `inputs` drives every tick but the last, [R, N-1, ...]. `measured` [R, N, 4] is
    what `SIGNALS` names, of which `v` and `a` [R, N] are the motion's derivatives; what
    is not measured is NaN. The first `lead` ticks let memories settle; `there` [R, N]
    says which ticks are a log's own and come after that.
    """

    inputs: StepInput
    measured: Float[Array, "runs n 4"]
    v: Float[Array, "runs n"]
    a: Float[Array, "runs n"]
    there: Float[Array, "runs n"]
    t: Float[Array, "runs n"]

    @property
    def settling(self) -> Float[np.ndarray, "runs n"]:
        """Where memories settle: ahead of the first tick that is compared."""
        return np.cumsum(np.asarray(self.there), axis=1) <= 1.0

    def head(self, ticks: int) -> Course:
        """The first `ticks` of every run that come after it has settled."""
        ticks += int(self.settling.sum(axis=1).max())
        inputs = jax.tree.map(lambda a: a[:, : ticks - 1], self.inputs)
        return Course(inputs, *(a[:, :ticks] for a in self[1:]))


def course_of(case: Case, logs: Sequence[Log], parts: int) -> Course:
    """The longest stretch without gaps of every log, as a run in `parts` a tick; its
    head only where all logs together would hold over `criteria.most_ticks`.
    """
    rows = [_rows(case, log, parts) for log in logs]
    ticks = max(len(row["t"]) for row in rows)

    def padded(name: str) -> np.ndarray:
        values = [row[name] for row in rows]
        return np.stack(
            [
                np.pad(v, [(0, ticks - len(v)), *[(0, 0)] * (v.ndim - 1)], "edge")
                for v in values
            ]
        )

    own: dict[str, Any] = {name: padded(name) for name in rows[0]}
    for kept, row in zip(own["there"], rows, strict=True):
        kept[len(row["t"]) :] = 0.0
    h: Any = np.diff(own["t"], axis=1)
    still: Any = np.zeros((*h.shape, parts))
    P_s, P_r = (np.stack([own[p][:, :-1], own[p][:, 1:]], -1) for p in ("P_s", "P_r"))
    drive = None
    if case.fit.driven_by == "P":  # held over a tick at its mean
        drive = (own["P"][:, :-1] + own["P"][:, 1:]) / 2
    inputs = StepInput(
        h=np.where(h > 0, h, np.median(h)),
        u=own["u"][:, :-1],
        P_s=jnp.asarray(P_s),
        P_r=jnp.asarray(P_r),
        x=jnp.zeros((*still.shape, 3)),
        dx=None,
        v=still,
        a=still,
        t=own["t"][:, 1:],
        P=drive,
    )
    return Course(inputs, own["measured"], own["v"], own["a"], own["there"], own["t"])


def _rows(case: Case, log: Log, parts: int) -> dict[str, np.ndarray]:
    """One log's longest stretch: signals at its ticks, by name."""
    first, last = longest(log)
    most = case.criteria.most_ticks // len(case.fit_logs)
    rows = slice(first, min(last, first + most))
    own = case.preparation
    driven_by = case.fit.driven_by
    s = segment(0, log, case.spec, rows, driven_by, own.sign, own.band)
    x = s.place(s.t)
    rest = np.full((s.t.size, 3), np.nan)
    for i, name in enumerate(("P_a1", "P_a2", "F")):
        if name in log.signals and (driven_by == "u" or name == "F"):
            rest[:, i] = log.signals[name][rows]
    there = (s.t - s.t[0] >= SETTLE / 2).astype(float)
    drive = log.signals.get("P", np.zeros(log.time.size))[rows]
    return {
        "t": s.t - s.t[0],
        "measured": np.column_stack([x, rest]),
        "v": s.v,
        "a": s.a,
        "u": over_ticks(s.u, s.runs_on),
        "P_s": s.P_s,
        "P_r": s.P_r,
        "P": drive,
        "there": there,
    }


def parts_of(rig: Rig, load: Inertia, mass: float, h: float) -> int:
    """In how many parts a tick of `h` s is to be run.

    By the fastest natural frequency of the load, held by oil and bristle at the rig's
    values; the oil counts twice, since it grows stiffer toward the ends of the stroke.
    `mass` (kg) is all that moves with the piston.
    """
    chambers, friction = rig.chambers, rig.mechanics
    stiffness = float(jnp.maximum(friction.k_cp, friction.k_cn) / friction.z_ss)
    if float(rig.force_area_1) > 0:  # else no oil drives it
        oil = 2 * (rig.force_area_1 + rig.force_area_2) / chambers.length
        stiffness += 2 * float(chambers.beta * oil)
    rate = load.natural_frequencies(stiffness, mass - float(load.mass))[-1]
    parts = np.clip(h * rate / STIFFEST, 1, MOST_PARTS)
    # A power of two: every other number of parts is another program.
    return int(2 ** np.ceil(np.log2(parts)))
