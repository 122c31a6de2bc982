"""A valve of a user's own, from a log to its parameters, and through a trace.

The logs are the generator's, whose metering edges are set as this valve's would be.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace

import jax
import pytest

from hydrojax.api import fit, trace
from hydrojax.control.baselines import PIController
from hydrojax.errors import InputError
from hydrojax.logs.log import Log
from hydrojax.parameters import param, parameter_specs
from hydrojax.plant.valve import AbstractValve, root_flow, sides
from hydrojax.rigfile.build import build_loop, build_rig
from hydrojax.rigfile.schema import RigFile
from tests import generator

GRADIENT, RATIO = 7.4e-8, 0.93
ORIFICE = 0.65 * math.sqrt(2 / 870)


class SharpEdges(AbstractValve):
    """Sharp-edged orifices of one area gradient, the return's in a ratio to it."""

    gradient: jax.Array = param("m^2/{u}", 6e-8, 1e-9, 1e-6, "area per command")
    ratio: jax.Array = param("1", 1.0, 0.3, 3.0, "return edges to supply edges")

    def flows(self, at, drops=(), orifices=()):
        open_p, open_n = sides(*at.opening) if len(at.opening) == 1 else at.opening
        k = ORIFICE * self.gradient
        out_1, out_2 = root_flow(at.P_a1 - at.P_r), root_flow(at.P_a2 - at.P_r)
        q_1 = open_p * root_flow(at.P_s - at.P_a1) - self.ratio * open_n * out_1
        q_2 = open_n * root_flow(at.P_s - at.P_a2) - self.ratio * open_p * out_2
        return k * q_1, k * q_2


def rig_dict() -> dict:
    """A rig file of the generator, with this valve's parameters for the edges'."""
    tree = tomllib.loads(generator.rig_file("own", nominal()))
    kept = {k: v for k, v in tree["parameters"].items() if not k.startswith("c_")}
    own = {
        "gradient": {"start": "6e-8 m^2/V", "range": ["1e-8 m^2/V", "5e-7 m^2/V"]},
        "ratio": {"start": 1.0, "range": [0.5, 2.0]},
    }
    return tree | {"parameters": own | kept}


def truth() -> generator.Rig:
    """The recorded rig."""
    supply = ORIFICE * GRADIENT
    edges = {"c_p1": supply, "c_p2": supply}
    edges |= {"c_n1": RATIO * supply, "c_n2": RATIO * supply}
    return generator.draw_rig(3) | edges


def nominal() -> generator.Rig:
    return generator.nominal_rig(truth(), 3, 0.1)


@pytest.fixture(scope="module")
def rig() -> RigFile:
    return RigFile.from_dict(rig_dict(), valve=SharpEdges())


@pytest.fixture(scope="module")
def logs(tmp_path_factory) -> list[Log]:
    """To fit, and to validate."""
    folder = tmp_path_factory.mktemp("own_valve")
    for i in range(2):
        log = generator.record(truth(), 30 + i, seconds=6.0)
        generator.write_log(folder / f"log_{i}.csv", log)
    return [Log.load(folder / f"log_{i}.csv") for i in range(2)]


def test_its_parameters_are_the_rig_files(rig):
    names = list(parameter_specs(build_rig(rig)))
    assert names[:3] == ["gradient", "ratio", "beta"] and "c_p1" not in names
    with pytest.raises(InputError, match=r"\[parameters\] unknown .* 'c_p1'"):
        RigFile.from_text(generator.rig_file("own", nominal()), valve=SharpEdges())
    again = rig.with_text(rig.text)
    assert again.valve is rig.valve and again.parameters == rig.parameters


def test_a_parameter_that_the_rest_has_is_refused():
    class Stiff(SharpEdges):
        beta: jax.Array = param("Pa", 1e9, 1e8, 1e10, "of its own")

    with pytest.raises(InputError, match="Stiff declares beta"):
        RigFile.from_dict(rig_dict(), valve=Stiff())


def test_the_paper_s_law_does_not_invert_it(rig):
    with pytest.raises(InputError, match="not the valve SharpEdges"):
        build_loop(rig)
    loop = build_loop(replace(rig, law=PIController()))
    assert isinstance(loop.rig.valve, SharpEdges)


@pytest.mark.slow
def test_a_fit_finds_its_parameters(rig, logs):
    found = fit(rig, logs[:1], starts=1)
    table = found.parameters
    for name, want in (("gradient", GRADIENT), ("ratio", RATIO)):
        assert table.loc[name, "value"] == pytest.approx(want, rel=0.01)
        assert table.loc[name, "identified"]
    assert isinstance(found.rig.valve, SharpEdges)
    start = found.rig.parameters["gradient"].start
    assert start == pytest.approx(GRADIENT, rel=0.01)
    assert isinstance(found.model.valve, SharpEdges)


@pytest.mark.slow
def test_a_trace_misses_nothing(rig, logs):
    found = trace(rig, logs[:1], validate=logs[1:])
    assert found.verdict.startswith("nothing missing"), found.verdict


def test_edges_that_the_valve_lacks_are_refused(rig):
    """In one line, with the mend: its flows take two openings, and not four."""
    tree = rig_dict() | {"effects": {"return_overlap": {"o_n1": "0.1 V"}}}
    own = RigFile.from_dict(tree, valve=SharpEdges())
    with pytest.raises(InputError, match="not of SharpEdges; delete the effect") as e:
        build_rig(own)
    assert "\n" not in str(e.value)
