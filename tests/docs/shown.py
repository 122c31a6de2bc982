"""What README and pages show to be typed, and whether it does its work."""

from __future__ import annotations

import shlex
from pathlib import Path

from tests.pages import ROOT, commands

SIZES = ("--bore", "40 mm", "--rod", "0 mm", "--stroke", "200 mm", "--radius", "85 mm")
"""What `init` asks at a terminal."""


def plain(line: str) -> str:
    """A command without its comment."""
    return line.partition("#")[0].strip()


README = list(dict.fromkeys(map(plain, commands(ROOT / "README.md"))))


def written(folder: Path) -> set[tuple[Path, int]]:
    return {(p, p.stat().st_mtime_ns) for p in folder.rglob("*") if p.is_file()}


def does_its_work(line: str, call, desk: Path) -> None:
    command, _, file = line.partition(" > ")
    words = shlex.split(command)[1:]
    words = [p for w in words for p in (sorted(map(str, desk.glob(w))) or [w])]
    if words[0] == "compare":  # two reports: of one log, and of two
        logs = ["fit_1.csv", "fit_2.csv"]
        for out, fitted in zip(words[1:], (logs[:1], logs), strict=True):
            options = ["--validate", "other.csv", "--out", out]
            assert call("identify", "rig.toml", *fitted, *options).code == 0
    if words[0] == "init":
        words += SIZES
    before = written(desk)
    done = call(*words)
    # Gains that are no better than those of the rig file are not proposed: exit 1.
    assert done.code == 0 or (words[0] == "tune" and done.code == 1), done.err
    assert "Traceback" not in done.err
    if file:
        assert "[geometry]" in done.out
    elif words[0] not in ("check", "compare"):
        assert written(desk) - before, done.out


def new_lines(page: str) -> list[str]:
    """Commands of a page that the README does not show."""
    shown = map(plain, commands(ROOT / f"docs/{page}.md"))
    lines = [line for line in shown if line not in README]
    assert lines
    return lines
