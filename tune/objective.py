"""What a loop is tuned for: an aim over an ensemble, and what it must keep.

Peak, robustness, noise and command come from the loop linearised at rest and at speeds
of the joint, its adaptation live; tracking from a simulated run with the joint moving.
Slopes are differences: rows of the same compiled programs.
"""

from __future__ import annotations

import copy
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from hydrojax.control.adaptive import Law
from hydrojax.control.base import RATES
from hydrojax.programs.compiled import program
from hydrojax.rigfile.quantities import Quantity, Setting
from hydrojax.tune import linearize, metrics, operating_point, programs, trials
from hydrojax.tune.aims import Aim, Following, Limits, Seen, soft_kept
from hydrojax.tune.ensemble import Plants
from hydrojax.tune.programs import Programs, Rows
from hydrojax.tune.trials import make_trials

LOW_HZ = 2.0
"""Where the loop must reject what disturbs it as well as before."""

SPEEDS = (1.0, -1.0)
"""Speeds at which a descent linearises the loop beside rest, in the trials' peak:
there no presliding lowers the loop's gain any more."""

ALL_SPEEDS = (1.0, 1 / 3, 0.1, -0.1, -1 / 3, -1.0)
"""Speeds at which a proposal has to be stable, beside rest, in the trials' peak."""

UNSOUND = 2.0
"""How much worse than before the others may track where a plant was unstable."""

SPARE = 0.03
"""How much better than its limit a descent tracks, relative: the other runs of a check
differ from the one that it sees."""

FOLLOWS = 0.5
"""Largest |1 - F/F_d| at which a command counts as one that F follows."""

LINES = 48
"""Frequencies of a descent; what is shown has `metrics.LINES`."""

STEP = 1e-4
"""Relative step of the slopes of what is linearised; that of the run is `RUN_STEP`:
the encoder's steps make it rough."""

RUN_STEP = 1e-2


_metrics = program(jax.vmap(metrics.loop_metrics, (None, 0, 0)))


def groups_of(free: list[Quantity]) -> Int[np.ndarray, "gains"]:
    """Which gains move together: the rates of adapting friction, c_1 to c_7, do."""
    out: list[int] = []
    first: int | None = None
    for quantity in free:
        friction = quantity.name in RATES and quantity.name.startswith("c_")
        place = max(out, default=-1) + 1
        if friction:
            first = place if first is None else first
            place = first
        out.append(place)
    return np.array(out, int)


class Objective:
    """An aim and constraints of a setting as functions of some of its quantities.

    Args:
        setting: the loop at its operating point.
        free: the quantities that may change.
        plants: the ensemble.
        limits: what must be kept.
        aim: what is made as large as it can be.
    """

    def __init__(
        self, setting: Setting, free: list[Quantity], plants: Plants, limits: Limits,
        aim: Aim | None = None,
    ):  # fmt: skip
        self.setting, self.free, self.limits = setting, free, limits
        self.aim = aim or Following()
        self.names, self.values = plants.names, np.asarray(plants.values)
        self.groups = groups_of(free)
        self.hertz = metrics.grid(float(1 / setting.loop.h))
        self.few = metrics.grid(float(1 / setting.loop.h), LINES)
        self.trials = make_trials(setting)
        settle = round(operating_point.SETTLE / float(setting.loop.h))
        count = (1 + self.groups.max(initial=-1) + 1) * len(self.values)
        self.programs = Programs(
            setting, free, self.names, settle, int(count), self.trials.scenarios
        )
        # Nowhere 0, so that what a gain of 0 would leave out is among the states.
        gains = np.maximum(1.01 * self.initial(), 1e-4)
        rows = self.rows(gains, (0.0, *SPEEDS))
        self.carries = self.programs.settle(setting, self.rows(None, (0.0, *SPEEDS)))
        full = self.programs.systems(setting, rows, self.carries)
        self.states = linearize.find_states(full)
        self._points: Any = None
        self.model: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self.before: dict[str, np.ndarray] = {}
        self.before = self.evaluate(self.initial())
        self.sound = bool(np.all(self.before["largest_eigenvalue"] < 1))

    def relaxed(
        self,
        setting: Setting | None = None,
        values: Float[np.ndarray, "plants parameters"] | None = None,
        limits: Limits | None = None,
    ) -> Objective:
        """The same objective with other numbers; nothing is compiled anew.

        What it must keep relative to before, it keeps relative to the same before.
        """
        out = copy.copy(self)
        out.setting = self.setting if setting is None else setting
        out.values = self.values if values is None else values
        out.limits = self.limits if limits is None else limits
        if setting is not None or values is not None:
            rows = out.rows(None, (0.0, *SPEEDS))
            out.carries = self.programs.settle(out.setting, rows)
            out._points = None
        return out

    def without_runs(self, gains: Float[np.ndarray, "gains"]) -> Objective:
        """The same, with tracking to first order about these gains: no more runs."""
        count = int(self.groups.max()) + 1
        moved = np.concatenate([np.zeros((1, count)), RUN_STEP * np.eye(count)])
        rms = np.log(self._runs(gains, moved))
        out = copy.copy(self)
        out.model = np.asarray(gains), rms[0], (rms[1:] - rms[0]) / RUN_STEP
        return out

    def initial(self) -> Float[np.ndarray, "gains"]:
        """The setting's own values of what is free, in their units."""
        return np.array([float(q.get(self.setting)) for q in self.free])

    def at(self, gains: Float[np.ndarray, "gains"], plant: int = 0) -> Setting:
        """The setting of one plant with these gains."""
        return programs.setting_at(
            self.setting, self.free, self.names, jnp.asarray(gains),
            jnp.asarray(self.values[plant]), self.setting.v,
        )  # fmt: skip

    def rows(
        self, gains: Float[np.ndarray, "gains"] | None, speeds: tuple[float, ...]
    ) -> Rows:
        """All plants with these gains (None: the setting's), speed by speed, in the
        trials' peak.
        """
        g = self.initial() if gains is None else np.asarray(gains)
        m, count = len(self.values), len(speeds) * len(self.values)
        rest = float(self.setting.v)
        return Rows(
            np.broadcast_to(g, (count, g.size)),
            np.tile(self.values, (len(speeds), 1)),
            np.repeat(np.array([v * self.trials.speed or rest for v in speeds]), m),
        )

    def points(self, gains: Float[np.ndarray, "gains"]) -> tuple[Rows, Any]:
        """All plants at rest and at `ALL_SPEEDS`, and the memory of each there.

        The paper's law settles with gains of its own, so its points are found once.
        """
        speeds = (0.0, *ALL_SPEEDS)
        rows = self.rows(gains, speeds)
        if not isinstance(self.setting.loop.law, Law):
            return rows, self.programs.settle(self.setting, rows)
        if self._points is None:
            own = self.rows(None, speeds)
            self._points = self.programs.settle(self.setting, own)
        return rows, self._points

    def evaluate(
        self, gains: Float[np.ndarray, "gains"]
    ) -> dict[str, Float[np.ndarray, "plants *rest"]]:
        """Metrics of all plants, linearised at rest with the adaptation live.

        `largest_eigenvalue` is the largest over `ALL_SPEEDS` too, each at its
        own point; `peak_moving` and `sensitivity_moving` are over them.
        """
        m = len(self.values)
        rows, carries = self.points(gains)
        full = self.programs.systems(self.setting, rows, carries)
        largest = linearize.largest_eigenvalue(full).reshape(-1, m).max(0)
        H = linearize.responses(linearize.reduced(full, self.states), self.hertz)
        # At rest a mean pressure stays put, and so does every estimate.
        found = _metrics(self.hertz, H[:m], largest)
        sense = metrics.decibels(H[:m, :, 1, 1])
        out = {n: np.asarray(v) for n, v in found.items()}
        moving = metrics.decibels(H[m:]).reshape(-1, m, self.hertz.size, 2, 5)
        return out | {
            "largest_eigenvalue": largest,
            "response": H[:m, :, 0, 0],
            "low": np.array([np.interp(LOW_HZ, self.hertz, s) for s in sense]),
            "peak_moving": moving[..., 0, 0].max((0, 2)),
            "sensitivity_moving": moving[..., 1, 1].max((0, 2)),
            "rms": self._tracking(self.rows(gains, (0.0,))),
        }

    def scores(
        self, gains: Float[np.ndarray, "gains"]
    ) -> tuple[Float[np.ndarray, "7"], Float[np.ndarray, "7 groups"], bool]:
        """The aim and `CONSTRAINTS` (kept where >= 0), slopes, whether stable.

        Slopes are per logarithm of each group of gains.
        """
        count = int(self.groups.max()) + 1
        moved = np.concatenate([np.zeros((1, count)), np.eye(count)])
        value, radius = self._linear(gains, STEP * moved)
        rms = self._runs(gains, RUN_STEP * moved)
        table = [self._score(*row) for row in zip(value, rms[:1].repeat(count + 1, 0),
                                                  strict=True)]  # fmt: skip
        by_run = [self._score(value[0], r) for r in rms]
        here = np.array(table[0])
        slope = (np.array(table[1:]) - here) / STEP
        slope += (np.array(by_run[1:]) - here) / RUN_STEP
        sound = radius < 1 and np.isfinite(here).all() and np.isfinite(slope).all()
        return here, slope.T, bool(sound)

    def stable(self, gains: Float[np.ndarray, "gains"]) -> bool:
        """Whether every plant is stable at rest and at `SPEEDS`, adaptation live."""
        count = int(self.groups.max()) + 1
        return self._linear(gains, np.zeros((1, count)))[1] < 1

    def _linear(
        self, gains: Float[np.ndarray, "gains"], moved: Float[np.ndarray, "k groups"]
    ) -> tuple[list[Any], float]:
        """Responses [speeds, plants, lines, 2, 5] at each of the moved gains."""
        speeds, m = (0.0, *SPEEDS), len(self.values)
        each = [self.rows(gains * np.exp(y[self.groups]), speeds) for y in moved]
        rows = jax.tree.map(lambda *a: np.concatenate(a), *each)
        n = len(speeds) * m
        carries = programs.repeat(self.carries, np.tile(np.arange(n), len(moved)))
        full = self.programs.systems(self.setting, rows, carries)
        first = jax.tree.map(lambda a: a[:n], full)
        radius = float(np.max(linearize.largest_eigenvalue(first)))
        H = linearize.responses(linearize.reduced(full, self.states), self.few)
        return list(H.reshape(len(moved), len(speeds), m, *H.shape[1:])), radius

    def _runs(
        self, gains: Float[np.ndarray, "gains"], moved: Float[np.ndarray, "k groups"]
    ) -> Float[np.ndarray, "k plants"]:
        """RMS of the moving run of all plants at each of the moved gains, N."""
        if self.model is not None:
            about, rms, slope = self.model
            away = np.log(np.maximum(gains, 1e-300) / np.maximum(about, 1e-300))
            y = np.array([away[self.groups == g].mean() for g in range(moved.shape[1])])
            return np.exp(np.clip(rms + (y + moved) @ slope, -20, 20))
        each = [self.rows(gains * np.exp(y[self.groups]), (0.0,)) for y in moved]
        rows = jax.tree.map(lambda *a: np.concatenate(a), *each)
        return self._tracking(rows).reshape(len(moved), -1)

    def _tracking(self, rows: Rows) -> Float[np.ndarray, "rows"]:
        k = trials.MOVING
        which = np.full(rows.v.size, k)
        F = self.programs.runs(self.setting, rows, which, self.trials.scenarios)
        return trials.rms_error(self.trials, k, F[..., 0])

    def _score(
        self, H: Float[np.ndarray, "speeds plants lines 2 5"],
        rms: Float[np.ndarray, "plants"],
    ) -> list[float]:  # fmt: skip
        """The aim and all constraints of one set of gains."""
        keep, u_max = self.limits, float(self.setting.loop.law.u_max)
        rest, dB = H[0], metrics.decibels(H)
        power = np.sum(np.abs(rest[..., 1, 2:]) ** 2, axis=-1)
        heard = np.sqrt(np.trapezoid(power, self.few) / self.few[-1])
        follows = soft_kept(np.abs(1 - rest[..., 0, 0]) / FOLLOWS)
        pushed = float(self.setting.amplitude) * follows * np.abs(rest[..., 1, 0])
        i = int(np.argmin(np.abs(self.few - LOW_HZ)))
        low = dB[..., i, 1, 1]
        seen = Seen(self.few, rest[..., 0, 0], rms, low.max(0))
        was, wide = self.before["rms"], keep.tracking
        if not self.sound:
            was, wide = np.maximum(was, np.median(was)), UNSOUND * wide
        limit = np.max(self.before["low"]) - 20 * np.log10(keep.rejection)
        moving = keep.moving_dB
        if self.sound:
            moving = max(moving, float(np.max(self.before["sensitivity_moving"])))
        sense = dB[..., 1, 1]
        margin = min(keep.sensitivity_dB - _top(sense[0]), moving - _top(sense[1:]))
        return [
            self.aim.score(seen),
            (keep.peak_dB - _top(dB[0, ..., 0, 0])) / 3,
            margin / 3,
            float(np.log(keep.noise * u_max / max(np.max(heard), 1e-9 * u_max))),
            float(np.log(keep.push * u_max / max(np.max(pushed), 1e-9 * u_max))),
            float(np.min(np.log(wide * was / rms))) - SPARE,
            float(limit - np.max(low[0])) / 3,
        ]


def _top(dB: Float[np.ndarray, "*rest"], sharp: float = 20.0) -> float:
    """The largest value, smoothly."""
    most = np.max(dB)
    return float(most + np.log(np.sum(np.exp(sharp * (dB - most)))) / sharp)
