"""Profile likelihood: against scipy on a valley with a bend, and on a log."""

from typing import Any

import numpy as np
import pytest
from scipy import optimize, stats

from hydrojax.identify import api
from hydrojax.identify.case import open_case
from hydrojax.identify.inference.profile import _end, profiles
from hydrojax.identify.inference.uncertainty import Uncertainty, estimate_uncertainty
from hydrojax.identify.tracing.criteria import Criteria
from tests import generator

LEVEL = float(stats.chi2.isf(0.05, 1))


class Valley:
    """Stands in for a `Problem`: chi-square of two parameters, one of them bent."""

    criteria = Criteria()

    class model:
        names = ("a", "b")
        scale = np.array([1.0, 1.0])

    def __init__(self):
        from hydrojax.identify.estimation.known import Free

        self.free = {"a": Free(0.5, 0.0, 4.0), "b": Free(0.0, -50.0, 50.0)}

    @staticmethod
    def chi2(a, b):
        return (np.exp(a) - np.e) ** 2 / 0.5 + (b - a**2) ** 2 / 0.01

    def solve(self, values, names, weights=None):
        at = values.copy()
        assert names == ("b",)
        found: Any = optimize.minimize_scalar(lambda b: self.chi2(at[0], b))
        at[1] = found.x
        out = type("Fit", (), {"cost": self.chi2(*at) / 2})
        return at, out


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_ends_are_where_chi_square_has_risen(side):
    """Against the root of the profile by scipy: the interval is not symmetric."""
    valley, best = Valley(), np.array([1.0, 1.0])
    point = type("Point", (), {"weights": None})
    end = _end(valley, best, point, ("a", "b"), "a", side * 0.2, 0.0, LEVEL)

    def off(a):
        return (np.exp(a) - np.e) ** 2 / 0.5 - LEVEL

    want = optimize.brentq(off, *((0.0, 1.0) if side < 0 else (1.0, 4.0)))
    assert end == pytest.approx(want, abs=0.03 * abs(want - 1.0) + 1e-3)


def test_a_range_that_ends_first_is_the_end():
    valley, best = Valley(), np.array([1.0, 1.0])
    valley.free["a"] = type(valley.free["a"])(0.5, 0.9, 4.0)
    point = type("Point", (), {"weights": None})
    assert _end(valley, best, point, ("a", "b"), "a", -0.2, 0.0, LEVEL) == 0.9


class Mean:
    """Stands in for a `Problem`: the mean of readings whose noise is known."""

    criteria = Criteria()
    known = None

    class model:
        names = ("a",)
        scale = np.array([1.0])

    def __init__(self, y, sigma):
        from hydrojax.identify.estimation.known import Free

        self.y, self.sigma = y, sigma
        self.free = {"a": Free(0.0, -50.0, 50.0)}

    def solve(self, values, names, weights=None):
        at = np.array([self.y.mean()]) if names else values
        r = (self.y - at[0]) / self.sigma
        return at, type("Fit", (), {"cost": r @ r / 2})

    def sums_at(self, values, weights):
        rows = np.stack([0 * self.y - 1, self.y - values[0]], axis=1) / self.sigma
        return type("Sums", (), {"gram": (rows.T @ rows)[None]})


@pytest.mark.parametrize("wider", [1.0, 2.0])
def test_the_interval_of_a_mean_is_that_of_95_percent(wider):
    """Against the normal distribution; `wider` is what clustered windows made of it."""
    y, sigma = np.random.default_rng(4).normal(3.0, 0.5, 25), 0.5
    std, at = wider * sigma / 5, np.array([y.mean()])
    point = type("Point", (), {"values": at, "weights": None})
    uncertainty = Uncertainty(
        {"a": std}, frozenset(), (), (), ("a",), np.array([[std**2]])
    )
    found = profiles(Mean(y, sigma), point, ("a",), uncertainty)
    want = stats.norm.interval(0.95, y.mean(), std)
    np.testing.assert_allclose(found["a"], want, rtol=1e-9)


@pytest.mark.slow
def test_a_log_gives_intervals_like_its_covariance(tmp_path):
    """Where the fit is nearly linear both agree, and both hold the truth mostly."""
    import json

    generator.write_case(tmp_path, 5, seconds=5.0, nominal_error=0.1)
    logs = [tmp_path / "fit_1.csv", tmp_path / "fit_2.csv"]
    state = api.fit_case(open_case(tmp_path / "rig.toml", logs), 1)
    few = ("beta", "c_p1", "k_cp", "k_fp")
    uncertainty = estimate_uncertainty(state.problem, state.point, state.free)
    # Only these are walked; the others follow all the same.
    found = profiles(state.problem, state.point, state.free, uncertainty, walk=few)
    truth = json.loads((tmp_path / "truth.json").read_text())["rig"]
    held = 0
    for name in few:
        low, high = found[name]
        std = uncertainty.std[name]
        assert (high - low) / (2 * 1.96 * std) == pytest.approx(1.0, abs=0.35)
        held += low < truth[name] < high
    assert held >= 3
