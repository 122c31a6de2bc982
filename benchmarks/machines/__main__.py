"""`python -m benchmarks.machines`: record machines, trace them, print the table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from . import files, record, table, tracing

BATCH = 4
"""Machines recorded at a time: each takes 60 MB while it is."""


def main(
    cases: Annotated[int, typer.Option(help="machines", min=1)] = 12,
    out: Annotated[Path, typer.Option(help="folder of machines and results")] = Path(
        "machines-benchmark"
    ),
    first: Annotated[int, typer.Option(help="seed of the first machine", min=0)] = 1,
    record_only: Annotated[
        bool, typer.Option("--record-only", help="record them, and trace none")
    ] = False,
) -> None:
    """Trace machines that hydrojax was not shaped on, and print what was found.

    A run that was killed resumes where it stood; a run that is done is only printed.
    """
    console = Console(width=150)
    seeds = list(range(first, first + cases))
    todo = files.missing(out, seeds)
    for begin in range(0, len(todo), BATCH):
        for recording in record.record(todo[begin : begin + BATCH]):
            machine = recording.machine
            folder = files.folder_of(out, machine.seed)
            files.write(recording, folder)
            left_out = ", ".join(machine.left_out) or "nothing"
            console.print(f"recorded {folder.name}: leaves out {left_out}")
    if not record_only:
        _trace(out, seeds, console)


def _trace(out: Path, seeds: list[int], console: Console) -> None:
    """Trace what has no result yet, and print all."""
    folders = {seed: files.folder_of(out, seed) for seed in seeds}
    if not all((f / files.RESULT).exists() for f in folders.values()):
        from hydrojax.jax_setup import set_up_jax, user_cache

        set_up_jax(user_cache())
    rows = []
    for seed, folder in folders.items():
        truth = files.read(folder, files.TRUTH)
        result = files.read(folder, files.RESULT)
        if truth is None:
            raise RuntimeError(f"{folder} has no truth")
        if result is None:
            result = tracing.trace(folder)
            named = ", ".join(result["named"]) or "nothing"
            console.print(f"{folder.name}: {result['verdict']}, named {named}")
        rows.append(table.Row(seed, tuple(truth["left_out"]), result))
    console.print(table.table(rows))
    console.print(table.summary(rows))


if __name__ == "__main__":
    typer.run(main)
