"""What is fitted to what: a model, its free parameters, logs, and compiled programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree
from scipy.linalg import block_diag

from hydrojax.identify.estimation.columns import (
    Basis,
    Batch,
    ParametricRig,
    Room,
    basis,
    batch_of,
    filled,
    room_of,
    slot_names,
    thinned,
)
from hydrojax.identify.estimation.coupled import agreed, stretched
from hydrojax.identify.estimation.drive import SpoolPath
from hydrojax.identify.estimation.known import Free, Known, prior_rows
from hydrojax.identify.estimation.memory import Store, recalled, spool_of
from hydrojax.identify.estimation.misfit import (
    START_SPREAD,
    Sums,
    run_leftover,
    run_pressures,
    run_sums,
)
from hydrojax.identify.estimation.pieces import on_all_cores
from hydrojax.identify.estimation.sensitivity import Recalled
from hydrojax.identify.estimation.solve import ENOUGH, Fit, minimise_step_by_step
from hydrojax.identify.preparation.data import Data
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.plant.places import gauge_names
from hydrojax.plant.replay import Cut
from hydrojax.plant.rig import Rig

SPARE = ((4, 9), (16, 40))
"""Columns kept free for effects that a trace adds (hydraulic, other): the first that
holds them is taken, so that few programs serve every fit. One more takes longer to
compile than all fits of a trace save by fewer columns."""

SPARE_OF_PRESSURES = ((4, 3), (16, 9), (16, 40))
"""The same where the rig file has nothing but what moves the pressures."""

KEPT = 4
"""Values for which a problem keeps the residuals."""

NO_WORSE = 1.01
"""Squared residuals over those of the first guess up to which corrected initial
pressures are no worse, 1: both are free of what the guess does to first order."""

PRESSURES = np.array([True, True, False])
"""Which channels are pressures."""


@dataclass(frozen=True)
class Problem:
    """What a fit is given: the model, what may be free, and the data.

    `declared` counts the free parameters of the rig file, hydraulic and other.

    `symmetric` holds k_cp and k_cn equal, for logs that do not distinguish a difference
    of the two from an offset k_0. `known` is what other logs give, in place of priors;
    `criteria` the thresholds of whatever is decided on it, `least` the size of logs
    that its programs are to have room for. `balances` keeps what `balance_at` gave:
    searches of several kinds begin alike.
    """

    model: ParametricRig
    free: Mapping[str, Free]
    batch: Batch
    declared: tuple[int, int]
    simulate: bool
    symmetric: bool = False
    known: Known | None = None
    criteria: Criteria = Criteria()
    least: Room = (0, 0, 0)
    _begun: dict[bytes, tuple[Batch, Float[np.ndarray, "windows ticks 3"]]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _summed: dict[bytes, Sums] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _common: Store = field(default_factory=dict, init=False, repr=False, compare=False)
    balances: dict[tuple[bytes, tuple[str, ...]], Any] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @classmethod
    def of(
        cls,
        rig: Rig,
        free: Mapping[str, Free],
        data: Data,
        criteria: Criteria = Criteria(),
    ) -> Problem:
        """The problem of fitting `free` on prepared logs."""
        model = ParametricRig.of(rig)
        first = sum(model.names.index(n) < model.hydraulic for n in free)
        declared = (first, len(free) - first)
        batch = batch_of(data)
        return cls(
            model,
            free,
            batch,
            declared,
            data.driven_by == "u",
            criteria=criteria,
            least=room_of(batch),
        )

    @cached_property
    def brief(self) -> Problem:
        """The problem on as many windows as balances are fitted on."""
        ticks = self.batch.windows.u.shape[1]
        most = max(self.criteria.balance_ticks // ticks, 1)
        return replace(self, batch=thinned(self.batch, most))

    def slots(self, free: Sequence[str]) -> tuple[int, int]:
        """Columns, hydraulic and other, of the program that fits these parameters."""
        usual = SPARE if self.declared[1] else SPARE_OF_PRESSURES
        return self._holding(free, usual)

    def most_slots(self, free: Sequence[str]) -> tuple[int, int]:
        """Those of the one program that fits nearly all that may be free together."""
        return self._holding(free, SPARE[-1:])

    def _holding(
        self, free: Sequence[str], usual: Sequence[tuple[int, int]]
    ) -> tuple[int, int]:
        """The first of the usual columns, or of their doubles, that hold `free`.

        Both sides grow together, so that few programs serve every fit, of the pressures
        by themselves too; not where the rig file has nothing but what moves these:
        hardly any but hydraulic ones are free there.
        """
        need = (len(self.side(free, True)), len(self.side(free, False)))
        if len(self.free) == sum(self.declared):
            return self.declared
        larger = ((usual[-1][0] << i, usual[-1][1] << i) for i in range(1, 8))
        sizes = np.add(self.declared, [*usual, *larger])
        first = np.argmax(sizes >= need, axis=0)
        if self.declared[1]:
            first[:] = np.max(first)
        return int(sizes[first[0], 0]), int(sizes[first[1], 1])

    def solve(
        self,
        values: Float[np.ndarray, "n"],
        free: Sequence[str] | None = None,
        noise: Float[np.ndarray, "3"] | None = None,
        enough: float = ENOUGH,
    ) -> tuple[Float[np.ndarray, "n"], Fit]:
        """Move `free` from `values` to the best fit; returns all values, and how.

        `noise` replaces the problem's own where a part of the model is fitted by
        itself; `enough` is the share of the cost that a step has to promise.
        """
        free = tuple(self.free if free is None else free)
        slots = self.slots(free)
        columns = slot_names(self.model, free, slots)
        index = np.array([self.model.names.index(n) if n else 0 for n in columns])
        scale = self.model.scale[index]
        at = values[index]
        spare = Free(0.0, 0.0, 0.0)
        given = [self.free[n] if n else spare for n in columns]
        lower = np.array([f.lower for f in given])
        upper = np.array([f.upper for f in given])
        used = np.array([n is not None for n in columns])

        def boxed(bound):
            return np.where(used, (bound - at) / scale, 0.0)

        batch = self.batch if noise is None else self.batch._replace(noise=noise)
        tied = self.criteria.tied if self.symmetric else None
        slope, away = prior_rows(self.free, self.known, tied, columns, at, scale)
        full = self._filled(batch)
        model, begun = self.model.acting(values, free)
        directions = basis(model, free, slots)
        start, moves = np.asarray(begun), block_diag(*directions)

        def gram(d: Float[np.ndarray, "k"]) -> tuple[np.ndarray, Sums]:
            there = self._sums(model, start + moves @ d, directions, batch, full)
            # What is known beforehand is more residual rows.
            rows = np.concatenate([slope, (slope @ d + away)[:, None]], axis=1)
            return np.sum(there.gram, axis=0) + rows.T @ rows, there

        out = minimise_step_by_step(gram, boxed(lower), boxed(upper), enough=enough)
        moved = values.copy()
        step = np.asarray(out.at) * scale
        for i, name in enumerate(columns):
            if name:
                # Clipped again in SI: the box's corner may be off by rounding.
                moved[index[i]] = np.clip(at[i] + step[i], lower[i], upper[i])
        return moved, out

    def sums_at(
        self,
        values: Float[np.ndarray, "n"],
        noise: Float[np.ndarray, "3"] | None = None,
    ) -> Sums:
        """The windows' sums at `values`, along every parameter of the model."""
        batch = self.batch
        if noise is not None:
            batch = batch._replace(noise=noise)
        key = values.tobytes() + np.asarray(batch.noise).tobytes()
        found = self._summed.get(key)
        if found is None:
            n, names = self.model.hydraulic, self.model.names
            found = self.evaluate(values, names, (n, len(names) - n), batch)
            for a in found:  # every later caller gets the same arrays
                np.asarray(a).setflags(write=False)
            self._summed.clear()  # the last only: it is asked for where a fit ended
            self._summed[key] = found
        return found

    def sums_along(
        self,
        values: Float[np.ndarray, "n"],
        names: tuple[str, ...],
        noise: Float[np.ndarray, "3"],
    ) -> tuple[list[str | None], Sums]:
        """The windows' sums at `values` along some parameters, by the program that fits
        them: what each of their columns stands for, and the sums.
        """
        slots = self.slots(names)
        sums = self.evaluate(values, names, slots, self.batch._replace(noise=noise))
        return slot_names(self.model, names, slots), sums

    def fits_alike(
        self, values: Float[np.ndarray, "n"], some: Sequence[str], others: Sequence[str]
    ) -> bool:
        """Whether the program that fits some parameters at `values` fits others too."""
        a, b = (self.model.acting(values, own)[0].names for own in (some, others))
        return a == b and self.slots(some) == self.slots(others)

    def residuals_at(
        self, values: Float[np.ndarray, "n"]
    ) -> Float[np.ndarray, "windows ticks 3"]:
        """Measured minus replayed, SI.

        What gives follows the force that is replayed; see `coupled`.
        """
        batch, left = self._begin(values)
        if not self.simulate:
            return left
        rig = stretched(self.model, values)
        if rig is None:
            return left
        return agreed(
            rig, batch, left, lambda b: self._left(values, b)[0], self.criteria
        )

    def started(self, values: Float[np.ndarray, "n"]) -> Batch:
        """The batch with each window's initial pressures as `values` want them."""
        return self._begin(values)[0]

    def _filled(self, batch: Batch) -> Batch:
        """The batch as programs take it, in JAX's arrays: they are not copied again for
        each piece of it.
        """
        return jax.tree.map(jnp.asarray, filled(batch, self.least))

    def _left(self, values: np.ndarray, batch: Batch) -> tuple[np.ndarray, np.ndarray]:
        """Residuals [W, T, 3], and how far off the initial pressures are, [W, 2]."""
        model, at = self.model.acting(values)
        full = self._filled(batch)
        common = self._recall(model, at, None, batch, full)

        def run(*pieces):
            return run_leftover(model, at, full, common, *pieces)

        return self._real(on_all_cores(run, full))

    def _sums(
        self,
        model: ParametricRig,
        values: Float[Array | np.ndarray, "n"],
        directions: Basis,
        batch: Batch,
        full: Batch,
    ) -> Sums:
        """The windows' sums of a batch; `full` is what it is filled up to."""
        common = self._recall(model, values, directions, batch, full)
        at = jnp.asarray(values)

        def run(*pieces):
            return run_sums(model, at, directions, full, common, *pieces)

        real = len(batch.P_0)
        return jax.tree.map(lambda a: a[:real], on_all_cores(run, full))

    def _recall(
        self,
        model: ParametricRig,
        values: Float[Array | np.ndarray, "n"],
        directions: Basis | None,
        batch: Batch,
        full: Batch,
    ) -> Recalled:
        """What all windows of a batch have in common; what friction remembers is kept
        of the problem's own motion only: where something gives it is run under other
        forces, too.
        """
        own = self._common if batch.motion is self.batch.motion else {}
        stores = (own, self._common)
        return recalled(model, values, directions, full.motion, self.simulate, stores)

    def spool(
        self,
        model: ParametricRig,
        values: Float[Array | np.ndarray, "n"],
        hydraulic: Float[np.ndarray, "n_1 k"],
        full: Batch,
        cut: Cut | None,
    ) -> SpoolPath:
        """Where the command has the spool, as `spool_of` has it; kept."""
        return spool_of(model, values, hydraulic, full.motion, self._common, cut)

    def _begin(self, values: np.ndarray) -> tuple[Batch, np.ndarray]:
        """The batch with its windows' initial pressures found, and the residuals.

        The last few are kept: a search asks again and again for those where it stands.
        """
        key = values.tobytes()
        found = self._begun.get(key)
        if found is None:
            found = self._find_starts(values)
            found[1].setflags(write=False)  # every later caller gets the same array
            self._begun[key] = found
            for old in list(self._begun)[:-KEPT]:
                self._begun.pop(old, None)
        return found

    def _find_starts(self, values: np.ndarray) -> tuple[Batch, np.ndarray]:
        """What `_begin` gives.

        Initial pressures are corrected once, and linearly beyond that: logs that take
        no part in a fit come with a first guess only. The residuals of both hardly
        differ then: the later one is kept unless it is worse, and where it leads. Where
        no pressure is measured it takes more, and ways that lead through worse
        places: each window keeps the best it saw. Nothing is to be corrected where
        pressures are the log's.
        """
        noise = np.asarray(self.batch.noise)
        seen = np.isfinite(noise)
        highest = np.max(np.asarray(self.batch.windows.P_s), axis=1, keepdims=True)

        def cost(left: np.ndarray) -> np.ndarray:
            return np.sum((left[..., seen] / noise[seen]) ** 2, axis=(1, 2))

        def leads(P_0: np.ndarray, off: np.ndarray) -> np.ndarray:
            return P_0 - off if self.simulate and not self.blind else P_0

        P_0 = np.asarray(self.batch.P_0)
        left, off = self._left(values, self.batch)
        best = leads(P_0, off)
        rounds = self.criteria.blind_corrections if self.blind else int(self.simulate)
        for _ in range(rounds):
            P_0 = np.clip(P_0 - off, 0.0, highest) if self.blind else P_0 - off
            there, off = self._left(values, self.batch._replace(P_0=P_0))
            most = cost(left) * (1.0 if self.blind else NO_WORSE)
            better = cost(there) <= most
            best = np.where(better[:, None], leads(P_0, off), best)
            left = np.where(better[:, None, None], there, left)
        return self.batch._replace(P_0=best), left

    def errors_at(
        self, values: Float[np.ndarray, "n"]
    ) -> Float[np.ndarray, "windows 3"]:
        """Sum of squared residuals by window and channel, SI."""
        return np.sum(self.residuals_at(values) ** 2, axis=1)

    def evaluate(
        self,
        values: Float[np.ndarray, "n"],
        free: tuple[str, ...],
        slots: tuple[int, int],
        batch: Batch,
    ) -> Sums:
        """The windows' sums of a batch at `values`, along the columns of `free`."""
        model, at = self.model.acting(values, free)
        directions = basis(model, free, slots)
        full = self._filled(batch)
        return self._sums(model, at, directions, batch, full)

    def behind(self, values: Float[np.ndarray, "n"]) -> Problem:
        """The problem at the pressures that are replayed at `values`: what acts behind
        them, friction and sensors, is fitted at a small part of the cost.
        """
        batch = self.batch
        full = self._filled(batch)
        model, at = self.model.acting(values)
        spool = spool_of(model, at, None, full.motion, self._common)
        P = self._real(run_pressures(model, at, full, spool.now))
        windows = batch.windows._replace(P_a1=P[0], P_a2=P[1])
        return replace(self, batch=batch._replace(windows=windows), simulate=False)

    def _real(self, found: PyTree) -> PyTree:
        """What was found of the windows, without those that only fill up."""
        return jax.tree.map(lambda a: np.asarray(a)[: len(self.batch.P_0)], found)

    def restarted(self, at: Sums, values: Float[np.ndarray, "n"]) -> Problem:
        """The problem with each window's initial pressures moved to their estimate.

        `at` are the windows' sums at `values`.
        """
        batch = self.batch
        if self.blind:
            return replace(self, batch=self._begin(values)[0])
        P_0 = batch.P_0 - at.start[:, :2, -1]
        for i, own in enumerate((batch.windows.P_a1, batch.windows.P_a2)):
            if np.isfinite(np.asarray(batch.noise)[i]):
                # A chamber that runs empty in a window says little of where it began.
                first = np.asarray(own)[:, 0]
                P_0[:, i] = np.clip(
                    P_0[:, i], first - START_SPREAD, first + START_SPREAD
                )
        return replace(self, batch=batch._replace(P_0=P_0))

    def initial_values(self) -> Float[np.ndarray, "n"]:
        """The rig's values, with every free parameter at its start."""
        values = np.array(self.model.values)
        for name, f in self.free.items():
            values[self.model.names.index(name)] = f.start
        return values

    @property
    def blind(self) -> bool:
        """Whether pressures are simulated that no channel of the log shows."""
        return self.simulate and not self.sees_pressures

    @property
    def sees_force(self) -> bool:
        """Whether the force is compared."""
        return bool(np.isfinite(np.asarray(self.batch.noise)[2]))

    @property
    def sees_pressures(self) -> bool:
        """Whether the pressures are simulated, and compared with the log's."""
        noise = np.asarray(self.batch.noise)
        return self.simulate and bool(np.any(np.isfinite(noise) & PRESSURES))

    def side(self, names: Sequence[str], hydraulic: bool) -> tuple[str, ...]:
        """Those of the names on which the pressures depend, or the others."""
        n = self.model.hydraulic
        return tuple(x for x in names if (self.model.names.index(x) < n) == hydraulic)

    def rms(
        self, sse: Float[Array | np.ndarray, "windows 3"]
    ) -> Float[np.ndarray, "3"]:
        """Root mean square by channel, SI, of the windows' squared residuals."""
        ticks = self.batch.windows.measured.shape[1]
        return np.sqrt(
            np.sum(np.asarray(sse), axis=0) / (np.sum(self.batch.weight) * ticks)
        )


def in_play(problem: Problem, data: Data) -> tuple[str, ...]:
    """The free parameters that anything compared depends on."""
    out, gauges = [], gauge_names(problem.model.rig)
    for name in problem.free:
        hydraulic = problem.model.names.index(name) < problem.model.hydraulic
        plays = data.driven_by == "u" if hydraulic else np.isfinite(data.noise[2])
        if plays or (name in gauges and data.driven_by == "u"):
            out.append(name)
    return tuple(out)
