"""Logs: every kind of file, every rule, every kind of bad input."""

from __future__ import annotations

import gzip
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io

from hydrojax import units
from hydrojax.errors import InputError
from hydrojax.logs.log import Log
from hydrojax.logs.tables import Channel


def a_run(rows: int = 2000, step: float = 0.001) -> dict[str, np.ndarray]:
    """Columns of a sound log, by `name [unit]`."""
    time = step * np.arange(rows)
    wave = np.sin(9.0 * time)
    return {
        "time [s]": time,
        "u [V]": 3.0 * wave,
        "psi [deg]": 20.0 * wave,
        "P_a1 [bar]": 70.0 + 5.0 * wave,
        "P_a2 [bar]": 70.0 - 5.0 * wave,
        "P_s [bar]": 140.0 + 0.0 * wave,
        "F [kN]": 0.5 * wave,
        "temperature": 40.0 + wave,
    }


def write(path: Path, columns: dict) -> Path:
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def refusal(path: Path, *words: str, **options) -> str:
    """The one line with which the log is refused."""
    with pytest.raises(InputError) as caught:
        Log.load(path, **options)
    line = str(caught.value)
    assert "\n" not in line
    for word in (path.name, *words):
        assert word in line
    return line


def edited(tmp_path: Path, **changes) -> Path:
    """A CSV of `a_run` with columns changed; None takes one out."""
    run = a_run()
    for name, value in changes.items():
        label = next(label for label in run if label.split(" ")[0] == name)
        if value is None:
            del run[label]
        elif isinstance(value, str):
            run = {(value if k == label else k): v for k, v in run.items()}
        else:
            run[label] = value
    return write(tmp_path / "log.csv", run)


def same(one: Log, other: Log) -> None:
    np.testing.assert_allclose(one.time, other.time, atol=1e-12)
    assert one.signals.keys() == other.signals.keys()
    for name, values in one.signals.items():
        np.testing.assert_allclose(other.signals[name], values, rtol=1e-12)


def test_a_value_that_no_sensor_gives_is_refused_at_its_row(tmp_path: Path) -> None:
    wild = a_run()["P_a1 [bar]"].copy()
    wild[41] = 1e300
    path = edited(tmp_path, P_a1=wild)
    refusal(path, "P_a1 [bar]", "row 42 (line 43)", "1e+300 bar", "beyond any sensor")


# What is read


def test_csv_in_si(tmp_path: Path) -> None:
    run = a_run()
    log = Log.load(write(tmp_path / "log.csv", run))
    assert log.name == "log.csv"
    np.testing.assert_allclose(log.signals["P_a1"], 1e5 * run["P_a1 [bar]"])
    np.testing.assert_allclose(log.signals["F"], 1e3 * run["F [kN]"])
    np.testing.assert_allclose(log.signals["psi"], np.deg2rad(run["psi [deg]"]))
    assert log.units == {
        "u": "V", "psi": "rad", "P_a1": "Pa", "P_a2": "Pa", "P_s": "Pa", "F": "N",
    }  # fmt: skip
    assert log.ignored == ("temperature",)
    assert log.segments == ((0, 2000),)
    assert log.merged == 0


def test_time_in_ms_keeps_its_start(tmp_path: Path) -> None:
    run = a_run()
    time = run.pop("time [s]")
    log = Log.load(write(tmp_path / "log.csv", {"time [ms]": 7e3 + 1e3 * time, **run}))
    np.testing.assert_allclose(log.time, 7.0 + time, atol=1e-9)


def test_spaces_byte_order_mark_and_blank_tail(tmp_path: Path) -> None:
    plain = Log.load(edited(tmp_path))
    text = (tmp_path / "log.csv").read_text()
    header, body = text.split("\n", 1)
    header = header.replace(",", " , ").replace(" [", "   [ ")
    path = tmp_path / "odd.csv"
    path.write_text(f"\ufeff {header}\n{body.replace(',', ', ')}\n\n", "utf-8")
    same(plain, Log.load(path))


@pytest.mark.parametrize("ending", ["csv.gz", "parquet", "CSV"])
def test_other_tables(tmp_path: Path, ending: str) -> None:
    plain = Log.load(edited(tmp_path))
    path = tmp_path / f"run.{ending}"
    frame = pd.DataFrame(a_run())
    if ending == "parquet":
        frame.set_index("time [s]").to_parquet(path)
    else:
        frame.to_csv(path, index=False)
    same(plain, Log.load(path))


def vectors() -> tuple[dict[str, np.ndarray], dict[str, str]]:
    labels = [label for label in a_run() if "[" in label]
    names = {label: label.split(" ")[0] for label in labels}
    values = {names[label]: a_run()[label] for label in labels}
    return values, {names[label]: label.split("[")[1][:-1] for label in labels}


@pytest.mark.parametrize("form", ["units", "suffix", "log", "column"])
def test_mat_v5(tmp_path: Path, form: str) -> None:
    plain = Log.load(edited(tmp_path))
    values, said = vectors()
    tree: dict = dict(values)
    if form == "suffix":
        tree |= {f"{name}_unit": unit for name, unit in said.items()}
    elif form == "log":
        tree = {"log": {**values, "units": said}}
    else:
        tree["units"] = said
    kind = "column" if form == "column" else "row"
    scipy.io.savemat(tmp_path / "log.mat", tree, oned_as=kind)
    same(plain, Log.load(tmp_path / "log.mat"))


@pytest.mark.parametrize("form", ["units", "suffix", "log"])
def test_mat_v7_3(tmp_path: Path, form: str) -> None:
    plain = Log.load(edited(tmp_path))
    values, said = vectors()
    path = tmp_path / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        top = file.create_group("log") if form == "log" else file
        for name, value in values.items():
            top[name] = value[None, :] if name == "u" else value[:, None]
        place = top if form == "suffix" else top.create_group("units")
        for name, unit in said.items():
            key = f"{name}_unit" if form == "suffix" else name
            place[key] = np.array([[ord(c)] for c in unit], dtype=np.uint16)
            place[key].attrs["MATLAB_class"] = np.bytes_("char")
    log = Log.load(path)
    same(plain, log)
    assert log.ignored == ()


def test_channels_rename_give_a_unit_and_invert(tmp_path: Path) -> None:
    run = a_run()
    run["MainU"] = 0.1 * run["u [V]"]
    path = write(tmp_path / "log.csv", run)
    channels = {
        "u": Channel(column="MainU", unit="1", invert=True),
        "F": Channel(column="F [kN]", unit="N"),
    }
    log = Log.load(path, channels)
    np.testing.assert_allclose(log.signals["u"], -run["MainU"])
    np.testing.assert_allclose(log.signals["F"], run["F [kN]"])
    assert log.units["u"] == "1"
    assert log.ignored == ("u [V]", "temperature")
    assert len(log.notes) == 2  # P_s at rest, and the file's unit overruled
    assert any("'F [kN]' is read in N" in note for note in log.notes)


@pytest.mark.parametrize(
    ("unit", "si", "factor"),
    [("mV", "V", 1e-3), ("%", "1", 0.01), ("1", "1", 1.0), ("-", "1", 1.0)],
)
def test_command_units(tmp_path: Path, unit: str, si: str, factor: float) -> None:
    log = Log.load(edited(tmp_path, u=f"u [{unit}]"))
    assert log.units["u"] == si
    np.testing.assert_allclose(log.signals["u"], factor * a_run()["u [V]"])


def test_supply_return_velocity_and_desired_force_may_rest(tmp_path: Path) -> None:
    rest = {k: np.ones(2000) for k in ("P_r [bar]", "v [m/s]", "F_d [N]")}
    log = Log.load(write(tmp_path / "log.csv", a_run() | rest))
    assert len([note for note in log.notes if "constant" in note]) == 4


# Gaps, missing numbers, coarse clocks


def test_nan_and_inf_cut(tmp_path: Path) -> None:
    force = a_run()["F [kN]"]
    force[700:710], force[1400:1402] = np.nan, np.inf
    log = Log.load(edited(tmp_path, F=force))
    assert log.segments == ((0, 700), (710, 1400), (1402, 2000))
    assert np.isnan(log.signals["F"][[700, 709, 1400]]).all()
    assert any("F is missing: 12" in note for note in log.notes)
    assert len(log.time) == 2000


def test_a_lone_hole_costs_its_row(tmp_path: Path) -> None:
    """One tick is then as long as two; where that would be a gap, the hole cuts."""
    run = a_run()
    force, pressure, time = (run[n] for n in ("F [kN]", "P_a1 [bar]", "time [s]"))
    force[[300, 1400]], pressure[[301, 900]] = np.nan, np.nan
    time[1400:] += 0.6e-3
    log = Log.load(edited(tmp_path, F=force, P_a1=pressure, time=time))
    u = run["u [V]"]
    whole = np.delete(np.arange(2000), 900)
    np.testing.assert_array_equal(log.time, time[whole])
    assert log.segments == ((302, 1399), (1400, 1999))  # under 0.5 s before 300
    # The command was there, and counts in the mean over the long tick.
    assert log.signals["u"][899] == pytest.approx((u[899] + u[900]) / 2, rel=1e-12)
    others = np.delete(np.arange(1999), 899)
    np.testing.assert_array_equal(log.signals["u"][others], u[whole[others]])
    assert any("F is missing: 2" in note for note in log.notes)
    assert any("P_a1 is missing: 2" in note for note in log.notes)


def test_a_log_of_nothing_but_what_is_desired(tmp_path: Path) -> None:
    run = a_run()
    both = {"time [s]": run["time [s]"], "F_d [N]": 1e3 * run["F [kN]"]}
    assert Log.load(write(tmp_path / "log.csv", both)).segments == ((0, 2000),)


def test_desired_force_and_ignored_columns_do_not_cut(tmp_path: Path) -> None:
    holes = a_run()["F [kN]"]
    holes[900] = np.nan
    run = a_run() | {"F_d [N]": holes, "other [N]": holes, "name": ["ü"] * 2000}
    assert Log.load(write(tmp_path / "log.csv", run)).segments == ((0, 2000),)


def test_gap_in_time_cuts_and_short_pieces_go(tmp_path: Path) -> None:
    time = a_run()["time [s]"]
    time[800:] += 0.0016  # a step of 2.6 ms
    time[1200:] += 0.0014  # a step of 2.4 ms is none
    time[1700:] += 1.0
    path = edited(tmp_path, time=time)
    log = Log.load(path)
    assert log.segments == ((0, 800), (800, 1700))
    assert any("gaps in time: 2, the longest 1" in note for note in log.notes)
    assert any("under 0.5 s: 300" in note for note in log.notes)
    assert len(Log.load(path, shortest=0.2).segments) == 3


def test_no_segment_left(tmp_path: Path) -> None:
    force = a_run()["F [kN]"]
    force[::400] = force[1::400] = np.nan
    refusal(edited(tmp_path, F=force), "no stretch of 0.5 s", "F is missing: 10")


def coarse_run(seed: int = 0) -> dict[str, np.ndarray]:
    steps = 0.01 * np.random.default_rng(seed).normal(1.0, 0.25, 3000)
    time = np.round(np.cumsum(np.abs(steps)), 2)
    return {"time [s]": time, "x [mm]": np.sin(time), "F [N]": np.arange(3000.0)}


def test_coarse_clock_is_averaged(tmp_path: Path) -> None:
    run = coarse_run()
    log = Log.load(write(tmp_path / "log.csv", run))
    time = run["time [s]"]
    assert 0.01 < np.mean(np.diff(time) == 0.0) < 0.2
    assert log.merged == 3000 - len(np.unique(time)) > 0
    assert (np.diff(log.time) > 0.0).all()
    assert any(str(log.merged) in note for note in log.notes)
    first = int(np.flatnonzero(np.diff(time) == 0.0)[0])
    group = run["F [N]"][time == time[first]]
    at = np.searchsorted(log.time, time[first])
    assert log.signals["F"][at] == pytest.approx(group.mean())


def test_even_clock_may_not_repeat(tmp_path: Path) -> None:
    words = ("'time [s]'", "row 301 (line 302)", "time repeats")
    time = a_run()["time [s]"]
    time[300::500] = time[299:-1:500]
    refusal(edited(tmp_path, time=time), *words)
    rows = np.sort(np.r_[0:2000, 299:2000:20])  # 4 % of the rows are there twice
    twice = {label: values[rows] for label, values in a_run().items()}
    refusal(write(tmp_path / "log.csv", twice), *words)


def test_fine_uneven_clock_may_not_repeat(tmp_path: Path) -> None:
    run = coarse_run()
    time = np.cumsum(0.01 * np.random.default_rng(1).uniform(0.5, 1.5, 3000))
    assert Log.load(write(tmp_path / "a.csv", run | {"time [s]": time})).merged == 0
    time[50] = time[49]
    refusal(write(tmp_path / "b.csv", run | {"time [s]": time}), "row 51 (line 52)")


# Bad input


@pytest.mark.parametrize(
    ("name", "label", "words"),
    [
        ("F", "F", ("'F'", "has no unit", "F [N]")),
        ("F", "F []", ("has no unit",)),
        ("F", "F [Pa]", ("'F [Pa]'", "'Pa' does not fit", "N")),
        ("F", "F [kn]", ("'kn' does not fit",)),
        ("F", "F [blurg]", ("unknown unit 'blurg'",)),
        ("F", "P [bar]", ("'P [bar]'", "N")),
        ("psi", "x [deg]", ("'x [deg]'", "m")),
        ("time", "time [m]", ("'time [m]'", "s")),
        ("time", "time", ("has no unit", "time [s]")),
        ("u", "u [A]", ("'u [A]'", "neither V nor 1")),
        ("u", "u", ("has no unit", "u [V]")),
        ("temperature", "F [N]", ("2 columns", "'F'")),
    ],
)
def test_bad_header(
    tmp_path: Path, name: str, label: str, words: tuple[str, ...]
) -> None:
    refusal(edited(tmp_path, **{name: label}), *words)


def test_no_time(tmp_path: Path) -> None:
    refusal(edited(tmp_path, time=None), "no column 'time'", "'F [kN]'")
    refusal(edited(tmp_path, time="Time [s]"), "did you mean 'Time'")


def test_spaces_between_columns(tmp_path: Path) -> None:
    pd.DataFrame(a_run()).to_csv(tmp_path / "log.csv", index=False, sep=" ")
    refusal(tmp_path / "log.csv", "separate the columns with commas")


def test_channel_that_is_not_there(tmp_path: Path) -> None:
    channels = {"F": Channel(column="Load")}
    refusal(edited(tmp_path), "'Load'", "[channels] F", channels=channels)
    channels = {"F": Channel(column="temperatur", unit="N")}
    line = refusal(edited(tmp_path), channels=channels)
    assert "did you mean 'temperature'" in line


def test_cell_that_is_no_number(tmp_path: Path) -> None:
    force = a_run()["F [kN]"].astype(object)
    force[41] = "1,5"
    words = ("'F [kN]'", "row 42 (line 43)", "'1,5'", "not a number")
    refusal(edited(tmp_path, F=force), *words)
    pd.DataFrame(a_run() | {"F [kN]": force.astype(str)}).to_parquet(
        tmp_path / "log.parquet"
    )
    line = refusal(tmp_path / "log.parquet", "'F [kN]'", "row 42", "'1,5'")
    assert "line 43" not in line


def test_time_that_is_a_date(tmp_path: Path) -> None:
    stamps = pd.to_timedelta(a_run()["time [s]"], unit="s")
    path = tmp_path / "log.parquet"
    pd.DataFrame(a_run() | {"time [s]": stamps}).to_parquet(path)
    np.testing.assert_allclose(Log.load(path).time, a_run()["time [s]"], atol=1e-9)


def test_time_missing_or_falling(tmp_path: Path) -> None:
    time = a_run()["time [s]"]
    time[6] = np.nan
    refusal(edited(tmp_path, time=time), "row 7 (line 8)", "time is missing")
    time[6] = 0.0
    refusal(edited(tmp_path, time=time), "row 7 (line 8)", "time falls")


def test_blank_line_is_counted(tmp_path: Path) -> None:
    lines = edited(tmp_path).read_text().split("\n")
    (tmp_path / "log.csv").write_text("\n".join([*lines[:9], "", *lines[9:]]))
    refusal(tmp_path / "log.csv", "row 9 (line 10)", "time is missing")


@pytest.mark.parametrize("rows", [0, 3, 49])
def test_too_few_rows(tmp_path: Path, rows: int) -> None:
    path = write(tmp_path / "log.csv", {k: v[:rows] for k, v in a_run().items()})
    refusal(path, f"it has {rows}", "at least 50 rows")


def test_row_with_a_cell_too_many(tmp_path: Path) -> None:
    lines = edited(tmp_path).read_text().split("\n")
    for row in (1, 9):
        wrong = [*lines[:row], lines[row] + ",1", *lines[row + 1 :]]
        (tmp_path / "log.csv").write_text("\n".join(wrong))
        refusal(tmp_path / "log.csv", "not a readable CSV file")


@pytest.mark.parametrize("name", ["u", "psi", "P_a1", "P_a2", "F"])
def test_channel_that_rests(tmp_path: Path, name: str) -> None:
    values = np.full(2000, 1.5)
    values[10] = np.nan
    refusal(edited(tmp_path, **{name: values}), f"'{name} [", "does not move")


def test_position_or_drive_force_that_rests(tmp_path: Path) -> None:
    for label in ("x [mm]", "P [N]"):
        run = a_run() | {label: np.zeros(2000)}
        refusal(write(tmp_path / "log.csv", run), f"'{label}'", "does not move")


def test_column_without_numbers(tmp_path: Path) -> None:
    refusal(edited(tmp_path, F=np.full(2000, np.nan)), "'F [kN]'", "no number")


@pytest.mark.parametrize("ending", ["csv", "csv.gz", "parquet", "mat"])
@pytest.mark.parametrize(
    "content",
    [b"", b"time [s],u [V]\n0,1\n", bytes(range(256)) * 40, gzip.compress(b"ab\xff")],
    ids=["empty", "text", "binary", "gzip"],
)
def test_not_what_its_name_says(tmp_path: Path, ending: str, content: bytes) -> None:
    path = tmp_path / f"log.{ending}"
    path.write_bytes(content)
    line = refusal(path)
    if content == b"":
        assert "empty" in line
    elif ending != "csv" or not content.startswith(b"time"):
        assert "not a readable" in line


def test_gz_cut_short(tmp_path: Path) -> None:
    whole = gzip.compress(edited(tmp_path).read_bytes())
    (tmp_path / "log.csv.gz").write_bytes(whole[: len(whole) // 2])
    refusal(tmp_path / "log.csv.gz", "not a readable gzipped CSV file")


def test_no_file_and_unknown_kind(tmp_path: Path) -> None:
    refusal(tmp_path / "none.csv", "no such file")
    refusal(edited(tmp_path).rename(tmp_path / "log.doc"), "not a kind of log")
    refusal(edited(tmp_path).rename(tmp_path / "log.xlsx"), "not a readable Excel file")


def test_mat_with_bad_vectors(tmp_path: Path) -> None:
    values, said = vectors()
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, values)
    refusal(path, "'time' has no unit", "time_unit = 's'", "[channels] time")
    scipy.io.savemat(path, {**values, "units": said, "F": values["F"][:-1]})
    refusal(path, "'F' has 1999 values", "2000")
    scipy.io.savemat(path, {**values, "units": said, "F": np.eye(30)})
    refusal(path, "'F' is not a vector")
    scipy.io.savemat(path, {**values, "units": said, "F": values["F"] + 1j})
    refusal(path, "'F'", "not a number")


def test_mat_unit_from_the_rig_file(tmp_path: Path) -> None:
    values, _ = vectors()
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, {k: values[k] for k in ("time", "psi")} | {"q": 1.0})
    channels = {
        "time": Channel(column="time", unit="s"),
        "psi": Channel(column="psi", unit="deg"),
    }
    log = Log.load(path, channels)
    np.testing.assert_allclose(log.signals["psi"], np.deg2rad(values["psi"]))
    assert log.ignored == ("q",)


# Units


@pytest.mark.parametrize(
    ("text", "want", "value"),
    [
        ("8e8 Pa", "Pa", 8e8),
        ("60 um", "m", 60e-6),
        ("-0.5kN", "N", -500.0),
        ("0", "1", 0.0),
        ("0.7", "1", 0.7),
        (0.7, "1", 0.7),
        ("5 %", "1", 0.05),
        ("0.01 1/N", "1/N", 0.01),
        ("1257 rad/s", "rad/s", 1257.0),
        ("1257 rad/s", "1/s", 1257.0),
        ("60 rpm", "rad/s", 2.0 * np.pi),
        ("2.3e-9 m^3/(s*V*Pa^0.5)", "m^3/(s*V*Pa^0.5)", 2.3e-9),
        ("1 l/(min*mV*bar^0.5)", "m^3/(s*V*Pa^0.5)", 1.0 / 60.0 / 1e5**0.5),
    ],
)
def test_quantity(text: object, want: str, value: float) -> None:
    assert units.quantity(text, want, "here") == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "want", "words"),
    [
        ("0", "N", ("has no unit", '"0 N"')),
        (5, "Pa", ("has no unit", '"5 Pa"')),
        ("5", "rad", ("has no unit",)),
        ("5 m", "N", ("'m' does not fit", "N")),
        ("5 m", "1", ("'m' does not fit", "plain number")),
        ("5 newtonn", "N", ("unknown unit 'newtonn'",)),
        ("20 degC", "Pa", ("'degC'",)),
        ("3 dB", "1", ("'dB'",)),
        ("200 Hz", "rad/s", ("2*pi",)),
        ("five N", "N", ("not a quantity",)),
        ("", "N", ("not a quantity",)),
        ("inf N", "N", ("not a quantity",)),
        ("1e999 N", "N", ("not a quantity",)),
        (True, "1", ("not a quantity",)),
        (["5 N"], "N", ("not a quantity",)),
        ("5 N\nm", "N", ("does not fit",)),
    ],
)
def test_bad_quantity(text: object, want: str, words: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as caught:
        units.quantity(text, want, "rig.toml: [load] F")
    line = str(caught.value)
    assert line.startswith("rig.toml: [load] F: ")
    assert "\n" not in line
    assert all(word in line for word in words)


def test_array_to_si() -> None:
    values = units.to_si(np.array([1.0, 2.0]), "bar", "Pa", "here")
    np.testing.assert_allclose(values, [1e5, 2e5])


@pytest.mark.parametrize(
    ("unit", "volts", "plain"),
    [
        ("m^3/(s*{u}*Pa^0.5)", "m^3/(s*V*Pa^0.5)", "m^3/(s*Pa^0.5)"),
        ("{u}", "V", "1"),
        ("N/{u}", "N/V", "N"),
        ("{u}/s", "V/s", "1/s"),
        ("Pa", "Pa", "Pa"),
    ],
)
def test_with_command(unit: str, volts: str, plain: str) -> None:
    assert units.with_command(unit, "V") == volts
    assert units.with_command(unit, "1") == plain


def test_a_table_is_read_as_a_file_is(tmp_path):
    frame = pd.DataFrame(a_run())
    frame.to_csv(tmp_path / "log.csv", index=False)
    one, other = Log.load(tmp_path / "log.csv"), Log.from_frame(frame)
    for name, values in one.signals.items():
        np.testing.assert_allclose(other.signals[name], values, rtol=1e-12)
    assert (one.units, one.segments) == (other.units, other.segments)


def test_a_table_has_its_units_beside_it_and_comes_back():
    plain = pd.DataFrame({k.split(" ")[0]: v for k, v in a_run().items()})
    units_of = {k.split(" ")[0]: k.split("[")[1][:-1] for k in a_run() if "[" in k}
    log = Log.from_frame(plain.set_index("time"), units=units_of)
    again = Log.from_frame(log.to_frame())
    np.testing.assert_array_equal(again.time, log.time)
    np.testing.assert_allclose(log.signals["P_a1"], 1e5 * plain["P_a1"])
    for name, values in log.signals.items():
        np.testing.assert_array_equal(again.signals[name], values)
    with pytest.raises(InputError, match="'P_a1' has no unit"):
        Log.from_frame(plain, units={k: u for k, u in units_of.items() if k != "P_a1"})


def test_a_late_column_is_brought_forward_in_each_stretch(tmp_path):
    """Over a gap nothing is; where a stretch ends a late column shows nothing yet."""
    run = a_run(4000)
    path = write(tmp_path / "log.csv", {n: np.delete(y, slice(2000, 2100))
                                        for n, y in run.items()})  # fmt: skip
    log = Log.load(path, {"psi": Channel(column="psi", delay="20 ms")})
    assert log.segments == ((0, 1980), (2000, 3880))
    wave = np.radians(20.0) * np.sin(9.0 * (log.time + 0.02))
    for start, stop in log.segments:
        found = log.signals["psi"][start:stop]
        np.testing.assert_allclose(found, wave[start:stop], atol=1e-9)
    np.testing.assert_allclose(log.signals["u"], 3.0 * np.sin(9.0 * log.time))


def test_an_early_column_shows_nothing_where_a_stretch_begins(tmp_path):
    """Beside a late one both ends are cut."""
    path = write(tmp_path / "log.csv", a_run(4000))
    given = {"psi": "-20 ms", "P_a1": "5 ms"}
    log = Log.load(path, {n: Channel(column=n, delay=d) for n, d in given.items()})
    ((start, stop),) = log.segments
    assert (start, stop) == (20, 3995)
    wave = np.radians(20.0) * np.sin(9.0 * (log.time - 0.02))
    np.testing.assert_allclose(log.signals["psi"][20:], wave[20:], atol=1e-9)


def test_the_time_is_not_late(tmp_path):
    channels = {"time": Channel(column="time", delay="5 ms")}
    refusal(write(tmp_path / "log.csv", a_run()), "time.delay", channels=channels)
