"""`python -m benchmarks.machines.units FOLDER...`: recorded machines whose supply
pressure alone is told in another unit, and what `hydrojax check` calls it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from scipy import constants

PSI = 1e-5 * constants.psi
"""A psi in bar."""
TOLD = (1.0, 100 * PSI, 10.0, 1 / PSI, 0.1, 0.01 / PSI)
"""Factors that mend what is told: none, or one of kPa, bar, MPa and psi for another."""


def called(folder: Path) -> list[tuple[float, str]]:
    """The factors told of a machine that are not called by their name, and what is."""
    import hydrojax as hj

    rig = hj.RigFile.load(folder / "rig.toml")
    logs = [hj.Log.load(p, rig.channels) for p in sorted(folder.glob("fit*.csv"))]
    missed = []
    for factor in TOLD:
        told = [
            replace(g, signals=g.signals | {"P_s": g.signals["P_s"] / factor})
            for g in logs
        ]
        found = [f for f in hj.check(rig, told).found if f.finding == "unit"]
        names = [(f.input, round(f.factor or 0.0, 3)) for f in found]
        if names != ([] if factor == 1 else [("P_s", round(factor, 3))]):
            missed.append((factor, str(names or "nothing")))
    return missed


def main(
    folders: Annotated[list[Path], typer.Argument(help="folders of recorded machines")],
) -> None:
    """Print how many units are called by their name, and those that are not."""
    from hydrojax.jax_setup import ensure_jax

    ensure_jax()
    print(_table({f.name: called(f) for f in folders}))


def _table(missed: dict[str, Sequence[tuple[float, str]]]) -> str:
    whole = len(missed) * len(TOLD)
    wrong = sum(map(len, missed.values()))
    lines = [f"{whole - wrong} of {whole} right, of {len(missed)} machines."]
    for name, own in missed.items():
        lines += [f"- {name}, to be multiplied by {f:.3g}: {what}" for f, what in own]
    return "\n".join(lines)


if __name__ == "__main__":
    typer.run(main)
