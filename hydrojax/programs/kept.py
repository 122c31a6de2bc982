"""Compiled programs kept on disk, so that a later run need not trace them again.

They lie in the folder where JAX keeps what it compiled (`jax_compilation_cache_dir`),
and share its bound (`jax_setup.CACHED`). JAX asks for its own by what it has traced and
lowered, which takes longer than to load them; these are asked for by the structure of
what a function is given. Loading a program runs code, so nothing is kept, or taken, but
in a folder that only its owner can write.
"""

from __future__ import annotations

import functools
import hashlib
import os
import pickle
import platform
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from hydrojax.jax_setup import return_freed_memory

OWN = "hydrojax"
"""Package whose sources are part of a key; programs of anything else are not kept."""

SAFE = {OWN, "builtins", "jax", "jaxlib", "equinox", "numpy"}
"""Packages whose types a key may name; their versions are part of it."""

SUFFIX = ".program"

_LOADED = time.time()
_HITS = threading.local()  # programs that JAX took from its own cache, by thread


def key_of(
    function: Any, tree: Any, fixed: Sequence[Any], arrays: Sequence[Any], options: Any
) -> str | None:
    """What a program is kept under: all that it depends on.

    Args:
        function: that is compiled.
        tree: structure of its arguments.
        fixed: leaves that are no arrays, None where one is.
        arrays: the others.
        options: of the compiler.

    Returns:
        A hash; None where one of the parts has no text that is the same in another
        process, or is code of the user's, which may change unseen.
    """
    types, here, nodes = list(_types(tree)), _here(), str(tree)
    own = function.__module__.partition(".")[0] == OWN
    plain = all(isinstance(a, str | int | float | None) for a in fixed)
    # Objects without a text of their own are given in angle brackets.
    if not (own and plain and here and "<" not in nodes and all(map(_is_safe, types))):
        return None
    names = [f"{t.__module__}.{t.__qualname__}" for t in (function, *types)]
    shapes = [(a.shape, str(a.dtype), getattr(a, "weak_type", False)) for a in arrays]
    text = repr((names, nodes, list(fixed), shapes, options, here))
    return hashlib.sha256(text.encode()).hexdigest()


def load(key: str | None) -> Any | None:
    """The program kept under a key; None where there is none that can be used."""
    folder = _folder()
    if key is None or folder is None:
        return None
    path = folder / f"{key}{SUFFIX}"
    try:
        if not _only_mine(path):
            return None
        found = path.read_bytes()
    except OSError:
        return None
    if hashlib.sha256(found[32:]).digest() != found[:32]:
        return None
    from jax.experimental.serialize_executable import deserialize_and_load

    _start_lapack()
    try:
        program = deserialize_and_load(*pickle.loads(found[32:]))
    except Exception:  # an XLA that does not take it says so in ways of its own
        return None
    del found
    return_freed_memory()
    with suppress(OSError):
        os.utime(path)  # the bound takes what was used longest ago
    return program


def save(key: str | None, program: Any) -> None:
    """Keep a program that was compiled in this thread since `begin`.

    One that JAX took from its own cache cannot be written again, and is not kept.
    """
    folder = _folder()
    if key is None or folder is None or _HITS.count:
        return
    from jax.experimental.serialize_executable import serialize

    with suppress(Exception):  # what cannot be kept is compiled again
        data = pickle.dumps(serialize(program))
        with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:
            try:
                file.write(hashlib.sha256(data).digest() + data)
                file.close()
                os.replace(file.name, folder / f"{key}{SUFFIX}")
            except BaseException:
                os.unlink(file.name)
                raise


def release() -> str:
    """The package's version, for names. A program's is part of what JAX keeps it under:
    without it a new version, whose programs are often the same, would find them in
    JAX's cache, and not be able to keep them here.
    """
    return version(OWN).replace(".", "_")


def begin() -> None:
    """Count from here what this thread takes from JAX's own cache."""
    _listen()
    _HITS.count = 0


@functools.cache
def _start_lapack() -> None:
    """Have JAX find LAPACK's functions, which it does where it lowers one: a program
    that is loaded before calls them at address 0.
    """
    import jax
    import jax.numpy as jnp

    jax.jit(jnp.linalg.solve).lower(np.eye(1), np.ones(1))


@functools.cache
def _listen() -> None:
    import jax

    def heard(event: str, **more: Any) -> None:
        if event == "/jax/compilation_cache/cache_hits":
            _HITS.count = getattr(_HITS, "count", 0) + 1

    jax.monitoring.register_event_listener(heard)


def _types(tree: Any) -> Iterator[type]:
    """The types of a structure's nodes."""
    if node := tree.node_data():
        yield node[0]
    for child in tree.children():
        yield from _types(child)


def _is_safe(kind: type) -> bool:
    """Whether a type is what its name says, in a package whose code does not change: a
    class that was made as the program ran may share its name with another.
    """
    if kind.__module__ == "builtins":
        return True
    if kind.__module__.partition(".")[0] not in SAFE:
        return False
    found: Any = sys.modules.get(kind.__module__)
    for name in kind.__qualname__.split("."):
        found = getattr(found, name, None)
    return found is kind


@functools.cache
def _here() -> tuple[str, ...] | None:
    """This machine, these versions, these settings, and the sources; None where these
    were edited since the package was loaded.
    """
    import jax

    sources = _sources()
    if sources is None:
        return None

    versions = [version(n) for n in ("jax", "jaxlib", "equinox", "numpy")]
    flags = os.environ.get("XLA_FLAGS", "")
    double = str(jax.config.read("jax_enable_x64"))
    devices = str([(d.platform, d.device_kind) for d in jax.devices()])
    python = platform.python_version()
    return (*versions, python, flags, double, devices, _processor(), sources)


def _processor() -> str:
    """What the processor can do: a program is for those that can as much."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith(("flags", "Features")):
                return line
    return f"{platform.machine()} {platform.processor()}"


def _sources() -> str | None:
    """A hash of the package's own sources; None where one is newer than this process'
    copy of it may be.
    """
    total = hashlib.sha256()
    root = Path(__file__).resolve().parents[1]
    for folder, inside, files in os.walk(root, followlinks=True):
        inside.sort()
        for name in sorted(f for f in files if f.endswith(".py")):
            path = Path(folder, name)
            if path.stat().st_mtime > _LOADED:
                return None
            total.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return total.hexdigest()


def _folder() -> Path | None:
    """Where programs are kept; None where JAX keeps none, or others could write."""
    import jax

    folder = jax.config.values["jax_compilation_cache_dir"]
    if not folder:
        return None
    try:
        return Path(folder) if _only_mine(Path(folder)) else None
    except OSError:
        return None


def _only_mine(path: Path) -> bool:
    """Whether this user owns a file or folder and nobody else may write it; never
    where the system does not say.
    """
    if not hasattr(os, "geteuid"):
        return False
    found = path.stat()
    return found.st_uid == os.geteuid() and not found.st_mode & 0o022
