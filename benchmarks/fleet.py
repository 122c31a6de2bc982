"""A fleet of logs of mixed length: speed, memory, kills, a lost worker.

Run as `python -m benchmarks.fleet run` (an unbroken run), `kills` (the same, killed
again and again), `workers` (one process with all cores, or one per core) and `cluster`
(local workers, one of them killed). The logs are simulated into `--out`, once; what is
printed is what docs/scale.md says.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pandas as pd

from hydrojax.jax_setup import set_up_jax, user_cache

FREE = {
    "beta", "c_p1", "c_n1", "c_p2", "c_n2", "k_cp", "k_cn", "k_0", "k_vp", "k_vn",
}  # fmt: skip
"""What is fitted, from a start 10 % off."""
PARTS = ("run", "kills", "workers", "cluster")
SECONDS = (3.0, 8.0)
"""Least and greatest length of a log, s."""


def make_logs(folder: Path, count: int, lengths: int) -> Path:
    """`count` logs to fit and as many to validate, simulated; the table of jobs.

    `lengths` is how many different ones they have; 0: every log its own.
    """
    table = folder / f"jobs_{count}_{lengths}.csv"
    if table.exists():
        return table

    from hydrojax.control import simulation
    from hydrojax.paper import experiments
    from hydrojax.rigfile import recording
    from hydrojax.rigfile.build import build_loop
    from hydrojax.rigfile.scenarios import rig_scenario
    from hydrojax.rigfile.schema import RigFile

    set_up_jax(user_cache())
    source = Path(experiments.__file__).parent / "reference.toml"
    folder.mkdir(parents=True, exist_ok=True)
    declared = re.sub(r'^(\w+) = "(\S+)(.*)"$', _ranged, source.read_text(), flags=re.M)
    (folder / "rig.toml").write_text(declared)
    rng = np.random.default_rng(0)
    rows = []
    for i in range(count):
        warm = float(rng.uniform(20, 60))
        beta = 8.5e8 * (1 - 0.004 * (warm - 20))
        text = source.read_text().replace('"8.5e8 Pa"', f'"{beta:.6g} Pa"')
        own = folder / "truth.toml"
        own.write_text(text)
        spec = RigFile.load(own)
        loop = build_loop(spec, None, {})
        scenario = rig_scenario(spec, loop, seconds=2 * SECONDS[1], seed=i)
        columns = recording.log_columns(simulation.simulate_loop(loop, scenario), spec)
        rows_of = {n: y for n, (_, y) in columns.items()}
        share = rng.integers(lengths) / (lengths - 1) if lengths > 1 else rng.uniform()
        length = int(1000 * (SECONDS[0] + share * (SECONDS[1] - SECONDS[0])))
        for name, part in (
            ("fit", slice(0, length)),
            ("validate", slice(8000, 8000 + int(1000 * SECONDS[0]))),
        ):
            cut = {n: (columns[n][0], y[part]) for n, y in rows_of.items()}
            recording.write_log(folder / f"{name}_{i:04d}.parquet", cut)
        logs = (f"fit_{i:04d}.parquet", f"validate_{i:04d}.parquet")
        rows.append((f"run {i}", "rig.toml", *logs, round(warm, 2), f"M{i % 5}"))
    names = ["job", "rig", "fit", "validate", "temperature [degC]", "machine"]
    pd.DataFrame(rows, columns=names).to_csv(table, index=False)
    return table


def _ranged(line: re.Match[str]) -> str:
    name, value, unit = line[1], line[2], line[3]
    if name not in FREE:
        return line[0]
    size = float(value)
    ends = (
        (-8 * size, 8 * size)
        if name in ("k_0", "k_vp", "k_vn")
        else (0.1 * size, 5 * size)
    )
    start, low, high = (f'"{v:.6g}{unit}"' for v in (1.1 * size, *ends))
    return f"{name} = {{ start = {start}, range = [{low}, {high}] }}"


def start(table: Path, out: Path, *more: str) -> subprocess.Popen[bytes]:
    """The command line, as a user has it, in a process group of its own."""
    words = [sys.executable, "-m", "hydrojax.cli", "batch", str(table)]
    words += ["--command", "identify", "--starts", "1", "--out", str(out), *more]
    return subprocess.Popen(words, start_new_session=True, stdout=subprocess.DEVNULL)


def digest(out: Path) -> str:
    """Of the merged table's bytes."""
    return hashlib.sha256((out / "fleet.parquet").read_bytes()).hexdigest()[:16]


class Watch(threading.Thread):
    """Memory of a process and of those it started, MB, over time."""

    def __init__(self, process: subprocess.Popen[bytes]):
        super().__init__(daemon=True)
        self.process, self.seen = process, []

    def run(self) -> None:
        """Look until it ends."""
        import psutil

        while self.process.poll() is None:
            try:
                root = psutil.Process(self.process.pid)
                own = root.memory_info().rss
                rest = [c.memory_info().rss for c in root.children(recursive=True)]
                self.seen.append((own / 1e6, max(rest, default=0.0) / 1e6))
            except psutil.Error:
                pass
            time.sleep(0.5)

    def said(self) -> str:
        """Largest of the parent and of any worker, by quarters of the run."""
        parts = np.array_split(np.array(self.seen), 4)
        both = [p.max(axis=0) for p in parts if len(p)]
        return "; ".join(f"{a:.0f} + worker {b:.0f}" for a, b in both)


def run(table: Path, out: Path, *more: str) -> None:
    """An unbroken run."""
    shutil.rmtree(out, ignore_errors=True)
    began = time.perf_counter()
    process = start(table, out, *more)
    watch = Watch(process)
    watch.start()
    process.wait()
    took = time.perf_counter() - began
    spent = pd.read_parquet(out / "seconds.parquet")
    size = [p.stat() for p in out.glob("jobs/*/*.json")]
    failed = pd.read_parquet(out / "fleet.parquet")["failed"].notna().sum()
    print(
        f"{len(spent)} logs, {failed} failed, {took:.0f} s: "
        f"{60 * len(spent) / took:.1f} logs a minute\n"
        f"a log: median {spent['all'].median():.2f} s, 90 % under "
        f"{spent['all'].quantile(0.9):.2f} s; "
        f"{100 * spent['compile'].sum() / spent['all'].sum():.0f} % of it compiling\n"
        f"largest memory, MB, by quarters of the run: {watch.said()}\n"
        f"a result: {np.mean([s.st_size for s in size]):.0f} bytes, "
        f"{np.mean([512 * s.st_blocks for s in size]):.0f} on disk; fleet.parquet "
        f"{(out / 'fleet.parquet').stat().st_size} bytes; sha256 {digest(out)}",
        flush=True,
    )


def kills(table: Path, out: Path, whole: Path, count: int) -> None:
    """The same, killed `count` times at random; is it the same table?"""
    shutil.rmtree(out, ignore_errors=True)
    rng = np.random.default_rng(1)
    jobs = len(pd.read_csv(table))
    kept: dict[Path, tuple[int, int]] = {}
    again = 0
    for at in np.sort(rng.choice(np.arange(1, jobs), count, replace=False)):
        process = start(table, out)
        while len(_results(out)) < at and process.poll() is None:
            time.sleep(0.05)
        time.sleep(float(rng.uniform(0.0, 3.0)))
        process.kill()
        process.wait()
        time.sleep(1.0)  # its workers hear that nobody asks any more
        files = {p: _mark(p) for p in _results(out)}
        again += sum(files.get(p) != mark for p, mark in kept.items())
        kept = files
        print(f"killed: {len(kept)} of {jobs} results stand", flush=True)
    start(table, out).wait()
    files = {p: _mark(p) for p in _results(out)}
    again += sum(files.get(p) != mark for p, mark in kept.items())
    same = "the same bytes" if digest(out) == digest(whole) else "ANOTHER TABLE"
    print(f"{again} results written twice; {same}: sha256 {digest(out)}")


def _results(out: Path) -> list[Path]:
    """Those that stand; drafts come and go meanwhile."""
    found = os.walk(out / "jobs")  # a folder that has gone is passed over
    return [Path(f, name) for f, _, names in found for name in names
            if name.endswith(".json")]  # fmt: skip


def _mark(path: Path) -> tuple[int, int]:
    found = path.stat()
    return found.st_ino, found.st_mtime_ns


def lose_a_worker(table: Path, out: Path, whole: Path) -> None:
    """Two local workers of a cluster, one killed when a third is done."""
    import psutil

    shutil.rmtree(out, ignore_errors=True)
    process = start(table, out, "--cluster", "local:2")
    jobs, killed = len(pd.read_csv(table)), 0
    while process.poll() is None:
        done = len(list(out.glob("jobs/*/*.json")))
        if not killed and done >= jobs / 3:
            busy = psutil.Process(process.pid).children(recursive=True)
            victim = max(busy, key=lambda p: p.memory_info().rss)
            victim.kill()
            killed = done
        time.sleep(0.2)
    marks = sum(1 for _ in out.glob("jobs/*/*.json"))
    same = "the same bytes" if digest(out) == digest(whole) else "ANOTHER TABLE"
    print(f"worker killed after {killed} of {jobs}: {marks} results; {same}")


def main() -> None:
    """One part of the study."""
    given = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    given.add_argument("part", choices=PARTS)
    given.add_argument("--out", type=Path, default=Path("hydrojax-fleet-study"))
    given.add_argument("--logs", type=int, default=200)
    given.add_argument("--lengths", type=int, default=4, help="different ones; 0: all")
    given.add_argument("--kills", type=int, default=10)
    words = given.parse_args()
    table, whole = make_logs(words.out, words.logs, words.lengths), words.out / "whole"
    if words.part == "run":
        run(table, whole)
    elif words.part == "kills":
        if not (whole / "fleet.html").exists():
            run(table, whole)
        kills(table, words.out / "killed", whole, words.kills)
    elif words.part == "workers":
        for count in ("1", "2"):
            print(f"--workers {count}")
            run(table, words.out / "workers", "--workers", count)
    else:
        if not (whole / "fleet.html").exists():
            run(table, whole)
        lose_a_worker(table, words.out / "cluster", whole)


if __name__ == "__main__":
    main()
