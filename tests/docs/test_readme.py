"""The commands of README and pages, each run as printed on the demo's logs."""

from __future__ import annotations

import gzip
import shlex
import shutil
from pathlib import Path

import pytest

from tests.pages import ROOT, commands

DEMO = ROOT / "hydrojax/demo"
LOGS = {
    "fit_1": ("fit_1", "fit", "log", "log_1"),
    "fit_2": ("fit_2", "log_2"),
    "validate": ("other", "validate"),
}
"""What the pages call the logs of the demo."""

SIZES = ("--bore", "40 mm", "--rod", "0 mm", "--stroke", "200 mm", "--radius", "85 mm")
"""What `init` asks at a terminal."""

PAGES = ("closed_loop", "figures", "interchange")
"""Those whose commands differ from the README's in more than a file or an option; the
tutorial and first_report have tests of their own.
"""


def plain(line: str) -> str:
    """A command without its comment."""
    return line.partition("#")[0].strip()


README = list(dict.fromkeys(map(plain, commands(ROOT / "README.md"))))


@pytest.fixture
def desk(tmp_path, monkeypatch) -> Path:
    """A folder that holds what the commands name."""
    for log, names in LOGS.items():
        text = gzip.decompress((DEMO / f"{log}.csv.gz").read_bytes())
        for name in names:
            (tmp_path / f"{name}.csv").write_bytes(text)
    shutil.copy(DEMO / "rig.toml", tmp_path)
    jobs = "job,rig,fit,validate\nA,rig.toml,fit_1.csv;fit_2.csv,other.csv\n"
    (tmp_path / "jobs.csv").write_text(jobs)
    monkeypatch.chdir(tmp_path)
    return tmp_path


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


@pytest.mark.slow
@pytest.mark.parametrize("line", README, ids=lambda x: x.split()[1])
def test_a_command_of_the_readme_does_its_work(line, call, desk):
    does_its_work(line, call, desk)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_the_commands_of_a_page_do_their_work(page, call, desk):
    """In their order."""
    shown = map(plain, commands(ROOT / f"docs/{page}.md"))
    lines = [line for line in shown if line not in README]
    assert lines
    for line in lines:
        does_its_work(line, call, desk)
