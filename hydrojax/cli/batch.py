"""The command over many logs: `batch`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hydrojax.cli.options import (
    Cluster,
    Effects,
    Horizon,
    Level,
    Matters,
    Out,
    Profile,
    app,
    check_out,
    command_line,
    console,
    counted,
    errors,
    load_effects,
)
from hydrojax.errors import InputError
from hydrojax.jax_setup import set_up_fits

if TYPE_CHECKING:
    from hydrojax.workflows.fleet.work import Options

Jobs = Annotated[
    Path,
    typer.Argument(
        help="Table (CSV, Parquet) with columns rig, fit and validate (several logs "
        "are separated by ;), optionally job, and any labels; or a folder of folders, "
        "each with rig.toml, fit*, validate*.",
        show_default=False,
    ),
]
Workers = Annotated[
    int,
    typer.Option(help="Worker processes.", min=0, show_default="one per core"),
]
Starts = Annotated[
    int,
    typer.Option(
        help="Number of starts of each fit.",
        min=0,
        show_default="the command's own",
    ),
]
JobSeconds = Annotated[
    float, typer.Option(help="Time that one job may take, s.", min=1.0)
]
JobMemory = Annotated[
    float, typer.Option(help="Memory that one job may take, GiB.", min=0.1)
]


@app.command()
def batch(
    context: typer.Context,
    jobs: Jobs,
    out: Out = Path("hydrojax-batch"),
    command: Annotated[str, typer.Option(help="identify or trace.")] = "trace",
    workers: Workers = 0,
    cluster: Cluster = "",
    horizon: Horizon = 0.25,
    starts: Starts = 0,
    matters: Matters = 0.02,
    level: Level = 0.01,
    profile: Profile = False,
    job_seconds: JobSeconds = 3600.0,
    job_memory: JobMemory = 8.0,
    effects: Effects = None,
) -> None:
    """Identify or trace a fleet of logs: one table, one report.

    Given again, the same command continues a fleet that was stopped, and does nothing
    where all is done. A bad log fails on its own; the rest continue, and the exit
    status is 1.
    """
    check_out(context, out)
    if command not in ("identify", "trace"):
        raise InputError(f"invalid --command {command!r}: expected identify or trace")
    set_up_fits()
    load_effects(effects)
    from hydrojax.workflows.fleet.local import JobLimits
    from hydrojax.workflows.fleet.merged import named
    from hydrojax.workflows.fleet.run import Stopped, run_fleet

    options = _options(
        command=command, horizon=horizon, starts=starts, matters=matters, level=level,
        profile=profile, effects=tuple(map(str, effects or ())),
    )  # fmt: skip
    try:
        with counted(command) as progress:
            ran = run_fleet(
                jobs, out, options, workers, cluster, progress,
                limits=JobLimits(job_seconds, job_memory * 2**30),
                command_line=command_line(context),
            )  # fmt: skip
    except Stopped as stop:
        errors.print(
            f"hydrojax: stopped: {stop}; give the same command again to go on",
            style=None, soft_wrap=True,
        )  # fmt: skip
        raise typer.Exit(130) from None
    what = f"{ran.jobs} jobs, {ran.done} done now"
    console.print(f"{what}, {ran.failed} failed" if ran.failed else what)
    for line in named(out, 20):
        console.print(line, soft_wrap=True)
    console.print(f"fleet.html and fleet.parquet in {out}")
    if ran.failed:
        raise typer.Exit(1)


def _options(**given: Any) -> Options:
    """How every job is done.

    Raises:
        InputError: a number that is not finite.
    """
    from pydantic import ValidationError

    from hydrojax.workflows.fleet.work import Options

    try:
        return Options(**given)
    except ValidationError as error:
        first = error.errors()[0]
        says = first["msg"].removeprefix("Input should be ")
        raise InputError(
            f"invalid --{first['loc'][0]} {first['input']!r}: expected {says}"
        ) from error
