"""Values for longer runs: when they are looked for, and when they are kept."""

from __future__ import annotations

import json
from dataclasses import replace
from unittest.mock import Mock

import jsonschema
import pytest

from hydrojax.errors import InputError
from hydrojax.identify.longer import with_long_runs
from hydrojax.identify.report.write import write_report
from hydrojax.identify.results.outcome import ChannelErrors, Horizon, Outcome
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.report.schema import report_schema


def found(free: dict[str, float | None], verdict: str = "unknown", rig: str = "found"):
    """An outcome whose runs through whole logs are so far off; held is 1."""
    channels = {
        name: ChannelErrors(
            "Pa", 0.01, 2.0, 0.1, horizons={"free": Horizon(3.0, error, 1.0, None)}
        )
        for name, error in free.items()
    }
    return Outcome(
        "trace", "a rig", ("fit.csv",), ("validate.csv",), verdict, "Something is left",
        {}, channels, seconds={"compile": 1.0, "run": 2.0}, rig_file=rig,
    )  # fmt: skip


def case(horizon: float = 0.25) -> Mock:
    made = Mock()
    made.preparation.horizon, made.criteria, made.test = horizon, Criteria(), None
    return made


POOR = {"P_a1": 1.3, "P_a2": 2.5}


def test_better_values_are_kept_with_both_skills(tmp_path):
    own = case()
    fits = Mock(
        side_effect=[
            found({"P_a1": 0.8, "P_a2": 0.9}, rig="one second"),
            found({"P_a1": 0.7, "P_a2": 0.4}, rig="longer"),
        ]
    )
    out = with_long_runs(own, found(POOR), fits)
    assert out.long_runs is not None and out.long_runs.rig_file == "longer"
    assert out.rig_file == "found" and out.channels == found(POOR).channels
    assert out.long_runs.channels["P_a1"] == Horizon(1.3, 0.7, 1.0, None)
    (line,) = out.limits
    assert "P_a2 has skill -5.250" in line and "0.840" in line
    begun = [call.args for call in own.spec.with_text.call_args_list]
    assert begun == [("found",), ("one second",)]
    assert own.again.call_args.args[2] == out.long_runs.seconds == 3.0
    write_report(out, tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    jsonschema.validate(report, report_schema())
    assert report["long_runs"]["channels"]["P_a2"]["after"] == 0.4
    assert (tmp_path / "rig_long.toml").read_text() == "longer"
    write_report(replace(out, long_runs=None), tmp_path)
    assert not (tmp_path / "rig_long.toml").exists()


def test_a_longer_run_that_does_worse_leaves_the_shorter_one():
    fits = Mock(side_effect=[found({"P_a1": 0.5}), found({"P_a1": 0.6})])
    out = with_long_runs(case(), found({"P_a1": 1.3}), fits)
    assert out.long_runs is not None and out.long_runs.seconds == 1.0
    assert out.long_runs.channels["P_a1"].after == 0.5


@pytest.mark.parametrize(
    "other",
    [
        {"P_a1": 1.3, "P_a2": 2.6},
        {"P_a1": 1.5, "P_a2": 0.4},
        {"P_a1": 0.2, "P_a2": None},
    ],
)
def test_values_that_do_no_better_are_not(other):
    before = found(POOR)
    assert with_long_runs(case(), before, lambda *_: found(other)) == before


def test_a_run_that_ended_is_outdone_by_one_that_does_not():
    out = with_long_runs(case(), found({"P_a1": None}), lambda *_: found({"P_a1": 2.0}))
    assert out.long_runs is not None and "skill –, and" in out.limits[0]


@pytest.mark.parametrize(
    ("before", "horizon"),
    [
        (found({"P_a1": 0.1}), 0.25),
        (found(POOR, "explained"), 0.25),
        (found(POOR), 3.0),
        (found({"F": 2.0}), 0.25),
    ],
    ids=["with skill", "explained", "long already", "no pressure"],
)
def test_nothing_is_fitted_where_nothing_drifts(before, horizon):
    fit, early = Mock(), Mock()
    assert with_long_runs(case(horizon), before, fit, early=early) is before
    fit.assert_not_called()
    early.assert_not_called()


def test_what_was_found_is_given_before_the_fits_that_take_minutes():
    order = []

    def fit(*_):
        order.append("fit")
        return found({"P_a1": 0.8, "P_a2": 0.9})

    before = found(POOR)
    with_long_runs(case(), before, fit, early=order.append)
    assert order == [before, "fit", "fit"]


def test_logs_that_are_too_short_are_left_at_what_was_found():
    fit = Mock(side_effect=InputError("too short"))
    before = found(POOR)
    assert with_long_runs(case(), before, fit) is before


def test_the_errors_of_test_logs_decide_nothing():
    own, fit, before = case(), Mock(), found(POOR)
    own.test = Mock()
    assert with_long_runs(own, before, fit) is before
    fit.assert_not_called()
