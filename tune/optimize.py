"""Gains by descent (L-BFGS-B with penalties) from several starts.

Where no gains keep every limit the penalties end at a compromise, which a descent with
strict constraints does not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import optimize

from hydrojax.control.adaptive import Law
from hydrojax.control.base import RATES
from hydrojax.rigfile.quantities import Quantity
from hydrojax.tune.aims import CONSTRAINTS
from hydrojax.tune.objective import Objective

MAX_ITERATIONS = 25
REACH = 30.0
"""How many times above or below where it starts a gain may go."""

REACH_DOWN = 300.0
"""How many times below where it starts a rate of adaptation may go; above, 3 times."""

AT_END = 0.02
"""Share of that range within which a gain is at its end."""

PENALTY = 30.0
"""Weight of the squares by which constraints are broken."""

TIGHT = 0.02
"""A constraint within this of its end is one that holds the loop back."""


@dataclass(frozen=True, eq=False)
class Optimum:
    """The gains found, and what they give.

    Attributes:
        gains: in their units.
        score: of the aim.
        slack: what is left of each constraint, by name; < 0 is broken.
        others: the gains at which the other descents ended.
    """

    gains: Float[np.ndarray, "gains"]
    score: float
    slack: dict[str, float]
    others: tuple[Float[np.ndarray, "gains"], ...] = ()

    @property
    def kept(self) -> bool:
        """Whether nothing is broken."""
        return min(self.slack.values()) > -TIGHT


def optimize_gains(
    objective: Objective,
    starts: int = 2,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
    begin: Float[np.ndarray, "gains"] | None = None,
    iterations: int = MAX_ITERATIONS,
) -> Optimum:
    """The gains that reach the aim best and keep all limits.

    Args:
        objective: aim and constraints.
        starts: descents, the first from the present gains, the others at random.
        seed: of the random ones.
        progress: called with a line of text at each stage.
        begin: where the first starts, if not from the present gains.
        iterations: of each descent at most.

    Returns:
        The best of those that break nothing; the one that breaks least if all do.
    """
    here = origin(objective)
    low, high = reach(objective)
    count = low.size
    first = np.zeros(count) if begin is None else mean_log(objective, begin / here)
    rng = np.random.default_rng([seed, 31])
    tries = [np.clip(first, low, high)] + [
        rng.uniform(np.maximum(low, -np.log(10)), np.minimum(high, np.log(3)))
        for _ in range(starts - 1)
    ]
    ends: list[Optimum] = []
    for i, y in enumerate(tries):
        progress(f"descent {i + 1} of {len(tries)}")
        y = _stable(objective, here, y)
        ends.append(_descend(objective, here, y, (low, high), iterations))
    kept = [e for e in ends if e.kept]
    best = (
        max(kept, key=lambda e: e.score)
        if kept
        else max(ends, key=lambda e: min(e.slack.values()))
    )
    others = tuple(e.gains for e in ends if e is not best)
    return Optimum(best.gains, best.score, best.slack, others)


def origin(objective: Objective) -> Float[np.ndarray, "gains"]:
    """The gains that logarithms are relative to: the setting's, none of them 0."""
    floors = (_floor(q.name) for q in objective.free)
    pairs = zip(objective.initial(), floors, strict=True)
    return np.array([max(pair) for pair in pairs])


def from_logs(
    objective: Objective,
    here: Float[np.ndarray, "gains"],
    y: Float[np.ndarray, "groups"],
) -> Float[np.ndarray, "gains"]:
    """The gains at logarithms of their groups relative to `here`, of `origin`."""
    return here * np.exp(y[objective.groups])


def edges(objective: Objective, gains: Float[np.ndarray, "gains"]) -> tuple[str, ...]:
    """Names of the gains that are at an end of the range that is searched."""
    low, high = reach(objective)
    y = mean_log(objective, gains / origin(objective))
    near = np.minimum(y - low, high - y) < AT_END * (high - low)
    pairs = zip(objective.free, near[objective.groups], strict=True)
    return tuple(quantity.name for quantity, at_end in pairs if at_end)


def _floor(name: str) -> float:
    """Where a descent over a log scale begins for what may be 0."""
    return {"tau_d": 2e-4, "tau_v": 2e-4}.get(name, 1e-6)


def _is_rate(quantity: Quantity) -> bool:
    return quantity.name in RATES


def reach(
    objective: Objective,
) -> tuple[Float[np.ndarray, "groups"], Float[np.ndarray, "groups"]]:
    """Ends of the logarithm of each group of gains, relative to its start."""
    low = np.full(int(objective.groups.max()) + 1, -np.log(REACH))
    high = -low
    for group, quantity in zip(objective.groups, objective.free, strict=True):
        if _is_rate(quantity):
            low[group], high[group] = -np.log(REACH_DOWN), np.log(3)
    return low, high


def mean_log(
    objective: Objective, ratio: Float[np.ndarray, "gains"]
) -> Float[np.ndarray, "groups"]:
    """The logarithm of each group's mean ratio."""
    logs = np.log(np.maximum(ratio, 1e-9))
    count = int(objective.groups.max()) + 1
    return np.array([logs[objective.groups == g].mean() for g in range(count)])


def _stable(objective: Objective, here: np.ndarray, y: np.ndarray) -> np.ndarray:
    """`y` with its feedback and its adaptation lowered until the loop is stable."""
    adaptive = isinstance(objective.setting.loop.law, Law)
    lowered = np.zeros(y.size)
    for group, q in zip(objective.groups, objective.free, strict=True):
        if not adaptive or q.name in ("k_p", "k_f") or _is_rate(q):
            lowered[group] = np.log(0.6)
    for _ in range(8):
        if objective.stable(from_logs(objective, here, y)):
            break
        y = y + lowered
    return y


def _descend(
    objective: Objective, here: np.ndarray, y: np.ndarray,
    ends: tuple[np.ndarray, np.ndarray], iterations: int,
) -> Optimum:  # fmt: skip
    seen: dict[bytes, tuple[np.ndarray, np.ndarray, bool]] = {}

    def scored(y: np.ndarray) -> tuple[np.ndarray, np.ndarray, bool]:
        key = y.tobytes()
        if key not in seen:
            gains = from_logs(objective, here, y)
            value, slope, sound = objective.scores(gains)
            if not sound:  # unstable: keep the search away
                value, slope = np.full(value.size, -10.0), np.zeros(slope.shape)
            seen[key] = value, slope, sound
        return seen[key]

    def cost(y: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope, _ = scored(y)
        short = np.minimum(value[1:] - TIGHT / 2, 0.0)
        slopes = -slope[0] + 2 * PENALTY * short @ slope[1:]
        return float(-value[0] + PENALTY * short @ short), slopes

    optimize.minimize(
        cost, y, jac=True, bounds=list(zip(*ends, strict=True)), method="L-BFGS-B",
        options={"maxiter": iterations, "ftol": 1e-3, "maxls": 8},
    )  # fmt: skip
    # The last point may be one of the line search; take the best that was looked at.
    y = min((np.frombuffer(key) for key in seen), key=lambda y: cost(y)[0])
    value = scored(y)[0]
    return Optimum(
        from_logs(objective, here, y),
        float(value[0]),
        dict(zip(CONSTRAINTS, map(float, value[1:]), strict=True)),
    )
