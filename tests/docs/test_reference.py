"""The reference pages are what the declarations say today."""

from __future__ import annotations

import inspect
import json
import re

import jsonschema
import numpy as np
import pytest

import hydrojax as hj
from benchmarks import reference
from benchmarks.reference.known import FOLDER, KNOWN, MEASURED
from benchmarks.reference.signatures import digest, look_alikes
from hydrojax.effects import EFFECTS
from hydrojax.effects.friction import Stribeck
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


def test_every_effect_has_its_picture_and_how_to_tell_it(shipped):
    """`python -m benchmarks.reference.signatures` draws and measures them anew."""
    measured = json.loads(MEASURED.read_text())
    assert set(measured) == set(KNOWN) == set(EFFECTS)
    for name, kind in EFFECTS.items():
        assert (FOLDER / f"{name}.png").stat().st_size < 60_000
        stale = measured[name]["digest"] != digest(kind)
        assert not stale, f"{name}: run python -m benchmarks.reference.signatures"
    assert {p.stem for p in FOLDER.glob("*.png")} == set(EFFECTS)


def test_a_changed_law_makes_a_picture_stale(monkeypatch):
    before = digest(Stribeck)
    changed = inspect.getsource(Stribeck).replace("** 2", "** 3")
    monkeypatch.setattr(inspect, "getsource", lambda _: changed)
    assert digest(Stribeck) != before
    monkeypatch.setattr(
        inspect, "getsource", lambda _: changed.replace("** 3", "** 2") + "\n# why"
    )
    assert digest(Stribeck) == before


def test_effects_that_are_one_thing_are_look_alikes():
    """Of columns with known angles: a share is a squared cosine."""
    own = np.eye(3)
    table = {"a": own[:1], "b": own[:1] + own[1:2], "c": own[2:], "d": own[:2]}
    found = look_alikes(table, least=0.4)
    assert found["a"] == {"d": 1.0, "b": 0.5} and found["c"] == {}
    assert found["b"] == {"d": 1.0, "a": 0.5}


def test_every_public_name_has_its_signature():
    page = reference.pages()["api.md"]
    for name in hj.__all__:
        assert f"## hj.{name}\n" in page
    assert "hj.fit(\n    rig: RigSource," in page
    assert "- `InputError`: whatever is wrong with rig or logs, in one line." in page
    assert "**`predict(log: LogSource) -> pd.DataFrame`**" in page


def test_every_argument_of_a_public_name_is_described():
    """Those of functions, and of methods that take any, in their docstrings."""
    for name in hj.__all__:
        thing = getattr(hj, name)
        if inspect.isfunction(thing):
            said = inspect.getdoc(thing) or ""
            for argument in inspect.signature(thing).parameters:
                assert re.search(rf"^ *(\w+, )?{argument}\b.*:", said, re.M), (
                    f"{name}: {argument}"
                )


def test_the_schema_of_reports_is_one():
    jsonschema.Draft202012Validator.check_schema(report_schema())


def test_every_key_of_a_report_has_a_meaning():
    schema = report_schema()
    shapes = {"report": schema, **schema["$defs"]}
    dumb = [
        f"{name}.{key}"
        for name, shape in shapes.items()
        for key, said in shape["properties"].items()
        if not said.get("description")
    ]
    assert dumb == []
    page = reference.pages()["report.md"]
    assert "### channels.horizons" in page and "| `arx` | number or null | of a" in page
