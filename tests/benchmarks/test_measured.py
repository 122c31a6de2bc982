"""The models beside hydrojax: right on systems of which they are the truth."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.measured.peers import PEERS, predicted
from benchmarks.measured.sets import SETS, Run


def linear(seed: int, noise: float = 0.0, gain: float = 1.0) -> Run:
    """A second-order system under two noises, one of which acts a tick later."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((1500, 2))
    late = np.r_[0.0, u[:-1, 1]]
    y = gain * lfilter([0.0, 0.5], [1.0, -1.6, 0.8], u[:, 0] - 0.3 * late)
    return Run(np.arange(1500.0), u, y + noise * rng.standard_normal(1500))


def test_arx_is_exact_on_a_linear_system():
    error, order = predicted("ARX", [linear(1), linear(2)], [linear(3)])
    assert error < 1e-10
    assert order in (2, 4, 8, 16)


def test_errors_are_in_the_unit_of_the_output():
    one, _ = predicted("ARX", [linear(1, 0.3)], [linear(3, 0.3)])
    ten, _ = predicted("ARX", [linear(1, 3.0, 10.0)], [linear(3, 3.0, 10.0)])
    assert 0.3 < one < 2.0
    assert ten == pytest.approx(10 * one, rel=1e-6)


def test_a_run_that_counts_late_is_judged_late():
    spoiled = linear(3)
    y = spoiled.y.copy()
    y[20:200] += 50.0
    judged = Run(spoiled.t, spoiled.u, y, first=200)
    error, _ = predicted("ARX", [linear(1)], [judged])
    assert error < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize("name", ["subspace (N4SID)", "NARX (SysIdentPy)"])
def test_the_others_are_near_on_a_linear_system(name):
    package = {"subspace (N4SID)": "nfoursid"}.get(name, "sysidentpy")
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"needs {package}")
    error, _ = predicted(name, [linear(1, 0.01), linear(2, 0.01)], [linear(3)])
    assert error < 0.05 * np.std(linear(3).y)


def test_every_set_says_where_it_is_had():
    assert all(s.source and s.task and s.folder for s in SETS.values())
    assert set(PEERS) == {"ARX", "subspace (N4SID)", "NARX (SysIdentPy)", "GRU"}
