"""The reference pages are what the declarations say today."""

from __future__ import annotations

import jsonschema
import pytest

from benchmarks import reference
from hydrojax.effects import EFFECTS
from hydrojax.report.schema import report_schema


@pytest.fixture
def shipped(monkeypatch):
    """Without the effects that other tests have registered."""
    for name, kind in list(EFFECTS.items()):
        if not kind.__module__.startswith("hydrojax.effects"):
            monkeypatch.delitem(EFFECTS, name)


def test_the_pages_are_not_stale(shipped):
    """`python -m benchmarks.reference` writes them anew."""
    for name, text in reference.pages().items():
        kept = (reference.FOLDER / name).read_text(encoding="utf-8")
        assert kept == text, f"{name}: run python -m benchmarks.reference"


def test_every_declaration_has_its_line(shipped):
    pages = reference.pages()
    for name in ("beta", "k_fp", "L_rate", "delta_2"):
        assert f"| `{name}`" in pages["parameters.md"]
    for name in EFFECTS:
        assert f"## {name}\n" in pages["effects.md"]
    assert "`--fail-on`" in pages["commands.md"] and "## init\n" in pages["commands.md"]
    assert "| `k_p` | `V/kN` | 1.2 |" in pages["rig_file.md"]


def test_the_schema_of_reports_is_one():
    jsonschema.Draft202012Validator.check_schema(report_schema())
