"""Sweeps and tunings of a rig: objects in, objects out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from jaxtyping import ArrayLike

from hydrojax.errors import InputError
from hydrojax.jax_setup import ensure_jax
from hydrojax.rigfile.quantities import Quantity
from hydrojax.rigfile.schema import RigFile
from hydrojax.tune import sweep as sweeps
from hydrojax.tune.accessor import Swept as Swept  # so that `data.hydrojax` is known
from hydrojax.tune.adaptation import tune_adaptation
from hydrojax.tune.axes import make_axes
from hydrojax.tune.comparison import compare_models, notes
from hydrojax.tune.ensemble import SPREAD, Plants, ensemble
from hydrojax.tune.findings import Findings
from hydrojax.tune.free import adaptable, default_free, find_gain
from hydrojax.tune.limiting import what_limits, with_valve
from hydrojax.tune.objective import Limits, Objective
from hydrojax.tune.optimize import find_gains
from hydrojax.tune.plan import METHODS, Plan, with_excitations
from hydrojax.tune.result import Tuned
from hydrojax.tune.setup import make_plants, open_rig, rig_file

PLANTS = 8
"""Plants of a tuning's ensemble by default."""


def sweep(
    rig: RigFile | str | Path,
    axes: Mapping[str, ArrayLike | Sequence[float] | Sequence[str]],
    *,
    methods: Sequence[str] = ("linear",),
    gains: Mapping[str, object] | None = None,
    at: Mapping[str, float | str] | None = None,
    plants: int = 1,
    spread: float = SPREAD,
    findings: str | Path | None = None,
    frozen: bool = False,
    out: str | Path | None = None,
    progress: sweeps.Progress | None = None,
) -> xr.Dataset:
    """Map what the closed loop is worth over gains, plant, load and operating point.

    Args:
        rig: a rig file, or its path.
        axes: 1 to 4 quantities by name, each with its values: numbers (gains in the
            paper's units, all else SI) or texts with units, such as
            `{"k_p": np.linspace(0.2, 4, 48), "load.mass": ["50 kg", "100 kg"]}`.
        methods: of `linear` (the linearised loop), `multisine` and `noise` (the loop
            measured in simulation).
        gains: keys of [controller] that replace the file's.
        at: values of other quantities, such as `{"v": 0.01, "amplitude": "200 N"}`.
        plants: size of an ensemble of plants, the rig among them; 1 is the rig alone.
        spread: relative half-width of the ensemble.
        findings: folder of `identify` or `trace`; the ensemble is drawn from it.
        frozen: whether the adaptation is frozen while the loop is measured.
        out: a folder that keeps what is done, so that a sweep that was stopped goes on
            where it was; None keeps nothing.
        progress: called with the cells that are done, and their total number.

    Returns:
        Variables such as `linear_within_1dB` (Hz) and `multisine_rms_error` (N) over
        the axes, with units and descriptions; `data.hydrojax.plot()` draws them.

    Raises:
        InputError: an unknown name, a value that its quantity cannot take, or a folder
            that holds another sweep.
    """
    ensure_jax()
    plan = plan_sweep(
        rig, axes, methods=methods, gains=gains, at=at, plants=plants, spread=spread,
        findings=findings, frozen=frozen,
    )  # fmt: skip
    return sweeps.run_sweep(plan, None if out is None else Path(out), progress)


def plan_sweep(
    rig: RigFile | str | Path,
    axes: Mapping[str, ArrayLike | Sequence[float] | Sequence[str]],
    *,
    methods: Sequence[str] = ("linear",),
    gains: Mapping[str, object] | None = None,
    at: Mapping[str, float | str] | None = None,
    plants: int = 1,
    spread: float = SPREAD,
    findings: str | Path | None = None,
    frozen: bool = False,
) -> Plan:
    """What `sweep` does with the same arguments.

    Raises:
        InputError: see `sweep`.
    """
    for method in methods:
        if method not in METHODS:
            known = ", ".join(METHODS)
            raise InputError(f"invalid method {method!r}: expected one of {known}")
    file = rig_file(rig)
    setting, known = open_rig(file, gains, at, axes)
    found = Findings.load(findings) if findings and plants > 1 else None
    plan = Plan(
        setting,
        make_axes(axes, known),
        known,
        tuple(m for m in METHODS if m in methods),
        make_plants(setting, plants, spread, found),
        frozen,
        file.name,
        file.command_unit,
    )
    return with_excitations(plan)


def tune_gains(
    rig: RigFile | str | Path,
    free: Sequence[str] = (),
    limits: Limits | None = None,
    *,
    at: Mapping[str, float | str] | None = None,
    adaptation: bool = False,
    plants: int = PLANTS,
    spread: float = SPREAD,
    findings: str | Path | None = None,
    starts: int = 3,
    progress: Callable[[str], None] = lambda _: None,
) -> Tuned:
    """Find the gains that give the widest bandwidth on every plant of an ensemble.

    Args:
        rig: a rig file, or its path.
        free: names of the gains to tune; if none, `k_p`, `k_f`, `k_1`, and `A_a` where
            a load moves: how much of the velocity is fed forward damps it, or drives
            it.
        limits: what must be kept; `Limits()` if None.
        at: values of other quantities: the operating point.
        adaptation: whether rates and bounds of the adaptation are tuned afterwards.
        plants: size of the ensemble, the rig among them.
        spread: relative half-width of the ensemble.
        findings: folder of `identify` or `trace`: its plant and its uncertainty are
            used in place of the file's plant and `spread`.
        starts: number of descents.
        progress: called with a line of text at each stage.

    Returns:
        The gains, what they give, and what limits them.

    Raises:
        InputError: an unknown name, or a value that its quantity cannot take.
    """
    ensure_jax()
    progress("read the rig")
    file = rig_file(rig)
    found = Findings.load(findings) if findings else None
    setting, known = open_rig(file, None, at, free, found)
    names = tuple(free) or default_free(setting)
    chosen = [find_gain(known, name) for name in names]
    drawn_from = found if found and found.fitted else None
    those = make_plants(setting, plants, spread, drawn_from) or ensemble(setting, 1)
    limits = limits or Limits()
    progress("compile the loop")
    objective = Objective(setting, chosen, with_valve(setting, those), limits)
    rates = adaptable(known, setting) if adaptation else []
    return _tuned(file, objective, those, found, rates, starts, progress)


def _tuned(
    file: RigFile, objective: Objective, plants: Plants, findings: Findings | None,
    rates: list[Quantity], starts: int, progress: Callable[[str], None],
) -> Tuned:  # fmt: skip
    """The gains of an objective, and `rates` of the adaptation after them."""
    chosen, setting = objective.free, objective.setting
    optimum, objective, dropped = find_gains(objective, starts, progress)
    after = objective.evaluate(optimum.gains)
    relaxed = what_limits(objective, optimum, progress)
    gains = dict(zip(chosen, map(float, optimum.gains), strict=True))
    if rates:
        values, after["rms"] = tune_adaptation(
            objective, rates, optimum.gains, progress
        )
        gains |= dict(zip(rates, map(float, values), strict=True))
    comparison = ()
    if findings and findings.effects:
        progress("compare with the old model")
        comparison = compare_models(file, findings, objective, optimum, plants, after)
    return Tuned(
        file,
        {q.name: value for q, value in gains.items()},
        {q.name: q.unit for q in gains},
        {q.name: float(q.get(setting)) for q in gains},
        objective.before,
        after,
        np.asarray(objective.hertz),
        optimum,
        relaxed,
        plants.description,
        objective.limits,
        comparison,
        (*dropped, *notes(objective, after)),
    )
