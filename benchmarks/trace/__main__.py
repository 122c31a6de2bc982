"""`python -m benchmarks.trace`: record cases, trace them, print the table."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from . import baselines, cases, score, sizes, table, tracing
from .catalogue import ENDS, NAMED


def main(
    number: Annotated[int, typer.Option("--cases", help="cases to trace")] = 48,
    out: Annotated[Path, typer.Option(help="folder of cases and results")] = Path(
        "trace-benchmark"
    ),
    more: Annotated[
        list[str] | None,
        typer.Option(help="KIND=N: at least so many of a kind, as in nothing=100"),
    ] = None,
    sized: Annotated[
        int,
        typer.Option("--sizes", help="cases of every searched effect, of any size"),
    ] = 0,
    jobs: Annotated[int, typer.Option(help="processes that trace", min=1)] = 1,
    with_baselines: Annotated[
        bool, typer.Option("--baselines/--no-baselines", help="run the cheap ones too")
    ] = True,
    oracle: Annotated[
        bool, typer.Option(help="fit the true structure where trace missed it")
    ] = True,
    refits: Annotated[
        int, typer.Option(help="cases on which every candidate is refitted (slow)")
    ] = 0,
) -> None:
    """Trace rigs with known truths and print what was found, as Markdown.

    A run that was killed resumes where it stood; a run that is done is only printed.
    """
    wanted = {}
    for text in more or ():
        kind, _, count = text.partition("=")
        if kind not in cases.KINDS or not count.isdigit():
            known = ", ".join(cases.KINDS)
            raise typer.BadParameter(f"{text!r} is not KIND=N; kinds: {known}")
        wanted[kind] = int(count)
    console = Console(stderr=True)
    from hydrojax.jax_setup import set_up_jax, user_cache

    set_up_jax(user_cache())
    from hydrojax.effects import EFFECTS

    specs = cases.plan(number, wanted, [n for n in NAMED if n in EFFECTS])
    if sized:
        names = [n for n in ENDS if n in EFFECTS]
        specs += list(islice(sizes.sized(names), sized * len(names)))
    tracer = tracing.Tracing(oracle, with_baselines)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(elapsed_when_finished=False),
    )
    with Progress(*columns, console=console, speed_estimate_period=600) as bar:
        task = bar.add_task("cases", total=len(specs))

        def progress(what: str, done: int, total: int) -> None:
            bar.update(task, description=what, completed=done, total=total)

        rows = score.score(specs, out, tracer, jobs=jobs, progress=progress)
        if refits:
            baselines.refit_each(specs, out, refits, progress)
    rest = [row for row in rows if row["kind"] != "sized"]
    text = table.report(rest, baselines.read_refits(out)) if rest else ""
    if sized:
        text += sizes.curve(rows)
    (out / "table.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    typer.run(main)
