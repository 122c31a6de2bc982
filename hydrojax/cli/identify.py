"""The commands on logs: `check`, `identify`, `trace`, `demo`."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from hydrojax.cli.options import (
    Effects,
    Horizon,
    Level,
    Logs,
    Matters,
    Out,
    Profile,
    RigPath,
    app,
    check_out,
    console,
    load_effects,
    show_progress,
)
from hydrojax.jax_setup import set_up_jax, user_cache

if TYPE_CHECKING:
    from hydrojax.identify.result import Result
    from hydrojax.identify.results.outcome import Outcome

Validate = typer.Option(
    help="Logs that take no part in the fit: all words that follow."
)
Test = typer.Option(
    help="Logs that take part in no decision: all words that follow. Errors before and "
    "after are then theirs.",
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
        Path | None, typer.Option(help="Folder for a page and a table.")
    ] = None,
    effects: Effects = None,
) -> None:
    """Say what the logs hold, and which inputs look wrong: signs, units, factors."""
    if out is not None:
        check_out(context, out)
    set_up_jax(user_cache())
    load_effects(effects)
    from hydrojax import api

    with show_progress():
        found = api.check(rig, logs)
    console.print(found.summary(), markup=False, soft_wrap=True, end="")
    if out is not None:
        found.save(out)
        console.print(f"\npage in {out / 'check.html'}", markup=False)


@app.command()
def identify(
    context: typer.Context,
    rig: RigPath,
    logs: Logs,
    validate: Annotated[list[Path] | None, Validate] = None,
    test: Annotated[list[Path] | None, Test] = None,
    out: Out = Path("hydrojax-identify"),
    horizon: Horizon = 0.25,
    starts: Annotated[int, typer.Option(help="Number of starts.", min=1)] = 4,
    profile: Profile = False,
    effects: Effects = None,
) -> None:
    """Fit the declared model to logs; report errors and parameter uncertainties."""
    check_out(context, out)
    set_up_jax(user_cache())
    load_effects(effects)
    from hydrojax import api

    with show_progress() as progress:
        result = api.fit(
            rig, logs, validate or (), test or (), horizon=horizon, starts=starts,
            profile=profile, progress=progress,
        )  # fmt: skip
    _finish(result, out)


@app.command()
def trace(
    context: typer.Context,
    rig: RigPath,
    logs: Logs,
    validate: Annotated[list[Path], Validate],
    test: Annotated[list[Path] | None, Test] = None,
    out: Out = Path("hydrojax-trace"),
    horizon: Horizon = 0.25,
    starts: Annotated[int, typer.Option(help="Number of starts.", min=1)] = 1,
    matters: Matters = 0.02,
    level: Level = 0.01,
    profile: Profile = False,
    effects: Effects = None,
) -> None:
    """Close the loop: fit, residual, the effect behind it, refit, before and after."""
    check_out(context, out)
    set_up_jax(user_cache())
    load_effects(effects)
    from hydrojax import api
    from hydrojax.identify.tracing.criteria import Criteria

    with show_progress() as progress:
        result = api.trace(
            rig, logs, validate, test or (), horizon=horizon, starts=starts,
            criteria=Criteria(matters=matters, level=level), profile=profile,
            progress=progress,
        )  # fmt: skip
    _finish(result, out)


@app.command()
def demo(context: typer.Context, out: Out = Path("hydrojax-demo")) -> None:
    """Run `trace` on a rig and logs that come with the package."""
    folder = resources.files("hydrojax") / "demo"
    with resources.as_file(folder) as here:
        console.print("trace of the demo rig: two logs to fit, one to check\n")
        logs = [here / "fit_1.csv.gz", here / "fit_2.csv.gz"]
        trace(context, here / "rig.toml", logs, [here / "validate.csv.gz"], out=out)


def _finish(result: Result, out: Path) -> None:
    """Write the report and print its summary."""
    result.save(out)
    print_outcome(result.outcome)
    spent = result.outcome.seconds
    console.print(
        f"\ncompile {spent['compile']:.1f} s, run {spent['run']:.1f} s; "
        f"report in {out / 'report.html'}",
        markup=False,
    )


def print_outcome(outcome: Outcome) -> None:
    """Print verdict, errors by channel, effects and remarks."""
    from hydrojax.identify.results.outcome import skill_text
    from hydrojax.report.text import quantity_text

    console.print(outcome.verdict, style="bold", end="  ")
    console.print(f"{outcome.sentence}\n", markup=False)
    table = Table("channel", "noise", "before", "after", "after / noise", "skill")
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
        console.print(f"{effect.name}: {found}{alike}", markup=False)
    says = (f"{f.input}: {f.says}" for f in outcome.inputs[1:])
    for line in (*says, *outcome.limits, *outcome.notes):
        console.print(f"- {line}", markup=False)
