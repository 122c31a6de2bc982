"""MCAP files and ROS 2 bags, opened: topics, and messages decoded one by one."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from hydrojax.errors import SPARED, TEXT, InputError, file_text
from hydrojax.logs.tables import unreadable

if TYPE_CHECKING:
    from mcap.reader import McapReader
    from mcap.records import Channel, Schema


_CHUNK = 6
"""Kind of an MCAP record that holds others, compressed."""

_TEXT, _FIELDS, _ELEMENTS, _NUMBERS = 2**18, 2000, 100, 1_000_000
"""Most bytes of a message's description, its fields, and elements of a fixed array: of
texts or messages, and of numbers."""

_DEEP = 16
"""Lists and tables within each other in a bag's metadata.yaml."""

_CHAINED = re.compile(rf"(?:[-?:][ \t]+){{{_DEEP}}}")
"""Such lists without brackets, on one line."""


class Message(NamedTuple):
    """A message as the file has it; times in ns, `published` 0 if it is not known."""

    topic: str
    published: int
    received: int
    data: bytes


@dataclass(frozen=True)
class Bag:
    """An open bag.

    Attributes:
        topics: the number of messages by topic.
        decoder: what turns a topic's bytes into an object.
        messages: of these topics, in any order.
    """

    topics: Mapping[str, int]
    decoder: Callable[[str], Callable[[bytes], Any]]
    messages: Callable[[Collection[str]], Iterator[Message]]


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a .mcap or .db3 file, or the folder of a ROS 2 bag.

    Raises:
        InputError: no such bag, or a damaged one, whenever that comes to light; the
            libraries to read it are not installed.
    """
    kind = _kind(path)
    try:
        with (_mcap if kind == "MCAP file" else _rosbag)(path) as bag:
            yield bag
    except InputError:
        raise
    except ModuleNotFoundError as err:
        raise InputError(
            f"{path}: to read it takes the library {str(err.name).partition('.')[0]}; "
            "install it with pip install 'hydrojax[ros]'"
        ) from err
    except Exception as err:  # every library has its own kinds for a broken file
        mend = "mcap recover" if kind == "MCAP file" else "ros2 bag reindex"
        raise unreadable(path, kind, err, f"record it again, or try `{mend}`") from err


def _kind(path: Path) -> str:
    """What the path is, for messages."""
    if path.is_dir():
        if not (path / "metadata.yaml").is_file():
            raise InputError(
                f"{path}: a folder without metadata.yaml is no ROS 2 bag; give the "
                "log's file, or mend the bag with `ros2 bag reindex`"
            )
        return "ROS 2 bag"
    if not path.is_file():
        raise InputError(f"{path}: no such file; check the path")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty; record the log again")
    return "MCAP file" if path.suffix.lower() == ".mcap" else "ROS 2 bag"


@contextmanager
def _mcap(path: Path) -> Iterator[Bag]:
    from mcap.reader import make_reader

    _check_chunks(path)
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        types: dict[str, tuple[str, Schema | None]] = {}
        topics: dict[str, int] = {}
        for schema, channel, count in _channels(reader):
            types[channel.topic] = (channel.message_encoding, schema)
            topics[channel.topic] = topics.get(channel.topic, 0) + count

        def decoder(topic: str) -> Callable[[bytes], Any]:
            encoding, schema = types[topic]
            if encoding == "json":
                return json.loads
            if encoding != "cdr" or schema is None:
                raise InputError(
                    f"{path}: messages of {topic!r} are encoded as {encoding!r}; "
                    "record them as cdr (ROS 2) or json"
                )
            text = schema.data.decode()
            idl = schema.encoding != "ros2msg"
            return _cdr(f"{path}: {topic!r}", schema.name, text, idl)

        def messages(wanted: Collection[str]) -> Iterator[Message]:
            for _, c, m in reader.iter_messages(wanted, log_time_order=False):
                yield Message(c.topic, m.publish_time, m.log_time, m.data)

        yield Bag(topics, decoder, messages)


def _check_chunks(path: Path) -> None:
    """Refuse an MCAP file with a chunk that says that it expands beyond measure.

    The library takes a chunk's memory by what its header says, at once.
    """
    with path.open("rb") as file:
        file.seek(8)  # the magic bytes, which the library checks
        while len(tag := file.read(9)) == 9:
            kind, size = struct.unpack("<BQ", tag)
            at = file.tell()
            if kind == _CHUNK:
                head = file.read(24).ljust(24, b"\0")
                if struct.unpack_from("<Q", head, 16)[0] > SPARED:
                    raise InputError(
                        f"{path}: a chunk expands to more than {SPARED >> 20} MiB; "
                        "record with smaller chunks"
                    )
            if size > SPARED and at + size > path.stat().st_size:
                raise InputError(
                    f"{path}: ends inside a record of {size} bytes; record it again, "
                    "or try `mcap recover`"
                )
            file.seek(at + size)


def _channels(reader: McapReader) -> Iterator[tuple[Schema | None, Channel, int]]:
    """An MCAP file's channels, each with a number of messages; it may come again."""
    summary = reader.get_summary()
    counts = (
        summary and summary.statistics and summary.statistics.channel_message_counts
    )
    if not (summary and summary.channels and summary.schemas and counts):
        # A writer may leave them out of the summary.
        for schema, channel, _ in reader.iter_messages(log_time_order=False):
            yield schema, channel, 1
        return
    for channel in summary.channels.values():
        schema = summary.schemas.get(channel.schema_id)
        yield schema, channel, counts.get(channel.id, 0)


def _check_metadata(path: Path) -> None:
    """Refuse a description of a bag that is nested as none is: reading it takes a time
    that grows with the square of its depth, or faster.
    """
    if not path.exists():
        return
    text = file_text(path, TEXT, "record the bag again, or try `ros2 bag reindex`")
    depth = accumulate(1 if c in "[{" else -1 for c in text if c in "[]{}")
    if max(depth, default=0) > _DEEP or _CHAINED.search(text):
        raise InputError(
            f"{path}: is nested more than {_DEEP} deep, as no bag's description is; "
            "record the bag again, or try `ros2 bag reindex`"
        )


@contextmanager
def _rosbag(path: Path) -> Iterator[Bag]:
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.rosbag2 import Reader

    _check_metadata(path / "metadata.yaml")
    with Reader(path) as reader:

        def decoder(topic: str) -> Callable[[bytes], Any]:
            own = [c for c in reader.connections if c.topic == topic]
            (name, definition), *more = {(c.msgtype, c.msgdef) for c in own}
            if more:
                raise InputError(
                    f"{path}: {topic!r} has messages of several types; record one"
                )
            idl = definition.format == MessageDefinitionFormat.IDL
            return _cdr(f"{path}: {topic!r}", name, definition.data, idl)

        def messages(wanted: Collection[str]) -> Iterator[Message]:
            own = [c for c in reader.connections if c.topic in wanted]
            for connection, received, data in reader.messages(own):
                yield Message(connection.topic, 0, received, data)

        topics = {name: topic.msgcount for name, topic in reader.topics.items()}
        yield Bag(topics, decoder, messages)


def _cdr(where: str, name: str, text: str, idl: bool) -> Callable[[bytes], Any]:
    """What decodes CDR messages of a type, as `text` describes it.

    Bags of old recorders hold no description: then the type must be one of ROS 2's.
    """
    from rosbags import typesys
    from rosbags.typesys.msg import normalize_msgtype

    try:
        if len(text) > _TEXT:
            raise ValueError(f"a description of {len(text)} bytes is too long")
        name = normalize_msgtype(name)
        store = typesys.get_typestore(
            typesys.Stores.EMPTY if text else typesys.Stores.LATEST
        )
        rule = "=" * 80 + "\n"
        for part in text.split(rule)[1:] if idl and text.startswith(rule) else [text]:
            if idl:
                part = part.partition("\n")[2] if part.startswith("IDL: ") else part
                types = typesys.get_types_from_idl(part)
            else:
                types = typesys.get_types_from_msg(part, name) if part else {}
            _check_types(types)
            store.register(types)
        store.get_msgdef(name)
    except Exception as err:
        raise InputError(
            f"{where}: messages of type {name!r} cannot be decoded "
            f"({' '.join(str(err).split())[:80]}); record them with their description, "
            "as MCAP does"
        ) from err
    return lambda data: store.deserialize_cdr(data, name)


def _check_types(types: Mapping[str, tuple[Any, Sequence[tuple[str, Any]]]]) -> None:
    """Refuse types that take minutes or gigabytes to compile.

    Code is generated for every field, and for every element of a fixed array that is
    not of numbers.

    Raises:
        ValueError: types beyond `_FIELDS` and `_ELEMENTS`.
    """
    from rosbags.interfaces import Nodetype

    fields = [kind for _, own in types.values() for _, kind in own]
    if len(fields) > _FIELDS:
        raise ValueError(f"{len(fields)} fields are more than {_FIELDS}")
    for kind, what in fields:
        if kind != Nodetype.ARRAY:
            continue
        (inner, base), count = what
        numbers = inner == Nodetype.BASE and base[0] != "string"
        if count > (_NUMBERS if numbers else _ELEMENTS):
            raise ValueError(f"an array of {count} elements is too long")
