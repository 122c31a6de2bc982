"""A measured closed-loop run, run again in the loop of the identified rig."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from hydrojax.control.simulation import simulate_loop
from hydrojax.identify.results.outcome import LoopCheck
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.logs.log import Log
from hydrojax.parameters import get, parameter_specs, put
from hydrojax.rigfile.build import build_loop, build_rig, inverts
from hydrojax.rigfile.entries import Entry
from hydrojax.rigfile.scenarios import longest, rerun
from hydrojax.rigfile.schema import RigFile


def identified(spec: RigFile, values: dict[str, float]) -> RigFile:
    """The rig file with its own parameters, and its effects', at identified values."""
    base = dict(spec.parameters)
    effects = {name: dict(given) for name, given in spec.effects.items()}
    for name, value in values.items():
        effect, _, field = name.rpartition(".")
        if effect and effect not in effects:
            continue
        table = effects[effect] if effect else base
        old = table.get(field)
        table[field] = Entry(value, None, old.unit if old else "")
    return replace(spec, parameters=base, effects=effects)


def check_loop(
    spec: RigFile,
    log: Log,
    values: dict[str, float],
    added: tuple[str, ...],
    criteria: Criteria = Criteria(),
) -> LoopCheck | None:
    """Put a log's F_d through the simulated loop and compare F with the measured F.

    The plant is the identified one with all named effects; the law is the paper's with
    the rig file's [controller], and knows the identified parameters. Motion and supply
    are the log's.

    Args:
        spec: the rig file.
        log: what is to be run again.
        values: every parameter by name, SI, as identified.
        added: effects beyond the declared ones.
        criteria: how much of the log is run, and what of it is not compared.

    Returns:
        None where there is no u, F or F_d, or a valve that the law cannot invert.
    """
    if not {"u", "F", "F_d"} <= set(log.signals) or not spec.layout.has_valve:
        return None
    if spec.law is None and not inverts(spec):
        return None
    known = identified(spec, values)
    rig = build_rig(known, added)
    names = tuple(parameter_specs(rig))
    own = np.asarray(get(rig, names))
    at = [values.get(n, v) for n, v in zip(names, own, strict=True)]
    rig = put(rig, names, np.array(at))
    loop = build_loop(known, rig)
    scenario, loop = rerun(known, loop, log, criteria.loop_seconds)
    if scenario is None:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # it is among the figures
        run = simulate_loop(loop, scenario)
    start, stop = longest(log)
    t = log.time[start:stop] - log.time[start]
    keep = (t >= criteria.loop_settle) & (t <= run.t[-1])
    desired, measured = (log.signals[n][start:stop][keep] for n in ("F_d", "F"))
    simulated = np.interp(t[keep], run.t, run["true_F"])

    def rms(y: np.ndarray) -> float:
        return float(np.sqrt(np.mean(y**2)))

    return LoopCheck(
        log=log.name,
        t=t[keep],
        desired=desired,
        measured=measured,
        simulated=simulated,
        rms=rms(measured - simulated),
        tracking_measured=rms(desired - measured),
        tracking_simulated=rms(desired - simulated),
        warning=run.warning(),
    )
