"""From the end of a fit or a trace to an `Outcome`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hydrojax.identify.checking.words import Finding
from hydrojax.identify.estimation.columns import batch_of
from hydrojax.identify.estimation.fit import FitPoint
from hydrojax.identify.inference.omitted import with_omitted
from hydrojax.identify.inference.uncertainty import Uncertainty, is_whole, slack_of
from hydrojax.identify.preparation.noise import CHANNELS
from hydrojax.identify.results.horizons import beyond_windows, horizons_of
from hydrojax.identify.results.limits import limits_of, said_tolerated
from hydrojax.identify.results.outcome import (
    Candidate,
    ChannelErrors,
    Covariance,
    Errors,
    Outcome,
    Unexplained,
)
from hydrojax.identify.results.parts import (
    files_of,
    named_effects,
    parameters_of,
    series_of,
    signals_of,
    within_tolerance,
)
from hydrojax.identify.results.sentence import (
    verdict_sentence,
    with_ends,
    without_skill,
)
from hydrojax.identify.results.unexplained import (
    LeftOpen,
    extrapolation,
    lies_in,
    unexplained,
    unexplained_beyond,
)
from hydrojax.identify.tracing.loop import status
from hydrojax.identify.tracing.score import family
from hydrojax.identify.tracing.screen import size_that_matters
from hydrojax.identify.tracing.state import Tracing, strengths
from hydrojax.parameters import parameter_specs
from hydrojax.rigfile.schema import SUPPLY

if TYPE_CHECKING:
    from hydrojax.identify.case import Case
    from hydrojax.identify.tracing.criteria import Criteria

UNITS = ("Pa", "Pa", "N")


def summarise(
    command: str, case: Case, state: Tracing, base: FitPoint, uncertainty: Uncertainty
) -> Outcome:
    """All that was found, from the state a run ended in, its base fit, and the
    uncertainty of its parameters.
    """
    seen = [c for c in range(3) if np.isfinite(state.noise[c])]
    declared = state.check.initial_values() if command == "identify" else base.values
    ends = (declared, state.point.values)
    before, after = (state.check.residuals_at(values) for values in ends)
    errors = (_rms(before), _rms(after))
    channels = _channels(case, state, ends, errors, seen)
    signals = signals_of(case.check, before.shape[1], case.spec.geometry.get("radius"))
    left = _left(case, state, after, errors[1], signals, seen)
    in_windows = bool(left)
    left = left or _left_beyond(case, state, uncertainty, channels, ends)
    if not left:  # of an error above the noise nobody knows what is missing
        uncertainty = with_omitted(uncertainty, state)
    found = named_effects(case, state, uncertainty, (errors[0], errors[1]))
    tolerated = {e.name: own for e in found if (own := within_tolerance(e, case.spec))}
    effects = tuple(e for e in found if e.name not in tolerated)
    verdict = "unknown" if left else "explained" if effects else "nothing missing"
    needed = (
        extrapolation(state, uncertainty.unidentifiable)
        if in_windows and case.held_out
        else LeftOpen()
    )
    where = _in_few_windows(case, state, after, seen)
    return Outcome(
        command=command,
        rig=case.spec.name,
        fit_logs=tuple(log.name for log in case.fit_logs),
        validate_logs=tuple(log.name for log in case.check_logs if case.held_out),
        test_logs=tuple(log.name for log in case.test_logs),
        verdict=verdict,
        sentence=without_skill(channels, state.criteria.at_noise)
        + with_ends(
            verdict_sentence(
                command, verdict, effects, left, case.held_out, needed, state.criteria
            ),
            _at_ends(state, uncertainty),
        )
        + _slow_noise(case, channels, left, state.criteria),
        parameters=parameters_of(case, state, uncertainty, tuple(tolerated)),
        channels=channels,
        effects=effects,
        candidates=_candidates(state, tuple(tolerated)),
        unexplained=left,
        limits=(
            *said_tolerated(found, tolerated),
            *limits_of(case, state, uncertainty, effects, channels, verdict, where),
        ),
        tolerated=tuple(tolerated),
        notes=_notes(case),
        series=series_of(case, before, after, signals, seen),
        values=state.named,
        covariance=Covariance(uncertainty.inside, uncertainty.covariance),
        criteria=state.criteria,
        files=files_of(case),
    )


def _rms(residuals: np.ndarray) -> np.ndarray:
    """Root mean square by channel, [3], of [W, T, 3]."""
    return np.sqrt(np.mean(residuals**2, axis=(0, 1)))


def _channels(
    case: Case,
    state: Tracing,
    ends: tuple[np.ndarray, np.ndarray],
    errors: tuple[np.ndarray, np.ndarray],
    seen: list[int],
) -> dict[str, ChannelErrors]:
    """Errors at the values `ends` [n]: of the test logs where there are any, with those
    of the validation logs, if any, which are `errors` [3], beside them.
    """
    own, judged = errors, state.check
    if case.test is not None:
        judged = replace(state.check, batch=batch_of(case.test))
        own = tuple(_rms(judged.residuals_at(values)) for values in ends)
    length = case.preparation.horizon
    horizons = horizons_of(state.problem, judged, ends, length)
    out = {}
    for c in seen:
        beside = Errors(float(errors[0][c]), float(errors[1][c]))
        out[CHANNELS[c]] = ChannelErrors(
            UNITS[c],
            float(state.noise[c]),
            float(own[0][c]),
            float(own[1][c]),
            beside if case.test is not None and case.held_out else None,
            horizons[CHANNELS[c]],
        )
    return out


def _left(
    case: Case,
    state: Tracing,
    after: np.ndarray,
    errors: np.ndarray,
    signals: Mapping[str, np.ndarray],
    seen: list[int],
) -> tuple[Unexplained, ...]:
    """What stays above the noise of the validation logs: residuals `after` [W, T, 3],
    whose RMS is `errors` [3].
    """
    tick, places = float(np.median(case.check.windows.h)), _places(case, after.shape[1])
    which = "validation" if case.held_out else "fitted"
    where = f" on the {which} logs" if case.test is not None else ""
    return tuple(
        unexplained(
            CHANNELS[c],
            UNITS[c],
            float(state.noise[c]),
            after[..., c],
            signals,
            tick,
            state.criteria,
            places,
            where,
        )
        for c in seen
        if errors[c] > state.criteria.at_noise * state.noise[c]
    )


def _left_beyond(
    case: Case,
    state: Tracing,
    uncertainty: Uncertainty,
    channels: Mapping[str, ChannelErrors],
    ends: tuple[np.ndarray, np.ndarray],
) -> tuple[Unexplained, ...]:
    """What of the force stays above its noise over runs longer than windows, on the
    logs that the verdict is of.
    """
    if "F" not in channels:
        return ()
    horizons, length = channels["F"].horizons, case.preparation.horizon
    if case.test is not None:  # those are of the test logs, which decide nothing
        horizons = horizons_of(state.problem, state.check, ends, length)["F"]
    excess = beyond_windows(
        state.problem,
        state.check,
        ends[1],
        uncertainty,
        horizons,
        length,
        state.criteria,
    )
    if excess is None:
        return ()
    return (unexplained_beyond(excess, float(state.noise[2]), length),)


def _places(case: Case, ticks: int) -> list[tuple[str, float, float]]:
    """Log, start and end (s) of the compared ticks of each validation window."""
    t = np.asarray(case.check.windows.t)[:, -ticks:]
    names = [log.name for log in case.check_logs]
    return [
        (names[i], float(own[0]), float(own[-1]))
        for i, own in zip(case.check.log, t, strict=True)
    ]


def _slow_noise(
    case: Case,
    channels: Mapping[str, ChannelErrors],
    left: tuple[Unexplained, ...],
    criteria: Criteria,
) -> str:
    """That a sensor's own noise may be what is left, where nothing states how large it
    is and nothing else shows in it; empty elsewhere.
    """
    may_be = left and all(
        u.follows == "none"
        and not u.where
        and not u.beyond_windows
        and u.channel not in case.spec.sensors
        and channels[u.channel].after <= criteria.slow_noise * channels[u.channel].noise
        for u in left
    )
    if not may_be:
        return ""
    names = " and ".join(u.channel for u in left)
    return (
        f" The noise of {names} was estimated by what changes from row to row; that of "
        "a sensor behind a low-pass filter is larger: if there is one, state its noise "
        "under [sensors]."
    )


def _in_few_windows(
    case: Case, state: Tracing, after: np.ndarray, seen: list[int]
) -> dict[str, str]:
    """In which few windows what is above the noise lies, by channel."""
    places = _places(case, after.shape[1])
    return {
        CHANNELS[c]: lies_in(
            after[..., c], float(state.noise[c]), places, state.criteria
        )
        for c in seen
    }


def _notes(case: Case) -> tuple[str, ...]:
    notes = list(dict.fromkeys((*case.fit.notes, *case.check.notes)))
    if not case.held_out:
        judged = "the verdict is of" if case.test is not None else "errors are on"
        notes.insert(0, f"no validation log was given: {judged} the fitted logs")
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
    read = (log.name for group in case.as_read for log in group)
    own = {n for log in read for n in case.spec.names_of(log)}
    for name in case.spec.filtered:
        if name not in own:
            said = "so no filter acts there; see `logs` under [effects.signal_filter]"
            notes.append(f"{name} is none of these logs, {said}")
    if any("v" in log.signals for log in logs):
        notes.append("v is not used: speed is taken from the position")
    return tuple(notes)


WHY = {
    "helps": "helped, but another helped more",
    "too small": "lowers the validation error, by too little to matter",
    "does not help": "does not lower the validation error beyond chance",
    "explains too little": "leaves most of what stands above the noise",
    "answers noise": "lowers the error by no more than the noise of the position that "
    "the model is left with",
    "needless": "was added first, and made unnecessary by what was added later",
    "exchanged": "was added first, and exchanged for what does better with the others",
    "spoils another channel": "raises the validation error of another channel",
}


def _candidates(
    state: Tracing, tolerated: tuple[str, ...] = ()
) -> tuple[Candidate, ...]:
    p = family(state.scores, state.criteria)
    first = {a.name: a for a in state.added}
    small = state.criteria.smallest_gain * size_that_matters(state, state.noise)
    out = []
    for name, s in state.scores.items():
        what = status(state, name, p[name])
        what = "cannot tell" if name in tolerated else what
        why = WHY.get(state.tried.get(name, ""), "")
        if name in tolerated:
            why = "within the tolerance of a constant that is the same"
        elif what == "added":
            why = "lowers the validation error most, beyond chance"
        elif what == "absent":
            why = "these logs would have shown it at a size that matters"
        elif like := [a.name for a in state.added if name in a.cannot_tell_from]:
            why = f"does as well as {like[0]}: these logs do not distinguish them"
        elif what == "cannot tell" and s.share > state.criteria.promising:
            why = "may explain some of what is left, but not beyond chance"
        elif what == "cannot tell":
            why = "these logs would not show it at a size that matters"
        elif not why:
            why = (
                "there, but too small to matter"
                if s.gain <= small
                else "there, but not fitted: others promised more"
            )
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


def _at_ends(state: Tracing, uncertainty: Uncertainty) -> tuple[str, ...]:
    """Free parameters that stand at an end of their range; not what is absent there,
    nor what can be no more or less.
    """
    specs, free = parameter_specs(state.problem.model.rig), state.problem.free
    added = [state.effects[a.name] for a in state.added]
    strong = [n for e in added for n in strengths(e)]
    meant = {n for n in strong if abs(state.named[n]) <= slack_of(free[n])}
    whole = {n for n in state.free if is_whole(free[n], specs[n])}
    for n in whole:
        if np.any(np.isclose(state.named[n], (specs[n].lower, specs[n].upper))):
            meant.add(n)
    return tuple(n for n in state.free if n in uncertainty.ends and n not in meant)


def with_inputs(outcome: Outcome, found: tuple[Finding, ...]) -> Outcome:
    """The outcome with what looks wrong with the inputs, which is said first.

    Nothing is said of a factor by a balance of force that closes less well with it
    than the declared model's runs do without, or those with effects that bring the
    force to its noise (`Criteria.credible`); nor of one that an effect does as well
    which was added, and leaves the force above its noise: that effect says so itself,
    and stands for something else.
    """
    found = tuple(f for f in found if f.mended or _credible(f, outcome))
    if not found:
        return outcome
    mended, rest = ([f for f in found if f.mended == is_so] for is_so in (True, False))
    if mended and not (rest and all(f.finding == "stray" for f in mended)):
        also = f" (and {len(mended) - 1} more)" if len(mended) > 1 else ""
        lead = f"An input looks wrong: {mended[0].says}{also}. With it mended:"
    else:
        # A balance blames nothing that an effect explains as well (`checking.factors`);
        # a sensor's own readings say nothing of that.
        compared = outcome.effects and rest[0].error is not None
        beyond = ", and explains at least as much as any effect" if compared else ""
        lead = f"An input looks wrong{beyond}: "
        lead += f"{rest[0].says}."
        same = [e.name for e in outcome.effects if e.name in rest[0].effects]
        if same:
            lead += (
                f" {same[0]} is the same error under another name, not a second one."
            )
    return replace(outcome, inputs=found, sentence=f"{lead} {outcome.sentence}")


def _credible(found: Finding, outcome: Outcome) -> bool:
    """Whether the runs of the declared model do not speak against a finding."""
    left, force = found.error_if_mended, outcome.channels.get("F")
    if found.finding != "factor" or found.unit != "N" or left is None or force is None:
        return True
    own = outcome.criteria
    noise = own.at_noise * force.noise
    if any(e.name in found.effects for e in outcome.effects):
        return force.after <= noise
    traced = outcome.command == "trace"
    whole = bool(outcome.effects) and force.after <= noise
    runs = noise if whole else force.before if traced else force.after
    return left <= own.credible * runs
