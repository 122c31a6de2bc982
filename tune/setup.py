"""A rig at its operating point, with its quantities by name and its ensemble."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import equinox as eqx

from hydrojax.errors import COUNT, InputError
from hydrojax.rigfile.build import with_queues
from hydrojax.rigfile.quantities import (
    Quantity,
    Setting,
    find,
    open_setting,
    quantities,
)
from hydrojax.rigfile.schema import RigFile
from hydrojax.tune.axes import Axis
from hydrojax.tune.ensemble import Plants, ensemble, from_findings
from hydrojax.tune.findings import Findings

DELAY = "valve_delay.tau_u"


def rig_file(rig: RigFile | str | Path) -> RigFile:
    """A rig file that may be given by its path.

    Raises:
        InputError: the file cannot be read, or is none.
    """
    return rig if isinstance(rig, RigFile) else RigFile.load(rig)


def open_rig(
    rig: RigFile,
    gains: Mapping[str, object] | None = None,
    at: Mapping[str, float | str] | None = None,
    named: Iterable[str] = (),
    findings: Findings | None = None,
) -> tuple[Setting, dict[str, Quantity]]:
    """A rig as a loop at an operating point, and what can be named in it.

    Args:
        rig: the rig file.
        gains: keys of [controller] that replace the file's.
        at: values of other quantities, the operating point above all.
        named: names of further quantities: the effects they belong to are put in.
        findings: of `identify` or `trace`: the plant is the one they found.

    Raises:
        InputError: an unknown name, or a value that its quantity cannot take.
    """
    at = at or {}
    added = findings.effects if findings else ()
    setting = open_setting(rig, gains, [*added, *at, *named])
    setting = findings.apply(setting) if findings else setting
    known = quantities(rig, setting)
    for name, value in at.items():
        quantity = find(known, name, f"at {name}")
        setting = quantity.put(setting, quantity.number(value, f"at {name}"))
    return setting, known


def make_plants(
    setting: Setting, count: int, spread: float, findings: Findings | None
) -> Plants | None:
    """An ensemble of so many plants; None for the rig alone.

    Raises:
        InputError: nothing in the findings was fitted, or `count` is below 1.
    """
    if not 1 <= count <= COUNT:
        raise InputError(f"invalid number of plants {count}: expected 1 to {COUNT}")
    if count < 2:
        return None
    if findings is not None:
        return from_findings(setting, findings, count)
    return ensemble(setting, count, spread)


def with_room(
    setting: Setting, plants: Plants | None, axes: Sequence[Axis] = ()
) -> Setting:
    """The setting with a valve delay that can become as long as it will be.

    A delay remembers a fixed number of commands, which the rig file's own `tau_u` and
    rate have set; what is put in their place later may need more.

    Args:
        setting: with its effects and its operating point put in.
        plants: the ensemble, if there is one.
        axes: of a sweep.
    """
    swept = {axis.name: axis.values for axis in axes}
    h = min([float(setting.loop.h), *(1 / rate for rate in swept.get("rate", ()))])
    longest = [0.0, *swept.get(DELAY, ())]
    if plants is not None and DELAY in plants.names:
        longest.extend(plants.values[:, plants.names.index(DELAY)])
    # A tuning's loops have to be stable with part of a sample more.
    rig = with_queues(setting.loop.rig, h, float(max(longest)) + h)
    return eqx.tree_at(lambda s: s.loop.rig, setting, rig)
