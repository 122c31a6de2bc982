"""C sources to shared libraries, in a cache folder keyed by text and flags."""

from __future__ import annotations

import ctypes
import hashlib
import os
import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

import numpy as np

from hydrojax.jax_setup import user_cache

FLAGS = (
    "-std=gnu11", "-O3", "-march=native", "-mprefer-vector-width=512", "-fopenmp",
    "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC",
)  # fmt: skip
"""No -ffast-math: the arithmetic is IEEE's, with fused multiply-adds."""

HERE = Path(__file__).parent


def compiler() -> str | None:
    """The C compiler: $CC, gcc or clang, whichever is there first; None without one."""
    return next(
        (c for c in (os.environ.get("CC"), "gcc", "clang") if c and shutil.which(c)),
        None,
    )


def version(cc: str) -> str:
    """The first line of what a compiler says of itself."""
    said = subprocess.run([cc, "--version"], capture_output=True, text=True)
    return (said.stdout.splitlines() or [cc])[0]


def _command(source: str, real: str, lanes: int) -> list[str]:
    cc = compiler()
    if cc is None:
        raise RuntimeError("no C compiler; install gcc, or set CC")
    return [cc, *FLAGS, f"-DREAL={real}", f"-DLANES={lanes}", str(HERE / source)]


def _machine() -> str:
    """What -march=native looks at: a cache may be shared by machines."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return ""
    return next((line for line in lines if line.startswith("flags")), "")


@cache
def library(source: str, real: str = "double", lanes: int = 1) -> ctypes.CDLL:
    """The compiled `source` of this folder, `real` double or float.

    Raises:
        RuntimeError: no compiler, or it does not compile.
    """
    command = _command(source, real, lanes)
    texts = [(HERE / source).read_text(), (HERE / "model.h").read_text()]
    key = hashlib.sha256("\n".join([*command, _machine(), *texts]).encode())
    folder = user_cache() / "speed"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{Path(source).stem}-{key.hexdigest()[:20]}.so"
    if not path.exists():
        half = path.with_suffix(f".{os.getpid()}")
        done = subprocess.run([*command, "-o", str(half), "-lm"], capture_output=True)
        if done.returncode:
            raise RuntimeError(f"{command[0]}: {done.stderr.decode()[-2000:]}")
        os.replace(half, path)
    return ctypes.CDLL(str(path))


def vectorised(source: str, real: str, lanes: int) -> list[tuple[int, int]]:
    """What gcc vectorised: the line of each loop, and the vectors' size in bytes."""
    said = subprocess.run(
        [*_command(source, real, lanes), "-fopt-info-vec-optimized", "-o", os.devnull],
        capture_output=True,
        text=True,
        check=True,
    ).stderr
    found = re.findall(r":(\d+):\d+: \w+: loop vectorized using (\d+) byte", said)
    return [(int(line), int(size)) for line, size in found]


def dtype(real: str) -> type[np.floating]:
    """NumPy's name of C's `double` or `float`."""
    return {"double": np.float64, "float": np.float32}[real]


def names(text: bytes) -> list[str]:
    """The names of a list that the C code wrote down with its preprocessor."""
    return text.decode().rstrip(",").split(",")
