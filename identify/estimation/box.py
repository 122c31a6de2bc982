"""Friction over many fits, and the smallest box that holds it: the law's bounds.

The projection of (30) needs bounds of theta_f. Each stretch of time in the logs gives
theta_f once, with the hydraulics held at the fit of all; what scatters between the
stretches beyond their own uncertainty is friction that changes, and the box holds that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Float
from scipy import stats

from hydrojax.errors import InputError
from hydrojax.identify.estimation.fit import FitPoint
from hydrojax.identify.estimation.known import Free
from hydrojax.identify.estimation.problem import Problem
from hydrojax.identify.preparation.data import Data
from hydrojax.plant.friction import Theta

LEAN = 0.3
"""Prior of a stretch's theta_f about the fit of all, in units of its scale: it decides
only what a short stretch does not identify, such as k_cp against k_0."""

LEAST_WINDOWS = 8
"""Windows of a stretch, so that seven parameters are identifiable."""

DRAWS = 20_000


@dataclass(frozen=True)
class FrictionStretch:
    """Friction in one stretch of one log; SI.

    Attributes:
        log: its name.
        start: of the stretch, since the log began, s.
        seconds: its length.
        theta: the friction parameters that are free.
        covariance: of `theta`.
    """

    log: str
    start: float
    seconds: float
    theta: Float[np.ndarray, "n"]
    covariance: Float[np.ndarray, "n n"]


@dataclass(frozen=True)
class Box:
    """The smallest box that holds theta_f at a confidence; SI.

    Attributes:
        names: of the n parameters.
        mean: over the stretches.
        between: covariance of theta_f between stretches, their own uncertainty taken
            out.
        lower: ends of the box.
        upper: ends of the box.
        confidence: that all n are inside, jointly.
    """

    names: tuple[str, ...]
    mean: Float[np.ndarray, "n"]
    between: Float[np.ndarray, "n n"]
    lower: Float[np.ndarray, "n"]
    upper: Float[np.ndarray, "n"]
    confidence: float


def friction_names(problem: Problem) -> tuple[str, ...]:
    """Those of theta_f that the rig file leaves free."""
    return tuple(n for n in Theta._fields if n in problem.free)


def fit_stretches(
    problem: Problem, point: FitPoint, data: Data, logs: Sequence[str], seconds: float
) -> list[FrictionStretch]:
    """Fit theta_f in every stretch of `seconds`, all else held at `point`.

    Args:
        problem: of fitting these logs, at `point`.
        point: the fit of all.
        data: the logs, as they are in `problem`.
        logs: their names.
        seconds: length of a stretch.

    Raises:
        InputError: no friction parameter is free, or no stretch is long enough.
    """
    names = friction_names(problem)
    if not names:
        raise InputError(
            "none of k_cp, k_cn, k_0, k_vp, k_vn, k_fp, k_fn has a range in the rig "
            "file: give one to those whose bounds are wanted"
        )
    w = problem.batch.windows
    window = w.scored * float(np.median(np.asarray(w.h)))
    count = round(seconds / window)
    if count < LEAST_WINDOWS:
        raise InputError(
            f"--stretch {seconds:g}: a fit takes {LEAST_WINDOWS} windows of "
            f"{window:.3g} s at least; give {LEAST_WINDOWS * window:.3g} or more"
        )
    t = np.asarray(w.t)[:, w.x.shape[1] - w.scored]
    out = []
    for i, log in enumerate(logs):
        own = np.flatnonzero(data.log == i)
        for k in range(0, own.size - count + 1, count):
            part = own[k : k + count]
            theta, covariance = _fit(problem, point, names, part)
            out.append(
                FrictionStretch(
                    log, float(t[part[0]]), count * window, theta, covariance
                )
            )
    if len(out) < 2:
        raise InputError(
            f"{', '.join(logs)}: {len(out) or 'no'} stretch of {count * window:.3g} s "
            "is too few to see friction change: give more or longer logs, or a shorter "
            "--stretch"
        )
    return out


def _fit(
    problem: Problem, point: FitPoint, names: tuple[str, ...], part: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """theta_f of some windows, and its covariance."""
    at = [problem.model.names.index(n) for n in names]
    windows = jax.tree.map(lambda a: a[part], problem.batch.windows)
    batch = problem.batch._replace(
        windows=windows,
        P_0=problem.batch.P_0[part],
        weight=problem.batch.weight[part],
    )
    free = dict(problem.free)
    for name, i in zip(names, at, strict=True):
        f, scale = free[name], problem.model.scale[i]
        free[name] = Free(float(point.values[i]), f.lower, f.upper, LEAN * scale)
    alone = replace(problem, batch=batch, free=free)
    values, _ = alone.solve(point.values, names, point.weights)
    gram = np.asarray(alone.sums_at(values, point.weights).gram).sum(axis=0)
    scale = problem.model.scale[at]
    H = gram[np.ix_(at, at)] + np.eye(len(at)) / LEAN**2
    # By curvature: so few windows make no clusters.
    rows = 3 * windows.measured.shape[0] * windows.measured.shape[1]
    noise = max(gram[-1, -1] / rows, 1.0)
    return values[at], np.linalg.inv(H) * noise * np.outer(scale, scale)


def smallest_box(
    names: tuple[str, ...],
    fits: Sequence[FrictionStretch],
    confidence: float,
    limits: Sequence[tuple[float, float]],
) -> Box:
    """The box that holds the next stretch's theta_f at a confidence.

    theta_f is taken as Gaussian between stretches. Its mean and covariance are
    estimated from as many, so the box is cut from a Student distribution, at equal
    numbers of standard deviations on all sides.

    Args:
        names: of the n parameters.
        fits: K stretches.
        confidence: that all n are inside, jointly.
        limits: what each may be at all, SI.
    """
    theta = np.array([f.theta for f in fits])
    count = len(theta)
    mean = theta.mean(axis=0)
    own = np.mean([f.covariance for f in fits], axis=0)
    scatter = np.atleast_2d(np.cov(theta.T))
    between = _positive(scatter - own)
    spread = between * (1 + 1 / count) + own / count
    size = np.sqrt(np.diag(spread))
    shape = spread / np.outer(size, size)
    rng = np.random.default_rng(0)
    draws = stats.multivariate_t(shape=shape, df=count - 1, allow_singular=True).rvs(
        DRAWS, random_state=rng
    )
    reach = np.quantile(np.max(np.abs(draws.reshape(DRAWS, -1)), axis=1), confidence)
    low, high = np.array(limits).T
    return Box(
        names,
        mean,
        between,
        np.clip(mean - reach * size, low, high),
        np.clip(mean + reach * size, low, high),
        confidence,
    )


def _positive(matrix: np.ndarray) -> np.ndarray:
    """The nearest covariance: negative variances, and what goes with them, are none."""
    seen = np.diag(matrix) > 0
    size = np.sqrt(np.where(seen, np.diag(matrix), 1.0))
    both = np.outer(seen, seen)
    values, vectors = np.linalg.eigh(np.where(both, matrix / np.outer(size, size), 0.0))
    return (vectors * np.maximum(values, 0.0)) @ vectors.T * np.outer(size, size) * both
