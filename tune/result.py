"""A tuning that shows and saves itself."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from hydrojax.tune import display, report
from hydrojax.tune.metrics import minimum
from hydrojax.tune.tuning import Tuning


@dataclass(frozen=True, repr=False)
class Tuned(Tuning):
    """What `tune_gains` found; the fields are those of `Tuning`."""

    def summary(self) -> str:
        """Gains, metrics before and after, and what limits the loop, as text."""
        return display.summary(self)

    def plot(self) -> Figure:
        """Gain and phase before and after, with the ensemble's range."""
        return display.bode_figure(self)

    def save(self, folder: str | Path) -> None:
        """Write tune.json, rig.toml, pictures and report.html into a folder."""
        report.write(self, Path(folder))

    def __repr__(self) -> str:
        gains = ", ".join(f"{n}={v:.4g}" for n, v in self.gains.items())
        band = minimum(self.after["within_1dB"])
        return f"<Tuned {self.name!r}: {gains}; within 1 dB up to {band:.1f} Hz>"

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return display.html(self)
