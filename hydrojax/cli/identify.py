"""The commands that fit: `identify`, `trace`, `demo`."""

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
    from hydrojax.identify.results.outcome import Outcome


@app.command()
def identify(
    rig: RigPath,
    logs: Logs,
    validate: Annotated[
        list[Path] | None,
        typer.Option(help="Logs that take no part in the fit."),
    ] = None,
    out: Out = Path("hydrojax-identify"),
    horizon: Horizon = 0.25,
    starts: Annotated[
        int, typer.Option(help="Number of starts of the fit.", min=1)
    ] = 4,
    profile: Profile = False,
    effects: Effects = None,
) -> None:
    """Fit the declared model to logs; report errors and parameter uncertainties."""
    check_out(out)
    set_up_jax(user_cache())
    load_effects(effects)
    from hydrojax.identify import api
    from hydrojax.identify.case import open_case

    with show_progress() as progress:
        case = open_case(rig, logs, validate or (), horizon)
        outcome = api.identify(case, starts, progress, profile)
    _finish(outcome, out)


@app.command()
def trace(
    rig: RigPath,
    logs: Logs,
    validate: Annotated[
        list[Path],
        typer.Option(help="Logs that take no part in the fit."),
    ],
    out: Out = Path("hydrojax-trace"),
    horizon: Horizon = 0.25,
    starts: Annotated[
        int, typer.Option(help="Number of starts of the fit.", min=1)
    ] = 1,
    matters: Matters = 0.02,
    level: Level = 0.01,
    profile: Profile = False,
    effects: Effects = None,
) -> None:
    """Close the loop: fit, residual, the effect behind it, refit, before and after."""
    _trace(rig, logs, validate, out, horizon, starts, matters, level, profile, effects)


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
    profile: bool = False,
    effects: list[Path] | None = None,
) -> None:
    check_out(out)
    set_up_jax(user_cache())
    load_effects(effects)
    from hydrojax.identify import api
    from hydrojax.identify.case import open_case
    from hydrojax.identify.tracing.criteria import Criteria

    criteria = Criteria(matters=matters, level=level)
    with show_progress() as progress:
        case = open_case(rig, logs, validate, horizon=horizon, criteria=criteria)
        outcome = api.trace_case(case, starts, progress, profile)
    _finish(outcome, out)


def _finish(outcome: Outcome, out: Path) -> None:
    """Write the report and print its summary."""
    from hydrojax.identify.report.write import write_report
    from hydrojax.report.text import quantity

    write_report(outcome, out)
    console.print(outcome.verdict, style="bold", end="  ")
    console.print(f"{outcome.sentence}\n", markup=False)
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
            f"; not distinguishable from {', '.join(effect.cannot_tell_from)}"
            if effect.cannot_tell_from
            else ""
        )
        console.print(f"{effect.name}: {found}{alike}", markup=False)
    for line in (*outcome.limits, *outcome.notes):
        console.print(f"- {line}", markup=False)
    spent = outcome.seconds
    console.print(
        f"\ncompile {spent['compile']:.1f} s, run {spent['run']:.1f} s; "
        f"report in {out / 'report.html'}",
        markup=False,
    )
