"""Logs made to read other files, to fill the memory, or never to end."""

from __future__ import annotations

import gzip
import os
import struct
import time
import zipfile
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse

from hydrojax.errors import InputError
from hydrojax.logs.log import Log
from hydrojax.logs.tables import Channel
from hydrojax.workflows.fleet.work import memory
from tests.logs.test_logs import a_run, edited, refusal, write

MIB = 2**20


def refused_at_once(path: Path, *words: str, **options) -> str:
    """Refused, within seconds and without much memory beyond what is held already."""
    before, began = memory(), time.process_time()
    line = refusal(path, *words, **options)
    assert time.process_time() - began < 2
    assert memory() - before < 300 * MIB
    assert len(line) < 1500
    return line


# -- headings --


def test_a_heading_with_a_line_break_is_the_column(tmp_path):
    run = {k.replace("P_a1 [bar]", "P_a1 [bar\n]"): v for k, v in a_run().items()}
    log = Log.load(write(tmp_path / "log.csv", run))
    np.testing.assert_allclose(log.signals["P_a1"], 1e5 * run["P_a1 [bar\n]"])


@pytest.mark.parametrize("heading", ["[" * 60_000, "a" * 100_000, f"x{' ' * 60_000}]"])
def test_an_endless_heading(tmp_path, heading):
    path = write(tmp_path / "log.csv", a_run() | {heading: a_run()["u [V]"]})
    refused_at_once(path, "too long")


def test_a_first_line_that_never_ends(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"1," * MIB)
    refused_at_once(path, "first line")


@pytest.mark.parametrize("unit", ["Pa*9^(9*9*9*9*9*9*9*9*9)", "9⁹⁹⁹⁹⁹⁹⁹⁹", "9^9^9^9"])
def test_a_unit_that_is_a_computation(tmp_path, unit):
    refused_at_once(edited(tmp_path, P_a1=f"P_a1 [{unit}]"), "unknown unit")


def test_names_of_files_and_columns_cannot_write_to_the_terminal(tmp_path):
    run = a_run() | {"\x1b[2Jgone": a_run()["u [V]"]}
    path = write(tmp_path / "\x1b[31mred\n.csv", run)
    log = Log.load(path)
    assert log.name == r"\x1b[31mred\n.csv"
    assert all(label.isprintable() for label in log.ignored)
    with pytest.raises(InputError) as caught:
        Log.load(path, {"u": Channel(column="\x1b[2J\nu")})
    assert str(caught.value).isprintable()


def test_a_name_that_is_no_text(tmp_path):
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/log\xff.csv"))
    assert Log.load(write(path, a_run())).name.encode() == "log\ufffd.csv".encode()


# -- files that expand --


def test_a_gzipped_log_that_expands_without_end(tmp_path):
    path = tmp_path / "log.csv.gz"
    head, rows = b"time [s],u [V]\n", b"0,0\n" * MIB
    with gzip.open(path, "wb", compresslevel=9) as file:
        file.write(head)
        for _ in range(20):
            file.write(rows)
    assert path.stat().st_size < MIB
    before = memory()
    refusal(path, "less compression")
    assert memory() - before < 1000 * MIB


def mat(*elements: bytes) -> bytes:
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"".join(elements)


def matrix(kind: int, size: int, inner: bytes = b"", name: bytes = b"F") -> bytes:
    body = struct.pack("<IIII", 6, 8, kind, 0) + struct.pack("<IIii", 5, 8, size, 1)
    body += struct.pack("<II", 1, len(name)) + name.ljust(8, b"\0") + inner
    return struct.pack("<II", 14, len(body)) + body


def nested(depth: int) -> bytes:
    size, parts = len(matrix(1, 1)), []
    for i in range(depth):
        whole = matrix(1, 1)
        inner = (depth - i) * size - 8
        parts.append(whole[:4] + struct.pack("<I", inner) + whole[8:])
    return b"".join(parts)


@pytest.mark.parametrize(
    "content, word",
    [
        (mat(nested(100_000)), "nested"),  # overruns the stack in SciPy
        (mat(matrix(1, 2**30)), "elements"),  # takes 8 GiB in SciPy
        (mat(matrix(2, 2**30)), "elements"),
        (b"\0" * 200, "v5"),
    ],
)
def test_a_mat_file_that_claims_much(tmp_path, content, word):
    path = tmp_path / "log.mat"
    path.write_bytes(content)
    refused_at_once(path, word)


def test_a_mat_file_that_expands_without_end(tmp_path):
    zipped = zlib.compress(b"\0" * (100 * MIB), 9)
    path = tmp_path / "log.mat"
    path.write_bytes(mat(struct.pack("<II", 15, len(zipped)) + zipped))
    refusal(path, "less compression")


@pytest.mark.parametrize(
    "values", [scipy.sparse.eye(2000, format="csc"), {"a": 1.0}, np.zeros((50, 50))]
)
def test_a_mat_variable_that_is_no_vector(tmp_path, values):
    run = {k.split(" ")[0]: v for k, v in a_run().items()} | {"F": values}
    scipy.io.savemat(tmp_path / "log.mat", run | {"units": {"time": "s", "F": "N"}})
    channels = {n: Channel(column=n, unit=u) for n, u in UNITS.items()}
    refusal(tmp_path / "log.mat", "'F' is not a vector", channels=channels)


UNITS = {"time": "s", "u": "V", "psi": "deg", "P_a1": "bar", "P_a2": "bar",
         "P_s": "bar", "F": "kN"}  # fmt: skip


# -- HDF5 --


@pytest.fixture
def hdf5(tmp_path) -> Path:
    """A sound MAT v7.3 log."""
    path = tmp_path / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for label, values in a_run().items():
            file[label.split(" ")[0]] = values
        for name, unit in UNITS.items():
            file[f"{name}_unit"] = np.array([ord(c) for c in unit], dtype=np.uint16)
            file[f"{name}_unit"].attrs["MATLAB_class"] = np.bytes_("char")
    assert set(Log.load(path).signals) == set(UNITS) - {"time"}
    return path


@pytest.mark.parametrize("how", ["link", "soft", "external", "virtual"])
def test_a_mat_file_reads_no_other_file(hdf5, tmp_path, how):
    secret = tmp_path / "secret.h5"
    with h5py.File(secret, "w") as file:
        file["F"] = np.frombuffer(b"a secret" * 2000)
    with h5py.File(hdf5, "a") as file:
        del file["F"]
        if how == "link":
            file["F"] = h5py.ExternalLink(str(secret), "F")
        elif how == "soft":
            file["other"] = h5py.ExternalLink(str(secret), "/")
            file["F"] = h5py.SoftLink("/other/F")
        elif how == "external":
            where = [(str(secret), 0, 16000)]
            file.create_dataset("F", (2000,), "f8", external=where)
        else:
            layout = h5py.VirtualLayout((2000,), "f8")
            layout[:] = h5py.VirtualSource(str(secret), "F", (2000,))
            file.create_virtual_dataset("F", layout)
    said = refused_at_once(hdf5, "not followed" if "link" in how or how == "soft"
                           else "another file")  # fmt: skip
    assert "secret" not in said.replace("secret.h5", "")


def test_a_mat_file_whose_structs_hold_each_other(hdf5):
    """2^26 ways lead to its last struct; and a struct that holds itself."""
    with h5py.File(hdf5, "a") as file:
        inner = file.create_group("deep")
        for i in range(26):
            outer = file.create_group(f"level_{i}")
            outer["left"] = outer["right"] = inner
            inner = outer
        log = file.create_group("log")
        log["log"] = log["units"] = log
    began = time.process_time()
    assert Log.load(hdf5).signals
    assert time.process_time() - began < 2


def test_a_mat_file_that_claims_more_than_it_holds(hdf5):
    with h5py.File(hdf5, "a") as file:
        del file["F"]
        file.create_dataset("F", (2**40,), "f8", chunks=(2**20,))
    refused_at_once(hdf5, "less compression")
    with h5py.File(hdf5, "a") as file:
        del file["F"]
        file["F"] = np.zeros(2000, dtype=[("a", "f8"), ("b", "f8")])
    refused_at_once(hdf5, "not a vector")


# -- Excel --


def test_a_sheet_with_one_cell_far_off(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in range(1, 40):
        book.active.cell(row, 1, row)
    book.active.cell(400_000, 9_000, "far")
    book.save(tmp_path / "log.xlsx")
    refused_at_once(tmp_path / "log.xlsx", "memory")


def test_a_workbook_that_expands_without_end(tmp_path):
    with zipfile.ZipFile(tmp_path / "log.xlsx", "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("xl/workbook.xml", b" " * (100 * MIB))
    refused_at_once(tmp_path / "log.xlsx", "less compression")
