"""The scoring of `benchmarks.blind`, on made-up results."""

from __future__ import annotations

import pytest

from benchmarks.blind import scoring, table


def truth(kind, *names, lie=None, layout="differential", **fields):
    made = [{"name": name, "fields": fields} for name in names]
    return {"kind": kind, "effects": made, "lie": lie or {}, "layout": layout}


def row(verdict="explained", *names, alike=(), blamed=(), case="c00"):
    named = [{"name": n, "gain": 1.0, "cannot_tell_from": list(alike)} for n in names]
    inputs = [dict(zip(("input", "finding"), b, strict=True)) for b in blamed]
    channels = {"F": {"noise": 2.0, "after": 3.0}, "P_a2": {"noise": 1.0, "after": 1.0}}
    return {
        "case": case, "ok": True, "verdict": verdict, "named": named,
        "inputs": inputs, "channels": channels, "wall": 60.4,
    }  # fmt: skip


PAIRS = {"o_p1": 0.3, "o_n2": 0.3, "o_n1": 0.2, "o_p2": 0.2}
FOUR = PAIRS | {"o_n2": 0.4}
OPEN = dict.fromkeys(PAIRS, -0.1)
BOTH = truth("several", "stribeck", "backlash")
LIES = {
    "sign": ({"sign": "F"}, ("F", "sign"), ("F", "factor")),
    "area": ({"area": 0.95}, ("area_1", "factor"), ("P_s", "factor")),
    "swapped": (
        {"swapped": ["P_a1", "P_a2"]},
        ("P_a1, P_a2", "exchanged"),
        ("F", "sign"),
    ),
    "unit": ({"unit": {"channel": "P"}}, ("P_a1, P_a2", "unit"), ("F", "unit")),
    "noise": ({"noise": 10.0}, ("F", "noise"), ("F", "delay")),
    "shift": ({"shift": {"channel": "psi"}}, ("psi", "delay"), ("P_a1", "delay")),
}


@pytest.mark.parametrize(
    ("of", "found", "right"),
    [
        (truth("nothing"), row("nothing missing"), True),
        (truth("nothing"), row("unknown"), False),
        (truth("nothing"), row("nothing missing", "stribeck"), False),
        (truth("one", "stribeck"), row("unknown", "stribeck"), True),
        (truth("one", "stribeck"), row("explained", "stribeck", "backlash"), False),
        (truth("one", "stribeck"), row("", "backlash", alike=["stribeck"]), True),
        (BOTH, row("explained", "stribeck"), False),
        (BOTH, row("", "stribeck", "backlash"), True),
        (truth("one", "valve_deadband", **PAIRS), row("", "valve_deadband"), True),
        (truth("one", "valve_deadband", **PAIRS), row("", *scoring.EDGES), False),
        (truth("one", "valve_deadband", **FOUR), row("", "valve_deadband"), False),
        (
            truth("one", "valve_deadband", **FOUR),
            row("", "valve_deadband", "return_overlap"),
            True,
        ),
        (
            truth("one", "valve_deadband", layout="pull-pull", **FOUR),
            row("", "valve_deadband"),
            True,
        ),
        (truth("one", "underlap", **OPEN), row("", "underlap", "return_overlap"), True),
        (truth("one", "valve_deadband", **OPEN), row("", "return_overlap"), True),
        (truth("one", "underlap", **OPEN), row("nothing missing"), False),
        (truth("outside", "gland_leak"), row("unknown", "port_relief"), True),
        (truth("outside", "gland_leak"), row("explained", "port_relief"), False),
        (truth("outside", "relief_valve"), row("explained", "port_relief"), True),
        (truth("lie", lie={"area": 1.05}), row("", "stribeck", alike=["area"]), True),
        (truth("lie", lie={"sign": "F"}), row("unknown", "channel_skew"), False),
        *((truth("lie", lie=a), row(blamed=[b]), True) for a, b, _ in LIES.values()),
        *((truth("lie", lie=a), row(blamed=[b]), False) for a, _, b in LIES.values()),
    ],
)  # fmt: skip
def test_what_is_right(of, found, right):
    assert scoring.right(of, found) == right


def test_a_refusal_may_call_a_lie_by_its_name():
    refused = {"ok": False, "reason": "InputError: log.csv: F is 1e9 N"}
    assert scoring.right(truth("lie", lie={"sign": "F"}), refused)
    assert not scoring.right(truth("lie", lie={"sign": "u"}), refused)
    assert not scoring.right(truth("one", "stribeck"), refused)


def test_the_table_counts_kinds():
    lie = truth("lie", lie=LIES["shift"][0] | {})
    failed = {"case": "c04", "ok": False, "reason": "ValueError: a|b", "wall": 1.0}
    cases = [
        (truth("nothing"), row("nothing missing", case="c01")),
        (truth("one", "stribeck"), row("unknown", "stribeck", alike=["x"])),
        (truth("several", "stribeck", "backlash"), row("explained", "backlash")),
        (truth("outside", "gland_leak"), row("unknown", blamed=[("F", "sign")])),
        (lie, row("nothing missing", blamed=[("psi", "delay")])),
        (truth("nothing"), failed),
    ]
    text = table.report(cases)
    assert "| c01 | nothing | - | - | nothing missing | 1.50 | 60 | yes |" in text
    assert "| stribeck or x | unknown |" in text and "| [F: sign] |" in text
    assert "| ValueError: a/b | - | 1 | no |" in text
    said = (line.strip("| ").split(" | ") for line in table.summary(cases).split("\n"))
    counts = {own[0]: own[1].split(" ")[0] for own in said if len(own) == 2}
    assert counts["nothing missing, and said so"] == "1/2"
    assert counts["single effects named"] == "1/1"
    assert counts["single effects named, and `explained`"] == "0/1"
    assert counts["effects of sets named"] == "1/2"
    assert counts["lies called by their name"] == "1/1"
    assert counts["inputs blamed where none lies"] == "1/4"
    assert counts["traces failed"] == "1/6"
