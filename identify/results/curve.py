"""A curve for what no known effect explains, as plain data."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

GAP = 0.08
"""Share of a curve's range without a sample from which it is a guess there: the knots
of samples that lie evenly are as far apart."""


def gaps_in(
    seen: tuple[float, float], rug: Float[np.ndarray, "samples"]
) -> tuple[tuple[float, float], ...]:
    """Gaps of `GAP` between samples of a signal, in the range of it that was seen."""
    rows = np.sort(np.concatenate([seen, rug]))
    wide = np.diff(rows) > GAP * (seen[1] - seen[0])
    ends = zip(rows[:-1][wide], rows[1:][wide], strict=True)
    return tuple((float(a), float(b)) for a, b in ends)


@dataclass(frozen=True)
class FoundCurve:
    """A curve that stands for what no known effect explains; SI.

    Attributes:
        name: of the effect that it makes, `free_level_v`.
        place: where it acts.
        signal: what it is over, in `signal_unit`; `factor` what multiplies it, or "".
        unit: of the curve.
        s: of the signal, over the logs that are fitted and those that are not.
        y: the curve there, less what the rig's own parameters can follow.
        std: its standard deviation; the 95 % band is 1.96 times it, on either side.
        seen: range of the signal on which it rests.
        rug: samples of the signal that it rests on.
        p_value: family-wise, over all places and signals.
        before: error by channel on the validation logs, RMS; `after` that with it.
        share: part of the squared error above the noise that it takes.
        test_before: error by channel on the test logs, where there are any, without
            any curve; `test_after` with all of them.
        alike: names of curves that do as well.
        law: a formula that does as well as the curve, or "".
        law_y: its values at `s`, less the same; none without a formula.
        source: the class of an effect that has this law or this curve, in Python.
    """

    name: str
    place: str
    signal: str
    signal_unit: str
    factor: str
    unit: str
    s: Float[np.ndarray, "points"]
    y: Float[np.ndarray, "points"]
    std: Float[np.ndarray, "points"]
    seen: tuple[float, float]
    rug: Float[np.ndarray, "samples"]
    p_value: float
    before: dict[str, float]
    after: dict[str, float]
    share: float
    test_before: dict[str, float] = field(default_factory=dict)
    test_after: dict[str, float] = field(default_factory=dict)
    alike: tuple[str, ...] = ()
    law: str = ""
    law_y: Float[np.ndarray, "points"] | None = None
    source: str = ""

    @property
    def unseen(self) -> tuple[tuple[float, float], ...]:
        """Stretches of the signal in which no fitted log has samples: beyond `seen`,
        and gaps of `GAP` in it.
        """
        low, high = self.seen
        inside = gaps_in(self.seen, self.rug)
        every = ((self.s[0], low), *inside, (high, self.s[-1]))
        return tuple((float(a), float(b)) for a, b in every if a < b)

    @property
    def extrapolated(self) -> tuple[bool, ...]:
        """Of each of `s`, whether it is in one of these."""
        unseen = self.unseen
        return tuple(any(a <= s <= b for a, b in unseen) for s in self.s)
