"""The hidden effects of many lanes as arrays: what each lacks is at its absence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .catalogue import ALL, Effects


class Hidden:
    """Parameters of every effect over lanes [L]; `hidden(effect, parameter)`."""

    def __init__(self, effects: Sequence[Effects]):
        unknown = {name for e in effects for name in e} - set(ALL)
        if unknown:
            raise KeyError(f"no such effect: {sorted(unknown)}; known: {sorted(ALL)}")
        self.lanes = len(effects)
        self._present = {name for e in effects for name in e}
        self._values = {}
        for name, kind in ALL.items():
            absent = dict(kind.at_1)
            absent |= dict.fromkeys(kind.strengths, 0.0)
            absent |= dict.fromkeys(kind.inverse, np.inf)
            for parameter, value in absent.items():
                column = [e.get(name, {}).get(parameter, value) for e in effects]
                self._values[name, parameter] = np.array(column, float)

    def has(self, *names: str) -> bool:
        """Whether any lane has any of these effects."""
        return any(name in self._present for name in names)

    def __call__(self, effect: str, parameter: str) -> np.ndarray:
        """One parameter over all lanes, SI."""
        return self._values[effect, parameter]
