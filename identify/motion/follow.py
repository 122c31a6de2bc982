"""A load that moves by itself: its position through a log, and the fit of that."""

from __future__ import annotations

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from hydrojax.identify.estimation.columns import ParametricRig
from hydrojax.identify.estimation.solve import Fit, minimise
from hydrojax.identify.motion.course import Course
from hydrojax.parameters import put
from hydrojax.plant import step as plant_step
from hydrojax.plant.load import Inertia, PistonMotion
from hydrojax.plant.rig import Rig
from hydrojax.plant.state import State


def follow(
    rig: Rig, load: Inertia, course: Course, fresh: Bool[Array, "runs n"]
) -> Float[Array, "runs n 3"]:
    """Position (m) and both pressures (Pa) as the model has them, at every tick.

    At a tick that is `fresh` the run goes on from what was measured there: motion, and
    pressures where there are any. Friction, spool and lines go on as they stood.
    """

    def one(course: Course, fresh: Bool[Array, "n"]) -> Float[Array, "n 3"]:
        first = jax.tree.map(lambda a: a[0], course.inputs)
        middle = (first.P_s[0] + first.P_r[0]) / 2
        P = jnp.where(jnp.isnan(course.measured[0, 1:]), middle, course.measured[0, 1:])
        state, _ = plant_step.start(rig, first, (P[0], P[1]), load)
        rows = (course.measured, course.v, course.a, fresh)
        state = _begun(state, *(row[0] for row in rows[:3]))

        def tick(state, row):
            inputs, (measured, v, a, again) = row
            state, _ = plant_step.step(rig, state, inputs, load)
            seen = jnp.stack([state.motion.x, *state.P])
            anew = _begun(state, measured, v, a)
            state = jax.tree.map(lambda n, s: jnp.where(again, n, s), anew, state)
            return state, seen

        later = jax.tree.map(lambda row: row[1:], rows)
        seen = jax.lax.scan(tick, state, (course.inputs, later))[1]
        return jnp.concatenate([course.measured[:1], seen])

    return jax.vmap(one)(course, fresh)


def _begun(
    state: State,
    measured: Float[Array, "3"],
    v: Float[Array, ""],
    a: Float[Array, ""],
) -> State:
    """The state with motion, and pressures, as they were measured."""
    P = [
        jnp.where(jnp.isnan(m), p, m)
        for m, p in zip(measured[1:], state.P, strict=True)
    ]
    motion = PistonMotion(measured[0], v, a)
    return state._replace(motion=motion, P=(P[0], P[1]))


@eqx.filter_jit
def run_follow(
    model: ParametricRig,
    values: Float[Array, "n"],
    load: Inertia,
    course: Course,
    fresh: Bool[Array, "lengths runs n"],
) -> Float[Array, "lengths runs n 3"]:
    """`follow` for runs of several lengths, compiled."""
    rig = put(model.rig, model.names, values)
    return jax.vmap(lambda f: follow(rig, load, course, f))(fresh)


@eqx.filter_jit
def fit_follow(
    model: ParametricRig,
    values: Float[Array, "n"],
    directions: Float[Array, "k n"],
    load: Inertia,
    course: Course,
    fresh: Bool[Array, "runs n"],
    size: Float[Array, "3"],
    box: tuple[Float[Array, "k"], Float[Array, "k"]],
) -> Fit:
    """The best fit from `values` along `directions`, in their units; compiled.

    `size` [3] are what errors are counted in, SI; inf for what is not compared.
    """
    gram = partial(_gram, model, values, directions, load, course, fresh, size)
    return minimise(gram, jnp.zeros(len(directions)), *box)


def _gram(model, values, directions, load, course, fresh, size, at):
    """The Gram matrix of Jacobian and errors, both over `size`."""

    def errors(at: Float[Array, "k"]) -> Float[Array, "m"]:
        rig = put(model.rig, model.names, values + at @ directions)
        off = (follow(rig, load, course, fresh) - course.measured) / size
        compared = (course.there > 0)[..., None] & jnp.isfinite(course.measured / size)
        return jnp.where(compared, off, 0.0).ravel()

    def along(direction: Float[Array, "k"]) -> tuple:
        return jax.jvp(errors, (at,), (direction,))

    # Not `linearize`: it would keep every tick's operations in memory.
    off, columns = jax.vmap(along, out_axes=(None, 0))(jnp.eye(at.size))
    whole = jnp.concatenate([columns, off[None]])
    return whole @ whole.T, ()
