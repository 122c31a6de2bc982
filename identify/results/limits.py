"""What a report says beside its verdict: doubts, look-alikes, and what would decide."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from hydrojax.effects import EFFECTS
from hydrojax.identify.inference.uncertainty import Uncertainty
from hydrojax.identify.preparation.noise import level
from hydrojax.identify.results.horizons import drifting
from hydrojax.identify.results.outcome import ChannelErrors, FoundEffect
from hydrojax.identify.tracing.score import family
from hydrojax.identify.tracing.state import Tracing
from hydrojax.rigfile.plain import text

if TYPE_CHECKING:
    from hydrojax.identify.case import Case


def limits_of(
    case: Case,
    state: Tracing,
    uncertainty: Uncertainty,
    effects: tuple[FoundEffect, ...],
    channels: Mapping[str, ChannelErrors],
    verdict: str,
    where: Mapping[str, str],
) -> tuple[str, ...]:
    """Sentences on where the figures of a run end: ranges, look-alikes, doubts.

    Args:
        case: the rig and its logs.
        state: where the run ended.
        uncertainty: of its parameters.
        effects: that were named.
        channels: their errors, by name.
        verdict: of the run.
        where: in which few windows a channel's error lies, by name.
    """
    own = state.criteria
    return (
        *uncertainty.limits,
        *_undecided(effects),
        *_same_as_inputs(effects, uncertainty, own.alike_gains),
        *_untested(case, channels, verdict, own.at_noise),
        *_not_quite(state, channels, verdict, where),
        *_noisier(case, channels, own.at_noise),
        *drifting(channels, verdict, case.preparation.horizon, case.criteria),
    )


def said_tolerated(
    found: Sequence[FoundEffect], tolerated: Mapping[str, tuple[str, ...]]
) -> list[str]:
    """Of effects that a stated tolerance accounts for, what they are.

    Args:
        found: all that were added.
        tolerated: the areas whose tolerances account for one, by its name.
    """
    out = []
    for e in (e for e in found if e.name in tolerated):
        off, same = 100 * e.parameters["eps"].value, tolerated[e.name]
        gives = "gives" if len(same) == 1 else "give"
        out.append(
            f"F is {abs(off):.2g} % {'larger' if off > 0 else 'smaller'} than "
            f"{' and '.join(same)} {gives} it, which lies within the tolerance in the "
            f"rig file, at two standard deviations: {e.name} stands for it in "
            "rig.toml, and is not called missing"
        )
    return out


def _undecided(effects: tuple[FoundEffect, ...]) -> list[str]:
    """What would decide between effects that these logs do not distinguish."""
    return [
        f"{e.name} and {other} look alike in these logs: `hydrojax excite RIG "
        f"--separate {e.name} {other}` finds an experiment that distinguishes them"
        for e in effects
        for other in e.cannot_tell_from
        if other in EFFECTS
    ]


def _same_as_inputs(
    effects: tuple[FoundEffect, ...], uncertainty: Uncertainty, alike: float
) -> list[str]:
    """Inputs that would look just the same, with their size where it is known."""
    out = []
    for e in effects:
        if e.name == "loadcell_gain":
            off = 100 * e.parameters["eps"].value
            out.append(
                f"loadcell_gain of {off:.2g} % is the same as areas that are "
                f"{abs(off):.2g} % too {'small' if off > 0 else 'large'}, or a load "
                "cell that is: no log tells these apart"
            )
        if e.name == "pressure_sensor_gain":
            one, two = (e.parameters[n].value for n in ("eps_1", "eps_2"))
            if abs(one - two) < alike * abs(one + two):
                off = 50 * (one + two)
                out.append(
                    f"pressure_sensor_gain of about {off:.2g} % in both sensors looks "
                    f"like a supply that is {abs(off):.2g} % "
                    f"{'higher' if off > 0 else 'lower'} than the rig file or the log "
                    "has it: measure P_s"
                )
    ends = [n for n in ("delta_1", "delta_2") if n in uncertainty.ends]
    if ends:
        out.append(
            f"{' and '.join(ends)}: an offset of the position's zero is the same as "
            "delta_1 and delta_2 of opposite signs"
        )
    return out


def _untested(
    case: Case, channels: Mapping[str, ChannelErrors], verdict: str, at_noise: float
) -> list[str]:
    """Test errors that disagree with a verdict of the other logs."""
    if verdict == "unknown" or case.test is None:
        return []
    others = "validation" if case.held_out else "fitted"
    return [
        f"{name} is {c.after / c.noise:.2f} times its noise on the test logs, which "
        f"took part in no decision: the verdict holds for the {others} logs"
        for name, c in channels.items()
        if c.after > at_noise * c.noise
    ]


def _not_quite(
    state: Tracing,
    channels: Mapping[str, ChannelErrors],
    verdict: str,
    where: Mapping[str, str],
) -> list[str]:
    """Channels that count as at their noise and are above it, with what shows there."""
    own = state.criteria
    above = [
        name
        for name, c in channels.items()
        if c.noise and c.after > own.notable * c.noise
    ]
    high = [
        f"{name} is at {channels[name].after / channels[name].noise:.3g} times its "
        "noise"
        for name in above
    ]
    if verdict == "unknown" or not high:
        return []
    p = family(state.scores, own)
    added = {a.name for a in state.added}
    shows = [n for n in p if p[n] < own.level and n in state.tried and n not in added]
    said = f"{' and '.join(high)}, which counts as at it"
    if len(above) == 1:
        said += where.get(above[0], "")
    if shows:
        also = "shows" if len(shows) == 1 else "show"
        said += (
            f"; {' and '.join(shows)} {also} in what is left, but did not lower the "
            "validation error enough"
        )
    return [said]


def _noisier(
    case: Case, channels: Mapping[str, ChannelErrors], at_noise: float
) -> list[str]:
    """Channels that stay above the noise that is stated for them, and not above their
    own white noise in the logs.
    """
    out = []
    for name, c in channels.items():
        stated = case.spec.sensors.get(name)
        if not stated or c.after <= at_noise * c.noise:
            continue
        own = level(case.check_logs, name)
        if stated < own and c.after <= at_noise * own:
            line = f'{name} = "{text(float(f"{own:.3g}"), c.unit)}"'
            out.append(
                f"all that is left of {name} is white noise that its log has: "
                f"{own / stated:.2g} times what [sensors] states; if the sensor is "
                f"that noisy, write {line} there"
            )
    return out
