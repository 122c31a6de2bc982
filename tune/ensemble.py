"""Plants that could be the rig: what a sweep or a tuning must hold for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hydrojax.errors import InputError
from hydrojax.parameters import get, parameter_specs, specs
from hydrojax.rigfile.quantities import Setting
from hydrojax.tune.findings import Findings

SPREAD = 0.2
"""Half-width (relative) within which the parameters of an ensemble lie."""

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
    values[0] = middle
    low = np.array([known[n].lower for n in free])
    high = np.array([known[n].upper for n in free])
    values = np.clip(values, low, high)
    return Plants(
        tuple(free), values, f"{count} plants as {findings.source} found, {text}"
    )


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
