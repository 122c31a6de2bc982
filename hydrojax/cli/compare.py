"""The command that sets two reports side by side: `compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Column, Table

from hydrojax.cli.identify import print_json
from hydrojax.cli.options import Json, app, check_out, command_line, console
from hydrojax.report.files import write_all


@app.command()
def compare(
    context: typer.Context,
    a: Annotated[
        Path,
        typer.Argument(help="Folder written by identify or trace.", show_default=False),
    ],
    b: Annotated[Path, typer.Argument(help="Another such folder.", show_default=False)],
    out: Annotated[Path | None, typer.Option(help="Folder for compare.html.")] = None,
    json: Json = False,
) -> None:
    """Compare two reports: verdicts, errors, effects, parameters."""
    if out is not None:
        check_out(context, out)
    from hydrojax.report.compare import Comparison
    from hydrojax.report.compare import compare as compared

    found: Comparison = compared(a, b)
    if out is not None:
        write_all(out, {"compare.html": found.html(command_line(context)).encode()})
    if json:
        print_json(found.to_dict())
        return
    for name, rig, verdict in zip(found.names, found.rigs, found.verdicts, strict=True):
        console.print(f"{name}: {rig}, {verdict}")
    if not found.same_logs:
        console.print("judged on different logs: errors do not compare")
    errors = Table("error after", *found.names, "change")
    for pair in found.channels:
        errors.add_row(pair.name, pair.text("a"), pair.text("b"), pair.change)
    console.print(errors)
    for name, *there in found.effects:
        where = [n for n, yes in zip(found.names, there, strict=True) if yes]
        console.print(f"{name}: found in {' and '.join(where)}")
    named = Column("parameter", overflow="fold")
    table = Table(named, *found.names, "change", "change / std")
    for pair in found.parameters:
        apart = "–" if pair.apart is None else f"{pair.apart:.1f}"
        table.add_row(pair.name, pair.text("a"), pair.text("b"), pair.change, apart)
    console.print(table)
    console.print("std: the difference over its standard deviation")
    if out is not None:
        console.print(f"page in {out / 'compare.html'}")
