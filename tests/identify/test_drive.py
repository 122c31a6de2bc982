"""Derivatives of a substep of the pressures, backward, against forward mode."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hydrojax.effects import EFFECTS
from hydrojax.identify.estimation.drive import _derived
from hydrojax.parameters import get, parameter_specs, put
from hydrojax.plant.chambers import P_VAPOUR
from hydrojax.plant.hydraulics import pressure_step
from hydrojax.plant.places import flow_names
from hydrojax.plant.rig import add
from hydrojax.plant.state import StepInput
from hydrojax.programs.compiled import program_of_pytrees

P_S, P_R = 14e6, 0.25e6
ODD = {
    "between": (6e6, 8e6, 0.3, 0.0, 0.1),
    "shut and still": (6e6, 8e6, 0.0, 0.0, 0.0),
    "at the supply": (P_S, 8e6, 0.5, 0.0, 0.1),
    "at the return": (P_R, 8e6, 0.0, 0.5, -0.1),
    "beyond both": (P_S + 1e6, P_R - 1e5, 0.2, 0.1, 0.1),
    "at no pressure": (0.0, 0.0, 0.2, 0.2, 0.1),
    "a vacuum": (P_VAPOUR, 5e6, 0.2, 0.0, -0.3),
    "drawn empty": (3 * P_VAPOUR, 5e6, 0.0, 0.2, 0.3),
}
"""Pressures (Pa), openings toward either side (V) and speed (m/s)."""


@program_of_pytrees  # in half of the time and memory that JAX's own options take
def both_ways(rig, flow, leaves, tree, theta, opening, inputs):
    """State after a substep and its derivatives: backward, and in forward mode."""

    def after(state, theta, opening, P_s, own):
        P, line = jax.tree.unflatten(tree, state)
        given = own._replace(P_s=jnp.stack(P_s))
        here = put(rig, flow, theta)
        return tuple(jax.tree.leaves(pressure_step(here, P, opening, given, line)))

    at = (leaves, theta, opening, tuple(inputs.P_s.T), inputs)
    axes = (0, None, 0, 0, 0)
    wanted = jax.vmap(jax.jacfwd(after, argnums=(0, 1, 2, 3)), axes)(*at)
    values = jax.vmap(after, axes)(*at)
    return _derived(rig, flow, tree, leaves, theta, opening, inputs), (values, wanted)


@pytest.mark.parametrize(
    "stretched", [pytest.param(False, marks=pytest.mark.slow), True]
)
def test_a_substep_has_the_derivatives_of_forward_mode(rig, stretched):
    """At odd places too, where a branch that is not taken is not finite; with every
    effect dormant, and awake.
    """
    rig = add(rig, [effect() for effect in EFFECTS.values()])
    for strength in (0.0, 0.5):
        derivatives_agree(rig, strength, stretched)


def derivatives_agree(rig, strength, stretched):
    """With each strength at such a share of its scale."""
    spec = parameter_specs(rig)
    names = [n for n, s in spec.items() if s.strength]
    rig = put(rig, names, [strength * spec[n].scale for n in names])
    flow, rows = flow_names(rig), np.array(list(ODD.values())).T
    P_1, P_2, up, down, v = map(jnp.asarray, rows)
    count, h = len(ODD), 2.5e-3
    line = rig.line_init(P_1, P_2)
    leaves, tree = jax.tree.flatten(((P_1, P_2), line))
    same = jnp.ones(count)
    opening = (up, down, 0.9 * down, 1.1 * up)
    inputs = StepInput(
        h=h * same,
        u=same,
        P_s=P_S * jnp.ones((count, 2)),
        P_r=P_R * jnp.ones((count, 2)),
        x=0.02 + v[:, None] * h * jnp.array([0.0, 0.5, 1.0]),
        dx=None,
        v=v,
        a=0 * v,
        t=7.0 * same,
        F=300.0 * jnp.ones((count, 2)) if stretched else None,
    )
    theta = tuple(get(rig, flow))
    given = (tuple(leaves), tree, theta, opening, inputs)
    (out, found), (values, wanted) = both_ways(rig, flow, *given)
    np.testing.assert_allclose(np.array(out), np.array(values), rtol=1e-12)
    for k, forward in enumerate(wanted):
        pairs = zip(jax.tree.leaves(found), jax.tree.leaves(forward), strict=True)
        for backward, own in pairs:
            own = np.asarray(own)
            rounding = 1e-12 * np.abs(own).max()  # beside the largest of all places
            np.testing.assert_allclose(
                np.asarray(backward)[k], own, 1e-9, rounding, equal_nan=False
            )
