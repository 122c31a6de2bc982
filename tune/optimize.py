"""Gains by descent: SLSQP with exact slopes, from several starts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy import optimize

from hydrojax.control.adaptive import Law
from hydrojax.tune.objective import CONSTRAINTS, Limits, Objective

MAX_ITERATIONS = 40
REACH = 30.0
"""How many times above or below where it starts a gain may go."""

TIGHT = 0.02
"""A constraint within this of its end is one that holds the bandwidth back."""


@dataclass(frozen=True, eq=False)
class Optimum:
    """The gains found, and what they give.

    Attributes:
        gains: in their units.
        log_band: log of the smooth bandwidth of the worst plant.
        slack: what is left of each constraint, by name; < 0 is broken.
        starts: bandwidth (Hz) that each start came to, NaN where it broke something.
    """

    gains: Float[np.ndarray, "gains"]
    log_band: float
    slack: dict[str, float]
    starts: tuple[float, ...]

    @property
    def kept(self) -> bool:
        """Whether nothing is broken."""
        return min(self.slack.values()) > -TIGHT


def optimize_gains(
    objective: Objective,
    starts: int = 4,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
    begin: Float[np.ndarray, "gains"] | None = None,
) -> Optimum:
    """The widest loop that keeps all limits.

    Args:
        objective: bandwidth and constraints.
        starts: descents, the first from the present gains, the others at random.
        seed: of the random ones.
        progress: called with a line of text at each stage.
        begin: where the first starts, if not from the present gains.

    Returns:
        The best of those that break nothing; the one that breaks least if all do.
    """
    floors = (_floor(q.name) for q in objective.free)
    pairs = zip(objective.initial(), floors, strict=True)
    here = np.array([max(pair) for pair in pairs])
    first = here if begin is None else np.maximum(begin, 1e-9 * here)
    rng = np.random.default_rng([seed, 31])
    tries = [first] + [
        here * np.exp(rng.uniform(-np.log(10), np.log(3), here.size))
        for _ in range(starts - 1)
    ]
    ends: list[Optimum] = []
    for i, x in enumerate(tries):
        progress(f"descent {i + 1} of {len(tries)}")
        ends.append(_descend(objective, here, _stable(objective, x)))
    kept = [e for e in ends if e.kept]
    best = (
        max(kept, key=lambda e: e.log_band)
        if kept
        else max(ends, key=lambda e: min(e.slack.values()))
    )
    bands = tuple(float(np.exp(e.log_band)) if e in kept else np.nan for e in ends)
    return Optimum(best.gains, best.log_band, best.slack, bands)


def _floor(name: str) -> float:
    """Where a descent over a log scale begins for what may be 0."""
    return {"tau_d": 2e-4, "tau_v": 2e-4}.get(name, 1e-6)


def _stable(objective: Objective, x: np.ndarray) -> np.ndarray:
    """`x` with its feedback lowered until the loop is stable."""
    adaptive = isinstance(objective.setting.loop.law, Law)
    feedback = np.array(
        [not adaptive or q.name in ("k_p", "k_f") for q in objective.free]
    )
    for _ in range(8):
        if objective.scores(x)[2]:
            break
        x = np.where(feedback, 0.6 * x, x)
    return x


def _descend(objective: Objective, here: np.ndarray, x: np.ndarray) -> Optimum:
    seen: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def scored(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        key = y.tobytes()
        if key not in seen:
            gains = here * np.exp(y)
            value, slope, sound = objective.scores(gains)
            if not sound:  # unstable: keep the search away
                value, slope = np.full(value.size, -10.0), np.zeros(slope.shape)
            seen[key] = value, slope * gains
        return seen[key]

    done = optimize.minimize(
        lambda y: -scored(y)[0][0],
        np.log(x / here),
        jac=lambda y: -scored(y)[1][0],
        bounds=[(-np.log(REACH), np.log(REACH))] * x.size,
        constraints={"type": "ineq", "fun": lambda y: scored(y)[0][1:],
                     "jac": lambda y: scored(y)[1][1:]},
        method="SLSQP",
        options={"maxiter": MAX_ITERATIONS, "ftol": 1e-4},
    )  # fmt: skip
    # The last point may be one of the line search; take the best that was looked at.
    best = max(
        seen.items(),
        key=lambda item: (
            item[1][0][0] + 20 * min(0.0, item[1][0][1:].min() + TIGHT / 2)
        ),
    )
    y = np.frombuffer(best[0]) if best else done.x
    value = best[1][0]
    return Optimum(
        here * np.exp(y), float(value[0]),
        dict(zip(CONSTRAINTS, map(float, value[1:]), strict=True)), (),
    )  # fmt: skip


def find_gains(
    objective: Objective, starts: int, progress: Callable[[str], None] = lambda _: None
) -> tuple[Optimum, Objective, tuple[str, ...]]:
    """The gains, with tracking and rejection given up where no gains keep all.

    Args:
        objective: bandwidth and constraints.
        starts: number of descents.
        progress: called with a line of text at each stage.

    Returns:
        The optimum, the objective that it is of, and a note on what was given up.
    """
    best = optimize_gains(objective, starts, progress=progress)
    if best.kept:
        return best, objective, ()
    free = objective.relaxed(limits=_loose(objective.limits))
    other = optimize_gains(
        free, starts, progress=progress, begin=0.3 * objective.initial()
    )
    if min(other.slack.values()) <= min(best.slack.values()):
        return best, objective, ()
    note = (
        "No gains keep the limits on peak and margins together with those on tracking "
        "and rejection: the latter were given up."
    )
    return other, free, (note,)


def _loose(limits: Limits) -> Limits:
    return replace(limits, tracking=1e3, rejection=1e-2)
