"""Run measured axes through whole logs, and print how far off their position is.

Run as `python -m benchmarks.measured DATA`, where DATA holds `emps/fit.csv` and
`emps/validate.csv` (EMPS: https://www.nonlinearbenchmark.org, columns `time [s]`,
`x [m]`, `P [N]`). Fitted to the one, run through the other: the position as the drive
force alone gives it, from the first half second on.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.recorded import PUBLISHED
from hydrojax.jax_setup import set_up_jax

RIG = """
name = "EMPS"
layout = "driven-axis"
[load]
F = "0 N"
predicts = "x"
[parameters]
k_cp = { start = "10 N", range = ["0 N", "200 N"] }
k_cn = { start = "10 N", range = ["0 N", "200 N"] }
k_0 = { start = "0 N", range = ["-50 N", "50 N"] }
k_vp = "0 N*s/m"
k_vn = "0 N*s/m"
k_fp = "0"
k_fn = "0"
z_ss = { start = "50 um", range = ["2 um", "1 mm"] }
delta = "0.01 1/N"
[effects.viscous_friction]
b = { start = "50 N*s/m", range = ["0 N*s/m", "2000 N*s/m"] }
[effects.payload_inertia]
m = { start = "50 kg", range = ["1 kg", "1000 kg"] }
"""
"""Starts up to twice and half of what is published, as a user would guess them."""


def main(data: str) -> None:
    """Fit EMPS and print its runs."""
    set_up_jax()
    import hydrojax as hj

    folder = Path(data) / "emps"
    began = time.perf_counter()
    rig = hj.RigFile.from_text(RIG)
    found = hj.fit(rig, [folder / "fit.csv"], validate=[folder / "validate.csv"])
    seconds = time.perf_counter() - began
    motion = found.outcome.motion
    if motion is None:
        raise RuntimeError("EMPS has no motion to predict")
    table = Table("EMPS, whole validation log", "RMS error of x, mm")
    whole = motion.errors.horizons["free"]
    rows = {
        "fitted to whole runs": whole.after,
        "fitted to the balance of forces": motion.windows,
        "published parameters (least squares)": _published(found.case),
        "ARX(4, 4), simulated": whole.arx,
        "held where it began": whole.held,
    }
    for name, value in rows.items():
        table.add_row(name, "diverges" if value is None else f"{1e3 * value:.2f}")
    console = Console(width=120)
    console.print(table)
    values = Table("parameter", "of whole runs", "of forces", "published", "unit")
    for name, p in motion.values.items():
        other = PUBLISHED.get(name)
        shown = "" if other is None else f"{other:.4g}"
        values.add_row(name, f"{p.value:.4g}", f"{p.windows:.4g}", shown, p.unit)
    console.print(values)
    console.print(f"{seconds:.0f} s, with what was compiled")


def _published(case) -> float | None:
    """The same run with the published parameters, friction by the sign of v, m."""
    from hydrojax.identify.motion.predict import predict_motion

    published = {"L_slope": 1e6, "z_ss": 1e-7, **PUBLISHED}
    motion = predict_motion(case, {}, published, {}, ())
    return motion and motion.windows


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("python -m benchmarks.measured DATA")
    main(sys.argv[1])
