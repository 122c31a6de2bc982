"""B-splines of curves against SciPy's."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from hydrojax.effects import curve
from hydrojax.effects.splines import bspline, knots_over


@pytest.fixture
def samples() -> np.ndarray:
    return np.random.default_rng(0).normal(0.0, 0.01, 5000) ** 3


@pytest.mark.parametrize("count", [4, 9, 14])
def test_splines_are_scipys(samples, count):
    knots = knots_over(samples, count)
    s = np.r_[np.linspace(knots[0], knots[-1], 301), knots]
    want = BSpline.design_matrix(s, knots, 3).toarray()
    np.testing.assert_allclose(bspline(s, knots), want, atol=1e-12)


def test_a_curve_is_held_beyond_its_ends(samples):
    knots = knots_over(samples, 9)
    c = np.random.default_rng(1).normal(size=9)
    span = knots[-1] - knots[0]
    ends = curve(np.array([knots[0] - span, knots[-1] + span]), knots, c)
    np.testing.assert_allclose(ends, c[[0, -1]], rtol=1e-12)


def test_knots_are_close_where_samples_are(samples):
    knots = np.unique(knots_over(samples, 14))
    gaps = np.diff(knots)
    middle = gaps[np.argmin(np.abs(knots[:-1]))]
    assert middle < 0.8 * gaps.max()
    assert gaps.min() > np.ptp(knots) / len(gaps) / 2
