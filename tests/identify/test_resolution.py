"""A position that is measured coarsely: what is known of its noise, and what that does.

Truth is what was put in: noise of a known size on closed forms, and logs of the
independent generator under an encoder of fewer bits.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import signal

from hydrojax.identify import api
from hydrojax.identify.case import Case, open_case
from hydrojax.identify.estimation.fit import FitPoint
from hydrojax.identify.preparation.data import prepare_logs
from hydrojax.identify.preparation.noise import (
    Noise,
    SensorNoise,
    sensor_noise_of,
    smooth,
)
from hydrojax.identify.preparation.resolution import _largest, _noise_of
from hydrojax.identify.preparation.windows import at_rest
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.identify.tracing.state import Tracing
from hydrojax.logs.log import Log, brought_forward
from hydrojax.rigfile.schema import RigFile
from tests import generator

TIME = np.arange(12_000) * 1e-3
MOTION = sum(
    a * 1e-6 * np.sin(2 * np.pi * f * TIME + p)
    for a, f, p in ((9000, 0.4, 0.1), (400, 5.0, 1.0), (60, 17.0, 2.0))
)


def sensor_noise(x: np.ndarray) -> SensorNoise | None:
    return sensor_noise_of([(TIME, x)])


@pytest.mark.parametrize("sigma", [0.5e-6, 8e-6])
def test_white_noise_of_a_position_is_measured(sigma):
    noise = sigma * np.random.default_rng(1).normal(size=TIME.size)
    found = sensor_noise(MOTION + noise)
    assert found.sigma == pytest.approx(sigma, rel=0.1)
    assert found.step == 0.0
    assert 17.0 < found.cut < 100.0
    left = found.smoothed(TIME, MOTION + noise) - MOTION
    assert np.std(left[300:-300]) < 0.5 * sigma


@pytest.mark.parametrize("rows", [1600, 6000])
def test_noise_of_short_logs_is_not_taken_for_less(rows):
    """In the mean of many: the median of a spectrum of few segments is less than its
    mean, 3 % of the noise here.
    """
    draw = np.random.default_rng(6)
    found = [
        sensor_noise_of([(TIME[:rows], MOTION[:rows] + 2e-6 * draw.normal(size=rows))])
        for _ in range(100)
    ]
    sigma = [f.sigma for f in found if f]
    assert len(sigma) > 90
    assert np.mean(sigma) == pytest.approx(2e-6, rel=0.012)


@pytest.mark.parametrize("rate", [100.0, 512.0, 1000.3, 1024.0, 3000.0])
@pytest.mark.parametrize("jitter", [0.0, 0.1])
def test_noise_is_measured_at_any_rate(rate, jitter):
    """Stamps with six digits, and uneven by a tenth of a tick."""
    draw = np.random.default_rng(3)
    ticks = np.arange(int(12 * rate))
    t = np.round((ticks + jitter * draw.uniform(-1, 1, ticks.size)) / rate, 6)
    motion = 9e-3 * np.sin(2 * np.pi * 0.4 * t) + 4e-4 * np.sin(2 * np.pi * 5.0 * t)
    found = sensor_noise_of([(t, motion + 2e-6 * draw.normal(size=t.size))])
    assert found.sigma == pytest.approx(2e-6, rel=0.2)
    assert np.std((found.smoothed(t, motion) - motion)[100:-100]) < 2e-6


def test_a_still_piece_says_nothing():
    assert sensor_noise_of([(TIME[:1000] + 17.3, np.full(1000, 0.1))]) is None


def moved_by_a_mass(rows: int, step: float, seed: int) -> np.ndarray:
    """A mass on a soft valve, both of 2 Hz and damped, under random pushes."""
    w, fine = 2 * np.pi * 2.0, 8
    pushes = np.random.default_rng(seed).normal(size=rows * fine)
    one = signal.lti([w**2], [1, 1.2 * w, w**2])
    t = np.arange(pushes.size) * step / fine
    x = signal.lsim(one, signal.lsim(one, pushes, t)[1], t)[1]
    return 0.05 * (x / x.std())[::fine]


@pytest.mark.parametrize("seed", range(4))
def test_a_slow_log_shows_its_floor_at_the_end(seed):
    """29 um on the motion of a mass at 50 Hz: a floor in an eighth of the band."""
    t, draw = 0.02 * np.arange(3000), np.random.default_rng(100 + seed)
    x = moved_by_a_mass(t.size, 0.02, seed)
    found = sensor_noise_of([(t, x + 2.9e-5 * draw.normal(size=t.size))])
    assert found is not None and found.sigma == pytest.approx(2.9e-5, rel=0.2)
    assert sensor_noise_of([(t, x)]) is None


@pytest.mark.parametrize("ticks", [0.1, 0.2, 0.5])
def test_a_position_brought_forward_keeps_its_noise(ticks):
    """Between rows it is interpolated, which takes noise off at the band's end."""
    t, draw = 0.01 * np.arange(6000), np.random.default_rng(3)
    x = moved_by_a_mass(t.size, 0.01, 5) + 1.2e-5 * draw.normal(size=t.size)
    late = {"x": ticks * 0.01}
    moved, ((_, stop),) = brought_forward(t, {"x": x}, [(0, t.size)], late)
    found = sensor_noise_of([(t[:stop], moved["x"][:stop])])
    assert found is not None and found.sigma == pytest.approx(1.2e-5, rel=0.15)


def test_uneven_rows_are_joined_by_straight_lines():
    """A spline of seventh degree swings by far more than the motion between them."""
    t = np.cumsum(np.random.default_rng(4).uniform(1e-4, 0.02, 400))
    x = 0.05 * np.abs(np.sin(2 * t))
    moved, ((_, stop),) = brought_forward(t, {"x": x}, [(0, t.size)], {"x": 5e-3})
    true = 0.05 * np.abs(np.sin(2 * (t + 5e-3)))
    assert np.max(np.abs(moved["x"] - true)[:stop]) < 1e-3


@pytest.mark.parametrize("rows", [21, 40, 200])
def test_a_short_piece_has_too_few_frequencies(rows):
    """No floor is read off a bin or two, and none is missed with a warning."""
    x = moved_by_a_mass(rows, 0.02, 6) + 2e-5 * np.sin(np.arange(rows))
    found = sensor_noise_of([(0.02 * np.arange(rows), x)])
    assert found is None or found.sigma < 1e-4


def test_a_random_walk_has_no_floor():
    walk = 1e-5 * np.cumsum(np.random.default_rng(9).normal(size=6000))
    assert sensor_noise_of([(0.01 * np.arange(6000), walk)]) is None


def test_steps_of_a_position_are_seen():
    step = 5e-6
    found = sensor_noise(np.round(MOTION / step) * step)
    assert found.step == pytest.approx(step, rel=1e-6)
    assert found.sigma == pytest.approx(step / math.sqrt(12), rel=0.2)


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.6, 2.0])
def test_a_sensor_that_rounds_its_own_noise_is_measured_again_alike(share):
    """`share` is the noise ahead of the rounding, in steps: the reading's error has the
    size of the first one's whether noise or rounding makes it.
    """
    step = 5e-6
    noise = share * step * np.random.default_rng(4).normal(size=TIME.size)
    read = step * np.round((MOTION + noise) / step)
    again = sensor_noise(read).again(MOTION, seed=5)
    assert np.std(again - MOTION) == pytest.approx(np.std(read - MOTION), rel=0.15)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("cut", [np.inf, 300.0])
def test_a_rounded_reading_is_rounded_otherwise_the_next_time(cut, seed):
    """Readings that are hardly smoothed stand at the steps: rounded once more, they
    would be the same, or off by a whole step where arithmetic decides.
    """
    step = 2e-6
    read = step * np.round(MOTION / step)
    sensor = SensorNoise(step / math.sqrt(12), step, cut)
    seen = sensor.smoothed(TIME, read)
    off = sensor.again(seen, seed) - seen
    assert np.std(off) == pytest.approx(step / math.sqrt(12), rel=0.15)
    rest = np.zeros(400)
    assert np.ptp(sensor.again(rest, seed)) == 0


def shaken(t: np.ndarray) -> np.ndarray:
    """A slow stroke, m, that shakes at 18 Hz for a moment."""
    burst = 1e-4 * np.exp(-(((t - 31.0) / 0.1) ** 2)) * np.sin(2 * np.pi * 18 * t)
    return 0.1 * np.sin(2 * np.pi * 0.05 * t) + burst


@pytest.mark.parametrize("rate, cut", [(100.0, 12.0), (1000.0, 12.0)])
def test_a_moment_of_fast_motion_is_not_smoothed_away(rate, cut):
    t = np.arange(0.0, 60.0, 1 / rate)
    sensor = SensorNoise(5e-6, 0.0, cut)
    x = shaken(t)
    y = sensor.again(x)
    there = np.abs(t - 31.0) < 0.15
    alike = np.abs(t - 31.0) > 1.0
    got, same = sensor.smoothed(t, y), smooth(t, y, cut)(t)
    before, after = (float(np.std((v - x)[there])) for v in (same, got))
    assert before > 4 * sensor.sigma
    assert after < 1.2 * sensor.sigma
    np.testing.assert_allclose(got[alike], same[alike], atol=1e-2 * sensor.sigma)


@pytest.mark.parametrize("rate", [100.0, 1000.0])
def test_noise_alone_is_hardly_ever_left_for_motion(rate):
    t = np.arange(0.0, 60.0, 1 / rate)
    slow = 0.1 * np.sin(2 * np.pi * 0.05 * t)
    changed = []
    for seed in range(10):
        sensor = SensorNoise(5e-6, 0.0, 15.0)
        y = sensor.again(slow, seed)
        off = np.abs(sensor.smoothed(t, y) - smooth(t, y, 15.0)(t))
        changed.append(np.mean(off > 0.1 * sensor.sigma))
    assert np.mean(changed) < 0.01


def test_motion_without_a_floor_has_no_noise():
    """What falls all the way to the end of the spectrum."""
    rough = np.cumsum(np.random.default_rng(2).normal(size=TIME.size)) * 1e-6
    assert sensor_noise(rough) is None


def coarse_case(folder: Path, monkeypatch, bits: int, effects=None) -> Case:
    monkeypatch.setattr(generator, "ENCODER", 2 * math.pi / 2**bits)
    generator.write_case(folder, 1, effects)
    logs = [folder / f"fit_{i}.csv" for i in (1, 2)]
    return open_case(folder / "rig.toml", logs, [folder / "validate.csv"])


def _changes(spread: float) -> np.ndarray:
    """What noise moves in 200 windows, whose sizes differ: [W, T, 3]."""
    rng = np.random.default_rng(3)
    size = np.exp(spread * rng.standard_normal((200, 1, 3)))
    return size * rng.standard_normal((200, 25, 3))


def test_stiffer_windows_count_in_full():
    """Near an end a chamber answers by twice and more what it does elsewhere."""
    change, log = _changes(0.4), np.repeat([0, 1], 100)
    square = np.mean(change**2, axis=1)
    plain = np.sqrt(np.maximum(square[:100].mean(0), square[100:].mean(0)))
    every = np.ones(200, bool)
    np.testing.assert_allclose(_largest(change, log, every), plain, rtol=0.03)


def test_windows_at_rest_do_not_hide_those_that_move():
    """A sensor that rounds moves nothing at rest: in nineteen of twenty here."""
    change, log = _changes(0.2), np.repeat([0, 1], 100)
    moves = np.arange(200) % 20 == 3
    change[~moves] *= 1e-6
    square = np.mean(change**2, axis=1)
    plain = np.sqrt(np.maximum(square[:100].mean(0), square[100:].mean(0)))
    np.testing.assert_allclose(_largest(change, log, moves), plain, rtol=0.03)


def test_windows_that_run_wild_do_not_make_the_noise():
    change, log = _changes(0.4), np.repeat([0, 1], 100)
    every = np.ones(200, bool)
    calm = _largest(change, log, every)
    change[[5, 50, 120]] *= 100
    assert np.all(_largest(change, log, every) < 1.15 * calm)
    change[::5] *= 100  # but one in five is no exception
    assert np.all(_largest(change, log, every) > 10 * calm)


def test_windows_are_placed_by_another_position_if_one_is_given(recorded):
    """A rig that stands for 1.1 s, and a reading beyond 1 % of its travel then."""
    folder = recorded(1)
    spec = RigFile.load(folder / "rig.toml")
    log = Log.load(folder / "fit_1.csv")
    psi, late = log.signals["psi"].copy(), int(np.searchsorted(log.time, 1.15))
    psi[:late] = psi[late]
    still = replace(log, signals=log.signals | {"psi": psi})
    psi = psi.copy()
    psi[late - 40] += 0.02 * np.ptp(psi)
    read = replace(log, signals=log.signals | {"psi": psi})
    one, own = prepare_logs([still], spec), prepare_logs([read], spec)
    placed = prepare_logs([read], spec, placed=[still])
    assert not np.array_equal(own.windows.t[0], one.windows.t[0])
    assert np.array_equal(placed.windows.t, one.windows.t)
    assert not np.array_equal(placed.motion.dx, one.motion.dx)


def along_ticks(path, parts=4):
    """A path's displacements along ticks of some parts."""
    return np.diff(path).reshape(-1, parts)


def test_a_piston_rests_as_long_as_it_stays_within_its_noise():
    noise = 1e-6 * np.random.default_rng(0).normal(size=4001)
    dx = along_ticks(0.1 + np.clip(noise, -3e-6, 3e-6))
    assert np.sum(np.abs(dx)) > 1e-3
    assert np.sum(np.abs(at_rest(dx, 3e-6, 40))) < 6e-6
    # Noise that is wider than that is motion, and so is what ends sooner.
    np.testing.assert_allclose(at_rest(dx, 1e-6, 40), dx, atol=1e-18)
    short = np.where(np.arange(1000) < 30, 0.0, 1e-5)[:, None] * np.ones(4)
    np.testing.assert_allclose(at_rest(short, 3e-6, 40), short, atol=1e-18)


def test_a_piston_that_turns_round_is_not_at_rest():
    """In a sine of 5 mm at 0.1 Hz, at 1 kHz."""
    t = np.arange(40_001) / 4000.0
    dx = along_ticks(5e-3 * np.sin(0.2 * np.pi * t))
    np.testing.assert_allclose(at_rest(dx, 1e-6, 200), dx, atol=1e-18)


def test_a_rest_in_a_motion_keeps_what_comes_before_and_after():
    up = np.full((100, 4), 1e-5)
    noise = 1e-6 * np.random.default_rng(0).uniform(-1.0, 1.0, (200, 4))
    dx = np.concatenate([up, np.diff(noise.ravel(), prepend=0.0).reshape(200, 4), -up])
    rests = at_rest(dx, 2e-6, 40)
    np.testing.assert_allclose(rests[:99], dx[:99])
    np.testing.assert_allclose(rests[-99:], dx[-99:])
    assert np.sum(np.abs(rests[101:299])) < 1e-9
    assert abs(np.sum(rests) - np.sum(dx)) < 3e-6


def test_what_smoothing_leaves_of_white_noise():
    """Beside what a smoothed draw has."""
    h, cut = 5e-3, 12.0
    t = h * np.arange(40_000)
    noise = SensorNoise(1e-5, 0.0, cut)
    left = noise.smoothed(t, noise.again(np.zeros(t.size)))
    assert noise.left(h) == pytest.approx(np.std(left), rel=0.05)
    assert SensorNoise(1e-5, 0.0, np.inf).left(h) == 1e-5


def test_a_bristle_does_not_forget_on_the_noise_of_a_rest():
    """Behind 6 um of it, through 20 s: one of 0.4 mm stays where it was bent."""
    fine, h = 4, 5e-3
    draw = np.random.default_rng(1)
    slow = signal.butter(2, 12.0, fs=fine / h, output="sos")
    noise = signal.sosfiltfilt(slow, draw.normal(size=20 * 200 * fine + 1))
    x = 1e-3 + 6e-6 * noise / np.std(noise)
    x[:2000] = np.linspace(0.0, x[2000], 2000)

    def bent(moves, z_ss=4e-4):
        z = 0.0
        for dx in moves.ravel():
            z += dx - abs(dx) * z / z_ss
        return z / z_ss

    dx = along_ticks(x)
    assert bent(dx[:500]) > 0.9
    assert bent(dx) < 0.5
    assert bent(at_rest(dx, 3 * 6e-6, 40)) > 0.85


@pytest.mark.parametrize("ticks", [1, 5, 39, 40])
def test_a_piece_shorter_than_a_rest_is_as_it_was(ticks):
    """Gaps leave such pieces, in which no window lies."""
    dx = 1e-7 * np.random.default_rng(0).normal(size=(ticks, 4))
    if ticks < 40:
        np.testing.assert_allclose(at_rest(dx, 3e-6, 40), dx, atol=1e-18)
    assert at_rest(dx, 3e-6, 40).shape == dx.shape


@pytest.mark.slow
def test_a_fine_encoder_is_left_alone(tmp_path, monkeypatch):
    case = coarse_case(tmp_path, monkeypatch, 23)
    np.testing.assert_array_equal(case.fit.noise, [9e3, 9e3, 2.5])
    assert not any("the position is known to" in note for note in case.fit.notes)
    raw = Log.load(tmp_path / "fit_1.csv")
    np.testing.assert_array_equal(case.fit_logs[0].signals["psi"], raw.signals["psi"])


@pytest.mark.slow
def test_what_smoothing_would_take_off_is_reason_to_smooth(tmp_path, monkeypatch):
    """Twenty-two bits move F by half of its noise as they are, and smoothed by less
    than what is dealt with.
    """
    case = coarse_case(tmp_path, monkeypatch, 22)
    assert any("the position is known to 0.03" in note for note in case.fit.notes)
    assert 1.005 < case.fit.noise[2] / 2.5 < 1.2


@pytest.mark.parametrize("found, beta, more", [(0.8, 1, 0.8), (1.2, 1, 1.2),
                                               (3, 1, 1.5), (1.2, 3e9, 1)])  # fmt: skip
def test_the_model_found_raises_the_noise_by_half_at_most(
    recorded, monkeypatch, found, beta, more
):
    """And not at all where its oil is as stiff as it may be (3e9 Pa); in the fitted
    logs by what it brings there.
    """
    folder = recorded(1)
    logs = [folder / f"{name}.csv" for name in ("fit_1", "fit_2", "validate")]
    case = open_case(folder / "rig.toml", logs[:2], logs[2:])
    problem, check, free, _ = api._problems(case, [])
    values, noise = problem.initial_values(), np.asarray(problem.batch.noise)
    if beta > 1:
        values[problem.model.names.index("beta")] = beta
    point = FitPoint(values, noise, 0, True)
    monkeypatch.setattr(api, "fit_jointly", lambda problem, *_: (problem, point))
    state = Tracing(problem, check, {}, free, point, lambda _: None)
    case = replace(case, noise_by=lambda *_: Noise(0.9 * noise, found * noise))
    known = api._with_noise_found(case, state)
    np.testing.assert_allclose(known.noise, more * noise)
    np.testing.assert_allclose(known.problem.batch.noise, 0.9 * noise)


@pytest.mark.slow
def test_logs_near_an_end_are_judged_by_the_noise_there(tmp_path, monkeypatch):
    """A log to validate with the piston 5 cm from the others' middle: one chamber is
    half as long, and its pressure is moved twice as far; the other's less far.
    """
    case = coarse_case(tmp_path, monkeypatch, 17)
    logs = [tmp_path / f"fit_{i}.csv" for i in (1, 2)]
    table = pd.read_csv(tmp_path / "validate.csv")
    (psi,) = (n for n in table.columns if n.startswith("psi"))
    table[psi] += 0.05 / 0.085
    table.to_csv(tmp_path / "moved.csv", index=False)
    moved = open_case(tmp_path / "rig.toml", logs, [tmp_path / "moved.csv"])
    brought = [np.sqrt(c.check.noise[:2] ** 2 - 9e3**2) for c in (case, moved)]
    ratio = np.sort(brought[1] / brought[0])
    assert 0.6 < ratio[0] < 0.85 and 1.5 < ratio[1] < 2.7
    np.testing.assert_allclose(moved.fit.noise, case.fit.noise, rtol=0.02)


def test_a_log_is_smoothed_where_its_own_motion_ends(recorded):
    """A lever's slow motion, and beside it a shaker's: one cut for both would take the
    shaking off, and what it moves would pass for noise of all logs.
    """
    folder = recorded(1)
    spec = RigFile.load(folder / "rig.toml")
    log = Log.load(folder / "fit_1.csv")
    radius, t, draw = spec.geometry["radius"], log.time, np.random.default_rng(5)
    slow = 9e-3 * np.sin(2 * np.pi * 0.4 * t)
    logs, truths = [], [slow, slow + 1e-4 * np.sin(2 * np.pi * 60 * t)]
    for x in truths:
        psi = (x + 5e-6 * draw.normal(size=t.size)) / radius
        logs.append(replace(log, signals=log.signals | {"psi": psi}))
    pieces = [(t, radius * each.signals["psi"]) for each in logs]
    common = sensor_noise_of(pieces)
    own = [_noise_of(each, spec, common, Criteria()) for each in logs]
    left = [
        [
            np.sqrt(np.mean((y - x) ** 2))
            for y in (mine.smoothed(*piece), smooth(*piece, common.cut)(t))
        ]
        for mine, piece, x in zip(own, pieces, truths, strict=True)
    ]
    assert own[0].cut < common.cut < own[1].cut
    assert all(mine < shared for mine, shared in left)
    assert max(mine for mine, _ in left) < 0.5 * max(shared for _, shared in left)
    assert [b.sigma for b in own] == pytest.approx([5e-6, 5e-6], rel=0.1)


@pytest.mark.slow
def test_a_noisier_position_is_counted_in_its_own_log(tmp_path, monkeypatch):
    """A log to validate whose position has three times the noise of the others'."""
    case = coarse_case(tmp_path, monkeypatch, 17)
    logs = [tmp_path / f"fit_{i}.csv" for i in (1, 2)]
    table = pd.read_csv(tmp_path / "validate.csv")
    (psi,) = (n for n in table.columns if n.startswith("psi"))
    sigma = 2 * math.pi / 2**17 / math.sqrt(12)
    noise = np.random.default_rng(7).normal(size=len(table))
    table[psi] += math.sqrt(8) * sigma * noise
    table.to_csv(tmp_path / "noisy.csv", index=False)
    noisy = open_case(tmp_path / "rig.toml", logs, [tmp_path / "noisy.csv"])
    brought = [np.sqrt(c.check.noise[:2] ** 2 - 9e3**2) for c in (case, noisy)]
    ratio = brought[1] / brought[0]
    assert np.all(ratio > 2) and np.all(ratio < 3.5)
    np.testing.assert_allclose(noisy.fit.noise, case.fit.noise, rtol=0.02)


@pytest.mark.slow
def test_under_a_coarse_encoder_nothing_missing_is_still_the_answer(
    tmp_path, monkeypatch
):
    """Seventeen bits are 4 um: as they are, they move F by many times its noise."""
    case = coarse_case(tmp_path, monkeypatch, 17)
    assert any("the position is known to 1." in note for note in case.fit.notes)
    assert 4.0 < case.fit.noise[2] < 12.0 and case.fit.noise[0] > 9e3
    found = api.trace_case(case)
    assert found.verdict == "nothing missing" and not found.effects
    for channel in found.channels.values():
        assert 0.7 < channel.after / channel.noise < 1.1


@pytest.mark.slow
def test_what_a_coarse_encoder_does_to_the_bristle_is_in_its_interval(
    tmp_path, monkeypatch
):
    """Noise passes for motion, in which the bristle fades: z_ss comes out too short."""
    case = coarse_case(tmp_path, monkeypatch, 17)
    truth = json.loads((tmp_path / "truth.json").read_text())["rig"]

    def off(of: Case) -> dict[str, float]:
        found = api.identify(of).parameters
        return {
            name: abs(p.value - truth[name]) / p.std
            for name, p in found.items()
            if name in truth and p.std
        }

    counted, left_out = off(case), off(replace(case, twice=None))
    assert left_out["z_ss"] > 3.0
    assert max(counted.values()) < 3.0
    assert np.mean(np.square(list(counted.values()))) < 2.5


@pytest.mark.slow
def test_under_a_coarse_encoder_an_effect_is_still_named(tmp_path, monkeypatch):
    effects = {"internal_leakage": generator.CATALOGUE["internal_leakage"]}
    found = api.trace_case(coarse_case(tmp_path, monkeypatch, 17, effects))
    assert [e.name for e in found.effects] == ["internal_leakage"]
    assert found.verdict == "explained", found.sentence
    c_il = found.effects[0].parameters["c_il"].value
    assert c_il == pytest.approx(effects["internal_leakage"]["c_il"], rel=0.03)


def without_command(case: Path, folder: Path) -> Case:
    """The case with its pressures as what drives."""
    for name in ("fit_1", "fit_2", "validate"):
        log = pd.read_csv(case / f"{name}.csv").drop(columns="u [V]")
        log.to_csv(folder / f"{name}.csv", index=False)
    logs = [folder / f"{name}.csv" for name in ("fit_1", "fit_2")]
    return open_case(case / "rig.toml", logs, [folder / "validate.csv"])


@pytest.mark.study
def test_noise_of_pressures_that_drive_is_not_taken_for_a_lag(recorded, tmp_path):
    """9 kPa on 11.8 cm^2 twice are 15 N, six times the load cell's noise."""
    case = without_command(recorded(1), tmp_path)
    assert any("the pressures drive, and are noisy" in note for note in case.fit.notes)
    assert 3.0 < case.fit.noise[2] < 10.0
    found = api.trace_case(case)
    assert found.verdict == "nothing missing" and not found.effects


@pytest.mark.study
def test_friction_is_named_where_noisy_pressures_drive(recorded, tmp_path):
    effects = {"stribeck": generator.CATALOGUE["stribeck"]}
    found = api.trace_case(without_command(recorded(6, effects), tmp_path))
    assert [e.name for e in found.effects] == ["stribeck"]
    assert found.verdict == "explained", found.sentence
    k_st = found.effects[0].parameters["k_st"].value
    assert k_st == pytest.approx(effects["stribeck"]["k_st"], rel=0.05)
