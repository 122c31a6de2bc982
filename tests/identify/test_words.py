"""What a report says beside its verdict: ends of ranges, doubts, one thing twice."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hydrojax.identify.checking.words import Finding
from hydrojax.identify.estimation.known import Free, is_of_shapes
from hydrojax.identify.inference.uncertainty import _at_end, is_whole
from hydrojax.identify.results.limits import (
    _noisier,
    _not_quite,
    _same_as_inputs,
    said_tolerated,
)
from hydrojax.identify.results.outcome import (
    ChannelErrors,
    FoundEffect,
    Parameter,
    Unexplained,
)
from hydrojax.identify.results.summary import _slow_noise, with_inputs
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.identify.tracing.score import Score
from hydrojax.parameters import Spec
from tests.identify.test_report import explained

SHARE = Spec("1", 0.0, 0.0, 1.0, "a share", strength=True, whole=True)
EXPONENT = Spec("1", 1.2, 1.0, 1.4, "an exponent")


@pytest.mark.parametrize(
    ("end", "own", "spec", "says"),
    [
        (
            "lower",
            Free(0.5, 0.0, 2.0),
            EXPONENT,
            "the fit finds none of it in these logs",
        ),
        (
            "upper",
            Free(1.2, 1.0, 1.4),
            EXPONENT,
            "the widest that its model is meant for",
        ),
        (
            "lower",
            Free(1.2, 1.0, 1.3),
            EXPONENT,
            "the widest that its model is meant for",
        ),
        ("upper", Free(1.2, 1.0, 1.3), EXPONENT, "widen the range"),
        ("upper", Free(0.0, 0.0, 1.0), SHARE, "these logs show all of it"),
        ("upper", Free(0.0, 0.0, 0.8), SHARE, "widen the range"),
    ],
)
def test_only_a_range_narrower_than_the_model_s_is_to_be_widened(end, own, spec, says):
    assert says in _at_end("e.n", end, own, spec)
    assert is_whole(own, spec) == (spec is SHARE and own.upper == 1.0)


def test_a_share_between_two_shapes_is_told_by_its_ends():
    """One that a rig file lets go half the way only has no second shape."""
    between = Spec("1", 0.0, 0.0, 1.0, "", whole=True, grid=(0.0, 1.0))
    assert is_of_shapes(Free(0.0, 0.0, 1.0), between)
    assert not is_of_shapes(Free(0.0, 0.0, 0.5), between)
    assert not is_of_shapes(Free(0.0, 0.0, 1.0), SHARE)


def test_a_factor_and_the_effect_that_does_the_same_are_one_error():
    found = explained()
    gain = FoundEffect("loadcell_gain", {}, 0.0, {}, {}, (), "F")
    says, same = "area is 2 % too large", ("loadcell_gain",)
    area = Finding("area", "factor", 0.98, 6.9, 4.1, "N", says, effects=same)
    supply = Finding("P_s", "factor", 0.9, 9e3, 4e3, "Pa", "P_s is 10 % too high")
    alone = with_inputs(found, (area,)).sentence
    found = replace(found, effects=(*found.effects, gain))
    both, other = (with_inputs(found, (one,)).sentence for one in (area, supply))
    assert "not a second one" not in alone + other
    assert "loadcell_gain is the same error under another name" in both


def test_a_sensor_that_lies_is_not_said_to_explain_what_effects_do():
    stray = Finding("P_a1", "stray", None, None, None, "", "P_a1 jumps away and back")
    area = Finding("area", "factor", 0.98, 6.9, 4.1, "N", "area is 2 % too large")
    compared = "explains at least as much as any effect"
    said = {f.input: with_inputs(explained(), (f,)).sentence for f in (stray, area)}
    assert said["P_a1"].startswith("An input looks wrong: P_a1 jumps")
    assert compared not in said["P_a1"] and compared in said["area"]


def test_rows_that_are_left_out_do_not_hide_what_else_looks_wrong():
    stray = Finding("P_a1", "stray", None, None, None, "", "P_a1 jumps", mended=True)
    area = Finding("area", "factor", 0.98, 6.9, 4.1, "N", "area is 2 % too large")
    sign = Finding("F", "sign", -1.0, 1e3, 4.0, "N", "F is turned round", mended=True)
    said = [
        with_inputs(explained(), (stray, *more)).sentence
        for more in ((), (area,), (sign,))
    ]
    assert said[0].startswith("An input looks wrong: P_a1 jumps. With it mended:")
    assert "area is 2 % too large" in said[1] and "P_a1" not in said[1]
    assert "P_a1 jumps (and 1 more). With it mended:" in said[2]


def test_no_factor_is_blamed_that_a_balance_closes_less_well_with_than_the_runs():
    found = replace(explained(), effects=())  # its F is off by 31 N before
    says = "area is 11 % too large"
    crude, near = (
        Finding("area", "factor", 0.9, 1e3, left, "N", says) for left in (404.0, 40.0)
    )
    assert with_inputs(found, (crude,)) == found
    assert with_inputs(found, (crude, near)).inputs == (near,)
    sign = Finding("F", "sign", -1.0, 1e3, 404.0, "N", "F is turned round", mended=True)
    assert with_inputs(found, (sign,)).inputs == (sign,)


@pytest.mark.parametrize(("left", "blamed"), [(4.0, True), (12.3, False)])
def test_no_factor_is_blamed_where_effects_bring_the_force_to_its_noise(left, blamed):
    """A load cell that bends is 12 % of the area to a balance, and left as much."""
    found = explained()
    assert found.channels["F"].before > 12.3 and found.channels["F"].noise == 2.5
    area = Finding("area", "factor", 0.87, 33.2, left, "N", "area is 12 % too small")
    assert with_inputs(found, (area,)).inputs == ((area,) if blamed else ())


@pytest.mark.parametrize(("over", "blamed"), [(1.05, True), (4.7, False)])
def test_no_factor_is_blamed_whose_effect_leaves_the_force_above_its_noise(
    over, blamed
):
    """A gain that stands for a drag by pressure takes much of it, and not the rest."""
    gain = FoundEffect("loadcell_gain", {}, 0.0, {}, {}, ("area",), "F")
    says, same = "area is 15 % too large", ("loadcell_gain",)
    area = Finding("area", "factor", 0.87, 6.9, 4.1, "N", says, effects=same)
    found = explained()
    F = found.channels["F"]
    left = {**found.channels, "F": replace(F, after=over * F.noise)}
    found = replace(found, effects=(gain,), channels=left)
    assert with_inputs(found, (area,)).inputs == ((area,) if blamed else ())


@pytest.mark.parametrize(
    ("follows", "sensors", "after", "said"),
    [
        ("none", {}, 1.9, True),
        ("v", {}, 1.9, False),
        ("none", {"F": 1.0}, 1.9, False),
        ("none", {}, 3.0, False),
    ],
    ids=["nothing shows", "it goes with v", "stated", "too much"],
)
def test_slow_noise_of_a_sensor_is_offered(follows, sensors, after, said):
    case = SimpleNamespace(spec=SimpleNamespace(sensors=sensors))
    channels = {"F": ChannelErrors("N", 1.0, after, after)}
    left = (Unexplained("F", 1.6, "N", follows, "F stays 1.6 N"),)
    text = _slow_noise(case, channels, left, Criteria())
    assert ("state its noise under [sensors]" in text) == said == bool(text)
    assert _slow_noise(case, channels, (), Criteria()) == ""


@pytest.mark.parametrize(
    ("eps", "says"), [((0.107, 0.096), "10 % higher"), ((0.012, -0.0001), None)]
)
def test_both_gauges_off_alike_may_be_the_supply(eps, says):
    own = {f"eps_{i}": SimpleNamespace(value=e) for i, e in enumerate(eps, 1)}
    gain = FoundEffect("pressure_sensor_gain", own, 0.0, {}, {}, (), "P_a1 + P_a2")
    said = _same_as_inputs((gain,), SimpleNamespace(ends=frozenset()), 0.15)
    assert [says in text for text in said] == ([True] if says else [])


def test_noise_that_the_log_has_is_told_from_what_the_model_lacks():
    rng = np.random.default_rng(2)
    F = 200 * np.sin(np.arange(8000) / 300) + 1.5 * rng.standard_normal(8000)
    log = SimpleNamespace(signals={"F": F}, segments=[(0, 8000)])
    case = SimpleNamespace(spec=SimpleNamespace(sensors={"F": 0.6}), check_logs=(log,))
    (said,) = _noisier(case, {"F": ChannelErrors("N", 0.6, 1.53, 1.53)}, 1.1)
    assert "2.5 times what [sensors] states" in said
    assert 'write F = "1.5' in said and 'N" there' in said
    # More than the log's own, or no more than the stated: nothing to say.
    assert _noisier(case, {"F": ChannelErrors("N", 0.6, 4.0, 1.9)}, 1.1) == []
    assert _noisier(case, {"F": ChannelErrors("N", 0.6, 4.0, 0.6)}, 1.1) == []


def test_a_channel_a_little_above_its_noise_is_said_to_be():
    def scored(name: str, p: float) -> Score:
        by_window = np.random.default_rng(0).normal(0.5, 1.0, (60, 1))
        own = {"by_window": by_window}
        return Score(name, 1.0, np.zeros(1), p, 1.0, 100.0, 1.0, **own)

    state = SimpleNamespace(
        criteria=Criteria(),
        added=(),
        tried={"stribeck": "does not help"},
        scores={
            "stribeck": scored("stribeck", 1e-6),
            "backlash": scored("backlash", 1),
            "payload_inertia": scored("payload_inertia", 1e-6),
        },
    )
    channels = {
        "P_a1": ChannelErrors("Pa", 9e3, 9e3, 9.1e3),
        "F": ChannelErrors("N", 2.5, 2.7, 2.7),
    }
    (said,) = _not_quite(state, channels, "nothing missing", {})
    assert said.startswith("F is at 1.08 times its noise, which counts as at it")
    assert "stribeck shows" in said and "backlash" not in said
    assert "payload_inertia" not in said  # it was not tried
    where = {"F": "; 80 % of what is above lies in 2 of 60 windows"}
    (said,) = _not_quite(state, channels, "nothing missing", where)
    assert "counts as at it; 80 % of what is above lies in 2 of 60" in said
    assert _not_quite(state, channels, "unknown", {}) == []
    assert _not_quite(state, {"P_a1": channels["P_a1"]}, "explained", {}) == []


def test_what_a_tolerance_accounts_for_is_said_and_not_called_missing():
    gain = Parameter(-0.008, "1", "gain error", 0.0, True)
    found = [FoundEffect("loadcell_gain", {"eps": gain}, 1e-9, {}, {}, (), "F", 1.0)]
    (said,) = said_tolerated(found, {"loadcell_gain": ("area",)})
    assert (
        said.startswith("F is 0.8 % smaller than area gives it") and "rig.toml" in said
    )
    assert said_tolerated(found, {}) == []
