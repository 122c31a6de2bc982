"""The command that writes a rig for other tools: `export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hydrojax.cli.options import (
    Effects,
    RigPath,
    app,
    check_out,
    console,
    load_effects,
    show_progress,
)
from hydrojax.errors import InputError
from hydrojax.jax_setup import set_up_fits
from hydrojax.report.files import write_all


@app.command()
def export(
    context: typer.Context,
    rig: RigPath,
    to: Annotated[
        list[str],
        typer.Option(
            help="toml, json, mat, modelica, fmu (the plant), c (plant and "
            "controller): all words that follow.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the files.")] = Path(
        "hydrojax-export"
    ),
    effects: Effects = None,
) -> None:
    """Write a rig for MATLAB, Modelica, FMI or your own firmware."""
    check_out(context, out)
    set_up_fits()
    load_effects(effects)
    from hydrojax import export
    from hydrojax.rigfile.schema import RigFile

    with show_progress() as progress:
        progress("write the rig")
        spec = RigFile.load(rig)
        made = export.export(spec, to)
        for name in made.files:
            if (out / name).exists() and (out / name).samefile(rig):
                raise InputError(
                    f"{rig}: would be overwritten; name another folder with --out"
                )
        write_all(out, made.files)
    for note in made.notes:
        console.print(f"note: {note}", soft_wrap=True)
    console.print(f"{', '.join(made.files)} in {out}", soft_wrap=True)
