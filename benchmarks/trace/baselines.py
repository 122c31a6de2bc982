"""What others would do with the same logs: correlate, test whiteness, regress, refit.

The first three look at the declared model's residual on the validation logs, as a
practitioner would; the last refits the model with every candidate in turn.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .cases import LOGS, CaseSpec

CHANNELS = ("P_a1", "P_a2", "F")
WINDOW = 250
"""Ticks of a window: pressures are predicted from each window's own start."""
BAND = 2.576
"""Of a normal distribution, 99 %."""
LAGS = 25
P_S, P_R = 14e6, 0.25e6

Columns = dict[str, list[tuple[np.ndarray, np.ndarray, np.ndarray]]]


def cheap(outcome: Any) -> dict[str, dict[str, Any]]:
    """Correlation, whiteness and sparse regression on one outcome's residual."""
    noise = np.array([outcome.channels[c].noise for c in CHANNELS])
    residual, signals = _windows(outcome.series)
    columns = regressors(signals)
    scaled = residual / noise[:, None, None]
    ways = {
        "correlation": lambda: correlation(scaled, columns),
        "whiteness": lambda: whiteness(scaled),
        "sparse": lambda: sparse(scaled, columns, noise),
    }
    out = {}
    for name, way in ways.items():
        began = time.perf_counter()
        out[name] = way() | {"seconds": time.perf_counter() - began}
    return out


def _windows(series: Sequence[Any]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Residuals [3, W, T] before, and signals [W, T], cut into the replay's windows."""
    residual, signals = [], {}
    for one in series:
        stretches = np.split(np.arange(len(one.t)), np.nonzero(np.isnan(one.t))[0])
        for rows in stretches:
            rows = rows[~np.isnan(one.t[rows])]
            rows = rows[: len(rows) // WINDOW * WINDOW]
            shape = (-1, WINDOW)
            residual.append(
                np.stack([one.before[c][rows].reshape(shape) for c in CHANNELS])
            )
            for name, y in {**one.signals, "time": one.t}.items():
                signals.setdefault(name, []).append(y[rows].reshape(shape))
    joined = {n: np.concatenate(y) for n, y in signals.items()}
    return np.concatenate(residual, axis=1), joined


def regressors(s: Mapping[str, np.ndarray]) -> Columns:
    """What each effect adds to P_a1, P_a2 and F, to first order, up to its size.

    `""` holds what the base model's own parameters can do.
    """
    h = float(np.median(np.diff(s["time"], axis=1)))
    u, v, x, force = s["u"], s["v"], s["x"], s["F"]
    p_1 = (s["P_a1 + P_a2"] + s["P_a1 - P_a2"]) / 2
    p_2 = (s["P_a1 + P_a2"] - s["P_a1 - P_a2"]) / 2
    none, way = np.zeros_like(u), np.sign(v)

    def rate(y):
        return np.gradient(y, h, axis=1)

    def root(p, fills):
        return np.sqrt(np.maximum(np.where(fills, P_S - p, p - P_R), 1e5))

    g_1, g_2 = root(p_1, u > 0), root(p_2, u < 0)
    slope, r_1, r_2 = rate(u), rate(p_1), rate(p_2)

    def flow(q_1, q_2):
        """Flows, integrated over each window as its pressures do."""
        return (np.cumsum(q_1, axis=1) * h, np.cumsum(q_2, axis=1) * h, none)

    def command(y):
        return flow(y * g_1, -y * g_2)

    def only_force(y):
        return (none, none, y)

    film = np.abs(v) - _lagged(np.abs(v), h, 0.05)
    turns = 2 * np.pi * (x - x.min()) / np.ptp(x)
    air = P_R**1.83
    return {
        "": [
            flow(np.maximum(u, 0) * g_1, none),
            flow(np.minimum(u, 0) * g_1, none),
            flow(none, np.maximum(u, 0) * g_2),
            flow(none, np.minimum(u, 0) * g_2),
            flow(v, none),
            flow(none, v),
            *(only_force(y) for y in (np.ones_like(v), way, v, np.abs(v))),
            only_force(force * np.exp(-((v / 3e-3) ** 2))),
        ],
        "valve_bias": [command(np.ones_like(u))],
        "valve_deadband": [command(np.tanh(u / 0.02))],
        "valve_hysteresis": [command(np.sign(slope))],
        "valve_delay": [command(slope)],
        "valve_lag": [command(rate(slope))],
        "valve_rate_limit": [command(slope * np.abs(slope))],
        "internal_leakage": [flow(p_2 - p_1, p_1 - p_2)],
        "external_leakage": [flow(p_1, p_2)],
        "supply_line_drop": [
            flow(np.maximum(u, 0) ** 3 * g_1, np.minimum(u, 0) ** 3 * g_2)
        ],
        "return_line_drop": [
            flow(np.minimum(u, 0) ** 3 * g_1, np.maximum(u, 0) ** 3 * g_2)
        ],
        "port_relief": [
            flow(np.maximum(p_1 - 0.6 * P_S, 0), none),
            flow(none, np.maximum(p_2 - 0.6 * P_S, 0)),
        ],
        "entrained_air": [flow(r_1 * air / p_1**1.83, r_2 * air / p_2**1.83)],
        "orifice_transition": [flow(u / g_1**3, -u / g_2**3)],
        "underlap": [
            flow(*((P_S / 2 - p) * np.exp(-((u / 0.1) ** 2)) for p in (p_1, p_2)))
        ],
        "dead_volume": [flow(r_1, none), flow(none, r_2)],
        "rod_compliance": [flow(rate(force), -rate(force))],
        "backlash": [(np.sign(force), -np.sign(force), none)],
        "pressure_sensor_lag": [(r_1, r_2, none)],
        "viscous_friction": [only_force(v)],
        "film_friction": [only_force(way * np.sqrt(np.abs(v)))],
        "friction_at_rest": [only_force(way * np.exp(-((v / 3e-3) ** 2)))],
        "stribeck": [only_force(way * np.exp(-((v / 5e-3) ** 2)))],
        "bristle_damping": [only_force(s["a"] * np.exp(-((v / 1e-3) ** 2)))],
        "pressure_friction": [only_force(way * (p_1 + p_2))],
        "position_friction": [only_force(way * f(turns)) for f in (np.sin, np.cos)],
        "friction_drift": [only_force(way * s["time"])],
        "frictional_lag": [only_force(way * film)],
        "payload_inertia": [only_force(s["a"])],
        "gravity_load": [only_force(np.sin(x / 0.085)), only_force(np.cos(x / 0.085))],
        "loadcell_lag": [only_force(rate(force))],
        "loadcell_gain": [only_force(force)],
        "loadcell_bias": [only_force(np.ones_like(force))],
        "pressure_sensor_gain": [(p_1, none, none), (none, p_2, none)],
    }


def _lagged(y: np.ndarray, h: float, tau: float) -> np.ndarray:
    """First-order lag along the last axis."""
    from scipy.signal import lfilter

    keep = np.exp(-h / tau)
    start = keep * y[:, :1]
    return lfilter([1 - keep], [1, -keep], y, axis=1, zi=start)[0]


def _flat(
    column: tuple[np.ndarray, ...], noise: np.ndarray | None = None
) -> np.ndarray:
    """A column over all channels, each window's mean off the pressures', [3 W T]."""
    parts = []
    for i, y in enumerate(column):
        y = y - y.mean(axis=1, keepdims=True) if i < 2 else y
        parts.append((y if noise is None else y / noise[i]).ravel())
    return np.concatenate(parts)


def correlation(residual: np.ndarray, columns: Columns) -> dict[str, Any]:
    """The effect whose regressor correlates best with any channel's residual."""
    best = {}
    for name, group in columns.items():
        if not name:
            continue
        for column in group:
            for r, y in zip(residual, column, strict=True):
                if np.ptp(y) > 0:
                    c = abs(np.corrcoef(r.ravel(), y.ravel())[0, 1])
                    best[name] = max(best.get(name, 0.0), float(c))
    order = sorted(best, key=lambda n: -best[n])
    flag = best[order[0]] > BAND / np.sqrt(residual[0].size)
    return {"flag": bool(flag), "named": order[:1] if flag else [], "order": order[:3]}


def whiteness(residual: np.ndarray) -> dict[str, Any]:
    """Whether more of an autocorrelation than chance allows leaves the 99 % band."""
    worst = 0
    for r in residual:
        y = r - r.mean()
        power = np.mean(y * y)
        band = BAND / np.sqrt(y.size)
        out = sum(
            abs(np.mean(y[:, k:] * y[:, :-k])) / power > band
            for k in range(1, LAGS + 1)
        )
        worst = max(worst, int(out))
    return {"flag": worst > 1, "named": [], "lags_outside": worst}


def sparse(residual: np.ndarray, columns: Columns, noise: np.ndarray) -> dict[str, Any]:
    """Forward orthogonal least squares on the residual; BIC says when to stop."""
    y = _flat(tuple(residual))
    groups = {
        name: np.stack([_flat(c, noise) for c in group], axis=1)
        for name, group in columns.items()
    }

    def without(q: np.ndarray, a: np.ndarray) -> np.ndarray:
        return a - q @ (q.T @ a)

    def basis(a: np.ndarray) -> np.ndarray:
        a = a / np.maximum(np.linalg.norm(a, axis=0), 1e-300)
        left, size, _ = np.linalg.svd(a, full_matrices=False)
        return left[:, size > 1e-8]

    q = basis(groups.pop(""))
    y, n = without(q, y), y.size
    groups = {name: without(q, a) for name, a in groups.items()}
    named: list[str] = []
    first = float(y @ y)
    while groups and len(named) < 6:
        bases = {name: basis(a) for name, a in groups.items()}
        gains = {name: float(np.sum((b.T @ y) ** 2)) for name, b in bases.items()}
        best = max(gains, key=lambda name: gains[name])
        left = float(y @ y)
        terms = bases[best].shape[1]
        if n * np.log(left / (left - gains[best])) < terms * np.log(n):
            break
        if gains[best] < 0.005 * first:  # of the residual: smaller terms are bending
            break
        named.append(best)
        q = bases[best]
        y = without(q, y)
        groups.pop(best)
        groups = {name: without(q, a) for name, a in groups.items()}
    return {"flag": bool(named), "named": named[:1], "order": named}


# -- refit each candidate --


def refit_case(
    folder: Path, progress: Callable[[str], None], names: Sequence[str] | None = None
) -> dict[str, Any]:
    """Fit the declared model alone and with each effect; BIC on the validation logs.

    `names` are the effects; all of the vocabulary if None.
    """
    from hydrojax.effects import EFFECTS
    from hydrojax.identify import api
    from hydrojax.identify.case import open_case

    from .tracing import declare

    fit, check = [folder / n for n in LOGS[:2]], [folder / LOGS[2]]
    base = (folder / "rig.toml").read_text()
    began, scores = time.perf_counter(), {}
    for name in ("", *(EFFECTS if names is None else names)):
        progress(f"{folder.name}: {name or 'declared'}")
        rig = folder / "refit.toml"
        rig.write_text(base + (declare([name]) if name else ""))
        outcome = api.identify(open_case(rig, fit, check), starts=1)
        rows = sum(len(s.t) for s in outcome.series)
        free = sum(p.free for p in outcome.parameters.values())
        errors = [c.after for c in outcome.channels.values()]
        scores[name] = rows * sum(2 * np.log(e) for e in errors) + free * np.log(rows)
    best = min(scores, key=lambda n: scores[n])
    truth = json.loads((folder / "truth.json").read_text())
    return {
        "case": folder.name,
        "kind": truth["kind"],
        "sizes": truth["sizes"],
        "flag": bool(best),
        "named": [best] if best else [],
        "bic": {n: float(s - scores[""]) for n, s in scores.items()},
        "seconds": time.perf_counter() - began,
    }


def refit_each(
    specs: Sequence[CaseSpec],
    out: Path,
    number: int,
    progress: Callable[[str, int, int], None],
) -> None:
    """Refit every candidate on the first `number` cases; OUT/refits.jsonl resumes."""
    from .score import append

    known = {row["case"] for row in read_refits(out)}
    for i, spec in enumerate(specs[:number]):
        folder = out / "cases" / spec.name
        if spec.name not in known and (folder / "truth.json").exists():
            row = refit_case(folder, lambda what, i=i: progress(what, i, number))
            append(out / "refits.jsonl", row)


def read_refits(out: Path) -> list[dict[str, Any]]:
    """Rows of the refits that are done."""
    from .score import read_results

    return read_results(out / "refits.jsonl")
