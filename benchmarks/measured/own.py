"""What hydrojax makes of the measured sets."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from benchmarks.measured.sets import Measured
from benchmarks.recorded import PUBLISHED
from hydrojax.identify.case import Case

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


class Own(NamedTuple):
    """How far off hydrojax is on one set, in runs through whole validation logs.

    Attributes:
        rows: RMS error by what was run, in the set's unit; None where it diverges.
        said: what was found, in a line.
        seconds: to fit, or to trace, with what was compiled.
    """

    rows: dict[str, float | None]
    said: str
    seconds: float


def axis(data: Path, measured: Measured) -> Own:
    """EMPS: its position, fitted to whole runs, beside what others have."""
    import hydrojax as hj

    folder = data / measured.folder
    began = time.perf_counter()
    rig = hj.RigFile.from_text(RIG)
    found = hj.fit(rig, [folder / "fit.csv"], validate=[folder / "validate.csv"])
    seconds = time.perf_counter() - began
    motion = found.outcome.motion
    if motion is None:
        raise RuntimeError("EMPS has no motion to predict")
    whole = motion.channels["x"].horizons["free"]
    rows = {
        "hydrojax": whole.after,
        "hydrojax, fitted to the balance of forces": motion.windows["x"],
        "published parameters (least squares)": _published(found.case),
        "ARX(4, 4) at every tick of 1 ms": whole.arx,
        "held where it began": whole.held,
    }
    values = (
        f"{name} {p.value:.4g}"
        + (f" (published {PUBLISHED[name]:.4g})" if name in PUBLISHED else "")
        + f" {p.unit}"
        for name, p in motion.values.items()
    )
    return Own(_in_unit(rows, measured), ", ".join(values), seconds)


def traced(data: Path, measured: Measured) -> Own:
    """The force of a rig that leaves effects out: before and after a trace."""
    from hydrojax.identify import api
    from hydrojax.identify.case import open_case

    folder = data / measured.folder
    began = time.perf_counter()
    logs, others = sorted(folder.glob("fit*")), sorted(folder.glob("validate*"))
    outcome = api.trace_case(open_case(folder / "rig.toml", logs, others))
    seconds = time.perf_counter() - began
    whole = outcome.channels["F"].horizons["free"]
    rows = {"hydrojax": whole.after, "hydrojax, as declared": whole.before}
    named = ", ".join(e.name for e in outcome.effects) or "nothing"
    return Own(_in_unit(rows, measured), f"{outcome.verdict}: {named}", seconds)


def _in_unit(
    rows: Mapping[str, float | None], measured: Measured
) -> dict[str, float | None]:
    return {n: None if e is None else e / measured.size for n, e in rows.items()}


def _published(case: Case) -> float | None:
    """The same run with the published parameters, friction by the sign of v, m."""
    from hydrojax.identify.motion.predict import predict_motion

    published = {"L_slope": 1e6, "z_ss": 1e-7, **PUBLISHED}
    motion = predict_motion(case, {}, published, {}, ())
    return motion and motion.windows["x"]


OWN: Mapping[str, Callable[[Path, Measured], Own]] = {
    "EMPS": axis,
    "KDN seal": traced,
    "circular seal": traced,
    "O-ring 257": traced,
    "friction damper": traced,
}
"""How each set is run; what is missing has no layout that a rig file could name."""
