"""A parameter's unit, range, prior and meaning, kept beside its field.

A parameter is an array field of an `equinox.Module`, declared with `param`. What is
declared here is what the rig file may set, what the optimiser may move and what the
report prints; it is never repeated elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array


@dataclass(frozen=True)
class Spec:
    """What is known of a parameter before any log is seen.

    Attributes:
        unit: SI unit of the stored value, as pint reads it; `"{u}"` in it stands for
            the unit of the valve command, V or 1.
        default: value used where the rig file is silent. For an effect: the value the
            shape takes, or the absent strength.
        lower, upper: range the value may take.
        says: one phrase for the report.
        prior: standard deviation of a Gaussian prior about `default`, or None.
        strength: whether the effect is absent exactly when all its strengths are at
            their default; the other parameters of an effect are its shape.
        grid: shape values to try while the strength is zero; for a strength, values
            to try as they are, where it does what its slope at zero does not foresee.
        size: a strength's typical magnitude, for scaling.
        least: magnitude of a strength under which it is not this effect that acts, but
            something too fast or too small for a log to tell.
        outside: how files and reports show the value, if not as it is stored: the
            reciprocal under this name and unit.
    """

    unit: str
    default: float
    lower: float
    upper: float
    description: str
    prior: float | None = None
    strength: bool = False
    grid: tuple[float, ...] = ()
    size: float | None = None
    minimum: float = 0.0
    outside: tuple[str, str] | None = None

    @property
    def scale(self) -> float:
        """A typical magnitude: what one unit of the optimiser's coordinate means."""
        if self.size is not None:
            return self.size
        if self.default != 0.0:
            return abs(self.default)
        return max(abs(self.lower), abs(self.upper)) / 10.0


def param(
    unit: str, default: float, lower: float, upper: float, description: str, **more: Any
) -> Any:
    """Declare an array field of a Module as a parameter; see `Spec` for the words."""
    spec = Spec(unit, default, lower, upper, description, **more)
    return eqx.field(
        default=default,
        converter=lambda x: jnp.asarray(x, dtype=float),
        metadata={"spec": spec},
    )


def specs(module: type[eqx.Module] | eqx.Module) -> dict[str, Spec]:
    """The declared parameters of a Module (class or instance), by field name."""
    fields = module.__dataclass_fields__
    return {
        name: f.metadata["spec"] for name, f in fields.items() if "spec" in f.metadata
    }


def values(module: eqx.Module) -> dict[str, Array]:
    """The parameters of one Module, by field name."""
    return {name: getattr(module, name) for name in specs(module)}
