"""Worker processes, as the benchmark that asks them sees them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .timing import Rounds, interleave

ROOT = Path(__file__).parent.parent.parent


class Failed(RuntimeError):
    """A worker could not make or run a program; the text says why."""


@dataclass(frozen=True)
class Program:
    """What is to be timed.

    Attributes:
        name: unique within what is timed together.
        setting: of `worker.SETTINGS`.
        maker: `module:function` of this package; what it returns is run.
        given: the maker's arguments, as JSON has them.
        worker: programs of one worker share a process; "" is one of its own setting.
    """

    name: str
    setting: str
    maker: str
    given: dict[str, Any]
    worker: str = ""


def environment(cache: Path) -> dict[str, str]:
    """Of a child: no flags of ours, and a user's cache that begins empty.

    A GPU's memory is taken as it is needed: several children share it.
    """
    env = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_", "XLA_"))}
    if "JAX_PLATFORMS" in os.environ:
        env["JAX_PLATFORMS"] = os.environ["JAX_PLATFORMS"]
    return env | {
        "XLA_PYTHON_CLIENT_PREALLOCATE": "false",
        "XDG_CACHE_HOME": str(cache),
        "PYTHONPATH": os.pathsep.join([str(ROOT), env.get("PYTHONPATH", "")]),
    }


class _Child:
    def __init__(self, setting: str, cache: Path, log: Any):
        self.process = subprocess.Popen(
            [sys.executable, "-m", f"{__package__}.worker", setting],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            env=environment(cache),
        )

    def ask(self, do: str, **more: Any) -> dict[str, Any]:
        to, back = self.process.stdin, self.process.stdout
        assert to is not None and back is not None
        try:
            to.write(json.dumps({"do": do, **more}) + "\n")
            to.flush()
            line = back.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            raise Failed(f"the process ended with code {self.process.wait()}")
        said = json.loads(line)
        if "error" in said:
            raise Failed(said["error"])
        return said

    def end(self) -> None:
        assert self.process.stdin is not None and self.process.stdout is not None
        try:
            self.process.stdin.close()
            self.process.wait(20)
        except (BrokenPipeError, subprocess.TimeoutExpired):
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()


class Children(AbstractContextManager):
    """Workers, started when they are first asked, ended together."""

    def __init__(self, progress: Callable[[str], None] = lambda what: None):
        self.progress = progress
        self._own = tempfile.TemporaryDirectory(prefix="hydrojax-speed.")
        self._log = open(Path(self._own.name) / "stderr", "w+")  # noqa: SIM115
        self._children: dict[str, _Child] = {}
        self._where: dict[str, str] = {}

    def __exit__(self, *_: object) -> None:
        for child in self._children.values():
            child.end()
        self._log.close()
        self._own.cleanup()

    def prepare(self, program: Program) -> dict[str, Any]:
        """Make a program ready; see `worker.Desk.prepare`.

        Raises:
            Failed: it cannot be made.
        """
        key = program.worker or program.setting
        self.progress(f"make ready: {program.name}")
        if key in self._children and self._children[key].process.poll() is not None:
            self._children.pop(key).end()
        if key not in self._children:
            cache = Path(self._own.name) / "cache"
            self._children[key] = _Child(program.setting, cache, self._log)
        self._where[program.name] = key
        given = {"maker": program.maker, "given": program.given}
        return self._children[key].ask("prepare", name=program.name, **given)

    def seconds(self, name: str) -> float:
        """Seconds of one run of a program that is ready."""
        return self._children[self._where[name]].ask("run", name=name)["seconds"]

    def forget(self, name: str) -> None:
        """Drop a program."""
        self._children[self._where[name]].ask("forget", name=name)

    def time(self, names: list[str], rounds: int, what: str) -> Rounds:
        """Seconds of these programs, in turns."""

        def progress(done: int, total: int) -> None:
            self.progress(f"{what}: round {done + 1} of {total}")

        runs = {n: lambda n=n: self.seconds(n) for n in names}
        return interleave(runs, rounds, progress)
