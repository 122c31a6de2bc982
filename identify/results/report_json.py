"""An outcome as the content of report.json."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from hydrojax.identify.results.curve import FoundCurve
from hydrojax.identify.results.outcome import (
    ChannelErrors,
    FoundEffect,
    LongRuns,
    LoopCheck,
    Outcome,
    Parameter,
    PredictedMotion,
    Unexplained,
)
from hydrojax.report.schema import FORMAT


def report_json(outcome: Outcome) -> dict[str, Any]:
    """The content of report.json: SI units; null for what is not a finite number."""
    o = outcome
    found = {
        "format": FORMAT,
        "command": o.command,
        "rig": o.rig,
        "logs": {
            "fit": o.fit_logs,
            "validate": o.validate_logs,
            "test": o.test_logs,
        },
        "verdict": o.verdict,
        "sentence": o.sentence,
        "explained_share": o.explained_share,
        "parameters": {n: _parameter(p) for n, p in o.parameters.items()},
        "channels": {n: _channel(c) for n, c in o.every_channel.items()},
        "effects": [_effect(e) | _drawn(e, o.curves) for e in o.effects],
        "curves": [_curve(c) for c in o.curves],
        **(
            {"beside": {n: _parameter(p) for n, p in o.beside.items()}}
            if o.beside
            else {}
        ),
        "candidates": [asdict(c) for c in o.candidates],
        "unexplained": [_unexplained(u) for u in o.unexplained],
        **({"motion": _motion(o.motion)} if o.motion else {}),
        **({"long_runs": _long_runs(o.long_runs)} if o.long_runs else {}),
        "closed_loop": [_loop(c) for c in o.loops],
        "covariance": asdict(o.covariance) if o.covariance else None,
        "inputs": [asdict(f) for f in o.inputs],
        "limits": o.limits,
        "notes": o.notes,
        "seconds": o.seconds,
        "criteria": asdict(o.criteria),
        "files": [asdict(f) for f in o.files],
    }
    return _strict(found)


def _parameter(p: Parameter) -> dict[str, Any]:
    return {
        "value": p.value,
        "std": p.std,
        "unit": p.unit,
        "interval": p.interval,
        "start": p.start,
        "at_bound": p.at_bound,
        "identified": p.identified,
        "held": not p.free,
        "says": p.description,
        **({"profile": p.profile} if p.profile else {}),
    }


def _effect(e: FoundEffect) -> dict[str, Any]:
    own = {n: _parameter(p) for n, p in e.parameters.items()}
    # Not asdict: it would spell a parameter's fields in another way than the rig's.
    return {
        "name": e.name,
        "parameters": own,
        "p_value": e.p_value,
        "before": e.before,
        "after": e.after,
        "cannot_tell_from": e.cannot_tell_from,
        "betrayed_by": e.residual_axis,
        "share": e.share,
    }


def _drawn(e: FoundEffect, curves: Sequence[FoundCurve]) -> dict[str, Any]:
    """The curve that an effect was found as, and its formula, if it was."""
    for c in curves:
        if c.name == e.name:
            curve = {"signal": c.signal, "unit": c.unit}
            curve |= {"at": c.s, "value": c.y, "std": c.std}
            return {"curve": curve, "formula": c.law or None}
    return {}


def _curve(c: FoundCurve) -> dict[str, Any]:
    own = asdict(c)
    del own["source"]
    own["extrapolated"] = list(c.extrapolated)
    return own


def _channel(c: ChannelErrors) -> dict[str, Any]:
    own = asdict(c)
    if c.validate is None:
        del own["validate"]
    if c.window:
        own |= {"held": c.window.held, "skill": c.window.skill}
    return own


def _motion(m: PredictedMotion) -> dict[str, Any]:
    values = {name: asdict(p) for name, p in m.values.items()}
    return {
        "fitted_to": m.fitted_to,
        "windows": m.windows,
        "channels": {name: _channel(c) for name, c in m.channels.items()},
        "values": values,
    }


def _long_runs(r: LongRuns) -> dict[str, Any]:
    own = {name: asdict(h) for name, h in r.channels.items()}
    return {"seconds": r.seconds, "channels": own}


def _unexplained(u: Unexplained) -> dict[str, Any]:
    own = asdict(u)
    return own | {"says": own.pop("description")}


def _loop(c: LoopCheck) -> dict[str, Any]:
    names = ("log", "rms", "tracking_measured", "tracking_simulated", "warning")
    return {"unit": "N"} | {name: getattr(c, name) for name in names}


def _strict(value: Any) -> Any:
    """The same in JSON's own types, without NaN and infinity."""
    if hasattr(value, "tolist"):
        value = value.tolist()  # an array's or a NumPy number's own way
    if isinstance(value, Mapping):
        return {str(k): _strict(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_strict(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
