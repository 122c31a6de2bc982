"""What the tests of a fleet have in place of a fit: quick, and odd where asked."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hydrojax.errors import InputError
from hydrojax.workflows.fleet.jobs import Job
from hydrojax.workflows.fleet.run import Stopped, run_fleet
from hydrojax.workflows.fleet.work import Options


def pretend(job: Job, options: Options) -> dict[str, Any]:
    """A result made of the log's own text, which says how it is to go.

    Every call leaves its process's id beside the log, so that calls can be counted.
    """
    log = Path(job.fit[0])
    if not log.is_file():
        raise InputError(f"{log}: no such file; check the path")
    with log.with_suffix(".calls").open("a") as calls:
        calls.write(f"{os.getpid()}\n")
    words = json.loads(log.read_text())
    time.sleep(words.get("seconds", 0.0))
    if "holds" in words:
        held = np.ones(words["holds"] // 8)
        time.sleep(60 * held[0])
    if "bad" in words:
        raise InputError(f"{log}: {words['bad']}")
    if "fault" in words:
        raise RuntimeError(words["fault"])
    if words.get("dies"):
        os.kill(os.getpid(), signal.SIGKILL)
    found = result(words["value"], words.get("effects", []))
    found["seconds"] = {"compile": 0.1, "run": words.get("seconds", 0.0)}
    return found


def result(value: float, effects: Sequence[str] = ()) -> dict[str, Any]:
    """What is kept of a fit; its parameters are multiples of `value`."""
    return {
        "rig": "pretended",
        "verdict": "explained" if effects else "nothing missing",
        "sentence": "as pretended",
        "parameters": {
            name: parameter(value * factor, unit)
            for name, factor, unit in (
                ("beta", 1e8, "Pa"), ("k_cp", 100.0, "N"), ("k_vp", 10.0, "N*s/m"),
            )
        },
        "channels": {
            "F": {"unit": "N", "noise": 2.5, "before": 5.0 * value, "after": 2.6}
        },
        "effects": [{"name": n, "alike": []} for n in effects],
        "friction": {
            "inside": ["k_cp", "k_vp"],
            "covariance": np.diag([1.0, 0.01]).tolist(),
            "ranges": {"k_cp": [0.0, 4000.0], "k_vp": [-3e4, 3e4]},
        },
    }  # fmt: skip


def parameter(value: float, unit: str) -> dict[str, Any]:
    std = 0.01 * abs(value)
    return {
        "value": value, "std": std, "low": value - 1.96 * std,
        "high": value + 1.96 * std, "unit": unit, "identified": True, "at_bound": False,
    }  # fmt: skip


def main(table: str, out: str, cluster: str = "") -> None:
    """A fleet by `pretend`, as a process of its own that can be killed."""
    try:
        ran = run_fleet(
            table, Path(out), workers=2, cluster=cluster,
            solver="tests.fleet_solvers:pretend", report=False,
        )  # fmt: skip
        print(ran.jobs, ran.done, ran.failed, ran.fresh)
    except Stopped as stop:
        print(stop)


if __name__ == "__main__":
    # A shell starts what runs in its background with Ctrl-C ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    main(*sys.argv[1:])
