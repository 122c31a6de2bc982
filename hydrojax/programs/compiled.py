"""Functions compiled once for each structure of what they are given, and let go of."""

from __future__ import annotations

import functools
import gc
import math
import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from hydrojax.jax_setup import resident, return_freed_memory
from hydrojax.programs import kept

OPTIONS: dict[str, Any] = {
    "xla_cpu_use_fusion_emitters": False,
    "xla_backend_optimization_level": 1,
    "xla_llvm_disable_expensive_passes": True,
}
"""Compiler options for XLA on a CPU, of programs that fuse much. At LLVM's first level
they compile in 0.85 of the time, without its costly passes in 0.8 of that, and run as
fast. XLA's fusion emitters keep a module for each kernel until all are compiled, which
made a trace's peak 2.4 GiB (now 1.3, `python -m benchmarks.memory`), and abort the
process on some Jacobians of a loop's step (a failed check in `SymbolicMap::Compose`,
jax 0.10.2). Not for all: a loop that no option of `LOOPS` keeps whole takes minutes to
compile without them."""


@functools.cache
def options() -> dict[str, Any] | None:
    """`OPTIONS`, or None where there is no such compiler or it does not know them."""
    import jax

    if jax.default_backend() != "cpu":
        return None
    try:
        jax.jit(lambda x: x + 1, compiler_options=OPTIONS)(1.0)
    except Exception:  # XLA's own kinds, by version
        return None
    return OPTIONS


def program(f: Callable[..., Any], **more: Any) -> Callable[..., Any]:
    """A function compiled with `OPTIONS`, where the compiler knows them.

    That is found out at the first call: JAX starts its devices for it.

    Args:
        f: the function.
        more: further arguments of `jax.jit`.
    """
    made: list[Callable[..., Any]] = []

    @functools.wraps(f)
    def call(*args: Any, **named: Any) -> Any:
        if not made:
            import jax

            made.append(jax.jit(f, compiler_options=options(), **more))
        return made[0](*args, **named)

    return call


def _full(memory: int | None = None, count: int | None = None) -> int:
    """Bytes of `FULL` on a machine with so much memory and so many cores; its own."""
    if memory is None:
        memory = 0
        with suppress(OSError, ValueError, AttributeError):  # not on every system
            memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    count = count or os.cpu_count() or 1
    return min(max(memory // (4 * count), 2**30), 2**32)


FULL = _full()
"""Bytes of the process from which the programs used longest ago go before another one
is made: what that takes comes on top. A process for each core may take a quarter of the
memory so; 1 GiB at least, and at most 4."""

ROOM = 3 * 2**26
"""Bytes by which the process may grow before they go again: where all else that it
holds comes near `FULL`, a trace would take its programs from disk again and again."""

_PROGRAMS: OrderedDict[Hashable, Callable[..., Any]] = OrderedDict()
_LEFT = [0]  # what the process held when they last went
_KEEPING = threading.Lock()


def program_of_pytrees(f: Callable[..., Any]) -> Callable[..., Any]:
    """A function of any pytrees compiled once for every structure of them, with
    `OPTIONS`: arrays are its inputs, all else in them is fixed. It returns arrays.

    What JAX traced is let go of once it is compiled: for a fit's program that is a
    third of what the process would hold. It can therefore not be transformed further.
    Where the process holds more than `FULL`, programs go that were not used for long.
    They are kept on disk (see `kept`), and taken from there in a later process.

    Args:
        f: the function.
    """
    one = threading.Lock()  # two threads that want the same program compile it once

    @functools.wraps(f)
    def call(*args: Any) -> Any:
        import jax

        leaves, tree = jax.tree.flatten(args)
        moves = [isinstance(a, np.ndarray | np.generic | jax.Array) for a in leaves]
        arrays = [a for a, m in zip(leaves, moves, strict=True) if m]
        fixed = [None if m else a for a, m in zip(leaves, moves, strict=True)]
        key = (
            f,
            tree,
            *((type(a), a) for a in fixed),
            *((a.shape, a.dtype, getattr(a, "weak_type", False)) for a in arrays),
        )
        made = _used(key)
        if made is None:
            with one:  # not held for a program that is there while another is made
                made = _used(key)
                if made is None:
                    _let_go_of_old()
                    made = _compiled(f, tree, fixed, moves, arrays)
                    with _KEEPING:
                        _PROGRAMS[key] = made
        return made(arrays)

    return call


def _used(key: Hashable) -> Callable[..., Any] | None:
    """The program of a key, as the one used last; None where there is none."""
    with _KEEPING:
        if key in _PROGRAMS:
            _PROGRAMS.move_to_end(key)
        return _PROGRAMS.get(key)


def _let_go_of_old() -> None:
    """Half of the programs, where the process holds more than `FULL`, and `ROOM` more
    than when they last went.
    """
    if resident(os.getpid()) < max(FULL, _LEFT[0] + ROOM):
        return
    with _KEEPING:
        for _ in range(len(_PROGRAMS) // 2):
            _PROGRAMS.popitem(last=False)
    _give_back()


def _give_back() -> None:
    """Give the system what programs that went took, and note what the process holds."""
    gc.collect()
    return_freed_memory()
    _LEFT[0] = resident(os.getpid())


def _compiled(
    f: Callable[..., Any], tree: Any, fixed: list, moves: list[bool], arrays: list
) -> Callable[..., Any]:
    import jax

    # JAX keeps what it traced for as long as the function lives: this one is not kept.
    def once(arrays: list) -> Any:
        given = iter(arrays)
        leaves = [next(given) if m else a for m, a in zip(moves, fixed, strict=True)]
        return f(*jax.tree.unflatten(tree, leaves))

    once.__name__ = f"{f.__name__}_{kept.release()}"
    key = kept.key_of(f, tree, fixed, arrays, options())
    found = kept.load(key)
    if found is None:
        kept.begin()
        found = jax.jit(once, compiler_options=options()).lower(arrays).compile()
        kept.save(key, found)
    return found


MAPPED = 0.25
"""Share of the kernel's limit of memory mappings from which programs are let go: some
seven fits of rigs that differ in structure, half a gigabyte of programs."""


HELD = 3 * 2**28
"""Bytes from which a process lets go of its programs as it begins with a rig of another
structure: those of a trace are 450 to 600 MiB, and all else is 550 MiB."""

_FEW = 0.05
"""Share of the mappings below which programs are not what takes the memory."""


def make_room(share: float = MAPPED, held: float = math.inf) -> bool:
    """Let go of compiled programs before the process has too many.

    XLA maps the parts of a program into memory one by one, some 2300 for a fit. Linux
    gives a process 65,530 mappings (`vm.max_map_count`), and XLA dies where there are
    no more: after fits of some thirty rigs that differ in structure. What is let go
    and needed again comes from the cache on disk, or is compiled again.

    Args:
        share: of the mappings that the kernel allows, from which all programs go.
        held: bytes of the process from which they go.

    Returns:
        Whether anything was let go; never where the system does not say what it allows.
    """
    gc.collect()
    return_freed_memory()
    mapped = _share_mapped()
    if mapped < share and (mapped < _FEW or resident(os.getpid()) < held):
        return False
    import jax

    jax.clear_caches()
    _PROGRAMS.clear()
    _give_back()
    return True


def _share_mapped() -> float:
    """The part of its memory mappings that the process has; 0 where nothing says so."""
    with suppress(OSError, ValueError, ZeroDivisionError):
        allowed = int(Path("/proc/sys/vm/max_map_count").read_text())
        with open("/proc/self/maps", "rb") as lines:
            return sum(1 for _ in lines) / allowed
    return 0.0
