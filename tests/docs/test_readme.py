"""The commands and the Python of the README, run as printed on the demo's logs."""

from __future__ import annotations

import pytest

from tests.docs.shown import README, does_its_work
from tests.pages import ROOT, blocks

LONG = ("bounds",)
"""Commands that take minutes, and have tests of their own."""


def _marked(line: str):
    command = line.split()[1]
    mark = pytest.mark.study if command in LONG else pytest.mark.slow
    return pytest.param(line, marks=mark, id=command)


@pytest.mark.parametrize("line", [_marked(line) for line in README])
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
