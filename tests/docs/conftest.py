"""A folder with the logs and the files that the pages' commands name."""

from __future__ import annotations

import gzip
import shutil
from pathlib import Path

import pytest

from tests.pages import ROOT, blocks

DEMO = ROOT / "hydrojax/demo"
LOGS = {
    "fit_1": ("fit_1", "fit", "log", "log_1"),
    "fit_2": ("fit_2", "log_2"),
    "validate": ("other", "validate"),
}
"""What the pages call the logs of the demo."""


@pytest.fixture
def desk(tmp_path, monkeypatch) -> Path:
    """A folder that holds what the commands name."""
    for log, names in LOGS.items():
        text = gzip.decompress((DEMO / f"{log}.csv.gz").read_bytes())
        for name in names:
            (tmp_path / f"{name}.csv").write_bytes(text)
    shutil.copy(DEMO / "rig.toml", tmp_path)
    jobs = "job,rig,fit,validate\nA,rig.toml,fit_1.csv;fit_2.csv,other.csv\n"
    (tmp_path / "jobs.csv").write_text(jobs)
    own = next(blocks(ROOT / "docs/your_own_effect.md", "python"))
    (tmp_path / "my_effects.py").write_text(own)
    job = tmp_path / "measured/A"
    job.mkdir(parents=True)
    for file in ("rig.toml", "fit_1.csv", "validate.csv"):
        shutil.copy(tmp_path / file, job)
    monkeypatch.chdir(tmp_path)
    return tmp_path
