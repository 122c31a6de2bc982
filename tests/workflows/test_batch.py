"""A fleet of logs: its table, its workers, what is left of a killed run, its report.

Most fleets here are done by `tests.fleet_solvers.pretend`, in place of a fit.
"""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import random
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import pytest

from hydrojax.control.baselines import PIController
from hydrojax.effects.friction import ViscousFriction
from hydrojax.errors import InputError
from hydrojax.identify import api as identifying
from hydrojax.identify.case import open_case
from hydrojax.report.page import made_by
from hydrojax.rigfile.fingerprint import code_fingerprint
from hydrojax.rigfile.schema import RigFile
from hydrojax.tune import api, sweep
from hydrojax.workflows.fleet import friction, merged, summary, sweeps
from hydrojax.workflows.fleet import run as running
from hydrojax.workflows.fleet.jobs import read_jobs
from hydrojax.workflows.fleet.local import JobLimits
from hydrojax.workflows.fleet.report import Named, controller_lines, job_pages
from hydrojax.workflows.fleet.run import Ran, Stopped, run_fleet
from hydrojax.workflows.fleet.store import Store
from hydrojax.workflows.fleet.work import Options, keys_of

ROOT = Path(__file__).parents[2]
PRETEND = "tests.fleet_solvers:pretend"


def fleet(folder: Path, logs: list[dict], **labels: list) -> Path:
    """A table of jobs whose logs say how they are to go; each its own log."""
    for i, words in enumerate(logs):
        (folder / f"log_{i}.csv").write_text(json.dumps(words))
    for name in ("rig.toml", "check.csv"):
        (folder / name).touch()
    names = [f"log_{i}.csv" for i in range(len(logs))]
    rows = {"rig": "rig.toml", "fit": names, "validate": "check.csv", **labels}
    pd.DataFrame(rows).to_csv(folder / "jobs.csv", index=False)
    return folder / "jobs.csv"


def good(count: int, **more: object) -> list[dict]:
    return [{"value": 10.0 + 0.01 * i, **more} for i in range(count)]


def pretended(table: Path, out: Path, report: bool = False, **more) -> Ran:
    return run_fleet(table, out, workers=1, solver=PRETEND, report=report, **more)


def calls(folder: Path) -> list[int]:
    """How often each log was looked at."""
    logs = sorted(folder.glob("log_*.csv"), key=lambda p: int(p.stem[4:]))
    files = [log.with_suffix(".calls") for log in logs]
    return [len(f.read_text().split()) if f.exists() else 0 for f in files]


def digest(out: Path) -> str:
    return hashlib.sha256((out / "fleet.parquet").read_bytes()).hexdigest()


# -- tables --

BAD_TABLES = {
    "no column": ("rig,fit\nr,a\n", ("no column 'validate'",)),
    "no rig": ("rig,fit,validate\nr,a,b\n ,a,b\n", ("row 2 (line 3)", "rig")),
    "no log": ("rig,fit,validate\nr,;,b\n", ("row 1 (line 2)", "fit", ";")),
    "nothing to check by": (
        "rig,fit,validate\nr,a,\n",
        ("row 1", "validate", "--command identify"),
    ),
    "a name twice": (
        "job,rig,fit,validate\nm,r,a,b\nm,r,c,b\n",
        ("row 2 (line 3)", "'m'", "name of its own"),
    ),
    "a label like a result": (
        "rig,fit,validate,verdict\nr,a,b,good\n",
        ("'verdict'", "rename"),
    ),
    "no row": ("rig,fit,validate\n", ("holds no job",)),
    "blank lines": (
        "rig,fit,validate\n\nr,a,b\n\nr,,b\n\n",
        ("row 2 (line 5)", "fit"),
    ),
    "a cell too many": ("rig,fit,validate\nr,a,b,c\n", ("not a readable CSV",)),
    "a column twice": ("rig,fit,validate,rig \nr,a,b,q\n", ("'rig' is there twice",)),
    "nothing": ("", ("jobs.csv", "CSV")),
}


@pytest.mark.parametrize("case", BAD_TABLES)
def test_a_bad_table_is_refused_in_one_line(call, tmp_path, case):
    content, words = BAD_TABLES[case]
    (tmp_path / "jobs.csv").write_text(content)
    said = call("batch", tmp_path / "jobs.csv", "--out", tmp_path / "out")
    assert said.code == 2 and said.out == ""
    assert len(said.err.strip().splitlines()) == 1
    for word in (str(tmp_path / "jobs.csv"), *words):
        assert word in said.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "words"),
    [("jobs.txt", ".parquet"), ("none.csv", "no such file"), ("empty", "rig.toml")],
)
def test_what_is_no_table_is_refused(call, tmp_path, name, words):
    (tmp_path / "empty").mkdir()
    (tmp_path / "jobs.txt").write_text("rig,fit,validate\nr,a,b\n")
    said = call("batch", tmp_path / name, "--out", tmp_path / "out")
    assert said.code == 2
    assert str(tmp_path / name) in said.err and words in said.err


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [("--command", "tune", "identify or trace"), ("--cluster", "local:x", "local:2")],
)
def test_bad_options_are_refused(call, tmp_path, option, value, words):
    if option == "--cluster":
        pytest.importorskip("distributed")
    table = fleet(tmp_path, good(1))
    said = call("batch", table, "--out", tmp_path / "out", option, value)
    assert said.code == 2 and value in said.err and words in said.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("option", ["--matters", "--horizon"])
def test_numbers_without_end_are_refused(call, tmp_path, option):
    table = fleet(tmp_path, good(1))
    said = call("batch", table, "--out", tmp_path / "out", option, "inf")
    assert said.code == 2 and len(said.err.strip().splitlines()) == 1
    assert f"invalid {option} inf: expected a finite number" in said.err
    assert not (tmp_path / "out").exists()


def test_a_job_may_take_any_memory(call, tmp_path, monkeypatch):
    seen = {}

    def ran(*_, limits, **__):
        seen["limits"] = limits
        raise Stopped(0, 1)

    monkeypatch.setattr(running, "run_fleet", ran)
    table = fleet(tmp_path, good(1))
    said = call("batch", table, "--out", tmp_path / "out", "--job-memory", "inf")
    assert said.code == 130 and seen["limits"] == JobLimits(memory=float("inf"))


def test_a_label_that_is_there_twice_is_refused(tmp_path):
    """pandas would call the second `oil.1`."""
    (tmp_path / "jobs.csv").write_text(
        "rig,fit,validate,oil,oil\nr.toml,a.csv,b.csv,1,2\n"
    )
    with pytest.raises(InputError, match="column 'oil' is there twice"):
        read_jobs(tmp_path / "jobs.csv")


def test_cells_that_are_no_text_are_refused(tmp_path):
    for cell in ("r\0.toml", "r\x1b[2J.toml"):
        (tmp_path / "jobs.csv").write_text(f"rig,fit,validate\n{cell},a.csv,b.csv\n")
        with pytest.raises(InputError, match=r"jobs\.csv") as caught:
            read_jobs(tmp_path / "jobs.csv")
        assert str(caught.value).isprintable()


def test_csv_parquet_and_folders_give_the_same_jobs(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        for file in ("rig.toml", "fit_1.csv", "fit_2.csv.gz", "validate.csv", "x.csv"):
            (tmp_path / name / file).touch()
    (tmp_path / "nothing").mkdir()
    rows = {
        "job": ["a", "b"],
        "rig": ["a/rig.toml", "b/rig.toml"],
        "fit": ["a/fit_1.csv; a/fit_2.csv.gz", "b/fit_1.csv;b/fit_2.csv.gz;"],
        "validate": ["a/validate.csv", "b/validate.csv"],
    }
    pd.DataFrame(rows).to_csv(tmp_path / "t.csv", index=False)
    pd.DataFrame(rows).to_parquet(tmp_path / "t.parquet")
    by_folder = list(read_jobs(tmp_path))
    assert by_folder == list(read_jobs(tmp_path / "t.csv"))
    assert by_folder == list(read_jobs(tmp_path / "t.parquet"))
    assert [j.name for j in by_folder] == ["a", "b"]
    assert by_folder[0].fit == ("a/fit_1.csv", "a/fit_2.csv.gz")
    assert by_folder[0].validate_ == ("a/validate.csv",)


# -- work --


def test_what_came_of_every_job_is_a_row(tmp_path):
    logs = good(4, effects=["stribeck"])
    logs[1] = {"bad": "column u: no number in row 7"}
    logs[2] = {"fault": "odd"}
    table = fleet(
        tmp_path, logs, warm=[20, "", 40, 50], site=["a", "b", "", "c"],
        job=["w", "x", "y", "z"],
    )  # fmt: skip
    assert pretended(table, tmp_path / "out") == Ran(4, 4, 2, True)
    found = pd.read_parquet(tmp_path / "out" / "fleet.parquet")
    assert list(found["job"]) == ["w", "x", "y", "z"]
    assert found["warm"].dtype == float and found["warm"][3] == 50
    assert np.isnan(found["warm"][1]) and pd.isna(found["site"][2])
    assert found["failed"][1] == f"{tmp_path}/log_1.csv: column u: no number in row 7"
    assert found["failed"][2] == "RuntimeError: odd"
    assert merged.named(tmp_path / "out", 1) == [
        f"failed: x: {found['failed'][1]}",
        "failed: 1 more in fleet.parquet",
    ]
    assert pd.isna(found["failed"][0]) and pd.isna(found["verdict"][1])
    assert found["verdict"][0] == "explained" and found["effects"][0] == "stribeck"
    assert found["parameter.beta"][3] == 1e8 * 10.03
    assert found["parameter.beta.low"][3] < found["parameter.beta"][3]
    assert found["channel.F.after"][0] == 2.6
    assert np.isnan(found["parameter.beta"][2])
    fields = merged.Fleet(tmp_path / "out" / "fleet.parquet")
    assert fields.unit("parameter.k_vp.std") == "N*s/m"
    assert fields.labels == ["warm", "site"]


def test_running_again_does_nothing_but_what_may_pass(tmp_path):
    logs = good(4)
    logs[1], logs[2] = {"bad": "no"}, {"fault": "odd"}
    table, out = fleet(tmp_path, logs), tmp_path / "out"
    pretended(table, out)
    before = digest(out)
    assert pretended(table, out) == Ran(4, 1, 2, True)
    assert calls(tmp_path) == [1, 1, 2, 1]  # a fault may pass, a bad log does not
    assert digest(out) == before
    (tmp_path / "log_2.csv").write_text(json.dumps({"value": 10.0}))
    assert pretended(table, out) == Ran(4, 1, 1, True)
    assert pretended(table, out) == Ran(4, 0, 1, False)
    assert calls(tmp_path) == [1, 1, 3, 1]


@pytest.mark.slow
def test_a_result_depends_on_files_and_options_not_on_labels(tmp_path):
    table, out = fleet(tmp_path, good(3), warm=[1, 2, 3]), tmp_path / "out"
    pretended(table, out)
    text = table.read_text()
    table.write_text(text.replace("warm", "cold"))
    assert pretended(table, out) == Ran(3, 0, 0, True)
    assert "cold" in pd.read_parquet(out / "fleet.parquet")
    (tmp_path / "rig.toml").write_text("name = 'other'")
    assert pretended(table, out).done == 3
    options = Options(command="identify")
    assert pretended(table, out, options=options).done == 3
    assert calls(tmp_path) == [3, 3, 3]


def test_what_two_rows_ask_for_is_done_once(tmp_path):
    table = fleet(tmp_path, good(2))
    text = table.read_text()
    table.write_text(text + text.splitlines()[1] + "\n")
    assert pretended(table, tmp_path / "out") == Ran(3, 2, 0, True)
    assert len(pd.read_parquet(tmp_path / "out" / "fleet.parquet")) == 3
    assert calls(tmp_path) == [1, 1]


def test_a_job_that_kills_its_worker_fails_alone(tmp_path):
    logs = good(5)
    logs[2]["dies"] = True
    table, out = fleet(tmp_path, logs), tmp_path / "out"
    assert pretended(table, out) == Ran(5, 5, 1, True)
    failed = pd.read_parquet(out / "fleet.parquet")["failed"]
    assert failed[2] == "its worker died 3 times (SIGKILL)"
    assert failed.drop(2).isna().all()
    assert calls(tmp_path) == [1, 1, 3, 1, 1]


@pytest.mark.slow
def test_a_job_beyond_its_time_or_memory_fails_alone(tmp_path):
    logs = good(4)
    logs[1]["seconds"] = 600.0
    logs[2]["holds"] = 1200 * 2**20
    table, out = fleet(tmp_path, logs), tmp_path / "out"
    limits = JobLimits(seconds=20.0, memory=1000 * 2**20)
    assert pretended(table, out, limits=limits) == Ran(4, 4, 2, True)
    failed = pd.read_parquet(out / "fleet.parquet")["failed"].tolist()
    assert failed[1] == "took more than 20 s (--job-seconds)"
    assert "GiB (--job-memory)" in failed[2]
    assert pd.isna(failed[0]) and pd.isna(failed[3])
    assert calls(tmp_path) == [1, 1, 1, 1]  # no worker tries it again


@pytest.mark.slow
def test_a_worker_that_has_grown_is_replaced(tmp_path):
    table = fleet(tmp_path, good(3))
    jobs = read_jobs(table)
    for most, workers in ((1, 3), (2**60, 1)):
        out = tmp_path / f"out_{most}"
        out.mkdir()
        keys = running.keys_of(jobs, Options())
        tasks = running._tasks(jobs, keys, set(keys), Options(), out, PRETEND)
        for file in tmp_path.glob("*.calls"):
            file.unlink()
        running.local.share_out(tasks, 1, out / "log", lambda _: None, most)
        pids = {f.read_text() for f in tmp_path.glob("*.calls")}
        assert len(pids) == workers


def test_a_damaged_result_is_done_again(tmp_path):
    """By a power cut, by hand, or stored under another job's key."""
    table, out = fleet(tmp_path, good(8)), tmp_path / "out"
    pretended(table, out)
    before = digest(out)
    first, *rest = sorted(out.glob("jobs/[!.]*/*.json"))
    text = first.read_text()
    other = text.replace('"value": 10', '"value": 11', 1)
    assert other != text
    damages = ["", "[]", "{}", "null", text[:-20], text, other]
    for path, damaged in zip(rest, damages, strict=True):
        path.write_text(damaged)
    (out / "fleet.parquet").unlink()
    assert pretended(table, out) == Ran(8, len(damages), 0, True)
    assert digest(out) == before


def test_a_damaged_table_is_made_again(tmp_path):
    table, out = fleet(tmp_path, good(3)), tmp_path / "out"
    pretended(table, out)
    before = digest(out)
    whole = (out / "fleet.parquet").read_bytes()
    for damaged in (b"", whole[:100], b"PAR1" + whole[-300:]):
        (out / "fleet.parquet").write_bytes(damaged)
        assert pretended(table, out) == Ran(3, 0, 0, True)
        assert digest(out) == before


def test_a_job_s_key_holds_the_code_of_the_effects(tmp_path, monkeypatch):
    """A fleet that is resumed after an effect changed does its jobs anew."""
    table, out = fleet(tmp_path, good(2)), tmp_path / "out"
    assert pretended(table, out) == Ran(2, 2, 0, True)
    assert pretended(table, out).done == 0
    monkeypatch.setattr(ViscousFriction, "force", lambda self, at: 2 * self.b * at.v)
    assert pretended(table, out).done == 2


def test_a_folder_of_effects_is_the_files_in_it(tmp_path, monkeypatch):
    """Where one was edited, jobs are done anew."""
    (own := tmp_path / "own").mkdir()
    for name in ("b.py", "a.py", "notes.txt"):
        (own / name).write_text("# before")
    monkeypatch.chdir(tmp_path)
    options = Options(effects=("own", "one.py"))
    files = (own / "a.py", own / "b.py", tmp_path / "one.py")
    assert options.effects == tuple(map(str, files))
    jobs = read_jobs(fleet(tmp_path, good(2)), "trace")
    before = keys_of(jobs, options)
    assert keys_of(jobs, options) == before
    (own / "b.py").write_text("# after")
    assert not set(keys_of(jobs, options)) & set(before)


# -- kills --


def process(table: Path, out: Path, *more: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "tests.fleet_solvers", str(table), str(out), *more],
        cwd=ROOT, stdout=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip


def wait_for(out: Path, count: int) -> None:
    """Until so many results are there."""
    until = time.monotonic() + 60
    while len(list(out.glob("jobs/[!.]*/*.json"))) < count:
        assert time.monotonic() < until, "no results came"
        time.sleep(0.02)


def at_work(folder: Path) -> set[int]:
    """Process ids of those who have looked at a log."""
    return {int(w) for f in folder.glob("*.calls") for w in f.read_text().split()}


@pytest.mark.slow
def test_killed_at_any_moment_it_goes_on_and_gives_the_same_bytes(tmp_path):
    jobs, kills = 24, 4
    table = fleet(tmp_path, good(jobs, seconds=0.03))
    whole, out = tmp_path / "whole", tmp_path / "out"
    pretended(table, whole)
    for file in tmp_path.glob("*.calls"):
        file.unlink()
    chance, kept = random.Random(3), {}
    for i in range(kills):
        going = process(table, out)
        wait_for(out, 1 + i * jobs // kills)
        time.sleep(chance.uniform(0, 0.1))
        workers = psutil.Process(going.pid).children()
        going.kill()
        going.communicate()
        assert not psutil.wait_procs(workers, timeout=10)[1]  # they heard of it
        seen = {p: p.stat().st_mtime_ns for p in out.glob("jobs/[!.]*/*.json")}
        assert all(seen[p] == at for p, at in kept.items())
        kept = seen
    going = process(table, out)
    said = going.communicate()[0].split()
    assert said[0] == str(jobs) and int(said[1]) == jobs - len(kept)
    assert digest(out) == digest(whole)
    assert sum(calls(tmp_path)) <= jobs + 2 * kills  # what was under way, no more


def test_ctrl_c_keeps_what_is_done_and_leaves_no_worker(tmp_path):
    table, out = fleet(tmp_path, good(120, seconds=0.5)), tmp_path / "out"
    going = process(table, out)
    wait_for(out, 4)
    workers = psutil.Process(going.pid).children()
    os.killpg(going.pid, signal.SIGINT)
    said = going.communicate(timeout=60)[0]
    done = int(said.split()[0])
    assert said.endswith("of 120 are done and kept\n") and 2 <= done < 120
    assert len(list(out.glob("jobs/[!.]*/*.json"))) >= done
    gone, alive = psutil.wait_procs(workers, timeout=5)
    assert gone and not alive


def test_ctrl_c_says_how_to_go_on(call, tmp_path, monkeypatch):
    def stop(*_: object, **__: object) -> None:
        raise Stopped(3, 40)

    monkeypatch.setattr(running, "run_fleet", stop)
    said = call("batch", tmp_path, "--out", tmp_path / "out")
    assert said.code == 130
    assert "3 of 40 are done and kept" in said.err and "same command" in said.err


# -- a cluster --


@pytest.mark.slow
def test_a_cluster_that_loses_a_worker_loses_nothing(tmp_path):
    pytest.importorskip("distributed")
    table = fleet(tmp_path, good(30, seconds=0.3))
    whole, out = tmp_path / "whole", tmp_path / "out"
    pretended(table, whole)
    for file in tmp_path.glob("*.calls"):
        file.unlink()
    going = process(table, out, "local:2")
    wait_for(out, 3)
    while len(at_work(tmp_path)) < 2:
        assert going.poll() is None
        time.sleep(0.02)
    os.kill(min(at_work(tmp_path)), signal.SIGKILL)
    said = going.communicate(timeout=60)[0]
    assert said.split() == ["30", "30", "0", "True"]
    assert digest(out) == digest(whole)
    # What was under way when the worker was lost may have begun twice.
    assert sorted(set(calls(tmp_path))) in ([1], [1, 2])
    assert sum(calls(tmp_path)) <= 31


class Own(PIController):
    """A controller of a user's own, in a file that workers can import."""


def test_sending_a_controller_to_workers_leaves_its_fingerprint():
    before = code_fingerprint(Own())
    sent = pickle.dumps(Own())
    assert code_fingerprint(pickle.loads(sent)) == code_fingerprint(Own()) == before


def test_a_controller_of_the_running_script_is_refused(tmp_path, monkeypatch):
    """Workers could not import it: one line, before a worker starts."""
    monkeypatch.setattr(Own, "__module__", "__main__")
    rig = RigFile.load(ROOT / "hydrojax" / "paper" / "reference.toml")
    asked = {"axes": {"k_p": [1.0, 2.0]}}
    with pytest.raises(InputError, match="Own is defined in the running script"):
        sweeps.share_sweep(replace(rig, law=Own()), asked, (), tmp_path, "local:2")


def test_what_a_worker_cannot_import_is_one_line(tmp_path):
    unit = sweeps.Unit("a", b"cgone\nMyPI\n.", (), str(tmp_path), "linear", 0)
    with pytest.raises(InputError, match="cannot import .* No module named 'gone'"):
        sweeps.work_out(unit)


@pytest.mark.slow
def test_a_sweep_s_chunks_are_the_same_from_any_worker(tmp_path, monkeypatch):
    rig = RigFile.load(ROOT / "hydrojax" / "paper" / "reference.toml")
    asked = {
        # 300 cells: two chunks
        "axes": {"k_p": np.linspace(0.4, 2, 20), "k_f": np.linspace(0.5, 4, 15)},
        "gains": {"rho_a": 0.0},
    }
    alone = api.sweep(rig, **asked, out=tmp_path / "alone")
    units = []

    @contextmanager
    def nobody(address):
        yield None

    def backwards(tasks, do, found, hear, lost):
        units.extend(tasks)
        for unit in reversed(units):
            hear(do(pickle.loads(pickle.dumps(unit))))

    monkeypatch.setattr(sweeps, "client", nobody)
    monkeypatch.setattr(sweeps, "share_out", backwards)
    shared, told = tmp_path / "shared", []
    sweeps.share_sweep(rig, asked, (), shared, "local:2", lambda *n: told.append(n))
    assert [u.number for u in units] == [0, 1] and told == [(1, 2), (2, 2)]
    monkeypatch.setattr(sweep, "_Work", None)  # nothing is worked out again
    found = api.sweep(rig, **asked, out=shared)
    assert all(np.array_equal(found[n], alone[n], equal_nan=True) for n in alone)
    sweeps.share_sweep(rig, asked, (), shared, "local:2")
    assert len(units) == 2


# -- the report --


def test_outliers_drifts_and_failures_are_named(tmp_path):
    rng = np.random.default_rng(0)
    warm = np.linspace(20, 60, 30)
    values = 10 - 0.05 * (warm - 20) + 0.02 * rng.normal(size=30)
    values[7] = 25.0
    logs = [{"value": v, "effects": ["stribeck"] if v < 9 else []} for v in values]
    logs[4] = {"bad": "<b>no</b>"}
    days = [f"2026-03-{d + 1:02d}" for d in range(30)]
    table = fleet(
        tmp_path, logs, warm=warm.tolist(), day=days, site=["a", "b", "c"] * 10
    )
    out = tmp_path / "out"
    line = "hydrojax batch jobs.csv --out out"
    pretended(table, out, report=True, command_line=line)
    found = merged.Fleet(out / "fleet.parquet")
    apart = [o for o in summary.outliers(found) if o.what == "beta"]
    assert [o.job for o in apart] == ["row 8"]
    rest = np.delete(values, 4)
    spread = np.median(np.abs(rest - np.median(rest)))
    wide = np.hypot(spread / 0.6745, 0.25)  # a fit's own std is 1 %
    assert apart[0].z == pytest.approx((25 - np.median(rest)) / wide)
    drift = {(d.parameter, d.label): d for d in summary.drifts(found)}
    assert set(drift) == {
        (p, x) for p in ("beta", "k_cp", "k_vp") for x in ("warm", "day")
    }
    seen = drift["beta", "warm"]
    assert seen.low < -2e8 < seen.high and seen.change == pytest.approx(-2e8, rel=0.02)
    page = (out / "fleet.html").read_text()
    assert "row 8" in page and "row 5" in page and "<b>no" not in page
    assert "stribeck" in page and "://" not in page
    assert page.count(f"<code>{line}</code>") == 1
    (single,) = (out / "reports").glob("*.html")
    assert f'<a href="reports/{single.name}">row 5</a>' in page
    said = single.read_text()
    assert f"<code>{line}</code>" in said
    assert "&lt;b&gt;no" in said and "<b>no" not in said
    assert "hydrojax trace rig.toml log_4.csv --validate check.csv --out" in said
    own = str(tmp_path / "own.py")
    how = {"horizon": 0.5, "starts": 3, "matters": 0.05, "level": 0.02,
           "profile": True, "effects": (own,)}  # fmt: skip
    named, store = [Named("row 5", "no", single.stem)], Store(out)
    for command, more in (("trace", "--matters 0.05 --level 0.02 "), ("identify", "")):
        options = Options.model_validate({"command": command, **how})
        (text,) = job_pages(store, named, "t", options, made_by("")).values()
        assert (
            f"hydrojax {command} rig.toml log_4.csv --validate check.csv --horizon 0.5 "
            f"--starts 3 {more}--profile --effects {own} --out report" in text
        )
    pictures = {p.name for p in out.glob("*.png")}
    labels = {f"fleet_label_{i}.png" for i in (1, 2, 3)}
    assert pictures == {"fleet_effects.png", "fleet_friction.png", *labels}


def test_values_at_random_have_no_drift(tmp_path):
    rng = np.random.default_rng(1)
    logs = [{"value": v} for v in 10 + 0.1 * rng.normal(size=40)]
    table = fleet(tmp_path, logs, warm=list(range(40)))
    pretended(table, tmp_path / "out")
    assert not summary.drifts(merged.Fleet(tmp_path / "out" / "fleet.parquet"))


def records(theta: np.ndarray, noise: float = 0.0) -> list[dict]:
    """Results whose k_cp and k_cn are these, [K, 2]."""
    return [
        {
            "parameters": {
                n: {"value": v, "identified": True, "unit": "N"}
                for n, v in zip(("k_cp", "k_cn"), row, strict=True)
            },
            "friction": {
                "inside": ["k_cp", "k_cn"],
                "covariance": (noise**2 * np.eye(2)).tolist(),
                "ranges": {"k_cp": [0.0, 4000.0], "k_cn": [0.0, 4000.0]},
            },
        }
        for row in theta
    ]


def test_the_box_holds_as_much_friction_as_it_says():
    rng = np.random.default_rng(2)
    draw = rng.multivariate_normal
    mean, covariance = [1000.0, 800.0], [[900.0, 500.0], [500.0, 400.0]]
    found = friction.friction_box(records(draw(mean, covariance, 400)))
    fresh = draw(mean, covariance, 20_000)
    inside = np.all((fresh > found.box.lower) & (fresh < found.box.upper), axis=1)
    assert 0.93 < inside.mean() < 0.97
    assert found.box.names == ("k_cp", "k_cn") and found.units == ("N", "N")
    low, high = found.box.lower[0] / 1e3, found.box.upper[0] / 1e3
    line = f'k_cp = ["{low:.4g} kN", "{high:.4g} kN"]'
    assert controller_lines(found)[0] == line


def test_friction_that_fits_do_not_tell_has_no_bounds():
    some = records(np.random.default_rng(0).normal(1000, 10, (9, 2)))
    for record in some[:5]:
        record["parameters"]["k_cn"]["identified"] = False
    found = friction.friction_box(some)
    assert found.box.names == ("k_cp",) and len(found.values) == 9
    assert friction.friction_box(some[:4]) is None


# -- real logs --


@pytest.mark.slow
def test_a_fleet_of_real_logs_is_what_identify_gives(
    call, recorded, tmp_path, monkeypatch, cache_home
):
    """Bit for bit, in another process; the broken log fails alone."""
    case = recorded(3, seconds=3.0)
    (tmp_path / "cut.csv").write_text("time [s],u [V]\n0,1\n")
    rows = {
        "rig": str(case / "rig.toml"),
        "fit": [str(case / "fit_1.csv"), "cut.csv", str(case / "fit_2.csv")],
        "validate": str(case / "validate.csv"),
        "oil": [20.5, 30, 41],
    }
    pd.DataFrame(rows).to_csv(tmp_path / "jobs.csv", index=False)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    given = ("--out", tmp_path / "out", "--command", "identify", "--starts", 1)
    said = call("batch", tmp_path / "jobs.csv", *given, "--workers", 1)
    assert said.code == 1, said
    assert "3 jobs, 3 done now, 1 failed" in said.out
    found = pd.read_parquet(tmp_path / "out" / "fleet.parquet")
    assert "cut.csv" in found["failed"][1] and "Error" not in found["failed"][1]
    alone = identifying.identify(
        open_case(case / "rig.toml", [case / "fit_2.csv"], [case / "validate.csv"]),
        starts=1,
    )
    assert found["verdict"][2] == alone.verdict
    for name, p in alone.parameters.items():
        if p.free:
            assert found[f"parameter.{name}"][2] == p.value, name
            if p.std is not None:
                assert found[f"parameter.{name}.std"][2] == p.std, name
    for name, c in alone.channels.items():
        assert found[f"channel.{name}.after"][2] == c.after, name
    said = call("batch", tmp_path / "jobs.csv", *given)
    assert said.code == 1 and "3 jobs, 0 done now, 1 failed" in said.out
