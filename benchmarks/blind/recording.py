"""Records what is not there yet; truths go to one file, outside the cases' folders."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from benchmarks.trace.score import append, read_results

Truth = dict[str, Any]

CASES, TRUTHS = "cases", "truth.jsonl"


def name_of(number: int, machines: bool) -> str:
    """A case's name, and its folder's: c03, m11."""
    return f"{'m' if machines else 'c'}{number:02d}"


def truths(out: Path) -> dict[str, Truth]:
    """Of every case that was recorded, by its name."""
    return {t["case"]: t for t in read_results(out / TRUTHS)}


def record(out: Path, numbers: Iterable[int], machines: bool) -> Iterator[Truth]:
    """Write the cases that are missing. A truth comes last and says that all is there.

    Raises:
        ImportError: Numba is not installed.
    """
    known = truths(out)
    missing = [n for n in numbers if name_of(n, machines) not in known]
    write = _writer(machines) if missing else None
    for number in missing:
        assert write is not None
        (out / CASES).mkdir(parents=True, exist_ok=True)
        truth = write(out / CASES, number)
        append(out / TRUTHS, truth)
        yield truth


def _writer(machines: bool) -> Callable[[Path, int], Truth]:
    """Writes one case's folder, by number, and returns its truth."""
    if not machines:
        from .joints.make import write_case

        return write_case
    from .machines.make import make_case, plain

    def made(folder: Path, number: int) -> Truth:
        truth: Any = plain(make_case(number, folder))
        return truth

    return made
