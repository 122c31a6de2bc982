"""The columns of a fit: which parameters are moved, and the arrays it runs on."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hydrojax.parameters import get, parameter_specs, scales
from hydrojax.plant.places import hydraulic_names
from hydrojax.plant.replay import Motion, Windows
from hydrojax.plant.rig import Rig

SUPPLY_BLOCKS = 3
"""Pieces of a window in each of which the supply's measurement error is a constant."""

NUISANCE = 2 + SUPPLY_BLOCKS
"""What each window has of its own: two initial pressures, and the supply's errors."""


class ParametricRig(NamedTuple):
    """A rig and the order of its parameters: hydraulic ones first.

    Attributes:
        rig: the rig.
        names: of its n parameters.
        hydraulic: how many of them, at the head, the pressures depend on.
        scale: unit of the optimiser's coordinate of each parameter, SI.
    """

    rig: Rig
    names: tuple[str, ...]
    hydraulic: int
    scale: Float[np.ndarray, "n"]

    @classmethod
    def of(cls, rig: Rig) -> ParametricRig:
        """The model of a rig, with every parameter it has."""
        spec = parameter_specs(rig)
        first = hydraulic_names(rig)
        names = tuple(sorted(spec, key=lambda n: n not in first))
        return cls(rig, names, len(first), scales(spec[n] for n in names))

    @property
    def values(self) -> Float[Array, "n"]:
        """The rig's own values, SI."""
        return get(self.rig, self.names)


class Batch(NamedTuple):
    """What a fit runs on, as arrays.

    Attributes:
        motion: of whole segments.
        windows: cut from them.
        P_0: first guess of the pressures at each window's first tick, Pa.
        noise: standard deviation of each channel, SI; inf where it is not compared.
        supply_noise: standard deviation of the measured P_s, Pa (0 where the log has
            none): white noise there integrates to a drift of the pressures, which would
            otherwise be taken for a fault of the model.
        weight: of each window; 0 for padding.
    """

    motion: Motion
    windows: Windows
    P_0: Float[Array | np.ndarray, "windows 2"]
    noise: Float[Array | np.ndarray, "3"]
    supply_noise: Float[Array | np.ndarray, ""]
    weight: Float[Array | np.ndarray, "windows"]


class Basis(NamedTuple):
    """Directions in the space of hydraulic parameters, and of the others; SI."""

    hydraulic: Float[Array, "n_1 k_1"]
    other: Float[Array, "n_2 k_2"]


def basis(
    model: ParametricRig, names: tuple[str, ...], slots: tuple[int, int]
) -> Basis:
    """One direction per named parameter, one unit of its scale; spare slots are 0.

    Raises:
        ValueError: more names than slots.
    """
    out = [
        np.zeros((model.hydraulic, slots[0])),
        np.zeros((len(model.names) - model.hydraulic, slots[1])),
    ]
    used = [0, 0]
    for name in names:
        i = model.names.index(name)
        side = int(i >= model.hydraulic)
        if used[side] == slots[side]:
            raise ValueError(f"no slot left for {name}")
        out[side][i - side * model.hydraulic, used[side]] = model.scale[i]
        used[side] += 1
    return Basis(*(jnp.asarray(a) for a in out))


def slot_names(
    model: ParametricRig, names: tuple[str, ...], slots: tuple[int, int]
) -> list[str | None]:
    """Which parameter stands in each column of `basis`, None for a spare one."""
    first = [n for n in names if model.names.index(n) < model.hydraulic]
    rest = [n for n in names if n not in first]
    spare = [[None] * (slots[0] - len(first)), [None] * (slots[1] - len(rest))]
    return [*first, *spare[0], *rest, *spare[1]]
