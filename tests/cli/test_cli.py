"""The command line: what it refuses, in one line and without a trace, and what it does.

`main()` runs in this process wherever that shows the same as a process of its own.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.io

from hydrojax import __version__, api, cli
from tests.conftest import Said
from tests.pages import ROOT, TUTORIAL, blocks, commands, differences

RIG = """\
name = "bench"
layout = "pull-pull"

[geometry]
area = "1.18e-3 m^2"
chamber_length = "0.2 m"
radius = "0.085 m"

[supply]
P_s = "14 MPa"
P_r = "0.25 MPa"

[parameters]
beta = { start = "8e8 Pa", range = ["1e8 Pa", "3e9 Pa"] }
c_p1 = { start = "2e-9 m^3/(s*V*Pa^0.5)", range = ["2e-10 m^3/(s*V*Pa^0.5)", \
"2e-8 m^3/(s*V*Pa^0.5)"] }
k_cp = { start = "900 N", range = ["0 N", "4000 N"] }
"""


def columns(rows: int = 3000) -> dict[str, np.ndarray]:
    """A log that can be read, by `name [unit]`; nobody fits it."""
    t = 1e-3 * np.arange(rows)
    noise = np.random.default_rng(0).normal(size=(rows, 4))
    wave = np.sin(9 * t)
    return {
        "time [s]": t,
        "u [V]": 2 * np.cos(20 * t),
        "psi [rad]": 0.1 * wave + 0.01 * np.sin(60 * t),
        "P_a1 [bar]": 70 + 5 * wave + 0.1 * noise[:, 0],
        "P_a2 [bar]": 70 - 5 * wave + 0.1 * noise[:, 1],
        "P_s [bar]": 140 + 0.1 * noise[:, 2],
        "F [kN]": 0.5 * wave + 0.003 * noise[:, 3],
    }


def without(*names: str) -> dict[str, np.ndarray]:
    return {k: v for k, v in columns().items() if k.split(" ")[0] not in names}


def renamed(old: str, new: str) -> dict[str, np.ndarray]:
    assert old in columns()
    return {new if k == old else k: v for k, v in columns().items()}


def changed(name: str, change: Callable[[np.ndarray], object]) -> dict:
    log = columns()
    log[name] = log[name].copy()
    log[name] = change(log[name])
    return log


def at(index: slice | int, value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(y: np.ndarray) -> np.ndarray:
        y[index] = value
        return y

    return change


@pytest.fixture
def bench(tmp_path) -> Path:
    """A folder with a sound rig.toml and log.csv."""
    (tmp_path / "rig.toml").write_text(RIG)
    save(tmp_path / "log.csv", columns())
    return tmp_path


def save(path: Path, log: dict) -> Path:
    pd.DataFrame(log).to_csv(path, index=False)
    return path


def refused(said: Said, out: Path, *words: str) -> str:
    """The one line of a refusal; nothing else was said, and nothing written."""
    assert said.code == 2, said
    assert said.out == ""
    assert "Traceback" not in said.err
    lines = said.err.strip().splitlines()
    assert len(lines) == 1, said.err
    for word in words:
        assert word in lines[0]
    assert not out.exists()
    return lines[0]


# -- logs that will not do --

BAD_LOGS = {
    "no position": (without("psi"), ("no motion", "x [m]", "psi [rad]")),
    "nothing drives": (
        without("u", "P_a1", "P_a2"),
        ("nothing drives", "u [V]", "P_a1 [Pa]"),
    ),
    "half of what drives": (without("u", "P_a1"), ("nothing drives", "P_a1 [Pa]")),
    "nothing to predict under u": (
        without("P_a1", "P_a2", "P_s", "F"),
        ("nothing to predict", "F [N]"),
    ),
    "nothing to predict under pressures": (
        without("u", "F"),
        ("nothing to predict", "F [N]"),
    ),
    "no time": (without("time"), ("time", "time [s]")),
    "wrong dimension": (renamed("P_a1 [bar]", "P_a1 [N]"), ("P_a1 [N]", "Pa")),
    "no such unit": (renamed("F [kN]", "F [kNN]"), ("F [kNN]",)),
    "no unit": (renamed("P_a2 [bar]", "P_a2"), ("P_a2", "no unit")),
    "u without unit": (renamed("u [V]", "u"), ("'u'", "u [V]")),
    "u in amperes": (renamed("u [V]", "u [A]"), ("u [A]", "V")),
    "NaN everywhere": (
        changed("F [kN]", at(slice(None), np.nan)),
        ("F [kN]", "no number"),
    ),
    "NaN in every stretch": (
        changed("P_a1 [bar]", at(np.r_[0:3000:300, 1:3000:300], np.nan)),
        ("no stretch", "P_a1"),
    ),
    "NaN so that no window fits": (
        changed("P_a1 [bar]", at(np.r_[600:3000:600, 601:3000:600], np.nan)),
        ("no stretch", "horizon"),
    ),
    "text in a cell": (
        changed("u [V]", lambda y: ["n/a!" if i == 7 else v for i, v in enumerate(y)]),
        ("u [V]", "n/a!", "row 8", "line 9"),
    ),
    "time repeats": (
        changed("time [s]", at(1000, 0.999)),
        ("time [s]", "repeats", "row 1001", "line 1002"),
    ),
    "time falls": (
        changed("time [s]", at(1000, 0.5)),
        ("time [s]", "falls", "row 1001", "line 1002"),
    ),
    "time missing": (
        changed("time [s]", at(10, np.nan)),
        ("time [s]", "missing", "row 11", "line 12"),
    ),
    "a command once a second": (
        columns() | {"time [s]": 1.0 * np.arange(3000)},
        ("a row every 1 s", "20 Hz"),
    ),
    "three rows": ({k: v[:3] for k, v in columns().items()}, ("50 rows", "it has 3")),
    "a sensor at rest": (
        changed("P_a2 [bar]", at(slice(None), 70.0)),
        ("P_a2 [bar]", "does not move"),
    ),
    "a position at rest": (
        changed("psi [rad]", at(slice(None), 0.1)),
        ("psi [rad]", "does not move"),
    ),
    "one column": ({"time;u;psi": np.arange(100.0)}, ("time",)),
}


@pytest.mark.parametrize("what", BAD_LOGS)
def test_a_bad_log_is_refused_in_one_line(call, bench, what):
    log, words = BAD_LOGS[what]
    bad = save(bench / "bad.csv", log)
    out = bench / "out"
    refused(call("identify", bench / "rig.toml", bad, "--out", out), out, "bad", *words)


def test_the_refused_validation_log_is_named(call, bench):
    bad = save(bench / "bad.csv", changed("time [s]", at(1000, 0.5)))
    out = bench / "out"
    given = ("trace", bench / "rig.toml", bench / "log.csv", "--validate", bad)
    refused(call(*given, "--out", out), out, "bad.csv", "falls")


def test_logs_must_agree_in_their_columns(call, bench):
    odd = save(bench / "odd.csv", without("F"))
    out = bench / "out"
    given = ("identify", bench / "rig.toml", bench / "log.csv", "--validate", odd)
    line = refused(call(*given, "--out", out), out, "odd.csv", "log.csv", "columns")
    assert "(F)" in line


def as_mat(bench: Path, text: str) -> Path:
    (bench / "bad.mat").write_text(text)
    return bench / "bad.mat"


def as_parquet(bench: Path, text: str) -> Path:
    (bench / "bad.parquet").write_text("dear reader\n")
    return bench / "bad.parquet"


def as_gz(bench: Path, text: str) -> Path:
    (bench / "bad.csv.gz").write_text(text)
    return bench / "bad.csv.gz"


def as_nothing(bench: Path, text: str) -> Path:
    return bench / "bad.csv"


def as_empty(bench: Path, text: str) -> Path:
    (bench / "bad.csv").write_text("")
    return bench / "bad.csv"


def as_folder(bench: Path, text: str) -> Path:
    (bench / "bad.csv").mkdir()
    return bench / "bad.csv"


def as_text(bench: Path, text: str) -> Path:
    (bench / "bad.doc").write_text(text)
    return bench / "bad.doc"


def as_unitless_mat(bench: Path, text: str) -> Path:
    plain = {k.split(" ")[0]: v for k, v in columns().items()}
    scipy.io.savemat(bench / "bad.mat", plain)
    return bench / "bad.mat"


@pytest.mark.parametrize(
    "make, word",
    [
        (as_mat, "MAT"),
        (as_parquet, "Parquet"),
        (as_gz, "gzip"),
        (as_nothing, "no such file"),
        (as_empty, "empty"),
        (as_folder, "bad.csv"),
        (as_text, ".parquet"),
        (as_unitless_mat, "_unit"),
    ],
)
def test_a_file_that_is_no_log_is_refused(call, bench, make, word):
    bad = make(bench, (bench / "log.csv").read_text())
    out = bench / "out"
    given = ("identify", bench / "rig.toml", bad, "--out", out)
    refused(call(*given), out, bad.name, word)


# -- rigs that will not do --


def test_a_rig_file_that_is_not_there_is_said_to_be_missing(call, bench):
    for name in ("rigg.toml", "rig.toml/rig.toml"):
        found = call("identify", bench / name, bench / "log.csv")
        refused(found, bench / "hydrojax-identify", name, "no such file", "path")


BAD_RIGS = {
    "misspelt parameter": ("beta =", "betta =", ("betta", "did you mean 'beta'")),
    "misspelt section": ("[geometry]", "[geometri]", ("geometri",)),
    "unknown layout": ('"pull-pull"', '"pull-push"', ("layout", "pull-pull")),
    "range upside down": (
        '["0 N", "4000 N"]',
        '["4000 N", "0 N"]',
        ("k_cp", "upside down"),
    ),
    "start outside": ('"900 N"', '"9000 N"', ("k_cp", "outside")),
    "no unit": ('"900 N"', '"900"', ("k_cp", "N")),
    "wrong unit": ('"1.18e-3 m^2"', '"1.18e-3 m"', ("area", "m^2")),
    "geometry missing": ('area = "1.18e-3 m^2"\n', "", ("area", "missing")),
    "no TOML": ("[geometry]", "[geometry", ("TOML",)),
    "unknown effect": (
        "[parameters]",
        '[effects.internal_leak]\nc_il = "1e-12 m^3/(s*Pa)"\n\n[parameters]',
        ("internal_leak", "internal_leakage"),
    ),
    "radius missing for psi": ('radius = "0.085 m"\n', "", ("psi", "radius")),
    "column that is not there": (
        "[parameters]",
        '[channels]\nu = { column = "MainU", unit = "V" }\n\n[parameters]',
        ("MainU",),
    ),
    "constants for a command of 1, log in V": (
        "m^3/(s*V*Pa^0.5)",
        "m^3/(s*Pa^0.5)",
        ("log.csv", "[V]", "per [1]"),
    ),
}


@pytest.mark.parametrize("what", BAD_RIGS)
def test_a_bad_rig_is_refused_in_one_line(call, bench, what):
    old, new, words = BAD_RIGS[what]
    assert old in RIG
    (bench / "rig.toml").write_text(RIG.replace(old, new))
    out = bench / "out"
    given = ("identify", bench / "rig.toml", bench / "log.csv", "--out", out)
    refused(call(*given), out, *words)


def test_a_rig_without_anything_to_find_is_refused(call, bench):
    (bench / "rig.toml").write_text(RIG.partition("[parameters]")[0])
    out = bench / "out"
    given = ("identify", bench / "rig.toml", bench / "log.csv", "--out", out)
    refused(call(*given), out, "rig.toml", "nothing to identify", "range")


def test_a_missing_rig_is_refused(call, bench):
    out = bench / "out"
    given = ("identify", bench / "rigg.toml", bench / "log.csv", "--out", out)
    refused(call(*given), out, "rigg.toml")


# -- options that will not do --


def refuse_to_work(*_: object, **__: object) -> None:
    raise AssertionError("the logs were read before --out was seen to be no folder")


@pytest.mark.parametrize("below", ["", "sub", "sub/sub"])
def test_out_must_be_a_folder_and_is_looked_at_first(call, bench, monkeypatch, below):
    monkeypatch.setattr(api, "open_case", refuse_to_work)
    file = bench / "report"
    file.write_text("mine")
    given = ("identify", bench / "rig.toml", bench / "log.csv", "--out", file / below)
    refused(call(*given), bench / "no folder", "report", "--out")
    assert file.read_text() == "mine"


@pytest.mark.parametrize("horizon", ["nan", "inf", "60", "0", "-1", "soon"])
def test_a_horizon_that_will_not_do(call, bench, horizon):
    out = bench / "out"
    given = ("identify", bench / "rig.toml", bench / "log.csv", "--out", out)
    said = call(*given, "--horizon", horizon)
    assert said.code == 2
    assert "Traceback" not in said.err
    assert "horizon" in said.err
    assert not out.exists()


def test_what_is_missing_from_the_line_is_named(call, bench):
    said = call("trace", bench / "rig.toml", bench / "log.csv")
    assert said.code == 2
    assert "--validate" in said.err
    assert "Traceback" not in said.err


# -- what is well --


@pytest.mark.parametrize("command", [(), ("identify",), ("trace",), ("demo",)])
def test_help(call, command):
    said = call(*command, "--help")
    assert said.code == 0
    assert said.err == ""
    for word in ("--out",) if command else ("identify", "trace", "demo"):
        assert word in said.out


def test_version(call):
    said = call("--version")
    assert said.code == 0
    assert said.out.split() == ["hydrojax", __version__]


def test_a_process_of_its_own(bench, cache_home):
    """Exit code, stderr and folder as a shell sees them."""
    bad = save(bench / "bad.csv", changed("time [s]", at(1000, 0.5)))
    command = [sys.executable, "-m", "hydrojax.cli", "identify", "rig.toml", bad.name]
    env = os.environ | {"XDG_CACHE_HOME": str(cache_home)}
    done = subprocess.run(command, cwd=bench, env=env, capture_output=True, text=True)
    said = Said(done.returncode, done.stdout, done.stderr)
    refused(said, bench / "hydrojax-identify", "bad.csv", "falls")
    assert done.stderr.startswith("hydrojax: ")
    assert done.stderr.count("\n") == 1


KEYS = {
    "format": str, "command": str, "rig": str, "logs": dict, "verdict": str,
    "parameters": dict, "channels": dict, "effects": list, "candidates": list,
    "unexplained": list, "seconds": dict,
}  # fmt: skip


@pytest.fixture(scope="module")
def tutorial(tmp_path_factory) -> Path:
    """Where the tutorial's commands are run: a folder with the package's demo."""
    folder = tmp_path_factory.mktemp("tutorial")
    (folder / "hydrojax").symlink_to(ROOT / "hydrojax")
    return folder


@pytest.mark.slow
def test_identify_writes_the_contracts_report(call, tutorial, monkeypatch):
    """By the tutorial's command, which prints what the tutorial shows."""
    (line,) = (c for c in commands(TUTORIAL) if " identify " in c)
    (shown,) = (b for b in blocks(TUTORIAL, "text") if "Try trace" in b)
    monkeypatch.chdir(tutorial)
    said = call(*shlex.split(line)[1:])
    assert said.code == 0, said.err
    assert differences(shown, said.out) == []
    out = tutorial / "declared"
    report = json.loads((out / "report.json").read_text())
    for key, kind in KEYS.items():
        assert isinstance(report[key], kind), key
    assert report["format"] == "hydrojax-report/1"
    assert report["command"] == "identify"
    assert report["logs"] == {
        "fit": ["fit_1.csv.gz", "fit_2.csv.gz"],
        "validate": ["validate.csv.gz"],
        "test": [],
    }
    assert set(report["channels"]) == {"P_a1", "P_a2", "F"}
    for channel in report["channels"].values():
        assert set(channel) == {
            "unit",
            "noise",
            "before",
            "after",
            "held",
            "skill",
            "horizons",
        }
        assert channel["after"] < channel["before"]
    assert report["channels"]["P_a1"]["noise"] == 9000.0
    assert report["channels"]["F"]["noise"] == 2.5
    wanted = {"value", "std", "unit", "interval", "start", "at_bound", "identified"}
    for name, parameter in report["parameters"].items():
        assert wanted <= set(parameter), name
    beta = report["parameters"]["beta"]
    assert beta["unit"] == "Pa"
    low, high = beta["interval"]
    assert low < beta["value"] < high
    assert low == pytest.approx(beta["value"] - 1.96 * beta["std"])
    assert report["effects"] == report["candidates"] == []
    assert set(report["seconds"]) == {"compile", "run"}
    page = (out / "report.html").read_text()
    assert "<html" in page and "beta" in page
    assert list(out.glob("*.png"))
    assert report["verdict"] in said.out
    for channel in report["channels"]:
        assert channel in said.out


def test_validate_takes_all_the_logs_that_follow():
    words = "trace r a b --validate c d --out o --validate=e"
    assert cli.spread(words.split()) == [
        *("trace", "r", "a", "b", "--validate", "c", "--validate", "d"),
        *("--out", "o", "--validate=e"),
    ]
