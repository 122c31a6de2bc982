"""Results as Markdown: a line a case, and what they come to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks.trace.measures import Row, share, worst

from . import scoring

Scored = tuple[scoring.Truth, Row]
"""A case's truth, and the row of its trace."""


def report(cases: Sequence[Scored]) -> str:
    """Everything as Markdown."""
    return f"{lines(cases)}\n\n{summary(cases)}\n"


def lines(cases: Sequence[Scored]) -> str:
    """A line a case."""
    out = [
        "| case | kind | truth | found | verdict | after / noise | s | right |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for truth, row in cases:
        after = f"{worst(row, 'after'):.2f}" if row["ok"] else "-"
        cells = (
            row["case"],
            truth["kind"],
            _true(truth),
            _found(row) if row["ok"] else "-",
            row["verdict"] if row["ok"] else row["reason"].replace("|", "/"),
            after,
            f"{row['wall']:.0f}",
            "yes" if scoring.right(truth, row) else "no",
        )
        out.append(f"| {' | '.join(cells)} |")
    return "\n".join(out)


def _true(truth: scoring.Truth) -> str:
    if truth["kind"] == "lie":
        ((kind, told),) = truth["lie"].items()
        if isinstance(told, dict):
            told = " ".join(_short(v) for v in told.values())
        elif not isinstance(told, str):
            told = " ".join(map(_short, told if isinstance(told, list) else [told]))
        return f"{kind}: {told}"
    return ", ".join(e["name"] for e in truth["effects"]) or "-"


def _short(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:.3g}"


def _found(row: Row) -> str:
    """Effects with what they cannot be told from, and inputs that look wrong."""
    names = [
        " or ".join([e["name"], *e["cannot_tell_from"]])
        for e in sorted(row["named"], key=lambda e: -e["gain"])
    ]
    blamed = [f"[{f['input']}: {f['finding']}]" for f in row["inputs"]]
    return ", ".join(names + blamed) or "-"


def summary(cases: Sequence[Scored]) -> str:
    """How many of each kind are right, with Wilson's 95 % interval."""

    def of(kind: str) -> list[Scored]:
        return [case for case in cases if case[0]["kind"] == kind]

    each = [(t, row, e) for t, row in of("several") for e in t["effects"]]
    honest = [case for case in cases if case[0]["kind"] != "lie" and case[1]["ok"]]
    counts = {
        "nothing missing, and said so": share(of("nothing"), _right),
        "single effects named": share(of("one"), _right),
        "single effects named, and `explained`": share(of("one"), _explained),
        "sets named whole": share(of("several"), _right),
        "sets named whole, and `explained`": share(of("several"), _explained),
        "effects of sets named": share(each, _effect_named),
        "outside the vocabulary, and `unknown`": share(of("outside"), _right),
        "lies called by their name": share(of("lie"), _right),
        "inputs blamed where none lies": share(honest, _blames),
        "traces failed": share(cases, _failed),
        "right in all": share(cases, _right),
    }
    out = ["| | |", "|---|---|"]
    return "\n".join(out + [f"| {name} | {count} |" for name, count in counts.items()])


def _right(case: Scored) -> bool:
    return scoring.right(*case)


def _explained(case: Scored) -> bool:
    return scoring.right(*case) and case[1]["verdict"] == "explained"


def _blames(case: Scored) -> bool:
    return bool(case[1]["inputs"])


def _failed(case: Scored) -> bool:
    return not case[1]["ok"]


def _effect_named(case: tuple[scoring.Truth, Row, Any]) -> bool:
    truth, row, effect = case
    return row["ok"] and scoring.said(effect, scoring.layout_of(truth), row)
