"""What is said beside a tuning's table."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from hydrojax.plant.load import Driven, Inertia, TwoMassLoad
from hydrojax.tune import comparison


def test_a_load_is_said_to_swing_at_its_own_frequency():
    """Of two masses the lowest; of one that nothing holds none."""
    hertz = np.geomspace(0.1, 100, 200)
    flat = [{"response": np.full((1, hertz.size), value)} for value in (1.0, 0.1)]

    def said(load) -> list[str]:
        setting = SimpleNamespace(loop=SimpleNamespace(load=load))
        objective = SimpleNamespace(setting=setting, hertz=hertz, before=flat[0])
        return comparison._resonance(cast(Any, objective), cast(Any, flat[1]))

    k = (2 * np.pi * 5) ** 2 * 10.0
    (text,) = said(Inertia(10.0, k, 0.0))
    assert "At 5.0 Hz" in text and "0.0 dB before and -20.0 dB after" in text
    # Free, two equal masses on a spring swing at sqrt(2 k / m).
    (text,) = said(TwoMassLoad(10.0, 0.0, 0.0, 10.0, k / 2, 0.0))
    assert "At 5.0 Hz" in text
    assert said(Inertia(10.0, 0.0, 5.0)) == [] and said(Driven()) == []
