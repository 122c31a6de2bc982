"""The command line: the roof over the whole house."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from . import __version__
from .backend import set_up_jax, user_cache
from .errors import InputError

if TYPE_CHECKING:
    from .identify.outcome import Outcome

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Find the effect behind the residual of a hydraulic force-control model.",
)
console = Console()
errors = Console(stderr=True)

RigFile = Annotated[Path, typer.Argument(help="Rig file (TOML).", show_default=False)]
Logs = Annotated[
    list[Path],
    typer.Argument(help="Logs to fit: CSV(.gz), Parquet or MAT.", show_default=False),
]
Horizon = Annotated[float, typer.Option(help="Length of a replay window, s.", min=0.01)]
Out = Annotated[Path, typer.Option(help="Folder for the report and its figures.")]


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """A line that says what is being done, and for how long it has been."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    quiet = not errors.is_terminal  # else a log file gets an empty line
    with Progress(*columns, console=errors, transient=True, disable=quiet) as bar:
        task = bar.add_task("read the logs")
        yield lambda what: bar.update(task, description=what)


def _check_out(out: Path) -> None:
    for path in (out, *out.parents):
        if path.exists() and not path.is_dir():
            raise InputError(f"{path}: is a file: name a folder with --out")
    there = next(path for path in (out, *out.absolute().parents) if path.exists())
    if not os.access(there, os.W_OK):
        raise InputError(f"{out}: cannot be written to: name another folder with --out")


@app.command()
def identify(
    rig: RigFile,
    logs: Logs,
    validate: Annotated[
        list[Path] | None,
        typer.Option(help="Logs that take no part in the fit: all words that follow."),
    ] = None,
    out: Out = Path("hydrojax-identify"),
    horizon: Horizon = 0.25,
    starts: Annotated[int, typer.Option(help="Fits from so many starts.", min=1)] = 4,
) -> None:
    """Fit the declared model to logs; say how well it does and can be believed."""
    _check_out(out)
    set_up_jax(user_cache())
    from .identify import run

    with _progress() as tell:
        case = run.open_case(rig, logs, validate or (), horizon)
        outcome = run.identify(case, starts, tell)
    _finish(outcome, out)


@app.command()
def trace(
    rig: RigFile,
    logs: Logs,
    validate: Annotated[
        list[Path],
        typer.Option(help="Logs that take no part in the fit: all words that follow."),
    ],
    out: Out = Path("hydrojax-trace"),
    horizon: Horizon = 0.25,
    starts: Annotated[int, typer.Option(help="Fits from so many starts.", min=1)] = 1,
    matters: Annotated[
        float,
        typer.Option(help="Least fall of the error, as a share of the noise.", min=0.0),
    ] = 0.02,
    level: Annotated[
        float, typer.Option(help="Family-wise significance.", min=1e-12, max=0.5)
    ] = 0.01,
) -> None:
    """Close the loop: fit, residual, the effect behind it, refit, before and after."""
    _trace(rig, logs, validate, out, horizon, starts, matters, level)


@app.command()
def demo(out: Out = Path("hydrojax-demo")) -> None:
    """Run `trace` on a rig and logs that come with the package."""
    folder = resources.files("hydrojax") / "demo"
    with resources.as_file(folder) as here:
        console.print("trace of the demo rig: two logs to fit, one to check\n")
        logs = [here / "fit_1.csv.gz", here / "fit_2.csv.gz"]
        _trace(here / "rig.toml", logs, [here / "validate.csv.gz"], out)


def _trace(
    rig: Path,
    logs: list[Path],
    validate: list[Path],
    out: Path,
    horizon: float = 0.25,
    starts: int = 1,
    matters: float = 0.02,
    level: float = 0.01,
) -> None:
    _check_out(out)
    set_up_jax(user_cache())
    from .identify import run

    with _progress() as tell:
        case = run.open_case(rig, logs, validate, horizon)
        outcome = run.trace_case(case, starts, matters, level, tell)
    _finish(outcome, out)


def _finish(outcome: Outcome, out: Path) -> None:
    """Write the report and show the gist of it."""
    from .identify.report import quantity, write_report

    write_report(outcome, out)
    console.print(f"[bold]{outcome.verdict}[/bold]  {outcome.sentence}\n")
    table = Table("channel", "noise", "before", "after", "after / noise")
    for name, c in outcome.channels.items():
        table.add_row(
            name,
            *(quantity(v, c.unit) for v in (c.noise, c.before, c.after)),
            f"{c.after / c.noise:.3f}",
        )
    console.print(table)
    for effect in outcome.effects:
        found = ", ".join(
            f"{n} = {quantity(p.value, p.unit, p.std)}"
            for n, p in effect.parameters.items()
        )
        alike = (
            f"; cannot be told from {', '.join(effect.cannot_tell_from)}"
            if effect.cannot_tell_from
            else ""
        )
        console.print(f"{effect.name}: {found}{alike}")
    for line in (*outcome.limits, *outcome.notes):
        console.print(f"- {line}")
    spent = outcome.seconds
    console.print(
        f"\ncompile {spent['compile']:.1f} s, run {spent['run']:.1f} s; "
        f"report in {out / 'report.html'}"
    )


def _version(wanted: bool) -> None:
    if wanted:
        console.print(f"hydrojax {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Say it."),
    ] = False,
) -> None:
    """What holds for every command."""


def _spread(words: list[str]) -> list[str]:
    """Let `--validate` take several logs: repeat it before each word that follows."""
    out, open_ = [], False
    for word in words:
        if word == "--validate":
            open_ = True
        elif word.startswith("--validate="):
            open_ = True
            out.append(word)
        elif open_ and not word.startswith("-"):
            out += ["--validate", word]
        else:
            open_ = False
            out.append(word)
    return out


def _refuse(error: Exception) -> NoReturn:
    errors.print(f"hydrojax: {error}", style=None, markup=False, soft_wrap=True)
    sys.exit(2)


def main() -> None:
    """Run the command line: 0 when it did its work, 2 on bad input."""
    try:
        app(_spread(sys.argv[1:]))
    except InputError as error:
        _refuse(error)
    except OSError as error:  # a disk that is full, a folder that went away
        _refuse(error)


if __name__ == "__main__":
    main()
