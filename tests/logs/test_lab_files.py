"""Files as labs have them: each is read as the same run, or refused in one line."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hydrojax.errors import InputError
from hydrojax.logs.log import Log
from hydrojax.logs.tables import Channel

ROWS = 400
TIME = 1e-3 * np.arange(ROWS) * 2
WAVE = np.sin(9.0 * TIME)
RUN = {
    "time [s]": TIME,
    "u [%]": 30.0 * WAVE,
    "x [mm]": 20.0 * WAVE,
    "P_a1 [bar]": 70.0 + 5.0 * WAVE,
    "P_a2 [bar]": 70.0 - 5.0 * WAVE,
    "F [kN]": 0.5 * WAVE,
}
SI = {"u": 0.3, "x": 0.02, "P_a1": 5e5, "P_a2": -5e5, "F": 500.0}
"""What one unit of the wave is in SI."""


def as_csv(run: dict = RUN, header: bool = True, **options) -> str:
    return pd.DataFrame(run).to_csv(index=False, header=header, **options)


def german() -> str:
    return as_csv(sep=";", decimal=",")


def units_below() -> str:
    names = [label.split(" [")[0] for label in RUN]
    units = [label.split("[")[1].rstrip("]") for label in RUN]
    return (
        ";".join(names) + "\n" + ";".join(units) + "\n" + as_csv(header=False, sep=";")
    )


def numpy_text() -> str:
    out = io.StringIO()
    table = np.stack(list(RUN.values()), axis=1)
    np.savetxt(out, table, delimiter=",", header=",".join(RUN))
    return out.getvalue()


FILES = {
    "semicolons": as_csv(sep=";").encode(),
    "decimal commas": german().encode(),
    "tabs": as_csv(sep="\t").encode(),
    "tabs and commas": as_csv(sep="\t", decimal=",").encode(),
    "UTF-16": german().encode("utf-16"),
    "UTF-16, no mark": german().encode("utf-16-le"),
    "byte-order mark": german().encode("utf-8-sig"),
    "Latin-1": as_csv({**RUN, "Öl [°C]": 40.0 + WAVE}).encode("latin-1"),
    "comments": ("# rig 3\n# run 7; hot\n" + german()).encode(),
    "comments and commas": ("# rig 3\n\n" + as_csv()).encode(),
    "a row of units": units_below().encode(),
    "NumPy": numpy_text().encode(),
    "units in parentheses": as_csv(
        {k.replace("[", "(").replace("]", ")"): v for k, v in RUN.items()}
    ).encode(),
    "units behind a slash": as_csv(
        {k.replace("[", "/ ").replace("]", ""): v for k, v in RUN.items()}
    ).encode(),
    "a quoted header": as_csv(quoting=1, sep=";").encode(),
}


def check(log: Log) -> None:
    """Every signal as it was written, in SI."""
    np.testing.assert_allclose(log.time - log.time[0], TIME, atol=1e-9)
    for name, size in SI.items():
        values = log.signals[name]
        np.testing.assert_allclose(
            values - values[0], size * WAVE, atol=1e-9 * abs(size)
        )


@pytest.mark.parametrize("name", FILES)
def test_it_is_read(name: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(FILES[name])
    check(Log.load(path))


def test_what_is_not_plain_is_said(tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_bytes(german().encode("utf-16"))
    (note,) = Log.load(tmp_path / "log.txt").notes
    assert "semicolons" in note and "decimal commas" in note and "UTF-16" in note


def refusal(path: Path, text: str, **options) -> str:
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        Log.load(path, **options)
    line = str(caught.value)
    assert path.name in line and "\n" not in line
    return line


def test_a_row_s_line_is_named_below_comments(tmp_path: Path) -> None:
    run = {**RUN, "F [kN]": ["a"] + ["1,5"] * (ROWS - 1)}
    text = "# one\n# two\n" + as_csv(run, sep=";", decimal=",")
    line = refusal(tmp_path / "log.csv", text)
    assert "row 1 (line 4): 'a' is not a number" in line


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (as_csv(sep=";").replace(";0.", ";1.000,", 1), "thousands separator"),
        (german().replace(";", ","), "semicolons between the columns"),
        (as_csv({k: np.arange(ROWS) for k in RUN}, sep=";").replace("7;", "1,234;"),
         "may be a thousand or a decimal comma"),
        (german().replace("0,004;", "0.004;"), "has a decimal point"),
        ("time;u;x\nall;of;it\n" + "1;2;3\n" * 60, "neither numbers nor units"),
    ],
    ids=["thousands", "commas twice", "either", "mixed", "words"],
)  # fmt: skip
def test_what_can_be_read_in_two_ways_is_refused(
    text: str, words: str, tmp_path: Path
) -> None:
    assert words in refusal(tmp_path / "log.csv", text)


def stamped(form: str, start: str = "2024-03-01 23:59:59.900") -> list[str]:
    stamps = pd.Timestamp(start) + pd.to_timedelta(TIME, unit="s")
    return [s.strftime(form)[:-3] for s in stamps]


@pytest.mark.parametrize(
    "form",
    ["%Y-%m-%d %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S.%f", "%d.%m.%Y %H:%M:%S.%f"],
)
def test_dates_are_time(form: str, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(as_csv({**RUN, "time [s]": stamped(form)}))
    check(Log.load(tmp_path / "log.csv"))


@pytest.mark.parametrize("form", ["%H:%M:%S,%f", "%m/%d/%Y %H:%M:%S,%f"])
def test_times_of_one_day(form: str, tmp_path: Path) -> None:
    run = {**RUN, "time [s]": stamped(form, "2024-03-01 10:00:59.9")}
    (tmp_path / "log.csv").write_text(as_csv(run, sep=";", decimal=","))
    check(Log.load(tmp_path / "log.csv"))


@pytest.mark.parametrize("zone", ["Z", "+01:00", " +0100"])
@pytest.mark.parametrize("start", ["2024-03-01 10:00:59.9", "2024-03-01 23:59:59.900"])
def test_stamps_with_a_zone(zone: str, start: str, tmp_path: Path) -> None:
    stamps = [f"{s}{zone}" for s in stamped("%Y-%m-%dT%H:%M:%S.%f", start)]
    (tmp_path / "log.csv").write_text(as_csv({**RUN, "time [s]": stamps}))
    check(Log.load(tmp_path / "log.csv"))


def test_times_of_day_may_pass_midnight(tmp_path: Path) -> None:
    run = {**RUN, "time [s]": stamped("%H:%M:%S.%f")}
    (tmp_path / "log.csv").write_text(as_csv(run))
    check(Log.load(tmp_path / "log.csv"))


def test_degrees_in_german_are_no_gon(tmp_path: Path) -> None:
    """Which they were read as: 10 % less."""
    run = {**RUN, "psi [grad]": RUN["time [s]"]}
    line = refusal(tmp_path / "log.csv", as_csv(run))
    assert "may be degrees or gon; write deg or gon" in line


def test_dates_that_mean_two_days_are_refused(tmp_path: Path) -> None:
    run = {**RUN, "time [s]": stamped("%m/%d/%Y %H:%M:%S.%f")}
    line = refusal(tmp_path / "log.csv", as_csv(run))
    assert "03/01/2024" in line and "write it as 2024-03-01" in line


def test_a_frame_with_a_clock_for_an_index() -> None:
    frame = pd.DataFrame(RUN).drop(columns="time [s]")
    frame.index = pd.Timestamp("2024-03-01") + pd.to_timedelta(TIME, unit="s")
    frame.index.name = "time"
    check(Log.from_frame(frame))


@pytest.mark.parametrize("clock", ["seconds", "dates"])
def test_excel(clock: str, tmp_path: Path) -> None:
    pytest.importorskip("openpyxl", reason="openpyxl is not installed: [xlsx]")
    stamps = pd.Timestamp("2024-03-01") + pd.to_timedelta(TIME, unit="s")
    run = RUN if clock == "seconds" else {**RUN, "time [s]": stamps}
    path = tmp_path / "log.xlsx"
    with pd.ExcelWriter(path) as book:
        pd.DataFrame({"rig": ["3"]}).to_excel(book, sheet_name="notes", index=False)
        pd.DataFrame(run).to_excel(book, sheet_name="run", index=False)
    check(Log.load(path))
    with pd.ExcelWriter(path) as book:
        pd.DataFrame(run).to_excel(book, sheet_name="a", index=False)
        pd.DataFrame(run).to_excel(book, sheet_name="b", index=False)
    with pytest.raises(InputError, match=r"2 sheets \(a, b\)"):
        Log.load(path)


@pytest.mark.parametrize("clock", ["channel", "sampling"])
def test_tdms(clock: str, tmp_path: Path) -> None:
    nptdms = pytest.importorskip("nptdms", reason="npTDMS is not installed: [tdms]")
    names = list(RUN)[clock == "sampling" :]
    made = [
        nptdms.ChannelObject(
            "run",
            label.split(" [")[0],
            RUN[label],
            properties={
                "unit_string": label.split("[")[1].rstrip("]"),
                "wf_increment": 0.002,
                "wf_start_offset": 0.0,
            },
        )
        for label in names
    ]
    with nptdms.TdmsWriter(tmp_path / "log.tdms") as writer:
        writer.write_segment(made)
    check(Log.load(tmp_path / "log.tdms"))


def test_a_package_that_is_not_there_is_named(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "openpyxl", None)
    line = refusal(tmp_path / "log.xlsx", "x")
    assert "pip install 'hydrojax[xlsx]'" in line


def test_a_unit_in_other_letters_is_suggested(tmp_path: Path) -> None:
    line = refusal(tmp_path / "log.csv", as_csv().replace("P_a1 [bar]", "P_a1 [Bar]"))
    assert "unknown unit 'Bar'; did you mean 'bar'?" in line


def test_a_column_may_have_letters_in_parentheses(tmp_path: Path) -> None:
    text = as_csv().replace("P_a1 [bar]", "P (A)")
    (tmp_path / "log.csv").write_text(text)
    log = Log.load(tmp_path / "log.csv", {"P_a1": Channel(column="P (A)", unit="bar")})
    check(log)
