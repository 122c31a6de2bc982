"""Small pieces of HTML for notebooks: no script, nothing from outside."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

_CELL = "padding: .2em .8em; text-align: left; vertical-align: baseline"


def paragraph(text: str, strong: str = "") -> str:
    """A paragraph, with words in bold before it."""
    lead = f"<b>{escape(strong)}</b> " if strong else ""
    return f"<p>{lead}{escape(text)}</p>"


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of plain text; nothing where there are no rows."""
    if not rows:
        return ""

    def line(cells: Sequence[str], kind: str) -> str:
        inside = (f'<{kind} style="{_CELL}">{escape(c)}</{kind}>' for c in cells)
        return f"<tr>{''.join(inside)}</tr>"

    body = "".join(line(row, "td") for row in rows)
    head = line(heads, "th")
    inside = f"<thead>{head}</thead><tbody>{body}</tbody>"
    return f'<table style="margin: .6em 0">{inside}</table>'


def block(*parts: str) -> str:
    """Parts under each other, as wide as the notebook lets them."""
    return f'<div style="overflow-x: auto">{"".join(parts)}</div>'
