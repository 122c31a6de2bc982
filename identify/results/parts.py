"""Parts of an outcome: parameters, effects, residuals, the closed loop run again."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from hydrojax.control.simulation import simulate_loop
from hydrojax.effects import EFFECTS
from hydrojax.identify.inference.uncertainty import Uncertainty
from hydrojax.identify.preparation.data import Data
from hydrojax.identify.preparation.noise import CHANNELS
from hydrojax.identify.results.outcome import (
    FoundEffect,
    LogFile,
    LoopCheck,
    Parameter,
    Series,
    excess_of,
)
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.identify.tracing.state import Tracing
from hydrojax.logs.log import Log
from hydrojax.parameters import Spec, get, parameter_specs, put
from hydrojax.plant.places import hydraulic_names
from hydrojax.rigfile.build import build_loop, build_rig, inverts
from hydrojax.rigfile.edit import identified
from hydrojax.rigfile.recording import longest, rerun
from hydrojax.rigfile.schema import RigFile
from hydrojax.units import with_command

if TYPE_CHECKING:
    from hydrojax.identify.case import Case


def parameter_of(
    name: str, case: Case, state: Tracing, uncertainty: Uncertainty, spec: Spec
) -> tuple[str, Parameter]:
    """A parameter as reports show it: by its outside name where it has one."""
    value = float(state.point.values[state.problem.model.names.index(name)])
    free = name in state.free
    known = state.problem.free.get(name)
    start = known.start if known else value
    std = uncertainty.std.get(name)
    interval = None if std is None else (value - 1.96 * std, value + 1.96 * std)
    at_bound = free and name in uncertainty.ends
    unit = with_command(spec.unit, case.spec.command_unit)
    shown = name.rsplit(".", 1)[-1]
    if spec.outside:
        shown, unit = (
            spec.outside[0],
            with_command(spec.outside[1], case.spec.command_unit),
        )
        if std is not None and interval is not None and value > 0:
            ends = [1 / max(e, 1e-12) for e in interval]
            std, interval = std / value**2, (min(ends), max(ends))
        value = 1 / value if value else float("inf")
        start = 1 / start if start else float("inf")
    profile = uncertainty.profiles.get(name)
    if profile and spec.outside:
        profile = (1 / profile[1] if profile[1] else None,
                   1 / profile[0] if profile[0] else None)  # fmt: skip
    if interval and known and not spec.outside:
        interval = (max(interval[0], known.lower), min(interval[1], known.upper))
    return shown, Parameter(
        value, unit, spec.description, start, free, std, interval, at_bound,
        free and not at_bound and name not in uncertainty.unidentifiable, profile,
    )  # fmt: skip


def parameters_of(
    case: Case,
    state: Tracing,
    uncertainty: Uncertainty,
    tolerated: tuple[str, ...] = (),
) -> dict[str, Parameter]:
    """Base parameters and those of effects that the rig file declares, or that a stated
    tolerance accounts for.

    Without a valve the chambers do not take part, and are left out.
    """
    rig, out = state.problem.model.rig, {}
    unused = frozenset() if case.spec.layout.has_valve else hydraulic_names(rig)
    for name, spec in parameter_specs(rig).items():
        if name in unused:
            continue
        effect = name.split(".")[0] if "." in name else None
        if effect is None or effect in (*case.spec.effects, *tolerated):
            shown, p = parameter_of(name, case, state, uncertainty, spec)
            out[f"{effect}.{shown}" if effect else shown] = p
    return out


ALIASES: Mapping[str, tuple[str, ...]] = {
    "loadcell_gain": ("area", "area_1", "area_2"),
    "dead_volume": ("delta_1", "delta_2"),
    "viscous_friction": ("k_vp", "k_vn"),
}
"""Constants of a rig file with which an effect is exactly the same: a load cell's gain
with the areas, what stands beside a chamber with its length, friction with speed."""


def aliases(
    effect: str, found: Mapping[str, Parameter], spec: RigFile
) -> tuple[str, ...]:
    """The constants that a rig file holds, and an effect is exactly the same as with
    the parameters found.
    """
    share = found.get("s") if effect == "viscous_friction" else None
    if share is not None:  # in presliding k_vp and k_vn do nothing
        low = share.value - 0.5 if share.interval is None else share.interval[0]
        if low > 0:
            return ()
    held = {n for n, e in spec.parameters.items() if e.range is None}
    held |= set(spec.geometry)
    return tuple(n for n in ALIASES.get(effect, ()) if n in held)


def within_tolerance(effect: FoundEffect, spec: RigFile) -> tuple[str, ...]:
    """The areas in whose stated tolerances, at two standard deviations, an effect lies
    that is the same as all of them being off; none where it is beyond that of one.
    """
    if effect.name != "loadcell_gain":
        return ()
    areas = aliases(effect.name, effect.parameters, spec)
    size = abs(effect.parameters["eps"].value)
    within = all(
        size <= 2 * spec.tolerances.get(n, 0.0) / spec.geometry[n] for n in areas
    )
    return areas if within else ()


def named_effects(
    case: Case,
    state: Tracing,
    uncertainty: Uncertainty,
    errors: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]],
) -> tuple[FoundEffect, ...]:
    """The effects that were added, and what each did to the validation error.

    `errors` [3] are those before all of them and after, RMS, SI.
    """
    spec = parameter_specs(state.problem.model.rig)
    seen = [c for c in range(3) if np.isfinite(state.noise[c])]
    out = []
    # An effect counts up to where the next one came in, the last to the end:
    # the force is fitted only after the pressures have theirs.
    ends = [errors[0], *(a.before for a in state.added[1:]), errors[1]]
    # Until then it may be further off than it was before all of them.
    ends = [*np.minimum(ends[:-1], errors[0]), ends[-1]]
    excess = [sum(excess_of(e[c], state.noise[c]) for c in seen) for e in ends]
    for i, added in enumerate(state.added):
        own = [n for n in spec if n.startswith(f"{added.name}.")]
        parameters = dict(
            parameter_of(n, case, state, uncertainty, spec[n]) for n in own
        )
        out.append(
            FoundEffect(
                name=added.name,
                parameters=parameters,
                p_value=added.p_value,
                before={CHANNELS[c]: float(ends[i][c]) for c in seen},
                after={CHANNELS[c]: float(ends[i + 1][c]) for c in seen},
                cannot_tell_from=(
                    *added.cannot_tell_from,
                    *aliases(added.name, parameters, case.spec),
                ),
                residual_axis=EFFECTS[added.name].residual_axis,
                share=(excess[i] - excess[i + 1]) / max(excess[0], 1e-12),
            )
        )
    return tuple(out)


Signals = dict[str, Float[np.ndarray, "windows ticks"]]
"""Signals by name, SI."""


def signals_of(
    data: Data, scored: int, radius: float | None
) -> dict[str, Float[np.ndarray, "windows ticks"]]:
    """Signals a residual may correlate with, [W, T] each, at the compared ticks; SI."""
    w = data.windows
    lead = w.x.shape[1] - scored

    def rate(y):
        return np.gradient(y, axis=1) / w.h

    full = {"x": w.x, "v": w.v, "a": w.a, "t": w.t}
    if data.driven_by == "u":
        full |= {"u": w.u, "u_rate": rate(w.u), "abs(u)": np.abs(w.u)}
    if np.ptp(w.P_a2) > 0 and data.driven_by != "P":
        full |= {"P_a1 + P_a2": w.P_a1 + w.P_a2, "P_a1 - P_a2": w.P_a1 - w.P_a2}
    if radius:
        full["psi"] = w.x / radius
    out = {name: np.asarray(s[:, lead:]) for name, s in full.items()}
    F = np.asarray(w.measured[..., 2])
    if np.all(np.isfinite(F)) and np.ptp(F) > 0:
        out["F"] = F
    return out


def series_of(
    case: Case,
    before: Float[np.ndarray, "windows ticks 3"],
    after: Float[np.ndarray, "windows ticks 3"],
    signals: dict[str, Float[np.ndarray, "windows ticks"]],
    seen: list[int],
) -> tuple[Series, ...]:
    """One log's windows laid end to end, a NaN between those that do not adjoin."""
    data, out = case.check, []
    first = np.asarray(data.windows.first)
    seg, scored = np.asarray(data.windows.seg), before.shape[1]
    lead = data.windows.x.shape[1] - scored
    F = data.windows.measured
    for i, log in enumerate(case.check_logs):
        own = np.nonzero(data.log == i)[0]
        apart = [
            k
            for k, (a, b) in enumerate(zip(own[:-1], own[1:], strict=True))
            if seg[a] != seg[b] or first[b] != first[a] + scored
        ]

        def lay(y, own=own, apart=apart):
            rows = [
                np.append(y[j], np.nan) if k in apart else y[j]
                for k, j in enumerate(own)
            ]
            return np.concatenate(rows) if rows else np.zeros(0)

        names = {CHANNELS[c]: c for c in seen}
        out.append(
            Series(
                log=log.name,
                t=lay(np.asarray(data.windows.t)[:, lead:]),
                measured={n: lay(F[..., c]) for n, c in names.items()},
                before={n: lay(before[..., c]) for n, c in names.items()},
                after={n: lay(after[..., c]) for n, c in names.items()},
                signals={n: lay(s) for n, s in signals.items()},
            )
        )
    return tuple(out)


def check_loop(
    spec: RigFile,
    log: Log,
    values: dict[str, float],
    added: tuple[str, ...],
    criteria: Criteria = Criteria(),
) -> LoopCheck | None:
    """Put a log's F_d through the simulated loop and compare F with the measured F.

    The plant is the identified one with all named effects; the law is the paper's with
    the rig file's [controller], and knows the identified parameters. Motion and supply
    are the log's.

    Args:
        spec: the rig file.
        log: what is to be run again.
        values: every parameter by name, SI, as identified.
        added: effects beyond the declared ones.
        criteria: how much of the log is run, and what of it is not compared.

    Returns:
        None where there is no u, F or F_d, or a valve that the law cannot invert.
    """
    if not {"u", "F", "F_d"} <= set(log.signals) or not spec.layout.has_valve:
        return None
    if spec.law is None and not inverts(spec):
        return None
    known = identified(spec, values)
    rig = build_rig(known, added)
    names = tuple(parameter_specs(rig))
    own = np.asarray(get(rig, names))
    at = [values.get(n, v) for n, v in zip(names, own, strict=True)]
    rig = put(rig, names, np.array(at))
    loop = build_loop(known, rig)
    scenario, loop = rerun(known, loop, log, criteria.loop_seconds)
    if scenario is None:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # it is among the figures
        run = simulate_loop(loop, scenario)
    start, stop = longest(log)
    t = log.time[start:stop] - log.time[start]
    keep = (t >= criteria.loop_settle) & (t <= run.t[-1])
    desired, measured = (log.signals[n][start:stop][keep] for n in ("F_d", "F"))
    simulated = np.interp(t[keep], run.t, run["true_F"])

    def rms(y: np.ndarray) -> float:
        return float(np.sqrt(np.mean(y**2)))

    return LoopCheck(
        log=log.name,
        t=t[keep],
        desired=desired,
        measured=measured,
        simulated=simulated,
        rms=rms(measured - simulated),
        tracking_measured=rms(desired - measured),
        tracking_simulated=rms(desired - simulated),
        warning=run.warning(),
    )


def files_of(case: Case) -> tuple[LogFile, ...]:
    """The logs, by what they were for."""
    uses = {
        "fit": case.fit_logs,
        "validate": case.check_logs if case.held_out else (),
        "test": case.test_logs,
    }
    return tuple(
        LogFile(
            log.name, use, log.time.size, float(log.time[-1] - log.time[0]), log.sha256
        )
        for use, logs in uses.items()
        for log in logs
    )
