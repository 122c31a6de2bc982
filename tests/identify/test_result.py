"""A result: its tables, model and predictions, against the outcome's figures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import hydrojax
from hydrojax.api import fit
from hydrojax.errors import InputError
from hydrojax.identify.case import open_case, read
from hydrojax.identify.result import Result
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.logs.log import Log
from hydrojax.logs.tables import Channel
from hydrojax.parameters import get
from hydrojax.rigfile.schema import RigFile

DEMO = Path(hydrojax.__file__).parent / "demo"


@pytest.fixture(scope="module")
def folder(recorded):
    return recorded(4, {"internal_leakage": {}})


@pytest.fixture(scope="module")
def result(folder) -> Result:
    """From objects of every kind: a rig file, a log, a path, a table."""
    rig = RigFile.load(folder / "rig.toml")
    fitted = Log.load(folder / "fit_1.csv", rig.channels)
    test = pd.read_csv(folder / "fit_2.csv")
    return fit(rig, [fitted], [folder / "validate.csv"], [test], starts=1)


def rms(frame: pd.DataFrame, channel: str) -> float:
    return float(np.sqrt(np.mean((frame[channel] - frame[f"{channel}_measured"]) ** 2)))


@pytest.mark.slow
def test_predictions_have_the_errors_that_are_reported(result, folder):
    for log, column in (("validate", "validate_after"), ("fit_2", "after")):
        frame = result.predict(folder / f"{log}.csv")
        for channel, row in result.channels.iterrows():
            assert rms(frame, channel) == pytest.approx(row[column], rel=1e-6)
        assert (np.diff(frame["time"]) > 0).all()


def test_test_logs_take_no_part(result, folder):
    without = fit(
        folder / "rig.toml", [folder / "fit_1.csv"], [folder / "validate.csv"], starts=1
    )
    pd.testing.assert_frame_equal(without.parameters, result.parameters)
    assert without.verdict == result.verdict
    same = without.channels[["before", "after"]].to_numpy()
    beside = result.channels[["validate_before", "validate_after"]].to_numpy()
    np.testing.assert_array_equal(same, beside)
    assert result.outcome.test_logs == ("frame",) and not without.outcome.test_logs


def test_tables_hold_what_was_found(result):
    names = ["value", "std", "low", "high", "unit", "identified", "free", "at_bound"]
    assert list(result.parameters.columns) == names
    found = result.parameters.loc["beta"]
    assert found["low"] < found["value"] < found["high"] and found["unit"] == "Pa"
    assert (get(result.model, ("beta",)) == found["value"]).all()
    assert result.rig.parameters["beta"].start == pytest.approx(
        found["value"], rel=1e-5
    )
    assert result.rig.parameters["beta"].range is not None


def test_a_result_says_itself_in_a_line_and_in_a_page(result, tmp_path):
    assert repr(result).count("\n") == 0 and result.verdict in repr(result)
    text = result.summary()
    assert result.verdict in text and "beta" in text and "P_a1" in text
    assert max(map(len, text.splitlines())) < 110
    assert "<table" in result._repr_html_()
    result.save(tmp_path / "out")
    assert {"report.json", "report.html", "rig.toml"} <= {
        p.name for p in (tmp_path / "out").iterdir()
    }
    assert result.plot().axes


def test_a_log_has_one_part_only(folder):
    log = Log.load(folder / "fit_1.csv")
    with pytest.raises(InputError, match="is among the logs"):
        open_case(folder / "rig.toml", [log], [log])
    path = folder / "validate.csv"
    with pytest.raises(InputError, match="is among the logs"):
        open_case(folder / "rig.toml", [log], [path], [path])


@pytest.mark.slow
def test_criteria_decide(folder):
    """A channel is at its noise by the criterion that is given."""
    strict = Criteria(at_noise=0.5)
    logs = [folder / "fit_1.csv"], [folder / "validate.csv"]
    result = fit(folder / "rig.toml", *logs, starts=1, criteria=strict)
    assert result.verdict == "unknown"
    assert len(result.outcome.unexplained) == len(result.channels)


def test_a_log_read_without_the_rigs_channels_is_refused(tmp_path):
    """Its psi would run the wrong way round, and nothing would say so."""
    channels = {"psi": Channel(column="psi", invert=True), "F": Channel(column="F")}
    rig = RigFile.load(DEMO / "rig.toml")
    turned = replace(rig, channels=channels)
    log = Log.load(DEMO / "fit_1.csv.gz")
    with pytest.raises(InputError, match=r"without \[channels\] psi of"):
        read(log, turned)
    again = read(DEMO / "fit_1.csv.gz", turned)
    assert read(again, turned) is again
    np.testing.assert_array_equal(again.signals["psi"], -log.signals["psi"])
    assert read(log, rig) is log
    assert read(again, rig) is again  # channels of the caller's own
    arrays = replace(log, channels=None)
    assert read(arrays, turned) is arrays
