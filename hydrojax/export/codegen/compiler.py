"""The C compiler of this machine."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from hydrojax.errors import InputError

SHARED = ("-std=c99", "-O2", "-shared", "-fPIC", "-fvisibility=hidden")


def compiler() -> str | None:
    """$CC, cc, gcc or clang, whichever is there first; None without one."""
    known = (os.environ.get("CC"), "cc", "gcc", "clang")
    return next((found for c in known if c and (found := shutil.which(c))), None)


def shared_library(
    sources: Mapping[str, str], flags: Sequence[str] = SHARED, wanted_by: str = ""
) -> bytes:
    """A library made of C files.

    Args:
        sources: texts by file name; what does not end in `.c` is only included.
        flags: of the compiler.
        wanted_by: opens an error's line.

    Raises:
        InputError: there is no compiler, or it does not compile them.
    """
    cc = compiler()
    if cc is None:
        raise InputError(
            f"{wanted_by}: needs a C compiler and there is none; install gcc or clang, "
            "or name one in CC"
        )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in sources.items():
            (folder / file).write_text(text, encoding="utf-8")
        own = [file for file in sources if file.endswith(".c")]
        done = subprocess.run(
            [cc, *flags, *own, "-o", "made", "-lm"],
            cwd=folder,
            capture_output=True,
            text=True,
        )
        if done.returncode:
            lines = done.stderr.splitlines()
            said = next((x for x in lines if "error" in x), "".join(lines[:1]))
            raise InputError(
                f"{wanted_by}: {Path(cc).name} does not compile it: {said[:200]}"
            )
        return (folder / "made").read_bytes()
