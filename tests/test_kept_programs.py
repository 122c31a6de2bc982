"""Programs kept on disk: taken where nothing changed, from nobody else, not damaged."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hydrojax.effects.valve import ValveDelay
from hydrojax.programs import compiled, kept


@pytest.fixture
def folder(tmp_path) -> Iterator[Path]:
    """An empty folder for programs, in place of the suite's own."""
    own = jax.config.values["jax_compilation_cache_dir"]
    folder = tmp_path / "programs"
    folder.mkdir(mode=0o700)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    yield folder
    jax.config.update("jax_compilation_cache_dir", own)


class Counted:
    """A function of the package, to all appearance, that counts how often it is traced,
    called as in a process that has no program yet.
    """

    def __init__(self, module: str = "hydrojax.own"):
        self.traced = 0

        def solved(A, b, times: int):
            self.traced += 1
            return times * jnp.linalg.solve(A, b)

        solved.__module__ = module
        self.function = solved
        self.program = compiled.program_of_pytrees(solved)

    def anew(self, times: int = 2) -> np.ndarray:
        for key in [k for k in compiled._PROGRAMS if self.function in k]:
            del compiled._PROGRAMS[key]
        return np.asarray(self.program(np.diag([2.0, 4.0]), np.ones(2), times))


def test_a_kept_program_is_not_traced_again(folder):
    own = Counted()
    np.testing.assert_array_equal(own.anew(), [1.0, 0.5])
    np.testing.assert_array_equal(own.anew(), [1.0, 0.5])
    assert own.traced == 1
    np.testing.assert_array_equal(own.anew(times=4), [2.0, 1.0])
    assert own.traced == 2
    found = sorted(folder.iterdir())
    assert len(found) == 2 and all(p.suffix == kept.SUFFIX for p in found)
    assert all(p.stat().st_mode & 0o077 == 0 for p in found)


@pytest.mark.parametrize("damage", ["cut", "turned", "empty"])
def test_a_damaged_file_is_made_again(folder, damage):
    own = Counted()
    own.anew()
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    turned = whole[:-1] + bytes([whole[-1] ^ 1])
    path.write_bytes({"cut": whole[:-7], "turned": turned, "empty": b""}[damage])
    np.testing.assert_array_equal(own.anew(), [1.0, 0.5])
    assert own.traced == 2
    own.anew()
    assert own.traced == 2


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="owners are POSIX's")
@pytest.mark.parametrize("mode", [0o770, 0o707])
def test_nothing_is_taken_where_others_can_write(folder, mode):
    own = Counted()
    own.anew()
    (path,) = folder.iterdir()
    folder.chmod(mode)
    own.anew()
    assert own.traced == 2
    folder.chmod(0o700)
    path.chmod(mode)
    own.anew()
    assert own.traced == 3


def test_a_file_of_another_owner_is_not_taken(folder, monkeypatch):
    own = Counted()
    own.anew()
    monkeypatch.setattr(os, "geteuid", lambda: 12345, raising=False)
    own.anew()
    assert own.traced == 2


class Mine(NamedTuple):
    """A type that is not the package's."""

    a: np.ndarray


def test_programs_of_other_peoples_code_are_not_kept(folder):
    Counted("somebodys.effects").anew()
    tree = jax.tree.structure(Mine(np.ones(1)))
    function = Counted().function
    assert kept.key_of(function, tree, [None], [np.ones(1)], None) is None
    assert kept.key_of(function, tree.children()[0], [None], [np.ones(1)], None)
    assert not list(folder.iterdir())


def test_classes_that_share_a_name_and_objects_without_a_text_have_no_key():
    function = Counted().function

    def key(a):
        return kept.key_of(function, jax.tree.structure(a), [None], [np.ones(1)], None)

    made = [NamedTuple("Stroke", [("a", float)]) for _ in range(2)]
    for kind in made:
        kind.__module__, kind.__qualname__ = "hydrojax.plant.effect", "Stroke"
        assert key(kind(1.0)) is None
    assert key(ValveDelay()) and key([1.0])
    assert key(ValveDelay(queue=Counted)) is None  # pyright: ignore[reportArgumentType]


def test_sources_edited_since_they_were_loaded_have_no_key(monkeypatch):
    monkeypatch.setattr(kept, "_LOADED", 0.0)
    assert kept._sources() is None


def test_a_key_holds_all_that_a_program_depends_on(folder, monkeypatch):
    three = np.ones(3)

    def key(f="solved", a=three, fixed=2, options=None):
        def function():
            pass

        function.__module__, function.__qualname__ = "hydrojax.own", f
        tree = jax.tree.structure((a, fixed))
        return kept.key_of(function, tree, [None, fixed], [a], options)

    keys = [
        key(),
        key("other"),
        key(a=np.ones(4)),
        key(a=np.ones(3, np.float32)),
        key(fixed=3),
        key(fixed="2"),
        key(options={"xla_cpu_use_fusion_emitters": False}),
    ]
    here = kept._here()
    for i in range(len(here)):
        changed = (*here[:i], here[i] + "x", *here[i + 1 :])
        monkeypatch.setattr(kept, "_here", lambda changed=changed: changed)
        keys.append(key())
    assert None not in keys and len(set(keys)) == len(keys)


FRESH = """
import sys
import jax.numpy as jnp, numpy as np
from pathlib import Path
from hydrojax.jax_setup import set_up_jax
from hydrojax.programs.compiled import program_of_pytrees
set_up_jax(Path(sys.argv[1]))
traced = []
def solved(A, b):
    traced.append(1)
    return jnp.linalg.solve(A, b)
solved.__module__ = "hydrojax.own"
x = program_of_pytrees(solved)(np.diag([2.0, 4.0]), np.ones(2))
print(np.asarray(x), len(traced))
"""


def test_another_process_takes_it_before_anything_has_called_lapack(tmp_path):
    said = [
        subprocess.run(
            [sys.executable, "-c", FRESH, str(tmp_path / "kept")],
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()
        for _ in range(2)
    ]
    assert said == ["[0.5  0.25] 1", "[0.5  0.25] 0"]
    assert (tmp_path / "kept").stat().st_mode & 0o777 == 0o700
