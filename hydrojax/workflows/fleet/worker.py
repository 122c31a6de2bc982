"""A worker process: a task as a line of JSON comes in, and goes out when it is done."""

from __future__ import annotations

import os
import sys
import threading
from queue import SimpleQueue

from hydrojax.workflows.fleet.work import Task, perform


def main() -> None:
    """Do tasks until nobody asks any more."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a library prints is no answer
    asked: SimpleQueue[str] = SimpleQueue()
    threading.Thread(target=_listen, args=(asked,), daemon=True).start()
    while True:
        done = perform(Task.model_validate_json(asked.get()))
        answers.write(done.model_dump_json() + "\n")
        answers.flush()


def _listen(asked: SimpleQueue[str]) -> None:
    """Pass on what is asked; end at once, work under way or not, when who asks ends."""
    for line in sys.stdin:
        asked.put(line)
    os._exit(0)


if __name__ == "__main__":
    main()
