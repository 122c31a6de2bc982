"""The command that drafts a rig file: `init`."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from hydrojax.cli.options import app
from hydrojax.errors import InputError

QUESTIONS = {
    "bore": "Bore (diameter of the piston), such as 40 mm",
    "rod": "Rod diameter, such as 25 mm; 0 mm if both areas are equal",
    "stroke": "Stroke between the stops, such as 300 mm",
    "radius": "Radius at which the cylinder acts on the joint, such as 85 mm",
    "rated_flow": "Rated flow at 35 bar over each edge, such as 40 L/min; empty if you "
    "do not know it",
}


def _asked(size: str, said: Mapping[str, str]) -> str:
    """A size as it is answered at the terminal; asked again until it is one."""
    from hydrojax.rigfile.draft.sizes import read_sizes

    def read(answer: str) -> str:
        try:
            read_sizes(**said, **({size: answer} if answer else {}))
        except InputError as error:
            raise typer.BadParameter(str(error)) from None
        return answer

    default = "" if size == "rated_flow" else None
    return typer.prompt(
        QUESTIONS[size], default, value_proc=read, show_default=False, err=True
    )


def _schema(wanted: bool) -> None:
    if wanted:
        from hydrojax.rigfile.json_schema import rig_schema

        print(json.dumps(rig_schema(), indent=1))
        raise typer.Exit


Bore = Annotated[str, typer.Option(help="Diameter of the piston, as 40 mm.")]
Rod = Annotated[
    str,
    typer.Option(help="Diameter of the rod, as 25 mm; 0 mm where the areas are equal."),
]
Stroke = Annotated[str, typer.Option(help="Travel between the stops, as 300 mm.")]
Radius = Annotated[
    str, typer.Option(help="Lever arm, where the log has an angle, as 85 mm.")
]
RatedFlow = Annotated[
    str,
    typer.Option(
        help="Flow of the open valve at 35 bar over each edge, as 40 L/min.",
        show_default="estimated from the log",
    ),
]
Supply = Annotated[
    str,
    typer.Option(
        help="Supply pressure, where the log has none.",
        show_default="140 bar",
    ),
]
Layout = Annotated[
    str,
    typer.Option(
        help="pull-pull, differential, single, driven-axis or tester.",
        show_default="from columns and rod",
    ),
]
Columns = Annotated[
    list[str] | None,
    typer.Option(help="Columns by signal, as u=MainU: all words that follow."),
]


@app.command()
def init(
    logs: Annotated[
        list[Path],
        typer.Argument(help="Logs of one rig and one logger.", show_default=False),
    ],
    bore: Bore = "",
    rod: Rod = "",
    stroke: Stroke = "",
    radius: Radius = "",
    rated_flow: RatedFlow = "",
    supply: Supply = "",
    layout: Layout = "",
    column: Columns = None,
    name: Annotated[
        str, typer.Option(help="Name of the rig.", show_default="the log's")
    ] = "",
    schema: Annotated[
        bool,
        typer.Option(
            "--schema",
            callback=_schema,
            is_eager=True,
            help="Print the JSON schema of rig files, for editors, and exit.",
        ),
    ] = False,
) -> None:
    """Draft a commented rig file from logs.

    It is printed: hydrojax init LOG... > rig.toml. Columns, units and signs are
    guessed, and marked CHECK where they are not certain. At a terminal, sizes that are
    not given are asked for.
    """
    from hydrojax.cli.words import read_columns
    from hydrojax.rigfile.draft import sizes as known
    from hydrojax.rigfile.draft.write import drafted, read_log
    from hydrojax.rigfile.schema import RigFile

    given = {
        "bore": bore, "rod": rod, "stroke": stroke, "radius": radius,
        "rated_flow": rated_flow, "supply": supply,
    }  # fmt: skip
    said = {key: value for key, value in given.items() if value}
    log = read_log(logs, read_columns(column or []), layout, known.read_sizes(**said))
    missing = known.missing(log)
    for size in missing:
        if not sys.stdin.isatty():
            option = f"--{size.replace('_', '-')}"
            raise InputError(f"init: {option} is missing: {QUESTIONS[size]}")
        said[size] = _asked(size, said)
    if missing and known.rates_valve(log) and not rated_flow:
        said |= {"rated_flow": flow} if (flow := _asked("rated_flow", said)) else {}
    log = read_log(logs, read_columns(column or []), layout, known.read_sizes(**said))
    own, text = drafted(log, name)
    print(RigFile.from_text(text, own).text, end="")
