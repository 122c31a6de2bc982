"""One rig file is one plant: nothing but `rigfile.build` makes a rig or its effects."""

from __future__ import annotations

import ast
import importlib
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import jax
import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from hydrojax import effects as vocabulary
from hydrojax.cli import app
from hydrojax.control.adaptive import truth
from hydrojax.control.simulation import hold, make_scenario, simulate_loop
from hydrojax.export.tree import plant
from hydrojax.paper import experiments
from hydrojax.parameters import get, parameter_specs
from hydrojax.plant import rig as rigs
from hydrojax.plant.effect import Effect
from hydrojax.plant.friction import Sliding
from hydrojax.rigfile.build import build_loop, build_rig, over_travel
from hydrojax.rigfile.edit import rewrite
from hydrojax.rigfile.quantities import open_setting
from hydrojax.rigfile.schema import RigFile

RIG = Path(experiments.__file__).with_name("reference.toml").read_text()
WAVY = RIG.replace(
    "[effects.valve_lag]",
    '[effects.position_friction]\ns_1 = "0.3"\nwaves = "2"\n\n[effects.valve_lag]',
)
"""The reference rig with a profile that no key lays over a stretch."""

FADES_LESS = '[effects.friction_at_rest]\ns = "0.6"\n\n'


def level(rig: rigs.Rig, x: float) -> float:
    """Output force while the piston slides at `x`, N."""
    at = Sliding(0.0, x, 0.02, 0.0, 6e-5, 0.0, 0.02, 7e6, 7e6, 14e6, 0.0)
    return float(rig.output_force(Sliding._make(np.asarray(a) for a in at)))


def same_plant(one: rigs.Rig, other: rigs.Rig) -> bool:
    return jax.tree.structure(one) == jax.tree.structure(other) and all(
        np.array_equal(a, b)
        for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    )


def test_friction_that_stays_at_rest_is_the_plants_and_the_laws():
    """With L(0) = 0.4 both hold 0.6 of f_c at rest; the law knows no other effect."""
    text = WAVY.replace("[effects.valve_lag]", FADES_LESS + "[effects.valve_lag]")
    loop = build_loop(RigFile.from_text(text))
    nominal = loop.law.nominal
    assert [e.name for e in nominal.switch] == ["friction_at_rest"]
    assert not any((nominal.command, nominal.level, nominal.friction))
    z, F_d = 4e-5, 80.0
    P_d, _ = loop.law.desired(truth(nominal), z, 0.0, 0.0, F_d)
    f = loop.rig.mechanics
    slides = float(f.k_cp) * z / float(f.z_ss) + float(f.k_0)
    sticks = float(f.k_fp) * F_d / (1 + float(f.delta) * F_d)
    want = F_d + 0.6 * slides + 0.4 * sticks
    assert float(P_d) == pytest.approx(want, rel=1e-12)
    # The plant under that pressure, at the middle of the wave.
    P_2 = 7e6 + want / float(nominal.force_area_2)
    at = Sliding(0.0, 0.0, 0.0, 0.0, z, 0.0, 0.0, 7e6, P_2, 14e6, 0.0)
    F = nominal.output_force(Sliding._make(np.asarray(a) for a in at))
    assert float(F) == pytest.approx(F_d, rel=1e-9)


@pytest.mark.parametrize("length", ["200 mm", "90 mm"])
def test_a_rig_file_is_the_same_plant_everywhere(length):
    """In simulate, in a sweep's setting, in a loop given its rig, and in an export."""
    file = RigFile.from_text(WAVY.replace("200 mm", length))
    rig = build_rig(file)
    assert abs(level(rig, 0.011) - level(rig, 0.0)) > 10  # the profile acts
    named = open_setting(file, extra=("position_friction.s_1", "valve_lag.omega"))
    for other in (
        build_loop(file).rig, build_loop(file, rig).rig, open_setting(file).loop.rig,
        named.loop.rig, plant(file),
    ):  # fmt: skip
        assert same_plant(rig, other)
        assert level(other, 0.02) == level(rig, 0.02)


def test_what_identification_gives_out_is_what_it_fitted():
    """A candidate is laid over the travel of the logs, and the new file says so."""
    case = over_travel(RigFile.from_text(RIG), (-0.013, 0.029))
    values = {"position_friction.s_1": 0.3, "position_friction.waves": 2.0}
    text = rewrite(case, values, ("position_friction",))
    new = build_rig(RigFile.from_text(text))
    fitted = build_rig(case, ("position_friction",))
    fitted = rigs_at(fitted, values)
    for x in np.linspace(-0.02, 0.03, 7):
        assert level(new, x) == pytest.approx(level(fitted, x), rel=1e-6)
    assert same_plant(open_setting(RigFile.from_text(text)).loop.rig, new)


def rigs_at(rig: rigs.Rig, values: dict[str, float]) -> rigs.Rig:
    from hydrojax.parameters import put

    return put(rig, tuple(values), np.array(list(values.values())))


def test_dormant_candidates_do_not_change_a_rig():
    file = RigFile.from_text(RIG)
    bare, more = build_rig(file), build_rig(file, vocabulary.EFFECTS)
    names = tuple(parameter_specs(bare))
    assert np.array_equal(get(bare, names), get(more, names))
    with pytest.raises(KeyError, match="no_such_effect"):
        build_rig(file, ("no_such_effect",))


def test_a_locked_piston_has_a_profile_too(tmp_path):
    """What the profile is laid over does not come from the motion of the run."""
    rig, out = tmp_path / "rig.toml", tmp_path / "log.csv"
    rig.write_text(WAVY)
    words = [
        "simulate", str(rig), "--motion", "locked:3 mm", "--seconds", "0.2", "--out",
        str(out),
    ]  # fmt: skip
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert np.all(np.isfinite(pd.read_csv(out)["F [N]"]))


def test_simulate_runs_the_plant_of_the_file():
    """The same run by the command's way and by the sweep's setting."""
    file = RigFile.from_text(WAVY)
    F_d = 300 * np.sin(np.arange(200) / 30)
    scenario = make_scenario(F_d, hold(5e-3), 1e-3, 14e6, 0.25e6)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        runs = [
            simulate_loop(loop, scenario)["F"]
            for loop in (build_loop(file), open_setting(file).loop)
        ]
    assert np.array_equal(*runs)


# -- the sources --

ROOT = Path(__file__).parents[2]
FOLDERS = {"hydrojax": "hydrojax", "identify": "hydrojax.identify",
           "tune": "hydrojax.tune"}  # fmt: skip
DOOR = "hydrojax.rigfile.build"
AT_HOME = ("hydrojax.effects", "hydrojax.plant", DOOR)
"""Where effects are defined and tried, where rigs are, and the door."""


def sources() -> dict[str, Path]:
    out = {}
    for folder, package in FOLDERS.items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            inside = path.relative_to(ROOT / folder)
            if path.is_symlink() or any(
                p.is_symlink() for p in (ROOT / folder / inside).parents if p != ROOT
            ):
                continue
            parts = inside.with_suffix("").parts
            out[".".join((package, *parts)).removesuffix(".__init__")] = path
    return out


SOURCES = sources()


def value_of(node: ast.expr, names: dict[str, Any]) -> Any:
    """What `a` or `a.b.c` stands for, or None."""
    if isinstance(node, ast.Name):
        return names.get(node.id)
    if isinstance(node, ast.Attribute):
        return getattr(value_of(node.value, names), node.attr, None)
    return None


def visible(tree: ast.AST, module: ModuleType | None) -> dict[str, Any]:
    """The names of a module, with those that its functions import."""
    names = dict(vars(module)) if module else {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            if node.module.partition(".")[0] != "hydrojax":
                continue
            home = importlib.import_module(node.module)
            for alias in node.names:
                found = getattr(home, alias.name, None)
                names[alias.asname or alias.name] = found
    return names


def reads_vocabulary(node: ast.AST, names: dict[str, Any]) -> bool:
    """Whether an expression looks into `EFFECTS`."""
    return any(
        isinstance(n, (ast.Name, ast.Attribute))
        and value_of(n, names) is vocabulary.EFFECTS
        for n in ast.walk(node)
    )


def targets(node: ast.AST) -> Iterator[str]:
    return (n.id for n in ast.walk(node) if isinstance(n, ast.Name))


def makes(tree: ast.AST, module: ModuleType | None = None) -> list[str]:
    """Calls in a source that make an effect or a rig, or put effects into one."""
    names = visible(tree, module)
    makers = [rigs.Rig, rigs.add, rigs.bare_rig]
    drawn = set()  # variables that stand for a class out of the vocabulary
    for node in ast.walk(tree):
        if isinstance(node, (ast.For, ast.comprehension)):
            if reads_vocabulary(node.iter, names):
                drawn |= set(targets(node.target))
        elif isinstance(node, ast.Assign) and reads_vocabulary(node.value, names):
            for target in node.targets:
                drawn |= set(targets(target))
    out = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        called = value_of(node.func, names)
        from_class = isinstance(called, type) and issubclass(called, Effect)
        from_table = isinstance(node.func, ast.Subscript) and reads_vocabulary(
            node.func, names
        )
        from_name = isinstance(node.func, ast.Name) and node.func.id in drawn
        if from_class or from_table or from_name or called in makers:
            out.append(f"line {node.lineno}: {ast.unparse(node)[:60]}")
    return out


@pytest.mark.parametrize("name", SOURCES)
def test_nothing_but_the_door_makes_rigs_and_effects(name):
    if any(name == home or name.startswith(home + ".") for home in AT_HOME):
        return
    if name.endswith("__main__"):
        return
    tree = ast.parse(SOURCES[name].read_text(encoding="utf-8"))
    assert not makes(tree, importlib.import_module(name))


def test_the_reader_of_sources_reads():
    """Every way round the door, as it might be written, is seen; the door too."""
    ways = """
from hydrojax.effects import EFFECTS, ViscousFriction
from hydrojax import effects
from hydrojax.plant.rig import add, bare_rig
def one(): return ViscousFriction(c=1.0)
def two(): return EFFECTS["stribeck"]()
def three(): return {n: e() for n, e in EFFECTS.items() if n}
def four():
    chosen = EFFECTS["stribeck"]
    return chosen()
def five(): return add(bare_rig("pull-pull", {}), ())
def six(): return effects.ViscousFriction()
"""
    assert len(makes(ast.parse(ways))) == 7
    assert not makes(ast.parse("from hydrojax.effects import EFFECTS\nlen(EFFECTS)"))
    assert len(makes(ast.parse(SOURCES[DOOR].read_text()))) >= 3
