"""Whether an effect helps: validation errors before and after, paired by window."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float
from scipy import stats

from hydrojax.identify.estimation.problem import PRESSURES, Problem
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.identify.tracing.state import Tracing
from hydrojax.parameters import Spec, specs
from hydrojax.plant.effect import Effect
from hydrojax.plant.places import place_of

SHORTEST = 0.01
"""Share of a step of the logs up to which a delay or a time constant is none (seen: 5
us of a valve at 500 Hz, beyond chance)."""


def judge(
    state: Tracing,
    before: Float[np.ndarray, "windows 3"],
    after: Float[np.ndarray, "windows 3"],
    noise: Float[np.ndarray, "3"],
    by: Float[np.ndarray, "3"],
) -> str:
    """Whether an effect helps, from validation errors before and after.

    It must lower some channel's error beyond chance (paired by window, or down to the
    noise; see `_brought_down`) by `matters` of its noise, and either bring that channel
    to its noise or take a fair share of what stood above it; the latter in the force
    only where the pressures are explained. And no channel's error may rise beyond
    chance by more than `by` (see `may_rise`).
    """
    own = state.criteria
    seen = np.isfinite(noise)
    sigma = noise[seen]
    a, b = state.check.rms(after)[seen], state.check.rms(before)[seen]
    sure = _falls(before[:, seen], after[:, seen]) > own.beyond_chance
    sure |= _brought_down(b / sigma, a / sigma, len(after), own)
    helps = sure & (b - a > own.matters * sigma)
    if not helps.any():
        return "too small" if sure.any() else "does not help"
    above = b**2 - sigma**2
    all_of_it = np.ones_like(above)
    share = np.divide(b**2 - a**2, above, out=all_of_it, where=above > 0)
    fair = (a <= own.at_noise * sigma) | (share > own.fair_share)
    upstream = seen & PRESSURES
    if np.any((state.check.rms(after) > own.at_noise * noise) & upstream):
        # What the pressures lack runs on into the force: there only an effect that
        # explains all of it counts, or one that the pressures want themselves.
        fair &= (a <= own.at_noise * sigma) | PRESSURES[seen]
    if not np.any(helps & fair):
        return "explains too little"
    return "spoils another channel" if worsened(state, before, after, by) else "helps"


def _brought_down(
    before: Float[np.ndarray, "c"],
    after: Float[np.ndarray, "c"],
    windows: int,
    own: Criteria,
) -> Float[np.ndarray, "c"]:
    """Channels brought to their noise from above it, by more than noise would; errors
    are RMS over the noise.

    An effect that shows in one window or two (a reversal) has no chance where windows
    are paired: there is no scatter to be had from them. But of noise alone the mean
    square is 1, within `sqrt(2 / windows)` even if no more than one sample of a window
    were independent; and where there are validation logs no fit has seen the fall.
    """
    beyond = (before**2 - after**2) * np.sqrt(windows / 2) > own.beyond_chance
    return (before > own.at_noise) & (after <= own.at_noise) & beyond


def may_rise(
    state: Tracing, effects: Iterable[Effect], noise: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """By how much effects may raise each channel's RMS error, SI; inf where it is not
    compared.

    By what does not matter; less in the pressures where one of the effects acts on
    them and the force is compared too, for which they would be bent.
    """
    own = state.criteria
    upstream = any(place_of(e).shows_in_pressures for e in effects)
    if upstream and state.problem.sees_pressures and np.isfinite(noise[2]):
        return np.where(PRESSURES, own.bends, own.matters) * noise
    return own.matters * noise


def worsened(
    state: Tracing,
    before: Float[np.ndarray, "windows 3"],
    after: Float[np.ndarray, "windows 3"],
    by: Float[np.ndarray, "3"],
) -> bool:
    """Whether any channel's error rose beyond chance by more than `by`."""
    seen = np.isfinite(by)
    rms = (state.check.rms(after) - state.check.rms(before))[seen]
    sure = _falls(after[:, seen], before[:, seen]) > state.criteria.beyond_chance
    return bool(np.any(sure & (rms > by[seen])))


def negligible(
    problem: Problem, values: Float[np.ndarray, "n"], effect: Effect
) -> bool:
    """Whether none of an effect's strengths came out above the least that is it; of a
    time that is a share of a row, for what less does to a log is rounding.
    """
    names = problem.model.names
    row = SHORTEST * float(np.median(np.asarray(problem.batch.windows.h)))

    def least(spec: Spec) -> float:
        return max(spec.minimum, row) if spec.unit == "s" else spec.minimum

    return all(
        abs(values[names.index(f"{effect.name}.{field}")]) <= least(s)
        for field, s in specs(effect).items()
        if s.strength
    )


def _falls(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """By how many standard errors squared errors [W, c] fell, by channel.

    Windows are paired. The fall itself is tested and its logarithm too, and the larger
    counts: an effect that acts in a few windows only (a reversal) makes a fall of few
    large terms, whose mean is uncertain though nearly every one of them is clear.
    """
    small = 1e-12 * np.max(before) + 1e-300
    both = (before - after, np.log((before + small) / (after + small)))
    return np.max(
        [
            d.mean(axis=0) * np.sqrt(len(d)) / np.maximum(d.std(axis=0, ddof=1), 1e-300)
            for d in both
        ],
        axis=0,
    )


def chance(
    before: Float[np.ndarray, "windows 3"],
    after: Float[np.ndarray, "windows 3"],
    noise: Float[np.ndarray, "3"],
) -> float:
    """Chance that errors fell as clearly as they did in their best channel."""
    seen = np.isfinite(noise)
    best = float(np.max(_falls(before[:, seen], after[:, seen])))
    return float(min(2 * seen.sum() * stats.t.sf(best, len(before) - 1), 1.0))


def cost(sse: Float[np.ndarray, "windows 3"], noise: Float[np.ndarray, "3"]) -> float:
    """Chi-square of squared errors over the channels that are seen."""
    seen = np.isfinite(noise)
    return float(np.sum(sse[:, seen] / noise[seen] ** 2))


def worse(
    a: Float[np.ndarray, "windows 3"],
    b: Float[np.ndarray, "windows 3"],
    noise: Float[np.ndarray, "3"],
    criteria: Criteria,
) -> bool:
    """Whether errors `a` exceed `b` beyond chance, paired by window, and by more than
    models of one thing differ in how they are worked out.
    """
    seen = np.isfinite(noise)
    d = np.sum((a - b)[:, seen] / noise[seen] ** 2, axis=1)
    rms_a, rms_b = (np.sqrt(np.sum(e[:, seen], axis=0)) for e in (a, b))
    sure = d.mean() > criteria.worse_by * d.std(ddof=1) / np.sqrt(len(d))
    return bool(sure and np.any(rms_a > (1 + criteria.worse_at_least) * rms_b))


def as_good(
    state: Tracing,
    a: Float[np.ndarray, "windows 3"],
    b: Float[np.ndarray, "windows 3"],
    noise: Float[np.ndarray, "3"],
) -> bool:
    """Whether errors `a` are as good as `b`: not larger beyond chance, and in no
    channel by more than what matters, for which one window may be enough.
    """
    own, rms = state.criteria, state.check.rms
    near = rms(a) <= rms(b) + own.matters * noise
    return bool(np.all(near) and not worse(a, b, noise, own))


def better(
    a: Float[np.ndarray, "windows 3"],
    b: Float[np.ndarray, "windows 3"],
    noise: Float[np.ndarray, "3"],
    by: float,
) -> bool:
    """Whether errors `a` fall below `b` by `by` standard errors, paired by window: in
    their mean over the windows, or in that of their logarithms where the mean falls.
    """
    seen = np.isfinite(noise)
    each = [np.sum(e[:, seen] / noise[seen] ** 2, axis=1)[:, None] for e in (b, a)]
    sure = _falls(*each)[0] > by
    return bool(sure and cost(a, noise) < cost(b, noise))
