"""Traces recorded cases with hydrojax: the only module here that imports it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.trace.tracing import found


def trace(folder: Path, truth: Mapping[str, Any]) -> dict[str, Any]:
    """The row of one case; a trace that raises has one too, and is not `ok`."""
    began = time.perf_counter()
    try:
        row = {"ok": True} | _traced(folder, truth)
    except Exception as error:  # one case must not end the others' run
        reason = " ".join(str(error).split())
        row = {"ok": False, "reason": f"{type(error).__name__}: {reason}"[:500]}
    wall = time.perf_counter() - began
    return {"case": folder.name, "kind": truth["kind"]} | row | {"wall": wall}


def _traced(folder: Path, truth: Mapping[str, Any]) -> dict[str, Any]:
    from hydrojax.identify import api
    from hydrojax.identify.case import open_case

    fit = sorted(folder.glob("fit_*.csv"))
    case = open_case(folder / "rig.toml", fit, [folder / "validate.csv"])
    outcome = api.trace_case(case)
    inputs = [
        {k: getattr(f, k) for k in ("input", "finding", "factor", "mended")}
        for f in outcome.inputs
    ]
    row = found(outcome, as_known(truth))
    return row | {"inputs": inputs, "seconds": dict(outcome.seconds)}


def as_known(truth: Mapping[str, Any]) -> dict[str, Any]:
    """A truth in the words of `benchmarks.trace`: sizes are in units of the noise."""
    effects = {e["name"]: e for e in truth["effects"]}
    fields = {n: e.get("fields", e.get("parameters")) for n, e in effects.items()}
    sizes = {
        n: e["size"]["validate"] if "size" in e else e["size_in_noise"]
        for n, e in effects.items()
    }
    return {
        "kind": truth["kind"],
        "sizes": {n: max(size.values()) for n, size in sizes.items()},
        "noise": "white",
        "shifted": False,
        "effects": fields,
        "rig": truth.get("rig_parameters", truth["plant"]),
    }
