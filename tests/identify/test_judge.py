"""Whether an effect helps, where what it does is spread over windows or in one."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hydrojax.effects import EFFECTS
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.identify.tracing.judge import as_good, judge, negligible, worse
from hydrojax.identify.tracing.state import free_names

NOISE = np.array([np.inf, np.inf, 1.5])
WINDOWS, TICKS = 60, 250


def state() -> SimpleNamespace:
    def rms(sse):
        return np.sqrt(np.sum(sse, axis=0) / (WINDOWS * TICKS))

    return SimpleNamespace(criteria=Criteria(), check=SimpleNamespace(rms=rms))


def errors(seed: int, *more: tuple[slice, float]) -> np.ndarray:
    """Squared errors by window and channel: noise, and what is left in some windows, as
    a mean square over the noise's.
    """
    rng = np.random.default_rng(seed)
    out = np.zeros((WINDOWS, 3))
    out[:, 2] = rng.chisquare(TICKS, WINDOWS) * NOISE[2] ** 2
    for which, size in more:
        out[which, 2] += size * TICKS * NOISE[2] ** 2
    return out


BY = 0.02 * NOISE


@pytest.mark.parametrize("where", [slice(7, 8), slice(7, 9), slice(None)])
def test_an_effect_helps_in_one_window_as_in_all(where):
    """1.65 times the noise comes down to it, whether one reversal shows it or all."""
    size = 1.72 * WINDOWS / len(range(*where.indices(WINDOWS)))
    before = errors(1, (where, size))
    assert state().check.rms(before)[2] == pytest.approx(1.65 * 1.5, rel=0.02)
    assert judge(state(), before, errors(1), NOISE, BY) == "helps"


def test_what_leaves_one_window_as_it_is_does_not_help():
    """It lowers what stands in one window by half: no chance to tell, and not down."""
    one = slice(7, 8)
    before, after = errors(1, (one, 100.0)), errors(2, (one, 50.0))
    assert judge(state(), before, after, NOISE, BY) == "does not help"


def test_what_was_at_its_noise_before_is_not_brought_there():
    before, after = errors(1, (slice(7, 8), 9.0)), errors(1)
    assert state().check.rms(before)[2] < 1.1 * 1.5
    assert judge(state(), before, after, NOISE, BY) == "does not help"


def test_noise_does_not_bring_a_channel_down():
    """Few windows, each with no more than one sample to itself: chance can do that."""
    before, after = errors(1)[:4], errors(1)[:4]
    before[0, 2] += 1.1 * TICKS * NOISE[2] ** 2

    def rms(sse):
        return np.sqrt(np.sum(sse, axis=0) / (4 * TICKS))

    few = SimpleNamespace(**vars(state()) | {"check": SimpleNamespace(rms=rms)})
    assert rms(before)[2] > 1.1 * 1.5
    assert judge(few, before, after, NOISE, BY) == "does not help"


def test_what_fails_in_one_window_is_not_as_good():
    """Paired windows cannot tell; the simpler of two is not taken for it."""
    best, fails = errors(1), errors(2, (slice(7, 8), 40.0))
    assert not worse(fails, best, NOISE, Criteria())
    assert not as_good(state(), fails, best, NOISE)
    assert as_good(state(), errors(2), best, NOISE)


def test_a_difference_that_is_sure_and_next_to_nothing_tells_nothing_apart():
    """A lag of a fraction of a tick and a dead time leave the same but for a millionth
    that has one sign in every window."""
    best = errors(1)
    assert not worse((1 + 1e-6) * best, best, NOISE, Criteria())
    assert as_good(state(), (1 + 1e-6) * best, best, NOISE)
    assert worse(1.01 * best, best, NOISE, Criteria())


@pytest.mark.parametrize(
    ("name", "size", "none"),
    [
        # Less is what a spool does that the flow pushes.
        ("pressure_compensation.s", 0.02, True),
        ("pressure_compensation.s", 0.2, False),
        # 5 us of steps of 2 ms.
        ("valve_delay.tau_u", 5e-6, True),
        ("valve_delay.tau_u", 5e-5, False),
        ("channel_skew.tau_s", -5e-6, True),
        ("channel_skew.tau_s", -5e-5, False),
        ("internal_leakage.c_il", 1e-16, False),
    ],
)
def test_what_is_too_small_to_be_an_effect(name, size, none):
    effect = EFFECTS[name.split(".")[0]]
    windows = SimpleNamespace(h=np.full((3, 4), 2e-3))
    model = SimpleNamespace(names=tuple(free_names(effect)))
    assert name in model.names
    problem = SimpleNamespace(model=model, batch=SimpleNamespace(windows=windows))
    values = np.array([size if n == name else 0.0 for n in model.names])
    assert negligible(problem, values, effect) is none
