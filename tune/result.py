"""A tuning that shows and saves itself."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from hydrojax.errors import InputError
from hydrojax.tune import display, report
from hydrojax.tune.tuning import Tuning


@dataclass(frozen=True, repr=False)
class Tuned(Tuning):
    """What `tune_gains` found; the fields are those of `Tuning`."""

    def summary(self) -> str:
        """Gains, metrics before and after, and what limits the loop, as text."""
        return display.summary(self)

    def plot(self, picture: str = "bode") -> Figure:
        """A figure of the tuning.

        Args:
            picture: `bode`: gain and phase before and after, with the ensemble's range;
                `limits`: the bandwidth with each limit taken away; `front`: band
                against tracking, of all gains that were looked at.

        Raises:
            InputError: no such picture, or no limit was examined.
        """
        figures = {
            "bode": display.bode_figure,
            "limits": display.limits_figure,
            "front": display.front_figure,
        }
        if picture not in figures:
            raise InputError(
                f"invalid picture {picture!r}: expected one of {', '.join(figures)}"
            )
        if picture == "limits" and not self.relaxed:
            raise InputError(
                "invalid picture 'limits': no limit was examined; expected bode"
            )
        return figures[picture](self)

    def save(self, folder: str | Path, command_line: str = "") -> None:
        """Write tune.json, rig.toml, pictures and report.html into a folder.

        Args:
            folder: is made where there is none.
            command_line: by which the result came about, for the report.

        Raises:
            OSError: it cannot be written.
        """
        report.write(self, Path(folder), command_line)

    def __repr__(self) -> str:
        gains = ", ".join(f"{n}={v:.4g}" for n, v in self.gains.items())
        band = self.proposal.after.follows_to.min()
        return f"<Tuned {self.name!r}: {gains}; follows up to {band:.1f} Hz>"

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return display.html(self)
