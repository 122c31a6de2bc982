"""Windows' sums of products, against least squares that NumPy solves."""

from __future__ import annotations

from typing import NamedTuple, cast

import jax.numpy as jnp
import numpy as np

from hydrojax.identify.estimation.columns import NUISANCE, Batch
from hydrojax.identify.estimation.misfit import _own_prior, _sums

WINDOWS, TICKS, K = 5, 40, 3
NOISE = np.array([2.0, 3.0, 0.5])


class Measured(NamedTuple):
    """The windows of a batch, of which sums need the measured values alone."""

    measured: np.ndarray


class Given(NamedTuple):
    """A batch, as far as sums need it."""

    windows: Measured
    noise: np.ndarray
    weight: np.ndarray


def drawn() -> tuple[Given, np.ndarray, np.ndarray]:
    """Measured values, predictions, and derivatives of size 1."""
    rng = np.random.default_rng(3)
    measured, y = rng.standard_normal((2, WINDOWS, TICKS, 3))
    dy = rng.standard_normal((K + NUISANCE, WINDOWS, TICKS, 3))
    return Given(Measured(measured), NOISE, np.ones(WINDOWS)), y, dy


def projected(given: Given, y, dy, w: int) -> np.ndarray:
    """Products of a window's columns, what it has of its own projected out by QR."""
    rows = np.concatenate([-dy[:, w], (given.windows.measured[w] - y[w])[None]])
    rows = (rows / NOISE).reshape(len(rows), -1).T
    prior = np.linalg.cholesky(np.asarray(_own_prior(1 / NOISE))).T
    own = np.concatenate([rows[:, K : K + NUISANCE], prior])
    rest = np.delete(rows, np.s_[K : K + NUISANCE], axis=1)
    rest = np.concatenate([rest, np.zeros((NUISANCE, K + 1))])
    q, _ = np.linalg.qr(own)
    rest = rest - q @ (q.T @ rest)
    return rest.T @ rest


def test_what_a_window_has_of_its_own_is_projected_out():
    given, y, dy = drawn()
    gram = np.asarray(_sums(cast("Batch", given), jnp.asarray(y), jnp.asarray(dy)).gram)
    for w in range(WINDOWS):
        np.testing.assert_allclose(gram[w], projected(given, y, dy, w), rtol=1e-9)


def test_a_run_that_runs_away_says_nothing_of_the_parameters():
    """Its derivatives are 1e13 times those of the others, whose digits they took; the
    residual stays, so that no fit seeks such runs.
    """
    given, y, dy = drawn()
    dy[:, 2] *= 1e13
    out = _sums(cast("Batch", given), jnp.asarray(y), jnp.asarray(dy))
    gram = np.asarray(out.gram)
    left = np.sum(((given.windows.measured[2] - y[2]) / NOISE) ** 2)
    wanted = np.zeros((K + 1, K + 1))
    wanted[K, K] = left
    np.testing.assert_allclose(gram[2], wanted, rtol=1e-9)
    for w in (0, 1, 3, 4):
        np.testing.assert_allclose(gram[w], projected(given, y, dy, w), rtol=1e-9)
    assert np.all(np.linalg.eigvalsh(gram.sum(axis=0)) > 0)
    assert np.all(np.asarray(out.start)[2, :, -1] == 0)
