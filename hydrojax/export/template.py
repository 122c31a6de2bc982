"""The texts that are filled in: `*.jinja` beside this file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jinja2


def comment(text: str) -> str:
    """Text that may stand in a comment of C: one line of letters, figures and signs."""
    flat = " ".join(text.split()).encode("ascii", "replace").decode()
    flat = flat.replace("*/", "* /").replace("/*", "/ *")
    return "".join("_" if sign in "\\?" else sign for sign in flat)


def fill(template: str, **values: Any) -> str:
    """A text of this folder with `values` in it."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        undefined=jinja2.StrictUndefined,
        autoescape=False,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["comment"] = comment
    return environment.get_template(template).render(values)
