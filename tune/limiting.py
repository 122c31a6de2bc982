"""What limits a tuned loop: each limit taken away in turn, the loop tuned again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import equinox as eqx
import numpy as np

from hydrojax.tune.aims import Following, Magnitude
from hydrojax.tune.objective import Objective
from hydrojax.tune.optimize import Optimum, optimize_gains

ITERATIONS = 5
"""Of the descent without one of the limits, which starts from the tuned loop."""


@dataclass(frozen=True)
class Relaxed:
    """What the loop could do without one of its limits.

    Attributes:
        what: the limit that was taken away.
        band: of the aim, of the worst plant, Hz.
        gain: of the band, relative to the tuned loop's.
    """

    what: str
    band: float
    gain: float


def what_limits(
    objective: Objective, optimum: Optimum, progress: Callable[[str], None]
) -> tuple[Relaxed, ...]:
    """What each limit costs, the most first.

    Args:
        objective: that the loop was tuned for; nothing is compiled anew.
        optimum: the gains found.
        progress: called with a line of text at each stage.
    """
    if not isinstance(objective.aim, (Following, Magnitude)):
        return ()
    near, out = objective.without_runs(optimum.gains), []
    base = near.scores(optimum.gains)[0][0]
    for what, case in _cases(near).items():
        progress(f"what limits it: {what}")
        other = optimize_gains(case, 1, begin=optimum.gains, iterations=ITERATIONS)
        # The descent may come to nothing: the same gains give a lower bound.
        score = other.score if other.kept else case.scores(optimum.gains)[0][0]
        score = max(base, score)
        out.append(Relaxed(what, float(np.exp(score)), float(np.exp(score - base)) - 1))
    return tuple(sorted(out, key=lambda r: -r.gain))


def _cases(objective: Objective) -> dict[str, Objective]:
    """The objective without one of its limits at a time."""
    keep, values, names = objective.limits, objective.values, list(objective.names)
    higher = eqx.tree_at(
        lambda s: s.P_s, objective.setting, 1.5 * objective.setting.P_s
    )
    cases: dict[str, Objective] = {
        "peak: 3 dB more": objective.relaxed(
            limits=replace(keep, peak_dB=keep.peak_dB + 3)
        ),
        "margins: 3 dB less": objective.relaxed(
            limits=replace(
                keep,
                sensitivity_dB=keep.sensitivity_dB + 3,
                moving_dB=keep.moving_dB + 3,
            )
        ),
        "sensor noise: none": objective.relaxed(limits=replace(keep, noise=1e3)),
        "tracking and rejection: not required": objective.relaxed(
            limits=replace(keep, tracking=1e3, rejection=1e-2)
        ),
        "pressure range: supply 1.5 times as high": objective.relaxed(
            setting=higher, limits=replace(keep, push=1e3)
        ),
        "the rig itself known exactly": objective.relaxed(
            values=np.repeat(values[:1], len(values), axis=0)
        ),
    }
    for name, what, factor in (
        ("valve_lag.tau", "spool: ten times as fast", 0.1),
        ("valve_delay.tau_u", "computing delay: none", 0.0),
    ):
        if name in names:
            other = values.copy()
            other[:, names.index(name)] *= factor
            cases[what] = objective.relaxed(values=other)
    return cases
