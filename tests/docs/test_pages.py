"""The commands and the Python of the pages, run as printed on the demo's logs."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tomllib
from contextlib import contextmanager
from functools import partial

import numpy as np
import pytest

import hydrojax as hj
from hydrojax.workflows.fleet import run as fleets
from tests.docs.shown import does_its_work, new_lines
from tests.pages import ROOT, blocks

PAGES = ("closed_loop", "figures", "interchange", "your_own_effect")
"""Those whose commands differ from the README's in more than a file or an option; the
tutorial and first_report have tests of their own, logs and scale ask for more than a
desk.
"""


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_the_commands_of_a_page_do_their_work(page, call, desk, vocabulary):
    """In their order."""
    for line in new_lines(page):
        does_its_work(line, call, desk)


def test_the_python_of_the_first_report_drafts_a_rig(desk, monkeypatch):
    """And traces as the README does, which is not done twice."""
    asked = []
    monkeypatch.setattr(hj, "trace", lambda *logs, **more: asked.append((logs, more)))
    *_, code = blocks(ROOT / "docs/first_report.md", "python")
    exec(code, {})
    (((rig, fitted), more),) = asked
    assert isinstance(rig, hj.RigFile) and rig.layout.name == "pull-pull"
    logs = [*fitted, *more.pop("validate")]
    for log in logs:
        assert hj.Log.load(log, rig.channels).time.size > 1000
    assert more == {}


@pytest.mark.slow
def test_the_python_of_the_page_on_other_tools_plays_the_fmu(call, desk):
    pytest.importorskip("fmpy")
    rig = (desk / "rig.toml").read_text()
    name = tomllib.loads(rig)["name"]
    (desk / "rig.toml").write_text(rig.replace(name, "Reference rig"))
    assert call("export", "rig.toml", "--to", "fmu", "--out", ".").code == 0
    table = np.array([(0.0, 0.0, 0.0), (0.5, 1.0, 0.0), (1.0, 1.0, 0.0)], INPUTS)
    names = {"table": table}
    (code,) = blocks(ROOT / "docs/interchange.md", "python")
    exec(code, names)
    out = names["out"]
    assert out["time"][-1] == 1.0
    signals = [out[name] for name in ("P_a1", "P_a2", "F")]
    assert all(np.isfinite(y).all() and np.ptp(y) > 0 for y in signals)


INPUTS = [("time", float), ("u", float), ("x", float)]


@pytest.mark.slow
def test_the_bags_of_the_page_on_logs_are_traced(call, desk):
    """Its command, on bags of the demo's log, with its `[channels]`."""
    pytest.importorskip("mcap")
    pytest.importorskip("rosbags")
    from tests.logs.test_bags import demo_topics, write

    topics = demo_topics()
    for run, kind in (
        ("run_1", "sqlite3"),
        ("run_2", "mcap"),
        ("run_3", "mcap folder"),
    ):
        bag = write(desk / f"as_{run}", kind, topics)
        (desk / "runs").mkdir(exist_ok=True)
        bag.rename(desk / "runs" / (run + bag.suffix))
    tables = blocks(ROOT / "docs/logs.md", "toml")
    shown = next(
        t for t in tables if "/pressures" in t and "channels" in tomllib.loads(t)
    )
    with (desk / "rig.toml").open("a") as rig:
        rig.write("\n" + shown)
    for line in new_lines("logs"):
        does_its_work(line, call, desk)


@contextmanager
def scheduler():
    """The address of a dask scheduler with one worker, both as the page starts them."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    dask = [sys.executable, "-m", "distributed.cli."]
    parts = (
        ("dask_scheduler", "--host", "127.0.0.1", "--port", address.partition(":")[2],
         "--no-dashboard"),
        ("dask_worker", address, "--nworkers", "1", "--nthreads", "1",
         "--no-dashboard"),
    )  # fmt: skip
    started = [
        subprocess.Popen(
            [*dask[:2], dask[2] + name, *words],
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        for name, *words in parts
    ]
    try:
        yield address
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait(30)


@pytest.mark.slow
def test_the_commands_of_the_page_on_scale_do_their_work(call, desk, monkeypatch):
    """On a cluster of one worker, with fewer gains. Results are pretended: the README's
    own fleet is traced.
    """
    pytest.importorskip("distributed")
    pretended = partial(fleets.run_fleet, solver="tests.fleet_solvers:pretend")
    monkeypatch.setattr(fleets, "run_fleet", pretended)
    for log in desk.rglob("fit_1.csv"):
        log.write_text('{"value": 10.0}')
    with scheduler() as address:
        for line in new_lines("scale"):
            line = line.replace("HOST:8786", address).replace("/shared/", "shared/")
            does_its_work(line.replace(":512", ":8"), call, desk)
