"""Logs of many windows: effects are looked for on some, and fitted on all."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hydrojax.identify import api
from hydrojax.identify.case import Case, open_case
from hydrojax.identify.estimation import memory, misfit, pieces
from hydrojax.identify.estimation.columns import Batch, basis, room_of, thinned
from hydrojax.identify.estimation.fit import fit_all, in_short
from hydrojax.identify.estimation.pieces import (
    PIECE,
    PIECES,
    Span,
    in_pieces,
    on_all_cores,
)
from hydrojax.identify.tracing.loop import search_effects
from hydrojax.identify.tracing.state import Added, Tracing, free_names
from hydrojax.jax_setup import bucket
from hydrojax.parameters import put
from hydrojax.plant.replay import cut_of, opened_in, openings

MISSING, OTHER = "internal_leakage", "valve_bias"


@pytest.fixture(scope="module")
def leaking(recorded) -> Case:
    folder = recorded(4, {MISSING: {}})
    logs = [folder / f"{name}.csv" for name in ("fit_1", "fit_2", "validate")]
    return open_case(folder / "rig.toml", logs[:2], logs[2:])


@pytest.mark.parametrize("count, sizes", [(3, {3}), (8, {8}), (9, {8}), (20, {8})])
def test_pieces_give_the_windows_back(count, sizes):
    seen = []

    def double(_, a):
        seen.append(a.shape[0])
        return 2 * a

    out = in_pieces(double, 8, Span(0, -(-count // 8)), jnp.arange(count))
    np.testing.assert_array_equal(out[:count], 2 * np.arange(count))
    assert set(seen) == sizes


@pytest.mark.parametrize("first, end", [(0, 1), (0, 3), (1, 2), (1, 3), (2, 2)])
def test_only_pieces_of_the_span_are_run(first, end):
    ran = []

    def part(i, a):
        jax.debug.callback(lambda n: ran.append(int(n)), i)
        return a + 1

    run = jax.jit(lambda *span: in_pieces(part, 8, Span(*span), jnp.arange(20)))
    out = run(first, end)
    jax.effects_barrier()
    own = np.arange(20)[8 * first : 8 * end]
    np.testing.assert_array_equal(out[: len(own)], 1 + own)
    np.testing.assert_array_equal(out[8 * (end - first) :], 0)
    assert sorted(ran) == list(range(first, end))


def test_no_call_runs_more_pieces_than_it_has_room_for():
    run = jax.jit(
        lambda *span: in_pieces(lambda _, a: a, 2, Span(*span), jnp.arange(40))
    )
    out = run(5, 5 + PIECES)
    np.testing.assert_array_equal(out, 10 + np.arange(2 * PIECES))


@pytest.mark.parametrize("at_hand", [1, 2, 3, 8])
@pytest.mark.parametrize("real", [1, 40, 97, 190, 1000])
def test_each_core_has_its_share_of_the_windows(monkeypatch, at_hand, real):
    """Every window with a weight is run once, in its place, by calls of like size."""
    monkeypatch.setattr(pieces, "cores", lambda: at_hand)
    monkeypatch.setattr(pieces, "_pool", lambda: ThreadPoolExecutor(at_hand))
    count, calls = bucket(real), []
    weight = (np.arange(count) < real) * 1.0
    batch = Batch(None, None, np.zeros((count, 2)), None, None, weight)

    def run(size, span):
        assert size <= PIECE and span.end - span.first <= PIECES
        calls.append(span.end - span.first)
        rows = size * span.first + np.arange(size * PIECES)
        return np.where(rows < size * span.end, rows, -1)

    out = on_all_cores(run, batch)
    np.testing.assert_array_equal(out[:real], np.arange(real))
    assert len(out) < real + PIECE
    assert max(calls) - min(calls) <= 1
    assert len(calls) % at_hand == 0 or max(calls) == 1


@pytest.mark.slow
def test_fits_of_few_windows_run_the_program_of_all(leaking):
    """And come to what a program of their own gives."""
    problem = api._problems(leaking, [])[0]
    own = replace(problem, batch=thinned(problem.batch, len(problem.batch.P_0) // 2))
    assert room_of(own.batch)[0] < own.least[0]  # else it would be one program
    values = problem.initial_values()
    alone = replace(own, least=(0, 0, 0)).sums_at(values)
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(
            a, b, rtol=1e-9, atol=1e-12 * np.max(np.abs(b))
        ),
        own.sums_at(values),
        alone,
    )


def test_the_number_of_cores_changes_no_bit(leaking, monkeypatch):
    problem = replace(api._problems(leaking, [])[0], least=(0, 0, 0))
    values, found = problem.initial_values(), []
    for count in (1, 2, 3):
        monkeypatch.setattr(pieces, "cores", lambda count=count: count)
        monkeypatch.setattr(pieces, "_pool", lambda n=count: ThreadPoolExecutor(n))
        fresh = replace(problem)
        found.append((fresh.sums_at(values), fresh.residuals_at(values)))
    for other in found[1:]:
        jax.tree.map(np.testing.assert_array_equal, other, found[0])


@pytest.mark.parametrize("simulate", [True, False])
def test_no_program_that_runs_at_once_calls_lapack(leaking, simulate):
    """Stacks of systems are solved there by threads that the programs run on: two
    programs at once would wait for each other for ever.
    """
    problem = replace(api._problems(leaking, [])[0], simulate=simulate)
    values, model = problem.initial_values(), problem.model
    n = model.hydraulic
    directions = basis(model, model.names, (n, len(model.names) - n))

    def run(v, b):
        return misfit.sums(model, v, directions, b, simulate)

    lowered = jax.jit(run).lower(values, thinned(problem.batch, 8)).as_text()
    assert "stablehlo.while" in lowered and "lapack" not in lowered


@pytest.mark.parametrize("windows, columns", [(1, 1), (7, 3), (300, 40)])
def test_each_window_s_system_is_solved_by_itself(windows, columns):
    """As NumPy solves it, with units that are twelve decades apart."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(windows, 9, 30)) * 10.0 ** rng.uniform(-6, 6, (9, 1))
    B = root @ np.moveaxis(root, 1, 2)
    given = rng.normal(size=(windows, 9, columns)) * np.sqrt(
        np.diagonal(B, axis1=1, axis2=2)[..., None]
    )
    wanted = np.linalg.solve(B, given)
    largest = np.max(np.abs(wanted), axis=2, keepdims=True)
    found = misfit._solved(jnp.asarray(B), jnp.asarray(given))
    assert np.max(np.abs(found - wanted) / largest) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("piece", [96, 16, 1])
def test_sums_that_more_is_compiled_around_are_cut_as_well(leaking, monkeypatch, piece):
    problem = api._problems(leaking, [])[0]
    values, model = problem.initial_values(), problem.model
    few = replace(problem, batch=thinned(problem.batch, 19))
    n = model.hydraulic
    directions = basis(model, model.names, (n, len(model.names) - n))
    monkeypatch.setattr(misfit, "PIECE", piece)

    run = jax.jit(lambda v, b: misfit.sums(model, v, directions, b, True).gram)
    found = run(values, few.batch)
    wanted = few.sums_at(values).gram
    np.testing.assert_allclose(found, wanted, rtol=1e-8, atol=1e-11 * np.max(wanted))


@pytest.mark.slow
def test_what_friction_remembers_is_kept_of_the_log_s_motion_only(leaking):
    """Asked again under another force, a rod that gives remembers another motion."""
    problem = api._problems(leaking, ["rod_compliance"])[0]
    values = problem.initial_values()
    values[problem.model.names.index("rod_compliance.give")] = 3e-7
    motion = problem.batch.motion
    pulled = problem.batch._replace(motion=motion._replace(F=2 * np.asarray(motion.F)))
    own = problem._left(values, problem.batch)[0]
    assert problem._common  # what it found is kept
    under = problem._left(values, pulled)[0]
    fresh = replace(problem, batch=pulled)._left(values, pulled)[0]
    np.testing.assert_array_equal(under, fresh)
    assert not np.array_equal(under, own)
    np.testing.assert_array_equal(problem._left(values, problem.batch)[0], own)


@pytest.mark.slow
def test_it_is_kept_while_nothing_that_it_depends_on_changes(leaking, monkeypatch):
    runs = {"run_recall": 0, "run_openings_by": 0}

    def counted(name, run):
        def call(*given):
            runs[name] += 1
            return run(*given)

        return call

    for name in runs:
        monkeypatch.setattr(memory, name, counted(name, getattr(memory, name)))
    problem = api._problems(leaking, ["valve_lag"])[0]
    values, names = problem.initial_values(), problem.model.names
    counts, changes = (0, 0), [
        ("k_cp", (1, 1)), ("beta", (1, 1)), ("z_ss", (2, 1)), ("valve_lag.tau", (2, 2)),
        ("L_rate", (3, 2)),
    ]  # fmt: skip
    for name, counts in changes:
        values = values.copy()
        values[names.index(name)] += 0.1 * problem.model.scale[names.index(name)]
        problem.sums_at(values)
        assert tuple(runs.values()) == counts, name
    problem._left(values, problem.batch)  # asks for no derivative of what is there
    assert tuple(runs.values()) == counts


@pytest.mark.slow
def test_a_cut_has_the_opening_that_the_whole_has(leaking):
    """Windows by themselves, as balances of a few are run, and in their segments."""
    problem = api._problems(leaking, ["valve_lag", "valve_delay"])[0]
    model, batch = problem.model, problem.batch
    rig = put(model.rig, ["valve_lag.tau", "valve_delay.tau_u"], [3e-3, 4.3e-3])
    few = thinned(batch, 5).windows
    cut, own = cut_of(rig, batch.motion, few)
    assert cut is not None and cut_of(rig, batch.motion, batch.windows)[0] is None
    alone = opened_in(rig, openings(rig, batch.motion, cut), own)
    whole = opened_in(rig, openings(rig, batch.motion), few)
    for a, b in zip(alone, whole, strict=True):
        # What is run ahead of them differs: coarse steps, some way back.
        np.testing.assert_allclose(a, b, atol=1e-6)
        assert np.ptp(b) > 0.1


def test_some_windows_are_taken_where_that_is_much_less_work(leaking):
    problem = api._problems(leaking, [])[0]
    count = len(problem.batch.P_0)
    assert in_short(problem) is problem
    own = replace(problem.criteria, short_windows=count // 2)
    few = in_short(replace(problem, criteria=own))
    assert len(few.batch.P_0) == count // 2
    kept = np.isin(problem.batch.P_0[:, 0], few.batch.P_0[:, 0])
    assert kept[0] and kept[-1]  # the first and the last, and those between
    own = replace(problem.criteria, short_windows=count // 2 + 1)
    assert in_short(few := replace(problem, criteria=own)) is few
    driven = replace(problem, simulate=False)
    assert in_short(driven) is driven


@pytest.mark.slow
def test_what_is_found_on_some_windows_is_fitted_to_all(leaking):
    """It leaves what a fit of all windows leaves that begins elsewhere, from values by
    which more is left.
    """
    problem, check, free, effects = api._problems(leaking, [MISSING, OTHER])
    own = replace(problem.criteria, short_windows=len(problem.batch.P_0) // 3)
    few = in_short(replace(problem, criteria=own))
    done, point = fit_all(few, few.initial_values(), free)
    found = search_effects(Tracing(done, check, effects, free, point, print))
    assert [a.name for a in found.added] == [MISSING]
    whole = api._on_all(problem, found)
    assert len(whole.problem.batch.P_0) == len(problem.batch.P_0)
    rms = check.rms(check.errors_at(whole.point.values))
    assert np.all((rms <= 1.1 * whole.noise)[np.isfinite(whole.noise)])
    _, direct = fit_all(problem, problem.initial_values(), whole.free)
    seen = np.isfinite(whole.noise)

    def left(values):
        errors = problem.errors_at(values)[:, seen]
        return float(np.sum(errors / whole.noise[seen] ** 2))

    assert left(whole.point.values) == pytest.approx(left(direct.values), rel=1e-5)
    assert left(found.point.values) > (1 + 1e-4) * left(direct.values)
    index = [problem.model.names.index(n) for n in problem.side(free, True)]
    np.testing.assert_allclose(
        whole.point.values[index], direct.values[index], rtol=5e-3
    )
    assert api._on_all(problem, whole) is whole
    # What chance put beside it on some windows is not needed on all.
    none = np.full(3, np.nan)
    both = replace(
        found,
        free=(*found.free, *free_names(effects[OTHER])),
        added=(*found.added, Added(OTHER, 1e-9, none, none, ())),
    )
    assert [a.name for a in api._on_all(problem, both).added] == [MISSING]
