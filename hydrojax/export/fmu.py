"""The plant as a functional mock-up unit, FMI 2.0 for co-simulation, by PythonFMU."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hydrojax.effects import EFFECTS
from hydrojax.effects.registry import file_of
from hydrojax.errors import InputError
from hydrojax.export import slave
from hydrojax.export.text import toml_of
from hydrojax.rigfile.schema import RigFile

SCRIPT = '''"""A rig as an FMI slave: needs hydrojax in the Python that runs it."""

from pythonfmu import Fmi2Slave

from hydrojax.export.slave import HELD, Plant

HELD.append(globals())


class HydrojaxPlant(Plant, Fmi2Slave):
    pass
'''

MODULE = "hydrojax_plant"


def fmu_of(spec: RigFile) -> bytes:
    """A rig as an FMU: what its file holds.

    The rig lies in the resources, and with it the Python files of the effects of the
    user's own that it declares.

    Raises:
        InputError: PythonFMU is not installed, the rig cannot be run, or its valve is
            a user's own, which the resources cannot hold.
    """
    if spec.valve is not None:
        raise InputError(
            f"{spec.path}: an FMU cannot hold the valve {type(spec.valve).__name__}; "
            "expected a rig file's own"
        )
    try:
        from pythonfmu.builder import FmuBuilder
    except ImportError as err:
        raise InputError(
            "--to fmu: an FMU is built by PythonFMU, which is not installed; "
            "pip install 'hydrojax[fmu]'"
        ) from err
    with tempfile.TemporaryDirectory() as name, _modules_as_they_were():
        folder = Path(name)
        files = {slave.RIG: toml_of(spec)} | _own_effects(spec)
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8")
        script = folder / f"{MODULE}.py"
        script.write_text(SCRIPT, encoding="utf-8")
        built = FmuBuilder.build_FMU(
            script, folder / "built.fmu", [folder / file for file in files]
        )
        return Path(built).read_bytes()


def _own_effects(spec: RigFile) -> dict[str, str]:
    """The files of the user's own effects, and which effects are in which, by name."""
    homes: dict[Path, list[str]] = {}
    for name in spec.effects:
        home = file_of(EFFECTS[name])
        if home:
            homes.setdefault(home, []).append(name)
    files = {
        f"own_effects_{i}.py": home.read_text(encoding="utf-8-sig")
        for i, home in enumerate(homes)
    }
    index = dict(zip(files, homes.values(), strict=True))
    return {slave.EFFECTS: json.dumps(index)} | files


@contextmanager
def _modules_as_they_were() -> Iterator[None]:
    """Undo what the builder leaves in this process: a path, and a module by name."""
    path, module = list(sys.path), sys.modules.pop(MODULE, None)
    try:
        yield
    finally:
        sys.path[:] = path
        sys.modules.pop(MODULE, None)
        if module is not None:
            sys.modules[MODULE] = module
