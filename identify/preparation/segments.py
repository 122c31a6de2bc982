"""A log's stretches without gaps: position as a spline, speed and acceleration in the
band where they are no noise, everything else at its ticks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import interpolate
from scipy.signal import savgol_filter

from hydrojax.identify.preparation.noise import (
    derivatives,
    force_areas,
    motion_band,
    sensor_noise_of,
    smooth,
)
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.logs.log import Log
from hydrojax.rigfile.recording import position
from hydrojax.rigfile.schema import RigFile

SMOOTH = 15
"""Ticks over which a logged force is smoothed before it stretches anything: flat to
some 40 Hz on a log at 1 kHz."""


@dataclass(frozen=True)
class Segment:
    """One segment's signals at its ticks, all SI; see `Windows` for the names.

    `place` gives the position between ticks.
    """

    log: int
    origin: float  # when the log began
    t: Float[np.ndarray, "ticks"]
    place: interpolate.BSpline
    v: Float[np.ndarray, "ticks"]
    a: Float[np.ndarray, "ticks"]
    u: Float[np.ndarray, "ticks"]
    runs_on: float  # see `Motion`
    P_s: Float[np.ndarray, "ticks"]
    P_r: Float[np.ndarray, "ticks"]
    P: Float[np.ndarray, "ticks 2"]  # as logged
    dP: Float[np.ndarray, "ticks 3 2"]  # of P and P_s, smoothed
    F: Float[np.ndarray, "ticks"]
    smoothed: Float[np.ndarray, "ticks"]  # the force on the rod, for what it stretches


def common_band(
    logs: Sequence[Log],
    spec: RigFile,
    driven_by: str,
    criteria: Criteria = Criteria(),
) -> float:
    """The narrowest of the logs' bands, Hz; inf if none is needed."""
    bands = [
        motion_band(
            log.time[slice(*rows)],
            position(log, spec)[slice(*rows)],
            driven_by,
            criteria,
        )
        for log in logs
        for rows in log.segments
    ]
    return min((b for b in bands if b is not None), default=np.inf)


def segment(
    i: int,
    log: Log,
    spec: RigFile,
    rows: slice,
    driven_by: str,
    sign: float,
    band: float,
) -> Segment:
    """The signals of a log's rows, motion turned round by `sign` and cut at `band` Hz.

    `i` is the log's place among those that are made ready.
    """
    t, x = log.time[rows], sign * position(log, spec)[rows]
    get = {k: v[rows] for k, v in log.signals.items()}
    zero = np.zeros(t.size)
    F = get.get("F", zero + spec.output_load.get("F", np.nan))
    supply = {k: get.get(k, zero + v) for k, v in spec.line.items()}
    # Where u drives a log without pressures, they start midway: a first guess.
    middle = (supply["P_s"] + supply["P_r"]) / 2 if "u" in get else zero
    P = np.stack([get.get("P_a1", middle), get.get("P_a2", middle)], axis=1)
    if "P" in get and "P_a2" not in get:
        P = np.stack([zero, get["P"]], axis=1)
    place = interpolate.make_interp_spline(t, x, k=5)
    v, a = place(t, 1), place(t, 2)
    if np.isfinite(band):
        smoothed = smooth(t, x, band)
        # Speed is less rough than acceleration: it is followed an octave further.
        a, v = smoothed(t, 2), smooth(t, x, 2 * band)(t, 1)
        if "u" not in get:
            # Displacement stays as it is, for the bristle.
            place, v = interpolate.make_interp_spline(t, x, k=1), smoothed(t, 1)
        if driven_by == "P":
            # An axis driven by a force is mostly inertia: compared in its band.
            P = np.stack([smooth(t, p, band)(t) for p in P.T], axis=1)
            F = smooth(t, F, band)(t) if np.ptp(F) > 0 else F
    pushed = "F" not in get and has_rod_force(log, spec)
    stretches = _pushed(t, P, spec) if pushed else _smoothed(F)
    return Segment(
        log=i,
        origin=float(log.time[0]),
        t=t,
        place=place,
        v=v,
        a=a,
        u=get.get("u", zero),
        runs_on=runs_on(spec),
        P_s=supply["P_s"],
        P_r=supply["P_r"],
        P=P,
        dP=np.stack([derivatives(t, p) for p in (*P.T, supply["P_s"])], axis=1),
        F=F,
        smoothed=stretches,
    )


def has_rod_force(log: Log, spec: RigFile) -> bool:
    """Whether the force on the rod is known: logged, or nearly so from both pressures
    where nothing else says what it is.
    """
    if "F" in log.signals:
        return True
    return {"P_a1", "P_a2"} <= set(log.signals) and "F" not in spec.output_load


def _pushed(
    t: Float[np.ndarray, "ticks"], P: Float[np.ndarray, "ticks 2"], spec: RigFile
) -> Float[np.ndarray, "ticks"]:
    """The force on the rod by the measured pressures, N; the piston's friction, of
    which such logs say nothing, is left in it.
    """
    smoothed = []
    for p in P.T:
        noise = sensor_noise_of([(t, p)])
        smoothed.append(noise.smoothed(t, p) if noise else p)
    area_1, area_2 = force_areas(spec)
    return area_2 * smoothed[1] - area_1 * smoothed[0]


def runs_on(spec: RigFile) -> float:
    """Share of the way to the next row's command that it goes from each row."""
    return float("u" in spec.channels and not spec.channels["u"].held)


def over_ticks(
    u: Float[np.ndarray, "ticks"], runs_on: float
) -> Float[np.ndarray, "ticks"]:
    """The command's mean over the tick that begins at each."""
    return u + runs_on / 2 * np.diff(u, append=u[-1:])


def _smoothed(F: np.ndarray) -> np.ndarray:
    """A measured force without most of its noise, which what gives would follow."""
    if not np.isfinite(F).all():
        return np.zeros(F.size)
    return np.asarray(savgol_filter(F, SMOOTH, 3))
