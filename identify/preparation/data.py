"""From logs to what the replay runs on: motion, windows, first guesses, noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from hydrojax.errors import InputError
from hydrojax.identify.preparation.noise import (
    channel_noise,
    force_areas,
    supply_noise_of,
)
from hydrojax.identify.preparation.segments import common_band, segment
from hydrojax.identify.preparation.windows import (
    DRIVEN_LEAD,
    FEWEST_LEAD,
    LEAD,
    PRE,
    SETTLE,
    SUBSTEP,
    cut,
    motion,
    spread_runs,
    starts_in,
)
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.logs.log import Log
from hydrojax.plant.replay import SETTLED, Motion, Windows
from hydrojax.rigfile.schema import RigFile


@dataclass(frozen=True)
class Data:
    """Logs made ready.

    Attributes:
        motion: see `Motion`; S segments.
        windows: see `Windows`; W windows.
        P_0: first guess of the pressures at each window's first tick, Pa.
        log: which log each window comes from.
        noise: standard deviation of each channel's noise, SI; inf if not compared.
        supply_noise: standard deviation of the measured P_s, Pa; 0 if not measured.
        driven_by: `u`, or what else drives the replay.
        band: Hz up to which acceleration (and, without u, speed and force) is taken.
        travel: range of x that is compared, m.
        areas: on which the two pressures push, m^2.
        notes: one-line remarks for the report.
    """

    motion: Motion
    windows: Windows
    P_0: Float[np.ndarray, "windows 2"]
    log: Int[np.ndarray, "windows"]
    noise: Float[np.ndarray, "3"]
    supply_noise: float
    driven_by: str
    band: float
    travel: tuple[float, float]
    areas: tuple[float, float]
    notes: tuple[str, ...]


def prepare_logs(
    logs: Sequence[Log],
    spec: RigFile,
    horizon: float = 0.25,
    noise: Float[np.ndarray, "3"] | None = None,
    sign: float = 1.0,
    band: float | None = None,
    criteria: Criteria = Criteria(),
    placed: Sequence[Log] | None = None,
    still: float = 0.0,
) -> Data:
    """Make logs ready for a replay of the rig.

    Args:
        logs: as `Log.load` gives them, all with the same signals.
        spec: the rig they were recorded on.
        horizon: length of a window, s.
        noise: of each channel; None to take the rig file's, or estimate it.
        sign: -1 reverses the motion.
        band: Hz up to which acceleration is taken; None to find it.
        criteria: how much is read, and up to which band.
        placed: the same logs with another position, if by that one windows are placed:
            they are compared with its own.
        still: m that the position may change by, to either side, without friction
            taking it for motion.

    Raises:
        InputError: no motion, nothing to predict, logs that differ in their signals,
            or no stretch long enough for a window.
    """
    if not 0 < horizon < 1e4:
        raise InputError(f"horizon {horizon}: give the length of a window in seconds")
    driven_by = driver(logs, spec)
    if band is None:
        band = common_band(logs, spec, driven_by, criteria)
    rows = _rows(logs, criteria)
    h = _tick(logs, rows, driven_by, criteria)
    size = _Size.of(horizon, h, driven_by)
    rows, starts, used = _spread_windows(placed or logs, rows, size, h, criteria)
    segments = [segment(i, logs[i], spec, r, driven_by, sign, band) for i, r in rows]
    cuts = [(k, first) for k, own in enumerate(starts) for first in own]
    windows, P_0 = cut(segments, cuts, size.T, size.ahead, size.lead, size.substeps)
    if noise is None:
        noise = channel_noise(logs, spec, driven_by)
    log = np.array([segments[k].log for k, _ in cuts])
    filtered = np.array([spec.passes_filter(one.name) for one in logs], float)
    own = [f"{log.name}: {note}" for log in logs for note in log.notes]
    return Data(
        motion=motion(segments, h, still),
        windows=windows._replace(filtered=jnp.asarray(filtered[log])),
        P_0=P_0,
        log=log,
        noise=noise,
        supply_noise=supply_noise_of(logs, spec),
        driven_by=driven_by,
        band=band,
        travel=(float(windows.x.min()), float(windows.x.max())),
        areas=force_areas(spec),
        notes=tuple(dict.fromkeys([*own, *_band_note(band, driven_by), *used])),
    )


class _Size(NamedTuple):
    """Ticks of a window, of the log that it must have ahead of it, of that which it is
    given, and of its lead; its substeps.
    """

    T: int
    pre: int
    ahead: int
    lead: int
    substeps: int

    @classmethod
    def of(cls, horizon: float, h: float, driven_by: str) -> _Size:
        """The size of windows of `horizon` s on logs with a row every `h` s."""
        T = max(int(round(horizon / h)), 8)
        if driven_by == "u":
            lead = max(FEWEST_LEAD, round(LEAD / h))
            return cls(T, PRE, SETTLED, lead, max(1, int(np.ceil(h / SUBSTEP))))
        return cls(T, 1, 1, min(DRIVEN_LEAD, int(0.3 / h)), 1)


def _rows(logs: Sequence[Log], criteria: Criteria) -> list[tuple[int, slice]]:
    """Each log's stretches without gaps that are long enough: its place, and rows.

    Raises:
        InputError: there is none.
    """
    rows = [
        (i, slice(*own))
        for i, log in enumerate(logs)
        for own in log.segments
        if own[1] - own[0] > criteria.fewest_rows
    ]
    if not rows:
        raise InputError(
            f"{logs[0].name}: no stretch without gaps has over "
            f"{criteria.fewest_rows} rows"
        )
    return rows


def _tick(
    logs: Sequence[Log],
    rows: list[tuple[int, slice]],
    driven_by: str,
    criteria: Criteria,
) -> float:
    """The logs' median step, s.

    Raises:
        InputError: too slow to replay what the valve does.
    """
    h = float(np.median(np.concatenate([np.diff(logs[i].time[r]) for i, r in rows])))
    if driven_by == "u" and h > criteria.slowest_tick:
        raise InputError(
            f"{logs[0].name}: a row every {h:.3g} s is too slow to replay what the "
            f"valve does: log at {1 / criteria.slowest_tick:.0f} Hz or more, or "
            "take u out of the log"
        )
    return h


def _spread_windows(
    logs: Sequence[Log],
    rows: list[tuple[int, slice]],
    size: _Size,
    h: float,
    criteria: Criteria,
) -> tuple[list[tuple[int, slice]], list[range], list[str]]:
    """Stretches, the first ticks of the windows in each, and a note if some are unused.

    Raises:
        InputError: no stretch is long enough for a window.
    """
    T, pre, _, lead, _ = size
    starts = [
        starts_in(logs[i].time[r], logs[i].signals[logs[i].motion][r], T, pre, lead)
        for i, r in rows
    ]
    count, most = sum(map(len, starts)), max(criteria.most_ticks // (lead + T), 1)
    if count == 0:
        raise InputError(
            f"{logs[0].name}: no stretch without gaps is longer than "
            f"{SETTLE / 2 + (pre + lead + T) * h:.2g} s: give a longer log or a "
            "shorter --horizon"
        )
    if count <= most:
        return rows, starts, []
    rows, starts = spread_runs(rows, starts, most, lead + T)
    note = (
        f"{sum(map(len, starts))} windows of {count}, in runs spread evenly, were "
        "used: the logs hold more than a fit needs"
    )
    return rows, starts, [note]


def _band_note(band: float, driven_by: str) -> list[str]:
    """What is said of a band in which motion is differentiated; none without one."""
    if not np.isfinite(band):
        return []
    what = {"u": "acceleration is", "P": "speed, acceleration and force are"}.get(
        driven_by, "speed and acceleration are"
    )
    return [
        f"{what} taken below {band:.0f} Hz: what lies above is mostly noise of the "
        "position"
    ]


def driver(logs: Sequence[Log], spec: RigFile) -> str:
    """What drives the replay: `u`, the pressures, `P`, or the motion `x` alone.

    Raises:
        InputError: nothing to predict, logs that differ in their signals, or a drive
            that the layout does not have.
    """
    has = set(logs[0].signals)
    for log in logs[1:]:
        if set(log.signals) - {"F_d"} != has - {"F_d"}:
            odd = sorted((set(log.signals) ^ has) - {"F_d"})
            raise InputError(
                f"{log.name}: columns differ from {logs[0].name} ({', '.join(odd)}): "
                "logs that are fitted together need the same signals"
            )
    pressures = set(spec.layout.pressures)
    force = "F" in has or "F" in spec.output_load
    name = logs[0].name
    if not spec.layout.driven:
        if more := sorted({"u", "P", "P_a1", "P_a2"} & has):
            raise InputError(
                f"{name}: {more[0]} drives, but a {spec.layout.name} has no drive: "
                "take the column out, or name another layout in the rig file"
            )
        if "F" not in has:
            raise InputError(
                f"{name}: nothing to predict: a {spec.layout.name} needs F [N]"
            )
        return "x"
    if not spec.layout.has_valve:
        if "P" not in has:
            raise InputError(
                f"{name}: a {spec.layout.name} needs the drive force: P [N]"
            )
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


def runs_backward(data: Data, criteria: Criteria = Criteria()) -> bool:
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
    fast = np.abs(v) > criteria.backward_speed * np.std(v)
    falls = []
    for log in np.unique(data.log):
        own = data.log == log
        f, up = loss[own][fast[own]], v[own][fast[own]] > 0
        if up.all() or not up.any():
            return False
        falls.append(np.median(f[up]) - np.median(f[~up]))
    return bool(np.all(np.array(falls) < -criteria.backward * data.noise[2]))
