"""Pictures to zoom into and slide through, in notebooks: plotly, which is an extra."""

from __future__ import annotations

from typing import Any

from hydrojax.errors import InputError


def plotly() -> tuple[Any, Any]:
    """`plotly.graph_objects` and `plotly.subplots`.

    Raises:
        InputError: it is not installed.
    """
    try:
        from plotly import graph_objects, subplots
    except ImportError as err:
        raise InputError(
            "explore: plotly is not installed: pip install 'hydrojax[notebook]', or "
            "take plot() for a picture that stands still"
        ) from err
    return graph_objects, subplots


def layout(title: str, **more: Any) -> dict[str, Any]:
    """What all of these pictures look like."""
    axis = {"gridcolor": "#e4e4e4", "zerolinecolor": "#b0b0b0", "linecolor": "#1c1f23"}
    return {
        "title": {"text": title.replace("<", "&lt;"), "font": {"size": 14}},
        "template": "none",
        "height": 520,
        "margin": {"l": 70, "r": 20, "t": 90, "b": 60},
        "hovermode": "x unified",
        "legend": {"orientation": "h", "y": 1.09, "x": 0},
        "font": {"size": 12},
        **{f"{way}axis{n}": axis for way in "xy" for n in ("", "2")},
        **more,
    }
