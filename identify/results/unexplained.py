"""The residual above the noise: what it follows, and what the logs leave open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hydrojax.identify.estimation.known import Known
from hydrojax.identify.inference.uncertainty import curvature
from hydrojax.identify.results.lines import line_of, lowest_seen
from hydrojax.identify.results.outcome import Dependence, Stretch, Unexplained
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.identify.tracing.state import Tracing


def unexplained(
    channel: str,
    unit: str,
    noise: float,
    residual: Float[np.ndarray, "windows ticks"],
    signals: Mapping[str, Float[np.ndarray, "windows ticks"]],
    tick: float,
    criteria: Criteria = Criteria(),
    places: Sequence[tuple[str, float, float]] = (),
    logs: str = "",
) -> Unexplained:
    """Describe the residual of a channel that stays above its noise.

    The sentence is a description, not a cause: what the residual follows is where an
    engineer would look first.

    Args:
        channel: its name.
        unit: its unit.
        noise: its standard deviation, SI.
        residual: measured minus replayed, SI.
        signals: with which it may correlate, by name.
        tick: step of the log, s.
        criteria: from which share on a correlation is stated.
        places: log, start and end (s) of each window; without, no place is said.
        logs: on which it is, where errors are shown of others.
    """
    excess = float(np.sqrt(max(np.mean(residual**2) - noise**2, 0.0)))
    size = f"{channel} stays {_size(excess, unit)} RMS above its noise{logs}"
    found = [
        Dependence(n, *dependence(residual, s, criteria)) for n, s in signals.items()
    ]
    tests = tuple(sorted(found, key=lambda d: (d.p_value, -d.share)))
    line = line_of(residual, tick, places, signals.get("v"), criteria)
    clear = max(
        (d for d in tests if d.share > criteria.correlates), key=_share, default=None
    )
    if clear:
        follows = clear.signal
        description = (
            f"{size}; {100 * clear.share:.0f} % of the residual variance correlates "
            f"with {follows} (p {clear.p_value:.2g}), more than with any other signal "
            "of the log"
        )
    elif line is not None:
        follows = "frequency"
        description = f"{size}; it stands out as a line near {line:.3g} Hz"
    else:
        follows, where = _swells(residual, noise, signals, criteria)
        share = f"{100 * criteria.correlates:.0f} % of its variance"
        rest = f", but it is larger where {follows} is {where}" if where else ""
        lowest = lowest_seen(residual.shape[1], tick, places)
        if not where and lowest is not None:
            rest = f", and it has no spectral line above {lowest:.2g} Hz"
        description = f"{size}; no signal of the log goes with {share}{rest}"
    where = _in_few(residual, noise, places, criteria)
    return Unexplained(
        channel, excess, unit, follows, description + _said_of(where, len(residual)),
        tests, line, advice(channel, follows), where,
    )  # fmt: skip


def unexplained_beyond(excess: float, noise: float, length: float) -> Unexplained:
    """Describe a force that is at its noise over windows only.

    Args:
        excess: by how much it is above it over longer runs, N.
        noise: its standard deviation, N.
        length: of a window, s.
    """
    times = np.sqrt(1 + (excess / noise) ** 2)
    description = (
        f"F is at its noise over {length:g} s, but stays {_size(excess, 'N')} RMS "
        f"above it over 1 s and through whole logs ({times:.3g} times its noise)"
    )
    to_do = advice("F", "none")
    return Unexplained(
        "F", excess, "N", "none", description, next=to_do, beyond_windows=True
    )


def lies_in(
    residual: Float[np.ndarray, "windows ticks"],
    noise: float,
    places: Sequence[tuple[str, float, float]],
    criteria: Criteria,
) -> str:
    """In which few windows most of what is above the noise lies; empty where in many.

    The arguments are those of `unexplained`.
    """
    where = _in_few(residual, noise, places, criteria)
    return _said_of(where, len(residual), "what is above")


def _in_few(
    residual: np.ndarray,
    noise: float,
    places: Sequence[tuple[str, float, float]],
    criteria: Criteria,
) -> tuple[Stretch, ...]:
    """The fewest windows that hold over half of the excess; none if that is many."""
    own = np.sum(residual**2 - noise**2, axis=1)
    order = np.argsort(-own)
    held = np.cumsum(own[order]) > 0.5 * own.sum()
    count = int(np.argmax(held)) + 1
    if not places or not held.any() or count > max(criteria.few_windows * len(own), 1):
        return ()
    share = own / own.sum()
    return tuple(Stretch(*places[i], float(share[i])) for i in map(int, order[:count]))


def _said_of(where: Sequence[Stretch], windows: int, what: str = "it") -> str:
    if not where:
        return ""
    share = 100 * sum(w.share for w in where)  # of an excess that others lie below
    part = f"{share:.0f} %" if share < 99.5 else "all"
    times: dict[str, list[str]] = {}
    for w in where[:3]:
        times.setdefault(w.log, []).append(f"{w.start:.2f}")
    first = ", ".join(f"{log} from {', '.join(t)} s" for log, t in times.items())
    count = "one" if len(where) == 1 else str(len(where))
    more = " and others" if len(where) > 3 else ""
    return f"; {part} of {what} lies in {count} of {windows} windows ({first}{more})"


def _share(d: Dependence) -> float:
    return d.share


def _swells(
    residual: np.ndarray,
    noise: float,
    signals: Mapping[str, np.ndarray],
    criteria: Criteria,
) -> tuple[str, str]:
    """The signal with whose size that of the residual correlates, and which way."""
    loud = np.log(residual**2 + (0.1 * noise) ** 2)
    loud = loud - loud.mean()
    swell = {
        name: dependence(loud, np.abs(s), criteria)[0] for name, s in signals.items()
    }
    best = max(swell, key=lambda n: swell[n], default="")
    if not best or swell[best] <= criteria.correlates:
        return "none", ""
    high = np.abs(signals[best]) > np.median(np.abs(signals[best]))
    return best, "large" if loud[high].mean() > loud[~high].mean() else "small"


_STROKES = "strokes of constant speed both ways, at six speeds from below 1 mm/s on"
_PLACES = "the same strokes about three positions, and slow ones over the whole travel"
_TRIANGLE = "a slow triangle of the command through zero, at two supply pressures"
_HOLD = "a minute's hold with the valve shut, and runs at two supply pressures"
_WARM = "the same run cold and warm, a minute long each"
_FAST = "a multisine from 0.2 to 80 Hz at three amplitudes"
_FREE = "free motion at more than 5 m/s^2"
_STILL = "a hold at constant force: does the line stay, and move with pump or mains?"
_LEVELS = "strokes of constant speed at two supply pressures"
_BREAK = "a slow sine of force below breakaway, standing still"

ADVICE = {
    "frequency": (_STILL, _STILL), "v": (_STROKES, _FAST), "a": (_FREE, _FREE),
    "x": (_PLACES, _PLACES), "psi": (_PLACES, _PLACES), "t": (_WARM, _WARM),
    "u": (_TRIANGLE, _TRIANGLE), "abs(u)": (_TRIANGLE, _TRIANGLE),
    "u_rate": (_FAST, _FAST), "F": (_BREAK, _FAST),
    "P_a1 + P_a2": (_LEVELS, _HOLD), "P_a1 - P_a2": (_LEVELS, _HOLD),
}  # fmt: skip
"""What to record next where the force, or a pressure, follows a signal."""


def advice(channel: str, follows: str) -> str:
    """The excitation in which such a residual would show more clearly."""
    return ADVICE.get(follows, (_FAST, _FAST))[channel != "F"]


def dependence(
    residual: Float[np.ndarray, "windows ticks"],
    s: Float[np.ndarray, "windows ticks"],
    criteria: Criteria = Criteria(),
) -> tuple[float, float]:
    """Share of the residual's square held by its means between quantiles of `s`.

    The share is less what the same sum holds by chance, when the signal's
    windows are exchanged among each other; beside it the p-value that these exchanges
    give, at least 1 / (`criteria.shuffles` + 1).
    """
    residual = residual - residual.mean()
    edges = np.unique(np.quantile(s, np.linspace(0, 1, criteria.quantiles + 1)[1:-1]))
    if edges.size < 2:
        return 0.0, 1.0
    index = np.searchsorted(edges, s)
    count = np.maximum(np.bincount(index.ravel()), 1)

    def held(index):
        total = np.bincount(index.ravel(), weights=residual.ravel())
        return np.sum(total**2 / count[: total.size])

    draw = np.random.default_rng(0)
    chance = [
        held(index[draw.permutation(len(index))]) for _ in range(criteria.shuffles)
    ]
    own = held(index)
    share = max((own - np.mean(chance)) / max(np.sum(residual**2), 1e-300), 0.0)
    p = (1 + np.sum(np.array(chance) >= own)) / (criteria.shuffles + 1)
    return float(share), float(p)


def _size(value: float, unit: str) -> str:
    if unit == "Pa":
        return f"{value / 1e3:.3g} kPa"
    return f"{value:.3g} {unit}"


class LeftOpen(NamedTuple):
    """What the fitted logs leave open, and the validation logs depend on.

    Attributes:
        names: of parameters.
        share: of the validation logs' squared error above the noise that goes with
            other values of them, with which the fitted logs stay at their noise.
        whole: whether every channel of all logs is at its noise with these.
    """

    names: tuple[str, ...] = ()
    share: float = 0.0
    whole: bool = False


def extrapolation(state: Tracing, unidentifiable: Sequence[str]) -> LeftOpen:
    """Parameters that the fitted logs leave open and the check needs.

    A fit to the check's logs, held by what the fitted logs identify. Where there are
    values with which every channel of all the logs is at its noise, nothing says that
    the model lacks anything.

    Args:
        state: where a run ended.
        unidentifiable: those that the fitted logs do not identify, named first.
    """
    own = state.criteria
    free, index = state.free, _index(state)
    fitted, check, start = state.problem, state.check, state.point.values

    def off(problem, values) -> np.ndarray:
        """Each channel's error over its noise; 0 where it is not compared."""
        return problem.rms(problem.errors_at(values)) / np.asarray(problem.batch.noise)

    if np.any(off(fitted, start) > own.at_noise):
        return LeftOpen()
    known = Known(free, start[index], curvature(fitted, state.point, free)[0])
    both = replace(fitted, batch=check.batch, known=known, symmetric=False)
    values = start
    for _ in range(2):
        values, out = both.solve(values, free)
        both = both.restarted(out.also, values)
    if np.any(off(fitted, values) > own.at_noise):
        return LeftOpen()

    before, after = off(check, start), off(check, values)
    fall = float(np.sum(before**2 - after**2))
    whole = bool(np.all(after <= own.at_noise))
    above = float(np.sum(np.maximum(before**2 - 1, 0.0)))
    share = 1.0 if whole else min(fall / above, 1.0)
    rise = {}
    for name, i in zip(free, index, strict=True):
        without = values.copy()
        without[i] = start[i]
        rise[name] = float(np.sum(off(check, without) ** 2 - after**2)) / fall
    named = sorted((n for n in free if rise[n] > own.needed), key=lambda n: -rise[n])
    if not named or not share >= own.fair_share:
        return LeftOpen()
    return LeftOpen(
        tuple(n for n in named if n in unidentifiable) or tuple(named), share, whole
    )


def _index(state: Tracing) -> np.ndarray:
    names = state.problem.model.names
    return np.array([names.index(n) for n in state.free], dtype=int)
