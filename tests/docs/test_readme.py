"""The commands and the Python of the README, run as printed on the demo's logs."""

from __future__ import annotations

import pytest

from tests.docs.shown import README, does_its_work
from tests.pages import ROOT, blocks


@pytest.mark.slow
@pytest.mark.parametrize("line", README, ids=lambda x: x.split()[1])
def test_a_command_of_the_readme_does_its_work(line, call, desk):
    does_its_work(line, call, desk)


@pytest.mark.slow
def test_the_python_of_the_readme_does_its_work(desk):
    """On the demo's logs."""
    (code,) = blocks(ROOT / "README.md", "python")
    names: dict = {}
    exec(code, names)
    assert names["result"].verdict == "explained"
    assert [e.name for e in names["result"].effects] == ["stribeck"]
