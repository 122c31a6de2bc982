"""Every notebook runs from top to bottom, and keeps what is fit to be kept."""

import os
import re
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("plotly", reason="plotly is not installed: [full]")
nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed: [full]")
nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed: [full]")
pytest.importorskip("ipykernel", reason="ipykernel is not installed: [full]")

from benchmarks.notebooks import ALIVE  # noqa: E402

Notebook = Any
"""`nbformat.NotebookNode`, of a package that may be missing."""

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))

MEASURED = Path(os.environ.get("HYDROJAX_DATA", "") or "no-such-folder")
"""Logs that are not part of this repository, where a reader has them."""

MOST_BYTES = 1_000_000


def read(stem: str) -> Notebook:
    """A notebook by its name."""
    (path,) = (p for p in NOTEBOOKS if p.stem == stem)
    return nbformat.read(path, as_version=4)


def outputs(notebook: Notebook) -> list[Notebook]:
    """Every output of every cell."""
    return [o for c in notebook.cells if c.cell_type == "code" for o in c.outputs]


def drawn(notebook: Notebook) -> int:
    """How many pictures there are."""
    return sum("image/png" in o.get("data", {}) for o in outputs(notebook))


def printed(notebook: Notebook) -> str:
    """All that was printed and shown as text or tables."""
    parts = []
    for output in outputs(notebook):
        data = output.get("data", {})
        parts += [output.get("text", ""), data.get("text/plain", "")]
        parts.append(data.get("text/html", ""))
    return "\n".join(parts)


def written(notebook: Notebook) -> list[str]:
    """What was printed, and tables as text, output by output."""
    shown = [o for o in outputs(notebook) if not set(ALIVE) & set(o.get("data", {}))]
    texts = [o.get("text", "") or o.get("data", {}).get("text/plain", "")
             for o in shown if o.get("name") != "stderr"]  # fmt: skip
    return [t for t in texts if t and "<Figure" not in t]


def run(stem: str) -> Notebook:
    """Run a notebook from top to bottom."""
    notebook = read(stem)
    for output in (c for c in notebook.cells if c.cell_type == "code"):
        output.outputs = []
    nbclient.NotebookClient(notebook, timeout=900).execute()
    return notebook


NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def stale(kept: str, ran: str, close: float = 0.03) -> list[str]:
    """Numbers and words that a notebook keeps and does not print any more.

    Machines differ in the last figures of a deviation: numbers may by 3 %, and words
    may not.
    """
    words = (" ".join(NUMBER.sub("#", text).split()) for text in (kept, ran))
    if len(set(words)) > 1:
        return [kept, ran]
    pairs = zip(NUMBER.findall(kept), NUMBER.findall(ran), strict=True)
    return [
        f"{a} is printed as {b}"
        for a, b in pairs
        if abs(float(a) - float(b)) > close * abs(float(a)) + 1e-12
    ]


def test_what_went_stale_is_seen():
    shown = "P_a1  9000.0  8986.88\nc_p1 2.24e-09  1.2e-12"
    assert stale(shown, shown.replace("8986.88", "8990.10")) == []
    assert stale(shown, shown.replace("8986.88", "8000.00")) != []
    assert stale(shown, shown.replace("2.24e-09", "2.44e-09")) != []
    assert stale(shown, shown.replace("P_a1", "P_a2")) != []


@pytest.mark.slow
@pytest.mark.parametrize("stem", [path.stem for path in NOTEBOOKS])
def test_notebook_runs(stem, monkeypatch, cache_home):
    """It draws as many pictures as it keeps, and prints the figures that it keeps."""
    monkeypatch.delenv("HYDROJAX_DATA", raising=False)
    # What other tests have compiled is not compiled again.
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache_home))
    kept, done = read(stem), run(stem)
    for shown, ran in zip(written(kept), written(done), strict=True):
        assert stale(shown, ran) == [], f"run python -m benchmarks.notebooks {stem}"
    assert drawn(done), "no picture was drawn"
    if stem == "05_measured_data":
        assert "demo rig" in printed(done)
    else:
        assert drawn(done) == drawn(kept)
    if stem == "04_your_own_effect":
        assert "quadratic_drag: added" in printed(done)


@pytest.mark.skipif(
    not MEASURED.is_dir(), reason="HYDROJAX_DATA names no folder of measured logs"
)
def test_measured_data(monkeypatch):
    """EMPS as published: least squares by its authors, to 2 %."""
    text = printed(run("05_measured_data"))
    for name in ("payload_inertia.m", "viscous_friction.b", "k_0"):
        (line,) = (x for x in text.splitlines() if x.startswith(f"{name} "))
        assert abs(float(line.split()[-2])) < 2.5, line


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_what_a_notebook_keeps(path):
    """Run to the end, small, and without a word of the machine it was run on."""
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    code = [c for c in notebook.cells if c.cell_type == "code"]
    assert [c.execution_count for c in code] == list(range(1, len(code) + 1))
    assert drawn(notebook)
    assert path.stat().st_size < MOST_BYTES
    assert not [o for o in outputs(notebook) if o.get("name") == "stderr"]
    text = printed(notebook)
    for root in ("/work", "/home", "/root", "/tmp", "/Users", "C:\\", str(Path.cwd())):
        assert root not in text
    assert notebook.metadata.kernelspec.name == "python3"
