"""One job: its key, the fit, and what is kept of it."""

from __future__ import annotations

import hashlib
import importlib
import os
import stat
import time
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, field_validator

from hydrojax.effects import EFFECTS, offered
from hydrojax.effects.registry import file_of
from hydrojax.errors import InputError
from hydrojax.rigfile.fingerprint import code_fingerprint
from hydrojax.workflows.fleet.jobs import Command, Job, Jobs
from hydrojax.workflows.fleet.store import Store

FORMAT = "hydrojax-job/2"

SOLVER = "hydrojax.workflows.fleet.solve:solve"
"""What does a job, as `module:function` of a job with whole paths and the options."""

Solver = Callable[[Job, "Options"], dict[str, Any]]


class Options(BaseModel):
    """How every job is done; as `identify` and `trace` have it.

    Numbers are finite: what is not, JSON cannot bring to a worker. Of `effects` folders
    become the files in them, and paths whole ones.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    command: Command = "trace"
    horizon: float = Field(default=0.25, ge=0.01)
    starts: int = Field(default=0, ge=0, description="0: the command's own number")
    matters: float = Field(default=0.02, ge=0)
    level: float = Field(default=0.01, gt=0, le=0.5)
    profile: bool = False
    effects: tuple[str, ...] = ()

    @field_validator("effects")
    @classmethod
    def _files(cls, given: tuple[str, ...]) -> tuple[str, ...]:
        """Every file by its whole path: a result depends on what stands in each."""
        out: list[Path] = []
        for path in (Path(p).absolute() for p in given):
            out += sorted(path.glob("*.py")) if path.is_dir() else [path]
        return tuple(map(str, out))


class Task(BaseModel):
    """What a worker is given: a job with whole paths, its key, how and by what."""

    model_config = ConfigDict(frozen=True)

    key: str
    job: Job
    options: Options
    out: str
    solver: str = SOLVER


class Done(BaseModel):
    """What a worker returns; the result itself is in the store.

    `memory` is the most bytes that its process has held.
    """

    key: str
    failed: str = ""
    memory: int = 0


def located(job: Job, folder: Path) -> Job:
    """The job with whole paths."""
    root = folder.absolute()
    return Job(
        name=job.name,
        rig=str(root / job.rig),
        fit=tuple(str(root / p) for p in job.fit),
        validate_=tuple(str(root / p) for p in job.validate_),
    )


def keys_of(jobs: Jobs, options: Options) -> list[str]:
    """Every job's key, of the files as they are now."""
    _how.cache_clear()
    _content.cache_clear()
    return [_key(job, jobs.folder, options) for job in jobs]


def _key(job: Job, folder: Path, options: Options) -> str:
    """What a job's result depends on, in 24 letters.

    The rig's and the own effects' text, each log's path, size and time of change, the
    options, hydrojax's version and the code of all effects that a trace may add; not
    its name and its labels.
    """
    root = str(folder)
    how = options.model_dump_json(exclude={"effects"})
    seen = _how(how, options.effects).copy()
    seen.update(_content(os.path.join(root, job.rig)))
    for part in (job.fit, job.validate_):
        stamps = [(path, _stamp(os.path.join(root, path))) for path in part]
        seen.update(repr(stamps).encode())
    return seen.hexdigest()[:24]


@lru_cache(maxsize=16)
def _how(options: str, effects: tuple[str, ...]) -> Any:
    """A hash of how jobs are done, which every job's own begins with."""
    offered()
    known = {name: e for name, e in EFFECTS.items() if file_of(e) is None}
    seen = hashlib.sha256(f"{FORMAT} {code_fingerprint(known)}".encode())
    seen.update(options.encode())
    for path in effects:
        seen.update(_content(path))
    return seen


@lru_cache(maxsize=4096)
def _content(path: str) -> bytes:
    try:
        return hashlib.sha256(Path(path).read_bytes()).digest()
    except OSError:
        return path.encode()


def _stamp(path: str) -> list[int]:
    """Size and time of change of a file, or of all in a bag's folder; [] of none."""
    try:
        found = os.stat(path)
        if not stat.S_ISDIR(found.st_mode):
            return [found.st_size, found.st_mtime_ns]
        inside = [p.stat() for p in sorted(Path(path).rglob("*")) if p.is_file()]
        return [n for s in inside for n in (s.st_size, s.st_mtime_ns)]
    except OSError:
        return []


def perform(task: Task) -> Done:
    """Do a job and store what came of it; a job that is done already is left alone.

    A job that fails does not stop the others: its message is stored. An `InputError` is
    final, unless a file cannot be found from here; other failures (a disk, memory, a
    fault in the program) are tried again by the next run.
    """
    store = Store(Path(task.out))
    if store.has(task.key):
        return Done(key=task.key, memory=memory())
    began = time.perf_counter()
    module, _, name = task.solver.partition(":")
    final, row = True, {}
    try:
        solver: Solver = getattr(importlib.import_module(module), name)
        row = solver(task.job, task.options)
        failed = ""
    except InputError as error:
        failed = str(error)
        files = (task.job.rig, *task.job.fit, *task.job.validate_)
        final = all(map(os.path.exists, files))
    except Exception as error:
        failed = f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"
        final = False
    seconds = row.pop("seconds", {}) | {"all": time.perf_counter() - began}
    record = {"format": FORMAT, "key": task.key, "failed": failed, **row}
    store.save(task.key, record | {"seconds": seconds}, final)
    return Done(key=task.key, failed=failed, memory=memory())


def lost(task: Task, why: str) -> Done:
    """Store that a job's worker died every time it was tried."""
    record = {"format": FORMAT, "key": task.key, "failed": why, "seconds": {}}
    Store(Path(task.out)).save(task.key, record, final=False)
    return Done(key=task.key, failed=why)


def memory() -> int:
    """Most bytes that this process has held; 0 where the system does not say.

    On Linux ru_maxrss begins with what the parent has held, VmHWM does not.
    """
    with suppress(OSError):
        lines = Path("/proc/self/status").read_text().splitlines()
        return next((1024 * int(s.split()[1]) for s in lines if "VmHWM" in s), 0)
    try:
        import resource
    except ImportError:
        return 0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # bytes on macOS
