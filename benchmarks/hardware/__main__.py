"""Latency of the exported plant beside the exported law, in C, at 1 kHz and 10 kHz.

Run as `python -m benchmarks.hardware`: a rig's C (`hydrojax export --to c`) is
compiled, and runs a million periods of the closed loop at each rate as fast as it can;
each period's time is kept, and its percentiles and a histogram are printed. `--paced N`
runs N more at each rate with the clock: latency is then from the planned beginning of
a period to its end, the operating system's delay included. On a system without real
time that is what most of it is.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

HERE = Path(__file__).parent
RATES = (1000.0, 10_000.0)
SHARES = (50.0, 99.0, 99.99, 100.0)
"""The percentiles that are printed; the last is the worst."""

BINS = 10.0 ** np.arange(2, 9)
"""Edges of the histogram, ns."""


class Latency(NamedTuple):
    """Times of each period, ns: to its end, the law's, the plant's; and the loop's RMS
    error of force and desired force, N.
    """

    periods: Float[np.ndarray, "N 3"]
    error: float
    asked: float


def build(rig: Path, folder: Path) -> Path:
    """The program of a rig's closed loop.

    Raises:
        InputError: there is no C compiler, or the rig cannot be run.
    """
    from hydrojax.errors import InputError
    from hydrojax.export import export
    from hydrojax.export.codegen.compiler import compiler
    from hydrojax.rigfile.schema import RigFile

    cc = compiler()
    if cc is None:
        raise InputError("no C compiler; install gcc or clang, or name one in CC")
    for name, content in export(RigFile.load(rig), ["c"]).files.items():
        (folder / name).write_bytes(content)
    sources = [folder / "plant.c", folder / "law.c", HERE / "loop.c"]
    flags = ["-std=c99", "-O2", f"-I{folder}"]
    made = folder / "loop"
    subprocess.run([cc, *flags, *sources, "-lm", "-o", made], check=True)
    return made


def measure(program: Path, rate: float, periods: int, paced: bool) -> Latency:
    """So many periods at `rate` Hz."""
    words = [program, f"{rate:g}", str(periods), str(int(paced))]
    done = subprocess.run(words, capture_output=True, check=True)
    table = np.frombuffer(done.stdout).reshape(-1, 3)
    return Latency(table[:-1], float(table[-1, 0]), float(table[-1, 1]))


def lines(latency: Latency, rate: float, paced: bool) -> list[str]:
    """What is printed of one measurement."""
    whole = latency.periods[:, 0]
    late = int(np.sum(whole > 1e9 / rate))
    way = "paced" if paced else "as fast as may be"
    title = f"{rate:g} Hz, {len(whole)} periods, {way}"
    out = [
        f"{title}: F_d - F {latency.error:.1f} N RMS, {late} periods too long",
        f"{'us':>12}" + "".join(f"{f'p{share:g}':>10}" for share in SHARES),
    ]
    for i, name in enumerate(("period", "law", "plant")):
        found = np.percentile(latency.periods[:, i], SHARES) / 1e3
        out.append(f"{name:>12}" + "".join(f"{v:10.2f}" for v in found))
    counts, _ = np.histogram(whole, BINS)
    for low, high, n in zip(BINS[:-1], BINS[1:], counts, strict=True):
        bar = "#" * int(np.ceil(40 * n / len(whole)))
        out.append(f"{low / 1e3:>8g} to {high / 1e3:<8g} us {n:>9} {bar}")
    return out


def main() -> None:
    """Print the latencies of both rates."""
    from hydrojax.jax_setup import set_up_jax, user_cache

    reference = resources.files("hydrojax") / "paper" / "reference.toml"
    parser = argparse.ArgumentParser(description="Latency of plant and law in C.")
    parser.add_argument("--rig", type=Path, default=Path(str(reference)))
    parser.add_argument("--periods", type=int, default=1_000_000)
    parser.add_argument("--paced", type=int, default=0, help="periods with the clock")
    given = parser.parse_args()
    set_up_jax(user_cache())
    with tempfile.TemporaryDirectory() as folder:
        program = build(given.rig, Path(folder))
        for rate in RATES:
            for paced, periods in ((False, given.periods), (True, given.paced)):
                if periods:
                    found = measure(program, rate, periods, paced)
                    print("\n".join(lines(found, rate, paced)), flush=True)


if __name__ == "__main__":
    main()
