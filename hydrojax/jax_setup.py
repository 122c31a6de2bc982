"""Setting JAX up: the one place that touches global configuration, on request."""

from __future__ import annotations

import ctypes
import functools
import os
import sys
import warnings
from contextlib import suppress
from pathlib import Path

_OPTIONS = "--xla_backend_extra_options="

FITS = f"{_OPTIONS}xla_cpu_use_multi_output_fusion=true"
"""What replays, their Jacobians and all that fits run with: keeps XLA's CPU compiler
from computing a scan's body once per output. Not documented by XLA, and ignored by
versions that do not know it."""

LOOPS = f"{_OPTIONS}xla_cpu_small_while_loop_byte_threshold=1000000000"
"""What closed loops run with: a whole scan becomes one function, in place of a launch
per kernel and step. With fits' option beside it several outputs of a scan are copied
whole at every step; alone, it makes the Jacobian of a fit slow to compile."""

CACHED = 2 * 2**30
"""Bytes of compiled programs that are kept on disk when a process starts: those of some
thousand structures of rigs."""

WIDE = "--xla_cpu_prefer_vector_width=512"
"""Beside `LOOPS`, on processors that have such vectors."""


def set_up_jax(cache: Path | None = None, work: str = FITS) -> bool:
    """Double precision, the CPU settings for a kind of work, and a cache of programs.

    Call it before anything else uses JAX. The command line does. Options of the same
    kind that stand in `XLA_FLAGS` already are left alone. Threads then
    share two malloc arenas (see `ARENAS`), unless `MALLOC_ARENA_MAX` is set.

    Args:
        cache: folder for compiled programs, cut to `CACHED` first; None keeps none.
        work: `FITS` (identify, trace) or `LOOPS` (simulate, sweep, tune). Either is
            right for both, and slower for the other.

    Returns:
        False if JAX was running already without these settings: a `RuntimeWarning`
        says that they came too late, and all else holds.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    wanted = _OPTIONS not in flags
    late = wanted and "jax" in sys.modules and _running()
    if late:
        warnings.warn(
            "JAX is running already, so the settings for its CPU loops came too late: "
            "call set_up_jax before anything else uses JAX",
            RuntimeWarning,
            stacklevel=2,
        )
    elif wanted:
        mine = f"{work} {WIDE}" if work == LOOPS and _has_wide_vectors() else work
        os.environ["XLA_FLAGS"] = f"{flags} {mine}".strip()
    if "MALLOC_ARENA_MAX" not in os.environ:
        limit_arenas()
    import jax

    jax.config.update("jax_enable_x64", True)
    _trim_after_compiling()
    if cache is not None:
        with suppress(OSError):  # JAX would let others in, and says what is wrong
            Path(cache).mkdir(mode=0o700, parents=True, exist_ok=True)
        trim(cache)
        jax.config.update("jax_compilation_cache_dir", str(cache))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
    return not late


def trim(cache: Path, most: int = CACHED) -> None:
    """Remove the programs that were used least recently from a folder beyond bounds.

    JAX has a bound of its own (`jax_compilation_cache_max_size`), which takes a lock at
    every program and fails for good once a process is killed between two of its writes.

    Args:
        cache: the folder.
        most: bytes; of a folder that has more, three quarters of it stay.
    """
    found: list[tuple[float, int, str]] = []
    with suppress(OSError), os.scandir(cache) as entries:
        for entry in entries:
            with suppress(OSError):
                seen = entry.stat()
                used = max(seen.st_atime, seen.st_mtime)
                found.append((used, seen.st_size, entry.path))
    whole = sum(size for _, size, _ in found)
    if whole <= most:
        return
    for _, size, path in sorted(found):
        with suppress(OSError):  # another process trims too
            os.unlink(path)
            whole -= size
        if whole <= 0.75 * most:
            return


def _running() -> bool:
    from jax._src import xla_bridge

    return xla_bridge.backends_are_initialized()


def _has_wide_vectors() -> bool:
    try:
        return " avx512f " in Path("/proc/cpuinfo").read_text()
    except OSError:
        return False


ARENAS = 2
"""Arenas of glibc's malloc. By default it opens one for each thread, and what the
compiler's threads free in theirs stays there."""

_M_ARENA_MAX = -8  # of malloc.h


def limit_arenas(count: int = ARENAS) -> None:
    """Have threads that begin from now on share so many of malloc's arenas; where the C
    library is not glibc nothing changes.
    """
    with suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").mallopt(_M_ARENA_MAX, count)


def return_freed_memory() -> None:
    """Give back to the system what is free: the C library would keep some 400 MiB of
    what the compiler has freed for every program.
    """
    with suppress(OSError, AttributeError):  # another C library has its own ways
        ctypes.CDLL("libc.so.6").malloc_trim(0)


def resident(pid: int) -> int:
    """Bytes that a process holds; 0 where the system does not say."""
    with suppress(OSError, ValueError, IndexError):
        pages = Path(f"/proc/{pid}/statm").read_text().split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE")
    return 0


LONG_COMPILE = 1.0
"""Seconds a program takes to compile from which on its scratch memory is given back."""


@functools.cache
def _trim_after_compiling() -> None:
    """From now on, give back what each long compilation has freed: the next one would
    start from there.
    """
    import jax

    def heard(event: str, duration_secs: float, **kwargs: str | int) -> None:
        if duration_secs > LONG_COMPILE and event.endswith("backend_compile_duration"):
            return_freed_memory()

    jax.monitoring.register_event_duration_secs_listener(heard)


def cores() -> int:
    """How many processor cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def bucket(count: int, least: int = 8) -> int:
    """The size that an axis of `count` is filled up to: four to an octave, so that few
    programs serve logs of every length.
    """
    step = max(least, 1 << max(count.bit_length() - 3, 0))
    return -(-count // step) * step


def user_cache() -> Path:
    """Where this user's compiled programs are kept between runs."""
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "hydrojax"


def set_up_fits() -> None:
    """Set JAX up for a command that fits: with the user's cache, on the processor.

    A fit is many small steps one after the other, each a launch on a GPU: the demo's
    trace took over 110 s on one and 47 s beside it. `JAX_PLATFORMS` asks for another.
    """
    import jax

    if not os.environ.get("JAX_PLATFORMS"):
        jax.config.update("jax_platforms", "cpu")
    set_up_jax(user_cache())


def ensure_jax() -> None:
    """Set JAX up at the first use of the front door, if nobody has done it before.

    Double precision, the CPU settings of fits, and a cache of compiled programs in the
    user's cache folder; one line on stderr says so. A program that has set
    `jax_enable_x64` itself is left as it is.

    Raises:
        RuntimeError: JAX is running in single precision already, so that arrays made
            before would be of the wrong kind; the message holds the line to write.
    """
    import jax

    if jax.config.read("jax_enable_x64"):
        return
    if _running():
        raise RuntimeError(
            "JAX is running in single precision already, and hydrojax needs double: "
            "call hydrojax.set_up_jax(), or write "
            'jax.config.update("jax_enable_x64", True), before anything else uses JAX'
        )
    set_up_unless_running()


def set_up_unless_running() -> None:
    """Set JAX up as `ensure_jax` does; where it is running or set up, do nothing."""
    import jax

    if jax.config.read("jax_enable_x64") or _running():
        return
    cache = user_cache()
    set_up_jax(cache)
    print(
        f"hydrojax: JAX is set to double precision; compiled programs are kept in "
        f"{cache} (at most {CACHED >> 30} GiB)",
        file=sys.stderr,
    )
