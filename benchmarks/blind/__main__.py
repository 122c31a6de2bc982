"""`python -m benchmarks.blind`: record cases, trace them, print the table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmarks.trace.score import append, read_results

from . import recording, table, tracing

RESULTS = "results.jsonl"


def main(
    cases: Annotated[int, typer.Option(help="cases", min=1)] = 24,
    first: Annotated[int, typer.Option(help="number of the first", min=0)] = 0,
    machines: Annotated[
        bool, typer.Option("--machines", help="machines, not rigs of the paper's kind")
    ] = False,
    record_only: Annotated[
        bool, typer.Option("--record-only", help="record them, and trace none")
    ] = False,
    out: Annotated[Path, typer.Option(help="folder of cases and results")] = Path(
        "blind-benchmark"
    ),
) -> None:
    """Trace rigs of plants written without knowledge of hydrojax, and print a table.

    A run that was killed resumes where it stood; a run that is done is only printed.
    """
    numbers = range(first, first + cases)
    try:
        for truth in recording.record(out, numbers, machines):
            typer.echo(f"recorded {truth['case']}", err=True)
    except ImportError as error:
        if error.name != "numba":
            raise
        raise typer.BadParameter(
            "it takes Numba: pip install hydrojax[bench]"
        ) from None
    if not record_only:
        names = [recording.name_of(n, machines) for n in numbers]
        text = _traced(out, names)
        (out / "table.md").write_text(text, encoding="utf-8")
        typer.echo(text)


def _traced(out: Path, names: list[str]) -> str:
    """Trace what has no result yet; the table of all."""
    rows = {row["case"]: row for row in read_results(out / RESULTS)}
    known = recording.truths(out)
    todo = [name for name in names if name not in rows]
    if todo:
        from hydrojax.jax_setup import set_up_jax, user_cache

        set_up_jax(user_cache())
    for name in todo:
        row = tracing.trace(out / recording.CASES / name, known[name])
        append(out / RESULTS, row)
        rows[name] = row
        said = row["verdict"] if row["ok"] else row["reason"]
        typer.echo(f"traced {name} in {row['wall']:.0f} s: {said}", err=True)
    return table.report([(known[name], rows[name]) for name in names])


if __name__ == "__main__":
    typer.run(main)
