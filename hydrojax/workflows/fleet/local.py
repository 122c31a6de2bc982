"""Worker processes on this machine, and what happens when one of them dies.

Each has its own process and its share of the cores. A worker whose memory has grown is
replaced; a task whose worker died is given to another, at most `TRIES` times. A task
that takes more time or memory than its limit fails, and the others go on.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue

from hydrojax.jax_setup import cores, resident
from hydrojax.workflows.fleet.work import Done, Task, lost

MEMORY = 3 * 2**29
"""Bytes a worker may have held before it is replaced: one that has compiled a trace's
programs has, and one that finds them on disk has not."""

LOOK = 0.5
"""Seconds between two looks at what a task takes."""

TRIES = 3
"""Workers that may die of a task before it counts as failed."""


@dataclass(frozen=True)
class JobLimits:
    """What one task may take.

    Attributes:
        seconds: from when a worker has it.
        memory: bytes that the worker holds, where the system says how many; inf is no
            limit.
    """

    seconds: float = 3600.0
    memory: float = 8 * 2**30


Progress = Callable[[Done], None]
"""Called with every task that is done."""


def share_out(
    tasks: Iterable[Task],
    workers: int,
    log: Path,
    progress: Progress,
    most: int = MEMORY,
    limits: JobLimits = JobLimits(),
) -> None:
    """Have every task done by one of some worker processes.

    However it ends, no worker is left. What they print goes to the end of `log`.

    Args:
        tasks: taken one by one as workers get free.
        workers: how many.
        log: a file, made if it is not there.
        progress: called with every task that is done, in this thread.
        most: bytes of a worker at which it is replaced.
        limits: of every task.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    source, lock = iter(tasks), threading.Lock()
    ended: SimpleQueue[Done | BaseException | None] = SimpleQueue()
    lanes = [
        _Lane(source, lock, ended, log, workers, most, limits) for _ in range(workers)
    ]
    for lane in lanes:
        lane.start()
    try:
        running = workers
        while running:
            try:
                done = ended.get(timeout=1.0)  # so that Ctrl-C works everywhere
            except Empty:
                continue
            if done is None:
                running -= 1
            elif isinstance(done, BaseException):
                raise done
            else:
                progress(done)
    finally:
        for lane in lanes:
            lane.stop()
        for lane in lanes:
            lane.join()


class _Lane(threading.Thread):
    """One worker after another, and the tasks they are given."""

    def __init__(
        self, source: Iterator[Task], lock, ended, log: Path, workers, most, limits
    ):
        super().__init__(daemon=True)
        self.source, self.lock, self.ended = source, lock, ended
        self.log, self.most, self.limits = log, most, limits
        self.environment = os.environ | environment(max(1, cores() // workers))
        self.process: subprocess.Popen[str] | None = None
        self.stopped, self.exceeded = False, ""

    def run(self) -> None:
        try:
            while not self.stopped:
                with self.lock:
                    task = next(self.source, None)
                if task is None:
                    break
                done = self._persist(task)
                if done is not None:
                    self.ended.put(done)
                    if done.memory > self.most:
                        self._end()
        except BaseException as error:
            self.ended.put(error)
        finally:
            self._end()
            self.ended.put(None)

    def stop(self) -> None:
        """End the worker at once, whatever it does."""
        self.stopped = True
        process = self.process
        if process is not None:
            process.kill()

    def _persist(self, task: Task) -> Done | None:
        """Give the task to worker after worker; None if all was stopped."""
        code = 0
        for _ in range(TRIES):
            result = self._perform(task)
            if self.stopped:
                return None
            if result:
                return Done.model_validate_json(result)
            code = self._end()
            if self.exceeded:
                return lost(task, self.exceeded)
        return lost(task, f"its worker died {TRIES} times ({_cause(code)})")

    def _perform(self, task: Task) -> str:
        """The worker's result as a line; "" if it died."""
        if self.process is None:
            self.process = self._begin()
            if self.stopped:  # `stop` may have come before there was one to end
                return ""
        pipe, results = self.process.stdin, self.process.stdout
        assert pipe is not None and results is not None
        over, self.exceeded = threading.Event(), ""
        watch = threading.Thread(target=self._watch, args=(self.process, over))
        watch.start()
        try:
            pipe.write(task.model_dump_json() + "\n")
            pipe.flush()
            return results.readline()
        except OSError:
            return ""
        finally:
            over.set()
            watch.join()

    def _watch(self, process: subprocess.Popen[str], over: threading.Event) -> None:
        """End the worker where its task takes more than it may."""
        began, most = time.monotonic(), self.limits
        while not over.wait(LOOK):
            if time.monotonic() - began > most.seconds:
                self.exceeded = f"took more than {most.seconds:g} s (--job-seconds)"
            elif resident(process.pid) > most.memory:
                size = most.memory / 2**30
                self.exceeded = f"took more than {size:g} GiB (--job-memory)"
            if self.exceeded:
                process.kill()
                return

    def _begin(self) -> subprocess.Popen[str]:
        with self.log.open("a") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "hydrojax.workflows.fleet.worker"],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log,
                env=self.environment, encoding="utf-8",
                start_new_session=True,  # Ctrl-C is for who started the fleet
            )  # fmt: skip

    def _end(self) -> int:
        process, self.process = self.process, None
        if process is None:
            return 0
        if process.poll() is None:
            process.kill()
        code = process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                pipe.close()
        return code


def environment(threads: int) -> dict[str, str]:
    """What keeps a worker's programs to so many threads.

    The first two are read by XLA's pool of threads on the CPU, of which there is no
    other setting but the process's affinity.
    """
    names = ("NPROC", "PJRT_NPROC", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
    return dict.fromkeys(names, str(threads))


def _cause(code: int) -> str:
    """An exit status in words."""
    try:
        return signal.Signals(-code).name if code < 0 else f"exit status {code}"
    except ValueError:
        return f"signal {-code}"
