"""Runs `trace` on cases and keeps one JSON line a case; a killed run resumes."""

from __future__ import annotations

import json
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import nullcontext
from pathlib import Path

from .cases import CaseSpec, write_cases
from .tracing import Row, Tracing, declare

Tracer = Callable[[Path], Row]
Recorder = Callable[[Sequence[CaseSpec], Path], dict[str, str]]
Tell = Callable[[str, int, int], None]


# -- the file of results --


def read_results(path: Path) -> list[Row]:
    """The rows of a results file; a line that a kill tore is left out."""
    if not path.exists():
        return []
    rows = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            rows.append(json.loads(line))
        except ValueError:
            continue
    return rows


def append(path: Path, row: Row) -> None:
    """Add one row as one write, so that a kill tears at most the last line."""
    text = json.dumps(row, default=float) + "\n"
    torn = path.exists() and path.stat().st_size > 0 and not _ends_well(path)
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT
    file = os.open(path, flags, 0o644)
    try:
        os.write(file, (("\n" if torn else "") + text).encode())
        os.fsync(file)
    finally:
        os.close(file)


def _ends_well(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"


# -- many cases --


def batches(specs: Sequence[CaseSpec], size: int) -> Iterator[Sequence[CaseSpec]]:
    """Cases in the groups whose logs are recorded side by side."""
    for i in range(0, len(specs), size):
        yield specs[i : i + size]


def _record(specs: Sequence[CaseSpec], folder: Path, recorder: Recorder) -> dict:
    """Record what is not on disk; reasons by name of those that cannot be."""
    missing = [s for s in specs if not (folder / s.name / "truth.json").exists()]
    return recorder(missing, folder) if missing else {}


def _reason(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"[:500]


def _guarded(tracer: Tracer, folder: Path) -> Row:
    """A case's row, or the reason why there is none."""
    began = time.perf_counter()
    try:
        row = {"ok": True} | tracer(folder)
    except Exception as error:  # one bad case must not stop the others
        row = {"ok": False, "reason": _reason(error)}
    return {"case": folder.name} | row | {"wall": time.perf_counter() - began}


def score(
    specs: Sequence[CaseSpec],
    out: Path,
    tracer: Tracer | None = None,
    recorder: Recorder | None = None,
    jobs: int = 1,
    batch: int = 64,
    progress: Tell = lambda what, done, total: None,
) -> list[Row]:
    """Trace every case that OUT/results.jsonl does not hold yet; all its rows.

    Args:
        specs: the cases.
        out: folder of results.jsonl and of the cases' own folders.
        tracer: from a case's folder to its row; `Tracing()` by default; one that can be
            pickled if `jobs` > 1.
        recorder: writes cases' folders; `write_cases` with oracles by default.
        jobs: processes that trace.
        batch: cases whose logs are recorded side by side.
        progress: called with what is done, the cases done, and their total number.
    """
    out.mkdir(parents=True, exist_ok=True)
    path, folder = out / "results.jsonl", out / "cases"
    rows = read_results(path)
    known = {row["case"] for row in rows}
    wanted = {spec.name: spec for spec in specs}
    todo = [spec for name, spec in wanted.items() if name not in known]
    total, done = len(wanted), len(wanted) - len(todo)

    def keep(row: Row, spec: CaseSpec) -> None:
        nonlocal done
        row = {"kind": spec.kind, "sizes": dict(spec.effects)} | row
        append(path, row)
        rows.append(row)
        done += 1
        progress(row["case"], done, total)

    def recording(specs: Sequence[CaseSpec], folder: Path) -> dict[str, str]:
        return write_cases(specs, folder, declare)

    recorder, tracer = recorder or recording, tracer or Tracing()
    with _pool(jobs) as pool:
        for group in batches(todo, batch):
            progress(f"recording {len(group)} cases", done, total)
            bad = _record(group, folder, recorder)
            for spec in group:
                if spec.name in bad:
                    reason = bad[spec.name]
                    keep({"case": spec.name, "ok": False, "reason": reason}, spec)
            good = [spec for spec in group if spec.name not in bad]
            progress(f"tracing {len(good)} cases", done, total)
            for row, spec in _trace(good, folder, tracer, pool):
                keep(row, spec)
    return [row for row in rows if row["case"] in wanted]


def _pool(jobs: int) -> ProcessPoolExecutor | nullcontext[None]:
    """Processes that trace; none if this one does it alone."""
    # Forking a process in which JAX runs would hang it.
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(jobs, context) if jobs > 1 else nullcontext()


def _trace(
    specs: Sequence[CaseSpec],
    folder: Path,
    tracer: Tracer,
    pool: ProcessPoolExecutor | None,
) -> Iterator[tuple[Row, CaseSpec]]:
    """Rows of cases as they come."""
    if pool is None:
        for spec in specs:
            yield _guarded(tracer, folder / spec.name), spec
        return
    waiting = {pool.submit(_guarded, tracer, folder / s.name): s for s in specs}
    for job in as_completed(waiting):
        yield job.result(), waiting[job]
