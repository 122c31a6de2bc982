"""Tuning from files and words: what the command line calls."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hydrojax.errors import InputError
from hydrojax.plant.load import Inertia
from hydrojax.plant.named import parameter_specs, put
from hydrojax.rigfile.build import build_rig
from hydrojax.rigfile.controller import KEYS
from hydrojax.rigfile.quantities import (
    Quantity,
    Setting,
    find,
    open_setting,
    quantities,
)
from hydrojax.rigfile.schema import RigFile
from hydrojax.tune import axes, optimize, result
from hydrojax.tune.axes import Plants
from hydrojax.tune.objective import Goal, Limits
from hydrojax.tune.plan import make_plants, placed

PLANTS = 8
"""Plants of an ensemble where nothing else is said."""


def tune(
    source: Path,
    rig: Path | None = None,
    free: Sequence[str] = (),
    at: Sequence[str] = (),
    adaptation: bool = False,
    count: int = PLANTS,
    spread: float = axes.SPREAD,
    limits: Limits | None = None,
    starts: int = 3,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[result.Tuned, Path]:
    """Tune a rig file, or what `trace` or `identify` found of one.

    Args:
        source: a rig file, or a folder with `report.json`.
        rig: the rig file of such a folder that holds no `rig.toml`.
        free: gains to tune; `outcome.FREE` if none, and `A_a` where a load moves:
            how much of the velocity is fed forward damps it, or drives it.
        at: `name=value` words: the operating point.
        adaptation: whether rates and bounds of the adaptation are tuned after them.
        count: of the ensemble's plants.
        spread: of the ensemble around a rig file; a folder's is its own.
        limits: what must be kept.
        starts: descents.
        progress: called with a line of text at each stage.

    Returns:
        What was found, and the rig file that it is about.

    Raises:
        InputError: files, names or values that will not do.
    """
    progress("read the rig")
    folder = source if source.is_dir() else None
    path = _rig_file(source, rig)
    spec = RigFile.load(path)
    report = _report(folder) if folder else {}
    named = _effects(report)
    setting = open_setting(spec, None, (*named, *(w.partition("=")[0] for w in at)))
    setting = _as_found(setting, report)
    known = quantities(spec, setting)
    setting = placed(setting, known, at)
    free = tuple(free) or _default_free(setting)
    chosen = [_gain(known, name) for name in free]
    plants = make_plants(setting, count, spread, folder if _fitted(report) else None)
    plants = plants or axes.ensemble(setting, 1)
    limits = limits or Limits()
    progress("compile the loop")
    goal = Goal(setting, chosen, result.widen(setting, plants), limits)
    found, dropped = _found(goal, starts, progress)
    gains = dict(zip(free, map(float, found.gains), strict=True))
    start = {q.name: float(q.get(setting)) for q in chosen}
    units = {q.name: q.unit for q in chosen}
    after = goal.look(found.gains)
    if dropped:
        goal = goal.relaxed(limits=_loose(goal.limits))
    relaxed = result.what_limits(goal, found, progress)
    more = _adaptable(known, setting) if adaptation else []
    if more:
        values = result.adapt(goal, more, found.gains, progress)
        inner = result.copy_with(goal, goal.at(found.gains), more)
        after["rms"] = inner.run(values)
        gains |= {q.name: float(v) for q, v in zip(more, values, strict=True)}
        start |= {q.name: float(q.get(setting)) for q in more}
        units |= {q.name: q.unit for q in more}
    promises = ()
    if named:
        progress("what the old model promised")
        promises = _promises(spec, named, goal, found, start, chosen, plants, after)
    tuned = result.Tuned(
        spec.name, gains, units, start, goal.before, after, np.asarray(goal.hertz),
        found, relaxed, plants.says, goal.limits, promises,
        (*dropped, *_notes(goal, after)),
    )  # fmt: skip
    return tuned, path


def _loose(limits: Limits) -> Limits:
    return replace(limits, tracking=1e3, rejection=1e-2)


def _found(
    goal: Goal, starts: int, progress: Callable[[str], None]
) -> tuple[optimize.Found, tuple[str, ...]]:
    """The gains, and what had to be given up for there to be any."""
    found = optimize.tune(goal, starts, progress=progress)
    if found.kept:
        return found, ()
    free = goal.relaxed(limits=_loose(goal.limits))
    other = optimize.tune(free, starts, progress=progress, begin=0.3 * goal.here())
    if min(other.slack.values()) <= min(found.slack.values()):
        return found, ()
    return other, (
        "No gains keep the peak and the margins and also track and reject as was "
        "asked: tracking and rejection were given up.",
    )


def _default_free(setting: Setting) -> tuple[str, ...]:
    moves = isinstance(setting.loop.load, Inertia)
    return (*result.FREE, "A_a") if moves else result.FREE


def _gain(known: dict[str, Quantity], name: str) -> Quantity:
    """A quantity that a controller can be given."""
    quantity = find(known, name, "--free")
    key = name
    for end in ("_hat", "_lower", "_upper"):
        key = key.removesuffix(end)
    if key not in KEYS or (quantity.reach is None) or name == "rate":
        raise InputError(
            f"--free {name}: is no gain of the law; name k_p, k_f, k_1, tau_d, A_a …"
        )
    return quantity


def _rig_file(source: Path, rig: Path | None) -> Path:
    if not source.is_dir():
        return source
    if rig is not None:
        return rig
    if (source / "rig.toml").exists():
        return source / "rig.toml"
    raise InputError(
        f"{source}: no rig.toml in it; name the rig file that was traced with --rig"
    )


def _report(folder: Path) -> dict[str, Any]:
    path = folder / "report.json"
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        if {"parameters", "effects"} <= set(report):
            return report
    except (OSError, ValueError) as err:
        raise InputError(
            f"{path}: no report of identify or trace; name the folder --out gave"
        ) from err
    raise InputError(f"{path}: is no report of hydrojax; name another folder")


def _effects(report: dict[str, Any]) -> list[str]:
    """Names of the effects that were added."""
    return [effect["name"] for effect in report.get("effects", [])]


def _fitted(report: dict[str, Any]) -> bool:
    return any(p.get("std") for p in report.get("parameters", {}).values())


def _as_found(setting: Setting, report: dict[str, Any]) -> Setting:
    """The setting with the plant that the report found; the law as it was."""
    if not report:
        return setting
    known = parameter_specs(setting.loop.rig)
    found = dict(report["parameters"])
    for effect in report["effects"]:
        own = effect["parameters"].items()
        found |= {f"{effect['name']}.{n}": p for n, p in own}
    names = [n for n, p in found.items() if n in known and p.get("value") is not None]
    if not names:
        return setting
    values = np.array([found[n]["value"] for n in names])
    rig = put(setting.loop.rig, names, values)
    return eqx.tree_at(lambda s: s.loop.rig, setting, rig)


def _adaptable(known: dict[str, Quantity], setting: Setting) -> list[Quantity]:
    """What of the adaptation is at work and above 0."""
    chosen = [known[n] for n in result.ADAPTATION]
    return [q for q in chosen if float(q.get(setting)) > 0]


def _promises(
    spec: RigFile, named: list[str], goal: Goal, found: optimize.Found,
    start: dict[str, float], chosen: list[Quantity], plants: Plants,
    after: dict[str, np.ndarray],
) -> tuple[tuple[str, dict[str, float]], ...]:  # fmt: skip
    """The rig's own merits without and with what trace added."""
    old_spec = replace(
        spec, effects={n: e for n, e in spec.effects.items() if n not in named}
    )
    rig = build_rig(old_spec)
    here = goal.at(None)
    values = parameter_specs(rig)
    from hydrojax.plant.named import get

    names = [n for n in values]
    rig = put(rig, names, get(here.loop.rig, names))
    old = eqx.tree_at(lambda s: s.loop.rig, here, rig)
    only = [i for i, n in enumerate(plants.names) if n in values]
    few = Plants(
        tuple(plants.names[i] for i in only), plants.values[:1, only], plants.says
    )
    other = Goal(old, chosen, few, goal.limits)
    added = ", ".join(n.replace("_", " ") for n in named)
    return (
        (f"old model (without {added}), gains before", result.own(other.before)),
        ("mended model, gains before", result.own(goal.before)),
        ("old model, the new gains", result.own(other.look(found.gains))),
        ("mended model, the new gains", result.own(after)),
    )


def _notes(goal: Goal, after: dict[str, np.ndarray]) -> tuple[str, ...]:
    notes = []
    if not np.isfinite(goal.before["peak"]).all():
        notes.append("With the gains before, some plants of the ensemble are unstable.")
    rms = goal.before["rms"]
    if np.max(rms) > 5 * rms[0]:
        notes.append(
            f"With the gains before, tracking on one plant is {np.max(rms):.0f} N, "
            f"the rig's own {rms[0]:.1f} N: with the joint moving its loop is at or "
            "beyond the edge, which a linearised loop at rest does not show."
        )
    load = goal.setting.loop.load
    if isinstance(load, Inertia) and float(load.stiffness) > 0:
        at = float(jnp.sqrt(load.stiffness / load.mass)) / 2 / np.pi
        was, now = (
            20 * np.log10(np.interp(at, goal.hertz, np.abs(f["response"][0])))
            for f in (goal.before, after)
        )
        notes.append(
            f"At {at:.1f} Hz, the load's own frequency, it moves under next to no "
            f"force: |F/F_d| is {was:.1f} dB before and {now:.1f} dB after. No gain of "
            "this law fills that; more damping of the load does."
        )
    if not float(jnp.sum(goal.setting.loop.sensors.F)):
        notes.append("The rig file gives no noise of F: noise limits nothing here.")
    wide = np.asarray(after["within_1dB"])
    if np.max(wide) > 1.8 * np.min(wide):
        notes.append(
            f"Within 1 dB up to {wide[0]:.1f} Hz on the rig itself: the worst plant of "
            "the ensemble sets the promise."
        )
    return tuple(notes)
