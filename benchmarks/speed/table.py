"""From what was measured, as plain data, to Markdown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

Found = Mapping[str, Any]

TITLES = {
    "loop": "Closed loop",
    "sweep": "A sweep",
    "replay": "Replay and its derivative",
    "identify": "A whole identification",
    "trace": "Trace",
    "scaling": "Scaling",
}


def number(value: float) -> str:
    """Three digits, without an exponent where that is short enough."""
    if not math.isfinite(value):
        return "–"
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        digits = max(2 - math.floor(math.log10(abs(value) or 1.0)), 0)
        return f"{value:.{digits}f}"
    return f"{value:.2e}"


def between(one: Found) -> str:
    """A median and, where there is more than one value, its quartiles."""
    if one["count"] < 2:
        return number(one["median"])
    return f"{number(one['median'])} ({number(one['lower'])}–{number(one['upper'])})"


def rows(header: Sequence[str], body: Sequence[Sequence[str]]) -> list[str]:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *body]
    return [f"| {' | '.join(line)} |" for line in lines]


def programs(found: Sequence[Found]) -> list[str]:
    """Programs by what they were timed on: one table for each."""
    out: list[str] = []
    for case in dict.fromkeys(r["case"] for r in found):
        own = [r for r in found if r["case"] == case]
        said = any("remark" in r for r in own)
        apart = any(r.get("device_mib") for r in own)
        header = [case, own[0]["unit"], "ready s", "peak MiB"]
        header += ["device MiB"] * apart + ["reaches"] * said
        body = [
            [
                r["program"], between(r), number(r["ready_s"]), f"{r['peak_mib']:.0f}",
                *([f"{r.get('device_mib') or 0:.0f}"] * apart),
                *([r.get("remark", "")] * said),
            ]
            for r in own
        ]  # fmt: skip
        out += [*rows(header, body), ""]
    return out


def figures(found: Sequence[Found]) -> list[str]:
    """Figures beside their goals."""
    if not found:
        return []
    body = []
    for f in found:
        kept = {True: "met", False: "**missed**"}.get(f.get("met"), "")
        unit = "" if f["unit"] in ("1", "times") else f" {f['unit']}"
        body.append([f["says"], between(f) + unit, f.get("goal", ""), kept])
    return [*rows(["figure", "median (quartiles)", "goal", ""], body), ""]


def points(sweeps: Mapping[str, Found]) -> list[str]:
    """Points of the scaling sweeps."""
    out: list[str] = []
    for name, sweep in sweeps.items():
        header = [f"{name} [{sweep['unit']}]", "s", "peak MiB"]
        body = [
            [f"{p['x']:g}", number(p["seconds"]), f"{p['mib']:.0f}"]
            for p in sweep["points"]
        ]
        out += [*rows(header, body), ""]
    return out


def machine(found: Found) -> str:
    """One line on where this was measured."""
    versions = ", ".join(f"{k} {v}" for k, v in found["versions"].items())
    size = f"{found['cores']} cores, {found['memory_gib']:.0f} GiB"
    on = f", JAX on {found['device']}" if found["device"] != "cpu" else ""
    return f"{found['processor']}, {size}{on}; {versions}"


def report(data: Found) -> str:
    """Everything as Markdown."""
    out = ["# Speed", ""]
    for name, group in data["groups"].items():
        mode = "a quick run: small sizes, coarse figures" if group["quick"] else "full"
        out += [f"## {TITLES[name]}", "", f"{group['when']}, {mode}. "
                f"{machine(group['machine'])}.", ""]  # fmt: skip
        out += figures(group["figures"]) + programs(group["rows"])
        out += points(group["points"])
        out += [f"![{plot}]({plot})" for plot in group["plots"]]
        out += [""] * bool(group["plots"]) + [f"- {note}" for note in group["notes"]]
        out += [""] * bool(group["notes"])
    missed = [
        f["says"]
        for group in data["groups"].values()
        for f in group["figures"]
        if f.get("met") is False
    ]
    asked = sum("met" in f for g in data["groups"].values() for f in g["figures"])
    out.insert(
        2,
        f"{asked - len(missed)} of {asked} goals are met. Ready: building, compiling "
        "and the first run's surplus, nothing cached; memory is the peak of the "
        "program's process.\n",
    )
    return "\n".join(out).rstrip() + "\n"
