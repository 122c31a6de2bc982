"""The line on the terminal that says what is being done, and how long it will take."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
)
from rich.text import Text

from hydrojax.jax_setup import user_cache
from hydrojax.report.files import write_one

Stages = list[tuple[str, float]]
"""What a run did, and when each began, s."""


class _Compiling(ProgressColumn):
    """Says that a program is being compiled, as JAX's own events have it."""

    begins = "/jax/compilation_cache/compile_requests_use_cache"
    ends = "/jax/core/compile/backend_compile_duration"

    def __init__(self):
        super().__init__()
        self.under_way = 0

    def listen(self) -> Callable[[], None]:
        """Count from now on; what is returned ends it."""
        from jax import monitoring

        def begun(event: str, **_: Any) -> None:
            self.under_way += event == self.begins

        def done(event: str, duration_secs: float, **_: Any) -> None:
            self.under_way = max(0, self.under_way - (event == self.ends))

        monitoring.register_event_listener(begun)
        monitoring.register_event_duration_secs_listener(done)

        def end() -> None:
            self.begins = self.ends = ""

        return end

    def render(self, task: Task) -> Text:
        return Text("compiling" if self.under_way else "")


class _Left(ProgressColumn):
    """The time that is left, as the last run of this kind took."""

    def __init__(self, before: Stages):
        super().__init__()
        self.at = dict(before)
        self.total = before[-1][1] if before else 0.0
        self.since, self.there = time.monotonic(), 0.0

    def enter(self, stage: str) -> None:
        """A stage begins."""
        if stage in self.at:
            self.since, self.there = time.monotonic(), self.at[stage]

    def render(self, task: Task) -> Text:
        left = self.total - self.there - (time.monotonic() - self.since)
        return Text(f"about {_round(left)} left" if left >= 1 else "")


class _Remaining(ProgressColumn):
    """The time that is left of a count, by the speed so far."""

    def render(self, task: Task) -> Text:
        left = task.time_remaining
        return Text(f"about {_round(left)} left" if left else "")


def _round(seconds: float) -> str:
    """A time as one would say it."""
    if seconds < 90:
        return f"{max(1, round(seconds / 5) * 5) if seconds > 10 else round(seconds)} s"
    return f"{round(seconds / 60)} min"


EVERY = 30.0
"""Time after which another line is printed where there is no terminal, s."""


def _in_lines(console: Console) -> Callable[[str], None]:
    """What prints what is being done to a log file, one line in `EVERY` at most; none
    of what is over sooner.
    """
    began = said = time.monotonic()

    def say(what: str) -> None:
        nonlocal said
        now = time.monotonic()
        if now - said >= EVERY:
            console.print(f"{now - began:.0f} s: {what}", highlight=False)
            said = now

    return say


@contextmanager
def show_stages(console: Console, quiet: bool) -> Iterator[Callable[[str], None]]:
    """A line with the stage, whether something is being compiled, and the time left."""
    if quiet:
        yield lambda _: None
        return
    if not console.is_terminal:
        yield _in_lines(console)
        return
    key = _kind()
    began, seen = time.monotonic(), Stages()
    compiling, left = _Compiling(), _Left(_recall().get(key, []))
    columns = (SpinnerColumn(), TextColumn("{task.description}"), compiling,
               TimeElapsedColumn(), left)  # fmt: skip
    end = compiling.listen()
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("read the files")

        def enter(what: str) -> None:
            seen.append((what, time.monotonic() - began))
            left.enter(what)
            bar.update(task, description=what)

        try:
            yield enter
        finally:
            end()
    _keep(key, [*seen, ("", time.monotonic() - began)])


@contextmanager
def show_count(console: Console, what: str) -> Iterator[Callable[[int, int], None]]:
    """A bar of so many done out of so many, with the time that is left."""
    if not console.is_terminal:
        say = _in_lines(console)
        yield lambda done, total: say(f"{what}: {done} of {total}")
        return
    compiling = _Compiling()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
               _Remaining(), compiling)  # fmt: skip
    end = compiling.listen()
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(what, total=None)
        try:
            yield lambda done, total: bar.update(task, completed=done, total=total)
        finally:
            end()


def _kind() -> str:
    """The command, and how much it is given: runs of one kind take about as long."""
    words = zip(sys.argv[1:], sys.argv[2:], strict=False)
    files = (Path(word) for before, word in words if before != "--out")
    size = sum(path.stat().st_size for path in files if path.is_file())
    return f"{' '.join(sys.argv[1:2])} {size.bit_length()}"


def _file() -> Path:
    return user_cache() / "progress.json"


def _recall() -> dict[str, Stages]:
    """What earlier runs took, by kind; nothing where that cannot be read."""
    try:
        found = json.loads(_file().read_text(encoding="utf-8"))
        return {k: [(str(s), float(t)) for s, t in v] for k, v in found.items()}
    except (OSError, ValueError, TypeError, AttributeError):
        return {}


def _keep(key: str, stages: Stages) -> None:
    """Remember what a run took; where nothing can be written, it is forgotten."""
    with suppress(OSError):
        write_one(_file(), json.dumps(_recall() | {key: stages}).encode())
