"""The regressions of `check`, against NumPy's and SciPy's own least squares."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from hydrojax.identify.checking.regression import Table, solved

NAMES = ("a", "b", "c", "d")


def table(alike: float) -> Table:
    """Columns sixteen decades apart in size, two of which differ by `alike`."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(400, 4))
    X[:, 1] = X[:, 0] + alike * X[:, 1]
    X *= 10.0 ** np.array([-8, 3, 0, 8])
    y = X @ np.array([3e8, 2e-3, -1.0, 5e-9]) + 0.1 * rng.normal(size=400)
    return Table(y, dict(zip(NAMES, X.T, strict=True)))


@pytest.mark.parametrize("alike", [1.0, 1e-3])
def test_it_is_least_squares(alike):
    own = table(alike)
    X = np.stack([own.columns[n] for n in NAMES], axis=1)
    size = np.linalg.norm(X, axis=0)
    wanted = np.linalg.lstsq(X / size, own.y, rcond=None)[0] / size
    found = solved(own, NAMES)
    np.testing.assert_allclose([found.values[n] for n in NAMES], wanted, rtol=1e-6)
    left = own.y - X @ wanted
    np.testing.assert_allclose(found.left, left, atol=1e-6)
    assert found.error == pytest.approx(np.sqrt(np.mean(left**2)))
    spread = np.sqrt(1.5 * np.diag(np.linalg.inv((X / size).T @ (X / size))))
    np.testing.assert_allclose(
        [found.std[n] for n in NAMES], found.error * spread / size, rtol=1e-5
    )


def test_what_cannot_be_negative_is_not():
    own = table(1.0)
    X = np.stack([own.columns[n] for n in NAMES], axis=1)
    size = np.linalg.norm(X, axis=0)
    low = [-np.inf, -np.inf, 0.0, 0.0]
    wanted = lsq_linear(X / size, own.y, (low, np.inf), tol=1e-14).x / size
    found = solved(own, NAMES, ("c", "d"))
    assert found.values["c"] == 0.0
    np.testing.assert_allclose(
        [found.values[n] for n in NAMES], wanted, rtol=1e-4, atol=1e-12
    )


def test_columns_that_are_one_are_given_one_answer():
    """Or nothing at all."""
    twice = Table(np.ones(50), {"a": np.ones(50), "b": np.ones(50)})
    found = solved(twice, ("a", "b"))
    assert found.values["a"] == found.values["b"] == pytest.approx(0.5)
    nothing = Table(np.ones(50), {"a": np.zeros(50), "b": np.zeros(50)})
    for not_negative in ((), ("a",)):
        assert solved(nothing, ("a", "b"), not_negative).values == {"a": 0.0, "b": 0.0}
