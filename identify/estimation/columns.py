"""The columns of a fit: which parameters are moved, and the arrays it runs on."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hydrojax.identify.preparation.data import Data
from hydrojax.jax_setup import bucket
from hydrojax.parameters import get, parameter_specs, scales, specs
from hydrojax.plant.places import hydraulic_names
from hydrojax.plant.replay import Motion, Windows
from hydrojax.plant.rig import Rig

SUPPLY_BLOCKS = 3
"""Pieces of a window in each of which the supply's measurement error is a constant."""

READINGS = 4
"""The readings of both pressures where a window begins, and their slopes: a sensor that
filters remembers them, and the log has them with its noise."""

NUISANCE = 2 + SUPPLY_BLOCKS + READINGS
"""What each window has of its own: two initial pressures, the supply's errors, and the
`READINGS`."""


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

    def acting(
        self, values: Float[np.ndarray, "n"], moved: Collection[str] = ()
    ) -> tuple[ParametricRig, Float[Array, "m"]]:
        """The model and its values without lines in which nothing stands: their effect
        is absent at `values`, and none of the parameters `moved` is its own.

        Following what stands in lines is much of a replay's cost.
        """
        at, idle, line = dict(zip(self.names, values, strict=True)), set(), []
        for effect in self.rig.line:
            own = {f"{effect.name}.{n}": s for n, s in specs(effect).items()}
            present = any(s.strength and at[n] for n, s in own.items())
            if present or not own.keys().isdisjoint(moved):
                line.append(effect)
            else:
                idle.update(own)
        keep = np.array([n not in idle for n in self.names])
        model = ParametricRig(
            eqx.tree_at(lambda r: r.line, self.rig, tuple(line), is_leaf=_is_tuple),
            tuple(n for n in self.names if n not in idle),
            self.hydraulic - len(idle),
            self.scale[keep],
        )
        return model, jnp.asarray(values[keep])


def _is_tuple(x: object) -> bool:
    return isinstance(x, tuple)


class Batch(NamedTuple):
    """What a fit runs on, as arrays.

    Attributes:
        motion: of whole segments.
        windows: cut from them.
        P_0: first guess of the pressures at each window's first tick, Pa, as a sensor
            that filters would show them (see `replay.at_start`).
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


def batch_of(data: Data) -> Batch:
    """A fit's arrays from prepared logs."""
    motion, windows = jax.tree.map(np.asarray, (data.motion, data.windows))
    supply_noise, weight = np.asarray(data.supply_noise), np.ones(len(data.P_0))
    return Batch(motion, windows, data.P_0, data.noise, supply_noise, weight)


def thinned(batch: Batch, most: int) -> Batch:
    """A batch of at most `most` windows, spread evenly."""
    count = batch.P_0.shape[0]
    keep = np.unique(np.linspace(0, count - 1, min(most, count)).astype(int))
    return batch._replace(
        windows=jax.tree.map(lambda a: a[keep], batch.windows),
        P_0=batch.P_0[keep],
        weight=batch.weight[keep],
    )


HANDFUL = 32
"""Windows that pieces of a batch are multiples of. A batch of no more has a program of
its own, which is not as wide."""

Room = tuple[int, int, int]
"""Windows, segments, and ticks of a segment."""


def room_of(batch: Batch) -> Room:
    """What the programs of a batch have room for."""
    segments, ticks = batch.motion.h.shape
    return bucket(len(batch.P_0)), bucket(segments, 1), bucket(ticks + 1)


def filled(batch: Batch, least: Room = (0, 0, 0)) -> Batch:
    """The batch with copies of its last window that weigh nothing, and standstill after
    its motion: logs of other lengths then find their programs compiled. To the size
    `least`, or larger: windows that only fill up cost next to nothing (see
    `misfit.in_pieces`), but for those of no more than `HANDFUL`.
    """
    windows, *room = map(max, room_of(batch), least)
    if len(batch.P_0) <= HANDFUL:
        windows = room_of(batch)[0]
    which = np.minimum(np.arange(windows), len(batch.P_0) - 1)
    segments, ticks = batch.motion.h.shape
    more = (room[0] - segments, room[1] - ticks - 1)

    def longer(a):
        return np.pad(a, [*zip((0, 0, 0), (*more, 0), strict=True)][: a.ndim], "edge")

    own = (batch.windows, batch.P_0, batch.weight)
    own = jax.tree.map(lambda a: np.asarray(a)[which], own)
    motion = jax.tree.map(longer, batch.motion)
    still = np.array(motion.dx)
    still[segments:], still[:, ticks:] = 0.0, 0.0
    return batch._replace(
        motion=motion._replace(dx=still),
        windows=own[0],
        P_0=own[1],
        weight=own[2] * (np.arange(windows) < len(batch.P_0)),
    )


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
