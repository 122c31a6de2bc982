"""From the end of a fit or a trace to an `Outcome`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hydrojax.effects import EFFECTS
from hydrojax.identify.estimation.fit import Point
from hydrojax.identify.inference.uncertainty import Uncertainty
from hydrojax.identify.preparation.data import Data
from hydrojax.identify.preparation.noise import CHANNELS
from hydrojax.identify.results import describe
from hydrojax.identify.results.extrapolation import extrapolation
from hydrojax.identify.results.outcome import (
    Candidate,
    Channel,
    Covariance,
    Effect,
    Outcome,
    Parameter,
    Series,
    Unexplained,
)
from hydrojax.identify.tracing.loop import status
from hydrojax.identify.tracing.score import family
from hydrojax.identify.tracing.state import Tracing
from hydrojax.parameters import Spec
from hydrojax.plant.named import parameter_specs
from hydrojax.rigfile.schema import SUPPLY
from hydrojax.units import with_command

if TYPE_CHECKING:
    from hydrojax.identify.case import Case

UNITS = ("Pa", "Pa", "N")


def summarise(
    command: str, case: Case, state: Tracing, base: Point, uncertainty: Uncertainty
) -> Outcome:
    """All that was found, from the state a run ended in, its base fit, and the
    uncertainty of its parameters.
    """
    seen = [c for c in range(3) if np.isfinite(state.noise[c])]
    declared = state.check.initial_values() if command == "identify" else base.values
    before = state.check.residuals_at(declared)
    after = state.check.residuals_at(state.point.values)
    errors = tuple(np.sqrt(np.mean(r**2, axis=(0, 1))) for r in (before, after))
    channels = {
        CHANNELS[c]: Channel(
            UNITS[c],
            float(state.noise[c]),
            float(errors[0][c]),
            float(errors[1][c]),
        )
        for c in seen
    }
    signals = _signals(case.check, before.shape[1], case.spec.geometry.get("radius"))
    tick = float(np.median(case.check.windows.h))
    left = tuple(
        describe.unexplained(
            name,
            ch.unit,
            ch.noise,
            after[..., CHANNELS.index(name)],
            signals,
            tick,
            state.criteria,
        )
        for name, ch in channels.items()
        if ch.after > state.criteria.at_noise * ch.noise
    )
    verdict = "unknown" if left else "explained" if state.added else "nothing missing"
    needed = (
        extrapolation(state, uncertainty.unidentifiable)
        if left and case.held_out
        else ()
    )
    effects = _effects(case, state, uncertainty, (errors[0], errors[1]))
    return Outcome(
        command=command,
        rig=case.spec.name,
        fit_logs=tuple(log.name for log in case.fit_logs),
        validate_logs=tuple(log.name for log in case.check_logs),
        verdict=verdict,
        sentence=_sentence(command, verdict, effects, left, case.held_out, needed),
        parameters=_parameters(case, state, uncertainty),
        channels=channels,
        effects=effects,
        candidates=_candidates(state),
        unexplained=left,
        limits=(*uncertainty.limits, *_undecided(effects)),
        notes=_notes(case),
        series=_series(case, before, after, signals, seen),
        covariance=Covariance(uncertainty.inside, uncertainty.covariance),
        criteria=state.criteria,
    )


def _undecided(effects: tuple[Effect, ...]) -> list[str]:
    """What would decide between effects that these logs cannot tell apart."""
    return [
        f"{e.name} and {other} look alike in these logs: `hydrojax excite RIG "
        f"--separate {e.name} {other}` finds a course that tells them apart"
        for e in effects
        for other in e.cannot_tell_from
    ]


def _notes(case: Case) -> tuple[str, ...]:
    notes = list(dict.fromkeys((*case.fit.notes, *case.check.notes)))
    if not case.held_out:
        notes.insert(0, "no validation log was given: errors are on the fitted logs")
    if not case.spec.sensors:
        notes.append("the noise of every channel was estimated from the logs")
    ignored = sorted({c for log in case.fit_logs for c in log.ignored})
    if ignored:
        notes.append(f"columns not used: {', '.join(ignored)}")
    logs = (*case.fit_logs, *case.check_logs)
    for key, value in SUPPLY.items():
        known = key in case.spec.supply or all(key in log.signals for log in logs)
        if case.fit.driven_by == "u" and not known:
            taken = f"{value / 1e6:g} MPa was taken; give it under [supply]"
            notes.append(f"neither the logs nor the rig file have {key}: {taken}")
    if any("v" in log.signals for log in logs):
        notes.append("v is not used: speed is taken from the position")
    return tuple(notes)


def _shown(spec: Spec, command: str) -> str:
    return with_command(spec.unit, command)


def _one(
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
    unit = _shown(spec, case.spec.command_unit)
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


def _parameters(
    case: Case, state: Tracing, uncertainty: Uncertainty
) -> dict[str, Parameter]:
    """Base parameters and those of effects that the rig file declares."""
    out = {}
    for name, spec in parameter_specs(state.problem.model.rig).items():
        effect = name.split(".")[0] if "." in name else None
        if effect is None or effect in case.spec.effects:
            shown, p = _one(name, case, state, uncertainty, spec)
            out[f"{effect}.{shown}" if effect else shown] = p
    return out


def _effects(
    case: Case,
    state: Tracing,
    uncertainty: Uncertainty,
    errors: tuple[np.ndarray, np.ndarray],
) -> tuple[Effect, ...]:
    spec = parameter_specs(state.problem.model.rig)
    seen = [c for c in range(3) if np.isfinite(state.noise[c])]
    out = []
    # What an effect did is told to where the next one came in, and the last to the end:
    # the force is fitted only after the pressures have theirs.
    ends = [errors[0], *(a.before for a in state.added[1:]), errors[1]]
    for i, added in enumerate(state.added):
        own = [n for n in spec if n.startswith(f"{added.name}.")]
        out.append(
            Effect(
                name=added.name,
                parameters=dict(
                    _one(n, case, state, uncertainty, spec[n]) for n in own
                ),
                p_value=added.p_value,
                before={CHANNELS[c]: float(ends[i][c]) for c in seen},
                after={CHANNELS[c]: float(ends[i + 1][c]) for c in seen},
                cannot_tell_from=added.cannot_tell_from,
                residual_axis=EFFECTS[added.name].residual_axis,
            )
        )
    return tuple(out)


WHY = {
    "helps": "helped, but another helped more",
    "too small": "lowers the validation error, by too little to matter",
    "does not help": "does not lower the validation error beyond chance",
    "explains too little": "leaves most of what stands above the noise",
    "needless": "was added first, and made needless by what was added later",
}


def _candidates(state: Tracing) -> tuple[Candidate, ...]:
    p = family(state.scores, state.criteria)
    first = {a.name: a for a in state.added}
    out = []
    for name, s in state.scores.items():
        what = status(state, name, p[name])
        why = WHY.get(state.tried.get(name, ""), "")
        if what == "added":
            why = "lowers the validation error most, beyond chance"
        elif what == "absent":
            why = "these logs would have shown it at a size that matters"
        elif like := [a.name for a in state.added if name in a.cannot_tell_from]:
            why = f"does as well as {like[0]}: these logs do not tell them apart"
        elif what == "cannot tell":
            why = "these logs would not show it at a size that matters"
        elif not why:
            why = "there, but too small to matter"
        out.append(
            Candidate(
                name,
                what,
                first[name].p_value if name in first else p[name],
                s.power_at_noise if what == "added" else s.power,
                s.share,
                why,
            )  # fmt: skip
        )
    return tuple(sorted(out, key=lambda c: (c.status != "added", -c.share)))


def _sentence(
    command: str,
    verdict: str,
    effects: tuple[Effect, ...],
    left: tuple[Unexplained, ...],
    held_out: bool,
    needed: tuple[str, ...],
) -> str:
    names = " and ".join(e.name for e in effects)
    where = "validation" if held_out else "fitted"
    if verdict == "nothing missing":
        return f"Nothing is missing: every channel of the {where} logs is at its noise."
    if verdict == "explained":
        return (
            f"The model lacked {names}: with it every channel of the {where} logs is "
            "at its noise."
        )
    channels = " and ".join(u.channel for u in left)
    start = f"{names} was found and added, but " if names else ""
    rest = "; ".join(u.description for u in left)
    if needed:
        return (
            f"{start}{channels} cannot be judged: the validation logs depend on "
            f"{' and '.join(needed)}, which the fitted logs leave open. With values "
            "that suit both, every channel of all logs is at its noise; fit a log that "
            "moves as the validation logs do."
        )
    if command == "identify":
        return f"The declared model does not explain {channels}: {rest}. Try trace."
    return f"{start}no known effect explains the residual of {channels}: {rest}."


def _signals(data: Data, scored: int, radius: float | None) -> dict[str, np.ndarray]:
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


def _series(
    case: Case,
    before: np.ndarray,
    after: np.ndarray,
    signals: dict[str, np.ndarray],
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
