"""Reports as pages that need nothing else: pictures inside, one style for all."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jinja2

from hydrojax import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Picture:
    """A figure as PNG, with what stands below it and what is read in its place."""

    name: str
    png: bytes
    alt: str
    caption: str

    @property
    def data(self) -> str:
        """The address that holds the picture itself."""
        return "data:image/png;base64," + base64.b64encode(self.png).decode("ascii")


def made_by(command_line: str) -> dict[str, str]:
    """What made a report: `version`, `date` and `command_line`."""
    return {
        "version": __version__,
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "command_line": command_line,
    }


def as_png(figure: Figure, dpi: int) -> bytes:
    """A figure as a PNG file, in the style that is set."""
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=dpi)
    return out.getvalue()


def page(template: Path, help_: Iterable[Callable[..., Any]], **values: Any) -> str:
    """The page of a template.

    Args:
        template: its file; `page.css` beside this module can be included in it.
        help_: functions that it may call, by their own names.
        values: what it shows.

    Raises:
        jinja2.UndefinedError: it asks for what is not there.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([template.parent, Path(__file__).parent]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals.update({f.__name__: f for f in help_})
    return environment.get_template(template.name).render(**values)
