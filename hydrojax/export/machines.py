"""The plant, and a controller, as machines that C is written of."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hydrojax.control.base import Measured
from hydrojax.export.codegen.machine import Machine, Numbers, numbers_of
from hydrojax.export.model import INPUTS, OUTPUTS, DrivenRig
from hydrojax.export.stepping import Drive, inputs_from
from hydrojax.plant.rig import Rig
from hydrojax.plant.step import start, step
from hydrojax.rigfile.build import build_loop
from hydrojax.rigfile.schema import RigFile

ALONG = "d_"
"""What opens the name of a quantity's change."""

PERIOD = "h"
"""What the length of a tick is called among the parameters."""

READINGS = {
    "P_a1": "Pa, chamber 1",
    "P_a2": "Pa, chamber 2",
    "P_s": "Pa, supply",
    "F": "N, output force",
    "x": "m, piston position, 0 at mid-stroke",
    "F_d": "N, desired force",
}
"""What a controller is given at each sample."""


def plant_machine(model: DrivenRig) -> Machine:
    """The plant over one tick, driven as `Drive` has it.

    Its inputs are those of `model`, the seconds since the motion's beginning (`since`)
    and the time (`t`); `P_a1` and `P_a2` are used at the start alone.
    """
    spec = model.spec
    numbers, says, build = numbers_of(model.rig, spec.command_unit)
    numbers = numbers | {PERIOD: np.float64(model.period)}
    given = [n for n in INPUTS if n in model.inputs]
    inputs = {name: np.float64(model.held[name]) for name in given}
    inputs |= {"since": np.float64(0.0), "t": np.float64(0.0)}
    first = {"P_a1": np.float64(0.0), "P_a2": np.float64(0.0)}

    def drive(at: Numbers) -> Drive:
        zero = jnp.zeros(())
        return Drive(**{n: at.get(n, zero) for n in Drive._fields})._replace(
            P=None if model.has_valve else at.get("P", zero)
        )

    def begin(p: Numbers, at: Numbers) -> tuple[Any, Numbers]:
        zero = 0.0 * at["x"]
        P = (at["P_a1"], at["P_a2"]) if model.has_valve else (zero, at.get("P", zero))
        still = inputs_from(drive(at), at["t"], at["since"], jnp.zeros(()))
        return start(_rig(build, p), still, P)

    def move(p: Numbers, state: Any, at: Numbers) -> tuple[Any, Numbers]:
        tick = inputs_from(drive(at), at["t"], at["since"], p[PERIOD])
        return step(_rig(build, p), state, tick)

    words = {n: f"{unit}, {what}" for n, (unit, what) in model.inputs.items()}
    words |= {n: f"{unit}, {what}" for n, (unit, what) in model.outputs.items()}
    return Machine(
        numbers,
        inputs | (first if model.has_valve else {}),
        tuple(n for n in OUTPUTS if n in model.outputs),
        begin,
        move,
        says
        | words
        | {
            PERIOD: "s, length of a tick",
            "since": "s, from where x, v and a are given to the tick's start",
            "t": "s, time at the tick's start",
        },
    )


class _Twin(NamedTuple):
    """A state and its change; whole numbers do not change."""

    at: Any
    along: Any


def tangent_machine(machine: Machine) -> Machine:
    """A machine's derivative along a direction of its inputs and parameters.

    Its inputs are the machine's and their changes, its state the machine's and its
    change, its outputs the changes of the machine's; time and period do not change.
    """
    p, i = machine.parameters, machine.inputs
    fixed = {PERIOD, "since", "t"}
    moved = [n for n in (*i, *p) if n not in fixed]

    def split(at: Numbers) -> tuple[Numbers, tuple[Numbers, Numbers]]:
        own = {n: at[n] for n in i}
        along = {n: at[ALONG + n] if n in moved else jnp.zeros(()) for n in (*p, *i)}
        return own, ({n: along[n] for n in p}, {n: along[n] for n in i})

    def begin(parameters: Numbers, at: Numbers) -> tuple[Any, Numbers]:
        own, (dp, di) = split(at)
        now, new = jax.jvp(machine.start, (parameters, own), (dp, di))
        return _Twin(now[0], new[0]), {ALONG + n: v for n, v in new[1].items()}

    def move(parameters: Numbers, state: _Twin, at: Numbers) -> tuple[Any, Numbers]:
        own, (dp, di) = split(at)
        primal, tangent = (parameters, state.at, own), (dp, state.along, di)
        now, new = jax.jvp(machine.step, primal, tangent)
        return _Twin(now[0], new[0]), {ALONG + n: v for n, v in new[1].items()}

    return Machine(
        p,
        i | {ALONG + n: np.float64(0.0) for n in moved},
        tuple(ALONG + n for n in machine.outputs),
        begin,
        move,
        dict(machine.says),
    )


def _rig(build: Any, numbers: Numbers) -> Rig:
    return build({k: jnp.asarray(v) for k, v in numbers.items()})


def law_machine(spec: RigFile) -> Machine:
    """The controller that a rig file names, sample for sample.

    Raises:
        InputError: the rig has no valve, or an invalid entry in [controller].
    """
    loop = build_loop(spec)
    numbers, says, build = numbers_of(loop.law, spec.command_unit)
    numbers = numbers | {PERIOD: np.asarray(loop.h, float)}

    def seen(at: Numbers) -> Measured:
        return Measured(*(at[name] for name in Measured._fields))

    def begin(p: Numbers, at: Numbers) -> tuple[Any, Numbers]:
        memory = build(p).init(seen(at), at["F_d"])
        floats = jax.tree.map(jnp.asarray, memory)
        return floats, {"u": jnp.zeros_like(at["x"])}

    def sample(p: Numbers, memory: Any, at: Numbers) -> tuple[Any, Numbers]:
        memory, u, _ = build(p).step(memory, seen(at), at["F_d"], p[PERIOD])
        return jax.tree.map(jnp.asarray, memory), {"u": u}

    return Machine(
        numbers,
        {name: np.float64(0.0) for name in READINGS},
        ("u",),
        begin,
        sample,
        says
        | READINGS
        | {
            PERIOD: "s, sampling period",
            "u": f"{'V' if spec.command_unit == 'V' else '1'}, valve command",
        },
    )
