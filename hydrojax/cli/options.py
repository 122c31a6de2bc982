"""What the commands have in common: options, progress, checks of where they write."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from hydrojax.cli.progress import show_count, show_stages
from hydrojax.errors import TEXT, InputError, check_known, one_line
from hydrojax.report.files import check_untouched, claim, claim_file

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # brackets in help texts are what a rig file has
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Find the effect behind the residual of a hydraulic force-control model.",
)
console = Console(markup=False, emoji=False)
"""Names of files and rigs are printed as they are: `[/b]` is no markup in them."""
errors = Console(stderr=True, markup=False, emoji=False)

RigPath = Annotated[Path, typer.Argument(help="Rig file (TOML).", show_default=False)]
Logs = Annotated[
    list[Path],
    typer.Argument(
        help="Logs to fit: CSV(.gz), Parquet, MAT, Excel, TDMS, MCAP or a ROS 2 bag's "
        "folder.",
        show_default=False,
    ),
]
Horizon = Annotated[
    float, typer.Option(help="Length of the replay windows, s.", min=0.01)
]
Out = Annotated[Path, typer.Option(help="Folder for the report and its figures.")]
Discover = Annotated[
    bool,
    typer.Option(
        "--discover",
        help="Where it ends unknown: find curves for what is left, write them as "
        "my_effects.py, and trace again with them.",
    ),
]
Catalogue = Annotated[
    Path | None,
    typer.Option(
        help="Folder of effects that were found before: searched too. What --discover "
        "finds, and the trace then names, is added to it.",
        show_default=False,
    ),
]
Effects = Annotated[
    list[Path] | None,
    typer.Option(
        help="Python file with effects of your own, or a folder of such files; may be "
        "repeated."
    ),
]

Json = Annotated[
    bool, typer.Option("--json", help="Print the result as JSON, and nothing else.")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
FailOn = Annotated[
    list[str] | None,
    typer.Option(
        help="Exit with status 1 on these verdicts: unknown, explained, 'nothing "
        "missing'; all words that follow.",
        show_default=False,
    ),
]

Gains = Annotated[
    list[str] | None,
    typer.Option(
        help="Values to replace in [controller], as k_p=1.5 or 'A_a=6 V*s,15 V*s': "
        "all words that follow.",
        show_default=False,
    ),
]
At = Annotated[
    list[str] | None,
    typer.Option(
        help="Operating point and other quantities, as v=0.01 or amplitude=200: "
        "all words that follow.",
        show_default=False,
    ),
]

Cluster = Annotated[
    str,
    typer.Option(
        help="Address of a dask scheduler whose workers do the work, or local:N.",
        show_default=False,
    ),
]

Matters = Annotated[
    float,
    typer.Option(
        help="Smallest fall of the error that counts, as a share of the noise.", min=0.0
    ),
]
Level = Annotated[
    float, typer.Option(help="Family-wise significance level.", min=1e-12, max=0.5)
]

Profile = Annotated[
    bool,
    typer.Option(
        "--profile", help="Add intervals by profile likelihood (many refits)."
    ),
]


def show_progress(
    quiet: bool = False,
) -> AbstractContextManager[Callable[[str], None]]:
    """A line that says what is being done, and for how long it will be."""
    return show_stages(errors, quiet)


def counted(what: str) -> AbstractContextManager[Callable[[int, int], None]]:
    """A bar of so many done out of so many, with the time that is left."""
    return show_count(errors, what)


def command_line(context: typer.Context) -> str:
    """What was given, as one line for a report; as a comment behind it, the numbers and
    words that were left as they are.
    """
    line = shlex.join(["hydrojax", *sys.argv[1:]])
    left = []
    for option in context.command.params:
        value = context.params.get(option.name or "")
        source = context.get_parameter_source(option.name or "")
        known = isinstance(value, int | float | str) and not isinstance(value, bool)
        if known and value != "" and source is not None and source.name == "DEFAULT":
            left += [max(option.opts, key=len), str(value)]
    return one_line(f"{line}  # {shlex.join(left)}" if left else line, TEXT)


def check_out(context: typer.Context, out: Path) -> None:
    """Hold a folder until the command ends, before any work: see `files.claim`.

    Raises:
        InputError: it is no folder, cannot be written to, or another run holds it.
    """
    for path in (out, *out.parents):
        if os.path.exists(path) and not os.path.isdir(path):
            raise InputError(f"{path}: is a file: name a folder with --out")
    context.with_resource(claim(out))


def check_report(context: typer.Context, out: Path) -> None:
    """Refuse a folder that cannot be written, or whose rig.toml somebody edited."""
    check_out(context, out)
    check_untouched(out)


VERDICTS = ("nothing missing", "explained", "unknown")


def check_verdicts(named: list[str] | None) -> tuple[str, ...]:
    """The verdicts that `--fail-on` names.

    Raises:
        InputError: another word.
    """
    check_known("--fail-on:", named or (), VERDICTS, "verdict")
    return tuple(named or ())


def check_file(context: typer.Context, out: Path) -> None:
    """Hold a file until the command ends, before any work: see `files.claim_file`.

    Raises:
        InputError: it is a folder, cannot be written, or another run holds it.
    """
    if os.path.isdir(out):
        raise InputError(f"{out}: is a folder: name a file with --out")
    for path in out.parents:
        if os.path.exists(path) and not os.path.isdir(path):
            raise InputError(f"{path}: is a file: name a folder with --out")
    context.with_resource(claim_file(out))


def load_effects(files: list[Path] | None) -> None:
    """Take a user's own effects into the vocabulary: files, or folders of them.

    Raises:
        InputError: see `hydrojax.effects.load_effects`; or a folder without any.
    """
    from hydrojax.effects import load_effects

    for path in files or ():
        load_effects(path)


def load_catalogue(folder: Path | None) -> None:
    """Take the effects of a catalogue into the vocabulary; it may be empty yet.

    Raises:
        InputError: it is no folder, or see `hydrojax.effects.load_effects`.
    """
    if folder is None:
        return
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file: name a folder with --catalogue")
    load_effects(sorted(folder.glob("*.py")))
