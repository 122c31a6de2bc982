"""A parameter's unit, range, prior and meaning, and all of a tree's by name.

A parameter is an array field of an `equinox.Module`, declared with `param`. What is
declared here is what the rig file may set, what the optimiser may move and what the
report prints; it is never repeated elsewhere.

Names come from the tree: `beta`, and `internal_leakage.c_il` in a module whose class
has the attribute `name`. A rig, a controller and a closed loop are such trees.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Real

Tree = TypeVar("Tree", bound=eqx.Module)
Path = tuple[str | int, ...]
"""Where in a tree a parameter is: names of fields, and indices in tuples."""


@dataclass(frozen=True)
class Spec:
    """What is known of a parameter before any log is seen.

    Attributes:
        unit: SI unit of the stored value, as pint reads it; `"{u}"` in it stands for
            the unit of the valve command, V or 1.
        default: value used where the rig file is silent. For an effect: the value the
            shape takes, or the absent strength.
        lower, upper: range the value may take.
        description: one phrase for the report.
        prior: standard deviation of a Gaussian prior about `default`, or None.
        strength: whether the effect is absent exactly when all its strengths are at
            their default; the other parameters of an effect are its shape.
        grid: shape values to screen while the strength is zero; for a strength, values
            to screen as they are, where its slope at zero does not predict its effect.
        size: a strength's typical magnitude, for scaling.
        minimum: magnitude of a strength below which the effect is too fast or too
            small to be identified from a log.
        whole: whether the ends of its range are all there can be: no range could be
            wider. A share is 0 or 1 there, air is isothermal or adiabatic.
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
    whole: bool = False
    outside: tuple[str, str] | None = None

    @property
    def scale(self) -> float:
        """A typical magnitude: what one unit of the optimiser's coordinate means."""
        if self.size is not None:
            return self.size
        if self.default != 0.0:
            return abs(self.default)
        return max(abs(self.lower), abs(self.upper)) / 10.0


def spread(first: float, last: float, count: int) -> tuple[float, ...]:
    """A grid in even ratios: what a strength is screened at over its whole range."""
    return tuple(float(f"{v:.3g}") for v in np.geomspace(first, last, count))


def param(
    unit: str, default: float, lower: float, upper: float, description: str, **more: Any
) -> Any:
    """Declare an array field of a Module as a parameter.

    Args:
        unit: SI, as pint reads it; `"{u}"` stands for the unit of the valve command.
        default: value where the rig file is silent; of a strength 0.
        lower: least value that it may take.
        upper: largest value that it may take.
        description: one phrase for the report.
        more: `strength=True` where the effect is absent at 0, `size` its typical
            magnitude, and the other attributes of `Spec`.
    """
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


def values(module: eqx.Module) -> dict[str, Float[Array, ""]]:
    """The parameters of one Module, by field name."""
    return {name: getattr(module, name) for name in specs(module)}


def _walk(value: Any, path: Path, prefix: str) -> Iterator[tuple[str, Path, Spec]]:
    """Name, place and declaration of each parameter, in the order of the fields."""
    if isinstance(value, tuple | list):
        children = list(enumerate(value))
    elif isinstance(value, eqx.Module):
        own = specs(value)
        for field, spec in own.items():
            yield prefix + field, (*path, field), spec
        fields = (f for f in value.__dataclass_fields__ if f not in own)
        children = [(f, getattr(value, f)) for f in fields]
    else:
        return
    for key, child in children:
        name = getattr(type(child), "name", None)
        named = isinstance(child, eqx.Module) and isinstance(name, str)
        yield from _walk(child, (*path, key), f"{prefix}{name}." if named else prefix)


def parameter_specs(tree: eqx.Module) -> dict[str, Spec]:
    """Every parameter's declaration by name: `beta`, `internal_leakage.c_il`, ..."""
    return {name: spec for name, _, spec in _walk(tree, (), "")}


def paths(tree: eqx.Module) -> dict[str, Path]:
    """Where in the tree each parameter is, by name."""
    return {name: path for name, path, _ in _walk(tree, (), "")}


def _reach(tree: Any, path: Path) -> Any:  # an array, or what stands for one in tree_at
    for key in path:
        tree = getattr(tree, key) if isinstance(key, str) else tree[key]
    return tree


def get(tree: eqx.Module, names: Sequence[str]) -> Float[Array, "names"]:
    """Values of the named parameters, SI, in the order of `names`.

    Raises:
        KeyError: a name that the tree does not have.
    """
    at = paths(tree)
    return jnp.stack([_reach(tree, at[name]) for name in names])


def put(
    tree: Tree,
    names: Sequence[str],
    values: Real[ArrayLike, "names"] | tuple[Float[Array, ""], ...],
) -> Tree:
    """The tree with the named parameters set to `values`, SI, one for each name.

    Values are cast, so that a Python number compiles nothing new. A tuple of arrays is
    taken as it is, not stacked first.

    Raises:
        KeyError: a name that the tree does not have.
    """
    at = paths(tree)
    apart = isinstance(values, tuple)
    new = values if apart else jnp.asarray(values, dtype=float)
    return eqx.tree_at(
        lambda t: [_reach(t, at[name]) for name in names],
        tree,
        [jnp.asarray(new[i], dtype=float) for i in range(len(names))],
    )


def scales(spec: Iterable[Spec]) -> Float[np.ndarray, "parameters"]:
    """What one unit of the optimiser's coordinate means for each parameter."""
    return np.array([s.scale for s in spec])
