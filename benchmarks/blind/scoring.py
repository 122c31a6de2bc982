"""Whether a trace is right: its row beside the truth of its case."""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

from benchmarks.trace.lies import Lie, named
from benchmarks.trace.measures import Row

Truth = Mapping[str, Any]

EDGES = frozenset({"valve_deadband", "return_overlap", "underlap"})
"""What hydrojax calls the overlaps of a valve's four edges."""

OPENED = (("o_p1", "o_n2"), ("o_n1", "o_p2"))
"""Overlaps of the edges that open together."""

SINCE = {"relief_valve": "port_relief"}
"""Laws that were outside the vocabulary when a plant was written, and what hydrojax has
called them since, where the plant calls them otherwise."""


def options(row: Row) -> list[set[str]]:
    """Of each effect that is named, its name and those it cannot be told from."""
    return [{e["name"], *e["cannot_tell_from"]} for e in row["named"]]


def names_of(effect: Mapping[str, Any], layout: str) -> tuple[list[set[str]], set[str]]:
    """What has to be named of a true effect, one of each set, and what may be.

    Overlaps that are the same on both edges that open together are `valve_deadband`.
    With four that differ `return_overlap` comes to it, where it is looked for; and an
    open centre may be said in any words for edges.
    """
    name = effect["name"]
    if name not in EDGES:
        return [{name}], {name}
    fields = effect["fields"] if "fields" in effect else effect["parameters"]
    overlaps = [[fields[edge] for edge in pair] for pair in OPENED]
    if min(map(min, overlaps)) < 0:
        return [set(EDGES)], set(EDGES)
    if all(one == other for one, other in overlaps):
        return [{"valve_deadband"}], {"valve_deadband"}
    must = ["valve_deadband"] + ["return_overlap"] * (layout == "differential")
    return [{name} for name in must], {"valve_deadband", "return_overlap"}


def layout_of(truth: Truth) -> str:
    """A case's layout; every machine is a differential cylinder."""
    return truth.get("layout", "differential")


def said(effect: Mapping[str, Any], layout: str, row: Row) -> bool:
    """Whether a true effect is named, or among what one that is named looks like."""
    must, _ = names_of(effect, layout)
    return all(any(own & given for given in options(row)) for own in must)


def exact(truth: Truth, row: Row) -> bool:
    """Whether every true effect is named and no other."""
    layout = layout_of(truth)
    allowed = set().union(*(names_of(e, layout)[1] for e in truth["effects"]))
    return all(said(e, layout, row) for e in truth["effects"]) and all(
        allowed & given for given in options(row)
    )


def lie_of(truth: Truth) -> Lie:
    """A case's lie, in the terms of `benchmarks.trace.lies`."""
    ((kind, told),) = truth["lie"].items()
    motion = ("psi", "x")
    areas, gauges = ("area", "area_1", "area_2"), ("P_a1", "P_a2")
    channel = told.get("channel", "") if isinstance(told, dict) else told
    inputs, finding = {
        "area": ((*areas, "F"), "factor"),
        "sign": ((channel,), "sign"),
        "swapped": (gauges, "exchanged"),
        "unit": ((*gauges, "P_s") if channel == "P" else (channel,), "unit"),
        "P_s": (("P_s",), "factor"),
        "noise": ((*gauges, "F"), "noise"),
        "offset": ((*motion, "x_mid"), "offset"),  # no finding is called so yet
        "shift": ((channel,), "delay"),
    }[kind]
    return Lie(kind, lambda text, logs: (text, logs), inputs, (finding,))


def called(truth: Truth, row: Row) -> bool:
    """Whether a lie is called by its name.

    That is a finding of the input that lies, or an effect which by the report cannot be
    told from it, or is the same (`channel_skew` of a force that is logged late), or a
    refusal that names it.
    """
    lie = lie_of(truth)
    if not row["ok"]:
        words = set(re.findall(r"\w+", row["reason"]))
        return "InputError" in words and bool(words & set(lie.inputs))
    alike = {*lie.inputs} | ({"channel_skew"} if lie.inputs == ("F",) else set())
    if lie.name not in ("area", "shift"):
        alike = set()
    return named([SimpleNamespace(**f) for f in row["inputs"]], lie) or any(
        alike & given for given in options(row)
    )


def right(truth: Truth, row: Row) -> bool:
    """Whether a trace says of its case what is true."""
    if truth["kind"] == "lie":
        return called(truth, row)
    if not row["ok"]:
        return False
    if truth["kind"] == "nothing":
        return row["verdict"] == "nothing missing" and not row["named"]
    if truth["kind"] == "outside":
        return row["verdict"] == "unknown" or _has_a_name(truth, row)
    return exact(truth, row)


def _has_a_name(truth: Truth, row: Row) -> bool:
    """Whether a law from outside is called what hydrojax calls it by now."""
    names = [{e["name"], SINCE.get(e["name"], "")} for e in truth["effects"]]
    given = options(row)
    return all(any(own & g for g in given) for own in names) and all(
        set().union(*names) & g for g in given
    )
