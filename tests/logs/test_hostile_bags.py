"""Bags made to take the memory or the time of the machine."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import pytest

from benchmarks.damage.samples import write_bag_folder
from hydrojax.errors import InputError
from hydrojax.logs.log import Log
from hydrojax.logs.tables import Channel

pytest.importorskip("mcap")
pytest.importorskip("rosbags")
from mcap.writer import Writer  # noqa: E402

CHANNELS = {"u": Channel(column="/valve.data", unit="V")}


def bag(path: Path, schema: str, topic: str = "/valve", encoding="ros2msg") -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        kind = writer.register_schema("a/msg/B", encoding, schema.encode())
        channel = writer.register_channel(topic, "cdr", kind)
        for i in range(60):
            writer.add_message(channel, i * 10**7, b"\0" * 16, i * 10**7)
        writer.finish()
    return path


@pytest.mark.parametrize(
    "schema, encoding",
    [
        ("string[20000000] s\n", "ros2msg"),
        ("module a { module msg { struct B { string s[20000000]; }; }; };", "ros2idl"),
        ("".join(f"float64 f{i}\n" for i in range(100_000)), "ros2msg"),
        ("float64[2000000000] s\n", "ros2msg"),
        ("Other[5000] o\n" + "=" * 80 + "\nMSG: a/Other\nfloat64 x\n", "ros2msg"),
        ("module a {" * 5000, "ros2idl"),
    ],
)
def test_a_description_that_never_compiles(tmp_path, schema, encoding):
    path = bag(tmp_path / "run.mcap", schema, encoding=encoding)
    began = time.process_time()
    with pytest.raises(InputError, match="cannot be decoded") as caught:
        Log.load(path, CHANNELS)
    assert time.process_time() - began < 3
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 600


def test_a_chunk_that_expands_without_end(tmp_path):
    path = bag(tmp_path / "run.mcap", "float64 data\n")
    content = bytearray(path.read_bytes())
    at = 8
    while content[at] != 6:  # the first chunk
        at += 9 + struct.unpack_from("<Q", content, at + 1)[0]
    struct.pack_into("<Q", content, at + 9 + 16, 2**40)
    path.write_bytes(content)
    with pytest.raises(InputError, match="a chunk expands"):
        Log.load(path, CHANNELS)


@pytest.mark.parametrize("topic", ["/valve\x1b[2J", "/val\nve"])
def test_a_topic_cannot_write_to_the_terminal(tmp_path, topic):
    path = bag(tmp_path / "run.mcap", "float64 data\n", topic)
    with pytest.raises(InputError) as caught:
        Log.load(path, CHANNELS)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("nested", ["[" * 600, "{a: " * 600, "x: " + "- " * 600])
def test_a_description_of_a_bag_that_is_nested_without_end(tmp_path, nested):
    """YAML is read in a time that grows with the square of the depth, or faster."""
    folder = tmp_path / "run"
    write_bag_folder(folder)
    given = {"x": Channel(column="/rig.data", unit="mm")}
    assert Log.load(folder, given).time.size == 300
    text = (folder / "metadata.yaml").read_text()
    (folder / "metadata.yaml").write_text(f"{text}more: {nested}\n")
    began = time.process_time()
    with pytest.raises(InputError, match="nested more than 16 deep"):
        Log.load(folder, given)
    assert time.process_time() - began < 1
