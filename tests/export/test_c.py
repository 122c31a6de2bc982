"""The C that is written of a step, against that step as JAX runs it."""

import re
import subprocess
from dataclasses import replace
from importlib import resources
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hydrojax import effect
from hydrojax.effects import EFFECTS, Array, LevelEffect, param
from hydrojax.errors import InputError
from hydrojax.export.codegen.machine import Machine
from hydrojax.export.firmware import text_of
from hydrojax.export.machines import plant_machine
from hydrojax.export.model import driven_rig
from hydrojax.parameters import parameter_specs
from hydrojax.rigfile.schema import RigFile
from tests.export.c_code import Native, compiler

TICKS = 40
WITHIN = 1e-12
"""Of a field's largest value. libm's exp and sin differ from XLA's in the last digit:
over the ticks here that grows to some 1e-15."""


@pytest.fixture(scope="module")
def spec():
    file = resources.files("hydrojax") / "paper/reference.toml"
    with resources.as_file(file) as path:
        return RigFile.load(path)


def random_rigs(machine: Machine, rig, cases) -> dict[str, np.ndarray]:
    """Parameters by name, [cases]: rigs drawn, each with the effects of its case."""
    rng, known = np.random.default_rng(0), parameter_specs(rig)
    out = {n: np.repeat(float(v), len(cases)) for n, v in machine.parameters.items()}
    for name, s in known.items():
        if "." not in name:
            out[name] = np.clip(
                out[name] * rng.uniform(0.7, 1.4, len(cases)), s.lower, s.upper
            )
        elif s.strength:
            size = np.clip(s.scale * rng.uniform(0.5, 2, len(cases)), s.lower, s.upper)
            out[name] = np.where([name.split(".")[0] in on for on in cases], size, 0.0)
    return out


def course(machine: Machine) -> dict[str, np.ndarray]:
    """Inputs that cross zero in command, speed and force, [TICKS]."""
    t = np.arange(TICKS) * 1e-3
    known = {
        "u": 3 * np.sin(300 * t), "P": 900 * np.sin(170 * t),
        "x": 0.01 * np.sin(50 * t), "v": 0.5 * np.cos(50 * t),
        "a": -25 * np.sin(50 * t), "P_s": 14e6 + 1e5 * np.sin(90 * t),
        "P_r": np.full(TICKS, 3e5), "since": np.zeros(TICKS), "t": t,
        "P_a1": np.full(TICKS, 7e6), "P_a2": np.full(TICKS, 7.2e6),
    }  # fmt: skip
    return {name: known[name] for name in machine.inputs}


def by_jax(machine: Machine, parameters, inputs):
    """First state, then states before and after each tick, and outputs, by case."""

    def flat(tree):
        return jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(tree)])

    def run(p):
        state, _ = machine.start(p, {k: v[0] for k, v in inputs.items()})

        def body(state, row):
            new, out = machine.step(p, state, row)
            read = jnp.stack([out[name] for name in machine.outputs])
            return new, (flat(state), flat(new), read)

        return jax.lax.scan(body, state, inputs)[1]

    given = {k: jnp.asarray(v) for k, v in inputs.items()}
    inputs = given
    return [np.asarray(a) for a in jax.jit(jax.vmap(run))(parameters)]


class Compared(NamedTuple):
    """What C and JAX make of one case: worst differences over the largest value."""

    start: float
    step: float
    out: float
    free: float


def compare(machine: Machine, native: Native, parameters, inputs, found, i) -> Compared:
    before, after, read = (a[i] for a in found)
    table = np.stack([inputs[n] for n in machine.inputs], axis=1)
    row = [parameters[n][i] for n in machine.parameters]
    assert len(native.parameters) == len(row)  # none is without use
    assert np.isfinite(after).all()
    size = np.maximum(np.abs(after).max(0), 1e-300)
    states, outs = native.run(row, table, before)
    free, _ = native.run(row, table)
    return Compared(
        np.max(np.abs(states[0] - before[0]) / size),
        np.max(np.abs(states[1:] - after) / size),
        np.max(np.abs(outs[1:] - read) / np.abs(read).max(0)),
        np.max(np.abs(free[1:] - after) / size),
    )


CASES = [(), *((name,) for name in EFFECTS), tuple(EFFECTS)]


@pytest.fixture(scope="module")
def every(spec, tmp_path_factory):
    """A rig with the whole catalogue, as C and run by JAX, an effect to a case."""
    full = driven_rig(replace(spec, effects={name: {} for name in EFFECTS}))
    machine = plant_machine(full)
    files = text_of("plant", "The plant", "", full.spec, machine)
    native = Native("plant", files, tmp_path_factory.mktemp("every"))
    idle = set(machine.parameters) - _acting(machine, native)
    assert idle == {"signal_filter.s"}  # of the supply's reading, which no plant gives
    machine = _only_acting(machine, native)
    parameters, inputs = random_rigs(machine, full.rig, CASES), course(machine)
    return machine, native, parameters, inputs, by_jax(machine, parameters, inputs)


@pytest.mark.parametrize(
    "case", range(len(CASES)), ids=lambda i: "+".join(CASES[i][:2])
)
def test_the_plant_in_c_is_the_plant_of_the_simulator(every, case):
    assert max(compare(*every, case)) < WITHIN


def test_an_effect_of_ones_own_that_asks_for_turns_has_its_form_in_c(
    spec, tmp_path, vocabulary
):
    """`since`, `way` and `ages`, over turns of the piston and a rest."""

    @effect
    class Remembering(LevelEffect):
        """A level over all that is remembered of turns."""

        name = "remembering"
        residual_axis = "x"
        of_turns = True
        a: Array = param("N", 0.0, -1e3, 1e3, "level", strength=True, size=50.0)

        def level(self, at, base):
            old = sum(jnp.exp(-age) for age in at.ages)
            return self.a * (jnp.exp(-at.since / 0.01) + jnp.exp(-at.way / 1e-4) + old)

    own = driven_rig(replace(spec, effects={"remembering": {}}))
    machine = plant_machine(own)
    files = text_of("plant", "The plant", "", own.spec, machine)
    native = Native("plant", files, tmp_path)
    cases = [("remembering",), ()]
    parameters, inputs = random_rigs(machine, own.rig, cases), course(machine)
    inputs["v"] = np.where(np.arange(TICKS) > 30, 0.0, 0.5 * np.cos(314 * inputs["t"]))
    inputs["a"] = 0 * inputs["v"]
    found = by_jax(machine, parameters, inputs)
    assert max(compare(machine, native, parameters, inputs, found, 0)) < WITHIN
    assert np.max(np.abs(found[2][0] - found[2][1])[:, -1]) > 1.0


def test_every_effect_acts_in_c(every):
    """Against the same rig without it: the test above would not see a lost strength."""
    machine, native, parameters, inputs, _ = every
    table = np.stack([inputs[n] for n in machine.inputs], axis=1)
    for i, (name, *_) in enumerate(CASES[1:-1], 1):
        row = {n: parameters[n][i] for n in machine.parameters}
        without = {n: 0.0 if n.startswith(f"{name}.") else v for n, v in row.items()}
        strengths = parameter_specs(EFFECTS[name]())
        kept = {f"{name}.{n}" for n, s in strengths.items() if not s.strength}
        without |= {n: row[n] for n in kept & set(row)}
        outs = [native.run(list(r.values()), table)[1] for r in (row, without)]
        assert np.max(np.abs(outs[0] - outs[1]) / np.abs(outs[1]).max(0)) > 1e-9, name


def test_the_c_takes_no_memory_and_keeps_nothing(every, tmp_path):
    """It calls the functions of <math.h> and memcpy, and its data are constants."""
    _, native, *_ = every
    for name, text in (("plant.h", native.header), ("plant.c", native.source)):
        (tmp_path / name).write_text(text)
    made = tmp_path / "plant.o"
    subprocess.run(
        [compiler(), "-std=c99", "-O0", "-c", tmp_path / "plant.c", "-o", made],
        check=True,
    )
    said = subprocess.run(["nm", made], capture_output=True, text=True, check=True)
    symbols = [line.split()[-2:] for line in said.stdout.splitlines()]
    calls = {name for kind, name in symbols if kind == "U"}
    assert "exp" in calls
    assert calls <= {
        "exp", "expm1", "log", "pow", "sqrt", "sin", "cos", "tanh", "floor", "rint",
        "memcpy", "_GLOBAL_OFFSET_TABLE_", "__stack_chk_fail",
    }  # fmt: skip
    assert not [name for kind, name in symbols if kind in "dDbBC"]  # all are read only


# -- operations that no effect of the catalogue uses --


def listed(x, n):
    """Numbers by name that go through one operation each, of x [3] and a count."""
    table = jnp.array([0.3, -1.0, 2.0, 0.7, 5.0])
    at = jnp.array([-2.0, -0.5, 0.0, 1.0, 3.0])
    square = jnp.outer(x, jnp.flip(x)) + jnp.eye(3)
    index = jnp.floor(jnp.abs(x) * 2).astype(int)
    halved = jax.lax.while_loop(
        lambda c: c[1] > 0.1, lambda c: (c[0] + 1.0, c[1] / 2), (0.0, jnp.abs(x[0]) + 1)
    )[0]

    def inner(i, s):
        return s + jax.lax.fori_loop(0, 9, lambda j, r: r * x[1] / 3, 1.0) + i

    nested = jax.lax.fori_loop(0, 12, inner, x[2])
    swapped = jax.lax.fori_loop(0, 11, lambda i, c: (c[1], c[0] + 0.1), (x[0], x[1]))
    return {
        "interp": jnp.interp(x[0], at, table),
        "take": jnp.sum(table[index]),
        "beyond": jnp.take(table, index + 3, mode="fill", fill_value=7.0).sum(),
        "clipped": jnp.take(table, index + 3, mode="clip").sum(),
        "slice": jax.lax.dynamic_slice(table, (index[0],), (2,)).prod(),
        "update": jax.lax.dynamic_update_slice(table, x, (index[1],)) @ at,
        "matrix": jnp.trace(square @ square.T), "norm": jnp.linalg.norm(x),
        "sort": jnp.sort(x)[1], "order": jnp.argsort(x)[2] + 0.0,
        "median": jnp.median(x), "argmax": jnp.argmax(x) + 0.0,
        "cumsum": jnp.cumsum(x)[::-1] @ x, "cumprod": jnp.cumprod(x)[2],
        "least": jnp.min(x) - jnp.max(x), "any": jnp.any(x > 1.0) * 1.0,
        "all": jnp.where(jnp.all(x > -1), 2.0, 3.0),
        "while": halved, "nested": nested, "swapped": swapped[0] - 2 * swapped[1],
        "cond": jax.lax.cond(x[0] > 0, jnp.sin, jnp.cos, x[1]),
        "switch": jax.lax.switch(index[2], [jnp.sin, jnp.cos, jnp.tan], x[0]),
        "powers": x[0] ** 5 + x[1] ** -3 + jnp.abs(x[2]) ** 1.3,
        "rounded": jnp.round(x[0] * 3) + jnp.ceil(x[1]) + jnp.floor(x[2]) + x[0] // 0.3,
        "rest": x[0] % 0.7 + jnp.fmod(x[1], 0.3), "sign": jnp.sign(x) @ x,
        "erf": jax.scipy.special.erf(x[0]), "soft": jax.nn.sigmoid(x[1]),
        "log": jnp.log1p(jnp.abs(x[0])) + jnp.log(jnp.abs(x[1]) + 1),
        "root": jnp.cbrt(x[2]) + jnp.hypot(x[0], x[1]) + jax.lax.rsqrt(x[0] ** 2 + 1),
        "angle": jnp.arctan2(x[0], x[1]) + jnp.sinh(x[2]) + jnp.arcsinh(x[0]),
        "bound": jnp.arctan(x[0]) + jnp.arcsin(jnp.tanh(x[1])) + jnp.cosh(x[2]),
        "clip": jnp.clip(x, -0.5, 0.5).sum(), "polynomial": jnp.polyval(table, x[1]),
        "pad": jnp.pad(x, (1, 2), constant_values=0.4)[1:5].sum() + jnp.roll(x, 1)[0],
        "whole": (index[0] * 7 // 3 % 4 - index[1]) + 0.0,
        "signed": jnp.sign(index[2] - 1) + jnp.abs(1 - index[0]) + 0.0,
        "slope": jax.grad(lambda v: jnp.sum(jnp.tanh(v) ** 2 * x))(x)[1],
        "count": n + 1.0,
    }  # fmt: skip


def test_operations_of_jax_numpy_have_their_form_in_c(spec, tmp_path):
    """What effects and controllers of a user's own may be written with."""

    def step(p, n, at):
        x = jnp.stack([at["a"], at["b"], at["c"]]) * p["scale"]
        return n + 1, listed(x, n)

    names = tuple(listed(jnp.ones(3), 0.0))
    zeros = {name: np.float64(0.0) for name in ("a", "b", "c")}
    machine = Machine(
        {"scale": np.float64(1.1)}, zeros, names,
        lambda p, at: (jnp.zeros(()), step(p, 0.0, at)[1]), step, {},
    )  # fmt: skip
    native = Native("many", text_of("many", "All", "", spec, machine), tmp_path)
    rng = np.random.default_rng(1)
    inputs = rng.uniform(-2, 2, (60, 3))
    scale = jnp.asarray(1.1)
    want = jax.jit(jax.vmap(lambda x: jnp.stack([*listed(x * scale, 0.0).values()])))
    table = np.array(want(jnp.asarray(inputs)))
    table[:, names.index("count")] += np.arange(60)
    _, found = native.run([1.1], inputs)
    for i, name in enumerate(names):
        size = np.nanmax(np.abs(table[:, i]))
        off = np.max(np.abs(found[1:, i] - table[:, i]))
        assert off <= 1e-12 * max(size, 1.0), name
        assert np.ptp(table[:, i]) > 0, name


def test_what_has_no_form_in_c_is_named(spec):
    def start(p, at):
        return jnp.zeros(()), {"y": jnp.fft.rfft(jnp.stack([at["x"]] * 4)).real[0]}

    def step(p, state, at):
        return start(p, at)

    machine = Machine({}, {"x": np.float64(0)}, ("y",), start, step, {})
    with pytest.raises(InputError, match="operation 'fft' has no form in C"):
        text_of("none", "None", "", spec, machine)


def test_numbers_are_written_to_the_last_digit(every):
    """And no number of the rig is baked into the functions."""
    machine, native, *_ = every
    head = native.source.split("plant_rig = {")[1].split("};")[0]
    values = [float(v) for v in re.findall(r" = \(?([^,()]+)\)?,", head)]
    assert values == [float(v) for v in machine.parameters.values()]
    assert "1.18e-3" not in native.source.split("};", 1)[1]
    assert "0.00118" not in native.source.split("};", 1)[1]


# -- slow: an effect's own code, and other layouts --

LAYOUTS = {
    "differential": 'layout = "differential"\n[geometry]\narea_1 = "50 cm^2"\n'
    'area_2 = "34 cm^2"\nchamber_length = "0.59 m"\n',
    "single": 'layout = "single"\n[geometry]\narea = "1.2e-3 m^2"\n'
    'chamber_length = "0.2 m"\n',
    "driven-axis": 'layout = "driven-axis"\n',
    "flow table": 'layout = "differential"\n[geometry]\narea_1 = "50 cm^2"\n'
    'area_2 = "34 cm^2"\nchamber_length = "0.59 m"\n[valve]\nkind = "table"\n'
    'command = ["-10 V", "-1 V", "0.5 V", "4 V"]\n'
    'opening = ["-9 V", "0 V", "0 V", "2 V"]\n',
    "tester": 'layout = "tester"\n[parameters]\nk_cp = "20 N"\nk_cn = "30 N"\n',
}


@pytest.mark.slow
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_in_c(layout, tmp_path):
    (tmp_path / "rig.toml").write_text(LAYOUTS[layout])
    model = driven_rig(RigFile.load(tmp_path / "rig.toml"))
    machine = plant_machine(model)
    files = text_of("plant", "The plant", "", model.spec, machine)
    native = Native("plant", files, tmp_path)
    machine = _only_acting(machine, native)
    parameters = {n: np.repeat(float(v), 1) for n, v in machine.parameters.items()}
    inputs = course(machine)
    found = by_jax(machine, parameters, inputs)
    assert max(compare(machine, native, parameters, inputs, found, 0)) < WITHIN


def _only_acting(machine, native):
    """The machine with the parameters alone that its C has: those that act."""
    acting = _acting(machine, native)
    return machine._replace(
        parameters={n: v for n, v in machine.parameters.items() if n in acting},
        start=lambda p, at, m=machine: m.start(m.parameters | p, at),
        step=lambda p, s, at, m=machine: m.step(m.parameters | p, s, at),
    )


def _acting(machine, native):
    plain = {re.sub(r"\W+", "_", n): n for n in machine.parameters}
    return {plain[n] for n in native.parameters}


@pytest.mark.slow
@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_alone_in_c(spec, name, tmp_path):
    """The structure of a rig with this effect only."""
    model = driven_rig(replace(spec, effects={name: {}}))
    machine = plant_machine(model)
    files = text_of("plant", "The plant", "", model.spec, machine)
    native = Native("plant", files, tmp_path)
    machine = _only_acting(machine, native)
    parameters = random_rigs(machine, model.rig, [(name,)])
    inputs = course(machine)
    found = by_jax(machine, parameters, inputs)
    assert max(compare(machine, native, parameters, inputs, found, 0)) < WITHIN
