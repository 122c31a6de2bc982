"""A rig file drafted from a log: what it holds follows from how the log was made."""

from __future__ import annotations

import io
import json
import math
import tomllib
from pathlib import Path

import jsonschema
import numpy as np
import pandas as pd
import pytest

from hydrojax.errors import InputError
from hydrojax.logs.log import Log
from hydrojax.rigfile.json_schema import rig_schema
from hydrojax.rigfile.schema import RigFile
from hydrojax.rigfile.sections import base_specs
from tests.pages import ROOT

T = 1e-3 * np.arange(4000)
X = 0.02 * np.sin(9 * T)
V = np.gradient(X, T)
AREA_1, AREA_2 = math.pi / 4 * (40e-3**2 - 25e-3**2), math.pi / 4 * 40e-3**2


def a_log(**more: np.ndarray) -> dict[str, np.ndarray]:
    """A cylinder of 40/25 mm: positive command and port A extend it; F is the push."""
    bore, rod = 40e5 + 5e5 * np.cos(9 * T), 50e5 - 5e5 * np.cos(9 * T)
    flow = AREA_2 * V
    return {
        "Zeit": 1000 * T,
        "Ventil_V": flow / (2.3e-8 * math.sqrt(7e6)),
        "Weg": 1000 * (0.15 + X),
        "p_A": bore / 1e5,
        "p_B": rod / 1e5,
        "Kraft": AREA_2 * bore - AREA_1 * rod,
        "Temp": 40 + 0 * T,
        **more,
    }


def written(path: Path, columns: dict[str, np.ndarray]) -> Path:
    pd.DataFrame(columns).to_csv(path, index=False, sep=";", decimal=",")
    return path


SIZES = {"bore": "40 mm", "rod": "25 mm", "stroke": "300 mm"}


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return written(tmp_path / "run.csv", a_log())


def test_columns_units_and_signs(log):
    rig = RigFile.from_log(log, **SIZES)
    assert rig.name == "run"
    assert rig.layout.name == "differential"
    np.testing.assert_allclose(rig.geometry["area_1"], AREA_1, rtol=1e-5)
    np.testing.assert_allclose(rig.geometry["area_2"], AREA_2, rtol=1e-5)
    assert rig.geometry["x_mid"] == 0.15
    found = {n: (c.column, c.unit, c.invert) for n, c in rig.channels.items()}
    assert found == {
        "time": ("Zeit", "ms", False),
        "u": ("Ventil_V", "V", True),  # positive fills chamber 1, which retracts
        "x": ("Weg", "mm", False),
        "P_a1": ("p_B", "bar", False),
        "P_a2": ("p_A", "bar", False),
        "F": ("Kraft", "N", False),
    }
    assert "# not used: Temp" in rig.text
    read = Log.load(log, rig.channels)
    np.testing.assert_allclose(read.signals["x"], 0.15 + X, atol=1e-9)


def test_one_pressure_and_a_drive_force(tmp_path):
    columns = a_log()
    del columns["p_B"]
    rig = RigFile.from_log(written(tmp_path / "one.csv", columns), **SIZES)
    assert rig.layout.name == "single" and rig.channels["P_a2"].column == "p_A"
    columns = {"t": T, "x_mm": 1e3 * X, "Antriebskraft_kN": V, "F_N": 900 * V}
    rig = RigFile.from_log(written(tmp_path / "axis.csv", columns))
    assert rig.layout.name == "driven-axis" and rig.supply == {}
    assert rig.channels["P"].unit == "kN"
    assert "beta" not in rig.parameters and "k_cp" in rig.parameters
    del columns["Antriebskraft_kN"]
    rig = RigFile.from_log(written(tmp_path / "bench.csv", columns))
    assert rig.layout.name == "tester" and rig.supply == {}
    level = rig.parameters["k_cp"]  # friction is all that the load cell sees
    assert level.range[1] > 900 * np.max(np.abs(V)) > level.start > 0
    assert rig.channels["F"].invert  # friction pulls back


def test_a_force_that_pulls_is_turned(tmp_path):
    columns = a_log()
    columns["Kraft"] = -columns["Kraft"]
    rig = RigFile.from_log(written(tmp_path / "run.csv", columns), **SIZES)
    assert rig.channels["F"].invert


def test_the_valve_constant_from_flow_and_from_the_rated_flow(log):
    """From the log: the flow was made with 2.3e-8; rated: Q = c u sqrt(dp)."""
    guessed = RigFile.from_log(log, supply="140 bar", **SIZES).parameters["c_p1"]
    assert guessed.start == pytest.approx(2.3e-8 * (1 + AREA_1 / AREA_2) / 2, rel=0.02)
    rated = RigFile.from_log(log, rated_flow="40 L/min", **SIZES).parameters["c_p1"]
    assert rated.start == pytest.approx(40e-3 / 60 / 10 / math.sqrt(35e5), rel=2e-3)


def test_every_parameter_stands_there_with_unit_range_and_meaning(log):
    text = RigFile.from_log(log, **SIZES).text
    for name, spec in base_specs().items():
        line = next(
            i for i in text.splitlines() if i.startswith((f"{name} ", f"# {name} "))
        )
        before = text.splitlines()[text.splitlines().index(line) - 1]
        assert spec.description in before
        assert spec.unit == "1" or spec.unit.split("*")[0].split("/")[0] in line


def test_without_a_force_friction_is_left_out(tmp_path):
    columns = a_log()
    del columns["Kraft"]
    rig = RigFile.from_log(written(tmp_path / "run.csv", columns), **SIZES)
    assert "k_cp" not in rig.parameters and "# k_cp =" in rig.text
    assert "beta" in rig.parameters


def test_names_that_tell_nothing_are_asked_for(tmp_path):
    columns = {f"ch{i}": values for i, values in enumerate(a_log().values())}
    path = written(tmp_path / "run.csv", columns)
    with pytest.raises(InputError, match=r"--column time=NAME"):
        RigFile.from_log(path, **SIZES)
    named = {"time": "ch0", "u": "ch1", "x": "ch2", "P_a2": "ch3", "P_a1": "ch4"}
    rig = RigFile.from_log(path, columns=named, **SIZES)
    assert {n: c.column for n, c in rig.channels.items()} == named


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"rod": "50 mm"}, "--rod: must be thinner"),
        ({"bore": "40"}, "has no unit"),
        ({"stroke": "-3 mm"}, "--stroke: '-3 mm' must be above 0"),
        ({"stroke": None}, "stroke is missing"),
        ({"layout": "diferential"}, "did you mean 'differential'"),
        ({"columns": {"u": "Ventill_V"}}, "did you mean 'Ventil_V'"),
    ],
)
def test_what_is_refused(log, changes, words):
    given = {k: v for k, v in {**SIZES, **changes}.items() if v is not None}
    with pytest.raises(InputError) as caught:
        RigFile.from_log(log, **given)
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_logs_of_two_loggers_are_refused(log, tmp_path):
    other = written(tmp_path / "other.csv", {"t": T, "u": X})
    with pytest.raises(InputError, match=r"other.csv: no column"):
        RigFile.from_log(log, other, **SIZES)


def test_the_command_prints_what_can_be_read(call, log, tmp_path):
    words = [w for k, v in SIZES.items() for w in (f"--{k}", v)]
    said = call("init", log, *words, "--column", "v")
    assert said.code == 2 and "write SIGNAL=COLUMN" in said.err
    said = call("init", log, *words, "--name", "press 3")
    assert said.code == 0, said.err
    rig = RigFile.from_text(said.out)
    assert rig.name == "press 3"
    said = call("init", log, "--bore", "40 mm", "--rod", "25 mm")
    assert said.code == 2 and "--stroke is missing" in said.err and said.out == ""


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_sizes_are_asked_for_until_they_are_sizes(call, log, monkeypatch):
    answers = ["40", "40 mm", "0 mm", "300 mm", "80 mm", "25 mm", "40 L/min"]
    monkeypatch.setattr("sys.stdin", Terminal("\n".join(answers) + "\n"))
    said = call("init", log, "--layout", "differential")
    assert said.code == 0, said.err
    assert said.err.count("Error: ") == 3
    assert "must be above 0" in said.err and "thinner than the bore" in said.err
    rig = RigFile.from_text(said.out)
    assert rig.geometry["area_2"] == pytest.approx(AREA_2, rel=1e-5)
    assert rig.geometry["area_1"] == pytest.approx(AREA_1, rel=1e-5)
    assert "CHECK: a guess" not in said.out
    flow = 40e-3 / 60 / 10 / math.sqrt(35e5)  # 10 V open the valve
    assert rig.parameters["c_p1"].start == pytest.approx(flow, rel=1e-2)


def test_a_valve_that_is_not_rated_is_guessed_and_marked(call, log, monkeypatch):
    """Without a question, since nothing that is needed is missing."""
    monkeypatch.setattr("sys.stdin", Terminal(""))
    said = call("init", log, *[w for k, v in SIZES.items() for w in (f"--{k}", v)])
    assert said.code == 0, said.err
    assert said.err == "" and said.out.count("CHECK: a guess; give --rated-flow") == 4


SHIPPED = sorted(ROOT.glob("hydrojax/**/*.toml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.name)
def test_the_schema_takes_what_the_program_takes(path):
    jsonschema.validate(tomllib.loads(path.read_text()), rig_schema())


def test_the_schema_takes_a_draft_and_refuses_what_the_program_refuses(log, call):
    tree = tomllib.loads(RigFile.from_log(log, **SIZES).text)
    schema = rig_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(tree, schema)
    ranged = {"start": "5 kg", "range": ["1 kg", "9 kg"]}
    moved = {"predicts": "x", "mass": ranged, "second_mass": "2 kg"}
    jsonschema.validate({**tree, "load": moved}, schema)
    wrong = [
        {**tree, "load": {"F": ranged}},
        {**tree, "layout": "round"},
        {**tree, "geometry": {"are": "1 m^2"}},
        {**tree, "parameters": {"beta": {"start": "1 Pa"}}},
        {**tree, "parameters": {"bet": "1 Pa"}},
        {**tree, "effects": {"valve_lag": {"omga": "1 rad/s"}}},
        {**tree, "channels": {"u": {"colum": "a"}}},
    ]
    for other in wrong:
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(other, schema)
    printed = call("init", "--schema")
    assert printed.code == 0 and json.loads(printed.out) == json.loads(
        json.dumps(schema)
    )


def of_seconds(path: Path, change=lambda columns: columns) -> Path:
    columns = {"time": T, **{n: c for n, c in a_log().items() if n != "Zeit"}}
    return written(path, change(columns))


def test_a_pressure_by_its_documented_name_has_no_unit_in_it(tmp_path):
    """The s of P_s is no second, and the psi of an angle no pressure."""
    supply = 140 + np.sin(T)
    path = written(tmp_path / "run.csv", a_log(P_s=supply))
    assert RigFile.from_log(path, **SIZES).channels["P_s"].unit == "bar"


def test_the_time_of_day_is_taken_beside_a_date(tmp_path):
    def dated(columns):
        return {"Date": np.full(T.size, "01.03.2024"), "Time": T} | {
            n: c for n, c in columns.items() if n != "time"
        }

    rig = RigFile.from_log(of_seconds(tmp_path / "run.csv", dated), **SIZES)
    assert rig.channels["time"].column == "Time"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda c: {n: y[:1] for n, y in c.items()}, "at least 50 rows, and it has 1"),
        (lambda c: c | {"Kraft": np.full(T.size, np.nan)}, "'Kraft' holds no number"),
        (lambda c: c | {"time": np.floor(T / 2)}, "time repeats"),
    ],
)
def test_a_log_that_none_can_be_is_refused(tmp_path, change, says, recwarn):
    with pytest.raises(InputError, match=says):
        RigFile.from_log(of_seconds(tmp_path / "run.csv", change), **SIZES)
    assert not recwarn.list
