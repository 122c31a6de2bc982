"""Says how traces compare with the truths: a row a machine, and what they come to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.table import Table

GOOD = 0.9
"""Skill of the run through the whole validation log, from which it counts."""

KINDS = (
    "named exactly",
    "truth and more",
    "missed",
    "rightly nothing",
    "false names",
    "failed",
)


@dataclass(frozen=True)
class Row:
    """One machine: its number, what was left out, and `tracing.trace`'s result."""

    case: int
    left_out: tuple[str, ...]
    result: dict

    @property
    def kind(self) -> str:
        """Which of `KINDS` it is; "missed" is at least one of the left out."""
        if self.result["verdict"] == "failed":
            return "failed"
        named, truth = set(self.result["named"]), set(self.left_out)
        if not truth:
            return "false names" if named else "rightly nothing"
        if named == truth:
            return "named exactly"
        return "truth and more" if named > truth else "missed"

    @property
    def skilled(self) -> bool:
        """Whether every channel's run through the whole log is good."""
        channels = self.result["channels"].values()
        skills = [c["skill"] for c in channels]
        return bool(skills) and all(s is not None and s >= GOOD for s in skills)


def table(rows: Sequence[Row]) -> Table:
    """A row a machine."""
    made = Table(
        "case", "left out", "named", "verdict", "after / noise", "free run, skill", "s"
    )
    for row in rows:
        channels = row.result["channels"].items()
        made.add_row(
            str(row.case),
            "\n".join(row.left_out) or "-",
            "\n".join(sorted(row.result["named"])) or "-",
            row.result.get("error", row.result["verdict"]),
            "\n".join(f"{n} {c['after'] / c['noise']:.2f}" for n, c in channels),
            "\n".join(f"{n} {_free(c)}" for n, c in channels),
            f"{row.result['seconds']:.0f}",
        )
    return made


def _free(channel: dict) -> str:
    """Error and skill of the run through the whole log."""
    if channel["free"] is None:
        return "-"
    skill = channel["skill"]
    said = "-" if skill is None else f"{skill:.4f}"
    return f"{channel['free']:.4g} {channel['unit']}, {said}"


def summary(rows: Sequence[Row]) -> str:
    """Counts of each kind, and of the free runs that are good."""
    counts = {kind: sum(row.kind == kind for row in rows) for kind in KINDS}
    hidden = sum(bool(row.left_out) for row in rows)
    good = sum(row.skilled for row in rows)
    return "\n".join(
        [
            f"of {hidden} machines with something left out: "
            + ", ".join(f"{counts[k]} {k}" for k in KINDS[:3]),
            f"of {len(rows) - hidden} with nothing left out: "
            + ", ".join(f"{counts[k]} {k}" for k in KINDS[3:5]),
            f"failed: {counts['failed']} of {len(rows)}",
            f"skill of {GOOD} or more in every channel: {good} of {len(rows)}",
        ]
    )
