"""The figures of a tuning: gains, metrics before and after, what limits the loop."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from hydrojax.rigfile import edit
from hydrojax.rigfile.quantities import open_setting, quantities
from hydrojax.rigfile.schema import RigFile
from hydrojax.tune.aims import Aim, Limits
from hydrojax.tune.limiting import Relaxed
from hydrojax.tune.optimize import Optimum
from hydrojax.tune.proposal import Proposal
from hydrojax.tune.trials import SMALL

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, repr=False)
class Tuning:
    """The figures of what `tune_gains` found; `Tuned` shows and saves them.

    Attributes:
        file: the rig file that was tuned, with the gains that it had.
        gains: values by name, in the unit of `units`.
        units: of the gains: the paper's.
        start: the values before.
        before, after: metrics of every plant by name, linearised with the adaptation
            live; the rig itself is the first.
        proposal: the same gains tried in runs; what stands in the way of better ones.
        hertz: of the responses among them.
        optimum: where the descents ended.
        relaxed: what limits the loop, the most first.
        plants: what the ensemble is.
        limits: what was to be kept.
        aim: what was made as large as it can be.
        tolerance: of |1 - F/F_d|.
        amplitude: at which bands are promised, that of a sine of the same RMS, N; and
            at `SMALL` of it.
        speed: the joint's peak in the runs that move, m/s.
        run_by: what made the runs, and how C was held to XLA.
        edges: gains at an end of their search range.
        comparison: of models and gains: a title, and metrics of the rig itself.
        notes: remarks.
    """

    file: RigFile
    gains: dict[str, float]
    units: dict[str, str]
    start: dict[str, float]
    before: dict[str, Float[np.ndarray, "plants *rest"]]
    after: dict[str, Float[np.ndarray, "plants *rest"]]
    proposal: Proposal
    hertz: Float[np.ndarray, "lines"]
    optimum: Optimum
    relaxed: tuple[Relaxed, ...]
    plants: str
    limits: Limits
    aim: Aim
    tolerance: float
    amplitude: float
    speed: float
    run_by: str
    edges: tuple[str, ...] = ()
    comparison: tuple[tuple[str, dict[str, float | None]], ...] = ()
    notes: tuple[str, ...] = field(default=())

    @property
    def name(self) -> str:
        """The rig's."""
        return self.file.name

    @cached_property
    def rig(self) -> RigFile:
        """The rig file with the gains in it; all else, comments too, as it was."""
        keys: dict[str, Any] = {}
        for name, value in self.gains.items():
            written = edit.text(value, self.units[name])
            key, _, end = name.removesuffix("_hat").rpartition("_")
            if end in ("lower", "upper"):
                both = keys.get(key, self.file.controller.get(key))
                both = self._defaults(key) if both is None else both
                both = list(both) if isinstance(both, list) else [both, both]
                both[end == "upper"] = written
                keys[key] = both
            else:
                keys[name.removesuffix("_hat")] = written
        text = edit.rewrite(self.file, {}, controller=keys)
        return self.file.with_text(text)

    def _defaults(self, key: str) -> list[str]:
        """Both bounds of an estimate of which the file says nothing, as it has them."""
        setting = open_setting(self.file)
        known = quantities(self.file, setting)
        ends = (known[f"{key}_{end}"] for end in ("lower", "upper"))
        return [edit.text(float(q.get(setting)), q.unit) for q in ends]

    def to_frame(self) -> pd.DataFrame:
        """The gains: a row each, with columns `before`, `after` and `unit`."""
        import pandas as pd

        rows = {n: (self.start[n], v, self.units[n]) for n, v in self.gains.items()}
        columns = ["before", "after", "unit"]
        frame = pd.DataFrame.from_dict(rows, orient="index", columns=columns)
        return frame.rename_axis("gain")

    def json(self) -> dict[str, Any]:
        """The content of tune.json: gains in the paper's units."""
        return {
            "gains": self.gains,
            "proposed": self.proposal.found,
            "obstacles": list(self.obstacles),
            "aim": self.aim.word,
            "tolerance": self.tolerance,
            "amplitudes_N": list(self.amplitudes),
            "runs": self.run_by,
            "at_edge_of_search": list(self.edges),
            "before": self.proposal.before.figures(0),
            "after": self.proposal.after.figures(0),
            "worst_of_ensemble": self.proposal.after.figures(None),
        }

    @property
    def obstacles(self) -> tuple[str, ...]:
        """What stands in the way of a proposal; empty where there is one."""
        return self.proposal.obstacles

    @property
    def amplitudes(self) -> tuple[float, float]:
        """Sizes of the desired force at which bands are promised, N."""
        return SMALL * self.amplitude, self.amplitude
