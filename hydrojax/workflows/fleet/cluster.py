"""The same tasks on the workers of a cluster (dask.distributed).

Tasks name files by path, so every worker must see the logs and the folder of results
under the same paths; it writes its results there, and only a line comes back. What was
under way on a worker that is lost is given to another.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeVar

from hydrojax.errors import InputError
from hydrojax.jax_setup import cores
from hydrojax.workflows.fleet.local import TRIES, environment

if TYPE_CHECKING:
    from distributed import Client

AHEAD = 2
"""Tasks per worker's thread that the scheduler knows of at a time."""

T = TypeVar("T")


@contextmanager
def client(address: str) -> Iterator[Client]:
    """A connection to a scheduler, or to N workers made here for `local:N`.

    Raises:
        InputError: no such address, no scheduler or no worker there, or
            dask.distributed is missing.
    """
    try:
        import distributed
        from dask import config
    except ImportError as error:
        raise InputError(
            "--cluster: dask.distributed is not installed: pip install "
            "'hydrojax[cluster]'"
        ) from error
    kind, _, count = address.partition(":")
    with config.set({"distributed.scheduler.allowed-failures": TRIES}):
        if kind == "local":
            if not count.isdecimal() or not int(count):
                raise InputError(
                    f"--cluster {address}: write local:N with N workers, such as "
                    "local:2"
                )
            each: dict[str, Any] = {
                "threads_per_worker": 1,
                "processes": True,
                "dashboard_address": None,
                "memory_limit": 0,
                "silence_logs": 50,
                "env": environment(max(1, cores() // int(count))),
            }
            with (
                distributed.LocalCluster(n_workers=int(count), **each) as here,
                distributed.Client(here) as found,
            ):
                yield found
            return
        try:
            found = distributed.Client(address, timeout=10)
        except (OSError, ValueError) as error:
            raise InputError(
                f"--cluster {address}: no scheduler responds there; start one with "
                "dask scheduler, or write local:2"
            ) from error
        with found:
            if not found.nthreads():
                raise InputError(
                    f"--cluster {address}: the scheduler has no worker; start some: "
                    f"dask worker {address}"
                )
            yield found


def share_out(
    tasks: Iterable[T],
    do: Callable[[T], Any],
    found: Client,
    progress: Callable[[Any], None],
    lost: Callable[[T, str], Any],
) -> None:
    """Have every task done by one of the cluster's workers.

    Args:
        tasks: taken as workers get free; they travel, so they are small.
        do: what does one, by name; run again on another worker if its own is lost.
        found: the cluster.
        progress: called with the result of `do` for every task.
        lost: gives the result of a task whose workers died repeatedly.
    """
    from distributed import KilledWorker, as_completed

    source, under_way = iter(tasks), {}

    def submit(task: T) -> Any:
        future = found.submit(do, task, pure=False)
        under_way[future.key] = task
        return future

    workers: Any = found.nthreads()
    threads = max(1, sum(workers.values()))
    first = [submit(task) for task in islice(source, AHEAD * threads)]
    ended = as_completed(first)
    for future in ended:
        task = under_way.pop(future.key)
        try:
            result = future.result()
        except KilledWorker:
            result = lost(task, f"its worker was lost more than {TRIES} times")
        progress(result)
        for more in islice(source, 1):
            ended.add(submit(more))
