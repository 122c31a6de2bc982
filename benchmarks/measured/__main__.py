"""Predict measured sets, and print how far off hydrojax and other models are.

Run as `python -m benchmarks.measured DATA`, where DATA holds a folder for each set (see
`benchmarks.measured.sets`, which says where each is had). Every model is fitted to the
same logs and then runs free through others, from half a second on. NARX, the subspace
model and the GRU need the extra `peers`.
"""

from __future__ import annotations

import importlib.util
import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from benchmarks.measured.own import OWN
from benchmarks.measured.peers import predicted
from benchmarks.measured.sets import SETS, Measured
from hydrojax.jax_setup import set_up_jax, user_cache

NEEDED = {
    "subspace (N4SID)": "nfoursid",
    "NARX (SysIdentPy)": "sysidentpy",
    "GRU": "optax",
}
"""What a model is not run without."""


def main(
    data: Annotated[
        Path, typer.Argument(help="folder of the sets", exists=True, file_okay=False)
    ],
    only: Annotated[list[str], typer.Option(help="a set; may be repeated")] = [],  # noqa: B006
    ours: Annotated[bool, typer.Option(help="run hydrojax, too")] = True,
    others: Annotated[bool, typer.Option(help="run the other models, too")] = True,
) -> None:
    """Predict measured sets by hydrojax and by models that know no physics."""
    unknown = [name for name in only if name not in SETS]
    if unknown:
        said = f"no set {unknown[0]!r}: choose from {', '.join(SETS)}"
        raise typer.BadParameter(said, param_hint="--only")
    set_up_jax(user_cache())
    console = Console(width=110)
    for name, measured in SETS.items():
        if only and name not in only:
            continue
        if not (data / measured.folder).is_dir():
            console.print(f"{name}: no folder {measured.folder} ({measured.source})")
            continue
        unit = "" if measured.unit == "1" else f", {measured.unit}"
        table = Table(f"{name}: {measured.task}", f"RMS error{unit}", "s")
        own = OWN[name](data, measured) if ours else None
        if own is not None:
            for i, (row, error) in enumerate(own.rows.items()):
                seconds = f"{own.seconds:.0f}" if i == 0 else ""
                table.add_row(row, _figure(error), seconds)
        if others:
            _peers(table, data, measured)
        console.print(table)
        if own is not None:
            console.print(own.said)


def _peers(table: Table, data: Path, measured: Measured) -> None:
    fit, judged = measured.read(data, "fit"), measured.read(data, "validate")
    for name in measured.peers:
        package = NEEDED.get(name)
        if package and importlib.util.find_spec(package) is None:
            table.add_row(name, f"needs {package}", "")
            continue
        began = time.perf_counter()
        found = predicted(name, fit, judged)
        seconds = f"{time.perf_counter() - began:.0f}"
        if found is None:
            table.add_row(name, "diverges", seconds)
            continue
        error, size = found
        table.add_row(f"{name}, size {size}", _figure(error / measured.size), seconds)


def _figure(error: float | None) -> str:
    return "diverges" if error is None else f"{error:.3g}"


if __name__ == "__main__":
    typer.run(main)
