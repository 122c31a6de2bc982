"""The old model against the new, and remarks on a tuning."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hydrojax.parameters import get, parameter_specs, put
from hydrojax.plant.load import Inertia
from hydrojax.rigfile.build import build_rig
from hydrojax.rigfile.schema import RigFile
from hydrojax.tune.ensemble import Plants
from hydrojax.tune.findings import Findings
from hydrojax.tune.metrics import rig_metrics
from hydrojax.tune.objective import Objective
from hydrojax.tune.optimize import Optimum

Metrics = dict[str, Float[np.ndarray, "plants *rest"]]
"""Metrics of every plant by name, as `Objective.evaluate` gives them."""


def compare_models(
    file: RigFile, findings: Findings, objective: Objective, optimum: Optimum,
    plants: Plants, after: Metrics,
) -> tuple[tuple[str, dict[str, float | None]], ...]:  # fmt: skip
    """The rig's own metrics without and with the effects that trace added.

    Args:
        file: the rig file, with the effects or without.
        findings: that name the effects.
        objective: of the model with them.
        optimum: the gains found.
        plants: the ensemble.
        after: metrics of the model with them, with those gains.

    Returns:
        A title and the metrics, for each model with the gains before and after.
    """
    named = findings.effects
    old_file = replace(
        file, effects={n: e for n, e in file.effects.items() if n not in named}
    )
    rig = build_rig(old_file)
    here = objective.at(None)
    names = list(parameter_specs(rig))
    rig = put(rig, names, get(here.loop.rig, names))
    old = eqx.tree_at(lambda s: s.loop.rig, here, rig)
    only = [i for i, n in enumerate(plants.names) if n in names]
    few = Plants(
        tuple(plants.names[i] for i in only),
        plants.values[:1, only],
        plants.description,
    )
    other = Objective(old, objective.free, few, objective.limits)
    added = ", ".join(n.replace("_", " ") for n in named)
    return (
        (f"old model (without {added}), gains before", rig_metrics(other.before)),
        ("new model, gains before", rig_metrics(objective.before)),
        ("old model, gains after", rig_metrics(other.evaluate(optimum.gains))),
        ("new model, gains after", rig_metrics(after)),
    )


def notes(objective: Objective, after: Metrics) -> tuple[str, ...]:
    """Remarks that a reader of the tuning needs."""
    return (
        *_instability(objective),
        *_resonance(objective, after),
        *_rest(objective, after),
    )


def _instability(objective: Objective) -> list[str]:
    before, out = objective.before, []
    if not np.isfinite(before["peak"]).all():
        out.append("With the gains before, some plants of the ensemble are unstable.")
    rms = before["rms"]
    if np.max(rms) > 5 * rms[0]:
        out.append(
            f"With the gains before, tracking on one plant is {np.max(rms):.0f} N, "
            f"the rig's own {rms[0]:.1f} N: with the joint moving its loop is at or "
            "beyond the stability limit, which a loop linearised at rest does not show."
        )
    return out


def _resonance(objective: Objective, after: Metrics) -> list[str]:
    load = objective.setting.loop.load
    if not isinstance(load, Inertia) or not float(load.stiffness) > 0:
        return []
    at = float(jnp.sqrt(load.stiffness / load.mass)) / 2 / np.pi
    was, now = (
        20 * np.log10(np.interp(at, objective.hertz, np.abs(f["response"][0])))
        for f in (objective.before, after)
    )
    return [
        f"At {at:.1f} Hz, the load's own frequency, it moves under next to no "
        f"force: |F/F_d| is {was:.1f} dB before and {now:.1f} dB after. No gain of "
        "this controller fills that; more damping of the load does."
    ]


def _rest(objective: Objective, after: Metrics) -> list[str]:
    out = []
    if not float(jnp.sum(objective.setting.loop.sensors.F)):
        out.append(
            "The rig file gives no noise of F: the tuning is not limited by noise."
        )
    wide = np.asarray(after["within_1dB"])
    if np.max(wide) > 1.8 * np.min(wide):
        out.append(
            f"Within 1 dB up to {wide[0]:.1f} Hz on the rig itself: the worst plant of "
            "the ensemble limits the guaranteed bandwidth."
        )
    return out
