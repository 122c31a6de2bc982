"""Bags: MCAP and ROS 2, from what their libraries write back to the source."""

from __future__ import annotations

import json
import re
import sqlite3
import sys
import tomllib
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest

import hydrojax
from hydrojax.errors import InputError
from hydrojax.identify.preparation.data import prepare_logs
from hydrojax.logs.log import Log
from hydrojax.logs.tables import Channel
from hydrojax.rigfile.schema import RigFile

pytest.importorskip("mcap")
pytest.importorskip("rosbags")
from mcap.writer import Writer as McapWriter  # noqa: E402
from rosbags.rosbag2 import (  # noqa: E402
    CompressionFormat,
    CompressionMode,
    StoragePlugin,
    Writer,
)
from rosbags.typesys import (  # noqa: E402
    Stores,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)

DEMO = Path(hydrojax.__file__).parent / "demo"
PAGE = Path(__file__).parents[2] / "docs" / "logs.md"

START = 1_750_000_000_000_000_000
"""When the runs were recorded, ns."""

OWN_TYPES = {
    "rig_msgs/msg/Command": "std_msgs/Header header\nfloat64 data",
    "rig_msgs/msg/Values": "std_msgs/Header header\nfloat64[] values",
}
CHANNELS = {
    "u": Channel(column="/valve/command.data", unit="V"),
    "psi": Channel(column="/joint_states.position[0]", unit="rad"),
    "P_a1": Channel(column="/pressures.values[0]", unit="bar"),
    "P_a2": Channel(column="/pressures.values[1]", unit="bar"),
    "P_s": Channel(column="/pressures.values[2]", unit="bar"),
    "F": Channel(column="/load_cell.wrench.force.z", unit="kN"),
    "F_d": Channel(column="/desired.data", unit="kN"),
}
TYPES = {
    "/valve/command": "rig_msgs/msg/Command",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/pressures": "rig_msgs/msg/Values",
    "/load_cell": "geometry_msgs/msg/WrenchStamped",
    "/desired": "std_msgs/msg/Float64",  # without a header
}


class Topic(NamedTuple):
    """What one topic carries: ns, ns, and values [n, k]; ns published."""

    stamp: np.ndarray
    received: np.ndarray
    values: np.ndarray
    published: np.ndarray | None = None


def content(topic: str, stamp: int, v: np.ndarray) -> dict[str, Any]:
    """A message as plain data, called as its ROS type has it."""
    when = {"sec": int(stamp) // 10**9, "nanosec": int(stamp) % 10**9}
    head = {"header": {"stamp": when, "frame_id": ""}}
    body: dict[str, Any] = {"data": float(v[0])}
    if topic == "/desired":
        return body
    if topic == "/joint_states":
        body = {"name": ["joint"], "position": v, "velocity": v[:0], "effort": v[:0]}
    elif topic == "/pressures":
        body = {"values": v}
    elif topic == "/load_cell":
        zero = {"x": 0.0, "y": 0.0, "z": 0.0}
        body = {"wrench": {"force": zero | {"z": float(v[0])}, "torque": zero}}
    return head | body


def in_order(topics: dict[str, Topic]):
    """(topic, its row) by time received."""
    rows = [
        (t.received[i], name, i)
        for name, t in topics.items()
        for i in range(len(t.received))
    ]
    return [(name, i) for _, name, i in sorted(rows)]


def as_json(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


def write_json(path: Path, topics: dict[str, Topic]) -> Path:
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b'{"type": "object"}')
        ids = {t: writer.register_channel(t, "json", schema) for t in topics}
        for name, i in in_order(topics):
            t = topics[name]
            data = json.dumps(content(name, t.stamp[i], t.values[i]), default=as_json)
            sent = t.received if t.published is None else t.published
            writer.add_message(
                ids[name], int(t.received[i]), data.encode(), int(sent[i])
            )
        writer.finish()
    return path


def write_bag(
    path: Path,
    topics: dict[str, Topic],
    plugin: StoragePlugin,
    packed: CompressionMode | None = None,
) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in OWN_TYPES.items():
        store.register(get_types_from_msg(text, name))

    def build(kind: str, given: Any) -> Any:
        fields = {}
        for field, (node, of) in store.get_msgdef(kind).fields:
            value = given[field]
            fields[field] = build(of, value) if node.name == "NAME" else value
        return store.types[kind](**fields)

    bag = Writer(path, version=9, storage_plugin=plugin)
    if packed:
        bag.set_compression(packed, CompressionFormat.ZSTD)
    with bag as writer:
        links = {t: writer.add_connection(t, TYPES[t], typestore=store) for t in topics}
        for name, i in in_order(topics):
            t = topics[name]
            message = build(TYPES[name], content(name, t.stamp[i], t.values[i]))
            data = store.serialize_cdr(message, TYPES[name])
            writer.write(links[name], int(t.received[i]), data)
    return path


def write(folder: Path, kind: str, topics: dict[str, Topic]) -> Path:
    """A bag of one of the kinds: json, mcap (a lone file), mcap folder, sqlite3."""
    if kind == "json":
        return write_json(folder / "run.mcap", topics)
    plugin = StoragePlugin.SQLITE3 if kind == "sqlite3" else StoragePlugin.MCAP
    bag = write_bag(folder / "run", topics, plugin)
    return bag / "run.mcap" if kind == "mcap" else bag


KINDS = ("json", "mcap", "mcap folder", "sqlite3")


def demo_topics(rows: int | None = None) -> dict[str, Topic]:
    """The demo's log as topics, all with its stamps; F_d has only the log's time."""
    frame = pd.read_csv(DEMO / "fit_1.csv.gz", nrows=rows)
    stamp = START + np.round(frame["time [s]"].to_numpy() * 1e9).astype(np.int64)
    take = {
        "/valve/command": ["u [V]"],
        "/joint_states": ["psi [rad]"],
        "/pressures": ["P_a1 [bar]", "P_a2 [bar]", "P_s [bar]"],
        "/load_cell": ["F [kN]"],
        "/desired": ["F_d [kN]"],
    }
    return {
        t: Topic(stamp, stamp, np.ascontiguousarray(frame[labels]))
        for t, labels in take.items()
    }


@pytest.fixture(scope="module")
def short() -> dict[str, Topic]:
    """The first 1.2 s of the demo's log."""
    return demo_topics(1200)


def refusal(path: Path, channels: dict[str, Channel], *words: str) -> str:
    with pytest.raises(InputError) as caught:
        Log.load(path, channels)
    line = str(caught.value)
    assert "\n" not in line
    assert len(line) < 500
    for word in (path.name, *words):
        assert word in line, line
    return line


# A copy of a log is that log


@pytest.mark.parametrize("kind", KINDS)
def test_a_copy_gives_the_same_log(tmp_path, short, kind):
    csv = tmp_path / "log.csv"
    pd.read_csv(DEMO / "fit_1.csv.gz", nrows=1200).to_csv(csv, index=False)
    plain = Log.load(csv)
    log = Log.load(write(tmp_path, kind, short), CHANNELS)
    np.testing.assert_array_equal(log.time, plain.time)
    assert log.signals.keys() == plain.signals.keys()
    for name, values in plain.signals.items():
        np.testing.assert_array_equal(log.signals[name], values)
    assert log.units == plain.units
    assert log.segments == plain.segments
    notes = "; ".join(log.notes)
    assert "/pressures (P_a1, P_a2, P_s): times are by header.stamp" in notes
    assert "/desired (F_d): times are the log's" in notes
    assert "channel_skew" in notes
    assert "ticks are those of /valve/command, 1000 Hz" in notes
    assert "between the ticks" not in notes


@pytest.mark.slow
def test_a_copy_gives_the_same_windows(tmp_path):
    """End to end: what the replay runs on, from an MCAP copy and from the CSV."""
    spec = RigFile.load(DEMO / "rig.toml")
    path = write_json(tmp_path / "fit_1.mcap", demo_topics())
    given = [Log.load(DEMO / "fit_1.csv.gz"), Log.load(path, CHANNELS)]
    plain, mine = (prepare_logs([log], spec) for log in given)
    for part in ("windows", "motion"):
        one, other = getattr(plain, part), getattr(mine, part)
        for name in one._fields:
            np.testing.assert_array_equal(getattr(other, name), getattr(one, name))
    np.testing.assert_array_equal(mine.noise, plain.noise)


@pytest.mark.parametrize("plugin", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("packed", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_compressed_bags(tmp_path, short, plugin, packed):
    bag = write_bag(tmp_path / "run", short, plugin, packed)
    plain = Log.load(write_json(tmp_path / "same.mcap", short), CHANNELS)
    log = Log.load(bag, CHANNELS)
    for name, values in plain.signals.items():
        np.testing.assert_array_equal(log.signals[name], values)


def test_a_bag_without_descriptions(tmp_path, short):
    """As old recorders wrote it: ROS's own types are known, others are refused."""
    bag = write(tmp_path, "sqlite3", short)
    with closing(sqlite3.connect(bag / "run.db3")) as base:
        base.execute("DELETE FROM message_definitions")
        base.commit()
    own = {"F": CHANNELS["F"], "psi": CHANNELS["psi"]}
    log = Log.load(bag, own)
    np.testing.assert_allclose(log.signals["F"], 1e3 * short["/load_cell"].values[:, 0])
    refusal(bag, CHANNELS, "'rig_msgs/msg/Command' cannot be decoded")


def test_topics_left_alone_are_listed(tmp_path, short):
    channels = {k: v for k, v in CHANNELS.items() if k != "F"}
    log = Log.load(write(tmp_path, "mcap", short), channels)
    assert log.ignored == ("/load_cell",)
    assert "F" not in log.signals


def test_a_sign_is_turned_and_an_index_reached(tmp_path, short):
    plain = Log.load(write(tmp_path, "json", short), CHANNELS)
    turned = CHANNELS["psi"].model_copy(update={"invert": True})
    log = Log.load(tmp_path / "run.mcap", CHANNELS | {"psi": turned})
    np.testing.assert_array_equal(log.signals["psi"], -plain.signals["psi"])
    assert not np.array_equal(log.signals["P_a1"], log.signals["P_a2"])


# Channels with clocks of their own


def waves(t: np.ndarray) -> dict[str, np.ndarray]:
    """Signals at a time, with known slopes (see `STEEP`, per s)."""
    return {
        "u": 2.0 * np.sin(5.0 * t),
        "psi": 0.3 * np.sin(3.0 * t),
        "P_a1": 70.0 + 8.0 * np.sin(7.0 * t),
        "P_a2": 70.0 - 8.0 * np.sin(7.0 * t),
        "P_s": 140.0 + 1.0 * np.sin(2.0 * t),
        "F": 0.5 * np.sin(4.0 * t),
    }


STEEP = {"psi": 0.9, "P_a1": 56e5, "P_a2": 56e5, "P_s": 2e5, "F": 2e3}
"""Largest slopes in SI, per s."""

DRIFT = 150e-6
"""How much faster the pressures' clock runs."""


def own_clocks(seconds: float = 12.0) -> dict[str, Topic]:
    """Rates, jitter, delays, and one computer whose clock runs fast."""
    rng = np.random.default_rng(5)

    def topic(rate, names, jitter=0.0, drift=0.0, late=0.0, phase=0.0):
        t = phase / rate + np.arange(int(seconds * rate)) / rate
        t += jitter / rate * rng.uniform(-1, 1, t.size)
        true = (t * 1e9).astype(np.int64)
        delay = late + rng.exponential(0.5e-3, t.size)
        received = START + true + (delay * 1e9).astype(np.int64)
        stamp = START + true + (drift * t * 1e9).astype(np.int64)
        values = waves(true * 1e-9)
        return Topic(stamp, received, np.stack([values[n] for n in names], axis=1))

    return {
        "/valve/command": topic(1000, ["u"]),
        "/joint_states": topic(1000, ["psi"], phase=0.37),
        "/pressures": topic(2000, ["P_a1", "P_a2", "P_s"], jitter=0.2, drift=DRIFT),
        "/load_cell": topic(500, ["F"], jitter=0.3),
    }


OWN = {k: v for k, v in CHANNELS.items() if k != "F_d"}


@pytest.fixture(scope="module")
def apart(tmp_path_factory) -> tuple[Path, Log]:
    path = write_json(tmp_path_factory.mktemp("own") / "run.mcap", own_clocks())
    return path, Log.load(path, OWN)


def test_channels_come_at_the_commands_ticks(apart):
    """Within 10 us, which count as one tick, and 2 us of line and clock."""
    log = apart[1]
    np.testing.assert_allclose(np.diff(log.time), 1e-3, atol=2e-9)
    truth = waves(log.time)
    np.testing.assert_allclose(log.signals["u"], truth["u"], atol=1e-12)
    scale = {"psi": 1.0, "F": 1e3}
    for name, slope in STEEP.items():
        wrong = np.abs(log.signals[name] - scale.get(name, 1e5) * truth[name])
        assert np.nanmax(wrong) < 12e-6 * slope, name
    assert len(log.segments) == 1


def test_the_drift_is_told_with_its_error(apart):
    notes = "; ".join(apart[1].notes)
    found = re.search(r"/pressures: its clock .* runs (\S+) ppm \(\+- (\S+)\)", notes)
    assert found, notes
    assert abs(float(found[1]) - 1e6 * DRIFT) < 2 * float(found[2])
    assert float(found[2]) < 20
    assert "/joint_states: its clock" not in notes
    assert "/load_cell: its clock" not in notes
    for topic in ("/load_cell", "/pressures"):
        assert f"{topic} comes at" in notes
    assert "give the noise in [sensors]" in notes


def test_a_clock_since_power_on_is_brought_to_the_others(tmp_path, short):
    """The pressures' stamps count from some power-on; the delays say from when."""
    topics = dict(short)
    own = topics["/pressures"]
    topics["/pressures"] = own._replace(stamp=own.stamp - START + 77_000_000_000)
    log = Log.load(write_json(tmp_path / "run.mcap", topics), CHANNELS)
    plain = Log.load(write_json(tmp_path / "same.mcap", short), CHANNELS)
    for name in ("P_a1", "P_s"):
        np.testing.assert_allclose(log.signals[name], plain.signals[name], rtol=1e-9)
    assert any("off the recorder's" in note for note in log.notes)


def test_a_later_channel_is_said_and_left(tmp_path, short):
    topics = dict(short)
    own = topics["/load_cell"]
    topics["/load_cell"] = own._replace(received=own.received + 5_000_000)
    log = Log.load(write_json(tmp_path / "run.mcap", topics), CHANNELS)
    plain = Log.load(write_json(tmp_path / "same.mcap", short), CHANNELS)
    np.testing.assert_array_equal(log.signals["F"], plain.signals["F"])
    said = next(n for n in log.notes if n.startswith("/load_cell: comes at least"))
    assert "+5 ms later than /valve/command" in said
    assert "channel_skew" in said


def test_a_gap_stays_a_gap(tmp_path, short):
    """Pressures stop for 0.1 s: no row in it, and the log is cut there."""
    topics, own = dict(short), short["/pressures"]
    kept = np.r_[0:550, 650:1200]
    topics["/pressures"] = Topic(own.stamp[kept], own.received[kept], own.values[kept])
    log = Log.load(write_json(tmp_path / "run.mcap", topics), CHANNELS)
    holes = np.isnan(log.signals["P_a1"])
    np.testing.assert_array_equal(np.flatnonzero(holes), np.arange(550, 650))
    assert log.segments == ((0, 550), (650, 1200))
    assert not np.isnan(log.signals["F"]).any()


def test_one_lost_message_costs_one_row(tmp_path, short):
    topics, own = dict(short), short["/load_cell"]
    kept = np.delete(np.arange(1200), [300, 700])
    topics["/load_cell"] = Topic(own.stamp[kept], own.received[kept], own.values[kept])
    log = Log.load(write_json(tmp_path / "run.mcap", topics), CHANNELS)
    assert len(log.time) == 1198
    assert log.segments == ((0, 1198),)
    assert any("message is lost: 2" in note for note in log.notes)


def test_out_of_order_and_repeated_messages(tmp_path, short):
    topics, own = dict(short), short["/pressures"]
    order = np.arange(1200)
    order[[400, 401]] = 401, 400
    order = np.insert(order, 900, 900)
    received = own.received[0] + 1_000_000 * np.arange(len(order))
    topics["/pressures"] = Topic(own.stamp[order], received, own.values[order])
    log = Log.load(write_json(tmp_path / "run.mcap", topics), CHANNELS)
    plain = Log.load(write_json(tmp_path / "same.mcap", short), CHANNELS)
    np.testing.assert_allclose(log.signals["P_a1"], plain.signals["P_a1"], rtol=1e-12)
    assert "/pressures: messages out of order, sorted: 1" in log.notes
    assert "/pressures: messages of equal stamp, merged: 1" in log.notes


def test_which_time_is_taken(tmp_path, short):
    """No stamp: the time published, where the file tells it; else the log's."""
    topics = dict(short)
    own, late = topics["/load_cell"], topics["/joint_states"]
    none = np.zeros_like(own.stamp)
    topics["/load_cell"] = own._replace(
        stamp=none, received=own.received + 3_000_000, published=own.received
    )
    topics["/joint_states"] = late._replace(stamp=none)
    log = Log.load(write_json(tmp_path / "run.mcap", topics), CHANNELS)
    notes = "; ".join(log.notes)
    assert "/load_cell (F): times are by publish time" in notes
    assert "/joint_states (psi): times are the log's" in notes
    plain = Log.load(write_json(tmp_path / "same.mcap", short), CHANNELS)
    np.testing.assert_array_equal(log.signals["F"], plain.signals["F"])


# What is refused


def renamed(name: str, column: str) -> dict[str, Channel]:
    return CHANNELS | {name: Channel(column=column, unit="bar")}


@pytest.mark.parametrize("kind", ["json", "sqlite3"])
@pytest.mark.parametrize(
    ("name", "column", "words"),
    [
        ("u", "/valv/command.data", ("no such topic", "near it: /valve/command")),
        ("u", "zzz", ("no such topic", "/desired, /joint_states, /load_cell")),
        ("P_a1", "/pressures.valus[0]", ("not a field", "/pressures.values[0]")),
        ("P_a1", "/pressures.values[9]", ("not a field", "/pressures.values[0]")),
        ("P_a1", "/pressures.q", ("not a field", "they have /pressures.values[0]")),
        ("P_a1", "/pressures.values", ("not a number", "/pressures.values[0]")),
        ("P_a1", "/pressures.values.size", ("not a field",)),
        ("F", "/load_cell.wrench", ("not a number", ".force.x")),
        ("P_a1", "/pressures.values[-1]", ("is no field", "dots and indices")),
        ("P_a1", "/pressures.values[1]", ("P_a1 and P_a2 both name",)),
    ],
)
def test_a_wrong_place_is_refused(tmp_path, short, kind, name, column, words):
    path = write(
        tmp_path, kind, {t: Topic(*(v[:60] for v in s[:3])) for t, s in short.items()}
    )
    refusal(path, renamed(name, column), *words)


def test_channels_that_say_nothing(tmp_path, short):
    path = write_json(tmp_path / "run.mcap", short)
    line = refusal(path, {}, "/valve/command", "/joint_states", "[channels]")
    example = re.search(r"such as (u = \{.*?\})", line)
    assert example
    assert tomllib.loads(example[1])["u"]["unit"] == "V"
    no_unit = CHANNELS | {"F": Channel(column="/load_cell.wrench.force.z")}
    refusal(path, no_unit, "has no unit", "unit = 'N'", "[channels] F")
    refusal(path, CHANNELS | {"time": Channel(column="/t")}, "times of their own")


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_bag_is_refused(tmp_path, short, kind):
    path = write(tmp_path, kind, short)
    file = next(path.glob("*.[md][cb]*")) if path.is_dir() else path
    whole = file.read_bytes()
    for cut in (len(whole) // 2, 30):
        file.write_bytes(whole[:cut])
        refusal(path, CHANNELS, "not a readable", "record it again")
    flipped = bytearray(whole)
    flipped[len(whole) // 3 : len(whole) // 3 + 40] = bytes(40)
    file.write_bytes(flipped)
    if kind != "sqlite3":  # SQLite has no checksums
        refusal(path, CHANNELS, "not a readable", "record it again")


@pytest.mark.parametrize("kind", KINDS)
def test_an_empty_bag_is_refused(tmp_path, short, kind):
    path = write(tmp_path, kind, {})
    refusal(path, CHANNELS, "holds no message")


def test_what_is_no_bag_is_refused(tmp_path, short):
    refusal(tmp_path / "none.mcap", CHANNELS, "no such file")
    (tmp_path / "void.mcap").write_bytes(b"")
    refusal(tmp_path / "void.mcap", CHANNELS, "empty")
    (tmp_path / "folder").mkdir()
    refusal(tmp_path / "folder", CHANNELS, "no ROS 2 bag", "metadata.yaml")
    silent = short | {"/load_cell": Topic(*(v[:0] for v in short["/load_cell"][:3]))}
    path = write(tmp_path, "sqlite3", silent)
    refusal(path, CHANNELS, "'/load_cell' holds no message")
    refusal(path, renamed("F", "/load_cell_2.z"), "no such topic")


def test_topics_without_common_time_are_refused(tmp_path, short):
    own = short["/load_cell"]
    later = own._replace(stamp=own.stamp + 10**10, received=own.received + 10**10)
    path = write_json(tmp_path / "run.mcap", short | {"/load_cell": later})
    refusal(path, CHANNELS, "/load_cell", "starts 8.8 s after")


def plain_mcap(path: Path, encoding: str, schema: tuple[str, str, bytes]) -> Path:
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        at = writer.register_channel("/u", encoding, writer.register_schema(*schema))
        for i in range(100):
            writer.add_message(at, START + i, b"\x00\x01\x00\x00" + bytes(8), START + i)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("encoding", "schema", "words"),
    [
        ("protobuf", ("rig.U", "protobuf", b"\x0a"), ("'protobuf'", "cdr (ROS 2) or")),
        ("cdr", ("rig/msg/U", "ros2msg", b"float65 data"), ("'rig/msg/U' cannot",)),
        ("cdr", ("rig/msg/U", "ros2msg", b"Odd odd"), ("'rig/msg/U' cannot",)),
        ("cdr", ("rig/msg/U", "ros2idl", b"struct {"), ("'rig/msg/U' cannot",)),
        ("cdr", ("rig/msg/U", "ros2msg", b"string a"), ("not a readable MCAP",)),
        ("json", ("U", "jsonschema", b"{}"), ("not a readable MCAP",)),
    ],
)
def test_messages_that_cannot_be_decoded(tmp_path, encoding, schema, words):
    path = plain_mcap(tmp_path / "run.mcap", encoding, schema)
    refusal(path, {"u": Channel(column="/u.data", unit="V")}, *words)


def test_the_library_that_is_missing_is_named(tmp_path, short, monkeypatch):
    path = write(tmp_path, "mcap folder", short)
    monkeypatch.setitem(sys.modules, "mcap.reader", None)
    refusal(path / "run.mcap", CHANNELS, "library mcap", "'hydrojax[ros]'")
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    refusal(path, CHANNELS, "library rosbags", "'hydrojax[ros]'")


def test_the_command_line_refuses_in_one_line(tmp_path, short, call):
    """Exit 2, whichever command; a folder passes as far as the reader."""
    rig = tmp_path / "rig.toml"
    rig.write_text((DEMO / "rig.toml").read_text())
    bag = write(tmp_path, "sqlite3", short)
    for words in (
        ("identify", rig, bag, "--out", tmp_path / "out"),
        ("simulate", rig, "--motion", bag, "--out", tmp_path / "log.csv"),
    ):
        said = call(*words)
        assert said.code == 2
        assert said.err.count("\n") == 1
        assert "the topics are /desired, /joint_states" in said.err
    assert not (tmp_path / "out").exists()


# The page


def blocks(kind: str) -> list[str]:
    return re.findall(rf"```{kind}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)


def test_the_pages_channels_read_a_bag(tmp_path, short):
    tables = [tomllib.loads(text) for text in blocks("toml")]
    given = next(t["channels"] for t in tables if "/pressures" in str(t))
    channels = {name: Channel(**entry) for name, entry in given.items()}
    assert channels == {k: CHANNELS[k] for k in channels}
    log = Log.load(write(tmp_path, "mcap folder", short), channels)
    assert set(log.signals) == set(channels)


def test_the_pages_rigs_are_rigs(tmp_path):
    whole = [text for text in blocks("toml") if "layout" in text]
    assert len(whole) >= 2
    for text in whole:
        path = tmp_path / "rig.toml"
        path.write_text(text)
        RigFile.load(path)


def test_the_pages_python_writes_a_log(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (code,) = blocks("python")
    exec(compile(code, str(PAGE), "exec"), {})
    (path,) = tmp_path.glob("*.csv")
    log = Log.load(path)
    assert {"u", "x", "P_a1", "P_a2", "F"} <= set(log.signals)


def test_idl_described_messages_are_read(tmp_path):
    text = "module rig { module msg { struct U { double data; }; }; };"
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_idl(text))
    kind = "rig/msg/U"
    path = tmp_path / "run.mcap"
    values = np.sin(np.arange(700) / 50)
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2")
        schema = writer.register_schema(kind, "ros2idl", text.encode())
        at = writer.register_channel("/u", "cdr", schema)
        for i, v in enumerate(values):
            data = bytes(store.serialize_cdr(store.types[kind](float(v)), kind))
            writer.add_message(at, START + 10**6 * i, data, START + 10**6 * i)
        writer.finish()
    log = Log.load(path, {"u": Channel(column="/u.data", unit="V")})
    np.testing.assert_array_equal(log.signals["u"], values)
