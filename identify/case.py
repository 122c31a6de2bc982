"""A rig and its logs, read and prepared for a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import numpy as np

from hydrojax.effects import EFFECTS
from hydrojax.errors import InputError
from hydrojax.identify.preparation.data import Data, driver, prepare, runs_backward
from hydrojax.identify.preparation.noise import channel_noise
from hydrojax.identify.preparation.resolution import resolve
from hydrojax.identify.preparation.segments import common_band
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.jax_setup import make_room
from hydrojax.logs.log import Log
from hydrojax.parameters import specs
from hydrojax.rigfile.build import over_travel
from hydrojax.rigfile.schema import RigFile


@dataclass(frozen=True)
class Case:
    """A rig and its logs made ready: those that are fitted, and those that are not.

    Without validation logs the check is on the fitted ones, and `held_out` is False.
    """

    spec: RigFile
    fit: Data
    check: Data
    fit_logs: tuple[Log, ...]
    check_logs: tuple[Log, ...]
    held_out: bool
    criteria: Criteria = Criteria()


def open_case(
    rig: str | Path,
    logs: Sequence[str | Path],
    validate: Sequence[str | Path] = (),
    horizon: float = 0.25,
    criteria: Criteria = Criteria(),
) -> Case:
    """Read a rig file and its logs.

    Raises:
        InputError: whatever is wrong with them, in one line.
        RuntimeError: JAX is not in double precision.
    """
    if not jax.config.read("jax_enable_x64"):
        raise RuntimeError(
            "identification needs double precision: before anything else write "
            'jax.config.update("jax_enable_x64", True)'
        )
    make_room()
    spec = RigFile.load(rig)
    if not logs:
        raise InputError(f"{rig}: no log to fit: name at least one")
    fitted = tuple(Log.load(path, spec.channels) for path in logs)
    others = tuple(Log.load(path, spec.channels) for path in validate)
    again = {Path(p).resolve() for p in logs} & {Path(p).resolve() for p in validate}
    if again:
        raise InputError(
            f"{min(again)}: is among the logs to fit too: a check needs one that took "
            "no part in the fit"
        )
    per = [
        s for e in spec.effects for s in specs(EFFECTS[e]).values() if "{u}" in s.unit
    ]
    if not per and not any(n.startswith("c_") for n in spec.parameters):
        # Nothing in the rig file says what a command is: the logs do.
        unit = fitted[0].units.get("u", spec.command_unit)
        spec = replace(spec, command_unit=unit)
    for log in (*fitted, *others):
        unit = log.units.get("u", spec.command_unit)
        if unit != spec.command_unit:
            raise InputError(
                f"{log.name}: u is in [{unit}], but {rig} or another log is per "
                f"[{spec.command_unit}]: bring them to one unit"
            )
    every = (*fitted, *others)
    driven_by = driver(every, spec)
    band = common_band(every, spec, driven_by, criteria)
    noise = channel_noise(every, spec, driven_by)

    def ready(logs: Sequence[Log], noise: np.ndarray, sign: float = 1.0) -> Data:
        return prepare(logs, spec, horizon, noise, sign, band, criteria)

    fit = ready(fitted, noise)
    found = resolve(every, len(fitted), spec, fit, ready, criteria)
    fitted, others = found.logs[: len(fitted)], found.logs[len(fitted) :]
    fit, notes = found.fit, found.notes
    sign = -1.0 if runs_backward(fit, criteria) else 1.0
    if sign < 0:
        fit = ready(fitted, fit.noise, sign)
        notes = (
            *notes,
            "friction as logged drives the motion: the position runs against the "
            "rig's sign (P pushes toward positive v), so it was turned round; say so "
            "in the rig file with invert = true under [channels]",
        )
    spec = over_travel(spec, fit.travel)
    check = ready(others, fit.noise, sign) if others else fit
    said = (*notes, *fit.notes, *check.notes)
    fit = replace(fit, notes=tuple(dict.fromkeys(said)))
    return Case(spec, fit, check, fitted, others or fitted, bool(others), criteria)
