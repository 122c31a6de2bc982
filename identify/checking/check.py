"""`check`: what the logs hold, and which inputs look wrong, before any fit."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure

from hydrojax.identify.checking.findings import inputs_that_lie
from hydrojax.identify.checking.inputs import Inputs, inputs_of
from hydrojax.identify.checking.sensors import ROLL_OFF, channel_table, log_table
from hydrojax.identify.checking.words import Finding, of_strays
from hydrojax.identify.preparation.strays import without_strays
from hydrojax.identify.report.explorer import condensed
from hydrojax.identify.report.figures import AFTER, STYLE, png, sheet
from hydrojax.logs.log import Log
from hydrojax.report import markup
from hydrojax.report.files import write_all
from hydrojax.report.page import Picture, made_by, page
from hydrojax.report.text import engineering, quantity_text, symbol
from hydrojax.rigfile.schema import RigFile

FORMAT = "hydrojax-check/1"

LEGEND = textwrap.fill(
    "repeated: readings equal to the one before; at the ends: at the smallest or "
    "largest value; held: the longest run of one value; roll-off: fall of the power "
    "from a third of the sampling rate to half of it (a channel with a filter falls by "
    f"{ROLL_OFF:.0f} dB more than the others).",
    88,
)
"""What the columns of the channels' table mean."""


@dataclass(frozen=True, repr=False)
class Checked:
    """What `check` found.

    Attributes:
        rig: its name.
        found: what looks wrong, the worst first.
        logs: one row a log; see `log_table`.
        channels: one row a channel, SI; see `Readings`.
        inputs: one row an input: `verdict`, "plausible", "not checked" or what looks
            wrong, and `why`.
        read: the logs themselves.
    """

    rig: str
    found: tuple[Finding, ...]
    logs: pd.DataFrame
    channels: pd.DataFrame
    inputs: pd.DataFrame
    read: tuple[Log, ...] = ()

    @cached_property
    def findings(self) -> pd.DataFrame:
        """One row a finding; the columns are the attributes of `Finding`."""
        return pd.DataFrame(
            [asdict(f) for f in self.found], columns=list(Finding.__annotations__)
        )

    @property
    def sentence(self) -> str:
        """All of it in one line."""
        if not self.found:
            return "No input looks wrong."
        first = self.found[0].says
        more = len(self.found) - 1
        return first + (f"; and {more} more" if more else "") + "."

    def to_dict(self) -> dict[str, Any]:
        """The content of check.json: SI units; None for what is not a finite number."""
        return {
            "format": FORMAT,
            "rig": self.rig,
            "inputs": [finite(asdict(f)) for f in self.found],
            "verdicts": _rows(self.inputs),
            "logs": _rows(self.logs),
            "channels": _rows(self.channels),
        }

    @property
    def logs_shown(self) -> pd.DataFrame:
        """The logs as people read them."""
        rows = {
            name: {
                "length": quantity_text(row.seconds, "s"),
                "rows": str(row.rows),
                "rate": quantity_text(row.rate, "Hz"),
                "jitter": _share(row.jitter),
                "stretches": str(row.stretches),
                "standstill": _share(row.standstill),
            }
            for name, row in _each(self.logs)
        }
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("log")

    @property
    def channels_shown(self) -> pd.DataFrame:
        """The channels as people read them; "held" is the longest run of one value."""
        rows = {
            name: {
                **{
                    n: quantity_text(getattr(row, n), row.unit, figures=3)
                    for n in SIZES
                },
                "repeated": _share(row.repeated),
                "at the ends": _share(row.at_ends),
                "held": quantity_text(row.stuck, "s", figures=3),
                "roll-off": f"{10 * row.roll_off:.1f} dB",
                "below vacuum": _share(row.below_vacuum),
            }
            for name, row in _each(self.channels)
        }
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("channel")

    def summary(self) -> str:
        """Findings and tables as text."""
        parts = [
            f"hydrojax check: {self.rig}",
            *(textwrap.fill(f"- {f.says}", 88) for f in self.found),
            *(() if self.found else ("No input looks wrong.",)),
            *(f"- {log.name}: {note}" for log in self.read for note in log.notes),
            "",
            _text(self.inputs),
            "",
            _text(self.logs_shown),
            "",
            _text(self.channels_shown),
            "",
            LEGEND,
        ]
        return "\n".join(parts) + "\n"

    def plot(self) -> Figure:
        """The signals of the first log."""
        return _signals_figure(self.read[0])

    def save(self, folder: str | Path, command_line: str = "") -> None:
        """Write check.json, check.html and signals.png into a folder.

        Args:
            folder: is made where there is none.
            command_line: by which it came about, for the page.

        Raises:
            OSError: it cannot be written.
        """
        picture = Picture(
            "signals", png(self.plot()), "Every signal of the first log over time.",
            f"Signals of {self.read[0].name}, smallest and largest value per pixel.",
        )  # fmt: skip
        own = json.dumps(self.to_dict(), indent=1, allow_nan=False, ensure_ascii=False)
        html = page(
            Path(__file__).parent / "check.html", (quantity_text,), c=self,
            picture=picture, made=made_by(command_line),
        )  # fmt: skip
        files = {"check.json": f"{own}\n".encode(), "check.html": html.encode()}
        write_all(Path(folder), files | {"signals.png": picture.png})

    def __repr__(self) -> str:
        wrong = ", ".join(f.input for f in self.found) or "nothing looks wrong"
        return f"<check of {self.rig!r}: {wrong}>"

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        rows = [(f.input, f.finding, f.says) for f in self.found]
        return markup.block(
            markup.paragraph(self.sentence, f"{self.rig}."),
            markup.table(("input", "finding", "says"), rows),
        )


def finite(row: dict[str, Any]) -> dict[str, Any]:
    """The same with None for what is not a finite number."""
    return {
        k: None if isinstance(v, float) and not math.isfinite(v) else v
        for k, v in row.items()
    }


def _rows(table: pd.DataFrame) -> dict[str, dict[str, Any]]:
    return {str(k): finite(row) for k, row in table.to_dict(orient="index").items()}


SIZES = ("low", "high", "resolution", "noise")
"""Columns of the channels that have the channel's unit."""


def _each(table: pd.DataFrame) -> Iterator[tuple[str, Any]]:
    """Rows by name, with their columns as attributes."""
    rows = table.itertuples(index=False)
    return zip(map(str, table.index), rows, strict=True)


def _share(part: float) -> str:
    """A part of a whole in per cent."""
    return "< 0.01 %" if 0 < part < 1e-4 else f"{100 * part:.2g} %"


def _text(table: pd.DataFrame) -> str:
    return table.to_string(line_width=80)


def check_inputs(spec: RigFile, logs: Sequence[Log]) -> Checked:
    """Check a rig file against its logs: no simulation, and nothing is fitted for good.

    Args:
        spec: the rig file.
        logs: recorded on the rig, all with the same signals.

    Raises:
        InputError: logs without motion, or that differ in their signals.
    """
    cut = [without_strays(log) for log in logs]
    of = inputs_of(spec, cut)
    channels, kept = channel_table(logs), channel_table(cut)
    found = tuple(of_strays(channels, kept))
    if all(f.mended for f in found):  # no balance closes with a sensor that lies
        found += inputs_that_lie(of, kept, spec.base)
    return Checked(
        spec.name,
        found,
        log_table(logs, spec),
        channels,
        _verdicts(of, found),
        tuple(logs),
    )


def _verdicts(of: Inputs, found: Sequence[Finding]) -> pd.DataFrame:
    """What is said of each input."""
    wrong = {n: f.finding for f in reversed(found) for n in f.input.split(", ")}
    by_flow = {"u", of.motion, "P_a1", "P_a2", "P_s"} if of.has_flow else set()
    by_force = (
        {"F", of.motion, "P", *of.spec.layout.pressures} if of.has_force else set()
    )
    rows = {}
    names = [n for n in ("u", of.motion, "P_a1", "P_a2", "P_s", "P", "F")]
    geometry = [n for n in ("area", "area_1", "area_2") if n in of.spec.geometry]
    for name in (*(n for n in names if n in of.logged), *geometry):
        ways = []
        if name in by_flow:
            ways.append("flow")
        if name in by_force or (name in geometry and of.has_force):
            ways.append("force")
        why = f"balance of {' and '.join(ways)}" if ways else "the log alone"
        rows[name] = (wrong.pop(name, "plausible" if ways else "not checked"), why)
    rows |= {name: (what, "left out or stated wrong") for name, what in wrong.items()}
    table = pd.DataFrame.from_dict(rows, orient="index", columns=["verdict", "why"])
    return table.rename_axis("input")


PIXELS = 1400
"""Columns of a picture, each with the smallest and largest value in it."""


def _signals_figure(log: Log) -> Figure:
    """Every signal of a log over time, one under the other."""
    with rc_context(STYLE):
        figure = sheet(0.4 + 0.95 * len(log.signals))
        axes = figure.subplots(len(log.signals), 1, sharex=True, squeeze=False)[:, 0]
        t = log.time - log.time[0]
        for ax, (name, y) in zip(axes, log.signals.items(), strict=True):
            factor, unit = engineering(
                float(np.max(np.abs(y))), log.units.get(name, "1")
            )
            thin = condensed(t, y / factor, t[-1] / PIXELS)
            ax.plot(*thin, color=AFTER, linewidth=0.6)
            ax.set_ylabel(f"{symbol(name)} [{unit}]" if unit else symbol(name))
        axes[-1].set_xlabel("time [s]")
        figure.align_ylabels(axes)
    return figure
