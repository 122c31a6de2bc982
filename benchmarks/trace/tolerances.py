"""Do intervals hold the truth where the held constants are off within tolerance?

`python -m benchmarks.trace.tolerances FOLDER` takes cases that were recorded before, in
which nothing is hidden. Each constant of the rig file is moved by a draw from its
tolerance, which the file states; the declared model is fitted, and the 95 % intervals
that hold the truth are counted, with the tolerances in and without them.
"""

from __future__ import annotations

import json
import re
import zlib
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from .measures import wilson

TOLERANCES = {"area": 1.0, "chamber_length": 0.5, "radius": 0.5}
"""Standard deviations of the held constants, per cent."""


def off_within(text: str, seed: int) -> tuple[str, str]:
    """The rig file with its constants off, with their tolerances said and without."""
    rng = np.random.default_rng([seed, 7])
    said = silent = text
    for key, percent in TOLERANCES.items():
        own = re.search(rf'(?m)^{key} = "([^ "]+) ([^"]+)"', text)
        if own is None:
            continue
        value = float(own[1]) * (1 + percent / 100 * rng.normal())
        line = f'{key} = "{value:.9g} {own[2]}'
        said = said.replace(own[0], f'{line} +- {percent:g} %"')
        silent = silent.replace(own[0], f'{line}"')
    return said, silent


def held(text: str, folder: Path) -> dict[str, bool]:
    """Whether the interval of each fitted parameter holds the truth."""
    from hydrojax import api
    from hydrojax.rigfile.schema import RigFile

    truth = json.loads((folder / "truth.json").read_text())["rig"]
    logs = [folder / f"fit_{i}.csv" for i in (1, 2)]
    rig = RigFile.from_text(text)
    outcome = api.fit(rig, logs, [folder / "validate.csv"], starts=1).outcome
    return {
        n: p.interval[0] <= truth[n] <= p.interval[1]
        for n, p in outcome.parameters.items()
        if p.free and p.interval and n in truth
    }


def main(
    folder: Annotated[Path, typer.Argument(help="folder of recorded cases")],
    most: Annotated[int, typer.Option(help="cases that are fitted")] = 20,
) -> None:
    """Print the coverage of 95 % intervals."""
    from hydrojax.jax_setup import ensure_jax

    ensure_jax()
    places = [
        p
        for p in sorted(folder.iterdir())
        if p.name.startswith(("nothing", "parameters")) and (p / "truth.json").exists()
    ][:most]
    counts: dict[str, list[bool]] = {"stated": [], "left out": []}
    missed: dict[str, int] = {}
    for place in places:
        text = (place / "rig.toml").read_text()
        own = off_within(text, zlib.crc32(place.name.encode()))
        for kind, told in zip(counts, own, strict=True):
            inside = held(told, place)
            counts[kind] += inside.values()
            if kind == "stated":
                for name in (n for n, there in inside.items() if not there):
                    missed[name] = missed.get(name, 0) + 1
        done = {k: f"{sum(v)}/{len(v)}" for k, v in counts.items()}
        print(f"{place.name}: {done}", flush=True)
    print("\n| tolerances | intervals with the truth | |\n|---|---|---|")
    for kind, hits in counts.items():
        low, high = wilson(sum(hits), len(hits))
        print(
            f"| {kind} | {sum(hits)}/{len(hits)} = {np.mean(hits):.1%} "
            f"| [{low:.1%}, {high:.1%}] |"
        )
    print(f"\nMissed with tolerances stated: {missed}")


if __name__ == "__main__":
    typer.run(main)
