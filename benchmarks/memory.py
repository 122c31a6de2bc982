"""How much memory a process takes that identifies or traces one rig after another.

Run as `python -m benchmarks.memory --rigs 6`: every rig is of another structure (a
cylinder with its rod on one side or on both, and one declared effect or another), so
that none finds the programs of the one before. A line is printed for each: the most
that the process has held meanwhile and what it holds afterwards. Programs that are not
on disk (`--cache`) are compiled, which takes most; a second run has the first one's.
"""

from __future__ import annotations

import argparse
import gc
import os
import time
from pathlib import Path

import numpy as np

EFFECTS = (
    "", "valve_lag", "stribeck", "internal_leakage", "valve_deadband", "gravity_load",
    "viscous_friction", "loadcell_lag", "payload_inertia", "dead_volume",
    "supply_line_drop", "pressure_friction", "entrained_air", "external_leakage",
)  # fmt: skip
LAYOUTS = ("pull-pull", "differential")


def rigs(folder: Path, count: int, seconds: float) -> list[Path]:
    """Folders of so many rigs, each with its rig file and logs, made once."""
    from benchmarks.trace import cases, tracing

    out = []
    for i in range(count):
        layout, effect = LAYOUTS[i % 2], EFFECTS[i // 2 % len(EFFECTS)]
        spec = cases.CaseSpec(f"memory-{layout}", "nothing", layout=layout)
        if not (folder / spec.name / "truth.json").exists():
            cases.write_cases([spec], folder, seconds=seconds)
        place = folder / f"rig_{i}"
        place.mkdir(exist_ok=True)
        text = (folder / spec.name / "rig.toml").read_text()
        declared = tracing.declare([effect] if effect else [])
        (place / "rig.toml").write_text(text + declared)
        for name in cases.LOGS:
            (place / name).unlink(missing_ok=True)
            (place / name).symlink_to((folder / spec.name / name).absolute())
        out.append(place)
    return out


def main() -> None:
    """Identify or trace them all; exit 1 where the process held more than it may."""
    parser = argparse.ArgumentParser(description="Memory of a process of many rigs.")
    parser.add_argument("--rigs", type=int, default=6)
    parser.add_argument("--command", choices=("identify", "trace"), default="trace")
    parser.add_argument("--seconds", type=float, default=4.0, help="of each log")
    parser.add_argument("--most", type=float, default=1.5, help="GiB")
    parser.add_argument("--cache", type=Path, help="folder of compiled programs")
    parser.add_argument("--out", type=Path, default=Path("memory-benchmark"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    from benchmarks.damage.doors import held
    from benchmarks.trace.cases import LOGS
    from hydrojax.jax_setup import resident, return_freed_memory, set_up_jax

    set_up_jax(given.cache or given.out / "programs")
    from hydrojax.identify import api
    from hydrojax.identify.case import open_case

    work = {"identify": api.identify, "trace": api.trace_case}[given.command]
    places = rigs(given.out, given.rigs, given.seconds)
    rest, most = [], 0
    for place in places:
        held()
        began, cpu = time.perf_counter(), time.process_time()
        logs = [place / name for name in LOGS]
        work(open_case(place / "rig.toml", logs[:-1], logs[-1:]), starts=1)
        peak = held()
        gc.collect()
        return_freed_memory()
        rest.append(resident(os.getpid()))
        most = max(most, peak)
        took, busy = time.perf_counter() - began, time.process_time() - cpu
        print(
            f"{place.name}: {took:.0f} s ({busy:.0f} of processors), at most "
            f"{peak >> 20} MiB, {rest[-1] >> 20} after",
            flush=True,
        )
    half = rest[len(rest) // 2 :]
    growth = np.polyfit(range(len(half)), half, 1)[0] if len(half) > 1 else 0.0
    print(
        f"{len(places)} rigs: at most {most / 2**30:.2f} GiB; "
        f"{growth / 2**20:+.0f} MiB a rig over the second half"
    )
    raise SystemExit(most > given.most * 2**30)


if __name__ == "__main__":
    main()
