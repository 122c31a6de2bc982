"""The commands on logs: `check`, `identify`, `trace`, `demo`."""

from __future__ import annotations

from collections.abc import Collection
from importlib import resources
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

from hydrojax.cli.options import (
    Catalogue,
    Discover,
    Effects,
    FailOn,
    Horizon,
    Json,
    Level,
    Logs,
    Matters,
    Out,
    Profile,
    Quiet,
    RigPath,
    app,
    check_out,
    check_report,
    check_verdicts,
    command_line,
    console,
    load_catalogue,
    load_effects,
    show_progress,
)
from hydrojax.jax_setup import set_up_fits

if TYPE_CHECKING:
    from hydrojax.api import Progress
    from hydrojax.identify.result import Result
    from hydrojax.identify.results.outcome import Outcome

Validate = typer.Option(
    help="Logs that take no part in the fit: all words that follow."
)
Test = typer.Option(
    help="Logs that take part in no decision: all words that follow. The errors "
    "reported are then those on them.",
)


@app.command()
def check(
    context: typer.Context,
    rig: RigPath,
    logs: Annotated[
        list[Path],
        typer.Argument(
            help="Logs of the rig: CSV(.gz), Parquet, MAT, Excel, TDMS, MCAP or a "
            "ROS 2 bag's folder.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder for check.html and check.json.")
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
    effects: Effects = None,
) -> None:
    """Report what the logs contain, and which inputs look wrong.

    Wrong signs, exchanged channels, units, areas and stated noise are found in seconds,
    before any fit.
    """
    if out is not None:
        check_out(context, out)
    set_up_fits()
    load_effects(effects)
    from hydrojax import api

    with show_progress(quiet):
        found = api.check(rig, logs)
    if out is not None:
        found.save(out, command_line(context))
    if json:
        print_json(found.to_dict())
    if json or quiet:
        return
    console.print(found.summary(), soft_wrap=True, end="")
    if out is not None:
        console.print(f"\npage in {out / 'check.html'}")


@app.command()
def identify(
    context: typer.Context,
    rig: RigPath,
    logs: Logs,
    validate: Annotated[list[Path] | None, Validate] = None,
    test: Annotated[list[Path] | None, Test] = None,
    out: Out = Path("hydrojax-identify"),
    horizon: Horizon = 0.25,
    starts: Annotated[
        int, typer.Option(help="Number of starts of the fit.", min=1)
    ] = 4,
    profile: Profile = False,
    effects: Effects = None,
    json: Json = False,
    quiet: Quiet = False,
    fail_on: FailOn = None,
) -> None:
    """Fit the declared model to logs; report errors, uncertainties."""
    failing = check_verdicts(fail_on)
    check_report(context, out)
    set_up_fits()
    load_effects(effects)
    from hydrojax import api

    with show_progress(quiet) as progress:
        result = api.fit(
            rig, logs, validate or (), test or (), horizon=horizon, starts=starts,
            profile=profile, progress=progress,
        )  # fmt: skip
    _finish(context, result, out, json, quiet, failing)


@app.command()
def trace(
    context: typer.Context,
    rig: RigPath,
    logs: Logs,
    validate: Annotated[list[Path], Validate],
    test: Annotated[list[Path] | None, Test] = None,
    out: Out = Path("hydrojax-trace"),
    horizon: Horizon = 0.25,
    starts: Annotated[
        int, typer.Option(help="Number of starts of the fit.", min=1)
    ] = 1,
    matters: Matters = 0.02,
    level: Level = 0.01,
    profile: Profile = False,
    discover: Discover = False,
    catalogue: Catalogue = None,
    effects: Effects = None,
    json: Json = False,
    quiet: Quiet = False,
    fail_on: FailOn = None,
) -> None:
    """Fit, find the effects that the model lacks, and refit."""
    failing = check_verdicts(fail_on)
    check_report(context, out)
    set_up_fits()
    load_effects(effects)
    load_catalogue(catalogue)
    from hydrojax import api
    from hydrojax.identify.tracing.criteria import Criteria

    with show_progress(quiet) as progress:
        result = api.trace(
            rig, logs, validate, test or (), horizon=horizon, starts=starts,
            criteria=Criteria(matters=matters, level=level), profile=profile,
            progress=progress, early=lambda now: now.save(out, command_line(context)),
        )  # fmt: skip
        if discover and result.verdict == "unknown":
            result = _discovered(context, result, out, starts, profile, progress)
    _finish(context, result, out, json, quiet, failing, catalogue)


@app.command()
def demo(context: typer.Context, out: Out = Path("hydrojax-demo")) -> None:
    """Run `trace` on a rig and logs that come with the package."""
    folder = resources.files("hydrojax") / "demo"
    with resources.as_file(folder) as here:
        console.print("trace of the demo rig: two logs to fit, one to check\n")
        logs = [here / "fit_1.csv.gz", here / "fit_2.csv.gz"]
        trace(context, here / "rig.toml", logs, [here / "validate.csv.gz"], out=out)


def _discovered(
    context: typer.Context,
    result: Result,
    out: Path,
    starts: int,
    profile: bool,
    progress: Progress,
) -> Result:
    """The trace with curves for what it left, traced again with them as effects."""
    from hydrojax import api
    from hydrojax.identify.report.write import effects_path

    result.save(out, command_line(context))  # curves take minutes, and may be stopped
    result = api.discover(result, progress=progress)
    if not result.curves:
        return result
    result.save(out, command_line(context))
    load_effects([effects_path(out, result.curves)])
    return api.retraced(result, starts, profile, progress)


def _finish(
    context: typer.Context,
    result: Result,
    out: Path,
    json: bool,
    quiet: bool,
    failing: Collection[str],
    catalogue: Path | None = None,
) -> None:
    """Write the report, add to the catalogue and print a summary; leave with 1 on a
    failing verdict.
    """
    result.save(out, command_line(context))
    kept = result.keep(catalogue) if catalogue is not None else None
    outcome = result.outcome
    if json:
        print((out / "report.json").read_text(encoding="utf-8"), end="")
    elif not quiet:
        print_outcome(outcome, out)
        spent = outcome.seconds
        console.print(
            f"\ncompile {spent['compile']:.1f} s, run {spent['run']:.1f} s; "
            f"report in {out / 'report.html'}" + (f", kept in {kept}" if kept else ""),
            soft_wrap=True,
        )
    if outcome.verdict in failing:
        raise typer.Exit(1)


def print_json(content: object) -> None:
    """Print a result for other programs."""
    print(dumps(content, indent=1, allow_nan=False, ensure_ascii=False))


def print_outcome(outcome: Outcome, out: Path = Path()) -> None:
    """Print verdict, errors by channel, effects and remarks of what was written to a
    folder.
    """
    from hydrojax.identify.report.write import effects_path
    from hydrojax.identify.results.outcome import skill_text
    from hydrojax.report.text import quantity_text

    said = Text.assemble((outcome.verdict, "bold"), "  ", outcome.sentence, "\n")
    console.print(said)
    of = "errors of the test logs, in no decision" if outcome.test_logs else None
    heads = ("channel", "noise", "before", "after", "after / noise", "skill")
    table = Table(*heads, caption=of)
    for name, c in outcome.channels.items():
        table.add_row(
            name,
            *(quantity_text(v, c.unit) for v in (c.noise, c.before, c.after)),
            f"{c.after / c.noise:.3f}",
            skill_text(c.window),
        )
    console.print(table)
    for effect in outcome.effects:
        found = ", ".join(
            f"{n} = {quantity_text(p.value, p.unit, p.std)}"
            for n, p in effect.parameters.items()
        )
        alike = (
            f"; not distinguishable from {', '.join(effect.cannot_tell_from)}"
            if effect.cannot_tell_from
            else ""
        )
        console.print(f"{effect.name}: {found}{alike}")
    for c in outcome.curves:
        console.print(
            f"{c.name}: {100 * c.share:.0f} % of the excess, "
            f"{c.law or 'no formula does as well as the curve'}; "
            f"in {effects_path(out, outcome.curves).name}"
        )
    says = (f.says for f in outcome.inputs[1:])
    for line in (*says, *outcome.limits, *outcome.notes):
        console.print(f"- {line}")
