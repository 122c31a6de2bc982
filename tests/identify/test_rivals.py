"""Effects that were added, questioned again: a wrong one is exchanged, a needless one
let go.

The logs are the generator's, of a rig that leaks between its chambers; which effects
were added is set by hand.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.trace import cases
from benchmarks.trace.catalogue import NAMED
from hydrojax.identify import api
from hydrojax.identify.case import open_case
from hydrojax.identify.estimation import fit
from hydrojax.identify.estimation.fit import FitPoint, fit_all, only
from hydrojax.identify.estimation.problem import PRESSURES, Problem
from hydrojax.identify.estimation.starts import placed
from hydrojax.identify.preparation.noise import Noise
from hydrojax.identify.tracing import loop, refit, rivals
from hydrojax.identify.tracing.judge import better, may_rise, worsened
from hydrojax.identify.tracing.rivals import (
    beyond_position,
    exchanged,
    pruned,
    shed,
    with_look_alikes,
)
from hydrojax.identify.tracing.score import Score
from hydrojax.identify.tracing.state import Added, Tracing, free_names

TRUE, WRONG = "internal_leakage", "external_leakage"
NONE = np.full(3, np.nan)


@pytest.fixture(scope="module")
def opened(recorded):
    """Problems on both sets of logs, what is free, and candidates."""
    folder = recorded(4, {TRUE: {}})
    logs = [folder / f"{name}.csv" for name in ("fit_1", "fit_2", "validate")]
    case = open_case(folder / "rig.toml", logs[:2], logs[2:])
    names = [TRUE, WRONG, "valve_bias", "valve_rate_limit", "stribeck"]
    return api._problems(case, names)


@pytest.fixture(scope="module")
def leaking(opened) -> Callable[..., Tracing]:
    """The state of a trace that has added these effects, fitted, and what it says."""
    problem, check, declared, effects = opened

    def fitted(*names: str, progress: Callable[[str], None] = print) -> Tracing:
        own = (n for name in names for n in free_names(effects[name]))
        free = (*declared, *own)
        found, point = fit_all(problem, problem.initial_values(), free)
        added = tuple(Added(name, 0.0, NONE, NONE, ()) for name in names)
        return Tracing(found, check, effects, free, point, progress, added)

    return fitted


def unfitted(opened, *names: str) -> Tracing:
    """The state of a trace that has added these effects, where it begins."""
    problem, check, declared, effects = opened
    own = (n for name in names for n in free_names(effects[name]))
    values, noise = problem.initial_values(), np.asarray(problem.batch.noise)
    point = FitPoint(values, noise, 0, True)
    added = tuple(Added(name, 0.0, NONE, NONE, ()) for name in names)
    return Tracing(problem, check, effects, (*declared, *own), point, print, added)


def names_of(state: Tracing) -> list[str]:
    return [a.name for a in state.added]


@pytest.mark.slow
def test_a_rival_that_does_better_takes_an_effects_place(leaking):
    wrong = leaking(WRONG)
    right = exchanged(wrong, wrong.effects, wrong.noise)
    assert names_of(right) == [TRUE]
    assert set(right.free) == set(leaking(TRUE).free)
    after, before = (
        s.check.rms(s.check.errors_at(s.point.values)) for s in (right, wrong)
    )
    assert np.all(after <= 1.1 * right.noise) and np.any(before > 1.5 * wrong.noise)
    # Once all is at its noise nobody asks.
    assert exchanged(right, right.effects, right.noise) is right


@pytest.mark.slow
@pytest.mark.parametrize("order", [(WRONG, TRUE), (TRUE, WRONG)])
def test_the_needless_one_of_two_is_let_go_and_the_other_not_even_tried(leaking, order):
    said: list[str] = []
    both = leaking(*order, progress=said.append)
    left = pruned(both, both.noise, fresh=0)
    assert names_of(left) == [TRUE]
    assert left.tried == {WRONG: "needless"}
    assert said == [f"refit without {WRONG}", f"let go of {WRONG}"]


@pytest.mark.slow
def test_the_last_one_is_not_questioned(leaking):
    both = leaking(TRUE, WRONG)
    assert pruned(both, both.noise) is both


def test_what_came_to_nothing_is_let_go(opened):
    state = unfitted(opened, TRUE, WRONG)
    at = state.problem.model.names.index(f"{TRUE}.c_il")
    state.point.values[at] = 2e-13
    left = shed(state)
    assert names_of(left) == [TRUE] and left.tried == {WRONG: "too small"}
    assert set(state.free) - set(left.free) == set(free_names(state.effects[WRONG]))
    assert shed(left) is left


@pytest.mark.parametrize("shows", [True, False])
def test_what_was_found_beside_an_effect_that_is_let_go_is_fitted_again(
    opened, monkeypatch, shows
):
    """Sensors' biases had been bent to a valve that turned out to be another's."""
    state = unfitted(opened, TRUE, WRONG)
    names = list(state.problem.model.names)
    strong, weak = (
        names.index(f"{n}.{f}") for n, f in ((TRUE, "c_il"), (WRONG, "c_el"))
    )
    state.point.values[[strong, weak]] = 2e-13, 1e-14
    own = set(free_names(state.effects[WRONG]))

    def least_is_more(problem, values, effect):
        return effect.name == WRONG

    def fit_from(less, values, free, noise):
        assert not own & set(free)
        values = values.copy()
        values[strong] = 1e-13
        return less.problem, replace(less.point, values=values)

    monkeypatch.setattr(rivals, "negligible", least_is_more)
    monkeypatch.setattr(rivals, "fit_from", fit_from)
    check = _Leaks(state.check, weak if shows else None)
    left = shed(replace(state, check=check))
    assert names_of(left) == [TRUE] and left.tried == {WRONG: "too small"}
    assert left.point.values[strong] == (1e-13 if shows else 2e-13)


@pytest.mark.parametrize(("off", "kept"), [(3.0, [TRUE]), (0.5, [])])
def test_nothing_is_named_where_the_declared_model_leaves_no_more(opened, off, kept):
    """By the noise of the one: that of the other has its pressures begin elsewhere."""
    state = unfitted(opened, TRUE)
    place = list(state.problem.model.names).index(f"{TRUE}.c_il")
    base = replace(unfitted(opened), check=_Leaks(state.check, None, 4 - off))
    state.point.values[place] = 2e-13
    state = replace(state, check=_Leaks(state.check, place, off))
    left = api._or_none(state, base)
    assert names_of(left) == kept
    assert left.tried == ({} if kept else {TRUE: "does not help"})


def test_a_rival_that_comes_to_less_than_its_least_takes_no_place(opened, monkeypatch):
    state = unfitted(opened, WRONG)
    place = list(state.problem.model.names).index(f"{TRUE}.c_il")
    state = replace(state, check=_Leaks(state.check, place))
    found = state.point.values.copy()
    found[place] = 2e-13

    def rival(*_):
        yield TRUE, state.problem, replace(state.point, values=found)

    monkeypatch.setattr(rivals, "_in_place_of", rival)
    others = {TRUE: state.effects[TRUE]}
    assert names_of(rivals.exchanged(state, others, state.noise)) == [TRUE]
    monkeypatch.setattr(rivals, "negligible", lambda *_: True)
    assert rivals.exchanged(state, others, state.noise) is state


class _Leaks:
    """Stands for validation logs in which a leak shows: `off` without it; or for such
    in which it does not.
    """

    def __init__(self, check, place, off=3.0):
        self.batch, self.place, self.off = check.batch, place, off

    def errors_at(self, values):
        off = self.off * np.array([0.9, 1.0, 1.0, 1.1])
        if self.place is None or values[self.place]:
            off = np.ones(4)
        return np.tile(off[:, None], 3) * np.asarray(self.batch.noise) ** 2

    def rms(self, errors):
        return np.sqrt(np.mean(errors, axis=0))


@pytest.mark.parametrize(
    ("bare", "rms", "kept"),
    [(1.16, 1.12, False), (1.16, 1.30, True), (1.0, 1.12, True)],
    ids=["all of the fall", "part of it", "none of it"],
)
def test_what_only_answers_the_positions_noise_is_let_go(
    opened, monkeypatch, bare, rms, kept
):
    """Of the force's noise with the effect: that without it, and the error then. A mass
    took 0.12 of it away where the position's noise brought 0.16 less by it.
    """
    state = unfitted(opened, TRUE)
    monkeypatch.setattr(rivals, "without", lambda s, n, _: rivals.taken_out(s, n))

    def of_force(state: Tracing, alone: float) -> np.ndarray:
        return state.noise * np.array([1.0, 1.0, 1.0 if state.added else alone])

    monkeypatch.setattr(rivals, "_rms", lambda s: of_force(s, rms))
    strength = state.problem.model.names.index(f"{TRUE}.c_il")
    state.point.values[strength] = 2e-13

    def noise_by(problem: Problem, values: np.ndarray) -> Noise:
        ratio = np.array([1.0, 1.0, 1.0 if values[strength] else bare])
        return Noise(10 * state.noise, ratio * state.noise)

    left = beyond_position(state, noise_by)
    assert names_of(left) == ([TRUE] if kept else [])
    assert left.tried == ({} if kept else {TRUE: "answers noise"})


def test_no_effect_may_bend_the_pressures_for_the_force(opened):
    state = unfitted(opened)
    own, noise = state.criteria, state.noise
    wide = own.matters * noise
    assert 0 < own.bends < own.matters
    leak, friction = state.effects[TRUE], state.effects["stribeck"]
    assert np.array_equal(may_rise(state, [friction], noise), wide)
    bent = may_rise(state, [friction, leak], noise)
    assert np.allclose(bent, [own.bends * noise[0], own.bends * noise[1], wide[2]])
    alone = np.where([True, True, False], noise, np.inf)
    assert np.array_equal(may_rise(state, [leak], alone), own.matters * alone)

    before = np.full((50, 3), 250.0) * noise**2
    rise = np.random.default_rng(1).uniform(0.02, 0.03, 50)[:, None]
    after = before * (1 + rise * [1.0, 0.0, 0.0])  # 0.012 of the noise
    assert worsened(state, before, after, bent)
    assert not worsened(state, before, after, wide)


@pytest.mark.parametrize(
    "errors, chosen",
    [((9.0, 1.0), "own"), ((1.0, 9.0), "near"), ((np.nan, 9.0), "own")],
)
def test_a_range_met_from_the_balances_is_fitted_from_the_rigs_own_values_too(
    opened, monkeypatch, errors, chosen
):
    problem, _, free, _ = opened
    own = problem.initial_values()
    near, inside = own.copy(), own.copy()
    near[problem.model.names.index("beta")] = problem.free["beta"].upper
    inside[problem.model.names.index("beta")] *= 1.1
    found = {"own": own, "near": near}
    said: list[str] = []
    monkeypatch.setattr(fit, "_fit_these_pressures", lambda p, v, *_: (p, v))
    monkeypatch.setattr(
        Problem,
        "errors_at",
        lambda p, v: np.full((len(p.batch.P_0), 3), errors[0 if v is near else 1]),
    )
    monkeypatch.setattr(fit, "balanced", lambda *_: near)
    _, at = fit.fit_from_balances(problem, own, free, said.append)
    assert at is found[chosen] and len(said) == 1

    # Where no end is met nothing else is tried.
    monkeypatch.setattr(fit, "balanced", lambda *_: inside)
    assert fit.fit_from_balances(problem, own, free, said.append)[1] is inside
    assert len(said) == 1


@pytest.mark.parametrize(
    "errors, chosen, asked",
    [((2.0, 1.0), "other", 1), ((2.0, 3.0), "own", 1), ((1.0, 0.5), "own", 0)],
)
def test_the_other_shape_of_a_declared_effect_is_fitted_where_something_is_left(
    opened, monkeypatch, errors, chosen, asked
):
    problem, _, free, _ = opened
    own = problem.initial_values()
    at, noise = problem.model.names.index("beta"), np.asarray(problem.batch.noise)
    end = problem.free["beta"].upper
    said: list[str] = []
    monkeypatch.setattr(fit, "_fit_these_pressures", lambda p, v, *_: (p, v))
    monkeypatch.setattr(fit, "balanced", lambda _, values, *__: values)
    monkeypatch.setattr(fit, "other_ends", lambda *_: iter([("beta", end)]))
    off = {False: errors[0], True: errors[1]}
    monkeypatch.setattr(
        Problem,
        "rms",
        lambda _, at_end: np.where(np.isfinite(noise), off[at_end] * noise, 0.0),
    )
    monkeypatch.setattr(Problem, "errors_at", lambda _, v: bool(v[at] == end))
    _, values = fit.fit_from_balances(problem, own, free, said.append)
    assert (values[at] == end) == (chosen == "other") and len(said) == asked
    assert np.array_equal(np.delete(values, at), np.delete(own, at))


def test_pressures_are_weighed_by_what_a_fit_leaves_of_them(opened, monkeypatch):
    """Not by what the declared model left, before anything was found."""
    state = unfitted(opened)
    own = np.asarray(state.problem.batch.noise)
    loud = state.check.batch._replace(noise=10 * own)  # decides, and weighs nothing
    state = replace(state, check=replace(state.check, batch=loud))
    stale = replace(state.point, weights=1e3 * own)
    noise = only(state.noise, PRESSURES)
    sse = np.array([1.0, 9.0, 4.0]) * own**2
    counts = state.problem.batch.windows.measured.shape
    left = np.tile(sse * counts[1], (counts[0], 1))
    monkeypatch.setattr(Problem, "errors_at", lambda *_: left)
    monkeypatch.setattr(refit, "fit_pressures", lambda problem, at, *_: (problem, at))
    found = refit.fit_from(
        replace(state, point=stale), stale.values, state.free, noise
    )[1]
    np.testing.assert_allclose(found.weights, np.array([1, 3, 1e3]) * own)


@pytest.mark.parametrize(
    ("share", "tried", "said"),
    [(1e-3, True, "absent"), (0.1, True, "rejected"), (0.1, False, "cannot tell")],
)
def test_what_may_explain_much_of_what_is_left_is_not_called_absent(
    opened, share, tried, said
):
    """Though its test has power and finds nothing: few windows show it."""
    score = Score(TRUE, share * 1e6, np.ones(1), 0.3, 0.99, 1e6, 1.0)
    trials = {TRUE: "does not help"} if tried else {}
    state = replace(unfitted(opened), scores={TRUE: score}, tried=trials)
    assert loop.status(state, TRUE, 0.3) == said


@pytest.mark.parametrize("explained, added", [(True, ["stribeck"]), (False, [])])
def test_what_acts_ahead_of_explained_pressures_does_not_hide_the_force(
    opened, monkeypatch, explained, added
):
    """Three candidates ahead of the pressures score more than friction, and fail; two
    may be tried in vain.
    """
    state = unfitted(opened)
    own = replace(state.problem.criteria, tries=2)
    problem, check = (replace(p, criteria=own) for p in (state.problem, state.check))
    state = replace(state, problem=problem, check=check)
    force = np.array([0.0, 0.0, 1.0]) if explained else np.ones(3)
    sse = 1e4 * (force * state.noise) ** 2 * np.ones((len(check.batch.P_0), 1))
    monkeypatch.setattr(Problem, "errors_at", lambda *_: sse)
    monkeypatch.setattr(loop, "refit", lambda state, *_: (state.problem, state.point))
    monkeypatch.setattr(loop, "negligible", lambda *_: False)

    def judged(state, before, after, noise, by):
        return "helps" if tried[-1] == "refit with stribeck" else "does not help"

    tried: list[str] = []
    monkeypatch.setattr(loop, "judge", judged)
    scores = {
        name: Score(name, gain, np.ones(1), 0.0, 1.0, 1e9, 1.0)
        for name, gain in ((TRUE, 4e8), (WRONG, 3e8), ("valve_bias", 2e8),
                           ("stribeck", 1e8))
    }  # fmt: skip
    state = replace(state, progress=tried.append)
    found = loop._round(state, state.effects, scores, state.noise)
    assert names_of(found) == added


@pytest.mark.slow
def test_a_pair_behind_two_effects_of_the_pressures_is_found(tmp_path):
    """Four effects, of which two act on the force alone; that plant is another."""
    name = "several-4-14"
    (spec,) = (s for s in cases.plan(0, {"several": 15}, list(NAMED)) if s.name == name)
    assert not cases.write_cases([spec], tmp_path)
    logs = [tmp_path / name / log for log in cases.LOGS]
    found = api.trace_case(open_case(tmp_path / name / "rig.toml", logs[:2], logs[2:]))
    assert {e.name for e in found.effects} == set(spec.effects)


@pytest.mark.parametrize(
    "falls, rise, sure",
    [(0.1, 0.0, True), (0.1, 3.0, True), (0.1, 30.0, False), (0.0, 0.0, False)],
)
def test_what_is_better_in_nearly_every_window_is_better(falls, rise, sure):
    """Though one window that is worse takes most of what the others gain; not all."""
    rng = np.random.default_rng(3)
    before = np.abs(rng.normal(1.0, 0.05, (100, 3)))
    after = before * (1 - falls) * rng.normal(1.0, 0.01, before.shape)
    after[7, 0] += rise
    noise = np.array([0.1, 0.1, np.inf])
    assert better(after, before, noise, 3.0) is sure
    assert not better(before, after, noise, 3.0)


def test_what_was_found_since_is_no_look_alike(opened, monkeypatch):
    """A leak looked like another, until that was found beside it."""
    state = unfitted(opened, TRUE, WRONG)
    first, second = (replace(a, cannot_tell_from=(WRONG,)) for a in state.added)
    state = replace(state, added=(first, replace(second, cannot_tell_from=())))
    monkeypatch.setattr(rivals, "_near_parallel", lambda *_: [])
    monkeypatch.setattr(rivals, "_gram", lambda *_: None)
    assert [a.cannot_tell_from for a in with_look_alikes(state).added] == [(), ()]


@pytest.fixture
def sought_together(opened, monkeypatch):
    """What is found of sets that the flow balances want, each of which helps; and what
    the search began with.
    """

    def of(sets, question=lambda _: None):
        begun = replace(unfitted(opened), question=question)
        scores = {
            n: Score(n, 1.0, np.zeros(1), 1.0, 0.0, 1.0, 0.0) for n in (TRUE, WRONG)
        }
        found = replace(begun, scores=scores)
        monkeypatch.setattr(
            loop,
            "together",
            lambda s, _: (replace(one, scores=s.scores) for one in sets),
        )
        monkeypatch.setattr(loop, "fit_from", lambda s, *_: (s.problem, s.point))
        monkeypatch.setattr(loop, "judge", lambda *_: "helps")
        monkeypatch.setattr(loop, "better", lambda *_: True)
        monkeypatch.setattr(loop, "chance", lambda *_: 0.0)
        pressures = only(begun.noise, PRESSURES) / 100
        return found, loop._or_several(found, found, begun.effects, pressures)

    return of


def test_effects_that_are_added_together_keep_their_scores(opened, sought_together):
    """All that was tried is listed, and they were."""
    sets = [unfitted(opened, TRUE), unfitted(opened, TRUE, WRONG)]
    found, out = sought_together(sets)
    assert [a.name for a in out.added] == [TRUE, WRONG]
    assert out.scores == found.scores


def test_no_more_are_sought_together_than_replays_lack(opened, sought_together):
    """What little is left is looked for one by one, with all windows."""
    noise = only(unfitted(opened).noise, PRESSURES) / 100
    little = Errors(np.where(np.isfinite(noise), noise, 0.0), (1.5, 1.5, 0.0))

    def sets():
        yield unfitted(opened, TRUE)
        yield replace(unfitted(opened, TRUE, WRONG), check=little)
        pytest.fail("a third effect was sought")

    assert [a.name for a in sought_together(sets())[1].added] == [TRUE, WRONG]


def test_an_input_is_questioned_with_each_effect_that_balances_want(
    opened, sought_together
):
    """Before more effects stand in for what is at fault."""

    def question(state):
        if names_of(state) == [TRUE, WRONG]:
            raise InterruptedError

    sets = [unfitted(opened, TRUE), unfitted(opened, TRUE, WRONG)]
    with pytest.raises(InterruptedError):
        sought_together(sets, question)


class Errors:
    """Stands for the validation logs, by a state's errors over its noise."""

    def __init__(self, noise, off):
        scatter = np.random.default_rng(0).normal(1.0, 0.05, (60, 3))
        self.sse = (np.array(off) * noise * scatter) ** 2
        self.batch = SimpleNamespace(noise=noise)

    def errors_at(self, values):
        return self.sse

    def rms(self, sse):
        return np.sqrt(sse.mean(axis=0))


@pytest.mark.parametrize(
    ("own", "bare", "left"),
    [
        ((2.0, 2.0, 10.0), (4.0, 4.0, 7.0), []),
        ((2.0, 2.0, 10.0), (8.0, 8.0, 9.0), [TRUE]),
        ((1.0, 1.0, 10.0), (4.0, 4.0, 7.0), [TRUE]),  # the pressures are explained
        ((2.0, 2.0, 1.0), (4.0, 4.0, 0.9), [TRUE]),  # the force is
    ],
)
def test_what_brings_more_into_the_force_than_it_takes_from_the_pressures(
    opened, monkeypatch, own, bare, left
):
    state = unfitted(opened, TRUE)
    state = replace(state, check=Errors(state.noise, own))

    def without(state, name, noise):
        return replace(state, added=(), check=Errors(state.noise, bare))

    monkeypatch.setattr(rivals, "without", without)
    found = rivals.unspoilt(state)
    assert names_of(found) == left
    if not left:
        assert found.tried == {TRUE: "spoils another channel"}


def test_friction_is_not_asked_what_it_brings_into_the_force(opened, monkeypatch):
    state = unfitted(opened, "stribeck")
    state = replace(state, check=Errors(state.noise, (2.0, 2.0, 10.0)))
    monkeypatch.setattr(rivals, "without", None)  # would be called
    assert rivals.unspoilt(state) is state


class Ends:
    """Stands for the validation logs, by the errors at either end of a share."""

    def __init__(self, noise, at, ends):
        self.at, self.ends = at, [Errors(noise, off) for off in ends]
        self.batch = self.ends[0].batch

    def errors_at(self, values):
        return self.ends[int(values[self.at] > 0.5)].sse

    def rms(self, sse):
        return np.sqrt(sse.mean(axis=0))


@pytest.mark.parametrize(
    ("ends", "s"),
    [
        (((4.0, 4.0, 1.0), (2.0, 4.0, 1.0)), 1.0),
        (((4.0, 4.0, 1.0), (4.5, 4.0, 1.0)), 0.0),
        (((4.0, 4.0, 1.0), (4.0, 4.0, 1.0)), None),  # no spool tells them apart
        (((1.0, 1.0, 1.0), (0.9, 0.9, 1.0)), None),  # nothing is left
    ],
)
def test_a_share_is_tried_from_its_other_end(opened, monkeypatch, ends, s):
    state = unfitted(opened, "valve_rate_limit")
    names = state.problem.model.names
    at = names.index("valve_rate_limit.s")
    assert state.named["valve_rate_limit.s"] == 0.0
    state = replace(state, check=Ends(state.noise, at, ends))

    def fit_from(state, values, free, noise):
        return state.problem, replace(state.point, values=values)

    monkeypatch.setattr(rivals, "fit_from", fit_from if s is not None else None)
    found = rivals.at_other_ends(state, state.noise)
    assert found.named["valve_rate_limit.s"] == (s or 0.0)
    assert (found is state) == (not s)


@pytest.mark.parametrize("better", ["here", "back"])
def test_the_other_end_is_fitted_from_the_rigs_own_starts_too(
    opened, monkeypatch, better
):
    state = unfitted(opened, "valve_rate_limit")
    names = state.problem.model.names
    at, beta = names.index("valve_rate_limit.s"), names.index("beta")
    start, values = state.problem.free["beta"].start, state.point.values.copy()
    values[beta] = 1.2 * start
    state = replace(state, point=replace(state.point, values=values))

    class Apart(Ends):
        """Less is left at the other end, least of all from one of the two places."""

        def errors_at(self, values):
            there = (values[beta] == start) == (better == "back")
            return self.ends[int(values[at] > 0.5) * (1 + there)].sse

    offs = ((4.0, 4.0, 1.0), (3.0, 4.0, 1.0), (1.0, 1.0, 1.0))
    state = replace(state, check=Apart(state.noise, at, offs))

    def fit_from(state, values, free, noise):
        return state.problem, replace(state.point, values=values)

    monkeypatch.setattr(rivals, "fit_from", fit_from)
    found = rivals.at_other_ends(state, state.noise)
    assert found.named["valve_rate_limit.s"] == 1.0
    assert found.named["beta"] == (start if better == "back" else 1.2 * start)


@pytest.mark.parametrize(("first", "asked"), [(1.0, 2), (0.5, 1)])
def test_a_fit_that_ends_at_an_end_of_an_effects_range_is_made_from_elsewhere_too(
    opened, monkeypatch, first, asked
):
    """Though nothing is left: of two that leave as little the later is the better."""
    state, effect = unfitted(opened), opened[3]["stribeck"]
    problem, name = state.problem, free_names(effect)[-1]
    own = problem.free[name]
    assert own.lower < own.start < own.upper
    ends = []

    def at(share):
        return placed(problem, state.point.values, {name: share * own.upper})

    class Quiet:
        """Stands for a problem fitted to its noise."""

        model, free, batch = problem.model, problem.free, problem.batch
        criteria = problem.criteria

        def __init__(self, off):
            self.off = off

        def errors_at(self, _):
            return np.full((4, 3), self.off) * state.noise**2

        def rms(self, errors):
            return np.sqrt(np.mean(errors, axis=0))

    def fitted(_, values, *__):
        ends.append(values)
        return Quiet(0.9 ** len(ends)), replace(state.point, values=values)

    monkeypatch.setattr(refit, "fit_from", fitted)
    monkeypatch.setattr(refit, "_stepped", lambda *_: None)
    starts = iter([at(first), at(0.4)])
    monkeypatch.setattr(refit, "_elsewhere", lambda *_: starts)
    quiet = replace(state, problem=Quiet(1.0))
    score = Score(effect.name, 1.0, np.zeros(1), 0.0, 1.0, 1.0, 1.0)
    _, point = refit.refit(quiet, effect, score, state.noise)
    assert len(ends) == asked
    np.testing.assert_array_equal(point.values, ends[-1])
