"""Errors of longer runs, beside predictors that know no plant.

Truth comes from the log itself, from closed forms, and from the generator's rig: with
nothing missing a run through the whole log stays at the noise.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from hydrojax.identify import api
from hydrojax.identify.case import open_case
from hydrojax.identify.estimation.known import free_parameters
from hydrojax.identify.estimation.problem import Problem
from hydrojax.identify.results.horizons import (
    _Arx,
    _starts,
    beyond_windows,
    drifting,
)
from hydrojax.identify.results.outcome import ChannelErrors, Horizon
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.logs.log import Log
from hydrojax.rigfile.build import build_rig


@pytest.fixture(scope="module")
def outcome(recorded):
    folder = recorded(1)
    logs = [folder / "fit_1.csv", folder / "fit_2.csv"]
    case = open_case(folder / "rig.toml", logs, [folder / "validate.csv"])
    return api.identify(case), case, folder / "validate.csv"


@pytest.mark.slow
def test_a_right_model_runs_through_the_whole_log_at_its_noise(outcome):
    found, _, _ = outcome
    for name, c in found.channels.items():
        assert list(c.horizons) == ["0.25", "1", "5", "free"]
        short = c.horizons["0.25"]
        assert (short.before, short.after) == pytest.approx((c.before, c.after))
        for length, h in c.horizons.items():
            # A run's start is estimated from its first window alone, and its error
            # dies out in some tenths of a second.
            assert h.after < 1.5 * c.noise, (name, length)
            assert h.before > 3 * h.after
            assert h.skill == pytest.approx(1 - (h.after / h.held) ** 2)
    assert found.channels["P_a1"].horizons["free"].skill > 0.99


@pytest.mark.slow
def test_the_held_value_is_the_logs_own(outcome):
    found, case, path = outcome
    log = Log.load(path)
    w = case.check.windows
    first = np.asarray(w.t)[:, w.x.shape[1] - w.scored]
    for name, length in (("P_a1", "0.25"), ("F", "free")):
        y = np.asarray(log.signals[name])
        at = np.searchsorted(log.time - log.time[0], first - 1e-6)
        begins = at if length == "0.25" else np.full_like(at, at[0])
        ticks = np.arange(w.scored)
        error = y[at[:, None] + ticks] - y[begins][:, None]
        expected = np.sqrt(np.mean(error**2))
        held = found.channels[name].horizons[length].held
        assert held == pytest.approx(expected, rel=1e-6)


def windows(seg, first, scored=10):
    measured = np.zeros((len(seg), scored, 3))
    own = SimpleNamespace(
        seg=np.array(seg), first=np.array(first), scored=scored, measured=measured
    )
    return SimpleNamespace(windows=own, P_0=np.zeros((len(seg), 2)))


def test_runs_end_at_gaps_and_where_they_are_full():
    batch = windows([0, 0, 0, 0, 0, 1, 1], [0, 10, 20, 30, 40, 0, 20])
    starts = _starts(batch, 0.5)
    assert list(starts) == ["0.5", "1", "free"]
    begins, used = starts["1"]
    assert begins.tolist() == [0, 0, 2, 2, 4, 5, 6]
    assert used.tolist() == [True, True, True, True, False, False, False]
    assert starts["free"][0].tolist() == [0, 0, 0, 0, 0, 5, 6]


def linear(rng, windows=12, ticks=40):
    """A linear system of order two with one input, cut into windows that adjoin."""
    u = rng.normal(size=windows * ticks)
    y = np.zeros(u.size)
    for t in range(2, u.size):
        y[t] = 1.5 * y[t - 1] - 0.7 * y[t - 2] + 0.3 * u[t - 1] + 0.05
    y, u = (a.reshape(windows, ticks) for a in (1e6 * y, u))
    none = np.zeros((windows, ticks))
    own = SimpleNamespace(
        u=u, x=none, v=none, P_s=none, scored=ticks,
        measured=np.stack([y, none, none], axis=-1),
    )  # fmt: skip
    return SimpleNamespace(windows=own)


def test_an_arx_model_of_a_linear_system_is_that_system():
    rng = np.random.default_rng(0)
    fitted, other = linear(rng), linear(rng)
    arx = _Arx.fit(fitted, np.array([1.0, np.inf, np.inf]))
    y = other.windows.measured[..., 0]
    for begins in (np.arange(12), np.zeros(12, int), np.arange(12) // 4 * 4):
        simulated = arx.simulated(other, begins)[..., 0]
        assert np.max(np.abs(simulated - y)) < 1e-6 * np.std(y)


def test_a_run_that_diverges_has_no_skill():
    assert Horizon(None, None, 1.0, None).skill is None
    assert Horizon(4.0, 2.0, 2.0, 1.0).skill == 0.0


def small_uncertainty(share):
    """As if the logs determined beta to a share of itself, and nothing else is free."""
    std = share * 8.5e8
    return SimpleNamespace(inside=("beta",), covariance=np.array([[std**2]]))


@pytest.mark.slow
def test_a_force_off_over_longer_runs_is_left_unless_the_parameters_may_be(outcome):
    found, case, _ = outcome
    problem = Problem.of(
        build_rig(case.spec), free_parameters(case.spec), case.check, Criteria()
    )
    F = found.channels["F"]
    own = (problem, problem, problem.initial_values(), small_uncertainty(1e-6))

    def left(one, whole, own=own):
        runs = {
            n: Horizon(1.0, None if a is None else a * F.noise, 1.0, None)
            for n, a in (("1", one), ("free", whole))
            if a != 0
        }
        return beyond_windows(*own, runs, 0.25, Criteria())

    assert left(2.0, 2.0) == pytest.approx(np.sqrt(3) * F.noise)
    assert left(2.0, 1.6) == pytest.approx(np.sqrt(1.6**2 - 1) * F.noise)
    for runs in ((1.2, 2.0), (2.0, 1.2), (2.0, 0), (0, 0), (None, None)):
        assert left(*runs) is None
    none = SimpleNamespace(inside=(), covariance=np.zeros((0, 0)))
    assert left(2.0, 2.0, (*own[:3], none)) == pytest.approx(np.sqrt(3) * F.noise)
    unknown = SimpleNamespace(inside=("beta",), covariance=np.array([[np.nan]]))
    assert left(2.0, 2.0, (*own[:3], unknown)) is None
    loose = (*own[:3], small_uncertainty(0.3))
    assert left(1.4, 1.4, loose) is None and left(1.4, 1.4) is not None


def test_a_pressure_that_drifts_is_said_with_what_to_do():
    def channel(free, unit="Pa"):
        whole = Horizon(2.0, free, 1.0, None)
        return ChannelErrors(unit, 1.0, 2.0, 1.5, horizons={"free": whole})

    channels = {"P_a1": channel(2.5), "P_a2": channel(0.1), "F": channel(3.0, "N")}
    (line,) = drifting(channels, "unknown", 0.25, Criteria())
    assert "P_a1 has skill -5.250" in line and "--horizon 3" in line
    assert "P_a2" not in line and "F has" not in line
    assert drifting(channels, "explained", 0.25, Criteria()) == []
    assert drifting(channels, "unknown", 3.0, Criteria()) == []
    assert (
        "P_a1 has skill –"
        in drifting({"P_a1": channel(None)}, "unknown", 1.0, Criteria())[0]
    )


@pytest.mark.parametrize("length", [0.25, 1.0, 3.0, 12.0])
def test_runs_of_less_than_two_windows_are_left_out(length):
    batch = Mock()
    batch.windows.seg, batch.windows.first = np.zeros(8, int), 100 * np.arange(8)
    batch.windows.scored = 100
    assert list(_starts(batch, length)) == {
        0.25: ["0.25", "1", "free"], 1.0: ["1", "5", "free"],
        3.0: ["3", "free"], 12.0: ["12", "free"],
    }[length]  # fmt: skip


def test_a_run_begins_where_its_window_says_wherever_the_guess_was(outcome):
    """The residuals are free of the start's error, so which of two starts has the
    smaller ones is chance: some runs would begin at the guess.
    """
    found, case, _ = outcome
    problem = Problem.of(build_rig(case.spec), free_parameters(case.spec), case.check)
    values = problem.initial_values()
    for name, p in found.parameters.items():
        values[problem.model.names.index(name)] = p.value
    near = problem.started(values).P_0
    rng = np.random.default_rng(0)
    off = rng.choice([-1.0, 1.0], near.shape) * rng.uniform(2e4, 6e4, near.shape)
    batch = problem.batch._replace(P_0=near + off)
    again = replace(problem, batch=batch).started(values).P_0
    assert np.max(np.abs(again - near)) < 100.0
