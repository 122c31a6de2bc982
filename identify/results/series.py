"""Residuals and signals of the validation logs, laid out for reports."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from hydrojax.identify.preparation.data import Data
from hydrojax.identify.preparation.noise import CHANNELS
from hydrojax.identify.results.outcome import Series

if TYPE_CHECKING:
    from hydrojax.identify.case import Case


Signals = dict[str, Float[np.ndarray, "windows ticks"]]
"""Signals by name, SI."""


def signals_of(
    data: Data, scored: int, radius: float | None
) -> dict[str, Float[np.ndarray, "windows ticks"]]:
    """Signals a residual may correlate with, [W, T] each, at the compared ticks; SI."""
    w = data.windows
    lead = w.x.shape[1] - scored

    def rate(y):
        return np.gradient(y, axis=1) / w.h

    full = {"x": w.x, "v": w.v, "a": w.a, "t": w.t}
    if data.driven_by == "u":
        full |= {"u": w.u, "u_rate": rate(w.u), "abs(u)": np.abs(w.u)}
    if np.ptp(w.P_a2) > 0 and data.driven_by != "P":
        full |= {"P_a1 + P_a2": w.P_a1 + w.P_a2, "P_a1 - P_a2": w.P_a1 - w.P_a2}
    if radius:
        full["psi"] = w.x / radius
    out = {name: np.asarray(s[:, lead:]) for name, s in full.items()}
    F = np.asarray(w.measured[..., 2])
    if np.all(np.isfinite(F)) and np.ptp(F) > 0:
        out["F"] = F
    return out


def series_of(
    case: Case,
    before: Float[np.ndarray, "windows ticks 3"],
    after: Float[np.ndarray, "windows ticks 3"],
    signals: dict[str, Float[np.ndarray, "windows ticks"]],
    seen: list[int],
) -> tuple[Series, ...]:
    """One log's windows laid end to end, a NaN between those that do not adjoin."""
    data, out = case.check, []
    first = np.asarray(data.windows.first)
    seg, scored = np.asarray(data.windows.seg), before.shape[1]
    lead = data.windows.x.shape[1] - scored
    F = data.windows.measured
    for i, log in enumerate(case.check_logs):
        own = np.nonzero(data.log == i)[0]
        apart = [
            k
            for k, (a, b) in enumerate(zip(own[:-1], own[1:], strict=True))
            if seg[a] != seg[b] or first[b] != first[a] + scored
        ]

        def lay(y, own=own, apart=apart):
            rows = [
                np.append(y[j], np.nan) if k in apart else y[j]
                for k, j in enumerate(own)
            ]
            return np.concatenate(rows) if rows else np.zeros(0)

        names = {CHANNELS[c]: c for c in seen}
        out.append(
            Series(
                log=log.name,
                t=lay(np.asarray(data.windows.t)[:, lead:]),
                measured={n: lay(F[..., c]) for n, c in names.items()},
                before={n: lay(before[..., c]) for n, c in names.items()},
                after={n: lay(after[..., c]) for n, c in names.items()},
                signals={n: lay(s) for n, s in signals.items()},
            )
        )
    return tuple(out)
