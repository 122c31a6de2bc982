"""Setting JAX up: what reaches XLA, when it is too late, and what compiles nothing."""

from __future__ import annotations

import gc
import math
import os
import subprocess
import sys
import weakref
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hydrojax import jax_setup
from hydrojax.identify import api
from hydrojax.identify import case as cases
from hydrojax.identify.case import Case, open_case
from hydrojax.identify.estimation.columns import ParametricRig, basis, filled
from hydrojax.identify.estimation.misfit import sums
from hydrojax.programs import compiled as programs

LOOP = """
import jax, jax.numpy as jnp
def step(c, _):
    return (c[1], 0.5 * c[0] + jnp.sin(c[1])), c[0]
out = jax.jit(lambda a: jax.lax.scan(step, (a, a), None, length=50)[1])(jnp.arange(3.0))
print(jax.config.jax_enable_x64, float(out.sum()))
"""


def python(text: str, **flags: str) -> str:
    """What a fresh process prints."""
    own = {k: v for k, v in os.environ.items() if k != "XLA_FLAGS"} | flags
    done = subprocess.run(
        [sys.executable, "-c", text], env=own, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_every_setting_is_taken_by_this_xla_and_changes_no_result():
    said = {
        python(
            f"from hydrojax.jax_setup import *\nprint(set_up_jax(work={work!r}))" + LOOP
        )
        for work in (jax_setup.FITS, jax_setup.LOOPS)
    }
    assert len(said) == 1
    assert said.pop().startswith("True\nTrue ")


def test_the_users_own_options_are_left_alone():
    own = "--xla_backend_extra_options=xla_cpu_use_multi_output_fusion=false"
    text = "import os\nfrom hydrojax.jax_setup import *\nset_up_jax(work=LOOPS)\n"
    assert python(text + "print(os.environ['XLA_FLAGS'])", XLA_FLAGS=own) == own


@pytest.mark.parametrize("asked", [{}, {"JAX_PLATFORMS": "cuda,cpu"}])
def test_fits_keep_to_the_processor_unless_told_otherwise(asked, tmp_path):
    text = """
from hydrojax.jax_setup import set_up_fits
set_up_fits()
import jax
print(jax.config.jax_platforms)
"""
    wanted = asked.get("JAX_PLATFORMS", "cpu")
    asked = {"JAX_PLATFORMS": "", "XDG_CACHE_HOME": str(tmp_path)} | asked
    assert python(text, **asked).strip() == wanted


def test_too_late_is_said_and_the_rest_holds():
    said = python(
        "import jax, warnings\njax.devices()\nfrom hydrojax.jax_setup import *\n"
        "with warnings.catch_warnings(record=True) as heard:\n"
        "    warnings.simplefilter('always')\n"
        "    print(set_up_jax(), heard[0].message, jax.config.jax_enable_x64)"
    )
    assert said.startswith("False JAX is running already") and said.endswith("True")


ARENAS = """
import ctypes, threading
from hydrojax.jax_setup import set_up_jax
set_up_jax()
libc, together = ctypes.CDLL("libc.so.6"), threading.Barrier(8)
libc.malloc.restype = ctypes.c_void_p
def work():
    together.wait()
    libc.malloc(1000)
    together.wait()
threads = [threading.Thread(target=work) for _ in range(8)]
[t.start() for t in threads]
[t.join() for t in threads]
libc.malloc_info(0, ctypes.c_void_p.in_dll(libc, "stdout"))
libc.fflush(None)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="asks glibc")
def test_threads_share_mallocs_arenas_unless_the_user_says_how_many():
    assert python(ARENAS).count("<heap nr") == jax_setup.ARENAS
    assert python(ARENAS, MALLOC_ARENA_MAX="5").count("<heap nr") == 5


@pytest.mark.parametrize("count", [1, 7, 8, 9, 33, 90, 180, 296, 23_499, 80_001])
def test_buckets_hold_what_is_put_in_and_waste_little(count):
    for least in (1, 8):
        size = jax_setup.bucket(count, least)
        assert size >= count
        assert size - count < max(least, 0.25 * count + 1)
    assert len({jax_setup.bucket(n) for n in range(8, 8 * 2**10 + 1)}) <= 4 * 10 + 4


def cut_files(source: Path, folder: Path, rows: int) -> Path:
    """The files of a recorded case with its logs cut short at their end."""
    folder.mkdir()
    (folder / "rig.toml").write_text((source / "rig.toml").read_text())
    for path in source.glob("*.csv"):
        lines = path.read_text().splitlines()[:-rows]
        (folder / path.name).write_text("\n".join(lines) + "\n")
    return folder


def cut(source: Path, folder: Path, rows: int) -> Case:
    """A recorded case with its logs cut short at their end."""
    cut_files(source, folder, rows)
    logs = [folder / "fit_1.csv", folder / "fit_2.csv"]
    return open_case(folder / "rig.toml", logs, [folder / "validate.csv"])


def test_programs_on_disk_are_bounded_the_last_used_stay(tmp_path):
    for i in range(20):
        (tmp_path / f"program_{i}-cache").write_bytes(b"x" * 1000)
        os.utime(tmp_path / f"program_{i}-cache", (1e9 + i, 1e9 + i))
    jax_setup.trim(tmp_path, 20_000)
    assert len(list(tmp_path.iterdir())) == 20
    jax_setup.trim(tmp_path, 10_000)
    left = sorted(int(p.name[8:-6]) for p in tmp_path.iterdir())
    assert left == list(range(13, 20))
    jax_setup.trim(tmp_path / "none", 0)


@pytest.mark.slow
def test_windows_that_fill_up_change_nothing(recorded, tmp_path):
    case = cut(recorded(1), tmp_path / "short", 700)
    problem = api.fit_case(case, starts=1).problem
    values, batch = problem.initial_values(), problem.batch
    more = filled(batch)
    assert len(more.P_0) == jax_setup.bucket(len(batch.P_0)) > len(batch.P_0)
    assert np.sum(more.weight) == len(batch.P_0)
    found = problem.sums_at(values)
    model = problem.model
    directions = basis(model, model.names, _every(model))
    wanted = jax.jit(lambda v, b: sums(model, v, directions, b, True))(values, batch)
    for got, want in zip(found, wanted, strict=True):
        assert got.shape == want.shape
        assert np.allclose(got, want, rtol=1e-9, atol=1e-9 * np.max(np.abs(want)))


def _every(model: ParametricRig) -> tuple[int, int]:
    return model.hydraulic, len(model.names) - model.hydraulic


@pytest.mark.slow
def test_logs_of_another_length_and_rig_compile_nothing(recorded, tmp_path, compiled):
    api.identify(cut(recorded(1), tmp_path / "one", 100), starts=1)
    compiled.clear()
    api.identify(cut(recorded(6), tmp_path / "other", 450), starts=1)
    assert compiled == []


def test_a_program_of_pytrees_is_compiled_once_for_each_structure():
    """Two threads that want it at once wait for one; what it was traced from goes."""
    traced: list[weakref.ref] = []

    @programs.program_of_pytrees
    def weighed(parts, squared: bool):
        traced.append(weakref.ref(parts["a"]))
        total = parts["a"] * parts["factor"] + jnp.sum(parts["b"])
        return {"total": total**2 if squared else total}

    def parts(factor: float, n: int = 3):
        return {"a": np.full(n, 2.0), "b": jnp.ones(4), "factor": factor}

    with ThreadPoolExecutor(2) as pool:
        both = list(pool.map(lambda f: weighed(parts(f), False), (3.0, 3.0)))
    for out in both:
        np.testing.assert_array_equal(out["total"], np.full(3, 10.0))
    assert len(traced) == 1
    np.testing.assert_array_equal(weighed(parts(3.0), True)["total"], [100.0] * 3)
    np.testing.assert_array_equal(weighed(parts(5.0), False)["total"], [14.0] * 3)
    np.testing.assert_array_equal(weighed(parts(3.0, 2), False)["total"], [10.0] * 2)
    assert len(traced) == 4
    gc.collect()
    assert [seen() for seen in traced] == [None] * 4
    weighed(parts(5.0), False)
    assert len(traced) == 4
    programs.make_room(share=0.0)
    weighed(parts(5.0), False)
    assert len(traced) == 5


def test_a_process_for_each_core_holds_a_quarter_of_the_memory():
    gib = 2**30
    assert programs._full(24 * gib, 2) == 3 * gib
    assert programs._full(64 * gib, 2) == 4 * gib
    assert programs._full(64 * gib, 64) == gib
    assert programs._full(0, 4) == gib  # a system that does not say
    assert gib <= programs._full() <= 4 * gib


def test_programs_that_were_not_used_for_long_go_where_much_is_held(monkeypatch):
    traced: list[int] = []

    @programs.program_of_pytrees
    def double(a):
        traced.append(a.size)
        return 2 * a

    monkeypatch.setattr(programs, "_PROGRAMS", OrderedDict())
    monkeypatch.setattr(programs, "_LEFT", [0])
    monkeypatch.setattr(programs, "FULL", math.inf)
    for n in (1, 2, 3, 4, 1):
        double(np.ones(n))
    assert traced == [1, 2, 3, 4]
    monkeypatch.setattr(programs, "FULL", 0)
    double(np.ones(5))  # 2 and 3 go for it
    traced.clear()
    monkeypatch.setattr(programs, "FULL", math.inf)
    for n in (4, 1, 5, 2, 3):
        np.testing.assert_array_equal(double(np.ones(n)), np.full(n, 2.0))
    assert traced == [2, 3]
    monkeypatch.setattr(programs, "FULL", 0)
    monkeypatch.setattr(programs, "_LEFT", [2**40])  # what the process held last time
    traced.clear()
    for n in (6, 4, 1, 5, 2, 3):  # it has not grown since: none goes
        double(np.ones(n))
    assert traced == [6]
    monkeypatch.setattr(programs, "ROOM", -(2**30))
    programs.make_room(share=0.0)  # what is held counts anew once all have gone
    traced.clear()
    for n in (1, 2, 3, 1):  # the first goes for the third
        double(np.ones(n))
    assert traced == [1, 2, 3, 1]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_programs_are_let_go_before_the_kernel_runs_out_of_mappings(recorded, tmp_path):
    def mapped() -> int:
        return len(Path("/proc/self/maps").read_text().splitlines())

    case = cut(recorded(1), tmp_path / "one", 100)
    before = api.identify(case, starts=1)
    held = mapped()
    assert not programs.make_room()
    allowed = int(Path("/proc/sys/vm/max_map_count").read_text())
    assert programs.make_room(0.9 * held / allowed)
    assert mapped() < held - 1000
    again = api.identify(case, starts=1)
    assert again.parameters == before.parameters


def test_programs_of_another_structure_go_where_much_is_held(
    recorded, tmp_path, monkeypatch
):
    asked: list[float] = []
    monkeypatch.setattr(cases, "make_room", lambda held: asked.append(held))
    monkeypatch.setattr(cases, "_BEFORE", [])
    one = cut_files(recorded(1), tmp_path / "one", 100)
    other = cut_files(recorded(1), tmp_path / "other", 100)
    with (other / "rig.toml").open("a") as file:
        file.write('\n[effects.internal_leakage]\nc_il = "1e-13 m^3/(s*Pa)"\n')
    for folder in (one, one, other, other, one):
        open_case(folder / "rig.toml", [folder / "fit_1.csv"])
    never, held = math.inf, programs.HELD
    assert asked == [held, never, held, never, held]
