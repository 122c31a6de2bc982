"""What gives between piston and encoder, under the force that the model puts out.

A fit lets a rod or a play follow the measured force. Its noise then moves the piston,
and comes back from oil and bristle larger than it was, the more so the softer the rod
is against them. How well a model does is therefore judged with the force that it puts
out itself, which takes a few rounds to agree with what it stretches.
"""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hydrojax.identify.estimation.columns import Batch, ParametricRig
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.parameters import put
from hydrojax.plant import stretch
from hydrojax.plant.chambers import Point
from hydrojax.plant.rig import Rig
from hydrojax.programs.compiled import program_of_pytrees

HALVINGS = 40
"""Of the bracket that holds a tick's force."""


def stretched(model: ParametricRig, values: Float[np.ndarray, "n"]) -> Rig | None:
    """The rig at `values` if anything gives in it."""
    if not model.rig.stretch:
        return None
    rig = put(model.rig, model.names, jnp.asarray(values))
    probe = jnp.array([-1e3, 1e3])
    return rig if np.any(np.asarray(stretch.ahead(rig.stretch, probe))) else None


def agreed(
    rig: Rig,
    batch: Batch,
    left: Float[np.ndarray, "windows ticks 3"],
    replayed: Callable[[Batch], Float[np.ndarray, "windows ticks 3"]],
    criteria: Criteria,
) -> Float[np.ndarray, "windows ticks 3"]:
    """Measured less replayed, SI, once force and stretch agree.

    `left` is that under the batch's own force, `replayed` gives it under another one.
    """
    noise = float(np.asarray(batch.noise)[2])
    off, rounds = np.inf, 0
    most, near = criteria.force_rounds, criteria.force_agrees * noise
    while np.isfinite(noise) and off > near and rounds < most:
        batch, off = _followed(rig, batch, left)
        left, rounds = replayed(batch), rounds + 1
    return left


def _followed(rig: Rig, batch: Batch, left: np.ndarray) -> tuple[Batch, float]:
    """The batch with its stretching force brought nearer to the one that came of it.

    `left` [W, T, 3] is measured less replayed. Returns by how much force and stretch
    differed, RMS in N. Each tick is solved by itself, by halving: its force answers the
    stretch by the stiffness of oil and bristle, and hardly depends on other ticks.
    """
    w, lead = batch.windows, batch.windows.x.shape[1] - batch.windows.scored
    F = np.array(batch.motion.F)
    ticks = np.asarray(w.first)[:, None] + np.arange(w.x.shape[1])
    seg = np.asarray(w.seg)[:, None]
    at = seg, ticks[:, lead:]
    here, came = F[at], np.asarray(w.measured)[..., 2] - left[..., 2]
    K, s_here = float(answer(rig, batch)[2]), _ahead(rig, here)
    low, high = np.minimum(here, came), np.maximum(here, came)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        above = middle + K * (_ahead(rig, middle) - s_here) > came
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    F[at] = (low + high) / 2
    windows = w._replace(F=F[seg, ticks])
    batch = batch._replace(motion=batch.motion._replace(F=F), windows=windows)
    return batch, float(np.sqrt(np.mean((came - here) ** 2)))


def _ahead(rig: Rig, F: np.ndarray) -> np.ndarray:
    return np.asarray(stretch.ahead(rig.stretch, jnp.asarray(F)))


def answer(rig: Rig, batch: Batch) -> Float[np.ndarray, "3"]:
    """Pressures (Pa) and force (N) by which oil and bristle answer a metre of the
    piston, at most.
    """
    w = batch.windows
    x = np.array([np.min(w.x), np.max(w.x)])
    return np.asarray(_answer(rig, x, np.median(w.P_a1), np.median(w.P_a2)))


@program_of_pytrees
def _answer(
    rig: Rig, x: Float[Array, "2"], P_a1: Float[Array, ""], P_a2: Float[Array, ""]
) -> Float[Array, "3"]:
    P, none = (jnp.full(2, P_a1), jnp.full(2, P_a2)), jnp.zeros(2)
    at = Point(*P, P[0], none, (none,), x, v=none + 1.0)
    moved = rig.chambers.rates(at, none, none, rig.compliance, rig.volume)
    oil = jnp.stack([*moved, rig.drive_force(*moved)])
    friction = rig.mechanics
    level = jnp.maximum(friction.k_cp, friction.k_cn)
    bristle = jnp.array([0.0, 0.0, level / friction.z_ss])
    return jnp.max(jnp.abs(oil), axis=1) + bristle
