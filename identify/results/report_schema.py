"""The JSON schema of report.json: its keys, their types and what they mean."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

NUMBER: dict[str, Any] = {"type": ["number", "null"]}
TEXT: dict[str, Any] = {"type": "string"}
NAMES: dict[str, Any] = {"type": "array", "items": TEXT}


def report_schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12); readers ignore keys that they do not know."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "hydrojax report",
        "type": "object",
        "properties": {name: with_ | {"description": said}
                       for name, (with_, said) in KEYS.items()},
        "required": list(KEYS)[:-1],
    }  # fmt: skip


def _table(entries: Mapping[str, dict[str, Any]], *required: str) -> dict[str, Any]:
    """An object with these keys, and others."""
    return {
        "type": "object",
        "properties": dict(entries),
        "required": list(required or entries),
    }


def _each(entry: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "additionalProperties": entry}


def _list(entry: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": entry}


_PAIR = {"type": ["array", "null"], "items": NUMBER, "minItems": 2, "maxItems": 2}
_BOOL: dict[str, Any] = {"type": "boolean"}
_PARAMETER = _table(
    {
        "value": NUMBER, "std": NUMBER, "unit": TEXT, "interval": _PAIR,
        "start": NUMBER, "at_bound": _BOOL, "identified": _BOOL, "held": _BOOL,
    },
    "value", "std", "unit",
)  # fmt: skip
_HORIZON = _table({n: NUMBER for n in ("before", "after", "held", "arx")})
_CHANNEL = _table(
    {
        "unit": TEXT, "noise": NUMBER, "before": NUMBER, "after": NUMBER,
        "held": NUMBER, "skill": NUMBER, "horizons": _each(_HORIZON),
        "validate": _table({"before": NUMBER, "after": NUMBER}),
    },
    "unit", "noise", "before", "after",
)  # fmt: skip
_EFFECT = _table(
    {
        "name": TEXT, "parameters": _each(_PARAMETER), "p_value": NUMBER,
        "before": _each(NUMBER), "after": _each(NUMBER), "cannot_tell_from": NAMES,
        "share": NUMBER,
    }
)  # fmt: skip
_CANDIDATE = _table(
    {
        "name": TEXT,
        "status": {"enum": ["added", "absent", "cannot tell", "rejected"]},
        "p_value": NUMBER, "power": NUMBER, "share": NUMBER, "why": TEXT,
    },
    "name", "status", "p_value", "power",
)  # fmt: skip
_REST = _table({"channel": TEXT, "excess": NUMBER, "unit": TEXT, "follows": TEXT,
                "says": TEXT})  # fmt: skip
_LOOP = _table({"log": TEXT, "unit": TEXT, "rms": NUMBER, "tracking_measured": NUMBER,
                "tracking_simulated": NUMBER})  # fmt: skip
_FINDING = _table({"input": TEXT, "finding": TEXT, "factor": NUMBER,
                   "error_if_mended": NUMBER, "says": TEXT})  # fmt: skip
_FILE = _table({"name": TEXT, "use": {"enum": ["fit", "validate", "test"]},
                "rows": {"type": "integer"}, "seconds": NUMBER,
                "sha256": TEXT})  # fmt: skip

KEYS: Mapping[str, tuple[dict[str, Any], str]] = {
    "format": ({"const": "hydrojax-report/1"}, "version of this format"),
    "command": ({"enum": ["identify", "trace"]}, "what made it"),
    "rig": (TEXT, "name in the rig file"),
    "logs": (_table({n: NAMES for n in ("fit", "validate", "test")}),
             "names of the files by what they were for"),
    "verdict": ({"enum": ["nothing missing", "explained", "unknown"]},
                "every channel at its noise without an effect, with effects, or not"),
    "sentence": (TEXT, "the verdict in words"),
    "explained_share": (NUMBER, "part of the squared error above the noise that the "
                        "effects take, 0 to 1"),
    "parameters": (_each(_PARAMETER), "of the rig, by name; `held`: not fitted"),
    "channels": (_each(_CHANNEL), "errors by channel, RMS of measured - replayed; "
                 "`held`, `skill`: against the value held from a window's start; "
                 "`horizons`: runs of 1 s, 5 s and the whole log; `validate`: of the "
                 "validation logs, where test logs were given"),
    "effects": (_list(_EFFECT), "effects that were named"),
    "candidates": (_list(_CANDIDATE), "every effect that was tried, and what became "
                   "of it"),
    "unexplained": (_list(_REST), "channels that stay above their noise"),
    "closed_loop": (_list(_LOOP), "measured loops, run again in simulation"),
    "covariance": ({"type": ["object", "null"]}, "of the fitted parameters: `names`, "
                   "`matrix`"),
    "inputs": (_list(_FINDING), "inputs that look wrong, as `check` finds them"),
    "limits": (NAMES, "what is at a range's end or not identified, in words"),
    "notes": (NAMES, "how the logs were read"),
    "seconds": (_each(NUMBER), "time spent compiling and running"),
    "criteria": ({"type": "object"}, "the thresholds that decided"),
    "files": (_list(_FILE), "the logs, their lengths and hashes"),
    "made": (_table({n: TEXT for n in ("version", "date", "command_line")}),
             "version, date and command"),
    "rig_toml_sha256": (TEXT, "of the rig.toml beside it, where there is one"),
}  # fmt: skip
"""Top-level keys: what they hold, and what they mean. SI; null is no finite number."""
