"""A fit of the flow balances at the measured pressures: a start from anywhere.

A replay carries what a model lacks from tick to tick, and a fit of it drives the
parameters off to compensate. The balance of each tick knows its own error only,
integrates nothing, and has fewer local minima: it gives where a replay's fit begins,
and which effects are worth a fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.optimize import lsq_linear

from hydrojax.identify.estimation.columns import (
    HANDFUL,
    Batch,
    ParametricRig,
    basis,
    filled,
    slot_names,
)
from hydrojax.identify.estimation.drive import SpoolPath
from hydrojax.identify.estimation.pieces import Span, at_once, in_pieces
from hydrojax.identify.estimation.problem import PRESSURES, Problem
from hydrojax.identify.estimation.starts import placed
from hydrojax.parameters import put
from hydrojax.plant.imbalance import imbalance_behind
from hydrojax.plant.places import opening_names
from hydrojax.plant.replay import cut_of, opened_in
from hydrojax.programs.compiled import program_of_pytrees

Values = Float[np.ndarray, "n"]

SPAN, FEWEST = 0.025, 12
"""Seconds over which a balance is summed under a smooth weight, and ticks at least:
pressures are noisy, and their noise sums to little there."""


BASE_STEPS = 8
"""Steps of a fit of the declared model's balances, at most: a start is all it gives."""


class Linear(NamedTuple):
    """A sum of squares about some values, along what is free.

    Attributes:
        values: of all parameters.
        where: places of what is free among them.
        gram: of [sensitivities, residual], priors among its rows.
    """

    values: Values
    where: Int[np.ndarray, "k"]
    gram: Float[np.ndarray, "rows rows"]

    @classmethod
    def of(
        cls,
        problem: Problem,
        values: Values,
        columns: Sequence[str | None],
        gram: Float[np.ndarray, "rows rows"],
        variance: float = 1.0,
    ) -> Linear:
        """Without the columns that stand for nothing, and with what is known ahead, in
        units of the residual's `variance`.
        """
        model = problem.model
        used = [i for i, n in enumerate(columns) if n]
        gram = gram[np.ix_([*used, -1], [*used, -1])]
        index = np.array([model.names.index(n) for n in columns if n], int)
        for i, f in enumerate(problem.free[n] for n in columns if n):
            if f.prior:
                slope = model.scale[index[i]] / f.prior
                row = (slope, (values[index[i]] - f.start) / f.prior)
                gram[np.ix_([i, -1], [i, -1])] += variance * np.outer(row, row)
        return cls(values, index, gram)

    @property
    def left(self) -> float:
        """The sum of squares there."""
        return float(self.gram[-1, -1])

    def move(self, problem: Problem, damping: float) -> Float[np.ndarray, "k"]:
        """The damped step to the least sum of squares inside the ranges, in scales."""
        k, names = len(self.where), problem.model.names
        scale = problem.model.scale[self.where]
        free = [problem.free[names[i]] for i in self.where]
        size = np.sqrt(np.maximum(np.diag(self.gram)[:k], 0.0))
        size = np.maximum(size, 1e-6 * np.max(size, initial=0.0))
        size = np.where(size > 0, size, 1.0)  # nothing that is free is seen
        H = self.gram[:k, :k] / np.outer(size, size)
        R = np.linalg.cholesky(H + (damping + 1e-9) * np.eye(k)).T
        aim = np.linalg.solve(R.T, -self.gram[:k, -1] / size)
        ends = np.array([(f.lower, f.upper) for f in free]).reshape(k, 2)
        box = (ends - self.values[self.where, None]) * (size / scale)[:, None]
        low, high = box.T
        ends = np.minimum(low, -1e-9), np.maximum(high, 1e-9)
        return lsq_linear(R, aim, ends, method="bvls").x / size

    def predicted(self, problem: Problem) -> float:
        """The sum of squares where a linear step would end; inf where it has none."""
        if not np.all(np.isfinite(self.gram)):
            return np.inf
        full = np.append(self.move(problem, 1e-6), 1.0)
        return float(full @ self.gram @ full)

    def moved(self, problem: Problem, damping: float) -> Values:
        """The values after a damped step."""
        move = self.move(problem, damping) * problem.model.scale[self.where]
        names = (problem.model.names[i] for i in self.where)
        at = self.values[self.where] + move
        return placed(problem, self.values, dict(zip(names, at, strict=True)))


Evaluate = Callable[[Values, Sequence[str]], Linear]


def descend(
    problem: Problem, evaluate: Evaluate, at: Linear, free: Sequence[str], steps: int
) -> Linear:
    """Where a few damped steps of a fit inside the ranges lead."""
    damping = 1e-3
    for _ in range(steps):
        there = evaluate(at.moved(problem, damping), free)
        if there.left < at.left:
            settled = there.left > 0.99 * at.left
            at, damping = there, damping / 10
            if settled:
                break
        else:
            damping *= 100
    return at


def balance_at(problem: Problem, values: Values, free: Sequence[str]) -> Linear:
    """The balances at some values, along those of `free` that act on the pressures; the
    problem keeps them.
    """
    free = tuple(problem.side(free, True))
    key = values.tobytes(), free
    if key not in problem.balances:
        problem.balances[key] = _balance_along(problem, values, free)
    return problem.balances[key]


def _balance_along(problem: Problem, values: Values, free: tuple[str, ...]) -> Linear:
    """The balances at some values, along what acts on the pressures."""
    slots = (problem.most_slots(free)[0], 0)
    model, at = problem.model.acting(values, free)
    directions = basis(model, free, slots).hydraulic
    full = jax.tree.map(jnp.asarray, filled(problem.batch, problem.least))
    weight = jnp.asarray(_weight(problem.batch))
    cut, windows = cut_of(model.rig, full.motion, full.windows)
    spool = problem.spool(model, at, np.asarray(directions), full, cut)
    full = full._replace(windows=jax.tree.map(jnp.asarray, windows))

    def part(first: np.int32, end: np.int32) -> np.ndarray:
        handfuls = Span(first, end)
        return np.asarray(_run(model, at, directions, full, spool, weight, handfuls))

    # Two parts on any machine: sums of others are rounded otherwise.
    handfuls = -(-len(problem.batch.P_0) // HANDFUL)
    ends = np.linspace(0, handfuls, min(handfuls, 2) + 1).astype(np.int32)
    gram = np.sum(at_once(part, ends[:-1], ends[1:]), axis=0)
    columns = slot_names(problem.model, free, slots)
    # Its rows are not in units of a noise: what is left says how large that may be.
    rows = 2 * len(weight) * np.sum(np.asarray(problem.batch.weight))
    return Linear.of(problem, values, columns, gram, gram[-1, -1] / rows)


def balanced(problem: Problem, values: Values, free: Sequence[str]) -> Values:
    """The values at which the balances fit best along `free`, or those given if there
    a replay is nearer to the measured pressures.
    """
    few = problem.brief
    evaluate = partial(balance_at, few)
    at = descend(few, evaluate, evaluate(values, free), free, BASE_STEPS)
    noise = np.asarray(problem.batch.noise)
    seen = np.isfinite(noise) & PRESSURES
    costs = [
        np.sum(problem.errors_at(v)[:, seen] / noise[seen] ** 2)
        for v in (values, at.values)
    ]
    return at.values if costs[1] < costs[0] else values


def _weight(batch: Batch) -> Float[np.ndarray, "rows ticks"]:
    """Smooth weights that half overlap, over the ticks of a window."""
    ticks = batch.windows.x_fine.shape[1]
    h = float(np.median(batch.windows.h))
    span = min(max(round(SPAN / h), FEWEST), ticks)
    w = np.sin(np.pi * (np.arange(span) + 0.5) / span) ** 2
    starts = range(0, ticks - span + 1, max(span // 2, 1))
    out = np.zeros((len(starts), ticks))
    for i, s in enumerate(starts):
        out[i, s : s + span] = w
    return out


@program_of_pytrees
def _run(
    model: ParametricRig,
    values: Float[Array, "n"],
    directions: Float[Array, "n_1 k"],
    batch: Batch,
    spool: SpoolPath,
    weight: Float[Array, "rows ticks"],
    handfuls: Span,
) -> Float[Array, "rows_k rows_k"]:
    """Gram matrix of the balances' sums in some handfuls of windows, each over its
    displacement's RMS.
    """
    ends = batch.windows.x_fine[..., :: batch.windows.x_fine.shape[-1] - 1]
    swept = (jnp.diff(ends, axis=-1)[..., 0] @ weight.T) ** 2
    size = jnp.sqrt(jnp.average(jnp.mean(swept, axis=1), weights=batch.weight))
    n, apart = model.hydraulic, set(opening_names(model.rig))
    own = [i for i, name in enumerate(model.names[:n]) if name not in apart]
    names = [model.names[i] for i in own]
    rig = put(model.rig, model.names[:n], values[:n])
    at, moves = values[np.array(own, int)], directions[np.array(own, int)].T

    def some(_, w, weights):
        opened, by = (opened_in(rig, o, w) for o in (spool.now, spool.by))
        opened_by = tuple(jnp.tensordot(spool.along.T, o, axes=1) for o in by)

        def rows(of, opened):
            here = put(rig, names, of)
            return jnp.stack([e @ weight.T for e in imbalance_behind(here, w, opened)])

        def column(move, opened_by):
            return jax.jvp(rows, (at, opened), (move, opened_by))[1]

        columns = jax.vmap(column)(moves, opened_by)
        per = jnp.sqrt(weights)[None, :, None] / size
        stack = jnp.concatenate([columns, rows(at, opened)[None]]) * per
        return jnp.einsum("icwr,jcwr->wij", stack, stack)

    each = in_pieces(
        some, HANDFUL, handfuls, batch.windows, batch.weight, most=len(swept)
    )
    return jnp.sum(each, axis=0)
