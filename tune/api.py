"""Sweeps and tunings of a rig: objects in, objects out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import xarray as xr
from jaxtyping import ArrayLike

from hydrojax.errors import InputError
from hydrojax.jax_setup import ensure_jax
from hydrojax.rigfile.other_controllers import with_controller
from hydrojax.rigfile.schema import RigFile
from hydrojax.tune import sweep as sweeps
from hydrojax.tune.accessor import Swept as Swept  # so that `data.hydrojax` is known
from hydrojax.tune.aims import Aim, Limits
from hydrojax.tune.axes import make_axes
from hydrojax.tune.comparison import compare_models, notes
from hydrojax.tune.ensemble import SPREAD, Plants, ensemble, with_unsaid
from hydrojax.tune.findings import Findings
from hydrojax.tune.free import check_starts, default_free, find_gain
from hydrojax.tune.limiting import what_limits
from hydrojax.tune.objective import Objective
from hydrojax.tune.optimize import edges, optimize_gains
from hydrojax.tune.plan import METHODS, Plan, with_excitations
from hydrojax.tune.proposal import propose, tolerance_of, try_before
from hydrojax.tune.result import Tuned
from hydrojax.tune.setup import DELAY, make_plants, open_rig, rig_file, with_room
from hydrojax.tune.verification import cap

PLANTS = 8
"""Plants of a tuning's ensemble by default."""

VALVE = ("valve_lag.tau", DELAY)
"""Quantities of effects that every tuned rig has, if only at zero."""

STARTS = 2
"""Descents of a tuning by default."""


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
        findings: folder of `identify` or `trace`: its plant is used in place of the
            file's, and its uncertainty in place of `spread`.
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
    found = Findings.load(findings) if findings else None
    setting, known = open_rig(file, gains, at, axes, found)
    over = make_axes(axes, known)
    those = make_plants(setting, plants, spread, found)
    plan = Plan(
        with_room(setting, those, over),
        over,
        known,
        tuple(m for m in METHODS if m in methods),
        those,
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
    aim: Aim | None = None,
    at: Mapping[str, float | str] | None = None,
    plants: int = PLANTS,
    spread: float = SPREAD,
    findings: str | Path | None = None,
    starts: int = STARTS,
    controller: str = "",
    progress: Callable[[str], None] = lambda _: None,
) -> Tuned:
    """Find the gains with which F follows F_d best on every plant of an ensemble.

    What the descents find is tried in simulated runs on all plants, the adaptation at
    work: joint locked and moving, steps, two amplitudes; from there gains are searched
    in these runs. Gains that oscillate, saturate or track worse than those before are
    not proposed.

    Args:
        rig: a rig file, or its path.
        free: names of the gains to tune; if none, `k_p`, `k_f`, `k_1`, the rates of
            adaptation, and `A_a` where a load moves: how much of the velocity is fed
            forward damps it, or drives it. The rates of friction change together.
        limits: what must be kept; `Limits()` if None.
        aim: what is made as large as it can be; `Following()` if None.
        at: values of other quantities: the operating point, and `amplitude`, at which
            bands are promised.
        plants: size of the ensemble, the rig among them.
        spread: relative half-width of the ensemble.
        findings: folder of `identify` or `trace`: its plant and its uncertainty are
            used in place of the file's plant and `spread`.
        starts: number of descents.
        controller: `adaptive`, `fixed`, `pi`, `linearizing` or `backstepping` in place
            of what the rig file names, from its first gains.
        progress: called with a line of text at each stage.

    Returns:
        The gains, what they give, and what limits them; or the gains as they were, and
        what stands in the way (`Tuned.obstacles`).

    Raises:
        InputError: an unknown name, or a value that its quantity cannot take.
    """
    ensure_jax()
    progress("read the rig")
    tuning = plan_tuning(
        rig, free, limits, aim=aim, at=at, plants=plants, spread=spread,
        findings=findings, controller=controller, progress=progress,
    )  # fmt: skip
    return _tuned(tuning, starts, progress)


class ToTune(NamedTuple):
    """What a tuning sets out from.

    Attributes:
        file: the rig file.
        objective: what is made as large as it can be, on which plants.
        plants: of the ensemble.
        findings: of an identification, if any.
        given: names of effects and parameters of which anything is said.
    """

    file: RigFile
    objective: Objective
    plants: Plants
    findings: Findings | None
    given: set[str]


def plan_tuning(
    rig: RigFile | str | Path,
    free: Sequence[str] = (),
    limits: Limits | None = None,
    *,
    aim: Aim | None = None,
    at: Mapping[str, float | str] | None = None,
    plants: int = PLANTS,
    spread: float = SPREAD,
    findings: str | Path | None = None,
    controller: str = "",
    progress: Callable[[str], None] = lambda _: None,
) -> ToTune:
    """What `tune_gains` does with the same arguments.

    Raises:
        InputError: see `tune_gains`.
    """
    file = with_controller(rig_file(rig), controller)
    found = Findings.load(findings) if findings else None
    setting, known = open_rig(file, None, at, (*free, *VALVE), found)
    names = tuple(free) or default_free(setting)
    chosen = [find_gain(known, name) for name in names]
    check_starts(setting, chosen)
    drawn_from = found if found and found.fitted else None
    those = make_plants(setting, plants, spread, drawn_from) or ensemble(setting, 1)
    given = {*file.effects, *file.parameters, *_named(at or {})}
    given |= {*found.effects, *found.absent, *found.parameters} if found else set()
    fitted = found.shown if found else ()
    those = with_unsaid(setting, those, given, fitted=fitted)
    setting = with_room(setting, those)
    progress("compile the loop")
    objective = Objective(setting, chosen, those, limits or Limits(), aim)
    return ToTune(file, objective, those, found, given)


def _named(at: Mapping[str, float | str]) -> set[str]:
    """What values of quantities say of effects and parameters."""
    return {name.partition(".")[0] for name in at}


def _tuned(tuning: ToTune, starts: int, progress: Callable[[str], None]) -> Tuned:
    """What is proposed for an objective."""
    file, objective, plants, findings, given = tuning
    chosen, start = objective.free, objective.initial()
    most = cap(objective, {"valve_lag", "valve_delay"} <= given)
    progress("try the present gains in runs")
    before = try_before(objective, most)
    objective.sound = before.sound
    optimum = optimize_gains(objective, starts, progress=progress)
    proposal = propose(objective, optimum, before, most, progress)
    gains = proposal.after.gains
    after = objective.evaluate(gains) if proposal.found else objective.before
    relaxed = what_limits(objective, optimum, progress)
    comparison = ()
    if findings and findings.effects:
        progress("compare with the old model")
        comparison = compare_models(findings, objective, gains, after)
    return Tuned(
        file,
        {q.name: float(g) for q, g in zip(chosen, gains, strict=True)},
        {q.name: q.unit for q in chosen},
        {q.name: float(g) for q, g in zip(chosen, start, strict=True)},
        objective.before,
        after,
        proposal,
        objective.hertz,
        optimum,
        relaxed,
        plants.description,
        objective.limits,
        objective.aim,
        tolerance_of(objective),
        float(objective.setting.amplitude),
        objective.trials.speed,
        objective.programs.run_by,
        edges(objective, gains),
        comparison,
        notes(objective, after, most),
    )
