"""The whole of a fleet: what is left to do, the work, the table, the report."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from hydrojax.errors import InputError
from hydrojax.jax_setup import cores
from hydrojax.workflows.fleet import cluster as clusters
from hydrojax.workflows.fleet import local
from hydrojax.workflows.fleet.jobs import Jobs, read_jobs
from hydrojax.workflows.fleet.store import Store, merge, merged
from hydrojax.workflows.fleet.work import (
    SOLVER,
    Done,
    Options,
    Task,
    keys_of,
    located,
    lost,
    perform,
)

Progress = Callable[[int, int], None]
"""Called with the jobs done and their total number."""


@dataclass(frozen=True)
class Ran:
    """What a run did: jobs in the table, those done in this run, those that failed.

    `fresh` is whether fleet.parquet was written.
    """

    jobs: int
    done: int
    failed: int
    fresh: bool


class Stopped(Exception):
    """Ctrl-C was pressed: how many jobs are done and kept, of how many."""

    def __init__(self, done: int, jobs: int):
        super().__init__(f"{done} of {jobs} are done and kept")


def run_fleet(
    source: str | Path,
    out: Path,
    options: Options | None = None,
    workers: int = 0,
    cluster: str = "",
    progress: Progress | None = None,
    solver: str = SOLVER,
    report: bool = True,
    command_line: str = "",
    limits: local.JobLimits = local.JobLimits(),
) -> Ran:
    """Do what is left of a table of jobs, and write its one table of results.

    A run that was killed goes on where it was; one that is done does nothing.

    Args:
        source: a table or a folder; see `read_jobs`.
        out: folder of the results.
        options: how every job is done.
        workers: worker processes; 0 is one per core.
        cluster: address of a dask scheduler, or local:N, in place of them.
        progress: called with the jobs done and their total number.
        solver: what does a job; see `work.SOLVER`.
        report: whether fleet.html and its pictures are made too.
        command_line: what was given, for fleet.html.
        limits: what one job may take of time and memory, where workers are processes of
            this machine's own.

    Raises:
        InputError: an invalid table or address, or results that workers wrote and
            that are not here.
        Stopped: Ctrl-C.
    """
    options, store = options or Options(), Store(out)
    jobs = read_jobs(source, options.command)
    keys = keys_of(jobs, options)
    mark = _mark(jobs, keys)
    store.clear()
    drawn = partial(_draw, store, keys, jobs, options, command_line)
    draw = drawn if report else None
    done, unread = 0, []
    for _ in range(2):  # again where results could not be read
        left = set(keys) - store.done()
        if left:
            tasks = _tasks(jobs, keys, left, options, out, solver)
            size = (len(left), len(set(keys)))
            given = (tasks, *size, out, workers, cluster, progress, limits)
            done += _work(*given)
        elif (failures := _known(store, mark, report)) is not None:
            return Ran(len(jobs), done, failures, False)
        unread, failed = _merge(store, jobs, keys, mark, draw)
        if not unread:
            return Ran(len(jobs), done, failed, True)
        store.drop(unread)  # a power cut can leave a file empty
    raise InputError(
        f"{out}: {len(unread)} results are not here after their jobs were done; give "
        "all workers this folder under the same path"
    )


def _known(store: Store, mark: str, report: bool) -> int | None:
    """How many jobs failed, where everything that is to be written stands there."""
    if merged(store) != mark or (report and not (store.folder / "fleet.html").exists()):
        return None
    return _failures(store.folder)


def _merge(
    store: Store,
    jobs: Jobs,
    keys: list[str],
    mark: str,
    draw: Callable[[], None] | None,
) -> tuple[list[str], int]:
    """Write the table and its report; keys that cannot be read, and how many failed."""
    (store.folder / "fleet.html").unlink(missing_ok=True)  # of another table
    # A table with jobs that will be tried again is not the last: it has no mark.
    last = set(keys) <= store.done()
    unread, failed = merge(store, jobs, keys, mark if last else "")
    if draw and not unread:
        draw()
    return unread, failed


def _draw(
    store: Store, keys: list[str], jobs: Jobs, options: Options, command_line: str
) -> None:
    # It takes its time to import, so it is only where it is wanted.
    from hydrojax.workflows.fleet.report import write_fleet_report

    write_fleet_report(store, keys, jobs.source.name, options, command_line)


def _tasks(
    jobs: Jobs, keys: list[str], left: set[str], options: Options, out: Path, solver
) -> Iterator[Task]:
    """The tasks that are left; what two rows ask for is done once."""
    given: set[str] = set()
    for job, key in zip(jobs, keys, strict=True):
        if key in left and key not in given:
            given.add(key)
            yield Task(
                key=key, job=located(job, jobs.folder), options=options,
                out=str(out.absolute()), solver=solver,
            )  # fmt: skip


def _work(
    tasks: Iterator[Task], left: int, total: int, out: Path, workers: int,
    cluster: str, progress: Progress | None, limits: local.JobLimits,
) -> int:  # fmt: skip
    """Have tasks done; how many were."""
    done = 0

    def count_one(_: Done) -> None:
        nonlocal done
        done += 1
        if progress:
            progress(total - left + done, total)

    if progress:
        progress(total - left, total)
    try:
        if cluster:
            with clusters.client(cluster) as found:
                clusters.share_out(tasks, perform, found, count_one, lost)
        else:
            count = min(workers or cores(), left)
            log = out / "workers.log"
            local.share_out(tasks, count, log, count_one, limits=limits)
    except KeyboardInterrupt:
        raise Stopped(total - left + done, total) from None
    return done


def _mark(jobs: Jobs, keys: list[str]) -> str:
    """What the table of results depends on."""
    seen = hashlib.sha256(repr(list(jobs.table.columns)).encode())
    rows = jobs.table.itertuples(index=False, name=None)
    for key, row in zip(keys, rows, strict=True):
        seen.update(f"{key}{row!r}".encode())
    return seen.hexdigest()


def _failures(out: Path) -> int | None:
    """How many jobs failed, by the table; None where it is damaged."""
    try:
        column = pq.read_table(out / "fleet.parquet", columns=["failed"])["failed"]
    except (OSError, ValueError, LookupError, pa.ArrowException):
        return None
    return len(column) - column.null_count
