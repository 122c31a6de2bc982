"""The order of the rooms, read from their imports; what an import may do; packaging."""

import ast
import graphlib
import importlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
ROOMS = {
    "hydrojax": "hydrojax",
    "identify": "hydrojax.identify",
    "tune": "hydrojax.tune",
}
"""Folders and the packages they are."""

ROOF = (
    "hydrojax.cli",
    "hydrojax.demo",
    "hydrojax.workflows.fleet",
    "hydrojax.workflows.friction_bounds",
)
"""What may see the whole house."""


def under(module: str, package: str) -> bool:
    return module == package or module.startswith(package + ".")


def modules() -> dict[str, Path]:
    """Every module of the house and its file."""
    out = {}
    for folder, package in ROOMS.items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            inner = path.relative_to(ROOT / folder).with_suffix("").parts
            out[".".join((package, *inner)).removesuffix(".__init__")] = path
    return out


MODULES = modules()


def only_for_types(node: ast.AST) -> bool:
    """Whether this is `if TYPE_CHECKING:`, which never runs."""
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


def walk(node: ast.AST, types: bool) -> Iterator[ast.AST]:
    """Every node below, those of `if TYPE_CHECKING:` only if `types`."""
    for child in ast.iter_child_nodes(node):
        if types or not only_for_types(child):
            yield child
            yield from walk(child, types)


def imports(module: str, types: bool = True) -> set[str]:
    """What a module imports anywhere in its text, as absolute names.

    `from a import b` gives both `a` and `a.b`: the name may be a module.
    """
    path, out = MODULES[module], set()
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    for node in walk(ast.parse(path.read_text(encoding="utf-8")), types):
        if isinstance(node, ast.Import):
            out |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                stem = package.split(".")
                stem = stem[: len(stem) - node.level + 1]
                base = ".".join([*stem, base] if base else stem)
            out |= {base} | {f"{base}.{alias.name}" for alias in node.names}
    return out


def test_the_reader_of_imports_reads():
    """What the tests below rest on, seen where it is known."""
    assert "hydrojax.plant.rig" in imports("hydrojax.plant.replay")
    assert "hydrojax.parameters.param" in imports("hydrojax.effects.fluid")
    assert "hydrojax.plant.replay" in imports("hydrojax.identify.estimation.columns")
    assert {"hydrojax.tune", "hydrojax.effects"} <= set(MODULES)


@pytest.mark.parametrize("module", MODULES)
def test_rooms_keep_their_order(module):
    if any(under(module, roof) for roof in ROOF):
        return
    inner = [p for p in ("hydrojax.identify", "hydrojax.tune") if not under(module, p)]
    seen = imports(module)
    for package in (*inner, *ROOF, "identify", "tune"):
        assert not [name for name in seen if under(name, package)]


def test_rooms_have_no_circles():
    """A package named only on the way to a module of its own does not count."""
    arrows = {
        m: {n for n in imports(m, types=False) & set(MODULES) if not under(m, n)}
        for m in MODULES
    }
    graphlib.TopologicalSorter(arrows).prepare()  # raises CycleError


# -- what an import does --


def python(code: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    env = {k: v for k, v in os.environ.items() if not k.startswith("JAX_ENABLE")}
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=cwd, env=env
    )


def is_simulator(module: str) -> bool:
    """Whether a module stands below the other rooms and the roof."""
    others = ("hydrojax.identify", "hydrojax.tune", *ROOF)
    return not any(under(module, other) for other in others)


def test_importing_does_nothing_else(tmp_path):
    """No word, no global setting, no file, and matplotlib only where pictures are."""
    quiet = [m for m in MODULES if is_simulator(m) and not m.endswith("figures")]
    code = f"""
import importlib, json, sys, jax
before = dict(jax.config.values)
for name in {quiet!r}:
    importlib.import_module(name)
changed = [k for k, v in jax.config.values.items() if before.get(k) != v]
with open("seen.json", "w") as file:
    json.dump({{"x64": jax.config.jax_enable_x64, "changed": changed,
               "matplotlib": "matplotlib" in sys.modules}}, file)
"""
    done = python(code, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout == done.stderr == ""
    seen = json.loads((tmp_path / "seen.json").read_text())
    assert seen == {"x64": False, "changed": [], "matplotlib": False}
    assert [p.name for p in tmp_path.iterdir()] == ["seen.json"]


def test_importing_the_simulator_costs_little_beside_jax(tmp_path):
    """Processor time of one process, the least of three."""
    code = """
from time import process_time as now
start = now()
import jax
middle = now()
import hydrojax, hydrojax.plant.rig, hydrojax.plant.replay, hydrojax.control.loop
print((now() - start) / (middle - start))
"""
    assert min(float(python(code, tmp_path).stdout) for _ in range(3)) < 1.5


@pytest.mark.parametrize("name", ["identify", "tune"])
def test_a_bare_room_says_whose_it_is(name):
    """Both names belong to other packages; from the root they would be found."""
    done = python(f"import {name}", ROOT)
    assert done.returncode != 0
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("ImportError:") and f"hydrojax.{name}" in last


def test_what_benchmarks_and_documents_import_is_there():
    """They are run rarely, and import where they need it."""
    files = [*(ROOT / "benchmarks").rglob("*.py"), *(ROOT / "docs").rglob("*.py")]
    missing = [
        f"{path.name}: {node.module}.{alias.name}"
        for path in files
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and not node.level
        and (node.module or "").startswith(("hydrojax", "benchmarks", "tests"))
        for alias in node.names
        if not _has(node.module or "", alias.name)
    ]  # fmt: skip
    assert not missing


def _has(module: str, name: str) -> bool:
    try:
        importlib.import_module(f"{module}.{name}")
    except ModuleNotFoundError:
        return hasattr(importlib.import_module(module), name)
    return True


# -- packaging --


def test_every_folder_with_modules_is_a_package():
    for path in MODULES.values():
        assert (path.parent / "__init__.py").exists()
