"""From logs to what the replay runs on: motion, windows, first guesses, noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from scipy import interpolate
from scipy.signal import savgol_filter

from ..errors import InputError
from ..record import position
from ..replay import Motion, Windows
from ..rigfile import RigSpec
from ..signals import Log
from .measured import (
    QUIET,
    channel_noise,
    force_areas,
    motion_band,
    smooth,
    supply_noise_of,
)

PRE = 60
"""Ticks of command ahead of a window, for whatever on its path has memory."""

COARSE, EACH = 40, 5
"""Steps ahead of those, and their ticks: a spool that slews slowly remembers longer
than it need be known tick by tick."""


LEAD = 20
"""Ticks at the head of a window that are run but not compared."""


SETTLE = 1.0
"""Seconds at the head of a segment that no window takes: what bristle, filtered speed
and film start from is unknown. Half of it in segments under `SHORT` seconds."""

SHORT = 5.0

SMOOTH = 15
"""Ticks over which a logged force is smoothed before it stretches anything: flat to
some 40 Hz on a log at 1 kHz."""


SLOWEST = 0.05
"""s between rows up to which a command is replayed: a chamber settles in far less."""

MOST_TICKS = 80_000
"""Ticks that a fit or a check takes in: more only cost time."""

RUN = 20
"""Windows that follow each other where only some of a log's are taken: friction is
followed through them, and through the seconds ahead, so that memory does not grow with
the length of the log."""
QUARTERS = 4
"""Steps of the bristle per tick."""


@dataclass(frozen=True)
class Data:
    """Logs made ready.

    Attributes:
        motion: see `Motion`; S segments.
        windows: see `Windows`; W windows.
        P_0: [W, 2] first guess of the pressures at each window's first tick, Pa.
        log: [W] which log each window comes from.
        noise: [3] standard deviation of each channel's noise, SI; inf if not compared.
        supply_noise: standard deviation of the measured P_s, Pa; 0 if not measured.
        driven_by: `u`, or what else drives the replay.
        band: Hz up to which acceleration (and, without u, speed and force) is taken.
        travel: range of x that is compared, m.
        areas: on which the two pressures push, m^2.
        notes: one-line remarks for the report.
    """

    motion: Motion
    windows: Windows
    P_0: np.ndarray
    log: np.ndarray
    noise: np.ndarray
    supply_noise: float
    driven_by: str
    band: float
    travel: tuple[float, float]
    areas: tuple[float, float]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Segment:
    """One segment's signals at its ticks, all SI; see `Windows` for the names.

    `place` gives the position between ticks.
    """

    log: int
    origin: float  # when the log began
    t: np.ndarray
    place: interpolate.BSpline
    v: np.ndarray
    a: np.ndarray
    u: np.ndarray
    P_s: np.ndarray
    P_r: np.ndarray
    P: np.ndarray  # [n, 2] as logged
    F: np.ndarray
    calm: np.ndarray  # F for what it stretches


def prepare(
    logs: Sequence[Log],
    spec: RigSpec,
    horizon: float = 0.25,
    noise: np.ndarray | None = None,
    sign: float = 1.0,
    band: float | None = None,
) -> Data:
    """Make logs ready for a replay of the rig.

    Args:
        logs: as `read_log` gives them, all with the same signals.
        spec: the rig they were recorded on.
        horizon: length of a window, s.
        noise: [3] to be used, or None to take the rig file's or estimate it.
        sign: -1 turns the motion round.
        band: Hz up to which acceleration is taken; None to find it.

    Raises:
        InputError: no motion, nothing to predict, logs that differ in their signals,
            or no stretch long enough for a window.
    """
    if not 0 < horizon < 1e4:
        raise InputError(f"--horizon {horizon}: give the length of a window in seconds")
    driven_by = _driver(logs, spec)
    notes = [f"{log.name}: {note}" for log in logs for note in log.notes]
    if band is None:
        band = common_band(logs, spec, driven_by)
    if np.isfinite(band):
        what = {"u": "it is", "P": "speed, acceleration and force are"}.get(
            driven_by, "speed and acceleration are"
        )
        notes.append(
            f"above {band:.0f} Hz acceleration would be noise of the position: {what} "
            "taken below that"
        )
    rows = [
        (i, slice(*own))
        for i, log in enumerate(logs)
        for own in log.segments
        if own[1] - own[0] > 20
    ]
    if not rows:
        raise InputError(f"{logs[0].name}: no stretch without gaps has over 20 rows")
    h = float(np.median(np.concatenate([np.diff(logs[i].time[r]) for i, r in rows])))
    if driven_by == "u" and h > SLOWEST:
        raise InputError(
            f"{logs[0].name}: a row every {h:.3g} s is too slow to replay what the "
            f"valve does: log at {1 / SLOWEST:.0f} Hz or more, or take u out of the log"
        )
    T = max(int(round(horizon / h)), 8)
    pre, lead = (PRE, LEAD) if driven_by == "u" else (1, min(LEAD, int(0.3 / h)))
    n = max(1, int(np.ceil(h / 1.5e-3))) if driven_by == "u" else 1
    starts = [_starts(logs[i].time[r], T, pre, lead) for i, r in rows]
    count, most = sum(map(len, starts)), max(MOST_TICKS // (lead + T), 1)
    if count == 0:
        raise InputError(
            f"{logs[0].name}: no stretch without gaps is longer than "
            f"{SETTLE / 2 + (pre + lead + T) * h:.2g} s: give a longer log or a "
            "shorter --horizon"
        )
    if count > most:
        rows, starts = _runs(rows, starts, most, lead + T)
        notes.append(
            f"{sum(map(len, starts))} windows of {count}, in runs spread evenly, were "
            "used: the logs hold more than a fit needs"
        )
    segments = [_segment(i, logs[i], spec, r, driven_by, sign, band) for i, r in rows]
    cuts = [(k, first) for k, own in enumerate(starts) for first in own]
    windows, P_0 = _windows(segments, cuts, T, pre, lead, n)
    travel = (float(windows.x.min()), float(windows.x.max()))
    if noise is None:
        noise = channel_noise(logs, spec, driven_by)
    return Data(
        motion=_motion(segments, h),
        windows=windows,
        P_0=P_0,
        log=np.array([segments[k].log for k, _ in cuts]),
        noise=noise,
        supply_noise=supply_noise_of(logs, spec),
        driven_by=driven_by,
        band=band,
        travel=travel,
        areas=force_areas(spec),
        notes=tuple(dict.fromkeys(notes)),
    )


def _driver(logs: Sequence[Log], spec: RigSpec) -> str:
    """What drives the replay: `u`, the pressures, or `P`."""
    has = set(logs[0].signals)
    for log in logs[1:]:
        if set(log.signals) - {"F_d"} != has - {"F_d"}:
            odd = sorted((set(log.signals) ^ has) - {"F_d"})
            raise InputError(
                f"{log.name}: columns differ from {logs[0].name} ({', '.join(odd)}): "
                "logs that are fitted together need the same signals"
            )
    pressures = {"P_a2"} if spec.layout == "single" else {"P_a1", "P_a2"}
    force = "F" in has or "F" in spec.load
    name = logs[0].name
    if spec.layout == "driven-axis":
        if "P" not in has:
            raise InputError(f"{name}: a driven-axis needs the drive force: P [N]")
        driver = "P"
    elif "u" in has:
        if not (pressures & has) and not force:
            raise InputError(
                f"{name}: nothing to predict: give P_a1 [Pa], P_a2 [Pa] or F [N]"
            )
        return "u"
    elif pressures <= has:
        driver = "pressures"
    elif "P" in has:
        driver = "P"
    else:
        raise InputError(
            f"{name}: nothing drives the replay: give u [V], or "
            f"{' and '.join(f'{p} [Pa]' for p in sorted(pressures))}"
        )
    if not force:
        raise InputError(
            f"{name}: nothing to predict: without u the pressures drive, and F is "
            'missing: give F [N], or F = "0 N" under [load] for a free axis'
        )
    return driver


def common_band(logs: Sequence[Log], spec: RigSpec, driven_by: str) -> float:
    """The narrowest of the logs' bands, Hz; inf if none is needed."""
    bands = [
        motion_band(
            log.time[slice(*rows)], position(log, spec)[slice(*rows)], QUIET[driven_by]
        )
        for log in logs
        for rows in log.segments
    ]
    return min((b for b in bands if b is not None), default=np.inf)


def _segment(
    i: int,
    log: Log,
    spec: RigSpec,
    rows: slice,
    driven_by: str,
    sign: float,
    band: float,
) -> _Segment:
    t, x = log.time[rows], sign * position(log, spec)[rows]
    get = {k: v[rows] for k, v in log.signals.items()}
    zero = np.zeros(t.size)
    F = get.get("F", zero + spec.load.get("F", np.nan))
    supply = {k: get.get(k, zero + v) for k, v in spec.line.items()}
    # Where u drives a log without pressures, they start midway: a first guess.
    middle = (supply["P_s"] + supply["P_r"]) / 2 if "u" in get else zero
    P = np.stack([get.get("P_a1", middle), get.get("P_a2", middle)], axis=1)
    if "P" in get and "P_a2" not in get:
        P = np.stack([zero, get["P"]], axis=1)
    place = interpolate.make_interp_spline(t, x, k=5)
    v, a = place(t, 1), place(t, 2)
    if np.isfinite(band):
        calm = smooth(t, x, band)
        # Speed is less rough than acceleration: it is followed an octave further.
        a, v = calm(t, 2), smooth(t, x, 2 * band)(t, 1)
        if "u" not in get:
            # Displacement stays as it is, for the bristle.
            place, v = interpolate.make_interp_spline(t, x, k=1), calm(t, 1)
        if driven_by == "P":
            # An axis driven by a force is mostly inertia: compared in its band.
            P = np.stack([smooth(t, p, band)(t) for p in P.T], axis=1)
            F = smooth(t, F, band)(t) if np.ptp(F) > 0 else F
    return _Segment(
        log=i,
        origin=float(log.time[0]),
        t=t,
        place=place,
        v=v,
        a=a,
        u=get.get("u", zero),
        P_s=supply["P_s"],
        P_r=supply["P_r"],
        P=P,
        F=F,
        calm=_calm(F),
    )


def _calm(F: np.ndarray) -> np.ndarray:
    """A measured force without most of its noise, which what gives would follow."""
    if not np.isfinite(F).all():
        return np.zeros(F.size)
    return np.asarray(savgol_filter(F, SMOOTH, 3))


def runs_backward(data: Data) -> bool:
    """Whether friction, as logged, drives the motion: x against the rig's sign.

    Where the pressures drive the replay, P - F is larger in positive motion than in
    negative motion, since friction brakes.
    """
    if data.driven_by == "u" or not np.isfinite(data.noise[2]):
        return False
    w = data.windows
    lead = w.x.shape[1] - w.scored
    v = np.asarray(w.v[:, lead:])
    drive = data.areas[1] * w.P_a2[:, lead:] - data.areas[0] * w.P_a1[:, lead:]
    loss = np.asarray(drive - w.measured[..., 2])
    fast = np.abs(v) > 0.3 * np.std(v)
    falls = []
    for log in np.unique(data.log):
        own = data.log == log
        f, up = loss[own][fast[own]], v[own][fast[own]] > 0
        if up.all() or not up.any():
            return False
        falls.append(np.median(f[up]) - np.median(f[~up]))
    return bool(np.all(np.array(falls) < -5 * data.noise[2]))


def _starts(t: np.ndarray, T: int, pre: int, lead: int) -> range:
    """First ticks (of the lead) of the windows that tile a segment with times `t`."""
    settle = SETTLE if t[-1] - t[0] > SHORT else SETTLE / 2
    settled = int(np.searchsorted(t, t[0] + settle))
    begin = max(settled - lead, pre)
    return range(begin, t.size - lead - T + 1, T)


def _runs(
    rows: list[tuple[int, slice]], starts: list[range], most: int, size: int
) -> tuple[list[tuple[int, slice]], list[range]]:
    """Runs of windows spread evenly, each a stretch with what it needs ahead of it.

    `rows` and `starts` are the segments' and their windows'; about `most` windows of
    `size` ticks are kept.
    """
    blocks = [
        (k, own[j : j + RUN])
        for k, own in enumerate(starts)
        for j in range(0, len(own), RUN)
    ]
    count = max(int(most / np.mean([len(own) for _, own in blocks])), 1)
    spread = np.linspace(0, len(blocks) - 1, min(count, len(blocks)))
    kept_rows, kept = [], []
    for k, own in (blocks[j] for j in spread.round().astype(int)):
        i, of = rows[k]
        ahead = min(own[0], starts[k][0])
        # A little beyond the last window, where a spline is at its end.
        stop = min(of.start + own[-1] + size + LEAD, of.stop)
        kept_rows.append((i, slice(of.start + own[0] - ahead, stop)))
        kept.append(range(ahead, ahead + own[-1] - own[0] + 1, own.step))
    return kept_rows, kept


def _motion(segments: list[_Segment], h: float) -> Motion:
    n = max(s.t.size for s in segments)
    dx = np.zeros((len(segments), n - 1, QUARTERS))
    ticks = np.full((len(segments), n - 1), h)
    speed, v, F = np.zeros(len(segments)), np.zeros((len(segments), n)), []
    for k, s in enumerate(segments):
        step = np.diff(s.t)
        parts = np.arange(QUARTERS + 1) / QUARTERS
        x = s.place(s.t[:-1, None] + step[:, None] * parts)
        dx[k, : step.size] = np.diff(x, axis=1)
        ticks[k, : step.size] = step
        first = np.abs(dx[k, : max(int(0.2 / h), 2)])
        speed[k] = first.sum() / (first.shape[0] * h)
        v[k, : s.t.size] = s.v
        F.append(np.pad(s.calm, (0, n - s.t.size), mode="edge"))
    return Motion(*(jnp.asarray(np.array(a)) for a in (dx, ticks, speed, v, F)))


def _past(s: _Segment, first: int, pre: int) -> tuple[np.ndarray, np.ndarray]:
    """The command ahead of a window, coarse and then tick by tick, and its steps, s.

    Ahead of the segment the command is taken to have stood where it began.
    """
    coarse = COARSE if pre == PRE else 0
    near = first - pre
    edges = np.maximum(near - EACH * np.arange(coarse, -1, -1), 0)
    t, u = s.t[edges[0] : near + 1], s.u[edges[0] : near]
    spent = np.diff(s.t[edges])
    course = np.r_[0.0, np.cumsum(u * np.diff(t))][edges - edges[0]]
    known = spent > 0
    usual = EACH * float(s.t[near + 1] - s.t[near])
    mean = np.where(known, np.diff(course) / np.where(known, spent, 1.0), s.u[0])
    h = np.where(known, spent, usual)
    steps = np.diff(s.t[near : first + 1])
    return np.r_[mean, s.u[near:first]], np.r_[h, steps]


def _windows(
    segments: list[_Segment],
    cuts: list[tuple[int, int]],
    T: int,
    pre: int,
    lead: int,
    n: int,
) -> tuple[Windows, np.ndarray]:
    parts = np.arange(2 * n + 1) / (2 * n)
    columns: dict[str, list] = {name: [] for name in Windows._fields}
    P_0 = []
    for k, first in cuts:
        s = segments[k]
        at = slice(first, first + lead + T)
        t = s.t[at]
        h = np.append(np.diff(t), t[-1] - t[-2])
        fine = t[:-1, None] + h[:-1, None] * parts
        near = slice(max(first - 8, 0), first + 9)
        slope = np.polyfit(s.t[near] - t[0], s.P[near], 1)
        P_0.append(slope[1])
        before, before_h = _past(s, first, pre)
        row = {
            "seg": k,
            "first": first,
            "before": before,
            "before_h": before_h,
            "u": s.u[at],
            "h": h,
            "P_s": s.P_s[at],
            "P_r": s.P_r[at],
            "t": t - s.origin,
            "x": s.place(t),
            "v": s.v[at],
            "a": s.a[at],
            "F": s.calm[at],
            "x_fine": s.place(fine),
            "P_a1": s.P[at, 0],
            "P_a2": s.P[at, 1],
            "measured": np.column_stack([s.P[at], s.F[at]])[lead:],
        }
        for name, value in row.items():
            columns[name].append(value)
    windows = Windows(**{k: jnp.asarray(np.array(v)) for k, v in columns.items()})
    return windows, np.array(P_0)
