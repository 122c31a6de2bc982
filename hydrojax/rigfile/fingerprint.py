"""A fingerprint of code: what a kept result depends on besides numbers.

A sweep or a fleet that is resumed must compute anew once the code of an effect, a valve
or a controller has changed. What is hashed is the code that is loaded (the functions'
code objects), not a file that may have been edited since: a class from a notebook cell
has a fingerprint like any other. Global functions, classes and constants that the code
names are followed; those of Python and of the numerical libraries are not.
"""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import sys
from collections.abc import Iterator, Mapping
from types import CodeType, FunctionType, ModuleType
from typing import Any

import equinox as eqx
import jax
import numpy as np

from hydrojax import __version__
from hydrojax.parameters import Spec

FOREIGN = {
    *sys.stdlib_module_names, "beartype", "equinox", "jax", "jaxlib", "jaxtyping",
    "lineax", "numpy", "optimistix", "pandas", "pydantic", "scipy", "xarray",
}  # fmt: skip
"""Packages whose code is not followed: their version is not the model's."""

PLAIN = (type(None), bool, int, float, complex, str, bytes, Spec)
"""What is hashed by its `repr`, which holds the whole value."""

SKIPPED = {
    "__doc__", "__firstlineno__", "__module__", "__slotnames__",
    "__static_attributes__",
}  # fmt: skip
"""Attributes of a class that do not change what it computes: `__slotnames__` comes with
the first pickling of an instance."""


def code_fingerprint(*things: Any) -> str:
    """The version of hydrojax and the code of all classes involved, in a few letters.

    Args:
        things: pytrees with `eqx.Module`s in them, at any depth and in static fields
            too; classes; functions.

    Returns:
        16 hexadecimal digits. The same in another process of the same Python version;
        the numbers in the pytrees do not change it.
    """
    reader = _Reader()
    reader.feed(__version__)
    for name, each in sorted(_with_code(things, set()).items()):
        reader.feed(name)
        reader.read(each)
    return reader.seen.hexdigest()[:16]


def _with_code(thing: Any, seen: set[int]) -> dict[str, type | FunctionType]:
    """The classes of all modules in a thing, and functions, by their full name."""
    if id(thing) in seen:
        return {}
    seen.add(id(thing))
    found: dict[str, type | FunctionType] = {}
    if isinstance(thing, (type, FunctionType)):
        return {f"{thing.__module__}.{thing.__qualname__}": thing}
    inside: tuple = ()
    if isinstance(thing, eqx.Module):
        found |= _with_code(type(thing), seen)
        fields = dataclasses.fields(thing)  # type: ignore[arg-type]
        inside = tuple(getattr(thing, f.name, None) for f in fields)
    elif isinstance(thing, Mapping):
        inside = tuple(thing.values())
    elif isinstance(thing, (tuple, list)):
        inside = tuple(thing)
    for part in inside:
        found |= _with_code(part, seen)
    return found


class _Reader:
    """Feeds code into a hash, every function and class once."""

    def __init__(self) -> None:
        self.seen = hashlib.sha256()
        self.known: set[int] = set()

    def feed(self, text: str | bytes) -> None:
        """Add a piece of text, with its length so that pieces cannot run together."""
        raw = text.encode() if isinstance(text, str) else text
        self.seen.update(f"{len(raw)}:".encode() + raw)

    def read(self, thing: Any) -> None:
        """Add whatever stands behind a name."""
        thing = _unwrapped(thing)
        if isinstance(thing, PLAIN):
            self.feed(repr(thing))
        elif isinstance(thing, (np.ndarray, np.generic, jax.Array)):
            array = np.asarray(thing)
            self.feed(repr(array.dtype) + repr(array.shape))
            self.feed(array.tobytes())
        elif isinstance(thing, (tuple, list)):
            self.feed(f"{type(thing).__name__} {len(thing)}")
            for part in thing:
                self.read(part)
        elif isinstance(thing, (set, frozenset)):
            self.feed(repr(sorted(repr(x) for x in thing if isinstance(x, PLAIN))))
        elif isinstance(thing, Mapping):
            for key in sorted((k for k in thing if isinstance(k, PLAIN)), key=repr):
                self.feed(repr(key))
                self.read(thing[key])
        elif isinstance(thing, (FunctionType, type)):
            self._read_once(thing)

    def _read_once(self, thing: FunctionType | type) -> None:
        name = f"{thing.__module__}.{thing.__qualname__}"
        self.feed(name)
        if id(thing) in self.known or _is_foreign(thing.__module__):
            return
        self.known.add(id(thing))
        if isinstance(thing, type):
            self._read_class(thing)
        else:
            self._read_function(thing)

    def _read_class(self, each: type) -> None:
        for base in each.__bases__:
            self.read(base)
        for name, value in sorted(vars(each).items()):
            if name == "__dataclass_fields__":
                for key, field in value.items():
                    self.feed(key)
                    self.read(field.metadata.get("spec"))
            elif name not in SKIPPED:
                self.feed(name)
                self.read(value)

    def _read_function(self, each: FunctionType) -> None:
        self.read(each.__defaults__)
        self.read(each.__kwdefaults__)
        for cell in each.__closure__ or ():
            try:
                self.read(cell.cell_contents)
            except ValueError:  # a cell that is still empty
                continue
        self._read_code(each.__code__, each.__globals__)

    def _read_code(self, code: CodeType, names: Mapping[str, Any]) -> None:
        self.feed(code.co_code)
        self.feed(repr(code.co_names))
        for const in code.co_consts:
            if isinstance(const, CodeType):
                self._read_code(const, names)
            else:
                self.read(const)
        for thing in _named(code, names):
            self.read(thing)


def _unwrapped(thing: Any) -> Any:
    """The function behind a property, a method, or a wrapper such as `jax.jit`."""
    for name in ("__func__", "fget", "func"):
        inner = getattr(thing, name, None)
        if isinstance(inner, FunctionType):
            thing = inner
    return inspect.unwrap(thing) if callable(thing) else thing


def _named(code: CodeType, names: Mapping[str, Any]) -> Iterator[Any]:
    """The globals that code names, and what it names of a user's own modules."""
    for name in code.co_names:
        thing = names.get(name)
        if isinstance(thing, ModuleType):
            if not _is_foreign(thing.__name__):
                yield from (vars(thing).get(n) for n in code.co_names)
        elif thing is not None:
            yield thing


def _is_foreign(module: str) -> bool:
    return (module or "").partition(".")[0] in FOREIGN
