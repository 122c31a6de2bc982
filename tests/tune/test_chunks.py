"""What is kept of a sweep, damaged: it is done again, or refused, never believed."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
import xarray as xr

from hydrojax.errors import InputError
from hydrojax.tune.chunks import Chunks

OUT = {"peak": np.arange(4.0), "response": np.ones((4, 3), complex)}
DATA = xr.Dataset({"peak": ("k_p", np.arange(4.0))}, attrs={"methods": "linear"})


@pytest.fixture
def kept(tmp_path) -> Chunks:
    chunks = Chunks(tmp_path, "question", "code")
    chunks.claim()
    chunks.write("linear-4", 0, OUT)
    chunks.finish(DATA)
    assert chunks.whole(("linear",)) is not None
    return chunks


def part(kept: Chunks):
    assert kept.folder is not None
    (found,) = (kept.folder / "parts").iterdir()
    return found


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[]", b"{}", b"null", b'{"question": 3', b"[" * 100_000]
)
def test_a_damaged_plan_is_written_anew_and_chunks_stay(kept, content):
    (kept.folder / "plan.json").write_bytes(content)
    kept.claim()
    assert kept.whole(("linear",)) is None  # not known to be this sweep's
    found = kept.read("linear-4", 0)
    assert found is not None and set(found) == set(OUT)
    other = Chunks(kept.folder, "another", "code")
    with pytest.raises(InputError, match="another sweep"):
        other.claim()


def test_a_chunk_that_is_damaged_or_another_s_counts_as_none(kept):
    path = part(kept)
    whole = path.read_bytes()
    for cut in (0, 10, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:cut])
        assert kept.read("linear-4", 0) is None
    for at in range(40, len(whole), 97):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :])
        found = kept.read("linear-4", 0)
        if found is not None:  # a byte that zip does not use
            np.testing.assert_array_equal(found["peak"], OUT["peak"])
            np.testing.assert_array_equal(found["response"], OUT["response"])
    path.write_bytes(whole)
    shutil.copy(path, path.with_name(path.name.replace("00000", "00001")))
    assert kept.read("linear-4", 0) is not None and kept.read("linear-4", 1) is None


def test_a_damaged_sweep_counts_as_none(kept):
    path = kept.folder / "sweep.nc"
    whole = path.read_bytes()
    for content in (b"", whole[:-1], whole[:2000] + b"x" + whole[2001:]):
        path.write_bytes(content)
        assert kept.whole(("linear",)) is None
    path.write_bytes(whole)
    xr.testing.assert_identical(kept.whole(("linear",)), DATA)
