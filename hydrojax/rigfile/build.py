"""From a rig file to a rig."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import jax.numpy as jnp

from hydrojax.effects import EFFECTS, offered
from hydrojax.parameters import Spec, specs
from hydrojax.plant.chambers import Chambers, Lands
from hydrojax.plant.effect import Effect
from hydrojax.plant.friction import Friction
from hydrojax.plant.named import get, put
from hydrojax.plant.rig import Rig, add, bare_rig
from hydrojax.rigfile.schema import RigFile, read_rig

LANDS = tuple(specs(Lands))
"""The valve constants' names."""

BASE: Mapping[str, Spec] = {**specs(Lands), **specs(Chambers), **specs(Friction)}
"""The base model's parameters, by name."""


def load_rig(path: str | Path) -> RigFile:
    """Read a rig file against the vocabulary; see `rigfile.read_rig`.

    Effects that installed packages offer belong to it, and those of files that
    `effects.load_effects` has read.
    """
    offered()
    return read_rig(path, BASE, {name: specs(e) for name, e in EFFECTS.items()})


def make_effects(
    names: Iterable[str], spec: RigFile, travel: tuple[float, float]
) -> dict[str, Effect]:
    """The named effects, absent, in the order of the vocabulary.

    `travel` (m) is the range of x in the logs, over which a profile is laid unless
    the file says between which ends.
    """
    wanted = set(names)
    known = {
        "x_from": spec.geometry.get("x_from", travel[0]),
        "x_to": spec.geometry.get("x_to", travel[1]),
        "radius": spec.geometry.get("radius", 1.0),
    }
    out = {}
    for name, effect in EFFECTS.items():
        if name in wanted:
            own = {
                f: jnp.asarray(v, float)
                for f, v in known.items()
                if f in effect.__dataclass_fields__
            }
            out[name] = effect(**own)
    return out


def make_rig(spec: RigFile, effects: Mapping[str, Effect]) -> Rig:
    """The rig of a file at its start values, with effects added dormant.

    Effects that the file declares must be among `effects`.
    """
    rig = add(bare_rig(spec.layout, spec.geometry), effects.values())
    if spec.command_unit == "1":
        # The default valve constants are per volt of a +-10 V command.
        rig = put(rig, LANDS, 10 * get(rig, LANDS))
    given = {name: e.start for name, e in spec.parameters.items()}
    for effect, entries in spec.effects.items():
        given |= {f"{effect}.{name}": e.start for name, e in entries.items()}
    return put(rig, tuple(given), jnp.array(list(given.values()))) if given else rig
