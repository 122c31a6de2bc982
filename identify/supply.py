"""A supply pressure that is off by a factor, as a whole trace has it.

What a balance of flow makes of it its coefficients make too, where the pressures swing
little. Effects of the sensors can then take its place: gauges and load cell that all
read wrong by one factor are a supply that is wrong by it, and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hydrojax.identify.case import Case
from hydrojax.identify.checking.factors import SUPPLY
from hydrojax.identify.checking.mended import Findings
from hydrojax.identify.checking.words import supply_like_gains
from hydrojax.identify.tracing.state import Tracing

ALIKE = 0.1
"""By how much gains may differ that are taken for one, as a share of it: the return
line's pressure is not wrong with the supply's."""


def with_supply_of_gains(
    case: Case, found: Findings, state: Tracing, progress: Callable[[str], None]
) -> Findings:
    """The findings, with that of a supply pressure that is off by a factor, where the
    effects found say that of every sensor: both gauges, and the load cell where there
    is one; else themselves.

    Args:
        case: with the findings mended in it.
        found: in its inputs.
        state: where the trace ended.
        progress: is called with a line of text.
    """
    names = {a.name for a in state.added}
    wanted: dict[str, tuple[str, ...]] = {"pressure_sensor_gain": ("eps_1", "eps_2")}
    if np.isfinite(state.noise[2]):
        wanted["loadcell_gain"] = ("eps",)
    known = any(f.input == "P_s" for f in found)
    if known or case.fit.driven_by != "u" or not set(wanted) <= names:
        return found
    gains = np.array(
        [state.named[f"{effect}.{n}"] for effect, own in wanted.items() for n in own]
    )
    mean = float(np.mean(gains))
    if abs(mean) < SUPPLY or np.ptp(gains) > ALIKE * abs(mean):
        return found
    progress("see whether P_s is off by a factor")
    logged = all("P_s" in log.signals for log in case.read_logs)
    one = supply_like_gains(case.spec, logged, 1 + mean, "loadcell_gain" in wanted)
    return (*found, one)


def simpler_and_no_worse(own: Tracing, other: Tracing) -> bool:
    """Whether another trace's end leaves no channel of the validation logs further off
    than one's own, or all of them at their noise; with fewer effects.
    """
    matters, noise = own.criteria.matters, own.noise
    rms = [s.check.rms(s.check.errors_at(s.point.values)) for s in (own, other)]
    most = np.maximum(rms[0], noise) + matters * noise
    seen = np.isfinite(noise)
    return len(other.added) < len(own.added) and bool(np.all((rms[1] <= most)[seen]))
