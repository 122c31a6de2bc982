"""What is known of a fit's parameters beforehand: ranges, priors, and other logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hydrojax.effects import EFFECTS
from hydrojax.parameters import Spec, specs
from hydrojax.rigfile.schema import RigFile

COULOMB = ("k_cp", "k_cn")


@dataclass(frozen=True)
class Free:
    """A parameter that is to be found: where it starts and what it may be, SI."""

    start: float
    lower: float
    upper: float
    prior: float | None = None


def is_of_shapes(own: Free, spec: Spec) -> bool:
    """Whether a parameter is the share between two shapes of an effect, at the ends of
    its range.
    """
    return spec.whole and {own.lower, own.upper} <= set(spec.grid)


def free_parameters(spec: RigFile) -> dict[str, Free]:
    """What a rig file leaves to be found, effects it declares included.

    Of an effect of which anything is to be found, what the file leaves out and is
    known roughly (`prior`) is found too, as where a trace adds the effect: held at its
    default it would be paid for by effects that are not there.
    """
    entries, left_out = dict(spec.parameters), {}
    for effect, given in spec.effects.items():
        entries |= {f"{effect}.{name}": e for name, e in given.items()}
        if any(e.range for e in given.values()):
            rest = specs(EFFECTS[effect]).items()
            rest = {n: s for n, s in rest if s.prior and n not in given}
            left_out |= free_effect(effect, rest)
    found = {name: Free(e.start, *e.range) for name, e in entries.items() if e.range}
    return found | left_out


def free_effect(name: str, spec: Mapping[str, Spec]) -> dict[str, Free]:
    """The parameters of an effect that a trace adds, from its declaration."""
    return {
        f"{name}.{field}": Free(s.default, s.lower, s.upper, s.prior)
        for field, s in spec.items()
    }


@dataclass(frozen=True)
class Known:
    """Parameters as other logs identify them: their values there, SI, and the curvature
    of that fit, in units of the scales, priors counted.
    """

    names: tuple[str, ...]
    values: Float[np.ndarray, "k"]
    curvature: Float[np.ndarray, "k k"]

    def rows(
        self,
        columns: Sequence[str | None],
        at: Float[np.ndarray, "columns"],
        scale: Float[np.ndarray, "columns"],
    ) -> tuple[Float[np.ndarray, "columns columns"], Float[np.ndarray, "columns"]]:
        """Residual rows by column, and their value with the columns `at`."""
        sizes, vectors = np.linalg.eigh(self.curvature)
        root = (vectors * np.sqrt(np.maximum(sizes, 0.0))).T
        slope = np.zeros((len(columns), len(columns)))
        away = np.zeros(len(columns))
        for j, name in enumerate(self.names):
            i = columns.index(name)
            slope[: len(root), i] = root[:, j]
            away[i] = (at[i] - self.values[j]) / scale[i]
        return slope, slope @ away


def prior_rows(
    free: Mapping[str, Free],
    known: Known | None,
    tied: float | None,
    columns: Sequence[str | None],
    at: Float[np.ndarray, "columns"],
    scale: Float[np.ndarray, "columns"],
) -> tuple[Float[np.ndarray, "rows columns"], Float[np.ndarray, "rows"]]:
    """Residual rows of what is known beforehand, and their value with the columns `at`.

    One row per column, by its prior or by `known`, and one that ties k_cp to k_cn to
    within `tied` (N), where there is such a bound.
    """
    slope, value = np.zeros((len(columns) + 1, len(columns))), []
    for i, name in enumerate(columns):
        prior = free[name].prior if name else None
        slope[i, i] = scale[i] / prior if prior else 0.0
        value.append((at[i] - free[name].start) / prior if name and prior else 0.0)
    if known is not None:
        slope[:-1], value = known.rows(columns, at, scale)
    pair = [columns.index(n) for n in COULOMB if n in columns]
    difference = 0.0
    if tied is not None and len(pair) == 2:
        slope[-1, pair] = scale[pair[0]] / tied, -scale[pair[1]] / tied
        difference = (at[pair[0]] - at[pair[1]]) / tied
    return slope, np.array([*value, difference])
