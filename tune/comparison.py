"""The old model against the new, controllers beside each other, remarks on a tuning."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hydrojax.parameters import parameter_specs, put
from hydrojax.plant.load import Inertia
from hydrojax.tune.findings import Findings
from hydrojax.tune.metrics import rig_metrics
from hydrojax.tune.objective import Objective
from hydrojax.tune.trials import SPEED, top_speed
from hydrojax.tune.tuning import Tuning

if TYPE_CHECKING:
    import pandas as pd

Metrics = dict[str, Float[np.ndarray, "plants *rest"]]
"""Metrics of every plant by name, as `Objective.evaluate` gives them."""


def compare_models(
    findings: Findings, objective: Objective, gains: Float[np.ndarray, "gains"],
    after: Metrics,
) -> tuple[tuple[str, dict[str, float | None]], ...]:  # fmt: skip
    """The rig's own metrics without and with the effects that trace added.

    Args:
        findings: that name the effects.
        objective: of the model with them.
        gains: the gains found.
        after: metrics of the model with them, with those gains.

    Returns:
        A title and the metrics, for each model with the gains before and after.
    """
    named, rig = findings.effects, objective.setting.loop.rig
    gone = [
        n
        for n, spec in parameter_specs(rig).items()
        if spec.strength and n.partition(".")[0] in named
    ]
    rig = put(rig, gone, np.zeros(len(gone))) if gone else rig
    values = objective.values[:1].copy()
    values[:, [i for i, n in enumerate(objective.names) if n in gone]] = 0.0
    old = eqx.tree_at(lambda s: s.loop.rig, objective.setting, rig)
    other = objective.relaxed(setting=old, values=values)
    added = ", ".join(n.replace("_", " ") for n in named)
    was = rig_metrics(other.evaluate(objective.initial()))
    return (
        (f"old model (without {added}), gains before", was),
        ("new model, gains before", rig_metrics(objective.before)),
        ("old model, gains after", rig_metrics(other.evaluate(gains))),
        ("new model, gains after", rig_metrics(after)),
    )


def notes(objective: Objective, after: Metrics, most: float) -> tuple[str, ...]:
    """Remarks that a reader of the tuning needs."""
    return (
        *_slow(objective),
        *_instability(objective),
        *_resonance(objective, after),
        *_rest(objective, after, most),
    )


def _slow(objective: Objective) -> list[str]:
    setting, speed = objective.setting, objective.trials.speed
    if speed >= SPEED:
        return []
    top = float(top_speed(setting))
    length = float(setting.loop.rig.chambers.length)
    return [
        f"The runs with the joint moving go at up to {1e3 * speed:.3g} mm/s, not at "
        f"the usual {1e3 * SPEED:g}: wide open, the valve holds the piston's friction "
        f"up to {1e3 * top:.3g} mm/s, and the chambers are {1e3 * length:.3g} mm long."
    ]


def _instability(objective: Objective) -> list[str]:
    largest = objective.before["largest_eigenvalue"]
    if np.all(largest < 1):
        return []
    count = int(np.sum(largest >= 1))
    return [
        f"With the gains before, {count} of {largest.size} plants "
        f"{'is' if count == 1 else 'are'} unstable, joint at rest or moving: largest "
        f"eigenvalue {largest.max():.4f}."
    ]


def _resonance(objective: Objective, after: Metrics) -> list[str]:
    load = objective.setting.loop.load
    if not isinstance(load, Inertia):
        return []
    rates = load.natural_frequencies()
    if not np.any(swinging := rates > 1e-3):  # not one that is free to drift
        return []
    at = float(rates[swinging][0]) / 2 / np.pi
    was, now = (
        20 * np.log10(np.interp(at, objective.hertz, np.abs(f["response"][0])))
        for f in (objective.before, after)
    )
    return [
        f"At {at:.1f} Hz, the load's own frequency, it moves under next to no "
        f"force: |F/F_d| is {was:.1f} dB before and {now:.1f} dB after. No gain of "
        "this controller fills that; more damping of the load does."
    ]


def _rest(objective: Objective, after: Metrics, most: float) -> list[str]:
    out, rate = [], float(1 / objective.setting.loop.h)
    if most < 0.4 * rate:
        out.append(
            f"No band beyond {most:g} Hz, a tenth of the sampling rate, is promised: "
            "the rig file does not give both valve_lag and valve_delay."
        )
    if not float(jnp.sum(objective.setting.loop.sensors.F)):
        out.append(
            "The rig file gives no noise of F: the tuning is not limited by noise."
        )
    return out


FIGURES = {
    "follows_to_Hz": "follows Hz",
    "within_1dB_Hz": "1 dB Hz",
    "lag_90_Hz": "90° Hz",
    "peak_dB": "peak dB",
    "rms_N": "locked N",
    "rms_moving_N": "moving N",
}
"""What controllers are compared by, by the names of tune.json: bands, the peak, and the
tracking error's RMS with the joint locked and moving."""


def compare_controllers(found: Mapping[str, Tuning]) -> pd.DataFrame:
    """A row for each controller, tuned on the same plants: `FIGURES` of the worst one.

    `proposed` says whether its gains held in all runs; where they did not, the figures
    are those of its first gains.
    """
    import pandas as pd

    rows = {
        name: {"proposed": one.proposal.found, **one.proposal.after.figures(None)}
        for name, one in found.items()
    }
    frame = pd.DataFrame.from_dict(rows, orient="index").rename_axis("controller")
    return frame.loc[:, ["proposed", *FIGURES]]
