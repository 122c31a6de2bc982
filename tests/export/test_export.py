"""Rigs for other tools: each file read by its own reader, against the simulator."""

import json
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from dataclasses import replace
from importlib import resources
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pint
import pytest
from scipy.io import loadmat

from hydrojax import export
from hydrojax.control.simulation import simulate_loop
from hydrojax.errors import InputError
from hydrojax.parameters import put
from hydrojax.plant.state import StepInput
from hydrojax.plant.step import start, step
from hydrojax.rigfile.build import build_loop
from hydrojax.rigfile.controller import file_keys
from hydrojax.rigfile.other_controllers import with_controller
from hydrojax.rigfile.scenarios import rig_scenario
from hydrojax.rigfile.schema import RigFile
from tests.export.c_code import Native, compiler

REFERENCE = (resources.files("hydrojax") / "paper/reference.toml").read_text()

RICH = """
name = 'a "rich" rig */ 2'
layout = "differential"

[geometry]
area_1 = "50 cm^2"
area_2 = "3.4e-3 m^2"
chamber_length = "0.59 m"
x_mid = "25 cm"

[sensors]
P_a1 = "9 kPa"
F = "2.5 N"

[channels]
u = { column = "MainU", unit = "1", invert = true }

[valve]
kind = "table"
command = [-1, -0.1, 0.2, 0.5, 1]
opening = ["-1", "0", "0", "0.25", "1"]

[load]
mass = "0.15 t"

[parameters]
beta = { start = "8e3 bar", range = ["1e8 Pa", "3e9 Pa"] }
c_p1 = { start = "2e-8 m^3/(s*Pa^0.5)", range = ["2e-9 m^3/(s*Pa^0.5)", "2e-7 m^3/(s*Pa^0.5)"] }
k_cp = "0.3 kN"
k_cn = "0.2 kN"
z_ss = "60 um"

[effects.valve_lag]
omega = { start = "1257 rad/s", range = ["300 rad/s", "3000 rad/s"] }

[effects.internal_leakage]
c_il = "2e-13 m^3/(s*Pa)"

[effects.stribeck]
k_st = "400 N"

[effects.loadcell_lag]
tau_F = "2 ms"

[effects.pressure_sensor_bias]
b_1 = "0.3 bar"

[controller]
rate = 500
k_p = 0.02
k_cp = [0, 1]
"""  # noqa: E501

EVERY = (
    REFERENCE.replace('k_1 = "0.01 V*s/kN"', 'k_1 = ["0.008 V*s/kN", "0.012 V*s/kN"]')
    + """rho_1 = "2e-6 V*s/kN^3"
tau_d = "0.5 ms"
tau_v = "1 ms"
"""
)
"""The reference rig with all nine estimates adapted, and both filters."""

SINGLE = """
layout = "single"

[geometry]
area = "1.2e-3 m^2"
chamber_length = "0.2 m"

[sensors]
P_a2 = "9 kPa"
F = "2.5 N"

[parameters]
k_cp = "100 N"
k_cn = "100 N"
"""

GUARDED = REFERENCE.replace(
    "[controller]",
    '[controller]\nleakage = "0.4 1/s"\ndead_zone = "15 N"\nsaturated = 0.3\n'
    'u_max = "0.3 V"',
)
LAWS = {
    "reference": REFERENCE, "every": EVERY, "rich": RICH, "single": SINGLE,
    "guarded": GUARDED,
}  # fmt: skip


def spec_of(text, tmp_path):
    path = tmp_path / "source.toml"
    path.write_text(text, encoding="utf-8")
    return RigFile.load(path)


def one(spec, kind):
    """The single file of one format."""
    (content,) = export.export(spec, [kind]).files.values()
    return content


def closed_loop(spec, seconds, seed=3):
    """A run of the rig as its file says, with noise."""
    loop = build_loop(spec)
    scenario = rig_scenario(spec, loop, seconds=seconds, seed=seed)
    return loop, simulate_loop(loop, scenario)


# -- toml --


MOVED = RICH.replace(
    "[load]",
    """[load]
predicts = "x"
second_mass = "40 kg"
second_stiffness = { start = "2 kN/mm", range = ["1 kN/mm", "9 kN/mm"] }""",
)
"""A load of which something is to be found from the motion."""


@pytest.mark.parametrize(
    "text", [REFERENCE, RICH, MOVED], ids=["reference", "rich", "moved"]
)
def test_toml_reads_back_as_the_same_rig(text, tmp_path):
    spec = spec_of(text, tmp_path)
    (tmp_path / "out.toml").write_bytes(one(spec, "toml"))
    again = RigFile.load(tmp_path / "out.toml")
    assert file_keys(again) == file_keys(spec)
    same = replace(again, path=spec.path, controller=spec.controller)
    assert same == spec
    laws = [jax.tree.leaves(build_loop(s)) for s in (spec, again)]
    assert all(np.array_equal(a, b) for a, b in zip(*laws, strict=True))


def test_toml_keeps_tolerances(tmp_path):
    text = RICH + '[supply]\nP_s = "14 MPa +- 1 %"\n'
    for plain, tolerance in (
        ('area_1 = "50 cm^2', "2 %"), ('z_ss = "60 um', "2 um"),
        ('k_st = "400 N', "5 %"), ('tau_F = "2 ms', "0.1 ms"),
    ):  # fmt: skip
        assert plain in text
        text = text.replace(plain, f"{plain} +- {tolerance}")
    spec = spec_of(text, tmp_path)
    assert set(spec.tolerances) == {"area_1", "P_s"}
    assert spec.effects["loadcell_lag"]["tau_F"].tolerance == pytest.approx(1e-4)
    (tmp_path / "out.toml").write_bytes(one(spec, "toml"))
    again = RigFile.load(tmp_path / "out.toml")
    for part in ("tolerances", "geometry", "supply", "parameters", "effects"):
        assert getattr(again, part) == getattr(spec, part), part


def test_toml_has_the_quantities_of_the_file_in_si(tmp_path):
    """By pint alone, on the texts of both files."""
    registry = pint.UnitRegistry()
    made = tomllib.loads(one(spec_of(RICH, tmp_path), "toml").decode())
    given = tomllib.loads(RICH)
    for section, key in (
        ("geometry", "area_1"), ("geometry", "x_mid"), ("load", "mass"),
        ("sensors", "P_a1"), ("parameters", "k_cp"), ("parameters", "z_ss"),
    ):  # fmt: skip
        a, b = (registry(tree[section][key]) for tree in (made, given))
        assert a.to_base_units() == a, key
        assert a.magnitude == pytest.approx(b.to(a.units).magnitude, rel=1e-14)
    lag = made["effects"]["valve_lag"]["tau"]
    assert registry(lag["start"]).magnitude == pytest.approx(1 / 1257, rel=1e-15)
    assert registry(lag["range"][1]).magnitude == pytest.approx(1 / 300, rel=1e-15)
    defaults = {"scale": 1.0, "delay": "0 s", "held": True}
    own = {name: {**entry, **defaults} for name, entry in given["channels"].items()}
    assert made["channels"] == own
    assert [float(u) for u in made["valve"]["command"]] == given["valve"]["command"]


# -- json, mat, modelica: one tree --


def test_json_has_every_number_with_its_unit(tmp_path):
    tree = json.loads(one(spec_of(RICH, tmp_path), "json"))
    assert tree["format"] == "hydrojax-rig/1" and tree["layout"] == "differential"
    assert tree["name"] == 'a "rich" rig */ 2' and tree["command_unit"] == "1"
    parameters, law = tree["parameters"], tree["controller"]
    assert parameters["beta"]["value"] == 8e8 and parameters["beta"]["given"]
    assert parameters["beta"]["range"] == [1e8, 3e9]
    # Ten times the default per volt: the command is a fraction.
    assert parameters["c_n1"]["value"] == pytest.approx(2.2e-8, rel=1e-14)
    assert parameters["c_n1"]["unit"] == "m^3/(s*Pa^0.5)"
    assert not parameters["c_n1"]["given"] and "range" not in parameters["c_n1"]
    tau = tree["effects"]["valve_lag"]["tau"]
    assert tau["value"] == pytest.approx(1 / 1257) and "1/omega" in tau["says"]
    assert tree["effects"]["valve_lag"]["zeta"]["value"] == 0.7  # the default
    assert tree["geometry"]["area_1"] == {"value": 5e-3, "unit": "m^2", "given": True}
    assert tree["supply"]["P_s"] == {"value": 14e6, "unit": "Pa", "given": False}
    assert tree["load"]["mass"]["value"] == pytest.approx(150)
    assert law["k_p"]["value"] == pytest.approx(2e-5) and law["k_p"]["unit"] == "V/N"
    assert law["k_cp"]["value"] == [0.0, 1e3] and law["rate"]["value"] == 500
    # beta of 8e8 Pa at 0.01 V s/kN.
    assert law["kappa"]["value"] == pytest.approx(1 / 8e8 / 1e-5)
    assert law["rho_a"]["value"] == pytest.approx(0.7) and not law["rho_a"]["given"]
    assert law["u_max"] == {"value": 1.0, "unit": "1", "given": False}


def test_the_laws_numbers_are_those_of_the_tree(tmp_path):
    """What [controller] says, times the valve gain, is what the loop has."""
    spec = spec_of(EVERY, tmp_path)
    tree, law = json.loads(one(spec, "json"))["controller"], build_loop(spec).law
    kappa = tree["kappa"]["value"]
    for name, volts in (("k_p", 1), ("k_f", 1), ("tau_d", 0), ("tau_v", 0)):
        want = tree[name]["value"] * (kappa if volts else 1)
        assert float(getattr(law, name)) == pytest.approx(want, rel=1e-14)
    for name in law.lower._fields:
        scale = kappa if name in ("k_1", "A_a") else 1.0
        ends = [float(getattr(side, name)) for side in (law.lower, law.upper)]
        assert ends == pytest.approx(
            [scale * e for e in tree[name]["value"]], rel=1e-14
        )


def plain(struct):
    """What loadmat gives, as nested dicts and lists."""
    if isinstance(struct, dict):
        return {name: plain(value) for name, value in struct.items()}
    return struct.tolist() if isinstance(struct, np.ndarray) else struct


def without_empty(tree):
    """MATLAB's struct has no empty sections, and its empty text is an empty array."""
    if not isinstance(tree, dict):
        return [] if tree == "" else tree
    return {k: without_empty(v) for k, v in tree.items() if v != {}}


def names_in(tree):
    for name, value in tree.items():
        yield name
        if isinstance(value, dict):
            yield from names_in(value)


@pytest.mark.parametrize("text", [REFERENCE, RICH], ids=["reference", "rich"])
def test_mat_reads_back_equal(text, tmp_path):
    spec = spec_of(text, tmp_path)
    (tmp_path / "rig.mat").write_bytes(one(spec, "mat"))
    read = loadmat(tmp_path / "rig.mat", simplify_cells=True)["rig"]
    assert plain(read) == without_empty(json.loads(one(spec, "json")))
    valid = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")
    assert all(valid.fullmatch(name) for name in names_in(read))


def literal(node):
    """A number, or numbers, of a parsed Modelica expression."""
    if hasattr(node, "values"):
        return [literal(v) for v in node.values]
    if hasattr(node, "operands"):
        (operand,) = node.operands
        return -literal(operand)
    return node.value


def modified(symbol):
    """What a declaration sets: its value, and attributes such as the unit."""
    arguments = [a.value for a in symbol.class_modification.arguments]
    return {a.component.name: a.modifications[0] for a in arguments}


@pytest.mark.parametrize("text", [REFERENCE, RICH], ids=["reference", "rich"])
def test_modelica_parses_to_the_same_numbers(text, tmp_path):
    parser = pytest.importorskip("pymoca.parser")
    spec = spec_of(text, tmp_path)
    ((name, content),) = export.export(spec, ["modelica"]).files.items()
    parsed = parser.parse(content.decode())
    kind = name.removesuffix(".mo")
    record_ = parsed.classes[kind]
    assert record_.type == "record"
    symbols, tree = record_.symbols, json.loads(one(spec, "json"))
    expected = {
        **tree["geometry"], **tree["supply"], **tree["parameters"],
        **{f"valve_{n}": q for n, q in tree["valve"].items()},
        **{f"law_{n}": q for n, q in tree["controller"].items()},
        **{f"load_{n}": q for n, q in tree["load"].items()},
        **{f"noise_{n}": q for n, q in tree["sensors"].items()},
        **{f"{e}_{n}": q for e, f in tree["effects"].items() for n, q in f.items()},
    }  # fmt: skip
    assert set(symbols) == {"layout", "command_unit", *expected}
    for name, quantity in expected.items():
        assert literal(modified(symbols[name])["value"]) == quantity["value"], name
        assert f"[{quantity['unit']}]" in symbols[name].comment
        assert "parameter" in symbols[name].prefixes
    assert str(symbols["P_s"].type) == "Modelica.Units.SI.Pressure"
    assert str(symbols["k_cp"].type) == "Modelica.Units.SI.Force"
    assert literal(modified(symbols["law_c_6"])["unit"]) == "1/(s.N2)"
    assert set(modified(symbols["c_p1"])) == {"value"}  # Modelica has no half powers


def test_names_that_mean_something_elsewhere_are_changed(tmp_path):
    for rig, want in (("Real", "Rig_Real"), ("7 bar", "Rig_7_bar"), ("ö", "Rig")):
        spec = replace(spec_of(REFERENCE, tmp_path), name=rig)
        (name,) = export.export(spec, ["modelica"]).files
        assert name == f"{want}.mo"


# -- the law in C --


ONCE = [
    pytest.param(k, marks=pytest.mark.slow) for k in ("linearizing", "backstepping")
]


def with_kind(kind):
    return (
        REFERENCE[: REFERENCE.index("[controller]")] + f"[controller]\nkind = '{kind}'"
    )


@pytest.mark.filterwarnings("ignore:a pressure left")  # one chamber cannot pull
@pytest.mark.parametrize("case", [*LAWS, "pi", *ONCE])
def test_the_law_in_c_is_the_law_of_the_simulator(case, tmp_path):
    spec = spec_of(LAWS.get(case) or with_kind(case), tmp_path)
    files = {n: c.decode() for n, c in export.export(spec, ["c"]).files.items()}
    assert set(files) == {"law.h", "law.c", "plant.h", "plant.c"}
    law = {n: text for n, text in files.items() if n.startswith("law")}
    native = Native("law", law, tmp_path)
    loop, run = closed_loop(spec, 2.0)
    assert native.inputs == ["P_a1", "P_a2", "P_s", "F", "x", "F_d"]
    seen = np.stack([*(run[n] for n in native.inputs[:-1]), run.F_d], axis=1)
    head = law["law.c"].split("law_rig = {")[1].split("};")[0]
    values = [float(v) for v in re.findall(r" = \(?([^,()]+)\)?,", head)]
    states, outs = native.run(values, seen)
    assert np.max(np.abs(outs[1:, 0] - run["u"])) < 1e-9 * np.max(np.abs(run["u"]))
    if case not in LAWS:
        return
    names, adapts = loop.law.rate._fields, [float(r) > 0 for r in loop.law.rate]
    for i, name in enumerate(names):
        found = states[:-1, native.state.index(f"estimates_{name}")]
        size = np.max(np.abs(run[name]))
        assert np.max(np.abs(found - run[name])) <= 1e-9 * size, name
        assert (np.ptp(run[name]) > 0) == adapts[i]
    if case == "guarded":  # all that the safeguards do was done
        assert 0.02 < np.mean(np.abs(run["u"]) >= 0.3) < 0.98
    assert sum(adapts) == (9 if case == "every" else 8)


def test_defaults_of_the_law_are_said(tmp_path):
    (note,) = export.export(spec_of(REFERENCE, tmp_path), ["c"]).notes
    assert "no rho_1, c_4, c_5" in note and "k_p" not in note
    bare = REFERENCE[: REFERENCE.index("[controller]")]
    (note,) = export.export(spec_of(bare, tmp_path), ["c"]).notes
    assert "k_p, k_f" in note


# -- the plant as an FMU --


@pytest.fixture(scope="module")
def fmpy():
    compiler()
    pytest.importorskip("fmpy.validation")
    return pytest.importorskip("fmpy")


def write_fmu(spec, folder):
    """The files of FMI 2.0 and 3.0."""
    files = export.export(spec, ["fmu"]).files
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return [folder / name for name in files]


def inputs(run, spec, seconds):
    """A run as what drives an FMU: at each tick the piston goes where the run goes."""
    h = run.t[1] - run.t[0]
    n = round(seconds / h)
    x, v = run["true_x"][: n + 1], run["true_v"][:n]
    a = 2 * (np.diff(x) - v * h) / h**2
    line = spec.line
    columns = {
        "time": np.arange(n) * h, "u": run["u"][:n], "x": x[:n], "v": v, "a": a,
        "P_s": line["P_s"] + 5e4 * np.sin(np.arange(n) / 40),
        "P_r": np.full(n, line["P_r"]),
    }  # fmt: skip
    table = np.empty(n, [(name, float) for name in columns])
    for name, column in columns.items():
        table[name] = column
    return table, h


def by_steps(rig, table, h, P, F=None, parts=4):
    """The step scanned over the same inputs, [n, 3], from rest at pressures `P`.

    `F` [n + 1] is the force that stretches what gives.
    """
    share = np.linspace(0.0, h, 2 * parts + 1)
    col = {name: jnp.asarray(table[name]) for name in table.dtype.names}
    x = col["x"][:, None] + col["v"][:, None] * share + col["a"][:, None] / 2 * share**2
    ticks = StepInput(
        h=jnp.full(table.size, h),
        u=col["u"],
        P_s=jnp.stack([col["P_s"]] * 2, axis=-1),
        P_r=jnp.stack([col["P_r"]] * 2, axis=-1),
        x=x,
        dx=jnp.diff(x[:, ::2], axis=1),
        v=col["v"] + h * col["a"],
        a=col["a"],
        t=col["time"] + h,
        F=None if F is None else jnp.stack([F[:-1], F[1:]], axis=-1),
    )

    def scan(rig):
        first = jax.tree.map(lambda a: a[0], ticks)
        state, _ = start(rig, first, (jnp.asarray(P[0]), jnp.asarray(P[1])))
        return jax.lax.scan(lambda s, tick: step(rig, s, tick), state, ticks)[1]

    read = jax.jit(scan)(rig)
    return np.stack([read[name] for name in ("P_a1", "P_a2", "F")], axis=1)


def run_fmu(fmpy, path, table, h, P, **more):
    start = {"P_a1_start": P[0], "P_a2_start": P[1]} | more.pop("start_values", {})
    out = fmpy.simulate_fmu(
        str(path), stop_time=table["time"][-1], output_interval=h, input=table,
        output=["P_a1", "P_a2", "F"], start_values=start, **more,
    )  # fmt: skip
    return np.stack([out[name] for name in ("P_a1", "P_a2", "F")], axis=1)


@pytest.fixture(
    scope="module", params=["reference", pytest.param("rich", marks=pytest.mark.slow)]
)
def driven(request, tmp_path_factory, fmpy):
    """A rig, its FMU as a file, and a run of it as inputs."""
    folder = tmp_path_factory.mktemp(request.param)
    spec = spec_of(LAWS[request.param], folder)
    two, _ = write_fmu(spec, folder)
    loop, run = closed_loop(spec, 2.5)
    table, h = inputs(run, spec, 2.0)
    P = float(run["true_P_a1"][0]), float(run["true_P_a2"][0])
    return spec, two, loop, run, table, h, P


def fmi3(path):
    """The file of FMI 3.0 beside that of 2.0."""
    return path.with_name(f"{path.stem}_fmi3.fmu")


@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_replays_as_the_simulator_does(fmpy, driven, version):
    _, path, loop, _, table, h, P = driven
    path = path if version == 2 else fmi3(path)
    found = run_fmu(fmpy, path, table, h, P)
    want = by_steps(loop.rig, table, h, P)[:-1]
    assert found.shape == (table.size, 3)
    size = np.max(np.abs(want), axis=0)
    assert np.max(np.abs(found[1:] - want) / size) < 1e-11


def test_an_fmu_follows_the_closed_loop_that_made_its_inputs(fmpy, driven):
    """The loop runs its plant in parts, with a supply that holds still."""
    spec, path, _, run, table, h, P = driven
    still = table.copy()
    still["P_s"] = spec.line["P_s"]
    found = run_fmu(fmpy, path, still, h, P)
    bias = 3e4 if "pressure_sensor_bias" in spec.effects else 0.0
    for i, name, off in ((0, "true_P_a1", bias), (1, "true_P_a2", 0.0)):
        truth = run[name][: table.size]
        assert np.max(np.abs(found[:, i] - off - truth)) < 0.02 * np.ptp(truth)


def test_the_effects_and_parameters_of_an_fmu_act(fmpy, driven):
    spec, path, loop, _, table, h, P = driven
    short = table[:200]
    base = run_fmu(fmpy, path, short, h, P)
    size = np.ptp(base, axis=0)
    for name in ("beta", "valve_lag.tau"):
        value = float(loop.rig.chambers.beta if name == "beta" else 8e-4)
        changed = run_fmu(fmpy, path, short, h, P, start_values={name: 3 * value})
        assert np.max(np.abs(changed - base) / size) > 1e-3, name
    bare = replace(spec, effects={})
    without = by_steps(build_loop(bare).rig, short, h, P)[:-1]
    assert np.max(np.abs(without - base[1:]) / size) > 1e-3


@pytest.mark.slow
def test_an_fmu_solves_for_the_force_that_stretches_its_rod(fmpy, tmp_path):
    """The step is given the force that the FMU found, and must find it again."""
    rod = "[effects.rod_compliance]\nk = '5e7 N/m'\n[controller]"
    spec = spec_of(REFERENCE.replace("[controller]", rod), tmp_path)
    fmu, _ = write_fmu(spec, tmp_path)
    loop, run = closed_loop(spec, 0.6)
    table, h = inputs(run, spec, 0.5)
    P = float(run["true_P_a1"][0]), float(run["true_P_a2"][0])
    found = run_fmu(fmpy, fmu, table, h, P)
    again = by_steps(loop.rig, table[:-1], h, P, F=jnp.asarray(found[:, 2]))
    free = by_steps(loop.rig, table[:-1], h, P)
    rigid = put(loop.rig, ["rod_compliance.give"], [0.0])
    stiff = by_steps(rigid, table[:-1], h, P)
    size = np.ptp(found, axis=0)
    assert np.max(np.abs(found[1:] - again) / size) < 1e-5
    # Given no force, the step solves for the same one.
    assert np.max(np.abs(found[1:] - free) / size) < 1e-12
    assert np.max(np.abs(found[1:] - stiff) / size) > 1e-2


@pytest.mark.filterwarnings("ignore:a pressure left")  # one chamber cannot pull
@pytest.mark.slow
def test_an_fmu_of_one_chamber_has_one_pressure(fmpy, tmp_path):
    spec = spec_of(SINGLE, tmp_path)
    fmu, _ = write_fmu(spec, tmp_path)
    loop, run = closed_loop(spec, 0.6)
    table, h = inputs(run, spec, 0.5)
    P_a2 = float(run["true_P_a2"][0])
    out = fmpy.simulate_fmu(
        str(fmu), stop_time=table["time"][-1], output_interval=h,
        input=table, start_values={"P_a2_start": P_a2},
    )  # fmt: skip
    assert out.dtype.names == ("time", "P_a2", "F")
    want = by_steps(loop.rig, table, h, (float(loop.P_start), P_a2))[:-1]
    for i, column in ((1, "P_a2"), (2, "F")):
        size = np.max(np.abs(want[:, i]))
        assert np.max(np.abs(out[column][1:] - want[:, i])) < 1e-9 * size


def test_an_fmu_says_what_it_is_and_nothing_of_the_machine(fmpy, driven):
    spec, path, *_ = driven
    description = fmpy.read_model_description(str(path), validate=True)
    assert description.fmiVersion == "2.0" and description.coSimulation
    by = {v.name: v for v in description.modelVariables}
    kinds = {name: v.causality for name, v in by.items()}
    assert [n for n, c in kinds.items() if c == "input"] == [
        "u", "x", "v", "a", "P_s", "P_r",
    ]  # fmt: skip
    assert [n for n, c in kinds.items() if c == "output"] == ["P_a1", "P_a2", "F"]
    assert kinds["valve_lag.tau"] == kinds["beta"] == "parameter"
    assert float(by["beta"].start) == spec.parameters["beta"].start
    fixed = not description.coSimulation.canHandleVariableCommunicationStepSize
    assert fixed == ("valve_delay" in spec.effects)
    assert not fmpy.validation.validate_fmu(str(path))
    assert not fmpy.validation.validate_fmu(str(fmi3(path)))
    with zipfile.ZipFile(path) as archive:
        assert {"sources/plant.c", "sources/fmi2.c"} <= set(archive.namelist())
        for name in archive.namelist():
            content = archive.read(name)
            for place in (Path(spec.path).parent, Path.home(), Path(__file__).parent):
                assert str(place).encode() not in content, name


def test_steps_of_any_length_but_of_one_where_there_is_a_delay(fmpy, driven):
    """A long step is cut into ticks, a rig whose delay counts them refuses others."""
    spec, path, loop, _, table, h, P = driven
    still = table[:21].copy()
    for name in ("v", "a"):
        still[name] = 0.0
    for name in ("x", "u", "P_s"):
        still[name] = still[name][0]
    fine = run_fmu(fmpy, path, still, h, P)[::5]
    coarse = still[::5]
    assert np.allclose(run_fmu(fmpy, path, coarse, 5 * h, P), fine, rtol=1e-12)
    description = fmpy.read_model_description(str(path))
    folder = fmpy.extract(str(path))
    said = []
    slave = fmpy.instantiate_fmu(
        folder, description, "CoSimulation", debug_logging=True,
        logger=lambda *words: said.append(words[-1].decode()),
    )  # fmt: skip
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    slave.doStep(0.0, h)
    if "valve_delay" in spec.effects:
        with pytest.raises(Exception, match="fmi2DoStep"):
            slave.doStep(h, 0.4 * h)
        assert any("keep to steps of one length" in line for line in said)
    else:
        slave.doStep(h, 0.4 * h)
    slave.freeInstance()
    shutil.rmtree(folder)


def test_a_delay_that_an_fmu_cannot_hold_is_refused(fmpy, driven):
    """It holds 15 ticks: finer ones, or a longer delay, would be cut short."""
    spec, path, *_ = driven
    if "valve_delay" not in spec.effects:
        pytest.skip("the rig has no delay")
    description = fmpy.read_model_description(str(path))
    folder = fmpy.extract(str(path))
    for tau_u, h, held in (
        (3e-3, 1e-3, True), (3e-3, 2e-4, True), (3e-3, 1e-4, False),
        (15e-3, 1e-3, True), (16e-3, 1e-3, False),
    ):  # fmt: skip
        said = []
        slave = fmpy.instantiate_fmu(
            folder, description, "CoSimulation", debug_logging=True,
            logger=lambda *words, said=said: said.append(words[-1].decode()),
        )  # fmt: skip
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        by = {v.name: v.valueReference for v in description.modelVariables}
        slave.setReal([by["valve_delay.tau_u"]], [tau_u])
        slave.exitInitializationMode()
        if held:
            slave.doStep(0.0, h)
        else:
            with pytest.raises(Exception, match="fmi2DoStep"):
                slave.doStep(0.0, h)
            assert any("is more than the 15 ticks" in line for line in said)
        slave.freeInstance()
    shutil.rmtree(folder)


class Played:
    """An FMU of either version, step by step."""

    def __init__(self, fmpy, path, version, P):
        description = fmpy.read_model_description(str(path))
        self.by = {v.name: v.valueReference for v in description.modelVariables}
        self.folder = fmpy.extract(str(path))
        self.unit = u = fmpy.instantiate_fmu(self.folder, description, "CoSimulation")
        if version == 2:
            u.setupExperiment(startTime=0.0)
            self._get, self._set, self.keep = u.getReal, u.setReal, u.getFMUstate
            self.back = u.setFMUstate
        else:
            self._get, self._set, self.keep = u.getFloat64, u.setFloat64, u.getFMUState
            self.back = u.setFMUState
        u.enterInitializationMode()
        self.put(P_a1_start=P[0], P_a2_start=P[1])
        u.exitInitializationMode()

    def put(self, **values):
        self._set(
            [self.by[n.replace("__", ".")] for n in values], list(values.values())
        )

    def get(self, *names):
        return np.array(self._get([self.by[n] for n in names]))

    def along(self, outs, names, seed):
        by = self.by
        refs = [by[n] for n in outs], [by[n] for n in names]
        return np.array(self.unit.getDirectionalDerivative(*refs, seed))


OUTS = ("P_a1", "P_a2", "F")


@pytest.mark.parametrize("version", [2, 3])
def test_derivatives_of_an_fmu_are_its_difference_quotients(fmpy, driven, version):
    """Along inputs and parameters over a step after the command jumped."""
    _, path, _, _, table, h, P = driven
    played = Played(fmpy, path if version == 2 else fmi3(path), version, P)
    names = [n for n in table.dtype.names if n != "time"]
    for row in table[:29]:
        jump = {"u": 0.1 if row["time"] == table["time"][28] else 0.0}
        played.put(**{n: row[n] + jump.get(n, 0.0) for n in names})
        played.unit.doStep(row["time"], h)
    played.put(**{n: table[n][29] for n in names})
    before, t = played.keep(), table["time"][29]
    played.unit.doStep(t, h)
    here = played.get(*OUTS)
    named = ["u", "a", "v", "P_s", "beta", "k_cp", "k_cn", "c_n1", "valve_lag.tau"]
    found = {n: played.along(OUTS, [n], [1.0]) for n in named}
    both = played.along(OUTS, ["u", "a"], [2.0, -3.0])
    assert np.allclose(both, 2 * found["u"] - 3 * found["a"], rtol=1e-12)
    for name in named:
        at = []
        size = 1e-5 * max(abs(played.get(name)[0]), 0.0 if "." in name else 1e-2)
        for sign in (1.0, -1.0):
            played.back(before)
            played.put(**{name: played.get(name)[0] + sign * size})
            played.unit.doStep(t, h)
            at.append(played.get(*OUTS))
        quotient = (at[0] - at[1]) / (2 * size)
        rounding = 1e-14 * np.max(np.abs(here)) / size
        scale = 1e-5 * np.max(np.abs(quotient)) + rounding
        assert np.max(np.abs(found[name] - quotient)) <= scale, name
    assert all(np.any(np.abs(found[n]) > 1.0) for n in ("v", "valve_lag.tau"))
    played.unit.freeInstance()
    shutil.rmtree(played.folder)


OWN = '''
from hydrojax.effects import Array, FrictionForce, param


class Drag(FrictionForce):
    """Drag of oil."""

    name = "drag"
    residual_axis = "v"
    c: Array = param("N*s/m", 0.0, 0.0, 1e8, "drag", strength=True, size=2e4)

    def force(self, at):
        return self.c * at.v
'''

ALONE = """
import sys

import fmpy
import numpy as np

table = np.array([(0.0, 0.01), (0.02, 0.01)], [("time", float), ("v", float)])
out = fmpy.simulate_fmu(sys.argv[1], stop_time=0.02, output_interval=1e-3, input=table,
                        start_values={"drag.c": float(sys.argv[2])}, output=["F"])
assert "hydrojax" not in sys.modules and "jax" not in sys.modules
print(repr(float(out["F"][-1])))
"""


def python(*words, cwd):
    root = str(Path(__file__).parents[2])
    return subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, cwd=cwd, timeout=300,
        env={"PYTHONPATH": root, "PATH": "/usr/bin:/bin", "HOME": str(cwd)},
    )  # fmt: skip


@pytest.mark.slow
def test_an_fmu_takes_effects_of_the_users_own_along(fmpy, tmp_path):
    """By the command line; run by another process after their file is gone."""
    rig = "[effects.drag]\nc = '1e4 N*s/m'\n[controller]"
    (tmp_path / "rig.toml").write_text(REFERENCE.replace("[controller]", rig))
    (tmp_path / "mine.py").write_text(OWN)
    words = ["export", "rig.toml", "--to", "fmu", "json", "--effects", "mine.py"]
    done = python("-m", "hydrojax.cli", *words, "--out", "made", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "the sources for any" in done.stdout
    made = tmp_path / "made"
    kinds = {"Reference_rig.fmu", "Reference_rig_fmi3.fmu", "rig.json"}
    assert {p.name for p in made.iterdir()} == kinds
    (tmp_path / "mine.py").unlink()
    F = []
    for c in ("1e4", "3e4"):
        ran = python("-c", ALONE, "Reference_rig.fmu", c, cwd=made)
        assert ran.returncode == 0, ran.stderr
        F.append(float(ran.stdout.splitlines()[-1]))
    # More drag by 2e4 N s/m at 10 mm/s: 200 N of friction, less what presliding takes.
    assert 20.0 < abs(F[0] - F[1]) < 250.0


# -- what cannot be --


@pytest.mark.parametrize(
    ("text", "formats", "says"),
    [
        (REFERENCE, ["jsn"], "--to: unknown format 'jsn'; did you mean 'json'?"),
        (REFERENCE, [], "--to: name one or more of toml, json"),
        (REFERENCE.replace("k_p =", "k_q ="), ["c"], r"[controller] unknown key 'k_q'"),
    ],
)
def test_what_cannot_be_written_is_said_in_one_line(text, formats, says, tmp_path):
    with pytest.raises(InputError) as error:
        export.export(spec_of(text, tmp_path), formats)
    assert says in str(error.value) and "\n" not in str(error.value)


def test_an_axis_without_a_valve_has_friction_only(fmpy, tmp_path):
    text = (
        'layout = "driven-axis"\n[parameters]\nk_cp = "20 N"\nk_cn = "20 N"\n'
        '[effects.payload_inertia]\nm = "95 kg"\n[effects.viscous_friction]\n'
        'b = "204 N*s/m"\n'
    )
    spec = spec_of(text, tmp_path)
    tree = json.loads(one(spec, "json"))
    assert "beta" not in tree["parameters"] and tree["controller"] == {}
    assert set(export.export(spec, ["c"]).files) == {"plant.h", "plant.c"}
    fmu, _ = write_fmu(spec, tmp_path)
    t = np.arange(2001) * 1e-3
    table = np.empty(t.size, [(n, float) for n in ("time", "P", "x", "v", "a")])
    table["time"], table["P"], table["a"] = t, 100.0, 0.1
    table["x"], table["v"] = 0.05 * t**2, 0.1 * t
    out = fmpy.simulate_fmu(str(fmu), stop_time=2.0, output_interval=1e-3, input=table)
    # Sliding at 0.2 m/s: P - friction - m a; L(t) leaves 1e-5 of friction.
    assert out["F"][-1] == pytest.approx(100 - 20 - 204 * 0.2 - 95 * 0.1, rel=5e-5)
    bench = spec_of(text.replace("driven-axis", "tester"), tmp_path)
    fmu, _ = write_fmu(bench, tmp_path)
    names = [v.name for v in fmpy.read_model_description(str(fmu)).modelVariables]
    assert "x" in names and "P" not in names
    out = fmpy.simulate_fmu(str(fmu), stop_time=2.0, output_interval=1e-3, input=table)
    assert out["F"][-1] == pytest.approx(-20 - 204 * 0.2 - 95 * 0.1, rel=5e-5)


def test_the_command_line_refuses_to_overwrite_the_rig(tmp_path):
    (tmp_path / "rig.toml").write_text(REFERENCE)
    words = ["export", "rig.toml", "--to", "toml", "--out", "."]
    done = python("-m", "hydrojax.cli", *words, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.strip() == (
        "hydrojax: rig.toml: would be overwritten; name another folder with --out"
    )
    assert (tmp_path / "rig.toml").read_text() == REFERENCE


def test_toml_keeps_another_controller_than_the_papers(tmp_path):
    spec = with_controller(spec_of(REFERENCE, tmp_path), "pi")
    tree = json.loads(one(spec, "json"))["controller"]
    assert {"k_p", "k_i", "k_v", "rate"} <= set(tree) and "kappa" not in tree
    (tmp_path / "out.toml").write_bytes(one(spec, "toml"))
    again = RigFile.load(tmp_path / "out.toml")
    assert again.controller["kind"] == "pi"
    assert file_keys(again) == file_keys(spec)
