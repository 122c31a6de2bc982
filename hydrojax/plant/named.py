"""A rig's parameters by name: `beta`, `internal_leakage.c_il`, ..."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from hydrojax.parameters import Spec, specs
from hydrojax.plant.places import PLACES
from hydrojax.plant.rig import Rig


def _parts(rig: Rig) -> Iterable[tuple[str, int | None, str, eqx.Module]]:
    """(attribute, index in its tuple, prefix of names, module)."""
    for part in ("valve", "chambers", "mechanics"):
        yield part, None, "", getattr(rig, part)
    for place in PLACES:
        for i, effect in enumerate(getattr(rig, place)):
            yield place, i, f"{effect.name}.", effect


def _modules(rig: Rig) -> dict[str, tuple[str, int | None, str]]:
    return {
        prefix + field: (part, i, field)
        for part, i, prefix, module in _parts(rig)
        for field in specs(module)
    }


def parameter_specs(rig: Rig) -> dict[str, Spec]:
    """Every parameter's declaration by name: `beta`, `internal_leakage.c_il`, ..."""
    return {
        prefix + field: spec
        for _, _, prefix, module in _parts(rig)
        for field, spec in specs(module).items()
    }


def hydraulic_names(rig: Rig) -> frozenset[str]:
    """Names of the parameters on which the pressures depend."""
    hydraulic = {place.name for place in PLACES.values() if place.hydraulic}
    hydraulic |= {"valve", "chambers"}
    return frozenset(n for n, at in _modules(rig).items() if at[0] in hydraulic)


def gauge_names(rig: Rig) -> frozenset[str]:
    """Names of the parameters of what the pressure sensors read, beside the pressure.

    Residuals of the pressures depend on them, the pressures themselves do not.
    """
    gauges = {place.name for place in PLACES.values() if place.gauge}
    return frozenset(n for n, at in _modules(rig).items() if at[0] in gauges)


def _reach(rig: Any, at: tuple[str, int | None, str]) -> Array:
    part, i, field = at
    module = getattr(rig, part)
    return getattr(module if i is None else module[i], field)


def get(rig: Rig, names: Sequence[str]) -> Array:
    """Values of the named parameters, [len(names)], SI.

    Raises:
        KeyError: a name that the rig has not.
    """
    at = _modules(rig)
    return jnp.stack([_reach(rig, at[name]) for name in names])


def put(rig: Rig, names: Sequence[str], values: ArrayLike) -> Rig:
    """The rig with the named parameters set to `values`, [len(names)], SI.

    Values are cast, so that a Python number compiles nothing new.

    Raises:
        KeyError: a name that the rig has not.
    """
    at = _modules(rig)
    new = jnp.asarray(values, dtype=float)
    return eqx.tree_at(
        lambda r: [_reach(r, at[name]) for name in names],
        rig,
        [new[i] for i in range(len(names))],
    )


def scales(spec: Iterable[Spec]) -> np.ndarray:
    """What one unit of the optimiser's coordinate means for each parameter."""
    return np.array([s.scale for s in spec])
