"""A process that makes programs ready and runs them when it is told to.

Run as `python -m benchmarks.speed.worker SETTING`. One line of JSON in, one out. XLA
reads its flags once a process, so programs of other flags live in other processes.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
import traceback
from collections.abc import Callable
from typing import Any

from . import timing

LEAST = 0.05
"""Seconds that one timing takes at least: a short program is run several times."""


def _loops() -> None:
    from hydrojax.jax_setup import LOOPS, set_up_jax

    set_up_jax(work=LOOPS)


def _single_loops() -> None:
    import jax

    _loops()
    jax.config.update("jax_enable_x64", False)


def _fits() -> None:
    from hydrojax.jax_setup import FITS, set_up_jax

    set_up_jax(work=FITS)


def _both() -> None:
    from hydrojax.jax_setup import FITS, LOOPS

    _loops()
    more = f"{LOOPS},{FITS.partition('options=')[2]}"
    os.environ["XLA_FLAGS"] = os.environ["XLA_FLAGS"].replace(LOOPS, more)


def _default() -> None:
    import jax

    os.environ.pop("XLA_FLAGS", None)
    jax.config.update("jax_enable_x64", True)


SETTINGS: dict[str, Callable[[], None]] = {
    "loops": _loops,
    "loops f32": _single_loops,
    "fits": _fits,
    "both": _both,
    "default": _default,
}
"""What a process does before JAX starts: as the command line sets it up for closed
loops; the same in single precision; for fits; with the options of both (for peers);
double precision and nothing else."""


class Desk:
    """The programs that are ready, by name."""

    def __init__(self):
        self.ready: dict[str, Callable[[], Any]] = {}
        self.compiling = timing.Compiling()

    def prepare(self, name: str, maker: str, given: dict[str, Any]) -> dict[str, Any]:
        """Make a program by `module:function` and run it once.

        The maker reads its data and gives what builds the program; building gives what
        runs it. `answer` is what the first run gave, `ready_s` the building and what
        the first run took longer than the second.
        """
        module, _, function = maker.partition(":")
        home = importlib.import_module(f"{__package__}.{module}")
        build = getattr(home, function)(**given)
        timing.forget_peak()
        began, compiled = time.perf_counter(), self.compiling.seconds
        run = build()
        answer = run()
        first = time.perf_counter() - began
        self.ready[name] = run
        return {
            "answer": _plain_data(answer),
            "ready_s": max(first - timing.timed(run), 0.0),
            "compile_s": self.compiling.seconds - compiled,
            "peak_mib": timing.peak_mib(),
            "device_mib": timing.device_mib(),
        }

    def run(self, name: str) -> dict[str, Any]:
        """Seconds of one run."""
        return {"seconds": timing.timed(self.ready[name], LEAST)}

    def forget(self, name: str) -> dict[str, Any]:
        """Drop a program and what it holds."""
        self.ready.pop(name, None)
        return {}


def _plain_data(answer: Any) -> Any:
    """What JSON takes of an answer: numbers, text, and lists of them."""
    if isinstance(answer, dict):
        return {str(k): _plain_data(v) for k, v in answer.items()}
    if isinstance(answer, (list, tuple)):
        return [_plain_data(v) for v in answer]
    if answer is None or isinstance(answer, (str, bool, int, float)):
        return answer
    import numpy as np

    return np.asarray(answer, float).tolist()


def main() -> None:
    """Serve until the input ends."""
    # What a library prints must not be taken for an answer.
    out, sys.stdout = sys.stdout, sys.stderr
    SETTINGS[sys.argv[1]]()
    desk = Desk()
    for line in sys.stdin:
        asked = json.loads(line)
        do = asked.pop("do")
        try:
            said = getattr(desk, do)(**asked)
        except Exception as error:  # told to who asked, who goes on without it
            traceback.print_exc()
            said = {"error": f"{type(error).__name__}: {error}".splitlines()[0]}
        out.write(json.dumps(said) + "\n")
        out.flush()


if __name__ == "__main__":
    main()
