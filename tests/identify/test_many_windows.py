"""Logs of many windows: effects are looked for on some, and fitted on all."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hydrojax.identify import api
from hydrojax.identify.case import Case, open_case
from hydrojax.identify.estimation.columns import room_of, thinned
from hydrojax.identify.estimation.fit import fit_all, in_short
from hydrojax.identify.estimation.misfit import in_pieces
from hydrojax.identify.tracing.loop import search_effects
from hydrojax.identify.tracing.state import Tracing

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

    out = in_pieces(double, 8, count, jnp.arange(count))
    np.testing.assert_array_equal(out, 2 * np.arange(count))
    assert set(seen) == sizes


@pytest.mark.parametrize("real, pieces", [(1, 1), (8, 1), (9, 2), (17, 3), (20, 3)])
def test_only_pieces_with_real_windows_are_run(real, pieces):
    ran = []

    def part(own, a):
        jax.debug.callback(lambda n: ran.append(int(n)), own)
        return a + 1

    run = jax.jit(lambda n, a: in_pieces(part, 8, n, a))
    out = run(jnp.asarray(real), jnp.arange(20))
    jax.effects_barrier()
    np.testing.assert_array_equal(out[:real], 1 + np.arange(real))
    np.testing.assert_array_equal(out[8 * pieces :], 0)
    assert sorted(ran) == sorted(min(8, real - 8 * i) for i in range(pieces))


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
    """The parameters come out where a fit of all windows has them, from elsewhere."""
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
    index = [problem.model.names.index(n) for n in problem.side(free, True)]
    np.testing.assert_allclose(
        whole.point.values[index], direct.values[index], rtol=1e-3
    )
    assert np.any(np.abs(found.point.values[index] / direct.values[index] - 1) > 1e-3)
    assert api._on_all(problem, whole) is whole
