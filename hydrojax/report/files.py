"""Files that belong together: all of them are written, or none.

New files are drafted inside their own folder, since the folder above may be read-only
or on another file system. One rename, of the draft to `READY`, decides: before it the
folder is as it was, after it `settle` moves the files to their places, now or when the
folder is read or written next.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
import uuid
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from hydrojax.errors import InputError

DRAFT = ".hydrojax-draft-"
READY = ".hydrojax-ready"
LOCK = ".hydrojax-lock"
OBSOLETE = ".obsolete"
"""In `READY`: the names of files that the new ones replace under other names."""

_RECORDS = ("report.json", "tune.json", "bounds.json")
"""Files that say which rig.toml was written beside them."""


def digest(content: bytes) -> str:
    """What identifies a file's content: its SHA-256."""
    return hashlib.sha256(content).hexdigest()


def check_untouched(folder: Path) -> None:
    """Refuse a folder whose rig.toml is not as it was written by an earlier run.

    Raises:
        InputError: somebody wrote or edited it.
    """
    path = folder / "rig.toml"
    if not path.is_file():
        return
    own = digest(path.read_bytes())
    for name in _RECORDS:
        try:
            record = json.loads((folder / name).read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            continue
        if isinstance(record, dict) and record.get("rig_toml_sha256") == own:
            return
    raise InputError(
        f"{path}: was edited, or is not of an earlier run, and would be overwritten; "
        "move it away, or name another folder with --out"
    )


def write_all(
    folder: Path, files: Mapping[str, bytes], obsolete: Iterable[str] = ()
) -> None:
    """Write files by name into `folder`, made if it is not there.

    A full disk, or a process that is killed, leaves either what was there or all that
    is new; files of other names stay.

    Args:
        folder: where.
        files: contents by name.
        obsolete: names of files that go as the new ones come.

    Raises:
        OSError: they cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    settle(folder)
    draft = Path(tempfile.mkdtemp(dir=folder, prefix=DRAFT))
    try:
        gone = sorted(set(obsolete) - set(files))
        for name, content in {**files, OBSOLETE: json.dumps(gone).encode()}.items():
            with (draft / name).open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())  # a full disk shows here at the latest
        settle(folder)
        os.rename(draft, folder / READY)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise
    settle(folder)


def settle(folder: Path) -> None:
    """Finish a change of files that was decided and not finished, if there is one.

    Raises:
        OSError: they cannot be moved.
    """
    ready = folder / READY
    if not ready.is_dir():
        return
    with suppress(FileNotFoundError):  # another process is finishing it too
        for name in json.loads((ready / OBSOLETE).read_text()):
            (folder / Path(name).name).unlink(missing_ok=True)
        for path in sorted(ready.iterdir()):
            if path.name != OBSOLETE:
                os.replace(path, folder / path.name)
    shutil.rmtree(ready, ignore_errors=True)


def write_one(path: Path, content: bytes) -> None:
    """Write a file, whole or not at all; its folder is made if it is not there.

    Raises:
        OSError: it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.parent / f"{DRAFT}{uuid.uuid4().hex}"
    try:
        draft.write_bytes(content)
        os.replace(draft, path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise


@contextmanager
def claim(folder: Path) -> Iterator[None]:
    """Hold a folder for one run, tested by writing; made if it is not there.

    A folder that was made and is still empty goes again at the end. What killed runs
    have left of drafts is removed.

    Raises:
        InputError: it cannot be written to, or another run holds it.
    """
    with _holding(folder / LOCK, folder, "folder"):
        for draft in folder.glob(f"{DRAFT}*"):
            shutil.rmtree(draft, ignore_errors=True)
            with suppress(OSError):
                draft.unlink(missing_ok=True)
        settle(folder)
        yield


@contextmanager
def claim_file(path: Path) -> Iterator[None]:
    """Hold one file for one run, as `claim` does a folder; its folder is made.

    Raises:
        InputError: it cannot be written to, or another run holds it.
    """
    own = digest(os.fsencode(path.name))[:16]
    with _holding(path.parent / f"{LOCK}-{own}", path, "file"):
        yield


@contextmanager
def _holding(lock: Path, what: Path, kind: str) -> Iterator[None]:
    """Hold a lock file in a folder that is made if it is not there."""
    folder = lock.parent
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = _locked(lock)
        if held is None:
            raise InputError(
                f"{what}: another run is writing there; wait for it, or name another "
                f"{kind} with --out"
            )
        try:
            held.write(b" " * 4096)
            held.flush()
        except OSError:
            held.close()
            raise
    except OSError as err:
        _remove(made)
        said = err.strerror or type(err).__name__
        raise InputError(
            f"{what}: cannot be written to ({said}): name another {kind} with --out"
        ) from err
    try:
        yield
    finally:
        with suppress(OSError):
            lock.unlink()
        held.close()
        _remove(made)


def _remove(made: Iterable[Path]) -> None:
    """Remove folders that are empty, the innermost first."""
    with suppress(OSError):
        for path in made:
            path.rmdir()


def _locked(path: Path) -> IO[bytes] | None:
    """A lock file, open and locked, or None where another process holds it; the lock
    goes with the process, however it ends.
    """
    while True:
        file = path.open("ab")
        if not _lock(file):
            file.close()
            return None
        try:
            if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                file.truncate(0)
                return file
        except FileNotFoundError:
            pass  # its holder removed it between the two: take a new one
        file.close()


def _lock(file: IO[bytes]) -> bool:
    """Whether a lock could be had, or the system has none."""
    try:
        import fcntl
    except ImportError:  # Windows
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True  # a file system without locks
    return True
