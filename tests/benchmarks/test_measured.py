"""The models beside hydrojax: right on systems of which they are the truth."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.measured.peers import predicted
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


def rubbing(P: float, coulomb: float, seed: int) -> Run:
    """A seal at one pressure, whose Coulomb friction sets in within 0.1 of a unit."""
    t = np.arange(3000) * 0.01
    x = 5 * np.sin(0.7 * t + seed) + 3 * np.sin(1.9 * t)
    v = np.gradient(x, t)
    stuck = np.zeros_like(x)
    for i, moved in enumerate(np.diff(x), start=1):
        stuck[i] = min(max(stuck[i - 1] + moved, -0.1), 0.1)
    friction = coulomb * stuck / 0.1 + 0.4 * np.where(v > 0, v, 2 * v)
    return Run(t, np.column_stack([x, v, np.full_like(t, P)]), 50 * P + friction)


def test_a_regression_of_each_run_takes_that_of_the_same_pressure():
    fit = [rubbing(1.0, 3.0, 1), rubbing(5.0, 9.0, 2)]
    judged = [rubbing(5.02, 9.0, 3), rubbing(0.99, 3.0, 4)]
    error, _ = predicted("regression of each run", fit, judged)
    assert error < 1.5  # 50 times the 0.02 by which pressures differ, and the reach
    swapped = [rubbing(5.0, 3.0, 3), rubbing(1.0, 9.0, 4)]
    worse, _ = predicted("regression of each run", fit, swapped)
    assert worse > 3 * error


@pytest.mark.slow
@pytest.mark.parametrize("name", ["subspace (N4SID)", "NARX (SysIdentPy)"])
def test_the_others_are_near_on_a_linear_system(name):
    package = {"subspace (N4SID)": "nfoursid"}.get(name, "sysidentpy")
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"needs {package}")
    error, _ = predicted(name, [linear(1, 0.01), linear(2, 0.01)], [linear(3)])
    assert error < 0.05 * np.std(linear(3).y)


def test_uneven_times_are_made_even_and_a_repeated_one_is_dropped(tmp_path):
    folder = tmp_path / SETS["KDN seal"].folder
    folder.mkdir()
    t = np.cumsum(np.random.default_rng(0).choice([0.008, 0.012, 0.02], 400))
    t = np.r_[t[:200], t[199], t[200:]]
    table = np.stack([t, 5.0 * t, 2.0 + 0.1 * t, 3.0 * t], axis=1)
    header = "time [s],x [mm],P_a2 [bar],F [N]"
    path = folder / "fit_1bar.csv"
    np.savetxt(path, table, delimiter=",", header=header, comments="")
    (run,) = SETS["KDN seal"].read(tmp_path, "fit")
    assert np.allclose(np.diff(run.t), 0.01)
    assert np.allclose(run.u[:, 0], 5.0 * run.t) and np.allclose(run.y, 3.0 * run.t)
    assert np.allclose(run.u[:, 1], 5.0, rtol=1e-6)  # the speed of a straight motion


def test_the_half_of_the_arm_that_counts_is_not_the_one_fitted(tmp_path):
    folder = tmp_path / SETS["robot arm"].folder
    folder.mkdir()
    table = np.arange(3072.0).reshape(1024, 3)
    np.savetxt(folder / "log.csv", table, delimiter=",", header="u,p,x", comments="")
    (fit,), (judged,) = (SETS["robot arm"].read(tmp_path, p) for p in ("fit", "check"))
    assert fit.y.max() < judged.y[judged.first :].min()
