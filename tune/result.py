"""A tuning from end to end: gains, adaptation, what limits them, before and after."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy import optimize

from hydrojax.plant.named import parameter_specs
from hydrojax.rigfile.quantities import Quantity, Setting
from hydrojax.tune import optimize as tuning
from hydrojax.tune.axes import Plants
from hydrojax.tune.metrics import least, most, number
from hydrojax.tune.objective import Goal, Limits

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FREE = ("k_p", "k_f", "k_1")
"""What is tuned where nothing else is said: both gains, and how much of the desired
force's rate is fed forward."""

ADAPTATION = ("rho_a", "c_1", "c_2", "c_3", "A_a_lower", "A_a_upper")
"""What is tuned beside them with `--adaptation`, as far as the rig adapts it."""

MERITS = {"within_1dB": "within_1dB_Hz", "peak": "peak_dB", "rms": "rms_N"}
"""What tune.json says of a loop."""


@dataclass(frozen=True)
class Relaxed:
    """What the loop could do without one of its limits; Hz, of the worst plant."""

    what: str
    band: float
    gain: float  # relative to the tuned loop


@dataclass(frozen=True)
class Tuned:
    """What `tune` found.

    Attributes:
        rig: its name.
        gains: by name, in the unit of `units`.
        before, after: merits of every plant, [m, ...]; the rig itself is the first.
        hertz: of their responses.
        found: the descent's end.
        relaxed: what limits it, the most first.
        plants: what the ensemble is.
        promises: what else is compared: title, gains of which, merits of the rig.
        limits: what was to be kept.
    """

    rig: str
    gains: dict[str, float]
    units: dict[str, str]
    start: dict[str, float]
    before: dict[str, np.ndarray]
    after: dict[str, np.ndarray]
    hertz: np.ndarray
    found: tuning.Found
    relaxed: tuple[Relaxed, ...]
    plants: str
    limits: Limits
    promises: tuple[tuple[str, dict[str, float]], ...] = ()
    notes: tuple[str, ...] = field(default=())

    def json(self) -> dict[str, Any]:
        """The content of tune.json: gains in the paper's units."""
        worst = {
            "within_1dB_Hz": least(self.after["within_1dB"]),
            "peak_dB": most(self.after["peak"]),
            "rms_N": most(self.after["rms"]),
        }
        return {
            "gains": self.gains,
            "before": own(self.before),
            "after": own(self.after),
            "worst_of_ensemble": worst,
        }

    def plot(self) -> Figure:
        """Gain and phase before and after, with the ensemble's range."""
        from hydrojax.tune import (
            tuned,  # it draws: whoever only reads a tuning needs no pictures
        )

        return tuned.bode_figure(self)

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        from hydrojax.tune import tuned

        return tuned.html(self)


def own(found: dict[str, np.ndarray]) -> dict[str, float]:
    """The rig's own merits, by tune.json's names; null where it is unstable."""
    return {name: number(found[key][0]) for key, name in MERITS.items()}


def widen(setting: Setting, plants: Plants) -> Plants:
    """The plants with the spool's lag and the delay among their parameters.

    So that both can be relaxed without compiling anew.
    """
    from hydrojax.plant.named import get

    known = parameter_specs(setting.loop.rig)
    more = [
        n for n in ("valve_lag.tau", "valve_delay.tau_u")
        if n in known and n not in plants.names
    ]  # fmt: skip
    if not more:
        return plants
    here = np.asarray(get(setting.loop.rig, more))
    values = np.hstack([plants.values, np.tile(here, (len(plants.values), 1))])
    return Plants((*plants.names, *more), values, plants.says)


def what_limits(
    goal: Goal, found: tuning.Found, progress: Callable[[str], None]
) -> tuple[Relaxed, ...]:
    """Each limit taken away in turn, the loop tuned again: who holds it back."""
    keep, values, names = goal.limits, goal.values, list(goal.names)
    stiff = goal.setting
    more_supply = replace_P_s(stiff, 1.5)
    cases: dict[str, Goal] = {
        "peak: 3 dB more": goal.relaxed(limits=replace(keep, peak=keep.peak + 3)),
        "margins: 3 dB less": goal.relaxed(
            limits=replace(keep, sensitivity=keep.sensitivity + 3)
        ),
        "sensor noise: none": goal.relaxed(limits=replace(keep, noise=1e3)),
        "tracking and rejection: not asked for": goal.relaxed(
            limits=replace(keep, tracking=1e3, rejection=1e-2)
        ),
        "pressure range: supply half as high again": goal.relaxed(
            setting=more_supply, limits=replace(keep, push=1e3)
        ),
        "the rig itself known exactly": goal.relaxed(
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
            cases[what] = goal.relaxed(values=other)
    base = least(goal.look(found.gains)["within_1dB"])
    out = []
    for what, case in cases.items():
        progress(f"what limits it: {what}")
        other = tuning.tune(case, 1, begin=found.gains)
        band = least(case.look(other.gains)["within_1dB"])
        if not other.kept:
            # The descent came to nothing: what the same gains give is a lower bound.
            band = max(base, least(case.look(found.gains)["within_1dB"]))
        out.append(Relaxed(what, band, band / base - 1 if base else np.nan))
    return tuple(sorted(out, key=lambda r: -r.gain))


def replace_P_s(setting: Setting, factor: float) -> Setting:
    """The setting under another supply."""
    import equinox as eqx

    return eqx.tree_at(lambda s: s.P_s, setting, setting.P_s * factor)


def adapt(
    goal: Goal, free: list[Quantity], gains: np.ndarray, progress: Callable[[str], None]
) -> np.ndarray:
    """Rates and bounds of the adaptation that track best, by descent through the run.

    Args:
        goal: whose run, plants and gains' quantities are used.
        free: rates and bounds above 0.
        gains: of the goal, kept as they are.
        progress: called with a line of text at each stage.

    Returns:
        Their values, in their units; those they had if nothing better was found.
    """
    progress("adaptation: descent through the run")
    setting = goal.at(gains)
    inner = copy_with(goal, setting, free)
    here = inner.here()
    given = inner._given()
    run, slope = jax.jit(inner._tracking), jax.jit(jax.jacfwd(inner._tracking))

    def look(y):
        g = jnp.asarray(here * np.exp(y))
        rms = np.asarray(run(g, given))
        steep = np.asarray(slope(g, given)) * np.asarray(g)
        if not (np.all(np.isfinite(rms)) and np.all(np.isfinite(steep))):
            return 1e3, np.zeros(y.size)
        mean = np.mean(rms**2)
        return 0.5 * np.log(mean), (rms @ steep) / rms.size / mean

    done = optimize.minimize(
        look, np.zeros(here.size), jac=True, method="L-BFGS-B",
        bounds=[(-np.log(10), np.log(10))] * here.size,
        options={"maxiter": 12},
    )  # fmt: skip
    better = done.fun < look(np.zeros(here.size))[0] - 1e-3
    return here * np.exp(done.x) if better else here


def copy_with(goal: Goal, setting: Setting, free: list[Quantity]) -> Goal:
    """The goal over other quantities, for its run alone."""
    out = goal.relaxed(setting=setting)
    out.free = free
    return out
