"""What `identify` or `trace` found of a plant, read from its report.json."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from hydrojax.errors import InputError
from hydrojax.parameters import parameter_specs, put
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
    parameters: Mapping[str, Mapping[str, Any]]
    covariance: tuple[tuple[str, ...], Float[np.ndarray, "n n"]] | None = None
    absent: tuple[str, ...] = ()
    residual: float = UNVALIDATED

    @classmethod
    def load(cls, folder: str | Path) -> Findings:
        """Read the report in a folder that `identify` or `trace` has written.

        Raises:
            InputError: there is no report, or it is not one of hydrojax.
        """
        path = Path(folder) / "report.json"
        try:
            report = json.loads(path.read_text(encoding="utf-8"))
            found = dict(report["parameters"])
            for effect in report["effects"]:
                own = effect["parameters"].items()
                found |= {f"{effect['name']}.{name}": p for name, p in own}
            names = tuple(effect["name"] for effect in report["effects"])
        except (OSError, ValueError, KeyError, TypeError) as err:
            raise InputError(
                f"{path}: no report of identify or trace: expected the folder that "
                "--out gave"
            ) from err
        full = report.get("covariance")
        covariance = (
            (tuple(full["names"]), np.array(full["matrix"], float)) if full else None
        )
        absent = tuple(
            c["name"] for c in report.get("candidates", ()) if c["status"] == "absent"
        )
        return cls(
            Path(folder), names, found, covariance, absent,
            _residual(report.get("channels", {})),
        )  # fmt: skip

    @property
    def fitted(self) -> bool:
        """Whether any parameter has a standard deviation."""
        return any(p.get("std") for p in self.parameters.values())

    def apply(self, setting: Setting) -> Setting:
        """The setting with the plant that was found; the controller as it was."""
        known = parameter_specs(setting.loop.rig)
        names = [
            n
            for n, p in self.parameters.items()
            if n in known and p.get("value") is not None
        ]
        if not names:
            return setting
        values = np.array([self.parameters[n]["value"] for n in names])
        rig = put(setting.loop.rig, names, values)
        return eqx.tree_at(lambda s: s.loop.rig, setting, rig)


def _residual(channels: Mapping[str, Mapping[str, Any]]) -> float:
    """The largest relative error that validation left; at most all of a signal."""
    shares = []
    for channel in channels.values():
        left = (channel.get("validate") or channel).get("after")
        held = (channel.get("validate") or channel).get("held") or channel.get("held")
        if left is not None and held:
            shares.append(min(left / held, 1.0))
    return max(shares, default=UNVALIDATED)
