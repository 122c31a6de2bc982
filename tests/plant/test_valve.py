"""A valve of a user's own in the place of the paper's four metering edges."""

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

from hydrojax.parameters import get, param, parameter_specs, put
from hydrojax.plant.chambers import Point
from hydrojax.plant.places import hydraulic_names
from hydrojax.plant.state import StepInput
from hydrojax.plant.step import start, step
from hydrojax.plant.valve import AbstractValve, metering_edges, root_flow, sides


class Symmetric(AbstractValve):
    """Four equal edges: one constant."""

    c: jax.Array = param("m^3/(s*{u}*Pa^0.5)", 2.2e-9, 1e-10, 1e-6, "every edge")

    def flows(self, at, drops=(), orifices=()):
        open_p, open_n = sides(*at.opening) if len(at.opening) == 1 else at.opening
        q_1 = open_p * root_flow(at.P_s - at.P_a1) - open_n * root_flow(
            at.P_a1 - at.P_r
        )
        q_2 = open_n * root_flow(at.P_s - at.P_a2) - open_p * root_flow(
            at.P_a2 - at.P_r
        )
        return self.c * q_1, self.c * q_2


def with_valve(rig, valve):
    return eqx.tree_at(lambda r: r.valve, rig, valve)


def test_its_parameters_are_the_rig_s(rig):
    own = with_valve(rig, Symmetric())
    names = list(parameter_specs(own))
    assert names[0] == "c" and not {"c_p1", "c_n2"} & set(names)
    assert "c" in hydraulic_names(own)
    assert float(get(put(own, ["c"], [3e-9]), ["c"])[0]) == 3e-9


def test_it_flows_as_equal_edges_do(rig):
    edges = put(rig, ["c_p1", "c_n1", "c_p2", "c_n2"], [2.2e-9] * 4)
    at = Point(5e6, 6e6, 14e6, 0.25e6, (jnp.asarray(-0.4),), 0.0, 0.0)
    at = jax.tree.map(jnp.asarray, at)
    for q, want in zip(Symmetric().flows(at), edges.valve.flows(at), strict=True):
        assert q == pytest.approx(float(want), rel=1e-12)


def test_the_step_takes_it(rig):
    ends = jnp.ones(2)
    inputs = StepInput(
        h=jnp.asarray(1e-3), u=jnp.asarray(0.3), P_s=14e6 * ends, P_r=2.5e5 * ends,
        x=jnp.zeros(3), dx=jnp.zeros(1), v=jnp.asarray(0.0), a=jnp.asarray(0.0),
        t=jnp.asarray(1e-3),
    )  # fmt: skip
    P = (jnp.asarray(6e6), jnp.asarray(7e6))

    @jax.jit
    def force(rig):
        state, _ = start(rig, inputs, P)
        return step(rig, state, inputs)[1]["F"]

    edges = put(rig, ["c_p1", "c_n1", "c_p2", "c_n2"], [2.2e-9] * 4)
    own = float(force(with_valve(rig, Symmetric())))
    assert own == pytest.approx(float(force(edges)), rel=1e-12)


def test_the_law_says_which_valve_it_inverts(rig):
    assert metering_edges(rig.valve) is rig.valve
    with pytest.raises(TypeError, match="Symmetric: expected MeteringEdges"):
        metering_edges(Symmetric())
