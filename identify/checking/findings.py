"""What is wrong with the inputs, found in the order in which it would mislead."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from hydrojax.errors import InputError
from hydrojax.identify.checking import words
from hydrojax.identify.checking.factors import (
    flow_left_out,
    force_balance,
    force_factor,
    force_left_out,
    gauge_delay,
    position_delay,
    position_zero,
    supply_factor,
)
from hydrojax.identify.checking.inputs import Inputs
from hydrojax.identify.checking.lines import applied
from hydrojax.identify.checking.regression import bump
from hydrojax.identify.checking.search import mends_wanted
from hydrojax.identify.checking.sensors import DEAD
from hydrojax.identify.checking.words import Finding
from hydrojax.parameters import Spec


def inputs_that_lie(
    of: Inputs, channels: pd.DataFrame, known: Mapping[str, Spec]
) -> tuple[Finding, ...]:
    """What is wrong with the inputs, the worst kind first.

    Args:
        of: the inputs.
        channels: what the logs' channels are like; see `channel_table`.
        known: the parameters of [parameters].
    """
    sensors = words.of_sensors(channels, of.h)
    stuck = [f.input for f in sensors if f.finding == "stuck"]
    no_supply = "P_s" in stuck and words.is_no_supply(channels.loc["P_s"])
    if no_supply or any(channels.repeated[n] > DEAD for n in stuck):
        return tuple(sensors)  # no balance closes with a sensor that is dead
    mended, scale, found = of, dict.fromkeys(channels.index, 1.0), []
    for mend, before, after in mends_wanted(of):
        one = words.of_mend(mend, before, after, of)
        try:
            of = replace(of, spec=applied(of.spec, one.lines))
        except InputError:  # a value that no rig can have
            one = replace(one, lines={})
        found.append(one)
        mended = replace(mend.applied(mended), spec=of.spec)
        for name in mend.inputs:
            scale[name] = scale.get(name, 1.0) * abs(mend.factor)
    noise = {n: scale[n] * float(channels.noise[n]) for n in channels.index}
    if mended.has_flow:
        if (late := gauge_delay(mended) or position_delay(mended)) is not None:
            one = words.of_delay(late, mended)
            try:
                of = replace(of, spec=applied(of.spec, one.lines))
            except InputError:  # later than any channel may be
                one = replace(one, lines={})
            found.append(one)
            mended = mended.brought_forward(late.input, late.seconds)
            mended = replace(mended, spec=of.spec)
        factor = supply_factor(mended)
        if factor is not None:
            found.append(words.of_supply(factor, mended))
            mended = mended.scaled("P_s", factor.factor)
        if (zero := position_zero(mended)) is not None:
            found.append(words.of_zero(zero, mended))
        if (out := flow_left_out(mended)) is not None:
            found.append(
                words.of_left_out(out, "Pa", words.stiffness(mended), known, of)
            )
    if mended.has_force:
        force = force_balance(mended)
        factor = force_factor(mended, force, _floor(mended, noise))
        if factor is not None:
            found.append(words.of_force(factor, of))
        if (out := force_left_out(mended, force)) is not None:
            found.append(words.of_left_out(out, "N", 1.0, known, of))
    found += words.of_noise(of, noise)
    blamed = {name for f in found for name in f.input.split(", ")}
    return (*found, *(f for f in sensors if f.input not in blamed))


def _floor(of: Inputs, noise: Mapping[str, float]) -> float:
    """RMS that the sensors' noise leaves in the force balance, N."""
    weights = {"P_a1": of.geometry.force[0], "P_a2": of.geometry.force[1], "P": 1.0}
    each = [noise.get("F", 0.0), *(w * noise.get(n, 0.0) for n, w in weights.items())]
    return float(np.linalg.norm(each) * np.linalg.norm(bump(of.ticks[1])))
