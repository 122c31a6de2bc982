"""The plant, and a controller, as machines that C is written of."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hydrojax.control.base import Measured
from hydrojax.export.codegen.machine import Machine, Numbers, numbers_of
from hydrojax.export.model import INPUTS, OUTPUTS, SteppedRig
from hydrojax.export.stepping import Drive, inputs_from
from hydrojax.plant.rig import Rig
from hydrojax.plant.step import start, step
from hydrojax.rigfile.build import build_loop
from hydrojax.rigfile.schema import RigFile

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


def plant_machine(model: SteppedRig) -> Machine:
    """The plant over one tick, driven as `Drive` has it.

    Its inputs are those of `model`, the seconds since the motion's beginning (`since`)
    and the time (`t`); `P_a1` and `P_a2` are used at the start alone.
    """
    spec = model.spec
    numbers, says, build = numbers_of(model.rig, spec.command_unit)
    numbers = numbers | {PERIOD: np.float64(model.period)}
    given = [n for n in INPUTS if n in model.inputs]
    inputs = {name: np.float64(model.drive[name]) for name in given}
    inputs |= {"since": np.float64(0.0), "t": np.float64(0.0)}
    first = {"P_a1": np.float64(0.0), "P_a2": np.float64(0.0)}

    def drive(at: Numbers) -> Drive:
        zero = jnp.zeros(())
        return Drive(**{n: at.get(n, zero) for n in Drive._fields})._replace(
            P=None if model.valve else at["P"]
        )

    def begin(p: Numbers, at: Numbers) -> tuple[Any, Numbers]:
        P = (at["P_a1"], at["P_a2"]) if model.valve else (0.0 * at["P"], at["P"])
        still = inputs_from(drive(at), at["t"], at["since"], jnp.zeros(()))
        return start(_rig(build, p), still, P)

    def move(p: Numbers, state: Any, at: Numbers) -> tuple[Any, Numbers]:
        tick = inputs_from(drive(at), at["t"], at["since"], p[PERIOD])
        return step(_rig(build, p), state, tick)

    words = {n: f"{unit}, {what}" for n, (unit, what) in model.inputs.items()}
    words |= {n: f"{unit}, {what}" for n, (unit, what) in model.outputs.items()}
    return Machine(
        numbers,
        inputs | (first if model.valve else {}),
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
