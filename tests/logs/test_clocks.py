"""Clocks and rates: against brute force, closed forms, and clocks known to drift."""

from __future__ import annotations

import numpy as np
import pytest

from hydrojax.logs.clocks import Stream, clock
from hydrojax.logs.resample import held, on_one_base, sampled

START = 1_750_000_000_000_000_000


def stream(topic: str, t: np.ndarray, **values: np.ndarray) -> Stream:
    stamp = START + np.round(t * 1e9).astype(np.int64)
    return Stream(topic, "header.stamp", stamp, stamp + 1_000_000, values)


def test_held_is_the_mean_of_the_steps():
    """Against a sum over a grid of a thousandth of a tick."""
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.2e-3, 2e-3, 300))
    values = rng.normal(size=300)
    ticks = np.arange(20, 200) * 1e-3 + 1e-4 * rng.uniform(-1, 1, 180)
    got = held(time, values, ticks)
    ends = np.append(ticks[1:], ticks[-1] + np.median(np.diff(ticks)))
    for a, b, mean in zip(ticks, ends, got, strict=True):
        fine = a + (b - a) * (np.arange(2000) + 0.5) / 2000
        grid = np.mean(values[np.searchsorted(time, fine, side="right") - 1])
        assert mean == pytest.approx(grid, abs=5e-3)


def test_held_between_ticks_is_the_previous_value():
    time, values = np.arange(10) * 0.01, np.arange(10.0)
    ticks = np.arange(0.0, 0.09, 0.001) + 1e-6
    got = held(time, values, ticks)
    inside = np.mod(np.arange(90), 10) != 9  # no new value within the tick
    previous = values[(ticks / 0.01).astype(int)]
    np.testing.assert_allclose(got[inside], previous[inside], atol=1e-12)
    assert np.isnan(held(time + 0.02, values, ticks)[:20]).all()


def test_held_goes_stale_and_passes_nan_on():
    time = np.array([0.0, 0.01, 0.02, 0.1, 0.11])
    ticks = np.arange(0.0, 0.11, 0.01)
    assert not np.isnan(held(time, np.arange(5.0), ticks)).any()
    stale = np.isnan(held(time, np.arange(5.0), ticks, 0.0175))
    np.testing.assert_array_equal(np.flatnonzero(stale), np.arange(3, 10))
    lost = held(time, np.array([0.0, np.nan, 2.0, 3.0, 4.0]), ticks)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(lost)), [1])


def test_sampled_is_the_line_between_neighbours():
    time, ticks = np.arange(100) * 1e-3, np.arange(90) * 1e-3 + 0.3e-3
    rough = np.random.default_rng(2).normal(size=100)
    np.testing.assert_allclose(
        sampled(time, rough, ticks), np.interp(ticks, time, rough), atol=1e-9
    )


def test_samples_at_the_ticks_keep_their_noise():
    """A clock's rounding apart: the very samples, so white noise stays as it is."""
    rng = np.random.default_rng(3)
    time, rough = np.arange(1000) * 1e-3, rng.normal(size=1000)
    near = time[1:-1] + 5e-6 * rng.uniform(-1, 1, 998)
    np.testing.assert_array_equal(sampled(time, rough, near), rough[1:-1])


def test_nothing_is_invented_over_gaps_and_ends():
    time = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 6.0, 7.0])
    got = sampled(time, time, np.array([-0.5, 0.5, 2.5, 3.0, 3.5, 4.9, 5.0, 6.5, 7.5]))
    expected = [np.nan, 0.5, 2.5, 3.0, np.nan, np.nan, 5.0, 6.5, np.nan]
    np.testing.assert_allclose(got, expected)


@pytest.mark.parametrize("drift", [0.0, 80e-6, -300e-6])
def test_the_drift_is_found_within_its_interval(drift):
    """Delays heavy in the tail; the 99 % interval holds the truth in 38 of 40 runs."""
    hits, errors = 0, []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        t = np.arange(10_000) * 1e-3
        delay = 1e-3 + 0.3e-3 * rng.pareto(2.0, t.size)
        stamp = START + np.round((1 + drift) * t * 1e9).astype(np.int64) - 7 * 10**9
        received = START + np.round((t + delay) * 1e9).astype(np.int64)
        found = clock(stamp, received, START)
        hits += abs(found.drift + drift) <= found.error
        errors.append(found.error)
        at = found.coarse * 1e-9 + found.offset
        assert at == pytest.approx(7.001, abs=50e-6)
    assert hits >= 38
    assert np.median(errors) < 5e-6


def test_one_wild_stamp_does_not_carry_the_floor_away():
    rng = np.random.default_rng(4)
    t = np.arange(10_000) * 1e-3
    stamp = START + np.round(t * 1e9).astype(np.int64)
    received = stamp + np.round(1e6 * (1 + rng.exponential(0.5, t.size))).astype(int)
    stamp[9000] += 50_000_000
    found = clock(stamp, received, START)
    assert abs(found.drift) <= max(found.error, 1e-6)
    assert found.coarse * 1e-9 + found.offset == pytest.approx(1e-3, abs=50e-6)


def test_a_short_run_says_nothing_of_drift():
    stamp = START + 10**6 * np.arange(8)
    assert np.isinf(clock(stamp, stamp + 10**6, START).error)


def test_the_base_is_the_command_unless_motion_is_slower():
    fast, slow = np.arange(4000) * 0.5e-3, np.arange(400) * 5e-3
    command = stream("/u", fast, u=np.sin(fast))
    quick, rare = stream("/x", fast, x=fast), stream("/x", slow, x=slow)
    other = stream("/F", slow, F=slow)
    assert len(on_one_base([quick, command, other])[0]) > 3900
    time, signals, notes = on_one_base([command, rare, other])
    np.testing.assert_allclose(np.diff(time), 5e-3)
    # The mean of the held command over 5 ms: 10 samples of 0.5 ms each.
    means = np.sin(fast).reshape(400, 10).mean(axis=1)[: len(time)]
    np.testing.assert_allclose(signals["u"][:-1], means[:-1], atol=1e-9)
    assert any("mean over a tick" in note for note in notes)
    assert len(on_one_base([other, stream("/P", fast, P_a1=fast)])[0]) > 3900


def test_a_command_sent_when_it_changes_is_held():
    ticks = np.arange(2000) * 1e-3
    sent = np.array([0.0, 0.1, 0.11, 0.115, 0.7, 0.9, 1.31])
    command = stream("/u", sent, u=np.arange(7.0))
    time, signals, notes = on_one_base([command, stream("/x", ticks, x=ticks)])
    assert len(time) == 2000
    expected = np.searchsorted(sent, ticks + 1e-9, side="right") - 1.0
    np.testing.assert_allclose(signals["u"], expected, atol=1e-9)
    assert any("u comes now and then" in note for note in notes)


def test_of_repeats_the_last_command_holds_and_measurements_are_averaged():
    t = np.repeat(np.arange(500) * 1e-3, 2)
    twice = np.tile([1.0, 2.0], 500)
    streams = [stream("/u", t, u=twice), stream("/F", t, F=twice)]
    time, signals, notes = on_one_base(streams)
    assert len(time) == 500
    assert (signals["u"] == 2.0).all()
    assert (signals["F"] == 1.5).all()
    assert "/F: messages of equal stamp, merged: 500" in notes


def test_the_same_time_to_the_nanosecond():
    """Stamps of 1.75e18 ns keep every digit."""
    t = np.arange(3000) * 1e-3
    time, _, _ = on_one_base([stream("/u", t, u=t)])
    np.testing.assert_array_equal(time, np.arange(3000) / 1000)
