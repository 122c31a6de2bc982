"""The line on the terminal: what is compiled, and how long it will take."""

from __future__ import annotations

import io
import json
import sys

import pytest
from jax import monitoring
from rich.console import Console

from hydrojax.cli import progress


@pytest.fixture
def clock(monkeypatch, tmp_path):
    """A time that the test sets, and a cache of its own."""
    now = [1000.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(progress, "user_cache", lambda: tmp_path)
    monkeypatch.setattr(sys, "argv", ["hydrojax", "trace", "rig.toml"])
    return now


def screen() -> Console:
    return Console(file=io.StringIO(), force_terminal=True, width=100)


def run(clock) -> None:
    """Two stages of 20 and 40 s."""
    with progress.show_stages(screen(), quiet=False) as enter:
        enter("fit")
        clock[0] += 20
        enter("search")
        clock[0] += 40


def test_the_second_run_knows_how_long_it_will_take(clock, tmp_path):
    run(clock)
    (stages,) = json.loads((tmp_path / "progress.json").read_text()).values()
    assert stages == [["fit", 0.0], ["search", 20.0], ["", 60.0]]
    left = progress._Left([(n, t) for n, t in stages])
    task = None
    left.enter("fit")
    assert left.render(task).plain == "about 60 s left"
    clock[0] += 35  # slower than it was
    left.enter("search")
    assert left.render(task).plain == "about 40 s left"
    clock[0] += 40
    assert left.render(task).plain == ""


def test_a_log_file_gets_a_line_now_and_then(clock):
    """Of a run that is over soon, and of a quiet one, none."""
    for quiet, seconds, said in (
        (False, 12, ["36 s: search", "72 s: search"]),
        (False, 3, []),
        (True, 12, []),
    ):
        out = io.StringIO()
        console = Console(file=out, width=100)
        with progress.show_stages(console, quiet) as enter:
            for what in ("fit", "refit", "search") * 2:
                clock[0] += seconds
                enter(what)
        assert out.getvalue().splitlines() == said
    out = io.StringIO()
    with progress.show_count(Console(file=out, width=100), "cells") as count:
        for done in (100, 200, 300):
            clock[0] += 20
            count(done, 4096)
    assert out.getvalue() == "40 s: cells: 200 of 4096\n"


def test_what_a_run_writes_is_not_what_it_is_given(clock, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["hydrojax", "simulate", "r", "--out", "log.csv"])
    before = progress._kind()
    (tmp_path / "log.csv").write_text("1" * 5000)
    assert progress._kind() == before
    (tmp_path / "r").write_text("1" * 5000)
    assert progress._kind() != before


def test_a_first_run_promises_nothing(clock):
    assert progress._Left([]).render(None).plain == ""


def test_what_was_remembered_and_is_damaged_is_forgotten(clock, tmp_path):
    for text in ("{", "[1]", '{"trace 0": [1]}'):
        (tmp_path / "progress.json").write_text(text)
        run(clock)
        assert "trace 0" in json.loads((tmp_path / "progress.json").read_text())


def test_a_failed_run_is_not_remembered(clock, tmp_path):
    with pytest.raises(KeyError), progress.show_stages(screen(), False) as enter:
        enter("fit")
        raise KeyError
    assert not (tmp_path / "progress.json").exists()


def test_compiling_is_named_while_it_lasts():
    column = progress._Compiling()
    end = column.listen()
    assert column.render(None).plain == ""
    monitoring.record_event(progress._Compiling.begins)
    assert column.render(None).plain == "compiling"
    monitoring.record_event_duration_secs(progress._Compiling.ends, 1.0)
    assert column.render(None).plain == ""
    end()
    monitoring.record_event(progress._Compiling.begins)
    assert column.render(None).plain == ""


def test_jax_s_own_events_are_these(clock):
    """One program, compiled anew: it begins and ends."""
    import jax
    import jax.numpy as jnp

    column, seen = progress._Compiling(), []
    end = column.listen()

    def note(event: str, **_: object) -> None:
        if event == progress._Compiling.begins:
            seen.append(event)

    monitoring.register_event_listener(note)
    jax.jit(lambda x: x * 1.2345 + 6.789)(jnp.ones(7)).block_until_ready()
    monitoring.unregister_event_listener(note)
    assert seen and column.render(None).plain == ""
    end()


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(3.2, "3 s"), (12, "10 s"), (61, "60 s"), (100, "2 min"), (600, "10 min")],
)
def test_times_are_rounded(seconds, said):
    assert progress._round(seconds) == said
