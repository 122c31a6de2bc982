"""What limits a tuned loop: each limit taken away in turn, the loop tuned again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import equinox as eqx
import numpy as np

from hydrojax.parameters import get, parameter_specs
from hydrojax.rigfile.quantities import Setting
from hydrojax.tune.ensemble import Plants
from hydrojax.tune.metrics import minimum
from hydrojax.tune.objective import Objective
from hydrojax.tune.optimize import Optimum, optimize_gains


@dataclass(frozen=True)
class Relaxed:
    """What the loop could do without one of its limits.

    Attributes:
        what: the limit that was taken away.
        band: within 1 dB, of the worst plant, Hz.
        gain: of the band, relative to the tuned loop's.
    """

    what: str
    band: float
    gain: float


def with_valve(setting: Setting, plants: Plants) -> Plants:
    """The plants with the spool's lag and the delay among their parameters.

    So that both can be relaxed without compiling anew.
    """
    known = parameter_specs(setting.loop.rig)
    more = [
        n for n in ("valve_lag.tau", "valve_delay.tau_u")
        if n in known and n not in plants.names
    ]  # fmt: skip
    if not more:
        return plants
    here = np.asarray(get(setting.loop.rig, more))
    values = np.hstack([plants.values, np.tile(here, (len(plants.values), 1))])
    return Plants((*plants.names, *more), values, plants.description)


def what_limits(
    objective: Objective, optimum: Optimum, progress: Callable[[str], None]
) -> tuple[Relaxed, ...]:
    """What each limit costs, the most first.

    Args:
        objective: that the loop was tuned for; nothing is compiled anew.
        optimum: the gains found.
        progress: called with a line of text at each stage.
    """
    base = minimum(objective.evaluate(optimum.gains)["within_1dB"])
    out = []
    for what, case in _cases(objective).items():
        progress(f"what limits it: {what}")
        other = optimize_gains(case, 1, begin=optimum.gains)
        band = minimum(case.evaluate(other.gains)["within_1dB"])
        if not other.kept:
            # The descent came to nothing: what the same gains give is a lower bound.
            band = max(base, minimum(case.evaluate(optimum.gains)["within_1dB"]))
        out.append(Relaxed(what, band, band / base - 1 if base else np.nan))
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
            limits=replace(keep, sensitivity_dB=keep.sensitivity_dB + 3)
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
