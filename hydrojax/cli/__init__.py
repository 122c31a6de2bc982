"""The command line."""

from __future__ import annotations

import sys
from typing import Annotated, NoReturn

import typer

from hydrojax import __version__
from hydrojax.cli import batch, export, identify, init, loop, tune
from hydrojax.cli.options import app, console, errors
from hydrojax.errors import InputError


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


SEVERAL = (
    "--validate", "--test", "--gains", "--separate", "--over", "--by", "--at", "--free",
    "--to", "--column",
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
    errors.print(
        f"hydrojax: {error}", style=None, markup=False, emoji=False, soft_wrap=True
    )
    sys.exit(2)


def main() -> None:
    """Run the command line: 0 when it did its work, 2 on bad input."""
    try:
        app(spread(sys.argv[1:]))
    except InputError as error:
        _refuse(error)
    except OSError as error:  # a disk that is full, a folder that went away
        _refuse(error)


__all__ = [
    "app",
    "batch",
    "export",
    "identify",
    "init",
    "loop",
    "main",
    "spread",
    "tune",
]
