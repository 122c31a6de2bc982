"""What the pages are made of: tables, units, docstrings."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator, Mapping

from hydrojax.parameters import Spec


def table(heads: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> str:
    """A table in Markdown."""
    lines = [heads, tuple("---" for _ in heads), *rows]
    cells = (
        " | ".join(c.replace("|", "\\|").replace("\n", " ") for c in r) for r in lines
    )
    return "\n".join(f"| {line} |" for line in cells) + "\n"


def unit(name: str) -> str:
    """A unit as code; V for that of the command."""
    return "–" if name == "1" else f"`{name.replace('{u}', 'V')}`"


def rows(known: Mapping[str, Spec]) -> Iterator[tuple[str, ...]]:
    """Parameters as rows: key, unit, range, default or usual size, meaning."""
    for name, s in known.items():
        also = f" or `{s.outside[0]}`" if s.outside else ""
        usual = s.size if s.size is not None else s.default
        limits = f"{s.lower:.3g} to {s.upper:.3g}"
        yield (f"`{name}`{also}", unit(s.unit), limits, f"{usual:.3g}", s.description)


HEADS = ("key", "unit", "limits", "scale", "meaning")


def doc(thing: object) -> str:
    """A docstring as Markdown."""
    text = inspect.cleandoc(getattr(thing, "__doc__", "") or "")
    text = re.sub(r" \([A-Z]\d+(?:, [A-Z]\d+)*\)", "", text)  # a catalogue's numbers
    return text.split("\n\nAttributes:")[0].split("\n\nArgs:")[0]
