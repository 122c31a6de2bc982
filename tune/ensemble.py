"""Plants that could be the rig: what a sweep or a tuning must hold for."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hydrojax.errors import InputError
from hydrojax.parameters import get, parameter_specs, specs
from hydrojax.plant.rig import Rig
from hydrojax.rigfile.quantities import Setting
from hydrojax.tune.findings import Findings

SPREAD = 0.2
"""Half-width (relative) within which the parameters of an ensemble lie."""

SPOOL_HZ, SPOOL_RANGE = 100.0, (50.0, 200.0)
"""Of a spool that the rig file does not give: what the rig itself is taken to have, and
the range of the others, Hz. Data sheets of proportional and servo valves give 50 to 200
at small commands."""

DELAY, DELAY_RANGE = 1.0, (0.5, 1.5)
"""Of a delay that it does not give: the rig's own and the others', samples. A loop that
reads, computes and then writes is late by one."""

PRESLIDING = (0.0, 0.8)
"""Range of k_fp and k_fn over the others where it gives neither."""

FRICTION = ("k_cp", "k_cn", "k_0", "k_vp", "k_vn", "k_fp", "k_fn")
"""Of the friction, what an ensemble varies, beside bulk modulus and valve constants."""


@dataclass(frozen=True)
class Plants:
    """An ensemble of plants.

    Attributes:
        names: of the parameters in which the plants differ.
        values: of each plant, SI; the first plant is the rig itself.
        description: where they come from.
    """

    names: tuple[str, ...]
    values: Float[np.ndarray, "plants names"]
    description: str = ""


def ensemble(
    setting: Setting, count: int, spread: float = SPREAD, seed: int = 0
) -> Plants:
    """The rig itself, and others within `spread` of it: uniform and independent.

    Args:
        setting: whose plant is the first.
        count: of all plants.
        spread: relative half-width for bulk modulus, valve constants, `FRICTION`.
        seed: of the draw.
    """
    rig = setting.loop.rig
    names = ("beta", *specs(rig.valve), *FRICTION)
    here = np.asarray(get(rig, names))
    rng = np.random.default_rng([seed, 21])
    factor = 1 + spread * rng.uniform(-1, 1, (count, here.size))
    factor[0] = 1.0
    text = f"{count} plants, ±{100 * spread:g} % on β, valve constants and friction"
    return Plants(names, here * factor, text)


def from_findings(
    setting: Setting, findings: Findings, count: int, seed: int = 0
) -> Plants:
    """Plants drawn from what `identify` or `trace` found, the found one first.

    Args:
        setting: whose rig has the report's parameters.
        findings: the report's plant, with standard deviations.
        count: of all plants.
        seed: of the draw.

    Raises:
        InputError: nothing in the report was fitted.
    """
    found = findings.known(setting)
    known = parameter_specs(setting.loop.rig)
    free = [n for n, p in found.items() if p.std and p.value is not None]
    if not free:
        raise InputError(
            f"{findings.source}: nothing in its report was fitted; use --spread instead"
        )
    middle = np.array([found[n].value for n in free])
    root, text = _root(findings, free)
    rng = np.random.default_rng([seed, 22])
    values = middle + rng.normal(size=(count, middle.size)) @ root.T
    # The covariance says how well the model's parameters are known, not how well the
    # model is: that is what the validation residual shows.
    rig = setting.loop.rig
    more = [n for n in ("beta", *specs(rig.valve), *FRICTION) if n not in free]
    rest = np.asarray(get(rig, more)) if more else np.zeros(0)
    values = np.hstack([values, np.tile(rest, (count, 1))])
    wide = findings.residual
    values = values * (1 + wide * rng.uniform(-1, 1, values.shape))
    values[0] = [*middle, *rest]
    names = (*free, *more)
    low = np.array([known[n].lower for n in names])
    high = np.array([known[n].upper for n in names])
    values = np.clip(values, low, high)
    text += f", and ±{100 * wide:.2g} % by its validation residual"
    return Plants(names, values, f"{count} plants as {findings.source} found, {text}")


def with_unsaid(
    setting: Setting,
    plants: Plants,
    given: Collection[str],
    seed: int = 0,
    fitted: Collection[str] = (),
) -> Plants:
    """The plants with what a rig file may leave unsaid: spool, delay, presliding.

    Args:
        setting: with the effects `valve_lag` and `valve_delay` in its rig.
        plants: the ensemble; the rig itself is the first.
        given: names of effects and parameters that are known, absent ones too: these
            keep their values.
        seed: of the draw.
        fitted: names of those that logs gave. Of a spool and a delay logs may show the
            sum alone: what is assumed of the one is taken off the other that was
            fitted, as much as it has.
    """
    rng, rig = np.random.default_rng([seed, 23]), setting.loop.rig
    count, said = len(plants.values), []
    values = dict(zip(plants.names, plants.values.T, strict=True))
    known = parameter_specs(rig)
    for name in ("valve_lag.tau", "valve_delay.tau_u"):
        if name in known and name not in values:
            values[name] = np.full(count, float(get(rig, (name,))[0]))
    if "valve_lag" not in given and "valve_lag.tau" in known:
        low, high = np.log(SPOOL_RANGE)
        hertz = np.exp(rng.uniform(low, high, count))
        hertz[0] = SPOOL_HZ
        values["valve_lag.tau"] = 1 / (2 * np.pi * hertz)
        said.append(f"a spool of {SPOOL_RANGE[0]:g} to {SPOOL_RANGE[1]:g} Hz")
    if "valve_delay" not in given and "valve_delay.tau_u" in known:
        samples = rng.uniform(*DELAY_RANGE, count)
        samples[0] = DELAY
        values["valve_delay.tau_u"] = samples * float(setting.loop.h)
        said.append(f"{DELAY_RANGE[0]:g} to {DELAY_RANGE[1]:g} samples of delay")
    if rest := _taken_off(rig, values, set(given), set(fitted)):
        said[-1] += rest
    if not {"k_fp", "k_fn"} & set(given) and {"k_fp", "k_fn"} <= set(known):
        both = rng.uniform(*PRESLIDING, (2, count))
        both[:, 0] = np.asarray(get(rig, ("k_fp", "k_fn")))
        values |= {"k_fp": both[0], "k_fn": both[1]}
        said.append(f"presliding of {PRESLIDING[0]:g} to {PRESLIDING[1]:g}")
    text = plants.description
    if said:
        text += f"; not in the rig file and assumed: {', '.join(said)}"
    return Plants(tuple(values), np.stack(list(values.values()), axis=1), text)


def _taken_off(
    rig: Rig, values: dict[str, np.ndarray], given: set[str], fitted: set[str]
) -> str:
    """Take what a spool is late by at low frequencies off a fitted delay, or a delay
    off a fitted spool, where the other is assumed; in words that it was done.
    """
    spool, delay = values.get("valve_lag.tau"), values.get("valve_delay.tau_u")
    if spool is None or delay is None or len({"valve_lag", "valve_delay"} & given) != 1:
        return ""
    slope = 2 * float(get(rig, ("valve_lag.zeta",))[0])
    if "valve_delay" in fitted & given:
        values["valve_lag.tau"] = np.minimum(spool, delay / slope)
        values["valve_delay.tau_u"] = delay - slope * values["valve_lag.tau"]
        return ", whose lag is taken off the delay that was found"
    if "valve_lag" in fitted & given:
        values["valve_delay.tau_u"] = np.minimum(delay, slope * spool)
        values["valve_lag.tau"] = spool - values["valve_delay.tau_u"] / slope
        return ", taken off the lag of the spool that was found"
    return ""


def _root(findings: Findings, free: list[str]) -> tuple[Float[np.ndarray, "n n"], str]:
    """A square root of the covariance of what is free, and what it is in words."""
    std = np.array([findings.parameters[n].std for n in free])
    full = findings.covariance
    if full is None or not set(free) <= set(full[0]):
        return np.diag(std), "without correlations, which the report does not hold"
    at = [full[0].index(n) for n in free]
    matrix = full[1][np.ix_(at, at)]
    # Of the correlations: the parameters are forty powers of ten apart in square.
    each = np.sqrt(np.diag(matrix))
    size, turn = np.linalg.eigh(matrix / np.outer(each, each))
    return each[:, None] * turn * np.sqrt(np.maximum(size, 0)), "from its covariance"
