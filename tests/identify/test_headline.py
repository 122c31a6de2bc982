"""What stands first in a report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import hydrojax as hj
from hydrojax.identify.report.headline import grade, headline, loop_verdict
from hydrojax.identify.report.traces import SECONDS, stretch
from hydrojax.identify.results.outcome import (
    Errors,
    FoundEffect,
    Horizon,
    LoopCheck,
    Parameter,
)
from hydrojax.identify.results.parts import aliases, within_tolerance
from hydrojax.identify.results.sentence import verdict_sentence
from hydrojax.identify.results.unexplained import LeftOpen, unexplained_beyond
from tests.identify.test_report import OUTCOMES, explained


def test_one_line_says_what_was_found():
    assert headline(explained()) == (
        "Internal leakage and position friction were missing: with them, the error of "
        "F falls from 31 N to 2.6 N, at a noise of 2.5 N."
    )
    one = replace(explained(), effects=explained().effects[:1])
    assert headline(one).startswith("Internal leakage was missing: with it, the error")
    for make in OUTCOMES.values():
        assert len(headline(make())) <= 150  # two lines
    unknown = OUTCOMES["unknown"]()
    assert headline(unknown) == (
        "F is not explained by any known effect: 55 N RMS, 22 times its noise."
    )
    found = replace(unknown, effects=explained().effects[:1])
    assert headline(found).startswith("Internal leakage was found, but F stays at 55 N")


def test_a_sentence_counts_its_effects():
    two, left = explained().effects, OUTCOMES["unknown"]().unexplained

    def said(verdict, effects):
        return verdict_sentence("trace", verdict, effects, left, True, LeftOpen())

    assert "position_friction: with them every" in said("explained", two)
    assert "internal_leakage: with it every channel" in said("explained", two[:1])
    assert " were found and added and take away " in said("unknown", two)
    assert " was found and added and takes away " in said("unknown", two[:1])
    assert "added" not in said("unknown", ())


def test_a_force_that_is_off_over_longer_runs_only_is_said_so():
    unknown = replace(
        OUTCOMES["unknown"](), unexplained=(unexplained_beyond(3.75, 2.5, 0.25),)
    )
    end = "over 1 s and more F stays 3.75 N above its noise."
    assert headline(unknown) == f"Something is missing: {end}"
    found = replace(unknown, effects=explained().effects[:1])
    assert headline(found) == (
        f"Internal leakage may stand in for what is missing: {end}"
    )
    sentence = verdict_sentence(
        "trace", "unknown", found.effects, unknown.unexplained, True, LeftOpen()
    )
    assert "F is at its noise over 0.25 s, but stays 3.75 N RMS above it" in sentence
    assert "(1.8 times its noise)" in sentence
    assert sentence.endswith("internal_leakage may stand in for what is missing.")


@pytest.mark.parametrize(("share", "hint"), [(0.6, True), (0.98, False)])
def test_an_effect_that_takes_a_part_may_stand_in_for_another(share, hint):
    left, one = OUTCOMES["unknown"]().unexplained, explained().effects[0]

    def said(verdict, *effects):
        return verdict_sentence(
            "trace", verdict, effects, left, True, LeftOpen()
        ).endswith("may stand in for what is missing.")

    own = replace(one, share=share)
    assert said("unknown", own) == hint
    assert not said("unknown") and not said("explained", own)


def test_a_sentence_says_what_goes_with_values_that_were_left_open():
    left = OUTCOMES["unknown"]().unexplained

    def said(needed):
        return verdict_sentence("trace", "unknown", (), left, True, needed)

    assert "open" not in said(LeftOpen())
    some = said(LeftOpen(("c_n2", "beta"), 0.834, False))
    assert "; other values of c_n2 and beta, which the fitted logs leave open," in some
    assert some.endswith("take away 83.4 % of the squared error above the noise.")
    assert "55" in some and "cannot be judged" not in some
    assert "F cannot be judged" in said(LeftOpen(("c_n2",), 1.0, True))


def test_what_stays_is_said_of_the_logs_that_the_verdict_is_of():
    """The test logs are at their noise here, the validation logs are not."""
    unknown = OUTCOMES["unknown"]()
    first = unknown.unexplained[:1]
    c = unknown.channels[first[0].channel]
    both = replace(c, after=c.noise, validate=Errors(c.before, 3 * c.noise))
    channels = {**unknown.channels, first[0].channel: both}
    said = headline(replace(unknown, channels=channels, unexplained=first))
    assert "on the validation logs, 3 times its noise" in said


def test_a_model_without_skill_says_so():
    unknown = OUTCOMES["unknown"]()
    poor = replace(unknown.channels["F"], horizons={"0.25": Horizon(60, 55, 50, None)})
    channels = {**unknown.channels, "F": poor}
    said = headline(replace(unknown, channels=channels))
    assert said == "The model predicts F no better than a held value: 55 N RMS."


def test_the_grade_is_the_share_of_the_excess():
    """By hand: squares over the noise, less one, before and after."""
    before = [41e3 / 9e3, 43.2e3 / 9e3, 31 / 2.5]
    after = [9.27e3 / 9e3, 9.18e3 / 9e3, 2.6 / 2.5]
    channels = explained().channels
    assert [c.before / c.noise for c in channels.values()] == pytest.approx(
        before, 0.02
    )
    excess = [sum(r**2 - 1 for r in ratios) for ratios in (before, after)]
    share = 100 * (1 - excess[1] / excess[0])
    assert grade(explained()).startswith(f"{share:.3g} %")
    assert grade(OUTCOMES["unknown"]()) == ""


@pytest.mark.parametrize(
    ("rms", "simulated", "words"),
    [
        (20.0, 75.0, "agrees: rig and controller"),
        (76.6, 10.0, "does not agree: the simulated loop tracks better"),
        (60.0, 90.0, "does not agree: the controller that ran"),
        (np.nan, np.nan, "not compared"),
    ],
)
def test_the_closed_loop_gets_a_verdict(rms, simulated, words):
    t = np.arange(3.0)
    check = LoopCheck("log", t, t, t, t, rms, 77.4, simulated, "")
    assert loop_verdict(check).startswith(words)


def test_the_stretch_is_where_the_error_is():
    t = np.arange(0, 20, 1e-2)
    error = np.where((t > 12) & (t < 13), 5.0, 0.1)
    error[300:400] = np.nan
    t = np.where(np.isnan(error), np.nan, t)
    part = stretch(t, error)
    assert t[part][0] <= 12.02 and t[part][-1] >= 12.98
    assert t[part][-1] - t[part][0] <= SECONDS


@pytest.mark.parametrize(
    ("eps", "second", "within"),
    [
        (0.015, "3e-3 m^2 +- 0.8 %", ("area_1", "area_2")),
        (-0.025, "3e-3 m^2 +- 2 %", ()),
        (0.015, "3e-3 m^2", ()),
    ],
    ids=["within both", "beyond the first", "the second is exact"],
)
def test_a_gain_lies_within_the_areas_tolerances_or_not(eps, second, within):
    """It is the same as both areas off, the first of which is known to 1 %."""
    rig = hj.RigFile.from_text(
        'name = "a press"\nlayout = "differential"\n[geometry]\n'
        f'area_1 = "5e-3 m^2 +- 1 %"\narea_2 = "{second}"\nchamber_length = "0.5 m"\n'
        '[supply]\nP_s = "14 MPa"\n[parameters]\nbeta = "8e8 Pa"\n'
    )
    gain = Parameter(eps, "1", "gain error", 0.0, True)
    effect = FoundEffect("loadcell_gain", {"eps": gain}, 1e-9, {}, {}, (), "F", 1.0)
    assert within_tolerance(effect, rig) == within


@pytest.mark.parametrize(
    ("s", "same"),
    [((0.02, (0.0, 0.1)), True), ((1.0, None), False), ((0.4, (0.2, 0.6)), False)],
    ids=["fades", "does not fade", "fades in part"],
)
def test_viscous_friction_is_another_name_for_k_v_only_where_it_fades(s, same):
    rig = hj.RigFile.from_text(
        'name = "a joint"\nlayout = "pull-pull"\n[geometry]\narea = "1e-3 m^2"\n'
        'chamber_length = "0.2 m"\nradius = "0.08 m"\n[supply]\nP_s = "14 MPa"\n'
        '[parameters]\nk_vp = "0 N*s/m"\nk_vn = "0 N*s/m"\n'
    )
    share = Parameter(s[0], "1", "share of it in presliding", 1.0, True, None, s[1])
    found = aliases("viscous_friction", {"s": share}, rig)
    assert found == (("k_vp", "k_vn") if same else ())
