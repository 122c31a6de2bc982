"""How smooth a curve is, what it gains, and its band: from sums of projected columns.

`H` are the products of a curve's columns, whitened and projected off the sensitivities
of all that is fitted; `g` their products with the residual, where all coefficients are
zero (the sign as in `tracing.score`: chi-square is `left + 2 g c + c H c`). A curve is
thereby what the rig's own parameters cannot follow (as Gyorok, Schoukens, Peni and
Toth, arXiv 2511.01321), and these keep their meaning.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hydrojax.identify.tracing.score import Projection

OWN = 1e-3
"""Share of its columns' squares with which a curve is drawn to zero: what the rig's
parameters follow to that degree is theirs."""

TOLD = 0.02
"""Share of a direction's squares that must be left by the projection for the direction
to be the curve's own, 1."""

HIDDEN = 2.0
"""What the fitted parameters have taken of a curve, over what is seen of it, as a
standard deviation: a line has nearly four times as much of `v abs(v)` as is left."""

TRIED = np.logspace(-6, 6, 49)
"""Smoothing parameters that are tried, over the ratio of curvature and penalty."""


@dataclass(frozen=True)
class Columns:
    """Sums of a curve's columns.

    Attributes:
        H: products of the projected columns.
        whole: the same before they were projected.
        g: products of the projected columns with the residual at zero coefficients.
        by_window: each window's part of `g` where the fit stands.
        inflation: variance of the scores over that of white residuals, 1.
        left: chi-square where the fit stands.
    """

    H: Float[np.ndarray, "k k"]
    whole: Float[np.ndarray, "k k"]
    g: Float[np.ndarray, "k"]
    by_window: Float[np.ndarray, "windows k"]
    inflation: float
    left: float

    @classmethod
    def of(
        cls,
        projection: Projection,
        columns: list[int],
        at: Float[np.ndarray, "k"] | float = 0.0,
    ) -> Columns:
        """The sums of `columns`, whose coefficients stand `at` in the projection."""
        H = projection.curvature(columns, columns)
        H = (H + H.T) / 2
        whole = projection.total[np.ix_(columns, columns)]
        scores = projection.scores(columns)
        g = scores.sum(axis=0) - H @ (np.zeros(len(columns)) + at)
        own = directions(H, whole)
        apart = (scores - scores.mean(axis=0)) @ own
        H_own = np.diag(own.T @ H @ own)
        ratio = np.sum(apart**2, axis=0) / np.maximum(H_own, 1e-300)
        inflation = float(np.mean(ratio)) if own.shape[1] else 1.0
        return cls(H, whole, g, scores, max(inflation, 1.0), projection.left)


def directions(
    H: Float[np.ndarray, "k k"], whole: Float[np.ndarray, "k k"]
) -> Float[np.ndarray, "k own"]:
    """The directions that are the curve's own: orthogonal in both products."""
    size = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    seen = size > 1e-6 * size.max()
    scaled = whole[np.ix_(seen, seen)] / np.outer(size[seen], size[seen])
    values, vectors = np.linalg.eigh(scaled)
    keep = values > 1e-8 * values[-1]
    root = vectors[:, keep] / np.sqrt(values[keep]) / size[seen, None]
    left, turned = np.linalg.eigh(root.T @ H[np.ix_(seen, seen)] @ root)
    out = np.zeros((len(H), int(np.sum(left > TOLD))))
    out[seen] = root @ turned[:, left > TOLD]
    return out


def roughness(knots: Float[np.ndarray, "k+4"]) -> Float[np.ndarray, "k k"]:
    """The penalty of P-splines (Eilers and Marx): squares of by how much the slope of
    the coefficients turns, each over the mean of three knots; over even knots, of their
    second differences.

    A line is not rough, and a corner as rough as it is sharp, however close the knots
    there are (Li and Cao, 2022: second differences would bend a line over knots that
    are not even).
    """
    gaps = np.diff(signal_in(knots))
    gaps = np.maximum(gaps, 1e-9 * np.mean(gaps)) / np.mean(gaps)
    D = np.diff(np.diff(np.eye(len(gaps) + 1), axis=0) / gaps[:, None], axis=0)
    return D.T @ D


def signal_in(knots: Float[np.ndarray, "k+4"]) -> Float[np.ndarray, "k"]:
    """Coefficients with which the splines are the signal itself, in its unit: means of
    three knots.
    """
    return (knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3


@dataclass(frozen=True)
class Smooth:
    """A curve's smoothing.

    Attributes:
        penalty: matrix that is added to `H`.
        rough: the part of it by roughness.
        c: the coefficients that it gives, to first order.
        gain: fall of chi-square with them.
        degrees: effective degrees of freedom.
    """

    penalty: Float[np.ndarray, "k k"]
    rough: Float[np.ndarray, "k k"]
    c: Float[np.ndarray, "k"]
    gain: float
    degrees: float


def smoothed(columns: Columns, knots: Float[np.ndarray, "k+4"]) -> Smooth:
    """The curve over `knots` whose smoothing has the largest restricted likelihood
    (REML).

    The likelihood is that of a Gaussian prior of the roughness, with the coefficients
    integrated out; the noise of the sums is that of their windows, `inflation` times
    that of white residuals.
    """
    H, g, k = columns.H, columns.g, len(columns.g)
    # Where no sample lies only the penalty holds a coefficient.
    typical = np.trace(columns.whole) / k
    ridge = OWN * columns.whole + 1e-9 * typical * np.eye(k)
    rough, noise = roughness(knots), columns.inflation
    # Of a typical coefficient: where knots are close the penalty is far larger.
    ratio = np.trace(H) / k / np.median(np.diag(rough))
    best, out = -np.inf, None
    for tried in TRIED * max(ratio, 1e-300):
        penalty = tried * rough + ridge
        A = H + penalty
        c = -np.linalg.solve(A, g)
        likelihood = (
            np.linalg.slogdet(penalty)[1]
            - np.linalg.slogdet(A)[1]
            - float(g @ c) / noise
        )
        if likelihood > best:
            gain = -float(2 * g @ c + c @ H @ c)
            degrees = float(np.trace(np.linalg.solve(A, H)))
            best, out = likelihood, Smooth(penalty, tried * rough, c, gain, degrees)
    assert out is not None
    return out


def covariance(
    columns: Columns, smooth: Smooth
) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, "k k"]]:
    """Covariance of the coefficients, and what takes from them the curve's own part.

    Bayesian, smoothing as the prior: such bands hold over the whole curve (Nychka,
    1988); of the directions that are the curve's own.
    """
    own = directions(columns.H, columns.whole)
    part = own @ own.T @ columns.whole
    V = columns.inflation * np.linalg.inv(columns.H + smooth.penalty)
    return part @ V @ part.T, part


def pull(
    columns: Columns,
    smooth: Smooth,
    c: Float[np.ndarray, "k"],
    line: Float[np.ndarray, "k"],
) -> Float[np.ndarray, "k k"]:
    """Covariance of the gradient by which its penalties draw a curve off the truth, and
    with it what is fitted beside it.

    A curve of coefficients `c` shows what the fitted parameters cannot follow; the rest
    of the truth is in these, and no log tells how large it is. It is taken to be
    `HIDDEN` times what is seen, as rough as that, and as far from zero as a line of the
    curve's slope through zero is where the signal is: `line` are the coefficients of
    the signal itself. A level that rises with pressure has risen from none.
    """
    W, noise, k = columns.whole, columns.inflation, len(c)
    size = max(HIDDEN**2 * float(c @ W @ c), noise)
    nowhere = 1e-9 * np.trace(W) / k * np.eye(k)
    truth = noise * np.linalg.inv(smooth.rough + noise / size * (W + nowhere))
    apart = line - np.sum(W @ line) / max(np.sum(W), 1e-300)
    slope = float(apart @ W @ c) / max(float(apart @ W @ apart), 1e-300)
    truth = truth + slope**2 * np.outer(line, line)
    return smooth.penalty @ truth @ smooth.penalty


def band(
    columns: Columns,
    smooth: Smooth,
    basis: Float[np.ndarray, "points k"],
    above: float,
) -> Float[np.ndarray, "points"]:
    """Standard deviation of a curve's own part where its splines are `basis`, in the
    unit of its coefficients.

    That of the coefficients, and that of what splines so far apart do not follow:
    `above` is chi-square above the noise, as if all of it were an error of the curve,
    of one size everywhere.
    """
    V, _ = covariance(columns, smooth)
    # The splines add up to one: so much does a curve of size 1 move the readings.
    rest = above / max(float(np.sum(columns.whole)), 1e-300)
    return np.sqrt(np.maximum(np.sum(basis @ V * basis, axis=1), 0.0) + rest)
