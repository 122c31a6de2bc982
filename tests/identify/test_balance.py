"""Flow balances at the measured pressures: where a fit begins, and which effect is
worth to begin with.

The logs are those of machines recorded by a plant that shares no code with this one.
"""

from __future__ import annotations

import tomllib
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import pytest

from hydrojax.identify.api import applicable
from hydrojax.identify.case import Case, Preparation
from hydrojax.identify.estimation.balance import (
    _weight,
    balance_at,
    balanced,
    descend,
)
from hydrojax.identify.estimation.columns import basis, filled, thinned
from hydrojax.identify.estimation.fit import FitPoint, fit_pressures
from hydrojax.identify.estimation.known import free_effect, free_parameters
from hydrojax.identify.estimation.memory import recalled
from hydrojax.identify.estimation.misfit import run_sums
from hydrojax.identify.estimation.pieces import Span
from hydrojax.identify.estimation.problem import Problem
from hydrojax.identify.estimation.starts import placed
from hydrojax.identify.preparation import data as preparation
from hydrojax.identify.preparation import windows
from hydrojax.identify.preparation.data import prepare_logs
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.identify.tracing.grids import bases, found_along
from hydrojax.identify.tracing.in_balances import (
    in_balances,
    near_in_balances,
    together,
)
from hydrojax.identify.tracing.loop import _in_steps, _several
from hydrojax.identify.tracing.rivals import taken_out
from hydrojax.identify.tracing.state import Tracing
from hydrojax.logs.log import Log
from hydrojax.parameters import specs
from hydrojax.rigfile.build import build_rig, effects_of
from hydrojax.rigfile.schema import RigFile
from tests.pages import ROOT

DATA = ROOT.parent / "shared" / "data"

MACHINES = {
    "machine_01": (
        "valve_deadband",
        {"u_dbp": (0.0610, 0.03), "u_dbn": (0.1245, 0.03)},
    ),
    "machine_04": ("flow_curve", {"k": (0.9, 0.1), "p": (2.63, 0.1)}),
}
"""What each lacks, and values (with relative tolerances) near which a search ends; the
fits of whole logs that follow agree with these."""


@pytest.fixture(scope="module", params=MACHINES)
def machine(request) -> tuple[str, Tracing]:
    """A machine and the state of its trace before anything is fitted."""
    folder = DATA / request.param
    if not folder.exists():
        pytest.skip("the machines' logs are not here")
    return request.param, state_of(folder)


def state_of(folder: Path) -> Tracing:
    spec = RigFile.load(folder / "rig.toml")
    logs = tuple(Log.load(folder / f"fit_{i}.csv") for i in (1, 2))
    data = prepare_logs(logs, spec)
    way = Preparation(spec, 0.25, data.noise, 1.0, data.band, Criteria())
    case = Case(spec, data, data, logs, logs, False, way)
    names = [n for n in applicable(case) if n not in spec.effects]
    effects = effects_of(names, spec)
    free = free_parameters(spec)
    known = dict(free)
    for name in names:
        known |= free_effect(name, specs(effects[name]))
    problem = Problem.of(build_rig(spec, names), known, data)
    point = FitPoint(problem.initial_values(), data.noise, 0, True)
    return Tracing(problem, problem, effects, tuple(free), point, print)


@pytest.mark.slow
def test_the_missing_effect_stands_out(machine):
    """It leaves less than a hundredth of the balances' squares, the next at least ten
    times that; and stands near where the fit of whole logs ends.
    """
    name, state = machine
    wanted, values = MACHINES[name]
    search = in_balances(state, state.effects, bases(state), Criteria().far_steps)
    assert search is not None
    found = found_along(state, state.effects, search)
    left = {n: min(f.left for f in fits) for n, fits in found.items()}
    order = sorted(left, key=lambda n: left[n])
    assert order[0] == wanted
    assert left[wanted] < 0.01 * search.here < 0.1 * left[order[1]]
    best = min(found[wanted], key=lambda f: f.left)
    for field, (value, rel) in values.items():
        at = state.problem.model.names.index(f"{wanted}.{field}")
        assert best.values[at] == pytest.approx(value, rel=rel)


@pytest.mark.slow
def test_what_does_not_act_on_the_pressures_is_left_to_the_replay(machine):
    search = in_balances(machine[1], machine[1].effects, bases(machine[1]), 0)
    assert search is not None
    assert "pressure_sensor_lag" in machine[1].effects
    assert "pressure_sensor_lag" not in search.effects


@pytest.mark.slow
def test_the_sensitivities_are_differences(machine):
    """The gradient of the sum of squares, along every free parameter."""
    problem, free = machine[1].problem, machine[1].free
    at = balance_at(problem, machine[1].point.values, free)
    scale = problem.model.scale[at.where]
    for k, i in enumerate(at.where):
        step = np.zeros(at.values.size)
        step[i] = 1e-5 * scale[k]
        ends = [
            balance_at(problem, v, free).left
            for v in (at.values + step, at.values - step)
        ]
        assert 2 * at.gram[k, -1] == pytest.approx(
            (ends[0] - ends[1]) / 2e-5, rel=2e-3, abs=1e-4 * at.left
        )


def test_what_is_known_beforehand_counts_as_much_as_one_of_the_rows(machine):
    """One standard deviation off it is as one more row of the size that is left."""
    problem, free = machine[1].problem, machine[1].free
    values, name = machine[1].point.values, problem.side(free, True)[0]
    own, at = problem.free[name], values[problem.model.names.index(name)]
    left = []
    for off in (0.0, 2.0, 4.0):
        known = replace(own, start=at + off * 0.1 * at, prior=0.1 * at)
        told = replace(problem, free={**problem.free, name: known})
        left.append(balance_at(told, values, free).left)
    more = np.array(left) / left[0] - 1
    ticks = problem.batch.windows.x_fine.shape[1]
    rows = 2 * len(problem.batch.P_0) * len(_weight(problem.batch))
    assert 0 < len(_weight(problem.batch)) < ticks
    np.testing.assert_allclose(more, [0.0, 4 / rows, 16 / rows], rtol=1e-6, atol=1e-12)


def test_a_descent_stays_in_the_ranges_and_lowers_the_squares(machine):
    problem, free = machine[1].problem, machine[1].free

    def evaluate(values, free):
        return balance_at(problem, values, free)

    first = evaluate(machine[1].point.values, free)
    last = descend(problem, evaluate, first, free, 4)
    assert last.left < 0.5 * first.left
    for name in free:
        f, value = problem.free[name], last.values[problem.model.names.index(name)]
        assert f.lower <= value <= f.upper


@pytest.mark.slow
def test_a_fit_begins_far_nearer_than_the_rig_file(machine):
    """By the replay's own errors of both pressures."""
    problem, free = machine[1].problem, machine[1].free
    given = machine[1].point.values
    errors = [
        np.sum(problem.errors_at(v)[:, :2])
        for v in (given, balanced(problem, given, free))
    ]
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.slow
def test_halved_substeps_change_little(machine, monkeypatch):
    """The replay at the balances' values: in nine windows of ten by under a tenth of
    the sensors' 9 kPa, and mostly by a hundredth. No fit has come near these values:
    in the rest the model is off by MPa, or a chamber runs empty, and one of them would
    decide a mean of the squares.
    """
    name, state = machine
    values = balanced(state.problem, state.point.values, state.free)
    monkeypatch.setattr(preparation, "SUBSTEP", windows.SUBSTEP / 2)
    fine = state_of(DATA / name).problem
    assert fine.batch.windows.x_fine.shape[-1] == 17  # 8 substeps, from 4
    coarse, fine = (p.residuals_at(values)[..., :2] for p in (state.problem, fine))
    off = np.sqrt(np.mean((coarse - fine) ** 2, axis=(1, 2)))
    assert 0 < np.median(off) < 90.0
    assert np.quantile(off, 0.9) < 9e3 / 10


@pytest.mark.slow
def test_lines_in_which_nothing_stands_are_left_out(machine):
    """The sums do not change by it; whatever stands in a line, or may, keeps it."""
    problem, free = machine[1].problem, machine[1].free
    model, values = problem.model, machine[1].point.values
    batch = filled(thinned(problem.batch, 4))
    lean, at = model.acting(values, free)
    assert model.rig.line and not lean.rig.line
    assert not [n for n in lean.names if n.startswith("counterbalance.")]
    assert lean.values.shape == at.shape == lean.scale.shape
    slots = problem.slots(free)

    def summed(model, values):
        directions = basis(model, free, slots)
        common = recalled(model, values, directions, batch.motion, True, ({}, {}))
        whole = (len(batch.P_0), Span(0, 1))
        return run_sums(model, values, directions, batch, common, *whole)

    ours, whole = summed(lean, np.asarray(at)), summed(model, np.asarray(values))
    for a, b in zip(ours, whole, strict=True):
        a, b = np.asarray(a), np.asarray(b)
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * np.abs(b).max())

    assert model.acting(values, ["counterbalance.P_set"])[0].rig.line
    # One column more takes no other program; one that fills a line does.
    assert problem.fits_alike(values, (*free, "valve_bias.u_0"), free)
    assert not problem.fits_alike(values, (*free, "counterbalance.k_1"), free)
    held = np.array(values)
    held[model.names.index("counterbalance.k_2")] = 1e11
    assert model.acting(held)[0].names == model.names


@pytest.mark.slow
def test_as_many_effects_as_there_are_find_room(machine):
    """A trace that adds effect upon effect never runs out of columns."""
    state = machine[1]
    problem = replace(state.problem, declared=(0, 0))
    hydraulic = problem.side(problem.free, True)
    assert len(hydraulic) > problem.most_slots(())[0]
    for free in (hydraulic, list(problem.free)):
        room = problem.slots(free)
        assert room[0] >= len(hydraulic)
        assert room[1] >= len(free) - len(hydraulic)
    at = balance_at(problem.brief, state.point.values, hydraulic)
    assert np.all(np.isfinite(at.gram))


def test_columns_of_forces_stay_few_where_the_rig_file_has_none(machine):
    """Where it has, both sides grow together, so that few programs serve every fit."""
    problem = replace(machine[1].problem, declared=(0, 0))
    many = problem.side(problem.free, True)[:10]
    assert problem.slots(many) == (16, 3)
    assert replace(problem, declared=(0, 2)).slots(many) == (16, 42)


@pytest.mark.slow
def test_effects_that_are_missing_together_are_told_apart_one_by_one():
    """Of nine the first five, none of which helps a replay without the others; and what
    none can take the place of is known by the balances.
    """
    folder = DATA / "machine_06"
    if not folder.exists():
        pytest.skip("the machines' logs are not here")
    state = state_of(folder)
    found = list(islice(together(state, state.effects), 5))
    sets = [there.added for there in found]
    truth = set(tomllib.loads((folder / "rig_declared.toml").read_text())["effects"])
    assert [len(names) for names in sets] == [1, 2, 3, 4, 5]
    assert {a.name for a in sets[-1]} <= truth
    assert "counterbalance" in {a.name for a in sets[-1]}  # which few steps do not show
    assert truth.isdisjoint(RigFile.load(folder / "rig.toml").effects)
    less = taken_out(found[-1], "signal_filter")
    names = ("dead_volume", "internal_leakage", "signal_filter")
    rivals = {n: state.effects[n] for n in names}
    near = near_in_balances(found[-1], less, rivals)
    assert near and [name for name, _ in near] == ["signal_filter"]


@pytest.mark.slow
def test_the_errors_of_effects_found_at_once_are_of_fits_one_after_the_other():
    folder = DATA / "machine_06"
    if not folder.exists():
        pytest.skip("the machines' logs are not here")
    state = state_of(folder)
    batch = thinned(state.problem.batch, 32)
    criteria = replace(state.criteria, together=3)
    problem = replace(state.problem, batch=batch, criteria=criteria)
    values = balanced(problem, state.point.values, state.free)
    fitted, values = fit_pressures(problem, values, state.free)
    point = replace(state.point, values=values)
    state = replace(state, problem=fitted, check=fitted, point=point)
    several = _several(state, state.effects, state.noise)
    several = _in_steps(several, state, state.noise)
    added = several.added
    assert len(added) >= 2 and len({a.p_value for a in added}) == 1
    rms = fitted.rms(fitted.errors_at(values))
    np.testing.assert_allclose(added[0].before, rms)
    for one, next_one in pairwise(added):
        np.testing.assert_array_equal(one.after, next_one.before)
    last = several.check.rms(several.check.errors_at(several.point.values))
    np.testing.assert_allclose(added[-1].after, last)
    # A fit with one of them may leave more, as it begins where the balances put it.
    assert np.all((last < 0.5 * rms)[:2])


@pytest.mark.slow
def test_an_effect_is_not_credited_with_what_own_parameters_do(machine):
    """Where those stand far off, and only their starts lead back: effects are tried
    from there too, and one that is not there would seem to do it.
    """
    state, name = machine[1], "internal_leakage"
    problem, free = state.problem, state.free
    far = placed(problem, state.point.values, {n: problem.free[n].lower for n in free})
    state = replace(state, point=replace(state.point, values=far))
    few = problem.brief
    there = balance_at(few, far, free)
    effects = {name: state.effects[name]}
    search = in_balances(state, effects, bases(state), 1)
    assert search is not None
    left = min(f.left for f in found_along(state, effects, search)[name])
    once = descend(few, search.evaluate, there, free, 1).left
    assert left < 0.7 * once
    assert left > 0.8 * search.here
