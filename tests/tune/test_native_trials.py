"""The runs in which gains are tried, in generated C: held to XLA's."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest

from hydrojax.export.codegen import compiler, running
from hydrojax.paper.records import reference
from hydrojax.rigfile.quantities import open_setting, quantities
from hydrojax.tune.programs import Programs, Rows
from hydrojax.tune.trials import make_trials

SPEC, _ = reference()
TICKS = 600
CALM = {"k_p": 0.8, "k_f": 2.0}
OSCILLATING = {"k_p": 40.0, "k_f": 60.0}
"""Gains in the paper's units; at the latter a limit cycle lets the last digit grow."""

needs_compiler = pytest.mark.skipif(
    compiler.compiler() is None, reason="there is no C compiler"
)


def programs_of(spec=SPEC):
    """Programs of two gains and two plants, and the first ticks of all trials."""
    setting = open_setting(spec)
    known = quantities(spec, setting)
    scenarios = jax.tree.map(lambda a: a[:, :TICKS], make_trials(setting).scenarios)
    free = [known[name] for name in CALM]
    return Programs(setting, free, ("c_p1", "beta"), 0, 8, scenarios), scenarios


def rows_of(setting, *gains):
    """Each of the gains on the rig and on a plant that is slower and softer."""
    known = quantities(SPEC, setting)
    plant = np.array([float(known[n].get(setting)) for n in ("c_p1", "beta")])
    plants = np.array([plant, 0.8 * plant])
    table = np.array([list(g.values()) for g in gains])
    count = 2 * len(gains)
    return Rows(
        np.repeat(table, 2, 0), np.tile(plants, (len(gains), 1)), np.zeros(count)
    )


def every(rows, trials):
    """All rows in all trials."""
    n = rows.v.size
    joined = jax.tree.map(lambda a: np.concatenate([a] * trials), rows)
    return joined, np.repeat(np.arange(trials), n)


@needs_compiler
def test_every_trial_is_as_xla_has_it():
    """Locked and moving, at both amplitudes, and with steps of the desired force."""
    made, scenarios = programs_of()
    rows = rows_of(made.setting, CALM, {"k_p": 1.2, "k_f": 1.0})
    table, which = every(rows, len(scenarios.F_d))
    ours = made.runs(made.setting, table, which, scenarios)
    assert made.run_by.startswith("C, as XLA to 1e-09 in ")
    theirs = made._by_xla(made.setting, table, which, scenarios)
    size = np.abs(theirs).max(1, keepdims=True)
    assert (np.abs(ours - theirs) <= 1e-9 * size).all()
    F = ours[..., 0]
    assert len(np.unique(F[:, -1])) == len(F), "rows that are the same"


@needs_compiler
def test_another_setting_is_left_to_xla():
    """Of the C the supply's pressure is a part."""
    made, scenarios = programs_of()
    rows, which = rows_of(made.setting, CALM), np.zeros(2, int)
    here = made.runs(made.setting, rows, which, scenarios)
    other = eqx.tree_at(lambda s: s.P_s, made.setting, 0.5 * made.setting.P_s)
    there = made.runs(other, rows, which, scenarios)
    assert np.abs(there - here).max() > 1e-3 * np.abs(here).max()
    np.testing.assert_array_equal(there, made._by_xla(other, rows, which, scenarios))


def test_what_differs_is_left_to_xla():
    made, scenarios = programs_of()
    rows, which = rows_of(made.setting, CALM), np.zeros(2, int)
    wrong: Future = Future()

    def late(numbers, which, scenarios):
        """As XLA, but in one kind of run: with steps of the desired force."""
        given = Rows(numbers[:, :2], numbers[:, 2:], np.zeros(len(numbers)))
        out = made._by_xla(made.setting, given, which, scenarios)
        return np.where((which == 5)[:, None, None], (1 + 1e-6) * out, out)

    wrong.set_result(late)
    made._in_c = wrong
    given = made.runs(made.setting, rows, which, scenarios)
    assert made.run_by.startswith("XLA (C differs from it by up to 1e-06")
    theirs = made._by_xla(made.setting, rows, which, scenarios)
    np.testing.assert_array_equal(given, theirs)


@needs_compiler
def test_it_stays_open_until_a_run_can_tell():
    """Of loops that do not come to rest no digit stays: the next rows are asked."""
    made, scenarios = programs_of()
    scenarios, which = jax.tree.map(lambda a: a[:1], scenarios), np.zeros(2, int)
    wild = rows_of(made.setting, OSCILLATING)
    given = made.runs(made.setting, wild, which, scenarios)
    assert "in none of its cells" in made.run_by
    theirs = made._by_xla(made.setting, wild, which, scenarios)
    np.testing.assert_array_equal(given, theirs)
    made.runs(made.setting, rows_of(made.setting, CALM), which, scenarios)
    assert made.run_by == "C, as XLA to 1e-09 in 2 cells"


@needs_compiler
@pytest.mark.slow
def test_a_loop_of_many_rounds_is_as_xla_has_it():
    """A rod that gives: each substep solves for the piston's own motion."""
    made, scenarios = programs_of(replace(SPEC, effects={"rod_compliance": {}}))
    rows, which = rows_of(made.setting, CALM), np.zeros(2, int)
    F = made.runs(made.setting, rows, which, scenarios)[..., 0]
    assert made.run_by == f"C, as XLA to 1e-09 in {2 * len(scenarios.F_d)} cells"
    theirs = made._by_xla(made.setting, rows, which, scenarios)[..., 0]
    np.testing.assert_allclose(F, theirs, rtol=0, atol=1e-9 * np.abs(theirs).max())


def test_without_a_compiler(monkeypatch):
    monkeypatch.setattr(compiler, "compiler", lambda: None)
    monkeypatch.setattr(running, "_library", running._library.__wrapped__)
    made, scenarios = programs_of()
    rows, which = rows_of(made.setting, CALM), np.zeros(2, int)
    assert np.isfinite(made.runs(made.setting, rows, which, scenarios)).all()
    assert made.run_by.startswith("XLA (tune: needs a C compiler")
