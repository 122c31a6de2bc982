"""The fit of one job, and the part of its outcome that a fleet is judged by."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from hydrojax.effects import load_effects
from hydrojax.jax_setup import set_up_fits
from hydrojax.plant.friction import Theta
from hydrojax.workflows.fleet.jobs import Job
from hydrojax.workflows.fleet.work import Options

STARTS = {"identify": 4, "trace": 1}


def solve(job: Job, options: Options) -> dict[str, Any]:
    """Identify or trace the logs of one job.

    Returns:
        Plain data in SI units: what `Store` keeps.

    Raises:
        InputError: whatever is wrong with its files, in one line.
    """
    set_up_fits()
    for path in options.effects:
        _own(path, Path(path).read_bytes())
    from hydrojax.identify import api
    from hydrojax.identify.case import open_case
    from hydrojax.identify.tracing.criteria import Criteria

    criteria = Criteria(matters=options.matters, level=options.level)
    case = open_case(
        job.rig, job.fit, job.validate_, horizon=options.horizon, criteria=criteria
    )
    starts = options.starts or STARTS[options.command]
    if options.command == "identify":
        outcome = api.identify(case, starts, profile=options.profile)
    else:
        outcome = api.trace_case(case, starts, profile=options.profile)
    ranges = {n: e.range for n, e in case.spec.parameters.items() if e.range}
    return row_of(outcome, ranges)


@cache
def _own(path: str, content: bytes) -> None:
    """Take a user's own effects into the vocabulary, once while the file is the same.

    Effects that are read again are other classes, for which all is compiled again.
    """
    load_effects(path)


def row_of(outcome: Any, ranges: Mapping[str, tuple[float, float]]) -> dict[str, Any]:
    """What is kept of an `Outcome`: its fitted parameters, errors and effects.

    `ranges` are those of the rig file: friction's are kept, for its bounds.
    """
    own = {f"{e.name}.{n}": p for e in outcome.effects for n, p in e.parameters.items()}
    every = {n: p for n, p in (outcome.parameters | own).items() if p.free}
    parameters = {
        name: {
            "value": _finite(p.value),
            "std": _finite(p.std),
            "low": _finite(p.interval[0]) if p.interval else None,
            "high": _finite(p.interval[1]) if p.interval else None,
            "unit": p.unit,
            "identified": bool(p.identified),
            "at_bound": bool(p.at_bound),
        }
        for name, p in every.items()
    }
    channels = {
        name: {
            "unit": c.unit,
            "noise": _finite(c.noise),
            "before": _finite(c.before),
            "after": _finite(c.after),
        }
        for name, c in outcome.channels.items()
    }
    effects = [
        {"name": e.name, "alike": list(e.cannot_tell_from)} for e in outcome.effects
    ]
    return {
        "rig": outcome.rig,
        "verdict": outcome.verdict,
        "sentence": outcome.sentence,
        "parameters": parameters,
        "channels": channels,
        "effects": effects,
        "friction": _friction(outcome, ranges),
        "seconds": {n: float(s) for n, s in outcome.seconds.items()},
    }


def _friction(outcome: Any, ranges: Mapping[str, tuple[float, float]]) -> dict:
    """Covariance of theta_f inside its ranges, and the ranges; SI."""
    own = [n for n in Theta._fields if n in ranges and outcome.parameters[n].free]
    found = outcome.covariance
    inside = [n for n in own if found is not None and n in found.names]
    matrix: list = []
    if found is not None:
        at = [found.names.index(n) for n in inside]
        matrix = np.asarray(found.matrix)[np.ix_(at, at)].tolist()
    return {
        "inside": inside,
        "covariance": matrix,
        "ranges": {n: list(ranges[n]) for n in own},
    }


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)
