"""A load that moves by itself: its position through a log, and the fit of that."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hydrojax.identify.estimation.solve import Fit, minimise
from hydrojax.identify.motion.course import Course
from hydrojax.parameters import get, parameter_specs, put, scales
from hydrojax.plant import step as plant_step
from hydrojax.plant.load import Inertia
from hydrojax.plant.rig import Rig
from hydrojax.plant.scan import in_one_kernel
from hydrojax.plant.state import State


class MovingRig(eqx.Module):
    """A rig and the load that it moves; the load's parameters are `load.mass`, ..."""

    rig: Rig
    load: Inertia


class ParametricMover(NamedTuple):
    """A rig with its load, and the order of its parameters.

    Attributes:
        tree: the rig and its load.
        names: of its n parameters.
        scale: unit of the optimiser's coordinate of each parameter, SI.
    """

    tree: MovingRig
    names: tuple[str, ...]
    scale: Float[np.ndarray, "n"]

    @classmethod
    def of(cls, rig: Rig, load: Inertia) -> ParametricMover:
        """With every parameter of both."""
        tree = MovingRig(rig, load)
        spec = parameter_specs(tree)
        return cls(tree, tuple(spec), scales(spec.values()))

    @property
    def values(self) -> Float[Array, "n"]:
        """Its own values, SI."""
        return get(self.tree, self.names)

    def at(self, values: Float[Array, "n"]) -> MovingRig:
        """The rig and its load with the parameters `values`, SI."""
        return put(self.tree, self.names, values)


def follow(
    moving: MovingRig, course: Course, fresh: Bool[Array, "runs n"]
) -> Float[Array, "runs n 4"]:
    """Position (m), both pressures (Pa) and the force (N) at every tick, as the model
    has them.

    At a tick that is `fresh` the run goes on from what was measured there: motion, and
    pressures where there are any. Friction, spool, lines and what the load carries go
    on as they stood.
    """
    rig, load = moving.rig, moving.load

    def one(course: Course, fresh: Bool[Array, "n"]) -> Float[Array, "n 4"]:
        first = jax.tree.map(lambda a: a[0], course.inputs)
        middle = (first.P_s[0] + first.P_r[0]) / 2
        P = course.measured[0, 1:3]
        P = jnp.where(jnp.isnan(P), middle, P)
        state, _ = plant_step.start(rig, first, (P[0], P[1]), load)
        rows = (course.measured, course.v, course.a, fresh)
        state = _begun(state, *(row[0] for row in rows[:3]))

        def tick(state, row):
            inputs, (measured, v, a, again) = row
            state, signals = plant_step.step(rig, state, inputs, load)
            seen = jnp.stack([state.motion.x, *state.P, signals["F"]])
            anew = _begun(state, measured, v, a)
            state = jax.tree.map(lambda n, s: jnp.where(again, n, s), anew, state)
            return state, seen

        later = jax.tree.map(lambda row: row[1:], rows)
        seen = jax.lax.scan(in_one_kernel(tick), state, (course.inputs, later))[1]
        return jnp.concatenate([course.measured[:1], seen])

    return jax.vmap(one)(course, fresh)


def _begun(
    state: State,
    measured: Float[Array, "4"],
    v: Float[Array, ""],
    a: Float[Array, ""],
) -> State:
    """The state with motion, and pressures, as they were measured."""
    P = [
        jnp.where(jnp.isnan(m), p, m)
        for m, p in zip(measured[1:3], state.P, strict=True)
    ]
    motion = state.motion._replace(x=measured[0], v=v, a=a)
    return state._replace(motion=motion, P=(P[0], P[1]))


@eqx.filter_jit
def run_follow(
    mover: ParametricMover,
    values: Float[Array, "n"],
    course: Course,
    fresh: Bool[Array, "lengths runs n"],
) -> Float[Array, "lengths runs n 4"]:
    """`follow` for runs of several lengths, compiled."""
    moving = mover.at(values)
    return jax.vmap(lambda f: follow(moving, course, f))(fresh)


@eqx.filter_jit
def fit_follow(
    mover: ParametricMover,
    values: Float[Array, "n"],
    directions: Float[Array, "k n"],
    course: Course,
    fresh: Bool[Array, "runs n"],
    size: Float[Array, "4"],
    prior: tuple[Float[Array, "k"], Float[Array, "k"]],
    box: tuple[Float[Array, "k"], Float[Array, "k"]],
) -> Fit:
    """The best fit from `values` along `directions`, in their units; compiled.

    `size` [4] are what errors are counted in, SI; inf for what is not compared.
    `prior` [k] are the values known beforehand, in units of the directions, and what an
    error of one such unit counts.
    """
    gram = partial(_gram, mover, values, directions, course, fresh, size, prior)
    return minimise(gram, jnp.zeros(len(directions)), *box)


def _gram(mover, values, directions, course, fresh, size, prior, at):
    """The Gram matrix of Jacobian and errors, both over `size`."""

    def errors(at: Float[Array, "k"]) -> Float[Array, "m"]:
        moving = mover.at(values + at @ directions)
        off = (follow(moving, course, fresh) - course.measured) / size
        compared = (course.there > 0)[..., None] & jnp.isfinite(course.measured / size)
        known, weight = prior
        return jnp.append(jnp.where(compared, off, 0.0), weight * (at - known))

    def along(direction: Float[Array, "k"]) -> tuple:
        return jax.jvp(errors, (at,), (direction,))

    # Not `linearize`: it would keep every tick's operations in memory.
    off, columns = jax.vmap(along, out_axes=(None, 0))(jnp.eye(at.size))
    whole = jnp.concatenate([columns, off[None]])
    return whole @ whole.T, ()
