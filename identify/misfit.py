"""The misfit: windows' residuals and sensitivities, summed to small Gram matrices.

Everything that is asked later (a Gauss-Newton step, a covariance, a score, what two
effects have in common) needs only sums of products of the columns. So each window is
reduced to the Gram matrix of [sensitivities, residual], with the window's two initial
pressures eliminated, and the large Jacobian is never stored beyond that.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from ..named import get, hydraulic_names, parameter_specs, put, scales
from ..params import specs
from ..replay import Motion, Past, Windows, friction_memory, pressures, readings
from ..rig import Rig

START_SPREAD = 3e5
"""Prior on a window's initial pressure about its first guess, Pa: wide, it only keeps
a chamber that no channel sees in place."""


PIECE = 256
"""Windows that are worked on side by side."""

SUPPLY_BLOCKS = 3
"""Pieces of a window in each of which the supply's measurement error is a constant."""

NUISANCE = 2 + SUPPLY_BLOCKS
"""What each window has of its own: two initial pressures, and the supply's errors."""


class Model(NamedTuple):
    """A rig and the order of its parameters: hydraulic ones first.

    `scale` and `value0` are what a coordinate of the optimiser means: value =
    scale * coordinate.
    """

    rig: Rig
    names: tuple[str, ...]
    hydraulic: int
    scale: np.ndarray

    @classmethod
    def of(cls, rig: Rig) -> Model:
        """The model of a rig, with every parameter it has."""
        spec = parameter_specs(rig)
        first = hydraulic_names(rig)
        names = tuple(sorted(spec, key=lambda n: n not in first))
        return cls(rig, names, len(first), scales(spec[n] for n in names))

    @property
    def values(self) -> Array:
        """The rig's own values, [n], SI."""
        return get(self.rig, self.names)


class Batch(NamedTuple):
    """What a fit runs on, as arrays; `noise` [3], `weight` [W] (0 for padding).

    `supply_noise` is the standard deviation of the measured P_s, Pa (0 where the log
    has none): white noise there integrates to a drift of the pressures, which would
    otherwise be taken for a fault of the model.
    """

    motion: Motion
    windows: Windows
    P_0: Array
    noise: Array
    supply_noise: Array
    weight: Array


_OWN_PRIOR = np.diag([1 / START_SPREAD**2] * 2 + [1.0] * SUPPLY_BLOCKS)


class Sums(NamedTuple):
    """Per window: `gram` [W, k+1, k+1] of [sensitivities, residual], whitened, what
    the window has of its own eliminated; `start` [W, NUISANCE, k+1] its solution (of
    the residual, with the sign turned); `sse` [W, 3] squared residuals, SI.
    """

    gram: Array
    start: Array
    sse: Array


class Basis(NamedTuple):
    """Directions in parameter space: [n_hydraulic, k_1] and [n_other, k_2], SI."""

    hydraulic: Array
    other: Array


def basis(model: Model, names: tuple[str, ...], slots: tuple[int, int]) -> Basis:
    """One direction per named parameter, one unit of its scale; spare slots are 0.

    Raises:
        ValueError: more names than slots.
    """
    out = [
        np.zeros((model.hydraulic, slots[0])),
        np.zeros((len(model.names) - model.hydraulic, slots[1])),
    ]
    used = [0, 0]
    for name in names:
        i = model.names.index(name)
        side = int(i >= model.hydraulic)
        if used[side] == slots[side]:
            raise ValueError(f"no slot left for {name}")
        out[side][i - side * model.hydraulic, used[side]] = model.scale[i]
        used[side] += 1
    return Basis(*(jnp.asarray(a) for a in out))


def slot_names(
    model: Model, names: tuple[str, ...], slots: tuple[int, int]
) -> list[str | None]:
    """Which parameter stands in each column of `basis`, None for a spare one."""
    first = [n for n in names if model.names.index(n) < model.hydraulic]
    rest = [n for n in names if n not in first]
    spare = [[None] * (slots[0] - len(first)), [None] * (slots[1] - len(rest))]
    return [*first, *spare[0], *rest, *spare[1]]


def predict(rig: Rig, batch: Batch, simulate: bool) -> Array:
    """What the sensors would read, [W, T, 3], from the batch's initial pressures."""
    w = batch.windows
    P = pressures(rig, w, batch.P_0) if simulate else (w.P_a1, w.P_a2)
    return readings(rig, w, *P, friction_memory(rig, batch.motion).within(w))


def memory_names(rig: Rig) -> tuple[str, ...]:
    """The parameters on which bristle, filtered speed and films depend."""
    moved = (
        f"{effect.name}.{field}"
        for effect in (*rig.stretch, *rig.velocity)
        for field in specs(effect)
    )
    return ("z_ss", "L_rate", *moved)


class Recalled(NamedTuple):
    """What friction sees of the motion over the whole log, and its derivatives by each
    parameter of `memory_names`, on a first axis.
    """

    past: Past
    by: Past


def recall(model: Model, values: Array, motion: Motion) -> Recalled:
    """What friction remembers of the motion: once for all windows."""
    here = put(model.rig, model.names, values)
    names = memory_names(here)

    def memory(of):
        return friction_memory(put(here, names, of), motion)

    at = get(here, names)
    along = jax.vmap(lambda row: jax.jvp(memory, (at,), (row,)), out_axes=(None, 0))
    return Recalled(*along(jnp.eye(len(names))))


def _in_pieces(part: Callable[[Batch], PyTree], batch: Batch) -> PyTree:
    """`part` of a batch, in pieces of `PIECE` windows one after the other if it is
    long: memory then does not grow with the length of the logs.
    """
    count = batch.P_0.shape[0]
    if count <= PIECE:
        return part(batch)
    pieces = -(-count // PIECE)

    def cut(a):
        # The last piece is filled with copies of the last window.
        index = np.minimum(np.arange(pieces * PIECE), count - 1)
        return a[index].reshape(pieces, PIECE, *a.shape[1:])

    own = jax.tree.map(cut, (batch.windows, batch.P_0, batch.weight))

    def one(piece):
        windows, P_0, weight = piece
        return part(batch._replace(windows=windows, P_0=P_0, weight=weight))

    out = jax.lax.map(one, own)
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:])[:count], out)


def sensitivities(
    model: Model,
    values: Array,
    directions: Basis,
    batch: Batch,
    simulate: bool,
    recalled: Recalled | None = None,
) -> tuple[Array, Array]:
    """Predictions [W, T, 3] and their derivatives [k + NUISANCE, W, T, 3].

    The columns are those of `directions`, then the two initial pressures (per Pa) and
    the supply's error in each block (per standard deviation of its mean).
    Forward mode, in the three stages of the replay, so that friction's columns never
    pay for the integration of the pressures.
    """
    rig, names, n = model.rig, model.names, model.hydraulic
    w = batch.windows
    k_1, k_2 = directions.hydraulic.shape[1], directions.other.shape[1]

    ticks = w.P_s.shape[1]
    block = jnp.arange(ticks) * SUPPLY_BLOCKS // ticks
    of_mean = batch.supply_noise / np.sqrt(ticks / SUPPLY_BLOCKS)

    def run(d, P_shift, supply):
        at = put(rig, names[:n], values[:n] + directions.hydraulic @ d)
        moved = w._replace(P_s=w.P_s + of_mean * supply[block])
        return pressures(at, moved, batch.P_0 + P_shift)

    here = put(rig, names, values)
    recalled = recalled or recall(model, values, batch.motion)
    past = recalled.past.within(w)
    if simulate:
        zero = (jnp.zeros(k_1), jnp.zeros(2), jnp.zeros(SUPPLY_BLOCKS))
        P, d_P = jax.vmap(
            lambda e: jax.jvp(run, zero, (e[:k_1], e[k_1 : k_1 + 2], e[k_1 + 2 :])),
            out_axes=(None, 0),
        )(jnp.eye(k_1 + NUISANCE))
        zeros = jnp.zeros((k_2, *P[0].shape))
        d_P = [jnp.concatenate([d[:k_1], zeros, d[k_1:]]) for d in d_P]
    else:
        P = (w.P_a1, w.P_a2)
        d_P = [jnp.zeros((k_1 + k_2 + NUISANCE, *P[0].shape))] * 2

    def force(d, P_a1, P_a2):
        at = put(here, names[n:], values[n:] + directions.other @ d)
        return readings(at, w, P_a1, P_a2, past)

    columns = jnp.concatenate(
        [jnp.zeros((k_1, k_2)), jnp.eye(k_2), jnp.zeros((NUISANCE, k_2))]
    )

    def column(e, dp_1, dp_2):
        return jax.jvp(force, (jnp.zeros(k_2), *P), (e, dp_1, dp_2))

    y, dy = jax.vmap(column, out_axes=(None, 0))(columns, *d_P)
    return y, dy + _through_memory(model, here, directions, w, P, recalled)


def _through_memory(
    model: Model,
    here: Rig,
    directions: Basis,
    w: Windows,
    P: tuple[Array, Array],
    recalled: Recalled,
) -> Array:
    """What the columns are through what friction remembers, [k + NUISANCE, W, T, 3]."""
    past = recalled.past.within(w)

    def one(by):
        along = (by.within(w),)
        return jax.jvp(lambda p: readings(here, w, *P, p), (past,), along)[1]

    k_1, k_2 = directions.hydraulic.shape[1], directions.other.shape[1]
    every = jnp.zeros((len(model.names), k_1 + k_2 + NUISANCE))
    every = every.at[: model.hydraulic, :k_1].set(directions.hydraulic)
    every = every.at[model.hydraulic :, k_1 : k_1 + k_2].set(directions.other)
    rows = np.array([model.names.index(m) for m in memory_names(here)])
    return jnp.tensordot(every[rows].T, jax.vmap(one)(recalled.by), axes=1)


def sums(
    model: Model, values: Array, directions: Basis, batch: Batch, simulate: bool
) -> Sums:
    """The windows' Gram matrices at `values` along `directions`; see `Sums`."""
    recalled = recall(model, values, batch.motion)

    def part(piece):
        y, dy = sensitivities(model, values, directions, piece, simulate, recalled)
        return _sums(piece, y, dy)

    return _in_pieces(part, batch)


def _sums(batch: Batch, y: Array, dy: Array) -> Sums:
    """Reduce predictions and their derivatives to each window's sums."""
    seen = jnp.isfinite(batch.noise)
    white = jnp.where(seen, 1 / jnp.where(seen, batch.noise, 1.0), 0.0)
    residual = jnp.where(seen, batch.windows.measured - y, 0.0)
    k = dy.shape[0] - NUISANCE
    stack = jnp.concatenate([-dy, residual[None]]) * white  # [k+NUISANCE+1, W, T, 3]
    stack = jnp.moveaxis(stack, 1, 0).reshape(*residual.shape[:1], len(stack), -1)
    full = jnp.einsum("wit,wjt->wij", stack, stack)
    keep = np.r_[0:k, k + NUISANCE]
    own = slice(k, k + NUISANCE)
    cross = full[:, own, keep]
    start = jnp.linalg.solve(full[:, own, own] + _OWN_PRIOR, cross)
    gram = full[:, keep[:, None], keep] - jnp.einsum("wia,wib->wab", cross, start)
    left = _leftover(residual, dy[k:], white, start[:, :, -1])
    weight = batch.weight
    return Sums(
        gram * weight[:, None, None],
        start,
        jnp.sum(left**2, axis=1) * weight[:, None],
    )


def _leftover(residual: Array, dy: Array, white: Array, start: Array) -> Array:
    """Residuals without what each window has of its own, [W, T, 3], SI.

    The force is judged with the initial state that all channels together give; the
    pressures with those that they give themselves, so that a force which the model
    cannot follow is not held against them.
    """
    seen = dy * white * jnp.array([1.0, 1.0, 0.0])
    B = jnp.einsum("iwtc,jwtc->wij", seen, seen) + _OWN_PRIOR
    cross = jnp.einsum("iwtc,wtc->wi", seen, residual * white)
    by_themselves = jnp.linalg.solve(B, -cross[..., None])[..., 0]
    own = residual + jnp.einsum("iwtc,wi->wtc", dy, by_themselves)
    left = residual + jnp.einsum("iwtc,wi->wtc", dy, start)
    return jnp.concatenate([own[..., :2], left[..., 2:]], axis=-1)


def leftover(
    model: Model, values: Array, batch: Batch, simulate: bool
) -> tuple[Array, Array]:
    """Measured minus replayed, [W, T, 3], SI, and the initial pressures' error [W, 2].

    Each window's own initial pressures are estimated from it.
    """
    n = len(model.names)
    none = Basis(jnp.zeros((model.hydraulic, 0)), jnp.zeros((n - model.hydraulic, 0)))
    recalled = recall(model, values, batch.motion)

    def part(piece):
        y, dy = sensitivities(model, values, none, piece, simulate, recalled)
        return _leftover_of(piece, y, dy)

    return _in_pieces(part, batch)


def _leftover_of(batch: Batch, y: Array, dy: Array) -> tuple[Array, Array]:
    seen = jnp.isfinite(batch.noise)
    white = jnp.where(seen, 1 / jnp.where(seen, batch.noise, 1.0), 0.0)
    residual = jnp.where(seen, batch.windows.measured - y, 0.0)
    scaled = dy * white
    B = jnp.einsum("iwtc,jwtc->wij", scaled, scaled) + _OWN_PRIOR
    cross = jnp.einsum("iwtc,wtc->wi", scaled, -residual * white)
    start = jnp.linalg.solve(B, cross[..., None])[..., 0]
    return _leftover(residual, dy, white, start), start[:, :2]
