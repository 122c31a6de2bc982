"""Traces recorded machines with hydrojax: the only module that imports it."""

from __future__ import annotations

import json
import time
import traceback
from pathlib import Path

from . import files
from .record import LOGS


def trace(folder: Path) -> dict:
    """Trace one machine's folder, keep the result in it, and return that.

    A trace that raises is a result too: its verdict is "failed".
    """
    began = time.perf_counter()
    try:
        result = _traced(folder)
    except Exception as error:  # one machine must not end the others' run
        result = {
            "verdict": "failed",
            "named": [],
            "channels": {},
            "error": f"{type(error).__name__}: {error}",
            "traceback": traceback.format_exc(),
        }
    result["seconds"] = time.perf_counter() - began
    files.write_text(folder / files.RESULT, json.dumps(result, indent=1) + "\n")
    return result


def _traced(folder: Path) -> dict:
    from hydrojax.identify import api
    from hydrojax.identify.case import open_case

    logs = [folder / f"{name}.csv" for name in LOGS]
    case = open_case(folder / files.RIG, logs[:2], logs[2:])
    outcome = api.trace_case(case)
    channels = {}
    for name, c in outcome.channels.items():
        free = c.horizons.get("free")
        channels[name] = {
            "unit": c.unit,
            "noise": c.noise,
            "before": c.before,
            "after": c.after,
            "free": None if free is None else free.after,
            "skill": None if free is None else free.skill,
        }
    return {
        "verdict": outcome.verdict,
        "sentence": outcome.sentence,
        "named": [e.name for e in outcome.effects],
        "effects": {
            e.name: {n: p.value for n, p in e.parameters.items()}
            for e in outcome.effects
        },
        "parameters": {n: p.value for n, p in outcome.parameters.items()},
        "channels": channels,
    }
