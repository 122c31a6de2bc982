"""A sweep and a tuning from files and words: what the command line calls."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import xarray as xr

from hydrojax.errors import InputError
from hydrojax.rigfile.quantities import (
    Quantity,
    Setting,
    find,
    open_setting,
    quantities,
)
from hydrojax.rigfile.schema import RigFile
from hydrojax.tune import axes, sweep
from hydrojax.tune.axes import Plants
from hydrojax.tune.swept import (
    sentences as sentences,  # and so `data.hydrojax` is known
)


def open_rig(
    path: Path,
    gains: Mapping[str, object] | None = None,
    at: Sequence[str] = (),
    over: Sequence[str] = (),
) -> tuple[RigFile, Setting, dict[str, Quantity]]:
    """A rig file as a loop at an operating point, and what can be named in it.

    Args:
        path: the rig file.
        gains: keys of [controller] that replace the file's.
        at: `name=value` words that set other quantities, the operating point above
            all.
        over: axes in words: the effects they name are put in.

    Raises:
        InputError: the file, a name or a value that will not do.
    """
    spec = RigFile.load(path)
    named = [word.partition("=")[0].strip() for word in (*at, *over)]
    setting = open_setting(spec, gains, named)
    known = quantities(spec, setting)
    return spec, placed(setting, known, at), known


def placed(
    setting: Setting, known: Mapping[str, Quantity], at: Sequence[str]
) -> Setting:
    """A setting with quantities set by `name=value` words.

    Raises:
        InputError: a name or a value that will not do.
    """
    for word in at:
        name, sign, text = word.partition("=")
        where = f"--at {word!r}"
        if not sign or not text.strip():
            raise InputError(f"{where}: write NAME=VALUE, such as v=0.01")
        quantity = find(known, name.strip(), where)
        setting = quantity.put(setting, quantity.number(text.strip(), where))
    return setting


def make_plants(
    setting: Setting, count: int, spread: float, folder: Path | None
) -> Plants | None:
    """An ensemble as asked for; None for the rig alone."""
    if count < 2:
        return None
    if folder is not None:
        return axes.from_report(setting, folder, count)
    return axes.ensemble(setting, count, spread)


def plan_sweep(
    rig: Path,
    over: Sequence[str],
    by: Sequence[str] = ("linear",),
    gains: Mapping[str, object] | None = None,
    at: Sequence[str] = (),
    count: int = 0,
    spread: float = axes.SPREAD,
    report: Path | None = None,
    frozen: bool = False,
) -> sweep.Plan:
    """What a sweep of a rig file does; see the command line's help for the words.

    Raises:
        InputError: words that will not do.
    """
    for way in by:
        if way not in sweep.METHODS:
            raise InputError(f"--by {way!r}: write one of {', '.join(sweep.METHODS)}")
    spec, setting, known = open_rig(rig, gains, at, over)
    plan = sweep.Plan(
        setting,
        axes.read_axes(over, known),
        known,
        tuple(m for m in sweep.METHODS if m in by),
        make_plants(setting, count, spread, report),
        frozen,
        spec.name,
        spec.command_unit,
    )
    return sweep.prepare(plan)


def sweep_rig(
    rig: Path,
    over: Sequence[str],
    by: Sequence[str] = ("linear",),
    gains: Mapping[str, object] | None = None,
    at: Sequence[str] = (),
    count: int = 0,
    spread: float = axes.SPREAD,
    report: Path | None = None,
    frozen: bool = False,
    out: Path | None = None,
    progress: sweep.Progress | None = None,
) -> xr.Dataset:
    """Sweep a rig file; see the command line's help for the words.

    Raises:
        InputError: words that will not do, or a folder that holds another sweep.
    """
    plan = plan_sweep(rig, over, by, gains, at, count, spread, report, frozen)
    return sweep.run(plan, out, progress)


Progress = Callable[[str], None]
