"""What a missing effect would explain: scores, powers and look-alikes from the sums.

All from the windows' Gram matrices at one point, with every candidate present at zero
strength: columns are projected off all fitted parameters, windows are the clusters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import stats


@dataclass(frozen=True)
class Score:
    """One candidate at zero strength, before any refit.

    `gain`: fall of chi-square that a linear step along it would bring, with all fitted
    parameters free to follow; `step`: that step, in units of the columns; `p_value`:
    of the cluster-robust score test, for this candidate alone; `power`: the chance
    that the test would have seen the effect at a size that matters; `shape`: the values
    of its shape at which it was scored; `share`: the gain over all of chi-square;
    `power_at_noise`: the power were the residual at its noise.
    """

    name: str
    gain: float
    step: np.ndarray
    p_value: float
    power: float
    share: float
    power_at_noise: float
    shape: Mapping[str, float] = field(default_factory=dict)


class Projection:
    """The Gram matrices [W, n+1, n+1] with the fitted columns projected out."""

    def __init__(self, gram: np.ndarray, fitted: Sequence[int], prior: np.ndarray):
        total = gram.sum(axis=0)
        total[np.arange(prior.size), np.arange(prior.size)] += prior**2
        A = total[np.ix_(fitted, fitted)]
        size = np.sqrt(np.maximum(np.diag(A), 1e-300))
        # Scaled first: parameters that no column distinguishes share what they can.
        inverse = np.linalg.pinv(A / np.outer(size, size), rcond=1e-12, hermitian=True)
        self.through = inverse / np.outer(size, size) @ total[fitted]
        self.gram, self.fitted, self.total = gram, list(fitted), total
        r = total.shape[0] - 1
        self.left = float(self.curvature([r], [r])[0, 0])

    def curvature(self, a: Sequence[int], b: Sequence[int]) -> np.ndarray:
        """Products of the projected columns `a` and `b`."""
        f = self.total[np.ix_(self.fitted, b)]
        return self.total[np.ix_(a, b)] - self.through[:, a].T @ f

    def scores(self, a: Sequence[int]) -> np.ndarray:
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
    ends: np.ndarray,
    matters: float,
    level: float,
) -> Score:
    """Score one candidate.

    Args:
        projection: of the fitted columns.
        name: the candidate's.
        columns: of its strengths.
        ends: [columns, 2] range of the strengths, in units of the columns.
        matters: chi-square by which an effect that matters changes the residual.
        level: significance at which it would be seen.
    """
    H = projection.curvature(columns, columns)
    own = projection.total[columns, columns]
    if np.all(np.diag(H) <= 1e-9 * np.maximum(own, 1e-300)):
        return Score(name, 0.0, np.zeros(len(columns)), 1.0, 0.0, 0.0, 0.0)
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
    share = gain / projection.left
    at_noise = _power(H, H, reach, matters, level)
    return Score(name, gain, step, p, power, share, at_noise)


def _power(H, spread, reach, matters, level) -> float:
    """Power of the test at a strength that changes the residual by `matters`."""
    best = int(np.argmax(np.diag(H) * reach**2))
    h = H[best, best]
    strength = min(np.sqrt(matters / h), reach[best])
    noncentral = strength**2 * h**2 / spread[best, best]
    threshold = stats.chi2.isf(level, len(H))
    return float(stats.ncx2.sf(threshold, len(H), noncentral))


def family(p_values: Mapping[str, float]) -> dict[str, float]:
    """Family-wise p-values of several candidates, by Holm's method."""
    names = sorted(p_values, key=lambda n: p_values[n])
    out, highest = {}, 0.0
    for i, name in enumerate(names):
        highest = max(highest, min(1.0, (len(names) - i) * p_values[name]))
        out[name] = highest
    return out
