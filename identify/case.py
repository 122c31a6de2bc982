"""A rig and its logs, read and prepared for a fit."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
from jaxtyping import Float

from hydrojax.effects import EFFECTS
from hydrojax.errors import InputError, one_line
from hydrojax.identify.preparation.data import Data, driver, prepare_logs, runs_backward
from hydrojax.identify.preparation.jolts import without_jolts
from hydrojax.identify.preparation.noise import channel_noise
from hydrojax.identify.preparation.resolution import NoiseBy, resolve
from hydrojax.identify.preparation.segments import common_band
from hydrojax.identify.preparation.strays import without_strays
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.logs.log import Log
from hydrojax.logs.tables import Channel
from hydrojax.parameters import specs
from hydrojax.programs import compiled
from hydrojax.programs.compiled import make_room
from hydrojax.rigfile.build import build_rig, over_travel
from hydrojax.rigfile.schema import RigFile

RigSource = str | Path | RigFile
"""A rig file by its path, or one that is read already."""

LogSource = str | Path | Log | pd.DataFrame | Mapping[str, Any]
"""A log by its path, one that is read already, or a table (a dict of columns is one);
see `Log.from_frame`."""


@dataclass(frozen=True)
class Preparation:
    """How the logs of a case were made ready, so that others can be in the same way.

    Attributes:
        spec: the rig.
        horizon: length of a replay window, s.
        noise: [3] of the channels, SI; inf if not compared.
        sign: -1.0 if the motion is turned round, else 1.0.
        band: Hz up to which motion is differentiated.
        criteria: the thresholds.
        smoothed: takes the noise off what drives a log, and rows that do not tell how
            the position moved.
        still: m within which a position is taken to rest; see `prepare_logs`.
    """

    spec: RigFile
    horizon: float
    noise: Float[np.ndarray, "3"]
    sign: float
    band: float
    criteria: Criteria
    smoothed: Callable[[Log], Log] = lambda log: log
    still: float = 0.0

    def data(self, logs: Sequence[Log]) -> Data:
        """Logs that take no part in the fit, made ready.

        Raises:
            InputError: see `prepare_logs`.
        """
        return prepare_logs(
            [self.smoothed(log) for log in logs],
            self.spec,
            self.horizon,
            self.noise,
            self.sign,
            self.band,
            self.criteria,
            still=self.still,
        )


@dataclass(frozen=True)
class Case:
    """A rig and its logs made ready.

    Attributes:
        spec: the rig.
        fit: the logs that are fitted, made ready.
        check: the validation logs, made ready; the fitted ones where there are none.
        fit_logs: the logs that are fitted.
        check_logs: the validation logs, or the fitted ones.
        held_out: whether there are validation logs.
        preparation: how they were made ready.
        test: logs that take part in no decision, made ready, if there are any.
        test_logs: these logs.
        as_read: the logs to fit, to validate and to test, as they were read.
        noise_by: the channels' noise by a model that was found, where the position's
            own noise is counted into it; None where it is not.
        twice: the logs to fit as they are and with their position measured once more,
            made ready, where its noise shows.
    """

    spec: RigFile
    fit: Data
    check: Data
    fit_logs: tuple[Log, ...]
    check_logs: tuple[Log, ...]
    held_out: bool
    preparation: Preparation
    test: Data | None = None
    test_logs: tuple[Log, ...] = ()
    as_read: tuple[tuple[Log, ...], ...] = ((), (), ())
    noise_by: NoiseBy | None = None
    twice: tuple[Data, Data] | None = None

    @property
    def criteria(self) -> Criteria:
        """The thresholds by which it is decided."""
        return self.preparation.criteria

    @property
    def read_logs(self) -> tuple[Log, ...]:
        """The logs that are fitted, as they were read."""
        return self.as_read[0]

    def again(
        self,
        spec: RigFile,
        logs: Sequence[Sequence[Log]],
        horizon: float | None = None,
    ) -> Case:
        """The case with another rig file, and its logs as that reads them.

        Args:
            spec: the rig file.
            logs: to fit, to validate and to test.
            horizon: length of a window, s; None for the case's own.

        Raises:
            InputError: see `open_case`.
        """
        fit, validate, test = (tuple(group) for group in logs)
        length = self.preparation.horizon if horizon is None else horizon
        return _prepared(spec, fit, validate, test, length, self.criteria)


def open_case(
    rig: RigSource,
    logs: Sequence[LogSource],
    validate: Sequence[LogSource] = (),
    test: Sequence[LogSource] = (),
    *,
    horizon: float = 0.25,
    criteria: Criteria = Criteria(),
) -> Case:
    """Read a rig file and its logs.

    A log that is a path or a table is read with the rig file's [channels]; a `Log`
    must have been.

    Args:
        rig: the rig file.
        logs: to be fitted.
        validate: logs that take no part in the fit, and decide what is added to it.
        test: logs that take part in no decision; only errors are reported of them.
        horizon: length of a replay window, s.
        criteria: the thresholds by which it is decided.

    Raises:
        InputError: whatever is wrong with them, in one line.
        RuntimeError: JAX is not in double precision.
    """
    if not jax.config.read("jax_enable_x64"):
        raise RuntimeError(
            "identification needs double precision: before anything else write "
            'jax.config.update("jax_enable_x64", True)'
        )
    spec = rig if isinstance(rig, RigFile) else RigFile.load(rig)
    if not logs:
        raise InputError(f"{spec.path}: no log to fit: name at least one")
    _refuse_shared(logs, validate, test)
    fitted, others, tests = (
        tuple(read(log, spec) for log in group) for group in (logs, validate, test)
    )
    spec = _with_command_unit(spec, (*fitted, *others, *tests))
    driver((*fitted, *others, *tests), spec)
    _make_room(spec, fitted)
    return _prepared(spec, fitted, others, tests, horizon, criteria)


Structure = tuple[str | frozenset[str], ...]
"""What rigs have in common that run the same programs, or nearly."""

_BEFORE: list[Structure] = []
"""Of the case that was opened last in this process."""


def _make_room(spec: RigFile, logs: Sequence[Log]) -> None:
    """Let go of compiled programs that another structure of rig left behind."""
    names = (spec.effects, spec.parameters, logs[0].signals)
    own: Structure = (spec.layout.name, *map(frozenset, names))
    make_room(held=math.inf if own in _BEFORE else compiled.HELD)
    _BEFORE[:] = [own]


def read(log: LogSource, spec: RigFile) -> Log:
    """A log of a rig, from wherever it is.

    Raises:
        InputError: see `Log.load`; or a `Log` that was read without the rig file's
            [channels], so that signals may be missing or have the other sign; or what
            is no log.
    """
    if isinstance(log, Log):
        applied = spec.channels if log.channels is None else log.channels
        if lacking := _named(spec.channels) - _named(applied):
            names = ", ".join(sorted(name for name, _ in lacking))
            raise InputError(
                f"{log.name}: read without [channels] {names} of {spec.path}: "
                "read it with Log.load(path, rig.channels), or give its path in place "
                "of the Log"
            )
        return log
    if isinstance(log, Mapping):
        try:
            log = pd.DataFrame(log)
        except ValueError as reason:  # columns of several lengths
            raise InputError(f"log: {one_line(str(reason))}") from reason
    if isinstance(log, pd.DataFrame):
        return Log.from_frame(log, channels=spec.channels)
    if not isinstance(log, (str, os.PathLike)):
        raise InputError(
            f"log: a {type(log).__name__} is not one; give a path, a DataFrame, a dict "
            "of columns (both with units in their names, as 'time [s]'), or a Log"
        )
    return Log.load(log, spec.channels)


def _named(channels: Mapping[str, Channel]) -> set[tuple[str, Channel]]:
    """The channels that are not simply the column of the signal's own name."""
    return {(n, c) for n, c in channels.items() if c != Channel(column=n)}


def _refuse_shared(*groups: Sequence[LogSource]) -> None:
    """Refuse a log that stands in two of the groups."""
    seen: list[object] = []
    for group in groups:
        own = [Path(g).resolve() if isinstance(g, (str, Path)) else g for g in group]
        for log in own:
            if any(log is other or _same_path(log, other) for other in seen):
                name = getattr(log, "name", "a table") if not _path(log) else str(log)
                raise InputError(
                    f"{name}: is among the logs to fit or validate too: a check needs "
                    "one that took no part in the fit"
                )
        seen += own


def _path(log: object) -> bool:
    return isinstance(log, Path)


def _same_path(log: object, other: object) -> bool:
    return _path(log) and _path(other) and log == other


def _with_command_unit(spec: RigFile, logs: Sequence[Log]) -> RigFile:
    """The rig with the logs' unit of the command where its file does not give one.

    Raises:
        InputError: logs whose commands are in another unit.
    """
    per = [
        s for e in spec.effects for s in specs(EFFECTS[e]).values() if "{u}" in s.unit
    ]
    if not per and not any("{u}" in spec.base[name].unit for name in spec.parameters):
        unit = logs[0].units.get("u", spec.command_unit)
        spec = replace(spec, command_unit=unit)
    for log in logs:
        unit = log.units.get("u", spec.command_unit)
        if unit != spec.command_unit:
            raise InputError(
                f"{log.name}: u is in [{unit}], but {spec.path} or another log is per "
                f"[{spec.command_unit}]: bring them to one unit"
            )
    return spec


def _follower(
    spec: RigFile, noise: Float[np.ndarray, "3"], driven_by: str
) -> Callable[[Log], Log]:
    """What leaves out of a log the rows that do not tell how the position moved."""
    if driven_by != "u":
        return lambda log: log
    return partial(without_jolts, spec=spec, rig=build_rig(spec), noise=noise)


def _prepared(
    spec: RigFile,
    fitted: tuple[Log, ...],
    others: tuple[Log, ...],
    tests: tuple[Log, ...],
    horizon: float,
    criteria: Criteria,
) -> Case:
    """The logs made ready; `tests` take no part in how."""
    as_read = (fitted, others, tests)
    fitted, others, tests = (tuple(map(without_strays, group)) for group in as_read)
    every = (*fitted, *others)
    driven_by = driver(every, spec)
    band = common_band(every, spec, driven_by, criteria)
    noise = channel_noise(every, spec, driven_by)
    followed = _follower(spec, noise, driven_by)
    fitted, others = (tuple(map(followed, group)) for group in (fitted, others))
    every = (*fitted, *others)

    def ready(
        logs: Sequence[Log],
        noise: np.ndarray,
        sign: float = 1.0,
        placed: Sequence[Log] | None = None,
        still: float = 0.0,
    ) -> Data:
        return prepare_logs(
            logs, spec, horizon, noise, sign, band, criteria, placed, still
        )

    fit = ready(fitted, noise)
    found = resolve(every, len(fitted), spec, fit, ready, criteria)
    fitted, others = found.logs[: len(fitted)], found.logs[len(fitted) :]
    fit, notes, still = found.fit, found.notes, found.still
    sign = -1.0 if runs_backward(fit, criteria) else 1.0
    if sign < 0:
        fit = ready(fitted, fit.noise, sign, still=still)
        way = "P pushes toward positive v"
        if not spec.layout.driven:
            way = "friction makes F negative where v is positive"
        notes = (
            *notes,
            "friction as logged drives the motion: the position runs against the "
            f"rig's sign ({way}), so it was inverted; write "
            "invert = true under [channels] of the rig file",
        )
    check = ready(others, found.check_noise, sign, still=still) if others else fit
    said = (*notes, *fit.notes, *check.notes)
    fit = replace(fit, notes=tuple(dict.fromkeys(said)))
    spec = over_travel(spec, fit.travel)
    own = Preparation(
        spec, horizon, check.noise, sign, band, criteria,
        lambda log: found.smoothed(followed(log)), still,
    )  # fmt: skip
    return Case(
        spec, fit, check, fitted, others or fitted, bool(others), own,
        own.data(tests) if tests else None, tests, as_read, found.noise_by,
        found.twice,
    )  # fmt: skip
