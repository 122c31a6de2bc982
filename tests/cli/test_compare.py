"""Two reports side by side."""

from __future__ import annotations

import json
from pathlib import Path

import pytest


def report(folder: Path, beta: float, std: float | None, **more) -> Path:
    """As much of a report as is compared; beta 2 MPa beside an effect of 3 MPa."""
    effect = {"name": "stribeck", "parameters": {"k_st": entry(550.0, 3.0, "N")}}
    content = {
        "format": "hydrojax-report/1",
        "rig": "demo",
        "logs": {"fit": ["a.csv"], "validate": ["v.csv"], "test": []},
        "verdict": "explained",
        "sentence": "All is well.",
        "parameters": {"beta": entry(beta, std, "Pa"), "P_s": entry(14e6, None, "Pa")},
        "channels": {"F": {"unit": "N", "after": 2.5}},
        "effects": [effect],
        **more,
    }
    folder.mkdir()
    (folder / "report.json").write_text(json.dumps(content))
    return folder


def entry(value: float, std: float | None, unit: str) -> dict:
    return {"value": value, "std": std, "unit": unit}


@pytest.fixture
def two(tmp_path):
    a = report(tmp_path / "before", 800e6, 3e6)
    channels = {"F": {"unit": "N", "after": 5.0}, "P_a1": {"unit": "Pa", "after": 9e3}}
    b = report(tmp_path / "after", 840e6, 4e6, effects=[], channels=channels)
    return a, b


def test_what_differs(call, two):
    said = call("compare", *two, "--json")
    assert said.code == 0, said.err
    found = json.loads(said.out)
    parameters = {p["name"]: p for p in found["parameters"]}
    assert set(parameters) == {"beta", "stribeck.k_st"}  # P_s is held in both
    assert parameters["beta"]["apart"] == pytest.approx(40 / 5)
    assert parameters["stribeck.k_st"]["b"] is None
    assert found["effects"] == [["stribeck", True, False]]
    assert {c["name"]: (c["a"], c["b"]) for c in found["channels"]} == {
        "F": (2.5, 5.0),
        "P_a1": (None, 9e3),
    }


def test_terminal_and_page(call, two, tmp_path):
    said = call("compare", *two, "--out", tmp_path / "page")
    assert said.code == 0, said.err
    assert "stribeck: found in before" in said.out
    assert "+5 %" in said.out and "+100 %" in said.out and "8.0" in said.out
    page = (tmp_path / "page/compare.html").read_text()
    assert "+5 %" in page and 'class="n bad">8.0' in page
    assert "judged on different logs" not in said.out


def test_other_logs_are_said(call, two, tmp_path):
    logs = {"fit": ["a.csv"], "validate": ["w.csv"], "test": []}
    other = report(tmp_path / "other", 1e9, None, logs=logs)
    assert "judged on different logs" in call("compare", two[0], other).out


def test_what_is_no_report(call, two, tmp_path):
    (tmp_path / "tuned").mkdir()
    said = call("compare", two[0], tmp_path / "tuned")
    assert said.code == 2 and "no report.json" in said.err
    (tmp_path / "tuned/report.json").write_text("{}")
    said = call("compare", two[0], tmp_path / "tuned")
    assert said.code == 2 and "not a report of identify or trace" in said.err
