"""Damaged input: an answer or one line, whatever is in the file.

The mutations are those of `benchmarks.damage`, which runs them by the thousand.
"""

from __future__ import annotations

import json
import random
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from benchmarks.damage import __main__ as damage
from benchmarks.damage import doors, fuzz, readers
from benchmarks.damage.mutations import damaged_log, damaged_rig
from benchmarks.damage.samples import samples
from hydrojax import units
from hydrojax.errors import InputError
from hydrojax.logs.log import Log
from hydrojax.logs.tables import SIGNALS
from hydrojax.rigfile.schema import RigFile
from hydrojax.rigfile.sections import GEOMETRY, LOAD

many = settings(
    max_examples=250, deadline=None, derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)  # fmt: skip
seeds = st.integers(0, 10**9)


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> tuple[Path, dict[str, float]]:
    """A folder with a sound rig.toml and log.csv, and the truth."""
    folder = tmp_path_factory.mktemp("damage")
    return folder, damage.sound(folder)


def one_line(path: Path, error: InputError) -> None:
    """The refusal names the file, in one line that can be printed."""
    said = str(error)
    assert said and "\n" not in said and "\r" not in said and path.name in said


def log_is_sound_or_refused(path: Path) -> None:
    try:
        log = Log.load(path)
    except InputError as error:
        one_line(path, error)
        return
    assert np.all(np.diff(log.time) > 0)
    for start, stop in log.segments:
        assert stop - start > 1
        for name, values in log.signals.items():
            assert name in SIGNALS
            assert name == "F_d" or np.isfinite(values[start:stop]).all()


def rig_is_sound_or_refused(path: Path) -> None:
    try:
        spec = RigFile.load(path)
    except InputError as error:
        one_line(path, error)
        return
    for entry in spec.parameters.values():
        assert np.isfinite(entry.start)
        low, high = entry.range or (entry.start, entry.start)
        assert low <= entry.start <= high


@pytest.mark.slow
@pytest.mark.parametrize(
    "name, mutated, read_or_refused",
    [
        ("log.csv", damaged_log, log_is_sound_or_refused),
        ("rig.toml", damaged_rig, rig_is_sound_or_refused),
    ],
)
@many
@given(seed=seeds)
def test_a_mutated_file(bench, tmp_path, name, mutated, read_or_refused, seed):
    path = tmp_path / name
    path.write_bytes(mutated((bench[0] / name).read_bytes(), random.Random(seed))[0])
    read_or_refused(path)


words = st.text(max_size=12)
numbers = st.one_of(st.floats(), st.integers(), st.booleans())
some_units = st.sampled_from(
    [
        "s",
        "ms",
        "V",
        "1",
        "Pa",
        "bar",
        "N",
        "m",
        "m^2",
        "rad",
        "deg",
        "m/s",
        "N*s/m",
        "kg",
    ]
)
headings = st.one_of(
    words, st.builds("{} [{}]".format, st.sampled_from(list(SIGNALS)), some_units)
)


@many
@given(
    names=st.lists(headings, min_size=1, max_size=8),
    cells=st.lists(st.one_of(numbers, words), min_size=1, max_size=30),
    rows=st.sampled_from([0, 1, 49, 50, 700]),
)
def test_any_table_is_read_or_refused(tmp_path, names, cells, rows):
    """Columns repeat what is drawn; a sound clock gets more of them past the door."""
    lines = [",".join(names)]
    for i in range(rows):
        row = [str(cells[(i + 7 * j) % len(cells)]) for j in range(len(names))]
        if names[0].startswith("time"):
            row[0] = f"{1e-3 * i:.3f}"
        lines.append(",".join(row))
    path = tmp_path / "bad.csv"
    path.write_text("\n".join(lines), encoding="utf-8", errors="replace")
    log_is_sound_or_refused(path)


@many
@given(content=st.binary(max_size=300), ending=st.sampled_from(
    [".csv", ".csv.gz", ".parquet", ".mat", ".mcap", ".txt", ""]))  # fmt: skip
@example(b"", ".mat")
@example(b"\x89HDF\r\n\x1a\n", ".mat")
@example(b"PAR1", ".parquet")
@example(b"\x1f\x8b", ".csv.gz")
@example(b"MATLAB 5.0 MAT-file" + b" " * 105 + b"\x00\x01IM", ".mat")
def test_any_bytes_are_refused(tmp_path, content, ending):
    path = tmp_path / f"bad{ending}"
    path.write_bytes(content)
    log_is_sound_or_refused(path)


amounts = st.builds(
    "{} {}".format, st.one_of(numbers, words), st.one_of(words, some_units)
)
values = st.recursive(
    st.one_of(numbers, words, amounts),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.dictionaries(st.sampled_from(["start", "range", "column", "unit"]), inner),
    ),
    max_leaves=5,
)
keys = st.sampled_from(
    [*GEOMETRY, *LOAD, *SIGNALS, "beta", "k_cp", "z_ss", "k_p", "internal_leakage"]
)
sections = st.sampled_from(["geometry", "supply", "sensors", "load", "channels",
                            "parameters", "effects", "controller"])  # fmt: skip


def toml(value: object) -> str:
    """A value as TOML writes it; text as JSON does, which TOML reads alike."""
    if isinstance(value, dict):
        inner = ", ".join(f"{json.dumps(k)} = {toml(v)}" for k, v in value.items())
        return f"{{ {inner} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(toml, value))}]"
    if isinstance(value, float) and not np.isfinite(value):
        return str(value)
    return json.dumps(value)


@many
@given(tree=st.dictionaries(sections, st.dictionaries(keys, values, max_size=3)))
def test_any_section_is_read_or_refused(bench, tmp_path, tree):
    whole = (bench[0] / "rig.toml").read_text().split("\n\n")
    kept = [p for p in whole if not any(p.startswith(f"[{s}]") for s in tree)]
    drawn = [
        "\n".join(
            [f"[{s}]", *(f"{json.dumps(k)} = {toml(v)}" for k, v in keys.items())]
        )
        for s, keys in tree.items()
    ]
    path = tmp_path / "bad.toml"
    text = "\n\n".join([*kept, *drawn])
    path.write_text(text, encoding="utf-8", errors="replace")
    rig_is_sound_or_refused(path)


@many
@given(text=st.one_of(words, amounts))
@example("5 Pa**9**9**9")
@example("1 " + "(" * 300)
@example("9" * 400 + " Pa")
def test_any_quantity_is_read_or_refused(text):
    try:
        assert np.isfinite(units.quantity(text, "Pa", "here"))
    except InputError as error:
        assert "here" in str(error) and "\n" not in str(error)


@pytest.mark.slow
def test_a_rig_file_or_a_log_cannot_reach_out(bench, call, tmp_path):
    """No code runs, no other file is read, and nothing is written beside --out."""
    folder, _ = bench
    rig = (folder / "rig.toml").read_text()
    secret = tmp_path / "secret.csv"
    secret.write_text("do not read me")
    (tmp_path / "work").mkdir()
    out = tmp_path / "work" / "out"
    hostile = rig.replace('name = "damage"', 'name = "../../<script>alert(1)</script>"')
    (tmp_path / "rig.toml").write_text(hostile)
    before = {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*")}
    said = call(
        "identify",
        tmp_path / "rig.toml",
        folder / "log.csv",
        "--out",
        out,
        "--starts",
        1,
    )
    assert said.code == 0, said
    after = {
        p: p.stat().st_mtime_ns for p in tmp_path.rglob("*") if out not in p.parents
    }
    del after[out]
    assert after.keys() == before.keys() and not list(folder.parent.glob("*<*"))
    assert "<script>alert(1)" not in (out / "report.html").read_text()
    for column in (str(secret), "__import__('os').remove('x')"):
        line = f'[channels]\nF = {{ column = {json.dumps(column)}, unit = "N" }}\n'
        (tmp_path / "rig.toml").write_text(
            rig.replace("[parameters]", line + "[parameters]")
        )
        said = call("identify", tmp_path / "rig.toml", folder / "log.csv", "--out", out)
        assert said.code == 2 and "do not read me" not in said.err
    assert secret.read_text() == "do not read me"


FITTED = (3, 6, 7, 21, 25, 26)
"""Damage with which the command fits to the end, and longest."""


@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(seed, marks=pytest.mark.slow if seed in FITTED else ())
        for seed in range(30)
    ],
)
def test_the_command_answers_or_refuses(bench, monkeypatch, cache_home, seed):
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache_home))
    folder, truth = bench
    found = damage.one(seed, folder, truth)
    assert not found.fault, found


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    """Sound samples of everything that is read."""
    folder = tmp_path_factory.mktemp("sound")
    samples(folder)
    return folder


def test_every_reader_answers_or_refuses(sound, tmp_path):
    faults = [
        (seed, *readers.one(seed, sound, tmp_path))
        for seed in range(10**6, 10**6 + 150)
    ]
    assert not [found for found in faults if found[2]]
    assert len({name for _, name, _ in faults}) == len(doors.READERS)


def test_a_reader_at_fault_is_found(sound, tmp_path, monkeypatch):
    def broken(path: Path) -> None:
        raise KeyError(path.name)

    monkeypatch.setattr(readers, "READERS", {"words": ("", broken)})
    assert readers.one(0, sound, tmp_path) == ("words", "KeyError: 'words'")


def test_what_fuzzing_kept_is_read_or_refused(sound, tmp_path):
    table = fuzz.kept()
    assert set(table) <= set(doors.READERS) and table["rig.toml"]
    assert fuzz.CORPUS.stat().st_size < 2**18
    for kind, contents in table.items():
        for content in contents:
            (tmp_path / kind).write_bytes(content)
            assert not doors.fault_of(doors.READERS[kind][1], tmp_path / kind)


def test_fuzzing_keeps_what_reaches_something_new(sound, tmp_path):
    """It is led into a branch by the word in it, which no sample holds."""
    from hydrojax.cli.words import read_axes

    coverage = fuzz.Coverage()
    for text, new in (
        ("k_p=1:2:3", True),
        ("k_p=4:5:6", False),
        ("k_p=1:2:3:log", True),
    ):
        with coverage:
            read_axes([text])
        assert bool(coverage.news()) == new, text
    assert b"log" in coverage.words()
    assert {Path(c.co_filename).name for c in coverage.codes} <= {
        "words.py",
        "units.py",
    }
