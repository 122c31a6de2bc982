"""The commands of the gains: `sweep` and `tune`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Column, Table

from hydrojax.cli.options import (
    At,
    Cluster,
    Effects,
    Gains,
    Out,
    RigPath,
    app,
    check_out,
    command_line,
    console,
    counted,
    load_effects,
    show_progress,
)
from hydrojax.cli.words import read_axes, read_gains, read_point
from hydrojax.errors import InputError, check_known
from hydrojax.jax_setup import LOOPS, set_up_jax, user_cache
from hydrojax.report.files import check_untouched, settle

if TYPE_CHECKING:
    from hydrojax.tune.aims import Aim as AnyAim
    from hydrojax.tune.result import Tuned


Over = Annotated[
    list[str],
    typer.Option(
        help="An axis, 1 to 4: k_p=0.2:4:48, load.mass=50 kg:300 kg:16, "
        "beta=5e8:1e9:9:log, v=0,0.01,0.02. All words that follow."
    ),
]
By = Annotated[
    list[str] | None,
    typer.Option(
        help="linear, multisine or noise: all words that follow.",
        show_default="linear",
    ),
]
Ensemble = Annotated[
    int, typer.Option(help="Number of plants, the rig among them.", min=1)
]
Spread = Annotated[
    float, typer.Option(help="Relative half-width of the ensemble.", min=0.0)
]
From = Annotated[
    Path | None,
    typer.Option(
        "--from",
        help="Folder written by identify or trace: its plant, and the spread of the "
        "ensemble.",
    ),
]
Frozen = Annotated[
    bool, typer.Option("--frozen", help="Measure with the adaptation frozen.")
]
Source = Annotated[
    Path,
    typer.Argument(
        help="Rig file, or a folder written by identify or trace.", show_default=False
    ),
]
SourceRig = Annotated[
    Path | None, typer.Option(help="Rig file, where the folder has none.")
]
Free = Annotated[
    list[str] | None,
    typer.Option(
        help="Gains to tune, as k_p k_f k_1 tau_d: all words that follow.",
        show_default="k_p k_f k_1, the rates of adaptation, and A_a where a load moves",
    ),
]
Aim = Annotated[
    str,
    typer.Option(help="What to maximise: following, magnitude, tracking or rejection."),
]
Tolerance = Annotated[
    float,
    typer.Option(
        help="Tolerance on |1 - F/F_d| in the band that follows; 1 is no force at all.",
        min=0.01,
        max=0.9,
    ),
]
Peak = Annotated[float, typer.Option(help="Limit on the resonance peak, dB.", min=0.1)]
Margin = Annotated[
    float, typer.Option(help="Limit on the sensitivity at the command, dB.", min=1.0)
]
Noise = Annotated[
    float,
    typer.Option(
        help="Limit on the command due to noise, RMS, as a share of its range.",
        min=1e-6,
    ),
]
Tracking = Annotated[
    float,
    typer.Option(
        help="Limit on the tracking error, joint moving, relative to before.", min=0.1
    ),
]
Controller = Annotated[
    list[str] | None,
    typer.Option(
        help="adaptive, fixed, pi, linearizing or backstepping: all words that follow. "
        "Several are compared, each in a folder of its own.",
        show_default="as in the rig file",
    ),
]
Starts = Annotated[int, typer.Option(help="Number of descents.", min=1)]


@app.command()
def sweep(
    context: typer.Context,
    rig: RigPath,
    over: Over,
    by: By = None,
    gains: Gains = None,
    at: At = None,
    ensemble: Ensemble = 1,
    spread: Spread = 0.2,
    report: From = None,
    frozen: Frozen = False,
    effects: Effects = None,
    cluster: Cluster = "",
    out: Out = Path("hydrojax-sweep"),
) -> None:
    """Map bandwidth over gains, plant, load, operating point.

    Axes are gains, bounds, and quantities of plant, load, signal path and operating
    point. Given again, the same command continues a sweep that was stopped, and does
    nothing where all is done.
    """
    check_out(context, out)
    set_up_jax(user_cache(), LOOPS)
    load_effects(effects)
    from hydrojax.rigfile.schema import RigFile
    from hydrojax.tune import api
    from hydrojax.tune.accessor import sentences
    from hydrojax.tune.report import write_sweep

    file = RigFile.load(rig)
    arguments: dict[str, Any] = {
        "axes": read_axes(over),
        "methods": by or ("linear",),
        "gains": read_gains(gains or ()),
        "at": read_point(at or ()),
        "plants": ensemble,
        "spread": spread,
        "findings": report and report.absolute(),
        "frozen": frozen,
    }
    with counted("sweep") as progress:
        if cluster:
            from hydrojax.workflows.fleet.sweeps import share_sweep

            share_sweep(file, arguments, effects or (), out, cluster, progress)
        data = api.sweep(file, **arguments, out=out, progress=progress)
    write_sweep(data, out, command_line(context))
    for line in sentences(data):
        console.print(line)
    console.print(f"report in {out / 'report.html'}, numbers in {out / 'sweep.nc'}")


@app.command()
def tune(
    context: typer.Context,
    source: Source,
    rig: SourceRig = None,
    free: Free = None,
    at: At = None,
    objective: Aim = "following",
    tolerance: Tolerance = 0.2,
    ensemble: Ensemble = 8,
    spread: Spread = 0.2,
    peak: Peak = 3.0,
    margin: Margin = 6.0,
    noise: Noise = 0.01,
    tracking: Tracking = 1.0,
    starts: Starts = 2,
    controller: Controller = None,
    effects: Effects = None,
    out: Out = Path("hydrojax-tune"),
) -> None:
    """Find the gains with which the force follows best.

    Gains are proposed only if they hold in simulated runs on every plant. Where none do
    (with several controllers: for none of them), what stands in the way is printed, and
    the exit status is 1.
    """
    check_out(context, out)
    set_up_jax(user_cache(), LOOPS)
    load_effects(effects)
    from hydrojax.rigfile.controller import KINDS
    from hydrojax.tune import api
    from hydrojax.tune.aims import Limits

    limits = Limits(peak_dB=peak, sensitivity_dB=margin, noise=noise, tracking=tracking)
    folder = source if os.path.isdir(source) else None
    kinds = list(dict.fromkeys(controller or [""]))
    check_known("--controller:", [k for k in kinds if k], KINDS, "controller")
    folders = {kind: out / kind if len(kinds) > 1 else out for kind in kinds}
    for own in folders.values():
        check_untouched(own)
    found: dict[str, Tuned] = {}
    with show_progress() as progress:
        for kind in kinds:
            found[kind] = api.tune_gains(
                _rig_of(source, rig),
                free or (),
                limits,
                at=read_point(at or ()),
                aim=_aim(objective, tolerance),
                plants=ensemble,
                spread=spread,
                findings=folder,
                starts=starts,
                controller=kind,
                progress=lambda line, kind=kind: progress(f"{kind} {line}".strip()),
            )
            progress("draw")
            found[kind].save(folders[kind], command_line(context))
    _print_found(found, out)
    if all(tuned.obstacles for tuned in found.values()):
        raise typer.Exit(1)


def _print_found(found: Mapping[str, Tuned], out: Path) -> None:
    """What was found with one controller, or with several side by side."""
    if len(found) > 1:
        _print_all(found, out)
        return
    for tuned in found.values():
        _print(tuned)
    console.print(f"tune.json, rig.toml and report.html in {out}")


def _print_all(found: Mapping[str, Tuned], out: Path) -> None:
    """Controllers side by side, and what stands in a controller's way."""
    from hydrojax.tune.comparison import FIGURES, compare_controllers

    table = Table(Column("controller", no_wrap=True), "held", *FIGURES.values())
    for row in compare_controllers(found).itertuples():
        name, proposed, *figures = row
        cells = (f"{float(value):.1f}" for value in figures)
        table.add_row(str(name), "yes" if proposed else "no", *cells)
    console.print(table)
    for name, tuned in found.items():
        for line in tuned.obstacles:
            console.print(f"- {name}: {line}")
    console.print(f"figures of the worst plant; a folder for each controller in {out}")


def _aim(word: str, tolerance: float) -> AnyAim:
    """The aim of a word."""
    from hydrojax.tune import aims

    known = {kind.word: kind for kind in aims.AIMS}
    check_known("--objective:", [word], known, "objective")
    if word == aims.Following.word:
        return aims.Following(tolerance)
    return known[word]()


def _print(tuned: Tuned) -> None:
    """The gains before and after, what they give, and what limits them."""
    from hydrojax.tune import display

    console.print(display.sentence(tuned))
    if not tuned.obstacles:
        heads, *rows = display.gains_table(tuned)
        table = Table(*heads)
        for row in rows:
            table.add_row(*row)
        console.print(table)
    console.print(display.limit(tuned))
    for line in tuned.notes:
        console.print(f"- {line}")


def _rig_of(source: Path, rig: Path | None) -> Path:
    """The rig file: the source itself, or that of a folder of identify or trace."""
    if not os.path.isdir(source):
        if rig is None:
            return source
        raise InputError(
            f"--rig: only beside a folder of identify or trace; {source} is a rig file "
            "itself: name one of the two"
        )
    if rig is not None:
        return rig
    settle(source)
    if (source / "rig.toml").exists():
        return source / "rig.toml"
    raise InputError(
        f"{source}: no rig.toml in it; name the rig file that was traced with --rig"
    )
