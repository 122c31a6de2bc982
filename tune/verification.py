"""Proposals tried in simulated runs on every plant, and what speaks against each."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from hydrojax.jax_setup import cores
from hydrojax.programs.compiled import program
from hydrojax.tune import linearize, metrics, trials
from hydrojax.tune.aims import TOLERANCE
from hydrojax.tune.objective import Objective
from hydrojax.tune.setup import DELAY

DELAY_MARGIN = 0.25
"""Samples of delay beyond each plant's own with which its loop has to be stable."""

WORSE = 1.05
"""How much worse a plant may be than before, relative: rounding and noise."""

PRICE = 1.5
"""How much worse than before a sound plant beside the rig itself may track for the sake
of one that oscillates, relative."""

SURE = 0.98
"""Share of a tolerance within which F follows to where a band is promised: the error in
another simulator of the same plant differs by less (`python -m benchmarks.gains`).
Where the error is nearly flat about its tolerance a little of it is a lot of band."""

ABOUT = tuple(np.linspace(0.85, 1.15, 31))
"""Of a tolerance, those over which a search takes the mean of a band: a band jumps
where the error is nearly flat about the tolerance."""

LOST = 0.5
"""Error with the joint moving, relative to the desired force, RMS, from which on the
force is not followed at all."""

PEAK_SLACK = 1.0
"""How far a peak at an amplitude may exceed the limit of the linear one, dB."""

GRAVE = 100.0
"""How an eigenvalue beyond 1 weighs against other faults: by 0.01 as much as something
that is e times as large as it may be."""

AT_ONE = 1e-12
"""An eigenvalue of 1 is too large."""

DECIBELS = 6.0
"""How many dB of a peak weigh as much."""


@dataclass(frozen=True, eq=False)
class Tried:
    """What gains give on every plant, in simulated runs with the adaptation at work.

    Bands and peak are the worse of both amplitudes.

    Attributes:
        gains: in their units.
        within_1dB, lag_90, follows_to: Hz; 0 where the run is not finite. F follows
            with `SURE` of the tolerance.
        about: `within_1dB` and `follows_to`, each the mean of those to `ABOUT`.
        peak: dB.
        rms, rms_moving: of F_d - F, locked at 0.1 to 20 Hz, and moving, N.
        small_moving: `rms_moving` at the smaller amplitude, N.
        eigenvalue: the largest with the adaptation live, at rest and at all speeds.
        late: the same with `DELAY_MARGIN` more delay.
        noise: RMS of F by the sensors' noise, at rest, linearised, N.
        swings: RMS of what oscillates in each trial, of what counts as an oscillation.
        full: share of the samples in which the command is at its end; 0 in the trials
            whose desired force steps.
    """

    gains: Float[np.ndarray, "gains"]
    within_1dB: Float[np.ndarray, "plants"]
    lag_90: Float[np.ndarray, "plants"]
    follows_to: Float[np.ndarray, "plants"]
    about: Float[np.ndarray, "2 plants"]
    peak: Float[np.ndarray, "plants"]
    rms: Float[np.ndarray, "plants"]
    rms_moving: Float[np.ndarray, "plants"]
    small_moving: Float[np.ndarray, "plants"]
    eigenvalue: Float[np.ndarray, "plants"]
    late: Float[np.ndarray, "plants"]
    noise: Float[np.ndarray, "plants"]
    swings: Float[np.ndarray, "trials plants"]
    full: Float[np.ndarray, "trials plants"]

    @property
    def oscillates(self) -> Bool[np.ndarray, "trials plants"]:
        """In which trials F oscillates."""
        return self.swings > 1

    @property
    def saturates(self) -> Bool[np.ndarray, "trials plants"]:
        """In which trials the command saturates."""
        return self.full > trials.SATURATED

    @property
    def calm(self) -> Bool[np.ndarray, "plants"]:
        """Which plants are stable, and do not oscillate."""
        return (self.eigenvalue < 1) & ~np.any(self.oscillates, axis=0)

    @property
    def sound(self) -> bool:
        """Whether all of them are."""
        return bool(np.all(self.calm))

    def averaged(self) -> Tried:
        """The same with each band the mean of those to the tolerances `ABOUT`."""
        return replace(self, within_1dB=self.about[0], follows_to=self.about[1])

    def figures(self, plant: int | None) -> dict[str, float | bool | None]:
        """By tune.json's names, of one plant, or the worst of each figure (None)."""
        low = ("within_1dB", "lag_90", "follows_to")
        high = ("peak", "rms", "rms_moving", "eigenvalue")
        names = {
            "within_1dB": "within_1dB_Hz", "lag_90": "lag_90_Hz",
            "follows_to": "follows_to_Hz", "peak": "peak_dB", "rms": "rms_N",
            "rms_moving": "rms_moving_N", "eigenvalue": "largest_eigenvalue",
        }  # fmt: skip
        out: dict[str, float | bool | None] = {}
        for name in (*low, *high):
            values = getattr(self, name)
            one = values.min() if name in low else values.max()
            one = one if plant is None else values[plant]
            out[names[name]] = metrics.finite_or_none(one)
        which = slice(None) if plant is None else plant
        out["oscillates"] = bool(
            np.any(self.oscillates[:, which]) or np.any(self.eigenvalue[which] >= 1)
        )
        return out


def cap(objective: Objective, declared: bool) -> float:
    """The highest band that is promised, Hz.

    Args:
        objective: whose sampling rate it is.
        declared: whether spool and delay are both known.
    """
    rate = float(1 / objective.setting.loop.h)
    return 0.45 * rate if declared else 0.1 * rate


def run_trials(
    objective: Objective, proposals: list[Float[np.ndarray, "gains"]], most: float,
    tolerance: float = TOLERANCE,
) -> list[Tried]:  # fmt: skip
    """Try proposals: all trials, on all plants of the objective.

    Args:
        objective: plants, trials and programs; nothing is compiled anew.
        proposals: gains.
        most: the highest band that is promised, Hz.
        tolerance: of |1 - F/F_d|.
    """
    m, t = len(objective.values), objective.trials
    count, k = m * len(proposals), len(t.names)
    rows = [objective.rows(g, (0.0,)) for g in proposals]
    joined = jax.tree.map(lambda *a: np.concatenate(a * k), *rows)
    which = np.repeat(np.arange(k), count)
    table = objective.programs.runs(objective.setting, joined, which, t.scenarios)
    table = table.reshape(k, len(proposals), m, *table.shape[1:])

    def one(i: int) -> Tried:
        return _tried(objective, proposals[i], table[:, i], most, tolerance)

    with ThreadPoolExecutor(cores()) as pool:
        return list(pool.map(one, range(len(proposals))))


def _bands(
    hertz: Float[Array, "lines"], H: Complex[Array, "lines"], tolerance: float
) -> tuple[Float[Array, ""], ...]:
    """`within_1dB`, `lag_90` and `follows_to` of a response, then both of `about`."""
    off, dB = jnp.abs(1 - H), jnp.abs(metrics.dB(H))

    def averaged(most, size):
        inside = most * jnp.array(ABOUT)[:, None] - size
        return jnp.mean(jax.vmap(metrics.band, (None, 0))(hertz, inside))

    return (
        metrics.band(hertz, 1.0 - dB),
        metrics.first(hertz, metrics.unwrapped(H) + jnp.pi / 2),
        metrics.band(hertz, tolerance - off),
        averaged(1.0, dB),
        averaged(tolerance, off),
    )


bands = program(jax.vmap(_bands, in_axes=(None, 0, None)))


def _tried(
    objective: Objective, gains: Float[np.ndarray, "gains"],
    table: Float[np.ndarray, "trials plants N 2"], most: float, tolerance: float,
) -> Tried:  # fmt: skip
    t, h = objective.trials, float(objective.setting.loop.h)
    F, u = table[..., 0], table[..., 1]
    found, peaks = [], []
    for k in (trials.RESPONSE, trials.RESPONSE_SMALL):
        with np.errstate(over="ignore", invalid="ignore"):
            H = trials.response_of(t, k, F[k])
        alive = np.isfinite(H).all(-1) & np.isfinite(F[k]).all(-1)
        H = np.where(alive[:, None], H, 1e9)
        each = bands(t.given.hertz, H, SURE * tolerance)
        found.append([np.where(alive, np.minimum(b, most), 0.0) for b in each])
        peaks.append(metrics.decibels(H).max(-1))
    within, lag, follows, *about = np.min(found, axis=0)
    eigenvalue, late, noise = stability(objective, gains)
    swings = np.array([trials.oscillation(t, k, F[k], h) for k in range(len(F))])
    enough = np.maximum(trials.SHARE * t.amplitude[:, None], trials.NOISES * noise)
    at_end = np.abs(u) >= trials.FULL * float(objective.setting.loop.law.u_max)
    locked, moving, small = (
        trials.rms_error(t, k, F[k])
        for k in (trials.FORCE_LOCKED, trials.MOVING, trials.MOVING_SMALL)
    )
    return Tried(
        np.asarray(gains), within, lag, follows, np.array(about),
        np.max(peaks, axis=0),
        locked, moving, small, eigenvalue, late, noise, swings / enough,
        np.where(t.stepped[:, None], 0.0, at_end.mean(-1)),
    )  # fmt: skip


def stability(
    objective: Objective, gains: Float[np.ndarray, "gains"]
) -> tuple[
    Float[np.ndarray, "plants"],
    Float[np.ndarray, "plants"],
    Float[np.ndarray, "plants"],
]:
    """Largest live eigenvalue as it is and with more delay, and noise of F, N."""
    m = len(objective.values)
    rows, carries = objective.points(gains)
    full = objective.programs.systems(objective.setting, rows, carries)
    largest = linearize.largest_eigenvalue(full).reshape(-1, m).max(0)
    at_rest = jax.tree.map(lambda a: a[:m], full)
    H = linearize.responses(linearize.reduced(at_rest, objective.states), objective.few)
    power = np.sum(np.abs(H[:, :, 0, 2:]) ** 2, axis=-1)
    noise = np.sqrt(np.trapezoid(power, objective.few) / objective.few[-1])
    late = largest
    if DELAY in objective.names:
        i = objective.names.index(DELAY)
        plant = rows.plant.copy()
        plant[:, i] += DELAY_MARGIN * float(objective.setting.loop.h)
        more = rows._replace(plant=plant)
        full = objective.programs.systems(objective.setting, more, carries)
        late = linearize.largest_eigenvalue(full).reshape(-1, m).max(0)
    return largest, late, noise


class Check(NamedTuple):
    """Something that proposed gains must keep.

    Attributes:
        broken: what is wrong where it is not kept.
        over: for each plant, logarithm of how far it exceeds its limit; kept up to 0.
        rest: more on it.
    """

    broken: str
    over: Float[np.ndarray, "plants"]
    rest: str = ""

    def __str__(self) -> str:
        count = f"on {int(np.sum(self.over > 0))} of {self.over.size} plants"
        return f"{self.broken} {count}{self.rest}"


def beyond(
    now: Float[np.ndarray, "*plants"], most: Float[np.ndarray, "*plants"] | float
) -> Float[np.ndarray, "*plants"]:
    """The logarithm of how far something exceeds its limit."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        over = np.log(now) - np.log(most)
    return np.where(np.isnan(over), np.inf, over)


def checks(
    objective: Objective, tried: Tried, before: Tried, calm: float = 1.0
) -> list[Check]:
    """All that proposed gains must keep, the gravest first.

    Args:
        objective: plants, trials and limits.
        tried: the gains, tried.
        before: the present ones, tried.
        calm: how much of what counts as an oscillation is let pass.
    """
    largest = f" (largest eigenvalue {tried.eigenvalue.max():.4f})"
    live, late = (GRAVE * (e - 1) + AT_ONE for e in (tried.eigenvalue, tried.late))
    out = [
        Check("unstable with the adaptation live", live, largest),
        Check(
            f"unstable with {DELAY_MARGIN} samples more delay",
            np.where(np.any(live > 0), -np.inf, late),
        ),
    ]
    for says, over in (
        ("oscillates", beyond(tried.swings, calm)),
        ("saturates", beyond(tried.full, trials.SATURATED)),
    ):
        named = zip(objective.trials.names, over, strict=True)
        out += [Check(f"{says} in the run {name!r}", each) for name, each in named]
    wide = objective.limits.tracking * WORSE
    for says, k, now, was in (
        ("locked", trials.FORCE_LOCKED, tried.rms, before.rms),
        ("moving", trials.MOVING, tried.rms_moving, before.rms_moving),
        ("moving, small", trials.MOVING_SMALL, tried.small_moving, before.small_moving),
    ):
        i = int(np.argmax(now / was))
        figures = f", {now[i]:.3g} N RMS against {was[i]:.3g} N before"
        # A plant that oscillated in this run has no tracking to be kept; what makes it
        # sound may cost the others something, but not all, and the rig itself nothing.
        own = was if before.sound else np.append(was[:1], PRICE * was[1:])
        calm = (before.eigenvalue < 1) & ~before.oscillates[k]
        most = wide * np.where(calm, own, np.max(was))
        out.append(Check(f"tracks worse ({says})", beyond(now, most), figures))
    lost = LOST * objective.trials.amplitude[trials.MOVING]
    figures = f", {tried.rms_moving.max():.3g} N RMS"
    over = beyond(tried.rms_moving, lost)
    out.append(Check("does not follow (moving)", over, figures))
    peak = max(objective.limits.peak_dB + PEAK_SLACK, float(np.max(before.peak)))
    over = (tried.peak - peak) / DECIBELS
    return [*out, Check(f"peak of {tried.peak.max():.1f} dB", over)]


def against(objective: Objective, tried: Tried, before: Tried) -> tuple[str, ...]:
    """What speaks against proposing these gains; empty where nothing does."""
    return tuple(str(c) for c in checks(objective, tried, before) if np.any(c.over > 0))
