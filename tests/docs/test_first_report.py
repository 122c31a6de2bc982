"""From a lab's log to an explained report, by the commands of a page."""

from __future__ import annotations

import json
import shlex

import pytest

from hydrojax.rigfile.schema import RigFile
from tests.pages import ROOT, blocks, commands, differences

PAGE = ROOT / "docs/first_report.md"


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A folder with three logs of a German logger, as the page makes them."""
    folder = tmp_path_factory.mktemp("lab")
    (folder / "hydrojax").symlink_to(ROOT / "hydrojax")
    return folder


@pytest.mark.slow
def test_the_page_s_commands_end_in_an_explained_report(call, lab, monkeypatch):
    monkeypatch.chdir(lab)
    exec(next(blocks(PAGE, "python")), {})
    head, said, verdict = blocks(PAGE, "text")
    lines = (lab / "fit_1.csv").read_text().splitlines()[:2]
    assert head.split() == " ".join(lines).split()
    draft, check, trace, schema = commands(PAGE)
    words, _, file = draft.partition(" > ")
    drafted = call(*shlex.split(words)[1:])
    assert drafted.code == 0, drafted.err
    (lab / file).write_text(drafted.out)
    (shown,) = blocks(PAGE, "toml")
    assert shown in drafted.out
    checked = call(*shlex.split(check)[1:])
    assert checked.code == 0, checked.err
    assert differences(said, checked.out) == []
    traced = call(*shlex.split(trace)[1:])
    assert traced.code == 0, traced.err
    assert differences(verdict, traced.out) == []
    report = json.loads((lab / "report/report.json").read_text())
    assert report["verdict"] == "explained"
    (effect,) = report["effects"]
    assert effect["name"] == "stribeck"  # the truth of the demo's logs: 550 N, 4 mm/s
    assert abs(effect["parameters"]["k_st"]["value"] - 550) < 5
    found = RigFile.load(lab / "report/rig.toml")
    assert found.channels["P_a1"].column == "Druck A"
    assert call(*shlex.split(schema.partition(" > ")[0])[1:]).code == 0
