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
    from distributed import Client, LocalCluster

AHEAD = 2
"""Tasks per worker's thread that the scheduler knows of at a time."""

MOST = 1024
"""Workers on this machine, at most."""

_NO_PAGES = {
    f"distributed.{who}.http.routes": [] for who in ("scheduler", "worker", "nanny")
}
"""Nothing is served over HTTP."""

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
    settings = {"distributed.scheduler.allowed-failures": TRIES, **_NO_PAGES}
    with config.set(settings):
        if kind == "local":
            if not count.isdecimal() or not 0 < int(count[:9]) <= MOST:
                raise InputError(
                    f"--cluster {address}: write local:N with 1 to {MOST} workers, "
                    "such as local:2"
                )
            with _local(int(count)) as here, distributed.Client(here) as found:
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


def _local(workers: int) -> LocalCluster:
    """Workers on this machine that nobody but this process can talk to.

    A scheduler runs whatever it is sent: without a key any user of the machine could
    run code as its owner.

    Raises:
        InputError: there is nothing to make keys with.
    """
    import distributed

    try:
        security = distributed.Security.temporary()  # a key for this run, in memory
    except ImportError as error:
        raise InputError(
            "--cluster: cryptography is not installed: pip install 'hydrojax[cluster]'"
        ) from error
    return distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        security=security,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",  # None would open 8787
        scheduler_kwargs={"dashboard": False},
        memory_limit=0,
        silence_logs=50,
        env=environment(max(1, cores() // workers)),
    )


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
