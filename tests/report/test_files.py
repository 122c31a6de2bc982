"""Files that are written together: full disks, kills, other file systems, two runs."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hydrojax.errors import InputError
from hydrojax.report import files
from hydrojax.report.files import claim, claim_file, settle, write_all, write_one

OLD = {"report.json": b"old", "rig.toml": b"old", "report_loop.png": b"old"}
NEW = {"report.json": b"new", "rig.toml": b"new"}


def contents(folder: Path) -> dict[str, bytes]:
    """Files by name; drafts are folders."""
    return {p.name: p.read_bytes() for p in sorted(folder.iterdir()) if p.is_file()}


def test_new_files_replace_old_ones_and_leave_the_rest(tmp_path):
    write_all(tmp_path, OLD | {"notes.txt": b"mine"})
    write_all(tmp_path, NEW, obsolete=["report_loop.png", "report.json"])
    assert contents(tmp_path) == NEW | {"notes.txt": b"mine"}


@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="needs two file systems")
def test_a_folder_on_another_file_system_than_the_one_above(tmp_path):
    shared = Path("/dev/shm") / f"hydrojax-{os.getpid()}"
    shared.mkdir()
    try:
        assert shared.stat().st_dev != tmp_path.stat().st_dev
        (tmp_path / "out").symlink_to(shared)
        write_all(tmp_path / "out", NEW)
        assert contents(shared) == NEW
        assert [p.name for p in tmp_path.iterdir()] == ["out"]
    finally:
        for path in shared.iterdir():
            path.unlink()
        shared.rmdir()


KILLED = """
import os, sys
from pathlib import Path
from hydrojax.report.files import write_all

calls = int(sys.argv[2])

def killed(function):
    def call(*arguments):
        global calls
        calls -= 1
        if calls < 0:
            os._exit(9)
        return function(*arguments)
    return call

os.replace, os.rename = killed(os.replace), killed(os.rename)
new = {"report.json": b"new", "rig.toml": b"new"}
write_all(Path(sys.argv[1]), new, obsolete=["report_loop.png"])
"""


@pytest.mark.parametrize("after", range(4))
def test_stopped_between_two_renames_the_folder_is_all_old_or_all_new(tmp_path, after):
    """As `kill -9` does it: nothing is put right on the way out."""
    write_all(tmp_path, OLD)
    command = [sys.executable, "-c", KILLED, str(tmp_path), str(after)]
    assert subprocess.run(command).returncode == (9 if after < 3 else 0)
    settle(tmp_path)
    assert contents(tmp_path) == (NEW if after else OLD)
    with claim(tmp_path):
        pass
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


@pytest.mark.parametrize("write", [write_all, lambda f, c: write_one(f / "a", c["a"])])
def test_a_full_disk_leaves_what_was_there(tmp_path, monkeypatch, write):
    write_all(tmp_path, {"a": b"old"})

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, "rename", full)
    monkeypatch.setattr(files.os, "replace", full)
    with pytest.raises(OSError, match="No space"):
        write(tmp_path, {"a": b"new"})
    assert contents(tmp_path) == {"a": b"old"}


def test_a_folder_that_cannot_be_written_is_refused_before_any_work():
    with pytest.raises(InputError, match="/proc/sys/out: cannot be written"):  # noqa: SIM117
        with claim(Path("/proc/sys/out")):
            raise AssertionError("work began")


def test_a_folder_made_for_a_run_that_wrote_nothing_goes_again(tmp_path):
    with claim(tmp_path / "a" / "b"):
        assert (tmp_path / "a" / "b").is_dir()
    assert not (tmp_path / "a").exists()
    with claim(tmp_path / "a" / "b"):
        write_all(tmp_path / "a" / "b", NEW)
    assert contents(tmp_path / "a" / "b") == NEW


HOLDER = """
import sys, time
from pathlib import Path
from hydrojax.report import files
with getattr(files, sys.argv[1])(Path(sys.argv[2])):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.mark.parametrize(
    ("hold", "name", "words"),
    [
        (claim, "out", ("identify", "rig.toml", "log.csv")),
        (claim_file, "log.csv", ("simulate", "rig.toml")),
        (claim_file, "log.csv", ("excite", "rig.toml")),
    ],
)
def test_a_second_run_into_the_same_place_refuses(call, tmp_path, hold, name, words):
    out = tmp_path / name
    first = subprocess.Popen(
        [sys.executable, "-c", HOLDER, hold.__name__, str(out)],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert first.stdout and first.stdout.readline() == "held\n"
        said = call(*words, "--out", out)
        assert said.code == 2 and "another run is writing there" in said.err
        with claim_file(tmp_path / "another.csv"):
            pass
    finally:
        first.kill()
        first.communicate()
    began = time.monotonic()
    with hold(out):  # a lock does not outlive its process
        pass
    assert time.monotonic() - began < 1
    assert not [p for p in tmp_path.rglob("*") if p.name.startswith(".")]
