"""Logs from where they are recorded: MCAP files and ROS 2 bags.

A signal is a field of a topic's messages, `/pressures.values[0]`, which the rig file's
[channels] names. Messages are CDR, described in the bag (ros2msg or IDL) or known to
ROS 2, or JSON. A sample's time is the message's `header.stamp` where that is set;
otherwise the time it was published, where the file has that; otherwise the time it was
logged.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hydrojax.errors import WORD, InputError, one_line
from hydrojax.logs.bagfile import Bag, open_bag
from hydrojax.logs.clocks import Stream
from hydrojax.logs.resample import on_one_base
from hydrojax.logs.tables import Column, File

_STEP = re.compile(r"\.([^.\[\]]+)|\[(\d+)\]")

_SHOWN = 12  # names in a message, at most

_EXAMPLE = 'u = { column = "/valve/command.data", unit = "V" }'


class _Place(NamedTuple):
    """Where a signal is: its column as written, the topic, and the way to the field."""

    column: str
    topic: str
    steps: tuple[str | int, ...]


def read_bag(path: Path, columns: Mapping[str, str]) -> File:
    """Read the signals of a bag, brought to one time base.

    Args:
        path: a .mcap or .db3 file, or the folder of a ROS 2 bag.
        columns: topic and field of each signal, such as `/pressures.values[0]`.

    Returns:
        Columns `time` (s, from the first tick) and those asked for, NaN where a
        channel has a gap; topics that were left alone, without values.

    Raises:
        InputError: no such bag, or a damaged or empty one; the libraries to read it
            are not installed; `columns` is empty, or names a topic or a field that is
            not there, a field that is no number, or messages that cannot be decoded;
            the topics have no time in common.
    """
    if "time" in columns:
        raise InputError(
            f"{path}: a bag's messages have times of their own; take time out of the "
            "rig file's [channels]"
        )
    with open_bag(path) as bag:
        places = _places(path, bag, columns)
        streams = _streams(path, bag, places)
    try:
        time, signals, notes = on_one_base(streams)
    except InputError as err:
        raise InputError(f"{path}: {err}") from err
    found = [Column(p.column, p.column, None, signals[n]) for n, p in places.items()]
    others = set(bag.topics) - {p.topic for p in places.values()}
    return File(
        path,
        [
            Column("time", "time", "s", time),
            *found,
            *(
                Column(t, t, None, np.empty(0))
                for t in sorted(one_line(topic, WORD) for topic in others)
            ),
        ],
        header=0,
        notes=tuple(notes),
    )


def _places(path: Path, bag: Bag, columns: Mapping[str, str]) -> dict[str, _Place]:
    """Where each signal is."""
    topics = [t for t, count in bag.topics.items() if count and t.isprintable()]
    if not topics:
        raise InputError(f"{path}: the bag holds no message; record the log again")
    if not columns:
        raise InputError(
            f"{path}: say in the rig file's [channels] where the signals are, such as "
            f"{_EXAMPLE}; the topics are {_some(sorted(topics))}"
        )
    out: dict[str, _Place] = {}
    for name, column in columns.items():
        column = column.strip()
        fits = [t for t in topics if _under(column, t)]
        if not fits:
            raise InputError(_no_topic(path, bag, name, column, topics))
        topic = max(fits, key=len)
        rest = column[len(topic) :]
        parts = list(_STEP.finditer(rest))
        if "".join(m[0] for m in parts) != rest:
            raise InputError(
                f"{path}: [channels] {name}: {column!r} is no field; write dots and "
                "indices, such as /pressures.values[0]"
            )
        twin = next((n for n, p in out.items() if p.column == column), None)
        if twin:
            raise InputError(
                f"{path}: [channels] {twin} and {name} both name {column!r}; mend one"
            )
        steps = tuple(m[1] if m[1] else int(m[2]) for m in parts)
        out[name] = _Place(column, topic, steps)
    return out


def _under(column: str, topic: str) -> bool:
    """Whether a column names a topic, or something in its messages."""
    return f"{column}.".startswith((f"{topic}.", f"{topic}["))


def _no_topic(
    path: Path, bag: Bag, name: str, column: str, topics: Collection[str]
) -> str:
    silent = [t for t in bag.topics if _under(column, t)]
    said = f"topic {silent[0]!r} holds no message" if silent else "no such topic"
    head, _, tail = column.rpartition("/")
    topic = f"{head}/{re.split(r'[.[]', tail)[0]}" if head or tail != column else column
    near = get_close_matches(topic, topics, n=3)
    hint = f"near it: {_some(near)}" if near else f"it has {_some(sorted(topics))}"
    return f"{path}: [channels] {name} = {column!r}: {said}; {hint}; mend it"


def _streams(path: Path, bag: Bag, places: Mapping[str, _Place]) -> list[Stream]:
    """Each topic's samples, in the order of the file."""
    own: dict[str, dict[str, _Place]] = {}
    for name, place in places.items():
        own.setdefault(place.topic, {})[name] = place
    decoders = {topic: bag.decoder(topic) for topic in own}
    rows: dict[str, list[tuple[int, int, int, list[Any]]]] = {t: [] for t in own}
    first: dict[str, Any] = {}
    for message in bag.messages(list(own)):
        topic = message.topic
        content = decoders[topic](message.data)
        first.setdefault(topic, content)
        values = [_number(path, n, p, content) for n, p in own[topic].items()]
        rows[topic].append(
            (_stamp(content), message.published, message.received, values)
        )
    for topic, signals in own.items():
        if not rows[topic]:
            raise InputError(f"{path}: topic {topic!r} holds no message; record again")
        for i, (name, place) in enumerate(signals.items()):
            if all(row[3][i] is None for row in rows[topic]):
                raise InputError(_no_field(path, name, place, first[topic]))
    return [_stream(topic, list(own[topic]), rows[topic]) for topic in own]


def _stream(
    topic: str, names: list[str], rows: list[tuple[int, int, int, list[Any]]]
) -> Stream:
    """A topic's samples, by the best of its times."""
    times = np.array([row[:3] for row in rows], dtype=np.int64)
    values = np.array([row[3] for row in rows], dtype=float)
    header, published, received = times.T
    by, stamp = "log time", received
    if np.mean(header != 0) > 0.5:
        by, stamp = "header.stamp", header
    elif np.mean(published != 0) > 0.5 and (published != received).any():
        by, stamp = "publish time", published
    known = (stamp != 0) | (by == "log time")
    signals = {name: values[known, i] for i, name in enumerate(names)}
    return Stream(topic, by, stamp[known], received[known], signals)


def _reach(content: Any, steps: Iterable[str | int]) -> Any:
    """The field that the steps lead to; None if it is not there."""
    for step in steps:
        if isinstance(step, int):
            listed = isinstance(content, (list, tuple, np.ndarray))
            content = content[step] if listed and step < len(content) else None
        elif isinstance(content, dict):
            content = content.get(step)
        else:
            known = getattr(content, "__dataclass_fields__", ())
            content = getattr(content, step) if step in known else None
    return content


def _number(path: Path, name: str, place: _Place, content: Any) -> float | None:
    """A signal's value in a message; None if it has none."""
    value = _reach(content, place.steps)
    if value is None:
        return None
    if isinstance(value, (bool, int, float, np.number, np.bool_)):
        return float(value)
    raise InputError(_no_field(path, name, place, content))


def _stamp(content: Any) -> int:
    """A message's `header.stamp`, ns; 0 if it has none."""
    stamp = _reach(content, ("header", "stamp"))
    seconds = _reach(stamp, ("sec",))
    if not isinstance(seconds, int):
        return 0
    rest = _reach(stamp, ("nanosec",)) or _reach(stamp, ("nsec",)) or 0
    return seconds * 1_000_000_000 + int(rest)


def _no_field(path: Path, name: str, place: _Place, content: Any) -> str:
    there = _reach(content, place.steps) is not None
    said = "is not a number" if there else "is not a field of its messages"
    known = [place.topic + leaf for leaf in _leaves(content)]
    near = get_close_matches(place.column, known, n=3, cutoff=0.75)
    hint = f"near it: {_some(near)}" if near else f"they have {_some(known)}"
    if not known:
        hint = "they have no number"
    return f"{path}: [channels] {name} = {place.column!r} {said}; {hint}; mend it"


def _leaves(content: Any, at: str = "") -> Iterator[str]:
    """Ways to all numbers in a message; of a list, to the first few."""
    if isinstance(content, (bool, int, float, np.number)):
        yield at
    elif isinstance(content, (list, tuple, np.ndarray)):
        for i, item in enumerate(content[:4]):
            yield from _leaves(item, f"{at}[{i}]")
    else:
        fields = content if isinstance(content, dict) else ()
        for name in fields or getattr(content, "__dataclass_fields__", ()):
            if name not in ("header", "__msgtype__"):
                yield from _leaves(_reach(content, (name,)), f"{at}.{name}")


def _some(names: Collection[str]) -> str:
    """Names in a list, the first few of many."""
    shown = ", ".join(list(names)[:_SHOWN])
    return shown + (f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else "")
