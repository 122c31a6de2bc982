"""Run the notebooks from top to bottom, and keep what they show.

`python -m benchmarks.notebooks [STEM...]`, such as `01_the_loop`: all without one. The
suite runs them too, and compares what they print with what is kept here. Pictures to
zoom into are not kept: they hold whole logs.
"""

from __future__ import annotations

import sys
from copy import deepcopy
from pathlib import Path
from typing import Any

import nbclient
import nbformat

FOLDER = Path(__file__).parents[1] / "notebooks"

ALIVE = ("application/vnd.plotly.v1+json", "application/vnd.plotly")
"""Outputs that are not kept."""


def kept(cell: Any) -> list[Any]:
    """The outputs of a cell without what is alive in them."""
    data = (o.get("data", {}) for o in cell.outputs)
    alive = [any(kind in d for kind in ALIVE) for d in data]
    return [o for o, gone in zip(cell.outputs, alive, strict=True) if not gone]


def run(path: Path) -> None:
    """Run a notebook in its folder, and write it back."""
    notebook = nbformat.read(path, as_version=4)
    own = deepcopy(notebook.metadata)
    nbclient.NotebookClient(notebook, timeout=1800).execute()
    notebook.metadata = own  # the kernel adds what it is
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)  # the times of its run
        if cell.cell_type == "code":
            cell.outputs = [o for o in kept(cell) if o.get("name") != "stderr"]
    nbformat.write(notebook, path)


def main() -> None:
    """Run those that are named."""
    named = sys.argv[1:] or sorted(p.stem for p in FOLDER.glob("*.ipynb"))
    for stem in named:
        print(stem, flush=True)
        run(FOLDER / f"{stem}.ipynb")


if __name__ == "__main__":
    main()
