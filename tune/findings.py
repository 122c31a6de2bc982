"""What `identify` or `trace` found of a plant, read from its report.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import equinox as eqx
import numpy as np
from jaxtyping import Float

from hydrojax import units
from hydrojax.errors import InputError
from hydrojax.parameters import parameter_specs, put
from hydrojax.report.record import read_report
from hydrojax.report.schema import ChannelRecord, ParameterRecord
from hydrojax.rigfile.quantities import Setting

UNVALIDATED = 0.05
"""Relative model error of a report that does not say what its validation left."""


@dataclass(frozen=True)
class Findings:
    """A report's plant.

    Attributes:
        source: the folder of the report.
        effects: names of the effects that were added to the rig file's.
        parameters: value and standard deviation (None where it was not fitted) by
            name; those of effects as `valve_lag.tau`; SI as stored.
        covariance: names, and the covariance of what was fitted, if the report has it.
        absent: effects that the logs would have shown, and did not.
        residual: of the validation, relative to how far a channel moves within a
            window, the largest of all channels.
    """

    source: Path
    effects: tuple[str, ...]
    parameters: Mapping[str, ParameterRecord]
    covariance: tuple[tuple[str, ...], Float[np.ndarray, "n n"]] | None = None
    absent: tuple[str, ...] = ()
    residual: float = UNVALIDATED

    @classmethod
    def load(cls, folder: str | Path) -> Findings:
        """Read the report in a folder that `identify` or `trace` has written.

        Raises:
            InputError: there is no report, or it is not one of hydrojax.
        """
        report = read_report(folder)
        full = report.covariance
        return cls(
            Path(folder),
            tuple(effect.name for effect in report.effects),
            report.every_parameter,
            (tuple(full.names), np.array(full.matrix)) if full else None,
            tuple(c.name for c in report.candidates if c.status == "absent"),
            _residual(report.channels),
        )

    @property
    def shown(self) -> frozenset[str]:
        """Names of the effects of which a parameter has a standard deviation."""
        parts = (n.partition(".") for n, p in self.parameters.items() if p.std)
        return frozenset(name for name, dot, _ in parts if dot)

    @property
    def fitted(self) -> bool:
        """Whether any parameter has a standard deviation."""
        return any(p.std for p in self.parameters.values())

    def apply(self, setting: Setting) -> Setting:
        """The setting with the plant that was found; the controller as it was."""
        found = {n: p for n, p in self.known(setting).items() if p.value is not None}
        if not found:
            return setting
        values = np.array([p.value for p in found.values()])
        rig = put(setting.loop.rig, list(found), values)
        return eqx.tree_at(lambda s: s.loop.rig, setting, rig)

    def known(self, setting: Setting) -> dict[str, ParameterRecord]:
        """Those of the parameters that the setting's rig has.

        Raises:
            InputError: one is in another unit than the rig's.
        """
        specs = parameter_specs(setting.loop.rig)
        found = {n: p for n, p in self.parameters.items() if n in specs}
        for name, p in found.items():
            wants = {units.with_command(specs[name].unit, u) for u in ("V", "1")}
            if p.unit not in wants:
                raise InputError(
                    f"{self.source}: report.json: {name} is in {p.unit}, not in "
                    f"{specs[name].unit}; run identify or trace again"
                )
        return found


def _residual(channels: Mapping[str, ChannelRecord]) -> float:
    """The largest relative error that validation left; at most all of a signal."""
    shares = []
    for channel in channels.values():
        judged = channel.validate_ or channel
        held = judged.held or channel.held
        if judged.after is not None and held:
            shares.append(min(judged.after / held, 1.0))
    return max(shares, default=UNVALIDATED)
