"""What hydrojax makes of the measured sets."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

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


TICK, PLACE, PUSH = 0.01, 0.1, 1000.0
"""What a tick (s), a unit of the position (m) and one of the pressure (N) of the robot
arm are taken for: its log says none of them."""

EDGE = '{ start = "2e-6 m^3/(s*Pa^0.5)", range = ["1e-9 m^3/(s*Pa^0.5)", "1e-4 m^3/(s*Pa^0.5)"] }'  # noqa: E501
ARM = f"""
name = "robot arm"
layout = "differential"
[geometry]
area_1 = "1e-3 m^2"
area_2 = "2e-3 m^2"
chamber_length = "0.6 m"
[supply]
P_s = "SUPPLY"
P_r = "0 Pa"
[load]
predicts = "x"
mass = {{ start = "400 kg", range = ["5 kg", "5000 kg"] }}
damping = {{ start = "8000 N*s/m", range = ["0 N*s/m", "80 kN*s/m"] }}
second_mass = {{ start = "300 kg", range = ["5 kg", "5000 kg"] }}
second_stiffness = {{ start = "200 kN/m", range = ["1 kN/m", "10000 kN/m"] }}
second_damping = {{ start = "1000 N*s/m", range = ["0 N*s/m", "100 kN*s/m"] }}
[channels]
u = {{ column = "u", unit = "1" }}
x = {{ column = "x", unit = "m", scale = {PLACE} }}
F = {{ column = "p", unit = "N", scale = {PUSH} }}
[parameters]
beta = {{ start = "1e8 Pa", range = ["5e6 Pa", "3e9 Pa"] }}
c_p1 = {EDGE}
c_n1 = {EDGE}
c_p2 = {EDGE}
c_n2 = {EDGE}
[effects.supply_line_drop]
k_s = {{ start = "2e13 Pa*s^2/m^6", range = ["0 Pa*s^2/m^6", "1e18 Pa*s^2/m^6"] }}
[effects.valve_lag]
tau = {{ start = "20 ms", range = ["0 ms", "50 ms"] }}
[effects.flow_curve]
k = "1"
p = {{ start = "1.8", range = ["1.2", "5"] }}
"""
"""The areas are those of a common cylinder, two to one, since the arm moves down twice
as fast."""

SUPPLIES = ("3 MPa", "4 MPa", "5 MPa", "6 MPa", "8 MPa", "12 MPa")
"""What its supply may have been; the one is taken with which the first half of the log
is predicted best."""


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


def arm(data: Path, measured: Measured) -> Own:
    """The net pressure of a valve-driven arm that bends, from its command alone; fitted
    to pressure and position of the first half.
    """
    import hydrojax as hj

    table = pd.read_csv(data / measured.folder / "log.csv")
    table.insert(0, "time [s]", TICK * np.arange(len(table)))
    (whole,) = measured.read(data, "validate")
    half = table[: whole.first]
    began = time.perf_counter()
    motions = {}
    for supply in SUPPLIES:
        rig = hj.RigFile.from_text(ARM.replace("SUPPLY", supply))
        motion = hj.fit(rig, [half], test=[table]).outcome.motion
        if motion is None:
            raise RuntimeError("the arm has no motion to predict")
        motions[supply] = motion
    seconds = time.perf_counter() - began

    def off(supply: str, signal: str, judged: bool) -> float:
        """RMS error in the half that is judged, or in the other, SI."""
        (run,) = motions[supply].series
        there = (run.t > (whole.first - 0.5) * TICK) == judged
        return float(np.sqrt(np.mean(run.after[signal][there] ** 2)))

    size = {"x": np.std(half["x"]) * PLACE, "F": np.std(half["p"]) * PUSH}
    best, *rest = sorted(
        SUPPLIES,
        key=lambda supply: np.hypot(*(off(supply, n, False) / size[n] for n in size)),
    )
    rows = {"hydrojax": off(best, "F", True) / PUSH}
    for supply in rest:
        name = f"hydrojax, were the supply {supply}"
        rows[name] = off(supply, "F", True) / PUSH
    own = off(best, "x", True) / PLACE / np.ptp(table["x"])
    said = f"supply {best}; position off by {own:.1%} of its range; "
    values = (f"{n} {p.value:.3g} {p.unit}" for n, p in motions[best].values.items())
    return Own(rows, said + ", ".join(values), seconds)


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
    "robot arm": arm,
}
"""How each set is run."""
