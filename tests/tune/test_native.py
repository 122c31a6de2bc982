"""Sweeps in generated C: held to XLA's runs, and left to XLA where they differ."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hydrojax.effects import EFFECTS
from hydrojax.export.codegen import compiler
from hydrojax.paper.records import reference
from hydrojax.parameters import param, parameter_specs
from hydrojax.plant.effect import ForceEffect
from hydrojax.rigfile.quantities import open_setting, quantities
from hydrojax.tune import measure, native, plan, sweep
from hydrojax.tune.axes import make_axes
from hydrojax.tune.ensemble import Plants

SPEC, _ = reference()

needs_compiler = pytest.mark.skipif(
    compiler.compiler() is None, reason="there is no C compiler"
)


def plan_of(axes, spec=SPEC, **more):
    setting = open_setting(spec)
    known = quantities(spec, setting)
    given = {"multisine": measure.multisine(1000.0, period=0.25, lines=8)}
    return plan.with_excitations(
        plan.Plan(setting, make_axes(axes, known), known, ("multisine",),
                  excitations=given, **more)
    )  # fmt: skip


AXES = {"k_p": [0.5, 1.0, 2.0], "k_f": [0.5, 2.0]}
"""Gains of loops that come to rest, in the paper's units."""


START = 50
"""Periods in which the stiffest of the catalogue's loops lets no digit grow."""


def both(made):
    """What XLA and C make of a plan's cells, [cells, n, 4] each."""
    given = made.excitations["multisine"]
    work = sweep._Work(made)
    rows = made.table()
    run = jax.jit(
        jax.vmap(
            lambda row: measure.run_excited(
                made.at(row), given, made.frozen, work.settle
            )
        )
    )
    by_xla = np.asarray(run(rows))
    by_c = native.native_runs(made, given, work.settle)(rows)
    return by_xla, np.moveaxis(by_c, -1, 0)


def assert_alike(made, periods=None):
    theirs, ours = (a[:, :periods] for a in both(made))
    size = np.abs(theirs).max(1, keepdims=True)
    assert (np.abs(ours - theirs) <= 1e-9 * size).all()
    assert (np.ptp(theirs[:, :, 0], axis=0) > 0).any(), "all cells are the same"


@needs_compiler
@pytest.mark.slow
def test_gains_at_rest():
    assert_alike(plan_of(AXES))


@needs_compiler
@pytest.mark.slow
def test_a_plant_that_differs_and_moves():
    """Settled points, and cells that differ in plant, speed and amplitude."""
    setting = open_setting(SPEC)
    here = float(quantities(SPEC, setting)["c_p1"].get(setting))
    axes = {"v": [0.0, 0.02], "c_p1": [here, 1.2 * here], "amplitude": [10.0, 30.0]}
    assert_alike(plan_of(axes, frozen=True))


class Odd(ForceEffect):
    """A force by an operation that has no form in C."""

    name = "odd"
    residual_axis = "v"
    f: jax.Array = param("N", 1.0, -10.0, 10.0, "force", strength=True, size=1.0)

    def force(self, at):
        """What it adds, N."""
        return self.f * jnp.fft.rfft(jnp.stack([at.v, at.x, at.v])).real[0]


def test_what_has_no_form_is_left_to_xla(vocabulary, monkeypatch):
    monkeypatch.setattr(native, "WORTH", 0)
    vocabulary["odd"] = Odd
    made = plan_of({"k_p": [0.5, 1.0]}, replace(SPEC, effects={"odd": {}}))
    call, words = native.measured(made, made.excitations["multisine"], 0)
    assert call is None
    assert words.startswith("XLA (c: the operation 'fft' has no form in C")


@needs_compiler
@pytest.mark.slow
def test_every_effect():
    """A rig with all of the catalogue; each plant has one of them in it."""
    spec = replace(SPEC, effects={name: {} for name in EFFECTS})
    known = parameter_specs(open_setting(spec).loop.rig)
    strong = [n for n, s in known.items() if s.strength]
    values = np.diag([known[n].scale for n in strong])
    plants = Plants(tuple(strong), values, "one effect each")
    made = plan_of({"k_p": [0.5, 1.0]}, spec, plants=plants)
    theirs, ours = (a[:, :START] for a in both(made))
    size = np.abs(theirs).max(1, keepdims=True)
    off = np.abs(ours - theirs).max((1, 2)) > 1e-9 * size.max()
    assert not off.any(), np.repeat(strong, 2)[off]


@needs_compiler
def test_a_sweep_is_the_same(monkeypatch):
    """In its numbers; and it says what ran it."""
    made = plan_of(AXES)
    theirs = sweep.run_sweep(made)
    monkeypatch.setattr(native, "WORTH", 0)
    ours = sweep.run_sweep(made)
    assert theirs.attrs["multisine_runs"] == "XLA"
    assert ours.attrs["multisine_runs"] == "C, as XLA to 1e-09 in 6 cells"
    for name in theirs.data_vars:
        np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-6, err_msg=name)


def wrong(monkeypatch, made, change):
    """What is said of a C that runs as XLA does, but for a change of its F [n, cells],
    N.
    """
    given = made.excitations["multisine"]
    by_xla = jax.vmap(lambda r: measure.run_excited(made.at(r), given), out_axes=2)

    def runs(rows):
        table = np.array(by_xla(rows))
        change(table[:, 0])
        return table

    monkeypatch.setattr(native, "WORTH", 0)
    monkeypatch.setattr(native, "native_runs", lambda *_: runs)
    return native.measured(made, given, 0)


def late(F):
    F[400:] *= 1 + 1e-6


def lost(F):
    F[-1] = np.nan


def one_cell(F):
    F[:, 1] *= 1 + 1e-6


@pytest.mark.parametrize(
    "change",
    [*(pytest.param(c, marks=pytest.mark.slow) for c in (late, lost)), one_cell],
)
def test_what_differs_is_seen(monkeypatch, change):
    """Of loops that come to rest, in every cell and to the last period."""
    call, words = wrong(monkeypatch, plan_of({"k_p": [0.5, 1.0]}), change)
    assert call is None and words.startswith("XLA (C differs from it by up to")


@pytest.mark.slow
def test_a_loop_that_does_not_come_to_rest_is_no_measure(monkeypatch):
    """At these gains a limit cycle lets the last digit grow: two runs part."""
    beside = plan_of({"k_p": [0.7, 40.0], "k_f": [1.0]})
    call, words = wrong(monkeypatch, beside, lambda F: None)
    assert call is not None
    assert words == (
        "C, as XLA to 1e-09 in 1 cells; in 1 more XLA's own runs part when they are "
        "nudged"
    )
    call, words = wrong(monkeypatch, plan_of({"k_p": [40.0, 41.0], "k_f": [60.0]}),
                        lambda F: None)  # fmt: skip
    assert call is None and "in none of its cells" in words


def test_without_a_compiler(monkeypatch):
    monkeypatch.setattr(native, "WORTH", 0)
    monkeypatch.setattr(compiler, "compiler", lambda: None)
    made = plan_of({"k_p": [8.0, 16.0]})
    call, words = native.measured(made, made.excitations["multisine"], 0)
    assert call is None
    assert words.startswith("XLA (sweep: needs a C compiler")


def test_a_small_sweep_is_left_to_xla():
    made = plan_of({"k_p": [8.0, 16.0]})
    assert native.measured(made, made.excitations["multisine"], 0) == (None, "XLA")
