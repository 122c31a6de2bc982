"""A worker process: a task as a line of JSON comes in, and goes out when it is done."""

from __future__ import annotations

import os
import sys
import threading
from queue import SimpleQueue

from hydrojax.workflows.fleet.work import Task, perform


def main() -> None:
    """Do tasks until the input ends."""
    results = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # keep what libraries print out of the results
    tasks: SimpleQueue[str] = SimpleQueue()
    threading.Thread(target=_listen, args=(tasks,), daemon=True).start()
    while True:
        done = perform(Task.model_validate_json(tasks.get()))
        results.write(done.model_dump_json() + "\n")
        results.flush()


def _listen(tasks: SimpleQueue[str]) -> None:
    """Pass tasks on; exit at once, even during a task, when the input ends."""
    for line in sys.stdin:
        tasks.put(line)
    os._exit(0)


if __name__ == "__main__":
    main()
