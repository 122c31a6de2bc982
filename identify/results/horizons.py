"""Errors of runs from a window's length to a whole log, beside predictors that know no
plant: the value held as a run began, and a linear autoregressive model (ARX).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from hydrojax.identify.estimation.columns import Batch, ParametricRig, filled
from hydrojax.identify.estimation.known import Free
from hydrojax.identify.estimation.problem import Problem
from hydrojax.identify.inference.uncertainty import Uncertainty
from hydrojax.identify.preparation.noise import CHANNELS
from hydrojax.identify.results.outcome import ChannelErrors, Horizon, skill_text
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.parameters import put
from hydrojax.plant.replay import (
    at_start,
    friction_memory,
    opened_in,
    openings,
    pressures_behind,
    readings,
)
from hydrojax.programs.compiled import program_of_pytrees

LONGER = (1.0, 5.0)
"""Seconds of the runs beside those of a single window and of the whole log."""

ORDER = 4
"""Past samples of each signal that the ARX model takes."""


def horizons_of(
    fitted: Problem,
    check: Problem,
    ends: tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]],
    length: float,
) -> dict[str, dict[str, Horizon]]:
    """Errors by channel and length of the run: "0.25", "1", "5" (seconds) and "free".

    Args:
        fitted: the problem of the fitted logs.
        check: that of the logs on which errors are counted.
        ends: all parameters of the declared and of the final model, SI.
        length: of a window, s.

    Each run starts from the pressures that are estimated from its first window, and
    goes on through as many windows as fit; "free" through all that adjoin. Lengths for
    which no log is long enough are left out.
    """
    noise = np.asarray(check.batch.noise)
    starts = _starts(check.batch, length)
    measured = np.asarray(check.batch.windows.measured)
    arx = _Arx.fit(fitted.batch, noise)
    runs = [_runs(check, values, starts) for values in ends]
    out: dict[str, dict[str, Horizon]] = {
        CHANNELS[c]: {} for c in range(3) if np.isfinite(noise[c])
    }
    for i, (name, (begins, used)) in enumerate(starts.items()):
        held = measured[begins, 0][:, None, :]
        linear = arx.simulated(check.batch, begins)
        left = [r[i] for r in runs]
        for c, channel in enumerate(CHANNELS):
            if channel in out:
                rms = [
                    _rms(e[used, :, c])
                    for e in (*left, measured - held, measured - linear)
                ]
                out[channel][name] = Horizon(rms[0], rms[1], rms[2] or 0.0, rms[3])
    return out


def drifting(
    channels: Mapping[str, ChannelErrors],
    verdict: str,
    length: float,
    criteria: Criteria,
) -> list[str]:
    """What to do about pressures that a model follows for a while only: of one that is
    not whole other values do best over longer runs.

    Args:
        channels: errors by channel.
        verdict: of the run.
        length: of a window, s.
        criteria: the thresholds.
    """
    longest = criteria.longest_run
    if verdict != "unknown" or length >= longest:
        return []
    whole = {n: c.horizons["free"] for n, c in channels.items() if "free" in c.horizons}
    poor = {
        name: h
        for name, h in whole.items()
        if name != "F" and (h.skill is None or h.skill < criteria.good_skill)
    }
    if not poor:
        return []
    skills = " and ".join(f"{n} has skill {skill_text(h)}" for n, h in poor.items())
    return [
        f"through whole logs {skills}: the values found are those for runs of "
        f"{length:g} s; `hydrojax identify` of the rig file found, with --horizon "
        f"{longest:g}, finds those for longer ones"
    ]


def beyond_windows(
    fitted: Problem,
    check: Problem,
    values: Float[np.ndarray, "n"],
    uncertainty: Uncertainty,
    horizons: Mapping[str, Horizon],
    length: float,
    criteria: Criteria,
) -> float | None:
    """By how much the force stays above its noise over longer runs, N, where that says
    that something is missing though it is at its noise over windows; else None.

    An error that hardly shows in a window adds up in longer runs, where effects only
    come near what the rig does. So does an error of the parameters, which the logs
    leave: it is drawn, by their covariance, and allowed for. Pressures are not judged
    so: of a machine logged at 100 Hz they drift with the right effect too.

    Args:
        fitted: the problem of the fitted logs, which has the parameters' ranges.
        check: that of the logs on which errors are counted.
        values: all parameters of the final model, SI.
        uncertainty: of those that were fitted.
        horizons: the force's errors by length of the run, of these logs.
        length: of a window, s.
        criteria: the thresholds.
    """
    noise = float(np.asarray(check.batch.noise)[2])
    long = [horizons[n].after for n in ("1", "free") if n in horizons]
    own = min((np.inf if e is None else e for e in long), default=0.0)
    if len(long) < 2 or not check.simulate or not own > criteria.drifts * noise:
        return None
    if not np.isfinite(own):
        return None
    ranges = [fitted.free[n] for n in uncertainty.inside]
    allowed = (criteria.drifts * noise) ** 2 + _drawn(
        check, values, uncertainty, ranges, length, criteria.drift_draws
    )
    return float(np.sqrt(own**2 - noise**2)) if own**2 > allowed else None


def _drawn(
    check: Problem,
    values: Float[np.ndarray, "n"],
    uncertainty: Uncertainty,
    ranges: Sequence[Free],
    length: float,
    draws: int,
) -> float:
    """Mean square by which the force's runs of 1 s and of whole logs move, whichever
    move more, with parameters drawn by their covariance, N^2.
    """
    names, cov = list(check.model.names), uncertainty.covariance
    index = [names.index(n) for n in uncertainty.inside]
    if not index:
        return 0.0
    if not np.all(np.isfinite(cov)):
        return np.inf  # nothing says how far they may be off
    starts = _starts(check.batch, length)
    lengths = [list(starts).index(n) for n in ("1", "free")]
    lower = np.array([r.lower for r in ranges])
    upper = np.array([r.upper for r in ranges])
    # Of numbers of one size: of Pa beside m^3/s only the former would be drawn.
    std = np.sqrt(np.maximum(np.diag(cov), 1e-300))
    alike = cov / np.outer(std, std)
    away = std * np.random.default_rng(0).multivariate_normal(
        np.zeros(len(index)), alike, size=draws, check_valid="ignore"
    )
    own, squares = _runs(check, values, starts)[lengths, ..., 2], []
    for move in away:
        there = values.copy()
        there[index] = np.clip(values[index] + move, lower, upper)
        moved = _runs(check, there, starts)[lengths, ..., 2] - own
        squares.append(np.mean(moved**2, axis=(1, 2)))
    return float(np.max(np.mean(squares, axis=0))) if squares else 0.0


def _rms(error: np.ndarray) -> float | None:
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.sqrt(np.mean(error**2)) if error.size else np.nan
    return float(size) if np.isfinite(size) else None


def _starts(
    batch: Batch, length: float
) -> dict[str, tuple[Int[np.ndarray, "windows"], Bool[np.ndarray, "windows"]]]:
    """By name of the run's length: the window in which each window's run begins, and
    which windows belong to a run of full length.
    """
    seg, first = np.asarray(batch.windows.seg), np.asarray(batch.windows.first)
    index = np.arange(seg.size)
    joined = (np.diff(seg) == 0) & (np.diff(first) == batch.windows.scored)
    whole = np.maximum.accumulate(np.where(np.r_[True, ~joined], index, 0))
    place = index - whole
    lasts = np.bincount(whole, minlength=seg.size)[whole]
    out = {f"{length:g}": (index, np.ones(seg.size, bool))}
    for seconds in LONGER:
        count = round(seconds / length)
        if count < 2:
            continue
        if abs(count * length - seconds) > 0.05 * seconds:
            continue  # windows do not make up a run of that length
        begins = whole + place // count * count
        used = place // count * count + count <= lasts
        if used.any():
            out[f"{seconds:g}"] = (begins, used)
    out["free"] = (whole, np.ones(seg.size, bool))
    return out


def _runs(
    problem: Problem, values: np.ndarray, starts: dict
) -> Float[np.ndarray, "lengths windows ticks 3"]:
    """Measured less replayed, SI, for each length of the runs."""
    own = problem.residuals_at(values)
    if not problem.simulate:  # nothing of one window goes on into the next
        return np.broadcast_to(own, (len(starts), *own.shape))
    batch = filled(problem.started(values))
    fresh = np.ones((len(starts), len(batch.P_0)), bool)
    for row, (begins, _) in zip(fresh, starts.values(), strict=True):
        row[: begins.size] = begins == np.arange(begins.size)
    at = problem.model.acting(values)
    out = _run_on(*at, batch, jnp.asarray(fresh[1:]))
    out = np.asarray(out)[:, : len(own)]
    return np.concatenate([own[None], problem.batch.windows.measured - out])


@program_of_pytrees
def _run_on(
    model: ParametricRig,
    values: Float[Array, "n"],
    batch: Batch,
    fresh: Bool[Array, "lengths windows"],
) -> Float[Array, "lengths windows ticks 3"]:
    """What the sensors read where a window begins with its own initial pressures, and
    readings, only if it is `fresh`, and else where the one before it ended.
    """
    rig, w = put(model.rig, model.names, values), batch.windows
    past = friction_memory(rig, batch.motion).within(w)
    opened = openings(rig, batch.motion)
    end = w.scored
    shown = end - (w.x.shape[1] - w.scored)  # among the readings, which have no lead

    def one(own: Bool[Array, "windows"]) -> Float[Array, "windows ticks 3"]:
        def through(ended, window):
            inputs, before, *measured, begins = window
            P, read, slope = jax.tree.map(
                lambda a, b: jnp.where(begins, a, b), tuple(measured), ended
            )
            alone, before = jax.tree.map(lambda a: a[None], (inputs, before))
            own = opened_in(rig, opened, alone)
            P_a1, P_a2 = pressures_behind(rig, alone, P[None], own)
            alone = alone._replace(
                P_a1=alone.P_a1.at[0, 0].set(read[0]),
                P_a2=alone.P_a2.at[0, 0].set(read[1]),
                dP=alone.dP.at[0, 0, :2, 0].set(slope),
            )
            y = readings(rig, alone, P_a1, P_a2, before)[0]
            slope = (y[shown + 1, :2] - y[shown - 1, :2]) / (2 * alone.h[0, end])
            P = jnp.stack([P_a1[0, end], P_a2[0, end]])
            return (P, y[shown, :2], slope), y

        start = at_start(rig, w, jnp.asarray(batch.P_0))
        read = jnp.stack([w.P_a1[:, 0], w.P_a2[:, 0]], axis=1)
        measured = (start, read, w.dP[:, 0, :2, 0])
        first = jax.tree.map(lambda a: a[0], measured)
        return jax.lax.scan(through, first, (w, past, *measured, own))[1]

    return jax.vmap(one)(fresh)


@dataclass(frozen=True)
class _Arx:
    """y(t) = sum of weights times the last `ORDER` samples of y and inputs, and 1; in
    standardised units.
    """

    weights: Float[np.ndarray, "features outputs"]
    mean: Float[np.ndarray, "signals"]
    size: Float[np.ndarray, "signals"]
    outputs: Int[np.ndarray, "outputs"]

    @classmethod
    def fit(cls, batch: Batch, noise: Float[np.ndarray, "3"]) -> _Arx:
        outputs = np.flatnonzero(np.isfinite(noise))
        z = _signals(batch, outputs)
        mean, size = z.mean(axis=(0, 1)), z.std(axis=(0, 1))
        size = np.where(size > 1e-12 * np.abs(mean), size, np.inf)
        z = (z - mean) / size
        T = z.shape[1]
        past = [z[:, ORDER - 1 - k : T - 1 - k] for k in range(ORDER)]
        rows = np.concatenate([*past, np.ones_like(past[0][..., :1])], axis=-1)
        X, y = (
            a.reshape(-1, a.shape[-1]) for a in (rows, z[:, ORDER:, : outputs.size])
        )
        weights = np.linalg.lstsq(X, y, rcond=1e-10)[0]
        return cls(weights, mean, size, outputs)

    def simulated(
        self, batch: Batch, begins: Int[np.ndarray, "windows"]
    ) -> Float[np.ndarray, "windows ticks 3"]:
        """The channels, SI, each run from its first `ORDER` measured samples."""
        z = (_signals(batch, self.outputs) - self.mean) / self.size
        W, T, n = *z.shape[:2], self.outputs.size
        y = z[..., :n].copy()
        place = np.arange(W) - begins
        order = [np.flatnonzero(place == k) for k in range(int(place.max()) + 1)]
        with np.errstate(over="ignore", invalid="ignore"):
            for k, now in enumerate(order):
                # All runs side by side, one window of each after the other.
                before = y[now - 1, -ORDER:] if k else y[now, :ORDER]
                inputs = z[now - 1, -ORDER:, n:] if k else z[now, :ORDER, n:]
                run = np.concatenate([before, y[now]] if k else [y[now]], axis=1)
                given = [inputs, z[now, :, n:]] if k else [z[now, :, n:]]
                self._advance(run, np.concatenate(given, axis=1))
                y[now] = run[:, -T:]
            out = np.zeros((W, T, 3))
            out[..., self.outputs] = y * self.size[:n] + self.mean[:n]
        return out

    def _advance(self, run: np.ndarray, given: np.ndarray) -> None:
        """Fill `run` [runs, ticks, outputs] from its first `ORDER` ticks on."""
        one = np.ones((len(run), 1))
        for t in range(ORDER, run.shape[1]):
            past = [
                np.concatenate([run[:, t - 1 - k], given[:, t - 1 - k]], axis=1)
                for k in range(ORDER)
            ]
            run[:, t] = np.concatenate([*past, one], axis=1) @ self.weights


def _signals(
    batch: Batch, outputs: Int[np.ndarray, "outputs"]
) -> Float[np.ndarray, "windows ticks signals"]:
    """The compared channels, and then what drives a replay, at the compared ticks."""
    w = batch.windows
    lead = w.x.shape[1] - w.scored
    measured = np.asarray(w.measured)[..., outputs]
    driving = [np.asarray(a)[:, lead:] for a in (w.u, w.x, w.v, w.P_s)]
    return np.concatenate([measured, np.stack(driving, axis=-1)], axis=-1)
