"""The table of places: what a rig, the checks and the estimation derive from it."""

from types import SimpleNamespace

import numpy as np
import pytest

from hydrojax.effects import EFFECTS, Array, SensorChannel, param
from hydrojax.identify.estimation.columns import ParametricRig
from hydrojax.identify.estimation.fit import fit_pressures
from hydrojax.identify.estimation.problem import in_play
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.plant.places import PLACES, place_of
from hydrojax.plant.rig import Rig, add


class PressureGain(SensorChannel):
    """A gauge that reads in proportion: `(1 + g) P`."""

    place = "sensor_P"
    needs = ("u", "P_a1", "P_a2")
    residual_axis = "P_a1 + P_a2"
    g: Array = param("1", 0.0, -0.5, 0.5, "gain error", strength=True, size=0.01)

    def step(self, memory, y, h):
        return memory, (1 + self.g) * y


class Named(PressureGain):
    name = "pressure_sensor_gain"


class OtherName(PressureGain):
    name = "gauge_gain"


class Fitted:
    """A problem that records with which parameters it was fitted."""

    def __init__(self, rig: Rig, free: tuple[str, ...]):
        self.model, self.free, self.asked = ParametricRig.of(rig), free, []
        self.criteria, self.simulate = Criteria(), False  # of no windows
        self.batch = SimpleNamespace(noise=np.array([1e3, 1e3, np.inf]))

    def side(self, names, hydraulic):
        n = self.model.hydraulic
        return tuple(x for x in names if (self.model.names.index(x) < n) == hydraulic)

    def solve(self, values, names, noise, enough):
        self.asked.append(names)
        return values, SimpleNamespace(also=SimpleNamespace(start=np.zeros((2, 3, 1))))

    def restarted(self, also, values):
        return self


@pytest.mark.parametrize("effect", [Named, OtherName])
def test_a_gauge_is_known_by_its_place_not_its_name(rig, effect):
    """Three decisions rest on it: each is the same for either name."""
    name = f"{effect.name}.g"
    free = ("beta", name, "k_cp")
    problem = Fitted(add(rig, [effect()]), free)
    # The trace's first stage, on the pressures alone, looks for it.
    assert place_of(effect).shows_in_pressures
    # Fitting the pressures moves it with the hydraulics.
    fit_pressures(problem, np.zeros(3), free)
    assert problem.asked == [("beta", name)]
    # Where only pressures are compared, it is in play.
    data = SimpleNamespace(driven_by="u", noise=np.array([1e3, 1e3, np.inf]))
    assert in_play(problem, data) == ("beta", name)
    data = SimpleNamespace(driven_by="pressures", noise=np.array([np.inf] * 2 + [1.0]))
    assert in_play(problem, data) == (name, "k_cp")


def test_the_table_and_the_rig_agree(rig):
    """Every place is a part of the rig, in order, and holds its base class."""
    fields = [n for n in Rig.__dataclass_fields__ if n in PLACES]
    assert fields == list(PLACES)
    for name, place in PLACES.items():
        assert place.name == name and getattr(rig, name) == ()
        assert place.method is None or callable(getattr(place.base, place.method))
    full = add(rig, [effect() for effect in EFFECTS.values()])
    for name, effect in EFFECTS.items():
        assert isinstance(effect(), PLACES[effect.place].base)
        assert name in [e.name for e in getattr(full, effect.place)]


def test_what_acts_on_pressures_is_hydraulic_or_a_gauge():
    downstream = {"velocity", "level", "friction", "switch", "hysteresis", "force"}
    downstream.add("sensor_F")
    assert {n for n, p in PLACES.items() if not p.shows_in_pressures} == downstream
    assert [n for n, p in PLACES.items() if p.gauge] == ["sensor_P"]
