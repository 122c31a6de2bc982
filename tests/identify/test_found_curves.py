"""Curves in reports, and as effects of a user's own: laws in closed form."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import jsonschema
import numpy as np
import pytest
from scipy.interpolate import BSpline

from hydrojax import api
from hydrojax.cli import identify
from hydrojax.cli.options import load_catalogue
from hydrojax.cli.options import load_effects as take
from hydrojax.effects import EFFECTS, load_effects
from hydrojax.effects.splines import knots_over
from hydrojax.errors import InputError
from hydrojax.identify.case import Case
from hydrojax.identify.discovery import discover
from hydrojax.identify.discovery.effect_file import (
    FoundLaw,
    effect_file,
    effect_source,
    over,
)
from hydrojax.identify.discovery.formula import FORMS, Formula
from hydrojax.identify.discovery.free_form import TERMS, share_of_level
from hydrojax.identify.discovery.laid import laid_over
from hydrojax.identify.discovery.with_curves import without_line
from hydrojax.identify.report.write import plot, result_html, write_report
from hydrojax.identify.result import Result
from hydrojax.identify.results.curve import FoundCurve
from hydrojax.identify.results.outcome import (
    ChannelErrors,
    FoundEffect,
    Outcome,
    Parameter,
)
from hydrojax.identify.results.report_json import report_json
from hydrojax.paper import experiments
from hydrojax.plant.chambers import Point
from hydrojax.plant.friction import Sliding
from hydrojax.report.schema import report_schema
from hydrojax.rigfile.build import build_rig
from hydrojax.rigfile.schema import RigFile

REFERENCE = Path(experiments.__file__).with_name("reference.toml")
TERM = {term.name: term for term in TERMS}
FORM = {form.name: form for form in FORMS}
SPANS = {"v": (-0.02, 0.02), "P": (1e6, 9e6), "x": (-0.01, 0.01), "w": (-1e-3, 1e-3)}


def law(term: str, formula: Formula | None = None) -> FoundLaw:
    """Of a term whose curve is a sine over its range."""
    span = SPANS[TERM[term].signal]
    knots = knots_over(np.linspace(*span, 2001), 14)
    c = TERM[term].size * np.sin(np.arange(14.0))
    return FoundLaw(TERM[term], knots, c, span, formula)


def found(made: FoundLaw, says: str = "") -> FoundCurve:
    s = np.linspace(*made.seen, 31)
    return FoundCurve(
        name=made.term.name,
        place=made.term.place,
        signal=made.term.signal,
        signal_unit=made.signal_unit,
        factor=made.term.factor,
        unit=made.unit,
        s=1.2 * s,
        y=100 * np.sin(s / s[-1]),
        std=0 * s + 5.0,
        seen=made.seen,
        rug=s,
        p_value=1e-5,
        before={"F": 14.0},
        after={"F": 2.6},
        share=0.97,
        test_before={"F": 15.0},
        test_after={"F": 2.7},
        law=says or made.says(),
        law_y=101 * np.sin(s / s[-1]),
        source=effect_source(made, made.term.name),
    )


def outcome(*curves: FoundCurve) -> Outcome:
    return Outcome(
        command="trace",
        rig="a rig",
        fit_logs=("fit.csv",),
        validate_logs=("validate.csv",),
        verdict="unknown",
        sentence="Something is left.",
        parameters={"k_cp": Parameter(900.0, "N", "level", 800.0, True, 3.0)},
        seconds={"compile": 1.0, "run": 2.0},
        channels={"F": ChannelErrors("N", 2.5, 14.0, 14.0)},
        curves=curves,
    )


def written(folder, curve: FoundCurve) -> type:
    """The effect of a file that holds it."""
    path = folder / "my_effects.py"
    path.write_text(effect_file("a rig", [curve]))
    return load_effects(path)[curve.name]


def sliding(**given: float) -> Sliding:
    return Sliding(**(dict.fromkeys(Sliding._fields, 0.0) | given))


def bell() -> Formula:
    return Formula(FORM["bell"], (120.0,), (0.5,), 4e-3, -100.0, -90.0)


def test_a_report_holds_its_curves(tmp_path):
    own = outcome(found(law("free_level_v", bell())))
    write_report(own, tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    jsonschema.validate(report, report_schema())
    (curve,) = report["curves"]
    assert curve["law"] == "120 N * exp(-((v / 0.004 m/s) ** 2))"
    assert curve["unit"] == "N" and curve["signal_unit"] == "m/s"
    assert np.mean(curve["extrapolated"]) == pytest.approx(1 / 6, abs=0.05)
    page = (tmp_path / "report.html").read_text()
    assert "120 N * exp(-((v / 0.004 m/s) ** 2))" in page
    assert "my_effects.py" in page
    assert (tmp_path / "report_curve.png").stat().st_size > 5000
    assert plot(own, "curve").axes[0].get_xlabel().endswith("[mm/s]")


def test_a_curve_is_a_guess_where_no_sample_lies():
    """Beyond the samples, and between three pressures at which a bench was run."""
    rug = np.concatenate([p + np.linspace(-2e3, 2e3, 100) for p in (5e4, 1.5e5, 3.5e5)])
    one = replace(
        found(law("free_level_x")),
        s=np.linspace(3e4, 3.6e5, 34), y=np.ones(34), std=np.ones(34), law_y=None,
        seen=(rug[0], rug[-1]), rug=rug,
    )  # fmt: skip
    ends = (3e4, 4.8e4), (5.2e4, 1.48e5), (1.52e5, 3.48e5), (3.52e5, 3.6e5)
    np.testing.assert_allclose(one.unseen, ends)
    away = np.abs(one.s[:, None] - np.array([5e4, 1.5e5, 3.5e5]))
    near = np.min(away, axis=1) < 2e3
    np.testing.assert_array_equal(one.extrapolated, ~near)
    assert report_json(outcome(one))["curves"][0]["extrapolated"] == (~near).tolist()
    drawn = plot(outcome(replace(one, y=np.where(near, 1.0, 9e3))), "curve")
    assert "no samples" in [t.get_text() for t in drawn.legends[0].get_texts()]
    assert drawn.axes[0].get_ylim()[1] < 5  # what the logs show, not the guess
    even = replace(
        one,
        s=np.array(rug[[0, -1]]),
        y=np.ones(2),
        std=np.ones(2),
        rug=np.linspace(*one.seen, 50),
    )
    assert even.unseen == () and not any(even.extrapolated)


def test_an_effect_that_was_found_as_a_curve_says_so():
    curve = found(law("free_level_v", bell()))
    errors = ({"F": 14.0}, {"F": 2.6})
    effects = [
        FoundEffect(name, {}, 1e-9, *errors, (), "v")
        for name in ("free_level_v", "valve_lag")
    ]
    own = replace(outcome(curve), effects=tuple(effects))
    one, other = report_json(own)["effects"]
    assert one["curve"]["signal"] == "v" and one["curve"]["unit"] == "N"
    assert one["curve"]["at"] == pytest.approx(curve.s)
    assert one["curve"]["value"] == pytest.approx(curve.y)
    assert one["formula"] == "120 N * exp(-((v / 0.004 m/s) ** 2))"
    assert "curve" not in other


def test_a_report_without_curves_has_no_file_of_them(tmp_path):
    write_report(outcome(), tmp_path)
    assert not (tmp_path / "my_effects.py").exists()
    assert not (tmp_path / "report_curve.png").exists()


def test_a_formula_is_an_effect(tmp_path, vocabulary):
    """Its law is the form's, with the strengths at what was found."""
    kind = written(tmp_path, found(law("free_level_v", bell())))
    effect = kind(a_1=120.0, s_0=4e-3)
    v = np.linspace(-0.02, 0.02, 41)
    got = [float(effect.level(sliding(v=one), 900.0)) for one in v]
    np.testing.assert_allclose(got, 120 * np.exp(-((v / 4e-3) ** 2)), rtol=1e-6)


def test_a_curve_is_an_effect_of_one_strength(tmp_path, vocabulary):
    made = law("free_flow_per_filling_P")
    kind = written(tmp_path, found(made, "none"))
    at = Point(3e6, 5e6, 14e6, 2.5e5, (0.5,), 0.0, 0.0)
    filling, other = kind(amount=2.0).flow(at)
    want = BSpline(made.knots, made.coefficients, 3)(3e6)
    np.testing.assert_allclose(float(filling), 2 * 0.5 * want, rtol=1e-5)
    assert float(other) == 0.0


def test_a_curve_with_hysteresis_is_an_effect_that_slides(tmp_path, vocabulary):
    made = law("free_hysteresis_w_1000um")
    kind = written(tmp_path, found(made, "none"))
    w = np.linspace(-9e-4, 9e-4, 7)
    want = BSpline(made.knots, made.coefficients, 3)(w)
    np.testing.assert_allclose(kind(amount=2.0).force(w), 2 * want, rtol=1e-5)
    assert kind().reach() == 1e-3


@pytest.mark.parametrize(
    ("term", "at", "times"),
    [
        ("free_level_since", {"since": 0.3}, 1.0),
        ("free_level_age_1000um", {"ages": (0.9, 0.3, 0.1)}, 1.0),
        ("free_level_per_P_mean_x", {"x": 0.3, "P_a1": 2e6, "P_a2": 6e6}, 4e6),
        ("free_friction_per_v_t", {"t": 0.3, "v": -0.02}, -0.02),
        ("free_level_P_a1", {"P_a1": 0.3, "P_a2": 6e6}, 1.0),
        ("free_level_P_a2", {"P_a1": 2e6, "P_a2": 0.3}, 1.0),
    ],
)
def test_a_curve_times_another_signal_and_one_with_a_memory_are_effects(
    term, at, times, tmp_path, vocabulary
):
    span = np.linspace(-1.0, 1.0, 301)
    made = replace(law("free_level_v"), term=TERM[term], knots=knots_over(span, 14))
    effect = written(tmp_path, found(made, "none"))(amount=2.0)
    got = (effect.level(sliding(**at), 900.0) if term.startswith("free_level")
           else effect.force(sliding(**at)))  # fmt: skip
    want = BSpline(made.knots, made.coefficients, 3)(0.3)
    np.testing.assert_allclose(got, 2 * times * want, rtol=1e-5)
    remembered = term in ("free_level_since", "free_level_age_1000um")
    assert effect.of_turns == remembered


def test_a_share_of_the_coulomb_level_is_an_effect(tmp_path, vocabulary):
    """Of the level of its direction, as it is searched and as it is written."""
    term = share_of_level(TERM["free_level_way"])
    knots = knots_over(np.linspace(0.0, 1.0, 301), 14)
    c = 0.1 * np.cos(np.arange(14.0))
    effect = written(
        tmp_path, found(FoundLaw(term, knots, c, (0.0, 1.0), None), "none")
    )
    assert effect.name == "free_level_per_level_way"
    at, share = sliding(way=0.3, ages=(0.0,) * 3), BSpline(knots, c, 3)(0.3)
    laid: Any = replace(
        term.laid(knots), **{f"c_{i}": v / 0.1 for i, v in enumerate(c)}
    )
    for base in (700.0, 1400.0):
        want = pytest.approx(base * share, rel=1e-5)
        assert float(effect(amount=1.0).level(at, base)) == want
        assert float(laid.level(at, base)) == want
    wave = replace(bell(), amplitudes=(0.2,), shape=0.01)
    made = FoundLaw(term, knots, c, (0.0, 1.0), wave)
    assert made.says() == "0.2 * level * exp(-((way / 0.01 m) ** 2))"


COMMANDS = (0.0, 0.3, 0.9, 0.9, 0.75, 0.2, -0.4, -0.35)


def went_back(us, reach):
    """How far each command went back since it turned."""
    w, out = 0.0, []
    for before, u in zip(us[:1] + us[:-1], us, strict=True):
        w = min(max(w + u - before, -reach), reach)
        out.append(w)
    return out


def lay_behind(us, tau, h):
    """By how much a lag is behind each held command, in the mean of its tick."""
    y, out = us[0], []
    for u in us:
        part = y + (u - y) * -np.expm1(-np.linspace(0, h, 20001) / tau)
        out.append(np.mean(part) - u)
        y = part[-1]
    return out


@pytest.mark.parametrize("kind", ["written", "searched"])
@pytest.mark.parametrize(
    ("term", "signal"),
    [
        ("free_command_back_300m", went_back(COMMANDS, 0.3)),
        ("free_command_behind_3ms", lay_behind(COMMANDS, 3e-3, 1e-3)),
    ],
)
def test_a_curve_of_what_the_command_did_is_a_channel(
    kind, term, signal, tmp_path, vocabulary
):
    """As it is searched and as it is written: by loops of plain Python."""
    span = np.linspace(-1.0, 1.0, 301)
    own = replace(TERM[term], edges=COEFFICIENTS)
    made = replace(law("free_level_v"), term=own, knots=knots_over(span, 14))
    effect: Any
    if kind == "written":
        effect = written(tmp_path, found(made, "none"))(amount=2.0)
    else:
        c = 2 * made.coefficients / made.term.size
        effect = made.term.laid(made.knots)
        effect = replace(effect, **{f"c_{i}": np.float64(v) for i, v in enumerate(c)})
    memory, got = effect.init(np.float64(COMMANDS[0])), []
    for u in COMMANDS:
        memory, out = effect.step(memory, np.float64(u), 1e-3)
        got.append(float(out) - u)
    want = 2 * BSpline(made.knots, made.coefficients, 3)(signal)
    np.testing.assert_allclose(got, want, atol=2e-4 * np.ptp(want))


def test_a_written_effect_says_where_it_is_a_guess(tmp_path, vocabulary):
    gaps = ((-0.01, -0.005), (2e-3, 6e-3))
    says = {}
    for name, own in (("even", ()), ("gaps", gaps)):
        made = replace(law("free_level_v", bell()), gaps=own)
        text = effect_source(made, "free_level_v")
        assert max(map(len, text.splitlines())) <= 88
        says[name] = " ".join(text.split())
    both = "from -0.01 to -0.005 m/s, from 0.002 to 0.006 m/s."
    assert f"Without samples, and a guess, {both}" in says["gaps"]
    assert "Without samples" not in says["even"]
    for said in says.values():
        assert "It rests on v from -0.02 to 0.02 m/s; beyond that it is" in said
    text = effect_source(replace(made, term=TERM["free_command_behind_30ms"]), "late")
    said = " ".join(text.split())
    assert "on behind, how far a lag of 30 ms is behind the command, from -0.02" in said
    text = effect_source(replace(made, term=TERM["free_flow_per_through_t"]), "wears")
    said = " ".join(text.split())
    assert "through is the flow through the valve." in said


COEFFICIENTS = (2.1e-9, 1.3e-9, 2.6e-9, 1.7e-9)
"""Of the edges: supply to chamber 1, 1 to return, supply to 2, 2 to return."""

HEADS = {
    0.5: (2.1e-9 * 11e6**0.5, -1.7e-9 * 4.75e6**0.5),
    -0.5: (1.3e-9 * 2.75e6**0.5, -2.6e-9 * 9e6**0.5),
}
"""By command, coefficients times roots of what drops at 3 and 5 MPa over the edges that
are open.
"""


@pytest.mark.parametrize("kind", ["written", "searched"])
@pytest.mark.parametrize("spool", HEADS)
@pytest.mark.parametrize(
    ("term", "times"),
    [
        ("free_flow_across_per_P_net_x", lambda u: (2e6, -2e6)),
        ("free_flow_across_per_P_net_t", lambda u: (2e6, -2e6)),
        ("free_flow_v", lambda u: (1.0, 1.0)),
        ("free_flow_per_head_t", lambda u: HEADS[u]),
        ("free_flow_per_head_P_s", lambda u: HEADS[u]),
        ("free_flow_per_through_t", lambda u: (u * HEADS[u][0], u * HEADS[u][1])),
    ],
)
def test_a_flow_over_any_signal_is_an_effect(
    kind, spool, term, times, tmp_path, vocabulary
):
    """As it is searched and as it is written: the signal stands at 0.3."""
    span = np.linspace(-1.0, 1.0, 301) * (5e7 if term.endswith("P_s") else 1.0)
    own = replace(TERM[term], edges=COEFFICIENTS)
    made = replace(law("free_level_v"), term=own, knots=knots_over(span, 14))
    effect: Any
    if kind == "written":
        effect = written(tmp_path, found(made, "none"))(amount=1.0)
    else:
        c = enumerate(made.coefficients / made.term.size)
        effect = replace(made.term.laid(made.knots), **{f"c_{i}": v for i, v in c})
    at = Point(3e6, 5e6, 14e6, 2.5e5, (spool,), 0.3, 0.3, t=0.3)
    s = 14e6 if term.endswith("P_s") else 0.3
    want = BSpline(made.knots, made.coefficients, 3)(s) * np.array(times(spool))
    np.testing.assert_allclose(effect.flow(at), want, rtol=1e-4)


@pytest.mark.parametrize("kind", ["written", "searched"])
def test_a_load_cell_that_bends_is_an_effect(kind, tmp_path, vocabulary):
    """A curve over the force that it is added to: what the cell then feels."""
    span = np.linspace(-400.0, 400.0, 301)
    term = TERM["free_force_F"]
    made = replace(law("free_force_x"), term=term, knots=knots_over(span, 14))
    if kind == "written":
        effect = written(tmp_path, found(made, "none"))(amount=1.0)
    else:
        c = enumerate(made.coefficients / term.size)
        effect = replace(term.laid(made.knots), **{f"c_{i}": v for i, v in c})
    rig, bent = (build_rig(RigFile.load(REFERENCE), (), own) for own in ((), [effect]))
    at = sliding(v=0.01, speed=0.01, z=1e-5, P_a1=4.2e6, P_a2=4.6e6)._replace(slips=())
    F = float(rig.output_force(at))
    assert 50 < abs(F) < 350
    want = F + BSpline(made.knots, made.coefficients, 3)(F)
    assert abs(want - F) > 5
    np.testing.assert_allclose(bent.output_force(at), want, rtol=1e-5)


def test_a_bent_cell_is_not_looked_for_beside_a_gain():
    """Its straight line is that gain: a fit had the force's own negative. A gain that
    the rig file declares stays; one that was found goes.
    """
    samples = {"F": np.linspace(-400.0, 400.0, 301), "x": np.linspace(0.0, 0.02, 301)}
    laid = [
        {one.term.name: one for one in laid_over(samples, {}, declared)}
        for declared in ((), ("loadcell_gain",))
    ]
    assert laid[0].keys() - laid[1].keys() == {"free_force_F"}
    free = ("k_0", "loadcell_gain.eps", "loadcell_bias.b")
    assert without_line(free, laid[0]["free_force_F"]) == ("k_0", "loadcell_bias.b")
    assert without_line(free, laid[0]["free_force_x"]) == free


def test_what_a_valve_does_is_by_its_own_coefficients():
    """And is not looked for in a valve that has none."""
    values = dict(zip(("c_p1", "c_n1", "c_p2", "c_n2"), COEFFICIENTS, strict=True))
    samples = {"t": np.linspace(0.0, 20.0, 301)}
    laid = {one.term.name: one.term for one in laid_over(samples, values)}
    assert laid["free_flow_per_head_t"].edges == COEFFICIENTS
    without = {one.term.name for one in laid_over(samples, {"beta": 1e9})}
    assert laid.keys() - without == {"free_flow_per_head_t", "free_flow_per_through_t"}


@pytest.mark.parametrize("form", FORMS, ids=lambda f: f.name)
def test_every_form_can_be_written(form, tmp_path, vocabulary):
    """And is what it is fitted as, but for its rounded corners."""
    span = 0.01
    a = tuple(30.0 / span**p for p in form.powers)
    formula = Formula(form, a, a, 0.4 * span if form.shape else None, 0.0, 0.0)
    made = law("free_force_x", formula)
    kind = written(tmp_path, found(made))
    given = {f"a_{i + 1}": size for i, size in enumerate(a)}
    if form.shape:
        given["s_0"] = 0.4 * span
    effect, x = kind(**given), np.linspace(-span, span, 41)
    got = [float(effect.force(sliding(x=one))) for one in x]
    np.testing.assert_allclose(got, formula.at(x), atol=0.05 * np.ptp(formula.at(x)))


def test_a_summary_says_its_curves():
    said = Result(outcome(found(law("free_level_v", bell()))), Mock()).summary()
    said = " ".join(said.split())
    assert "free_level_v: 97 % of the excess" in said
    assert "120 N * exp" in said


@pytest.mark.parametrize("verdict", ["unknown", "explained"])
def test_the_command_traces_again_with_what_it_found(
    verdict, tmp_path, monkeypatch, vocabulary, call
):
    """Only where the first trace ends unknown; the traces themselves are made up."""
    known = []
    first = replace(outcome(), verdict=verdict)
    second = replace(outcome(), verdict="explained", sentence="All of it.")
    curve = found(law("free_level_v", bell()))

    def discover(result, progress):
        return replace(result, outcome=replace(result.outcome, curves=(curve,)))

    def traced(*args):
        known.extend(EFFECTS)
        return second

    monkeypatch.setattr(api, "trace", lambda *_, **__: Result(first, Mock()))
    monkeypatch.setattr(api, "discover", discover)
    monkeypatch.setattr(api.api, "trace_case", traced)
    done = call("trace", "rig.toml", "a.csv", "--validate", "b.csv", "--discover",
               "--out", str(tmp_path / "out"))  # fmt: skip
    assert done.code == 0
    again = verdict == "unknown"
    assert ("free_level_v" in known) == again
    assert (tmp_path / "out" / "my_effects.py").exists() == again
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert len(report["curves"]) == again
    assert report["verdict"] == "explained"


@pytest.mark.parametrize(
    ("term", "form", "shape", "span"),
    [
        ("free_level_x", "ramp", 0.47, (0.45, 0.5)),
        ("free_level_x", "ramp down", 5e-4, (0.0, 1e-3)),
        ("free_level_x", "dead zone", 0.2, (0.19, 0.24)),
        ("free_level_P_mean", "ramp", 12e6, (11.5e6, 12.8e6)),
        ("free_friction_v", "bell", 1.2e-4, (0.0, 5e-3)),
        ("free_friction_v", "decay", 5e-6, (0.0, 1e-4)),
        ("free_level_P_net", "bell", 5e4, (-1e6, 1e6)),
        ("free_compliance_P", "bell", 1e5, (0.0, 1e6)),
    ],
)
def test_a_law_that_acts_far_from_where_effects_are_tried_is_taken(
    term, form, shape, span, tmp_path, vocabulary
):
    formula = Formula(FORM[form], (2.0,), (0.1,), shape, 0.0, 0.0)
    made = FoundLaw(TERM[term], np.zeros(12), np.zeros(8), span, formula)
    effect = written(tmp_path, found(made))
    s = np.linspace(*span, 200)
    got = np.asarray(effect(a_1=1.0).along(s))
    want = FORM[form].of(s, shape)[0]
    np.testing.assert_allclose(got, want, atol=0.02 * np.ptp(want))


@pytest.mark.parametrize("simulate", [True, False])
def test_curves_of_flow_need_a_command(simulate, monkeypatch):
    """Where the pressures are given no flow moves them, and its columns are zero."""
    problem = SimpleNamespace(model=SimpleNamespace(rig=None), simulate=simulate)
    start = SimpleNamespace(state=SimpleNamespace(problem=problem, named={}))
    rng = np.random.default_rng(0)
    samples = {name: rng.normal(size=500) for name in ("v", "x", "t")}
    laid = []
    monkeypatch.setattr(discover, "begun", lambda *_: start)
    monkeypatch.setattr(discover, "samples_of", lambda *_: samples)
    monkeypatch.setattr(discover, "search", lambda _, every: laid.extend(every))
    monkeypatch.setattr(discover, "found_curves", lambda *_: ())
    case = SimpleNamespace(fit=None, check=None, spec=SimpleNamespace(effects={}))
    discover.searched(case, outcome())
    places = {one.term.place for one in laid}
    assert {"friction", "level"} <= places
    assert ("flow" in places) == simulate


def test_found_effects_that_a_rig_file_may_name_are_not_replaced(tmp_path):
    first = outcome(found(law("free_level_v", bell())))
    write_report(first, tmp_path)
    before = (tmp_path / "my_effects.py").read_text()
    write_report(first, tmp_path)  # the same again
    assert not (tmp_path / "my_effects_2.py").exists()
    second = outcome(found(law("free_force_x")))
    for _ in range(2):
        write_report(second, tmp_path)
    assert (tmp_path / "my_effects.py").read_text() == before
    assert "free_force_x" in (tmp_path / "my_effects_2.py").read_text()
    assert not (tmp_path / "my_effects_3.py").exists()
    page = (tmp_path / "report.html").read_text()
    assert "--effects my_effects_2.py" in page


@pytest.mark.parametrize("name", [r"C:\Users\rig", 'my "rig"""', r"a\N{x}"])
def test_a_rig_of_any_name_has_its_file(name, tmp_path, vocabulary):
    path = tmp_path / "my_effects.py"
    path.write_text(effect_file(name, [found(law("free_level_v", bell()))]))
    assert "free_level_v" in load_effects(path)


def test_a_folder_of_found_effects_is_taken(tmp_path, vocabulary):
    for term in ("free_level_v", "free_force_x"):
        text = effect_file("a rig", [found(law(term), "none")])
        (tmp_path / f"{term}.py").write_text(text)
    take([tmp_path])
    assert {"free_level_v", "free_force_x"} <= set(EFFECTS)
    (tmp_path / "none").mkdir()
    with pytest.raises(InputError, match="none: holds no Python file"):
        take([tmp_path / "none"])


def test_curves_need_a_validation_log():
    case = Mock(held_out=False)
    with pytest.raises(InputError, match="give at least one with validate"):
        api.discover(Result(outcome(), case))


def test_units_over_units():
    assert over("N", "m/s", 1) == "N*s/m"
    assert over("N", "m/s^2", 2) == "N*s^4/m^2"
    assert over("m^3/(s*{u})", "Pa", 1) == "m^3/{u}/Pa/s"
    assert over("{u}", "{u}", 1) == "1"


def named(curve: FoundCurve, rig: str) -> Result:
    """A trace of a rig that names the curve."""
    errors = ({"F": 14.0}, {"F": 2.6})
    effect = FoundEffect(curve.name, {}, 1e-9, *errors, (), "v")
    return Result(replace(outcome(curve), rig=rig, effects=(effect,)), Mock())


def test_what_is_kept_is_searched_next_time(tmp_path, vocabulary):
    """Two rigs and one twice: each its own file and name, with the law unchanged, also
    where nothing of the folder was loaded between.
    """
    folder = tmp_path / "found" / "effects"
    curve = found(law("free_level_v", bell()))
    rigs = ("Crane 7, boom", "2nd crane", "Crane 7, boom")
    kept = [named(curve, rig).keep(folder) for rig in rigs]
    assert [path.name for path in kept] == [
        "crane_7_boom.py", "rig_2nd_crane.py", "crane_7_boom_2.py"
    ]  # fmt: skip
    assert sorted(folder.iterdir()) == sorted(kept)
    first = load_effects(kept[0])
    again = named(curve, "Crane 7, boom").keep(folder)
    every: dict[str, Any] = {
        **first, **load_effects(kept[1]), **load_effects(again)
    }  # fmt: skip
    assert list(every) == [
        "crane_7_boom_free_level_v", "rig_2nd_crane_free_level_v",
        "crane_7_boom_free_level_v_3",
    ]  # fmt: skip
    every |= load_effects(kept[2])
    assert list(every)[-1] == "crane_7_boom_free_level_v_2"
    for kind in every.values():
        got = float(kind(a_1=120.0, s_0=4e-3).level(sliding(v=3e-3), 900.0))
        assert got == pytest.approx(120 * np.exp(-((3 / 4) ** 2)), rel=1e-6)


def test_a_curve_that_the_trace_does_not_name_is_not_kept(tmp_path):
    curve = found(law("free_level_v", bell()))
    assert Result(outcome(curve), Mock()).keep(tmp_path / "found") is None
    assert not (tmp_path / "found").exists()


def test_a_catalogue_that_cannot_be(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is a file: name a folder with --catalogue"):
        load_catalogue(tmp_path / "file")
    with pytest.raises(InputError, match="cannot be written: .*; name another folder"):
        named(found(law("free_level_v", bell())), "a").keep(tmp_path / "file" / "sub")
    load_catalogue(tmp_path / "none yet")


def test_the_report_is_there_where_the_catalogue_cannot_be_written(
    tmp_path, monkeypatch
):
    """A trace takes minutes: they are not lost to a folder that is none."""
    (tmp_path / "file").write_text("")
    result = named(found(law("free_level_v", bell())), "a")
    monkeypatch.setattr(identify, "command_line", lambda _: "hydrojax trace")
    with pytest.raises(InputError, match="cannot be written"):
        identify._finish(
            Mock(), result, tmp_path / "out", False, True, (), tmp_path / "file" / "c"
        )
    assert (tmp_path / "out" / "report.json").exists()


def test_a_report_holds_the_parameters_beside_a_curve(tmp_path):
    wide = Parameter(
        905.0, "N", "level", 800.0, True, 70.0, (767.8, 1042.2), identified=True
    )
    own = replace(outcome(found(law("free_level_v", bell()))), beside={"k_cp": wide})
    write_report(own, tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    jsonschema.validate(report, report_schema())
    assert report["beside"]["k_cp"]["interval"] == [767.8, 1042.2]
    assert report["parameters"]["k_cp"]["value"] == 900.0
    page = (tmp_path / "report.html").read_text()
    assert "With the curves in place" in page and "905" in page
    assert "beside the curves" in result_html(own)
    assert "beside the curves" not in result_html(outcome())
    shown = Result(own, Mock(spec=Case))
    assert shown.beside.loc["k_cp", "std"] == 70.0
    assert "with the curves in place" in shown.summary()
