"""The commands of the closed loop: `simulate`, `excite`, `bounds`, `paper`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from hydrojax.cli.options import (
    Effects,
    Gains,
    Logs,
    Out,
    RigPath,
    app,
    check_file,
    check_out,
    check_report,
    console,
    load_effects,
    show_progress,
)
from hydrojax.cli.words import read_gains
from hydrojax.errors import InputError
from hydrojax.jax_setup import LOOPS, set_up_fits, set_up_jax, user_cache
from hydrojax.report.files import digest, write_all

if TYPE_CHECKING:
    from hydrojax.identify.design import Design


@app.command()
def simulate(
    context: typer.Context,
    rig: RigPath,
    gains: Gains = None,
    reference: Annotated[
        str,
        typer.Option(
            help="Desired force: sines:400 N, sine:300 N,0.5 Hz, noise:200 N,50 Hz, or "
            "a log with F_d."
        ),
    ] = "sines",
    motion: Annotated[
        str,
        typer.Option(
            help="Motion of the piston, or of what its load is attached to: "
            "wander:25 mm/s, to-and-fro:3 cm/s,3 s, locked, or a log."
        ),
    ] = "wander",
    seconds: Annotated[float, typer.Option(help="Length of the run, s.")] = 12.0,
    seed: Annotated[
        int, typer.Option(help="Seed of noise and random motion.", min=0)
    ] = 0,
    out: Annotated[
        Path, typer.Option(help="File for the log: CSV(.gz), Parquet or MAT.")
    ] = Path("hydrojax-simulate.csv"),
    effects: Effects = None,
) -> None:
    """Run a rig in closed loop, and write the log."""
    check_file(context, out)
    set_up_jax(user_cache(), LOOPS)
    load_effects(effects)
    import warnings

    from hydrojax.cli.scenario import read_inputs
    from hydrojax.rigfile import recording
    from hydrojax.rigfile.schema import RigFile
    from hydrojax.workflows import simulation

    recording.check_kind(out)
    spec = RigFile.load(rig)
    with show_progress() as progress:
        progress("run the closed loop")
        force, path = read_inputs(spec, reference, motion)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # is among the notes
            run = simulation.simulate(
                spec, reference=force, motion=path, seconds=seconds, seed=seed,
                gains=read_gains(gains or []), out=out,
            )  # fmt: skip
    for line in run.notes:
        console.print(f"warning: {line}")
    console.print(
        f"{run.t.size} samples in {out}; F_d - F {run.rms_error:.3g} N RMS after the "
        f"first quarter; command saturated in {100 * run.saturated:.1f} % of them",
    )


Separate = Annotated[
    list[str] | None,
    typer.Option(help="Two effects to distinguish: both words that follow."),
]


@app.command()
def excite(
    context: typer.Context,
    rig: RigPath,
    separate: Separate = None,
    force: Annotated[str, typer.Option(help="Largest desired force.")] = "800 N",
    speed: Annotated[str, typer.Option(help="Largest speed.")] = "25 mm/s",
    travel: Annotated[
        str, typer.Option(help="Largest distance from mid-stroke.")
    ] = "20 mm",
    seconds: Annotated[
        float, typer.Option(help="Length of the run, s.", min=1.0, max=60.0)
    ] = 8.0,
    out: Annotated[
        Path,
        typer.Option(
            help="File for the reference and motion: CSV(.gz), Parquet or MAT."
        ),
    ] = Path("hydrojax-excite.csv"),
    effects: Effects = None,
) -> None:
    """Design the run that best identifies what is not identified."""
    check_file(context, out)
    set_up_fits()
    load_effects(effects)
    from hydrojax import units
    from hydrojax.identify.design import design
    from hydrojax.identify.experiment import ExcitationLimits
    from hydrojax.rigfile import recording
    from hydrojax.rigfile.schema import RigFile

    recording.check_kind(out)
    spec = RigFile.load(rig)
    both = [name for word in separate or [] for name in word.split(",")]
    if both and len(both) != 2:
        raise InputError(f"--separate {' '.join(both)}: name two effects")
    most = [
        units.quantity(text, unit, f"--{name}")
        for name, text, unit in (
            ("force", force, "N"), ("speed", speed, "m/s"), ("travel", travel, "m"),
        )
    ]  # fmt: skip
    if min(most) <= 0:
        raise InputError("--force, --speed and --travel must be above 0")
    with show_progress() as progress:
        limits = ExcitationLimits(*most, seconds=seconds)
        found = design(spec, limits, both, progress=progress)
    recording.write_log(
        out, recording.scenario_columns(found.t, found.F_d, found.x, spec)
    )
    _print_design(found, "smallest size shown" if both else "standard deviation")
    console.print(f"reference and motion in {out}: simulate --reference and --motion")


def _print_design(found: Design, what: str) -> None:
    """What the designed run tells of each parameter, beside the undesigned one."""
    from hydrojax.report.text import quantity_text

    table = Table(what, "undesigned", "designed", "times better")
    for name, before in found.before.items():
        after, unit = found.after[name], found.units[name]
        sizes = (quantity_text(size, unit) for size in (before, after))
        table.add_row(name, *sizes, f"{before / after:.2g}")
    console.print(table)


@app.command()
def bounds(
    context: typer.Context,
    rig: RigPath,
    logs: Logs,
    validate: Annotated[
        list[Path] | None,
        typer.Option(
            help="Logs kept out of the fits, to judge by: all words that follow."
        ),
    ] = None,
    out: Out = Path("hydrojax-bounds"),
    confidence: Annotated[
        float,
        typer.Option(
            help="Confidence that the box contains the next fit.", min=0.5, max=0.999
        ),
    ] = 0.95,
    stretch: Annotated[
        float, typer.Option(help="Length of log that each fit takes, s.", min=0.5)
    ] = 2.0,
    effects: Effects = None,
) -> None:
    """Find friction bounds for the adaptive law from many fits."""
    check_report(context, out)
    set_up_fits()
    load_effects(effects)
    import json

    from hydrojax.identify.case import open_case
    from hydrojax.identify.report.figures import png
    from hydrojax.workflows.bounds_report import bounds_figure, content
    from hydrojax.workflows.friction_bounds import friction_bounds

    with show_progress() as progress:
        case = open_case(rig, logs, validate or ())
        found = friction_bounds(case, confidence, stretch, progress)
        figure = bounds_figure(found)
    rig_toml = found.rig_file.encode()
    record = content(found) | {"rig_toml_sha256": digest(rig_toml)}
    files = {
        "rig.toml": rig_toml,
        "bounds.json": (json.dumps(record, indent=1) + "\n").encode(),
        "bounds.png": png(figure),
    }
    write_all(out, files)
    table = Table(
        "F_d - F, N RMS", "plants fitted", "plants that took no part", "stretches held"
    )
    for way, error in found.fitted.items():
        other = f"{found.others[way]:.3g}" if found.others else "-"
        held = f"{100 * found.coverage[way]:.0f} %"
        table.add_row(f"{way} bounds", f"{error:.3g}", other, held)
    console.print(table)
    console.print(
        f"{len(found.fits)} stretches of {found.fits[0].seconds:.3g} s; rig.toml with "
        f"the {found.proposed} bounds, bounds.json and bounds.png in {out}"
    )


@app.command()
def paper(context: typer.Context, out: Out = Path("hydrojax-paper")) -> None:
    """Repeat the paper's experiments, figures 2 to 5."""
    check_out(context, out)
    set_up_jax(user_cache(), LOOPS)
    import json

    from hydrojax.identify.report.figures import png
    from hydrojax.paper import contents
    from hydrojax.paper.figures import paper_figures

    with show_progress() as progress:
        found = contents.experiments(progress)
        progress("draw")
        drawn = paper_figures(found)
        content = contents.paper_json(found)
    files = {f"{name}.png": png(figure) for name, figure in drawn.items()}
    files["paper.json"] = (json.dumps(content, indent=1) + "\n").encode()
    write_all(out, files)
    table = Table("RMS, N", "a", "b", "c", "d", "the paper says")
    for name in ("fig2", "fig3", "fig4"):
        figures = (
            f"{v:.0f}" if v >= 1000 else f"{v:.3g}" for v in content[name].values()
        )
        table.add_row(name, *figures, contents.PAPER_SAYS[name])
    console.print(table)
    for line in contents.lines(content):
        console.print(line)
    table = Table("reading", "2 (b), N", "2 (c), N", "Fig. 5 within 1 dB")
    for name, row in content["readings"].items():
        edge = contents.edge(row["within_1dB"])
        table.add_row(name, f"{row['fig2_b']:.1f}", f"{row['fig2_c']:.1f}", edge)
    console.print(table)
    console.print(f"pictures and paper.json in {out}")
