"""The order of the rooms, read from their imports; what an import may do; packaging."""

import ast
import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.house import arrows, circles, imports, modules, under

ROOT = Path(__file__).parent.parent
ROOF = ("hydrojax.api", "hydrojax.cli", "hydrojax.demo", "hydrojax.workflows")
"""What may import both identification and tuning."""

MODULES = modules()


def seen(module: str) -> set[str]:
    """What a module imports, as `benchmarks.house` reads it."""
    return imports(module, MODULES[module])


def test_the_reader_of_imports_reads():
    """What the tests below rest on, seen where it is known."""
    assert "hydrojax.plant.rig" in seen("hydrojax.plant.replay")
    assert "hydrojax.parameters.param" in seen("hydrojax.effects.fluid")
    assert "hydrojax.plant.replay" in seen("hydrojax.identify.estimation.columns")
    assert {"hydrojax.tune", "hydrojax.effects"} <= set(MODULES)


@pytest.mark.parametrize("module", MODULES)
def test_rooms_keep_their_order(module):
    if module == "hydrojax" or any(under(module, roof) for roof in ROOF):
        return
    inner = [p for p in ("hydrojax.identify", "hydrojax.tune") if not under(module, p)]
    known = seen(module)
    for package in (*inner, *ROOF, "identify", "tune"):
        assert not [name for name in known if under(name, package)]


def test_rooms_have_no_circles():
    """Imports for types included."""
    assert not circles(arrows())


def test_a_circle_is_seen():
    graph = {"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}
    assert circles(graph) == [["b", "c"]]


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
    """Processor time of one process, the least of three; a sweep of the garbage
    collector, which falls here or there, is 0.1 of it. Libraries that are slow to
    import are not loaded.
    """
    code = """
import sys
from time import process_time as now
start = now()
import jax
middle = now()
import hydrojax, hydrojax.plant.rig, hydrojax.plant.replay, hydrojax.control.loop
print((now() - start) / (middle - start))
print(*{"scipy", "pandas", "pint", "pydantic", "matplotlib"}.intersection(sys.modules))
"""
    seen = [python(code, tmp_path).stdout.splitlines() for _ in range(3)]
    assert [loaded for _, loaded in seen] == [""] * 3
    assert min(float(ratio) for ratio, _ in seen) < 1.7


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
