"""A command that is interrupted ends, and leaves nothing half done."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hydrojax import cli

STUBBORN = """
import sys, time
from pathlib import Path
import typer
from hydrojax import cli
from hydrojax.cli.options import check_out

@cli.app.command()
def work(context: typer.Context, out: Path, stubborn: bool = False):
    check_out(context, out)
    begun = False
    while True:
        try:
            if not begun:
                begun = True
                print("begun", flush=True)
            time.sleep(60)
        except KeyboardInterrupt:
            if not stubborn:
                raise  # otherwise as XLA does with what a callback raises

class Slow:
    def __del__(self):
        print("begun", flush=True)
        time.sleep(60)

@cli.app.command()
def destroy():
    slow = Slow()
    del slow  # whatever a destructor raises is swallowed
    time.sleep(60)

@cli.app.command()
def translate():
    try:
        print("begun", flush=True)
        time.sleep(60)
    except KeyboardInterrupt:
        raise RuntimeError("as XLA does with what a callback raises")

cli.main()
"""


@pytest.mark.parametrize("stubborn", [(), ("--stubborn",)])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_command(tmp_path, number, stubborn):
    out = tmp_path / "out"
    command = [sys.executable, "-c", STUBBORN, "work", str(out), *stubborn]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout and process.stdout.readline() == "begun\n"
    sent = time.monotonic()
    process.send_signal(number)
    _, said = process.communicate(timeout=30)
    assert process.returncode == 128 + number
    assert said == cli.STOPPED.format(number.name)
    if not stubborn:
        assert time.monotonic() - sent < cli.GRACE
        assert not out.exists()
    assert not [p for p in Path(tmp_path).rglob("*") if p.suffix == ".json"]


@pytest.mark.parametrize("word", ["destroy", "translate"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_that_is_lost_on_its_way_ends_a_command(word, number):
    process = subprocess.Popen(
        [sys.executable, "-c", STUBBORN, word],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout and process.stdout.readline() == "begun\n"
    sent = time.monotonic()
    process.send_signal(number)
    _, said = process.communicate(timeout=30)
    assert process.returncode == 128 + number
    assert said == cli.STOPPED.format(number.name)
    assert time.monotonic() - sent < cli.GRACE


def test_handlers_are_as_before(call):
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    assert call("--version").code == 0
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before
