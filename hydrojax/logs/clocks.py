"""Senders' clocks: what delays say of them, and all stamps brought to one.

A message's delay, receive time less stamp, is never negative. Where two clocks run
apart, the floor under the delays falls or rises with time: its slope is the drift (V.
Paxson, *On Calibrating Measurements of Packet Transit Times*, 1998; S. Moon, P. Skelly,
D. Towsley, *Estimation and Removal of Clock Skew from Network Delay Measurements*,
1999). The floor is taken as the least delays of even stretches, the line through them
by Theil and Sen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy import stats

WHOLE = 1.75
"""Neighbouring samples further apart than this many periods have a gap between them."""

SAME = 0.01
"""Stamps nearer each other than this share of a period are one tick."""

_STRETCHES, _LEAST = 30, 10  # of the run, for the floor of the delays; the fewest

_SURE = 0.99  # of the interval that a drift must leave zero out of

_LONG = 0.1  # s: longer than this, a delay is another clock's zero

_MATTERS = 0.01  # of a period: a drift that shifts less over the run is left


@dataclass(frozen=True)
class Stream:
    """The samples of one topic.

    Attributes:
        topic: its name.
        by: what `stamp` is: "header.stamp", "publish time" or "log time".
        stamp: ns, by the sender's clock.
        received: ns, by the recorder's clock.
        values: by signal; NaN where a message has none.
    """

    topic: str
    by: str
    stamp: Int[np.ndarray, "messages"]
    received: Int[np.ndarray, "messages"]
    values: dict[str, Float[np.ndarray, "messages"]]

    @cached_property
    def period(self) -> float:
        """Median step of the stamps, s."""
        return float(np.median(np.diff(self.stamp))) * 1e-9

    @property
    def steady(self) -> bool:
        """Whether it comes at a rate; else it comes when it changes."""
        return np.quantile(np.diff(self.stamp), 0.9) < WHOLE * 1e9 * self.period

    def __str__(self) -> str:
        """The topic and its signals."""
        return f"{self.topic} ({', '.join(self.values)})"


@dataclass(frozen=True)
class Clock:
    """A sender's clock against the recorder's: received - stamp is at least this.

    At s seconds of the recorder, `coarse` + `offset` + `drift` s.

    Attributes:
        coarse: ns, so that the rest is small.
        offset: s.
        drift: s/s; negative where the sender's clock is the faster.
        error: half the 99 % interval of `drift`; inf where it is not identifiable.
    """

    coarse: int
    offset: float
    drift: float
    error: float


def clock(
    stamp: Int[np.ndarray, "messages"],
    received: Int[np.ndarray, "messages"],
    origin: int,
) -> Clock:
    """What a topic's delays say of its clock.

    Args:
        stamp: ns, by the sender's clock.
        received: ns, by the recorder's clock.
        origin: ns of the recorder where its seconds start.
    """
    coarse = int(np.min(received - stamp))
    delay = (received - stamp - coarse) * 1e-9
    at = (received - origin) * 1e-9
    stretch = ((at - at.min()) / max(np.ptp(at), 1e-9) * _STRETCHES).astype(int)
    low = [
        own[np.argmin(delay[own])]
        for own in (np.flatnonzero(stretch == k) for k in range(_STRETCHES))
        if len(own)
    ]
    if len(low) < _LEAST:
        return Clock(coarse, float(np.median(delay[low])), 0.0, np.inf)
    fit = np.array(stats.theilslopes(delay[low], at[low], _SURE), dtype=float)
    slope, level, lower, upper = fit.tolist()
    return Clock(coarse, level, slope, (upper - lower) / 2)


def by_one_clock(
    streams: Sequence[Stream], base: Stream
) -> tuple[dict[str, Float[np.ndarray, "_"]], list[str]]:
    """Each topic's stamps by the base's clock, s from the base's first; remarks.

    A clock that drifts against the base's beyond doubt, or has another zero, is brought
    to it, as far as their least delays are the same; any other is taken as the same
    clock.
    """
    zero = int(base.stamp[0])
    origin = zero + int(np.min(base.received - base.stamp))
    home = clock(base.stamp, base.received, origin)
    span = np.ptp(base.stamp) * 1e-9
    times, notes = {}, [_delays(base, home)]
    for stream in streams:
        plain = (stream.stamp - zero) / 1e9
        times[stream.topic] = plain
        if stream is base:
            continue
        here = clock(stream.stamp, stream.received, origin)
        notes.append(_delays(stream, here))
        drift, error = here.drift - home.drift, np.hypot(here.error, home.error)
        apart = (here.coarse - home.coarse) * 1e-9 + here.offset - home.offset
        middle = apart + drift * span / 2
        drifts = abs(drift) > error and abs(drift) * span > _MATTERS * base.period
        if drifts or abs(middle) > _LONG:
            near = (stream.stamp - zero + here.coarse - home.coarse) / 1e9
            off = here.offset - home.offset + drift * (near if drifts else span / 2)
            times[stream.topic] = near + off
            notes.append(
                f"{stream.topic}: its clock stands {-middle:+.6g} s off {base.topic}'s "
                f"and runs {_ppm(-drift, error)} against it; "
                f"{'both' if drifts else 'the first'} corrected, but for what their "
                "least delays differ by"
            )
        elif abs(middle) > SAME * base.period and "log time" not in (
            stream.by,
            base.by,
        ):
            notes.append(
                f"{stream.topic}: comes at least {1e3 * middle:+.3g} ms later than "
                f"{base.topic}; delay and a clock's offset look the same, so it is "
                "left; the effect channel_skew may show it"
            )
    return times, notes


def _delays(stream: Stream, clock: Clock) -> str:
    """What is known of a topic's clock, in words."""
    if stream.by == "log time":
        return (
            f"{stream}: times are the log's, so its skew is not identifiable; the "
            "effect channel_skew may show it"
        )
    said = f"{stream}: times are by {stream.by}"
    if (stream.stamp == stream.received).all():
        return f"{said}, the same as the log's"
    least = clock.coarse * 1e-9 + clock.offset
    seen = f"its delay to the recorder is at least {1e3 * least:.4g} ms"
    if abs(least) > _LONG:
        seen = f"its clock stands {-least:+.6g} s off the recorder's"
    if np.isinf(clock.error):
        return f"{said}; {seen}, drift is not identifiable"
    return f"{said}; {seen}, drift {_ppm(-clock.drift, clock.error)}"


def _ppm(drift: float, error: float) -> str:
    return f"{round(1e6 * drift, 1) + 0.0:+.1f} ppm (+- {1e6 * error:.1g})"
