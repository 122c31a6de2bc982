"""Logs of many windows: effects are looked for on some, and fitted on all."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from hydrojax.identify import api
from hydrojax.identify.case import Case, open_case
from hydrojax.identify.estimation.fit import fit_all, in_short
from hydrojax.identify.estimation.misfit import _in_pieces
from hydrojax.identify.tracing.loop import search_effects
from hydrojax.identify.tracing.state import Tracing

MISSING, OTHER = "internal_leakage", "valve_bias"


@pytest.fixture(scope="module")
def leaking(recorded) -> Case:
    folder = recorded(4, {MISSING: {}})
    logs = [folder / f"{name}.csv" for name in ("fit_1", "fit_2", "validate")]
    return open_case(folder / "rig.toml", logs[:2], logs[2:])


@pytest.mark.parametrize("count", [3, 8, 9, 20])
def test_pieces_are_even_and_give_the_windows_back(count):
    sizes = []

    def double(a):
        sizes.append(a.shape[0])
        return 2 * a

    out = _in_pieces(double, 8, jnp.arange(count))
    np.testing.assert_array_equal(out, 2 * np.arange(count))
    assert max(sizes) == {3: 3, 8: 8, 9: 5, 20: 7}[count]


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
