"""A report.json that is read again: every damage is refused, in one line."""

from __future__ import annotations

import copy
import json
import time
from pathlib import Path

import jsonschema
import pytest

from hydrojax.cli.scenario import read_inputs
from hydrojax.errors import InputError
from hydrojax.logs.log import Log
from hydrojax.paper.records import reference
from hydrojax.report.files import OBSOLETE, READY
from hydrojax.report.record import read_report
from hydrojax.report.schema import report_schema
from hydrojax.rigfile.quantities import open_setting
from hydrojax.rigfile.schema import RigFile
from hydrojax.tune.findings import Findings
from hydrojax.workflows.fleet.jobs import read_jobs

SOUND = {
    "format": "hydrojax-report/1",
    "command": "identify",
    "rig": "bench",
    "logs": {"fit": ["a.csv"], "validate": [], "test": []},
    "verdict": "explained",
    "sentence": "All is well.",
    "parameters": {
        "beta": {"value": 8e8, "std": 8e6, "unit": "Pa", "interval": [7e8, 9e8]},
        "k_cp": {"value": 1e3, "std": None, "unit": "N"},
    },
    "channels": {"F": {"unit": "N", "noise": 1.0, "before": 2.0, "after": 1.0}},
    "effects": [
        {
            "name": "stribeck",
            "parameters": {"k_st": {"value": 5.0, "std": 1.0, "unit": "N"}},
        }
    ],
    "covariance": {"names": ["beta", "k_cp"], "matrix": [[4.0, 1.0], [1.0, 4.0]]},
}


def save(folder: Path, content: object) -> Path:
    text = content if isinstance(content, str) else json.dumps(content)
    (folder / "report.json").write_text(text)
    return folder


def refusal(folder: Path) -> str:
    began = time.process_time()
    with pytest.raises(InputError) as caught:
        read_report(folder)
    assert time.process_time() - began < 2
    line = str(caught.value)
    assert line.isprintable() and "report.json" in line and len(line) < 1300
    return line


def test_a_sound_report_is_read(tmp_path):
    report = read_report(save(tmp_path, SOUND))
    assert set(report.every_parameter) == {"beta", "k_cp", "stribeck.k_st"}
    assert report.covariance is not None and report.rig == "bench"


CANDIDATE = {"name": "stribeck", "status": "absent", "p_value": 0.5, "power": 0.9}

WRONG = {
    ("format",): ["hydrojax-report/99", 1, None],
    ("parameters",): [None, [], {"beta": 3}, {"\x1b[2J": {"value": 1.0, "unit": "N"}}],
    ("parameters", "beta"): [None, [], {}, {"value": "8e8", "unit": "Pa"}],
    ("parameters", "beta", "value"): ["NaN", float("nan"), float("inf"), [], True],
    ("parameters", "beta", "std"): [-1.0, float("nan"), "1", {}],
    ("parameters", "beta", "unit"): ["no unit", 3, None, "9^9^9^9"],
    ("channels", "F", "after"): [-1.0, float("inf"), "1"],
    ("effects",): [None, {}, [3], [{"name": "a"}], [{"parameters": {}}]],
    ("effects", 0, "name"): ["", 3, "a\nb", "n" * 1000],
    ("covariance",): [3, [], {}, {"names": [], "matrix": [[1.0]]}],
    ("covariance", "names"): [["beta"], ["beta", "beta"], "beta", None],
    ("covariance", "matrix"): [
        [], [[1.0]], [[1.0, 0.0], [0.0]], [[4.0, 1.0], [2.0, 4.0]],
        [[-4.0, 1.0], [1.0, 4.0]], [[1.0, 3.0], [3.0, 1.0]],
        [[float("nan"), 0.0], [0.0, 1.0]], [["a", 0.0], [0.0, 1.0]],
    ],
    ("logs",): [3, {"validate": "v.csv"}],
    ("rig",): [3, None, {}],
    ("verdict",): ["perfect", None, 1],
    ("candidates",): [{}, [{"name": "stribeck"}], [CANDIDATE | {"status": "maybe"}],
                      [CANDIDATE | {"p_value": 2.0}], [CANDIDATE | {"power": -1.0}]],
    ("channels", "F", "horizons"): [3, {"1": {"held": -1.0}}, {"1": 2.0}],
    ("parameters", "beta", "interval"): [[1.0], [1.0, 2.0, 3.0], ["a", "b"], 3.0],
    ("criteria",): [[], {"level": "small"}, {"level": float("nan")}],
    ("files",): [[{"name": "a.csv", "use": "fit", "rows": -1}]],
    ("seconds",): [{"compile": -1.0}, 3],
}  # fmt: skip


@pytest.mark.parametrize("where", WRONG)
def test_a_wrong_report_is_refused(tmp_path, where):
    for value in WRONG[where]:
        content = copy.deepcopy(SOUND)
        inner = content
        for key in where[:-1]:
            inner = inner[key]
        inner[where[-1]] = value
        refusal(save(tmp_path, content))
        if where[0] in ("format", "parameters", "effects"):
            del inner[where[-1]]
            if where[-1] not in ("beta", "std", "interval"):
                refusal(save(tmp_path, content))


def test_the_published_schema_is_what_is_read():
    """Whatever is wrong in its kind, and not only in its sense, fails there too."""
    schema = report_schema()
    jsonschema.validate(SOUND, schema)
    for where in (("format",), ("verdict",), ("candidates",), ("files",), ("rig",)):
        for value in WRONG[where]:
            with pytest.raises(jsonschema.ValidationError):
                jsonschema.validate({**SOUND, where[0]: value}, schema)


def test_a_number_that_is_none_is_refused_wherever_it_stands(tmp_path):
    for number in (float("nan"), float("inf")):
        refusal(save(tmp_path, SOUND | {"a key of another version": [{"b": number}]}))
    assert read_report(save(tmp_path, SOUND | {"a key of another version": 1}))


def test_bytes_that_are_no_report(tmp_path):
    whole = json.dumps(SOUND)
    for cut in range(0, len(whole), 41):
        refusal(save(tmp_path, whole[:cut]))
    for text in ("[]", "{}", "null", "3", "[" * 10**6, '{"a":' * 10**5, "9" * 10**6):
        refusal(save(tmp_path, text))
    (tmp_path / "report.json").write_bytes(b"\xff\xfe{}")
    refusal(tmp_path)
    (tmp_path / "report.json").unlink()
    assert "no report.json" in refusal(tmp_path)


def test_a_parameter_in_another_unit_than_the_rig_s_is_refused(tmp_path):
    """Furlongs are a unit, but not of a bulk modulus."""
    setting = open_setting(reference()[0])
    sound = {**SOUND, "effects": [], "covariance": None}
    assert "beta" in Findings.load(save(tmp_path, sound)).known(setting)
    wrong = copy.deepcopy(sound)
    wrong["parameters"]["beta"]["unit"] = "furlong"
    found = Findings.load(save(tmp_path, wrong))
    for use in (found.known, found.apply):
        with pytest.raises(InputError, match="beta is in furlong, not in Pa"):
            use(setting)


def test_a_report_that_was_decided_and_not_moved_is_read(tmp_path):
    """As a run leaves it that is killed between two renames, in a new folder."""
    ready = tmp_path / READY
    ready.mkdir()
    (ready / OBSOLETE).write_text("[]")
    save(ready, SOUND)
    assert read_report(tmp_path).rig == "bench"
    assert not ready.exists()


def test_names_that_no_path_can_have_are_refused_in_one_line():
    for name in ("n" * 10**6, "a\0b"):
        for read in (
            lambda name: read_report(name),
            lambda name: Log.load(f"{name}.csv"),
            lambda name: RigFile.load(f"{name}.toml"),
            lambda name: read_jobs(f"{name}.csv"),
            lambda name: read_inputs(reference()[0], reference=name),
        ):
            with pytest.raises(InputError) as caught:
                read(name)
            assert str(caught.value).isprintable() and len(str(caught.value)) < 1300
