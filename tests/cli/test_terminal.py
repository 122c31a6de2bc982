"""What a terminal shows: help, one-line errors, verdicts whole, exit codes."""

from __future__ import annotations

import io
import json
from types import SimpleNamespace

import pytest
from rich.console import Console

from hydrojax import api
from hydrojax.cli import identify
from hydrojax.report.files import digest
from tests.pages import ROOT

DEMO = ROOT / "hydrojax/demo"
COMMANDS = (
    "check", "identify", "trace", "demo", "simulate", "excite", "bounds", "paper",
    "sweep", "tune", "batch", "export", "init", "compare",
)  # fmt: skip
SENTENCE = (
    "stribeck was found and added and takes away 42 % of the squared error above the "
    "noise, but no known effect explains the residual of F: F stays 62.9 N RMS above "
    "its noise; 22 % of the residual variance correlates with v (p 0.01), more than "
    "with any other signal of the log."
)


@pytest.mark.parametrize("command", COMMANDS)
def test_short_help_and_brackets(call, command):
    said = call(command, "-h")
    assert said.code == 0 and said.err == ""
    assert said.out.startswith(f"Usage: hydrojax {command}")
    assert "of  " not in said.out
    if command in ("simulate", "sweep"):
        assert "[controller]" in said.out


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("trase", "No such command 'trase'"),
        ("tune rig.toml --speed 3", "No such option: --speed"),
        ("trace rig.toml log.csv", "Missing option '--validate'"),
        ("identify", "Missing argument"),
        ("identify rig.toml log.csv --horizon soon", "Invalid value for '--horizon'"),
        ("identify rig.toml log.csv --fail-on unknwon", "did you mean 'unknown'?"),
    ],
)
def test_usage_errors_are_one_line(call, line, words):
    said = call(*line.split())
    assert said.code == 2
    assert said.err.startswith("hydrojax: ") and said.err.count("\n") == 1
    assert words in said.err


@pytest.mark.parametrize("width", [80, 120])
def test_a_verdict_is_wrapped_at_words(width, monkeypatch):
    out = io.StringIO()
    monkeypatch.setattr(identify, "console", Console(file=out, width=width))
    identify.print_outcome(outcome("unknown"))
    lines = out.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    verdict = lines[: lines.index("")]
    assert " ".join(" ".join(verdict).split()) == f"unknown {SENTENCE}"


def outcome(verdict: str) -> SimpleNamespace:
    """As much of an outcome as a terminal shows."""
    return SimpleNamespace(
        test_logs=(),
        verdict=verdict, sentence=SENTENCE, channels={}, effects=(), inputs=(),
        limits=(), notes=(), curves=(), seconds={"compile": 1.0, "run": 1.0},
    )  # fmt: skip


@pytest.fixture
def fitted(monkeypatch, tmp_path):
    """`identify` without the work: what it comes to, and whether it was saved."""
    saved = []
    result = SimpleNamespace(
        outcome=outcome("unknown"), save=lambda folder, _: saved.append(folder)
    )
    monkeypatch.setattr(api, "fit", lambda *_, **__: result)
    words = ("identify", DEMO / "rig.toml", DEMO / "fit_1.csv.gz", "--out", tmp_path)
    return words, saved


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ((), 0),
        (("--fail-on", "unknown"), 1),
        (("--fail-on", "explained", "unknown", "-q"), 1),
        (("--fail-on", "explained"), 0),
        (("--fail-on", "nothing missing"), 0),
    ],
)
def test_the_exit_code_by_verdict(call, fitted, options, code):
    words, saved = fitted
    said = call(*words, *options)
    assert said.code == code and said.err == ""
    assert len(saved) == 1
    assert (said.out == "") == ("-q" in options)


def test_json_alone_is_printed(call, fitted, monkeypatch):
    """The file that was written, to the letter."""
    words, _ = fitted
    text = '{\n "verdict": "unknown",\n "made": "\u03c4"\n}\n'

    def save(folder, _):
        (folder / "report.json").write_text(text, encoding="utf-8")

    monkeypatch.setattr(api.fit(), "save", save)
    said = call(*words, "--json", "--fail-on", "unknown")
    assert said.code == 1
    assert said.out == text


def test_an_edited_rig_file_is_not_overwritten(call, fitted, tmp_path):
    words, saved = fitted
    rig = tmp_path / "rig.toml"
    rig.write_text("# mine\n")
    said = call(*words)
    assert said.code == 2 and "rig.toml: was edited" in said.err
    assert saved == [] and rig.read_text() == "# mine\n"
    record = {"rig_toml_sha256": digest(rig.read_bytes())}
    (tmp_path / "report.json").write_text(json.dumps(record))
    assert call(*words).code == 0
    rig.write_text("# mine, and more\n")
    assert call(*words).code == 2
