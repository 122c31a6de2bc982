"""What the site's build needs: the packages laid out as they are imported.

`identify/` and `tune/` are imported as `hydrojax.identify` and `hydrojax.tune`. The API
pages are made from the text of the modules, by a reader that does not know that: it is
shown a copy in which every package stands where its name says.
"""

from __future__ import annotations

import shutil
import tomllib
from pathlib import Path

ROOT = Path(__file__).parent.parent
COPY = ROOT / "build" / "api"


def lay_out(root: Path = ROOT, copy: Path = COPY) -> Path:
    """Copy the modules of every package to where its name says; returns the folder."""
    text = (root / "pyproject.toml").read_text(encoding="utf-8")
    places = tomllib.loads(text)["tool"]["setuptools"]["package-dir"]
    shutil.rmtree(copy, ignore_errors=True)
    ours = {"hydrojax": "hydrojax", **places}
    for package, folder in ours.items():
        for path in (root / folder).rglob("*.py"):
            target = copy / package.replace(".", "/") / path.relative_to(root / folder)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
    return copy


def on_startup(command: str, dirty: bool) -> None:
    """Lay the modules out before anything is read; `mkdocs.yml` names the folder."""
    lay_out()
