"""The command line."""

from __future__ import annotations

import gc
import io
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Annotated, Any, NoReturn

import typer

from hydrojax import __version__
from hydrojax.cli import batch, compare, export, identify, init, loop, tune
from hydrojax.cli.options import app, console, errors
from hydrojax.errors import InputError, one_line


def _version(wanted: bool) -> None:
    if wanted:
        console.print(f"hydrojax {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_version,
            is_eager=True,
            help="Show the version and exit.",
        ),
    ] = False,
) -> None:
    """Options of every command."""


ORDER = (
    "demo", "init", "check", "identify", "trace", "compare", "simulate", "excite",
    "bounds", "sweep", "tune", "batch", "export", "paper",
)  # fmt: skip
"""Commands as help lists them: in the order in which they are needed."""
app.registered_commands.sort(
    key=lambda c: ORDER.index(getattr(c.callback, "__name__", ""))
)

SEVERAL = (
    "--validate", "--test", "--gains", "--separate", "--over", "--by", "--at", "--free",
    "--controller", "--to", "--column", "--fail-on",
)  # fmt: skip
"""Options that take all words that follow."""


def spread(words: list[str]) -> list[str]:
    """Let some options take several words: repeat them before each that follows."""
    out, open_ = [], ""
    for word in words:
        name, sign, _ = word.partition("=")
        if name in SEVERAL:
            open_ = name
            if sign:
                out.append(word)
        elif open_ and not word.startswith("-"):
            out += [open_, word]
        else:
            open_ = ""
            out.append(word)
    return out


def _refuse(error: Exception) -> NoReturn:
    errors.print(f"hydrojax: {one_line(error)}", style=None, soft_wrap=True)
    sys.exit(2)


def _usage(error: Any) -> NoReturn:
    """A command line that cannot be taken, in one line."""
    context = getattr(error, "ctx", None)
    if type(error).__name__ == "NoArgsIsHelpError":  # its message is the help
        print(error.format_message())
        sys.exit(2)
    where = context.command_path if context is not None else "hydrojax"
    said = " ".join(error.format_message().split()).rstrip(".")
    _refuse(InputError(f"{said}; see {where} --help"))


_CLICK_ERROR: Any = typer.BadParameter.__mro__[2]
"""Click's base of what a command line can have wrong: Typer has a copy of Click or
Click itself, by its version."""


GRACE = 1.5
"""Seconds in which a command that is interrupted may end by itself."""

STOPPED = "hydrojax: stopped by {}\n"
"""What a command says last that a signal ends."""


@contextmanager
def _interruptible(came: list[int]) -> Iterator[None]:
    """Let SIGINT and SIGTERM end a command, whatever it is at; `came` gets them.

    An exception in a callback of compiled code, of the garbage collector or of a
    destructor is swallowed: it is raised again where that can be seen. Where it
    cannot, and while compiled code runs, Python hears of no signal: a thread of its own
    hears of it, and ends the process when its time is up. What is written is whole or
    not there at any moment.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(number: int, _: object) -> NoReturn:
        came.append(number)
        raise KeyboardInterrupt

    reader, writer = socket.socketpair()
    writer.setblocking(False)
    ended, swallowed = threading.Event(), threading.Event()

    def watch() -> None:
        number = reader.recv(1)
        if not number:
            return
        until = time.monotonic() + GRACE
        while not ended.wait(0.1):
            if time.monotonic() > until:
                _stop(number[0])
            if swallowed.is_set():
                swallowed.clear()
                signal.pthread_kill(threading.main_thread().ident or 0, number[0])

    def unraisable(lost: Any) -> None:
        if came and issubclass(lost.exc_type, KeyboardInterrupt):
            swallowed.set()
        else:
            hook(lost)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    hook, sys.unraisablehook = sys.unraisablehook, unraisable
    wakened = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    signals = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(s, interrupt) for s in signals]
    try:
        yield
    finally:
        ended.set()
        signal.set_wakeup_fd(wakened)
        writer.close()
        thread.join()  # before the handlers go: it may be sending a signal
        reader.close()
        for number, handler in zip(signals, before, strict=True):
            signal.signal(number, handler)
        sys.unraisablehook = hook


COLLECTED = (20_000, 20, 100)
"""Thresholds of Python's garbage collection (`gc.set_threshold`). At its own it looks
again and again through all that JAX has traced, and finds next to nothing."""


def main() -> None:
    """Run the command line: 0 when it did its work, 2 on bad input.

    1 where `--fail-on` says so, a job of a batch failed or a tuning finds no gains that
    hold; 130 and 143 where a signal stops it.
    """
    gc.set_threshold(*COLLECTED)
    came: list[int] = []
    code = 1
    try:
        with _interruptible(came):
            code = _run()
    except (Exception, SystemExit, KeyboardInterrupt):
        if not came:  # else it is what became of the interruption on its way
            raise
    if came:
        with suppress(OSError, ValueError):
            sys.stdout.flush()
        _stop(came[0])
    sys.exit(code)


def _stop(number: int) -> NoReturn:
    """Say that a signal ends the process, and end it as it is: Python's own end waits
    for compiled code, and is SIGINT where an interruption has passed through a text
    that was executed.
    """
    with suppress(OSError):
        os.write(2, STOPPED.format(signal.Signals(number).name).encode())
    os._exit(128 + number)


def _run() -> int:
    """Run the command line; its exit status."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # names of files need not be text
            stream.reconfigure(errors="backslashreplace")
    try:
        code = app(spread(sys.argv[1:]), prog_name="hydrojax", standalone_mode=False)
    except InputError as error:
        _refuse(error)
    except _CLICK_ERROR as error:
        _usage(error)
    except (typer.Abort, KeyboardInterrupt):
        return 1
    except OSError as error:  # a disk that is full, a folder that went away
        _refuse(error)
    except MemoryError:
        _refuse(InputError("out of memory: give it less at a time"))
    return code if isinstance(code, int) else 0


__all__ = [
    "app",
    "batch",
    "compare",
    "export",
    "identify",
    "init",
    "loop",
    "main",
    "spread",
    "tune",
]
