"""What a gain set costs in a sweep, and what a very long table of jobs costs by itself.

Run as `python -m benchmarks.scale gains` (two sweeps, and one on a cluster that loses a
worker), `devices` (sweeps that measure, on one and on two devices of the processor),
`instances` (the closed loop of a second, side by side, on what JAX finds) or `table` (a
million rows, a tenth of them with a result, nothing fitted). What is printed is what
docs/scale.md says.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import xarray as xr

import hydrojax
from benchmarks.fleet import Watch
from benchmarks.speed.measured import Section
from benchmarks.speed.scaling import by_batch
from hydrojax.workflows.fleet import run as fleet
from hydrojax.workflows.fleet.report import write_fleet_report
from hydrojax.workflows.fleet.work import memory
from tests.fleet_solvers import result

CHUNK = 256
"""Gain sets in a chunk of a sweep of the linearised loop."""


DEVICES = "--xla_force_host_platform_device_count"


def sweep(
    out: Path, side: int, *more: str, lose: bool = False, devices: int = 1
) -> float:
    """A sweep of `side` times `side` gain sets; its seconds.

    `lose`: its busiest worker is killed after a third; `devices`: so many of the
    processor.
    """
    shutil.rmtree(out, ignore_errors=True)
    rig = Path(hydrojax.__file__).parent / "paper" / "reference.toml"
    axes = [f"k_p=0.2:4:{side}", f"k_f=0.2:6:{side}"]
    words = ["sweep", str(rig), "--over", *axes, "--out", str(out), *more]
    began = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "hydrojax.cli", *words], stdout=subprocess.DEVNULL,
        env=os.environ | {"XLA_FLAGS": f"{DEVICES}={devices}"},
    )  # fmt: skip
    watch = Watch(process)
    watch.start()
    left = lose
    while process.poll() is None:
        if left and len(list(out.glob("parts/*.npz"))) >= side**2 / CHUNK / 3:
            busy = psutil.Process(process.pid).children(recursive=True)
            max(busy, key=lambda p: p.memory_info().rss).kill()
            left = False
        time.sleep(0.1)
    took = time.perf_counter() - began
    whole = (out / "sweep.nc").stat().st_size / side**2
    parts = sum(p.stat().st_size for p in out.glob("parts/*")) / side**2
    print(
        f"{out.name}: {side**2} gain sets in {took:.1f} s; each {whole:.0f} bytes in "
        f"sweep.nc, {parts:.0f} in parts; memory, MB: {watch.said()}",
        flush=True,
    )
    return took


def gains(folder: Path) -> None:
    """Two sweeps for the cost of a gain set; the larger again on a cluster."""
    small, large = 32, 128
    sweep(folder / "compiled", small)  # the programs are on disk after it
    took = sweep(folder / "small", small), sweep(folder / "large", large)
    sweep(folder / "shared", large, "--cluster", "local:2", lose=True)
    one, two = (
        xr.load_dataset(folder / n / "sweep.nc", engine="h5netcdf")
        for n in ("large", "shared")
    )
    same = all(np.array_equal(one[n], two[n], equal_nan=True) for n in one)
    each = (took[1] - took[0]) / (large**2 - small**2)
    print(
        f"{1e3 * each:.3f} ms a gain set beyond the start; shared, a worker killed: "
        f"{'the same numbers' if same else 'OTHER NUMBERS'}"
    )


def devices(folder: Path) -> None:
    """Gain sets measured in simulation on one device with threads, and on two."""
    small, large = 12, 32
    for count in (1, 2):
        took = [
            sweep(folder / f"{name} {count}", side, "--by", "multisine", devices=count)
            for name, side in (("compiled", small), ("small", small), ("large", large))
        ]
        each = (took[2] - took[1]) / (large**2 - small**2)
        print(f"{count} devices: {1e3 * each:.2f} ms a gain set beyond the start")


def long_table(folder: Path, rows: int) -> None:
    """What a table of so many rows costs when all its results are there."""
    source, out = folder / "long.csv", folder / "long"
    shutil.rmtree(out, ignore_errors=True)
    with source.open("w") as file:
        file.write("rig,fit,validate,temperature [degC]\n")
        for i in range(rows):
            file.write(f"rig.toml,m{i % 997}/fit_{i}.csv,validate.csv,{i % 61}\n")
    began, at = time.perf_counter(), memory()
    jobs = fleet.read_jobs(source)
    read = time.perf_counter()
    keys = fleet.keys_of(jobs, fleet.Options())
    print(
        f"{rows} rows: read and checked in {read - began:.1f} s, keys in "
        f"{time.perf_counter() - read:.1f} s, memory grew by "
        f"{(memory() - at) / 1e6:.0f} MB",
        flush=True,
    )
    store, part = fleet.Store(out), keys[: rows // 10]
    rng = np.random.default_rng(0)
    began = time.perf_counter()
    for key in part:
        found = {"key": key, "failed": "", **result(10 + rng.normal())}
        store.save(key, found, final=True)
    saved, at = time.perf_counter(), memory()
    have = store.done()
    found = time.perf_counter()
    few = type(jobs)(jobs.source, jobs.folder, jobs.table.iloc[: len(part)])
    fleet.merge(store, few, part, "study")
    merged = time.perf_counter()
    write_fleet_report(store, part, "study")
    print(
        f"{len(have)} results: kept in {saved - began:.1f} s, found in "
        f"{found - saved:.1f} s, merged in {merged - found:.1f} s, report in "
        f"{time.perf_counter() - merged:.1f} s, memory grew by "
        f"{(memory() - at) / 1e6:.0f} MB"
    )


def instances() -> None:
    """Seconds of the closed loop over a second at 1 kHz, by instances side by side."""
    section = Section()
    for point in by_batch(section, False, lambda said: print(said, file=sys.stderr)):
        one = 1e9 * point["seconds"] / (1000 * point["x"])
        print(
            f"{point['x']:9,.0f} instances: {point['seconds']:8.3f} s, {one:10.1f} ns "
            f"a period and instance; {point['ready_s']:.0f} s until it is compiled"
        )
    for said in section.notes:
        print(said)


def main() -> None:
    """One part of the study."""
    given = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    given.add_argument("part", choices=("gains", "devices", "instances", "table"))
    given.add_argument("--out", type=Path, default=Path("hydrojax-scale-study"))
    given.add_argument("--rows", type=int, default=1_000_000)
    words = given.parse_args()
    words.out.mkdir(parents=True, exist_ok=True)
    if words.part == "gains":
        gains(words.out)
    elif words.part == "devices":
        devices(words.out)
    elif words.part == "instances":
        instances()
    else:
        long_table(words.out, words.rows)


if __name__ == "__main__":
    main()
