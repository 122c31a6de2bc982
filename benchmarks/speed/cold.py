"""Work that is timed in a process of its own, from its first line on.

Run as `python -m benchmarks.speed.cold MODULE:FUNCTION GIVEN CACHE`; one line of JSON
comes out. `CACHE` is where compiled programs are kept; empty keeps none.
"""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from .children import Failed, environment


def fresh(maker: str, given: dict[str, Any], cache: str = "") -> dict[str, Any]:
    """Call `module:function` of this package in a new process.

    Returns:
        What it returned, if that is a dictionary, with `start_s` (until JAX was set
        up), `whole_s` and `peak_mib`.

    Raises:
        Failed: it ended badly; the text is its last line.
    """
    with tempfile.TemporaryDirectory(prefix="hydrojax-speed.") as own:
        began = time.perf_counter()
        words = [sys.executable, "-m", f"{__package__}.cold", maker]
        done = subprocess.run(
            [*words, json.dumps(given), cache],
            capture_output=True, text=True, env=environment(Path(own)), check=False,
        )  # fmt: skip
        whole = time.perf_counter() - began
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no word"])[-1]
        raise Failed(f"{maker}: code {done.returncode}: {last}")
    return json.loads(done.stdout.splitlines()[-1]) | {"whole_s": whole}


def device() -> dict[str, Any]:
    """What JAX runs on, in its own words."""
    import jax

    return {"device": jax.devices()[0].device_kind}


def main() -> None:
    """Do it, and say how it went."""
    began = time.perf_counter()
    from hydrojax.jax_setup import set_up_jax

    from .timing import peak_mib

    maker, given, cache = sys.argv[1:]
    out, sys.stdout = sys.stdout, sys.stderr
    set_up_jax(Path(cache) if cache else None)
    module, _, function = maker.partition(":")
    home = importlib.import_module(f"{__package__}.{module}")
    start = time.perf_counter() - began
    found = getattr(home, function)(**json.loads(given))
    said = found if isinstance(found, dict) else {}
    out.write(json.dumps({"start_s": start, "peak_mib": peak_mib(), **said}) + "\n")


if __name__ == "__main__":
    main()
