"""The step that the loop, exports and a user share: what gives cannot be forgotten."""

from dataclasses import replace
from importlib import resources

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hydrojax.control.base import AbstractController
from hydrojax.control.loop import run
from hydrojax.control.simulation import hold, make_scenario
from hydrojax.effects import EFFECTS
from hydrojax.export.machines import plant_machine
from hydrojax.export.model import driven_rig
from hydrojax.parameters import param, put
from hydrojax.plant.load import Driven
from hydrojax.plant.rig import Rig, add
from hydrojax.plant.state import StepInput
from hydrojax.plant.step import start, step
from hydrojax.rigfile.schema import RigFile
from tests.control.test_loop import make_bench_loop

U, X, TICKS, H = 0.3, 2e-3, 80, 1e-3
P_S, P_R = 14e6, 0.25e6
P_START = ((P_S + P_R) / 2,) * 2


@pytest.fixture(scope="module")
def soft(rig) -> Rig:
    """The reference rig with a rod of 5 kN/mm: 1/k = 2e-7 m/N."""
    return put(add(rig, [EFFECTS["rod_compliance"]()]), ["rod_compliance.give"], [2e-7])


def locked() -> StepInput:
    """One tick with the piston held at `X` under the command `U`."""
    ends = jnp.ones(2)
    return StepInput(
        h=jnp.asarray(H), u=jnp.asarray(U), P_s=P_S * ends, P_r=P_R * ends,
        x=jnp.full(9, X), dx=jnp.zeros(4), v=jnp.asarray(0.0), a=jnp.asarray(0.0),
        t=jnp.asarray(H),
    )  # fmt: skip


def by_library(rig: Rig) -> float:
    inputs, P = locked(), tuple(map(jnp.asarray, P_START))
    # As it stands at rest under no command.
    state, _ = start(rig, inputs._replace(u=0 * inputs.u), P)
    one = jax.jit(lambda s, _: step(rig, s, inputs))
    _, read = jax.lax.scan(one, state, None, length=TICKS)
    return float(read["F"][-1])


class Held(AbstractController):
    """A command that is constant."""

    u_max: jax.Array = param("{u}", U, 0.0, 10.0, "the command")

    def init(self, measured, F_d):
        return ()

    def step(self, memory, measured, F_d, h):
        return memory, self.u_max, {}


def by_loop(rig: Rig) -> float:
    loop = make_bench_loop(Driven(), effects=False)
    loop = eqx.tree_at(lambda lo: (lo.rig, lo.law), loop, (rig, Held()))
    scenario = make_scenario(np.zeros(TICKS + 1), hold(X), H, P_S, P_R)
    return float(eqx.filter_jit(run)(loop, scenario, ("true_F",))[-1, 0])


def by_export(rig: Rig, spec: RigFile) -> float:
    """What the FMU and the C of the plant are written of."""
    machine = plant_machine(replace(driven_rig(spec), rig=rig, period=H))
    given = {"u": U, "x": X, "P_s": P_S, "P_r": P_R, "P_a1": P_START[0]}
    given |= {"P_a2": P_START[1]}
    at = {name: jnp.asarray(given.get(name, 0.0)) for name in machine.inputs}
    p = {name: jnp.asarray(value) for name, value in machine.parameters.items()}
    state, _ = machine.start(p, at | {"u": jnp.asarray(0.0)})
    one = jax.jit(lambda s, _: machine.step(p, s, at))
    _, read = jax.lax.scan(one, state, None, length=TICKS)
    return float(read["F"][-1])


def test_a_rod_that_gives_is_in_every_step(rig, soft):
    """Held for 80 ms the oil pushes: a soft rod takes most of the force."""
    library, loop = by_library(soft), by_loop(soft)
    with resources.as_file(resources.files("hydrojax") / "paper/reference.toml") as at:
        exported = by_export(soft, RigFile.load(at))
    assert library == pytest.approx(exported, rel=1e-12)
    # The loop takes a tick in four parts: the same to the error of the integration.
    assert library == pytest.approx(loop, rel=1e-3)
    assert abs(library) < 0.5 * abs(by_library(rig))


def test_the_loop_s_plant_is_the_library_s_step(soft):
    """To rounding, with the load and the inputs that the loop gives it."""
    parts = 4
    still = jnp.zeros(parts)
    inputs = locked()._replace(x=jnp.full((parts, 3), X), dx=None, v=still, a=still)
    load, P = Driven(), tuple(map(jnp.asarray, P_START))
    state, _ = start(soft, inputs._replace(u=0 * inputs.u), P, load)
    one = jax.jit(lambda s, _: step(soft, s, inputs, load))
    _, read = jax.lax.scan(one, state, None, length=TICKS)
    assert float(read["true_F"][-1]) == pytest.approx(by_loop(soft), rel=1e-12)
