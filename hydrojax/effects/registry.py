"""Effects of a user's own: from a file, or from a package that offers them.

A class that passes `register` stands in the vocabulary beside the others, so that rig
files, identification, the trace and the reports know it by its name.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Iterable
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hydrojax import units
from hydrojax.errors import TEXT, InputError, file_text
from hydrojax.parameters import Spec, specs
from hydrojax.plant.chambers import Point
from hydrojax.plant.effect import Effect
from hydrojax.plant.places import PLACES

Own = TypeVar("Own", bound=Effect)

GROUP = "hydrojax.effects"
"""Entry points under which a package offers effects: a class, or a module of them."""

NEEDS = ("u", "F", "loadcell", "rod_force", "P_a1", "P_a2", "psi")
"""What an effect may need of a log."""


def load_effects(
    path: str | Path, vocabulary: dict[str, type[Effect]]
) -> dict[str, type[Effect]]:
    """Take the effects that a Python file defines into the vocabulary.

    The same file may be read again: its effects then replace those of before.

    Returns:
        The file's effects, by name.

    Raises:
        InputError: the file cannot be read or run, defines no effect, or one that
            cannot be taken; in one line, with the mend.
    """
    path = Path(path)
    text = file_text(path, TEXT, "check that --effects names a Python file")
    source = str(path.resolve())
    module = ModuleType(f"hydrojax_own_{path.stem}")
    module.__file__ = source
    sys.modules[module.__name__] = module  # where dataclasses look a class's names up
    try:
        exec(compile(text, source, "exec"), module.__dict__)
    except (Exception, SystemExit) as err:  # a file that ends the program defines none
        _broken(path, source, err)
    found = _of_module(module)
    if not found:
        raise InputError(
            f"{path}: defines no effect: write a class such as "
            "`class MyDrag(FrictionForce)`, with FrictionForce from hydrojax.effects"
        )
    return register(found, vocabulary, str(path), source)


def offered(vocabulary: dict[str, type[Effect]]) -> dict[str, type[Effect]]:
    """Take in the effects that installed packages offer as entry points.

    Raises:
        InputError: one of them cannot be taken.
    """
    out = {}
    for point in entry_points(group=GROUP):
        where = f"entry point {point.name!r} of {GROUP} ({point.value})"
        try:
            given = point.load()
        except (Exception, SystemExit) as err:
            said = " ".join(f"{type(err).__name__}: {err}".split())
            raise InputError(
                f"{where}: cannot be loaded: {said}; mend or uninstall its package"
            ) from err
        found = _of_module(given) if isinstance(given, ModuleType) else [given]
        out |= register(found, vocabulary, where, point.value)
    return out


def register(
    classes: Iterable[Any], vocabulary: dict[str, type[Effect]], where: str, source: str
) -> dict[str, type[Effect]]:
    """Check effects and add them to the vocabulary, all of them or none.

    Args:
        classes: the effects.
        vocabulary: where they are put, by name, behind what is there.
        where: opens an error's line.
        source: where they come from; what came from there before is replaced.
    """
    new: dict[str, type[Effect]] = {}
    for effect in classes:
        name = _check(effect, where)
        before = vocabulary.get(name)
        if name in new or (before and _SOURCES.get(before) != source):
            raise InputError(
                f"{where}: {effect.__name__}: the name {name!r} is taken; give it "
                "another"
            )
        new[name] = effect
    for name, effect in new.items():
        vocabulary[name] = effect
        _SOURCES[effect] = source
    return new


def effect(cls: type[Own], vocabulary: dict[str, type[Effect]]) -> type[Own]:
    """Check a class and add it to the vocabulary; see `hydrojax.effects.effect`."""
    # By name and not by object: a notebook's cell that runs again makes a new class.
    source = f"{cls.__module__}.{getattr(cls, '__qualname__', cls)}"
    register([cls], vocabulary, "effect", source)
    return cls


_SOURCES: dict[type[Effect], str] = {}


def file_of(effect: type[Effect]) -> Path | None:
    """The Python file that `load_effects` read an effect from, if it did."""
    source = Path(_SOURCES.get(effect, ""))
    return source if source.is_file() else None


def _of_module(module: ModuleType) -> list[type[Effect]]:
    """The effects that a module defines itself; a leading _ marks a helper."""
    return [
        c
        for c in vars(module).values()
        if isinstance(c, type)
        and issubclass(c, Effect)
        and c.__module__ == module.__name__
        and not c.__name__.startswith("_")
    ]


def _broken(path: Path, source: str, error: BaseException) -> NoReturn:
    """Say in one line where a file stopped."""
    line = getattr(error, "lineno", None)
    if line is None:
        frames = traceback.extract_tb(error.__traceback__)
        line = next((f.lineno for f in reversed(frames) if f.filename == source), None)
    said = " ".join(f"{type(error).__name__}: {error}".split())
    at = f" line {line}:" if line else ""
    raise InputError(f"{path}:{at} {said}; mend that line") from error


Refuse = Callable[[str], NoReturn]
"""Raises the error that an effect cannot be taken, and says what to mend."""


def _check(effect: Any, where: str) -> str:
    """The name of an effect that can be taken; else one line that says what to mend."""

    def refuse(what: str) -> NoReturn:
        raise InputError(f"{where}: {getattr(effect, '__name__', effect)}: {what}")

    if not (isinstance(effect, type) and issubclass(effect, Effect)):
        refuse("is no effect: derive it from a class of hydrojax.effects")
    name, place = getattr(effect, "name", None), getattr(effect, "place", None)
    if not isinstance(name, str) or not name.isidentifier():
        refuse('has no name for files and reports: add name = "my_effect"')
    if place is None:
        refuse(f"has no place: add place = one of {tuple(PLACES)}")
    if place not in PLACES:
        refuse(f"the place {place!r} is unknown: write one of {tuple(PLACES)}")
    needs = getattr(effect, "needs", None)
    if not needs or isinstance(needs, str) or not set(needs) <= set(NEEDS):
        refuse(f"invalid needs {needs!r}: expected a tuple of {NEEDS}")
    if not isinstance(getattr(effect, "residual_axis", None), str):
        refuse('declares no axis of its residual: add residual_axis = "v"')
    method, trial = PLACES[place].method, PLACES[place].trial
    bases = {p.base for p in PLACES.values()}
    for wanted in (*([method] if method else ()), *PLACES[place].besides):
        own = getattr(effect, wanted, None)
        if own is None or any(own is getattr(base, wanted, 0) for base in bases):
            refuse(f"at the place {place!r} it needs a method {wanted}(...)")
    declared = specs(effect)
    if not declared:
        refuse(
            "declares no parameter: write c: Array = param(unit, 0.0, lower, upper, "
            "description, strength=True, size=...), with the annotation"
        )
    for field, spec in declared.items():
        _check_spec(field, spec, refuse)
    if not any(spec.strength for spec in declared.values()):
        refuse(
            f"has no strength: one of {list(declared)} must have strength=True, at "
            "whose 0 the effect is absent"
        )
    try:
        instance = effect()
    except Exception as err:
        refuse(f"cannot be made without arguments: {err}; give each field a default")
    if method and trial is not None:
        _try(instance, method, trial, declared, refuse)
        if PLACES[place].hydraulic and not PLACES[place].opens:
            _try_backward(instance, method, trial, declared, refuse)
    return name


def _check_spec(field: str, spec: Spec, refuse: Refuse) -> None:
    unit = units.with_command(spec.unit, "V")
    if not spec.unit or not units.fits(unit, unit):
        refuse(
            f"{field}: the unit {spec.unit!r} is unknown: write one such as "
            '"N*s/m", or "1"'
        )
    if not (np.isfinite([spec.lower, spec.upper]).all() and spec.lower < spec.upper):
        refuse(f"{field}: the range {spec.lower:g} to {spec.upper:g} is invalid")
    if not spec.lower <= spec.default <= spec.upper:
        refuse(f"{field}: {spec.default:g} is outside its range; widen it")
    if spec.strength and spec.default != 0.0:
        refuse(f"{field}: a strength must be 0 where the effect is absent")
    if spec.prior is not None and not spec.prior > 0:
        refuse(f"{field}: a prior is a standard deviation, above 0")


def _try(
    instance: Effect,
    method: str,
    at: tuple,
    declared: dict[str, Spec],
    refuse: Refuse,
) -> None:
    """That an effect vanishes at zero strength, and that its derivative does not."""
    names = [field for field, s in declared.items() if s.strength]
    inputs = jax.tree.map(lambda x: jnp.asarray(x, dtype=float), at)

    def push(values):
        changed = eqx.tree_at(
            lambda e: [getattr(e, n) for n in names], instance, list(values)
        )
        out = getattr(changed, method)(*inputs)
        return jnp.stack([jnp.asarray(o, float) for o in jax.tree.leaves(out)])

    zero = jnp.zeros(len(names))
    try:
        jax.eval_shape(push, zero)  # as it will be compiled
        absent, slopes = push(zero), np.asarray(jax.jacfwd(push)(zero))
    except Exception as err:
        said = " ".join(f"{type(err).__name__}: {err}".split())
        refuse(f"{method}(...) fails: {said[:200]}")
    if np.any(np.asarray(absent) != 0):
        refuse(f"{method}(...) is not 0 when {', '.join(names)} = 0: it must vanish")
    for name, slope in zip(names, slopes.T, strict=True):
        if not np.all(np.isfinite(slope)) or not np.any(slope):
            refuse(
                f"{method}(...) has no finite derivative other than 0 by {name} at 0, "
                "so no trace would find it: let it grow in proportion at first"
            )


def _try_backward(
    instance: Effect,
    method: str,
    at: tuple,
    declared: dict[str, Spec],
    refuse: Refuse,
) -> None:
    """That fits can take its derivatives backward, by what it is given: at typical
    strengths, under the trial's pressures and under these exchanged, in motion back.
    """
    names = [field for field, s in declared.items() if s.strength]
    typical = eqx.tree_at(
        lambda e: [getattr(e, n) for n in names],
        instance,
        [jnp.asarray(declared[n].scale, dtype=float) for n in names],
    )

    def push(given):
        return sum(map(jnp.sum, jax.tree.leaves(getattr(typical, method)(*given))))

    turned = tuple(
        a._replace(P_a1=a.P_a2, P_a2=a.P_a1, v=-a.v) if isinstance(a, Point) else a
        for a in at
    )
    for given in (at, turned):
        inputs = jax.tree.map(lambda x: jnp.asarray(x, dtype=float), given)
        try:
            slopes = jax.tree.leaves(jax.grad(push)(inputs)) if inputs else []
        except Exception as err:
            said = " ".join(f"{type(err).__name__}: {err}".split())
            refuse(f"{method}(...) cannot be differentiated backward: {said[:160]}")
        if not all(np.all(np.isfinite(slope)) for slope in slopes):
            refuse(
                f"{method}(...) has no finite derivative by what it is given, taken "
                "backward: a branch of jnp.where that is not taken must be finite too"
            )


__all__ = ["GROUP", "effect", "file_of", "load_effects", "offered", "register"]
