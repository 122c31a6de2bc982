"""The values that are best for runs through whole logs, from one start or many."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hydrojax.identify.estimation.known import Free
from hydrojax.identify.motion.course import Course
from hydrojax.identify.motion.follow import fit_follow
from hydrojax.identify.motion.mover import Mover, rms, runs_through
from hydrojax.jax_setup import cores

CALLS = 3
"""Fits of 20 steps at one length at most."""

HEAD = 2000
"""Ticks of each log on which starts are sought: time against information."""

DRAWN = 240
"""Starts that are drawn; to rank one takes a single run, to fit it many."""

FITTED = 12
"""Of these, the best that are fitted."""

NEAR = 6
"""Starts about the two best fits, in each of `ROUNDS`: a fit stops in one of many local
minima, and better ones lie near good ones."""

ROUNDS = 2
"""Rounds of such starts."""

WIDE, NARROW = 0.7, 0.3
"""Standard deviation of the logarithm of a start, about the rig file's (a user knows a
mass that bends to its order of magnitude) and about a fit."""

Values = Mapping[str, float]


def refined(
    mover: Mover,
    starts: Sequence[Values],
    free: Mapping[str, Free],
    course: Course,
) -> list[dict[str, float]]:
    """The starts and the values found from them for runs through the course, the best
    first.

    From every start they are found in two ways: at once, and through shorter runs. A
    long run has many minima where an oscillation slips by a period; a short one is
    mostly what it begins with, which is measured.
    """
    if not free:
        return [dict(start) for start in starts]
    every = runs_through(course)
    moved = _Moved.of(mover, free, course)

    def ends(start: Values) -> list[dict[str, float]]:
        steps = dict(start)
        for fresh in every.values():
            steps = moved.fitted(steps, fresh)
        return [steps, moved.fitted(start, every["free"])]

    with ThreadPoolExecutor(cores()) as pool:
        found = [end for pair in pool.map(ends, starts) for end in pair]
    tried = [*(dict(start) for start in starts), *found]
    costs = costs_of(mover, tried, course, every["free"])
    return [tried[i] for i in np.argsort(costs, kind="stable")]


def costs_of(
    mover: Mover,
    tried: Sequence[Values],
    course: Course,
    fresh: Bool[np.ndarray, "runs n"],
) -> Float[np.ndarray, "tried"]:
    """RMS errors with several values in runs that begin where ticks are `fresh`, of all
    signals together, each over its standard deviation; inf where a run does not stay
    finite.
    """
    there, size = np.asarray(course.there) > 0, _sizes(course)
    seen = np.isfinite(size)
    off = (mover.run(values, course, fresh[None])[0][there] for values in tried)
    costs = [rms(o[:, seen] / size[seen]) for o in off]
    return np.nan_to_num(costs, nan=np.inf)


@dataclass(frozen=True)
class _Moved:
    """What is moved in a fit, in which directions, and what it is fitted to."""

    mover: Mover
    free: Mapping[str, Free]
    index: np.ndarray
    scale: np.ndarray
    course: Course

    @classmethod
    def of(cls, mover: Mover, free: Mapping[str, Free], course: Course) -> _Moved:
        """That of the parameters `free`."""
        index = np.array([mover.model.names.index(n) for n in free])
        return cls(mover, free, index, np.asarray(mover.model.scale)[index], course)

    def fitted(
        self, values: Values, fresh: Bool[np.ndarray, "runs n"]
    ) -> dict[str, float]:
        """The best values for runs that begin where ticks are `fresh`."""
        directions = np.zeros((len(self.free), len(self.mover.model.names)))
        directions[np.arange(len(self.free)), self.index] = self.scale
        lower = np.array([f.lower for f in self.free.values()])
        upper = np.array([f.upper for f in self.free.values()])
        values = dict(values)
        for _ in range(CALLS):
            at = self.mover.vector(values)
            own = at[self.index]
            # In units of what is left, so that a fit ends where it gains no more of it.
            (left,) = costs_of(self.mover, [values], self.course, self.course.settling)
            fit = fit_follow(
                self.mover.model,
                jnp.asarray(at),
                jnp.asarray(directions),
                self.course,
                jnp.asarray(fresh),
                jnp.asarray(min(left, 1.0) * _sizes(self.course)),
                self._prior(values),
                (
                    jnp.asarray((lower - own) / self.scale),
                    jnp.asarray((upper - own) / self.scale),
                ),
            )
            moved = own + np.asarray(fit.at) * self.scale
            if not np.isfinite(moved).all():
                break
            values |= zip(self.free, np.clip(moved, lower, upper).tolist(), strict=True)
            if bool(fit.converged):
                break
        return values

    def _prior(self, values: Values) -> tuple[Float[Array, "k"], Float[Array, "k"]]:
        """What is known beforehand, in units of the scales from `values`, and what an
        error of one such unit counts. A second of a log counts as one reading, since
        what a model leaves of a run is correlated.
        """
        free = list(self.free.values())
        known = np.array([f.start if f.prior else 0.0 for f in free])
        spread = np.array([f.prior or np.inf for f in free])
        ticks = np.sum(np.asarray(self.course.there) > 0)
        step = np.median(np.diff(np.asarray(self.course.t), axis=1))
        weight = np.sqrt(ticks / max(ticks * step, 1.0))
        off = known - np.array([values[name] for name in self.free])
        return jnp.asarray(off / self.scale), jnp.asarray(weight * self.scale / spread)


def _sizes(course: Course) -> Float[np.ndarray, "4"]:
    """What errors are divided by, SI: each signal's standard deviation; inf where it
    was not measured. Not its noise: most of what a model leaves of a machine is not.
    """
    there = np.asarray(course.there) > 0
    spread = np.std(np.asarray(course.measured)[there], axis=0)
    return np.where(np.isfinite(spread) & (spread > 0), spread, np.inf)


def searched(
    mover: Mover, found: Values, free: Mapping[str, Free], course: Course
) -> list[dict[str, float]]:
    """Where to begin with a load of which no window tells anything, nor all that was
    found without it: the two best of many fits to the head of the logs.

    Starts are drawn about the rig file's, and ranked by runs of a second; the best are
    fitted, and so are starts about the best of these.
    """
    course, rng = course.head(HEAD), np.random.default_rng(0)
    about = {name: f.start for name, f in free.items()}
    drawn = [dict(found), dict(found) | about]
    drawn += [dict(found) | _near(about, free, WIDE, rng) for _ in range(DRAWN)]
    runs = runs_through(course)
    ranks = np.argsort(costs_of(mover, drawn, course, runs.get("1", runs["free"])))
    best = refined(mover, [drawn[i] for i in ranks[:FITTED]], free, course)[:2]
    for _ in range(ROUNDS):
        near = [best[i % 2] for i in range(NEAR)]
        near = [values | _near(values, free, NARROW, rng) for values in near]
        best = refined(mover, [*best, *near], free, course)[:2]
    return best


def _near(
    values: Values, free: Mapping[str, Free], spread: float, rng: np.random.Generator
) -> dict[str, float]:
    """Values of what is free about some others, inside their ranges."""
    factors = np.exp(spread * rng.standard_normal(len(free)))
    return {
        name: float(np.clip(values[name] * factor, f.lower, f.upper))
        for (name, f), factor in zip(free.items(), factors, strict=True)
    }
