"""What a missing effect would explain: scores, powers and look-alikes from the sums.

All from the windows' Gram matrices at one point, with every candidate present at zero
strength: columns are projected off all fitted parameters, windows are the clusters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy import stats

from hydrojax.identify.tracing.criteria import Criteria


@dataclass(frozen=True)
class Score:
    """One candidate at zero strength, before any refit.

    Attributes:
        name: the candidate's.
        gain: fall of chi-square that a linear step along it would bring, with all
            fitted parameters free to follow.
        step: that step, in units of the columns.
        p_value: of the cluster-robust score test, for this candidate alone.
        power: the chance that the test would have seen the effect at a size that
            matters.
        left: chi-square before the step.
        power_at_noise: the power were the residual at its noise.
        shape: the values of its shape at which it was scored.
        by_window: the windows' scores, of which the test is the sum.
        starts: values of all parameters from which it may be fitted where its strength
            is far from zero, the best first.
        far: whether the gain is that of the first of these.
    """

    name: str
    gain: float
    step: Float[np.ndarray, "columns"]
    p_value: float
    power: float
    left: float
    power_at_noise: float
    shape: Mapping[str, float] = field(default_factory=dict)
    by_window: Float[np.ndarray, "windows columns"] = field(
        default_factory=lambda: np.zeros((0, 0))
    )
    starts: tuple[Float[np.ndarray, "n"], ...] = ()
    far: bool = False

    @property
    def share(self) -> float:
        """The gain over all of chi-square."""
        return self.gain / self.left if self.left > 0.0 else 0.0


class Projection:
    """The windows' Gram matrices with the fitted columns projected out."""

    def __init__(
        self,
        gram: Float[np.ndarray, "windows rows rows"],
        fitted: Sequence[int],
        prior: Float[np.ndarray, "n"],
    ):
        total = gram.sum(axis=0)
        total[np.arange(prior.size), np.arange(prior.size)] += prior**2
        self.gram, self.total, self.prior = gram, total, prior
        self.fitted = list(fitted)
        A = total[np.ix_(fitted, fitted)]
        size = np.sqrt(np.maximum(np.diag(A), 1e-300))
        # Scaled first: parameters that no column distinguishes share what they can.
        inverse = np.linalg.pinv(A / np.outer(size, size), rcond=1e-12, hermitian=True)
        self.through = inverse / np.outer(size, size) @ total[self.fitted]
        r = total.shape[0] - 1
        self.left = float(self.curvature([r], [r])[0, 0])

    def beside(self, columns: Sequence[int]) -> Projection:
        """The same with more columns fitted, after those that are."""
        return Projection(self.gram, [*self.fitted, *columns], self.prior)

    def curvature(self, a: Sequence[int], b: Sequence[int]) -> Float[np.ndarray, "a b"]:
        """Products of the projected columns `a` and `b`."""
        f = self.total[np.ix_(self.fitted, b)]
        return self.total[np.ix_(a, b)] - self.through[:, a].T @ f

    def scores(self, a: Sequence[int]) -> Float[np.ndarray, "windows a"]:
        """Each window's product of the projected columns `a` with the residual."""
        r = self.gram.shape[1] - 1
        own = self.gram[:, a, r]
        return own - self.gram[:, self.fitted, r] @ self.through[:, a]


def _solid(H: np.ndarray) -> np.ndarray:
    return H + np.diag(1e-9 * np.diag(H) + 1e-300)


def score(
    projection: Projection,
    name: str,
    columns: Sequence[int],
    ends: Float[np.ndarray, "columns 2"],
    matters: float,
    level: float,
) -> Score:
    """Score one candidate.

    Args:
        projection: of the fitted columns.
        name: the candidate's.
        columns: of its strengths.
        ends: range of the strengths, in units of the columns.
        matters: chi-square by which an effect that matters changes the residual.
        level: significance at which it would be seen.
    """
    H = projection.curvature(columns, columns)
    own = projection.total[columns, columns]
    if np.all(np.diag(H) <= 1e-9 * np.maximum(own, 1e-300)):
        none = np.zeros(len(columns))
        return Score(name, 0.0, none, 1.0, 0.0, projection.left, 0.0)
    H = _solid(H)
    reach = np.max(np.abs(ends), axis=1)
    by_window = projection.scores(columns)
    g = by_window.sum(axis=0)
    step = np.clip(-np.linalg.solve(H, g), ends[:, 0], ends[:, 1])
    spread = _solid(by_window.T @ by_window)
    chi2 = float(g @ np.linalg.solve(spread, g))
    p = float(stats.chi2.sf(chi2, len(columns)))
    # Where the range cuts a step short it still gains what the quadratic says; a
    # strength that would have to be negative gains nothing.
    gain = float(max(-2 * g @ step - step @ H @ step, 0.0))
    if gain == 0.0:
        p = 1.0
    power = _power(H, spread, reach, matters, level)
    at_noise = _power(H, H, reach, matters, level)
    left = projection.left
    return Score(name, gain, step, p, power, left, at_noise, by_window=by_window)


def _power(H, spread, reach, matters, level) -> float:
    """Power of the test at a strength that changes the residual by `matters`."""
    best = int(np.argmax(np.diag(H) * reach**2))
    h = H[best, best]
    strength = min(np.sqrt(matters / h), reach[best])
    noncentral = strength**2 * h**2 / spread[best, best]
    threshold = stats.chi2.isf(level, len(H))
    return float(stats.ncx2.sf(threshold, len(H), noncentral))


def worth_a_refit(p_value: float, s: Score, criteria: Criteria) -> bool:
    """Whether a candidate's score is significant, by its family-wise `p_value`, or
    large whatever that is.
    """
    return p_value < criteria.level or s.share > criteria.promising


def family(
    scores: Mapping[str, Score], criteria: Criteria = Criteria()
) -> dict[str, float]:
    """Family-wise p-values of several candidates, by the maximum statistic.

    Candidates look alike, so the smallest of their p-values is not that of so many
    independent tests. Its distribution is simulated: each draw turns the sign of every
    window's scores at random, all candidates' together (a wild bootstrap with windows
    as clusters). Beyond what the draws resolve, as many independent tests are taken as
    the lowest draws (`criteria.tail`) stand for.
    """
    tested = {n: s for n, s in scores.items() if s.by_window.size and s.p_value < 1.0}
    if not tested:
        return dict.fromkeys(scores, 1.0)
    least = np.ones(criteria.draws)
    windows = len(next(iter(tested.values())).by_window)
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (criteria.draws, windows))
    for s in tested.values():
        # The effect itself is taken out: the draws are of chance alone.
        own = s.by_window - s.by_window.mean(axis=0)
        spread = _solid(own.T @ own)
        drawn = signs @ own
        chi2 = np.sum(drawn * np.linalg.solve(spread, drawn.T).T, axis=1)
        least = np.minimum(least, stats.chi2.sf(chi2, own.shape[1]))
    tail = min(max(float(np.quantile(least, criteria.tail)), 1e-300), 1 - 1e-16)
    tests = np.log1p(-criteria.tail) / np.log1p(-tail)
    out = dict.fromkeys(scores, 1.0)
    for name, s in tested.items():
        p = s.p_value
        counted = float(np.mean(least <= p))
        beyond = float(-np.expm1(tests * np.log1p(-min(p, 1 - 1e-16))))
        out[name] = (
            max(counted, p) if counted > criteria.counted_above else max(beyond, p)
        )
    return out
