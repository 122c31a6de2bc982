"""Curves from sums: smoothing, bands and formulas against regressions in NumPy."""

import json
from dataclasses import replace
from unittest.mock import Mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.signal import lfilter

import hydrojax as hj
from hydrojax.effects.splines import knots_over
from hydrojax.effects.valve import ValveLag
from hydrojax.identify.case import open_case
from hydrojax.identify.discovery.discover import begun, commanded, deflections
from hydrojax.identify.discovery.formula import FORMS, formula_of
from hydrojax.identify.discovery.free_form import FORMS as FREE_FORMS
from hydrojax.identify.discovery.free_form import LAGS
from hydrojax.identify.discovery.search import above_noise
from hydrojax.identify.discovery.smooth import (
    Columns,
    band,
    covariance,
    directions,
    pull,
    roughness,
    signal_in,
    smoothed,
)
from hydrojax.identify.discovery.with_curves import drawn_knots
from hydrojax.identify.estimation.fit import FitPoint
from hydrojax.identify.estimation.known import Free, Known
from hydrojax.identify.estimation.problem import Problem
from hydrojax.identify.inference import tolerance, uncertainty
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.identify.tracing.score import Projection
from hydrojax.identify.tracing.state import Tracing
from hydrojax.plant.turned import AGES, at_rest, run_turned
from hydrojax.rigfile.build import build_rig

WINDOWS, TICKS, COUNT, NOISE = 80, 100, 14, 0.3
LAWS = {
    "drag": lambda s: 1.7 * np.abs(s) * s,
    "bell": lambda s: 3.0 * np.exp(-((s / 0.4) ** 2)),
    "saturation": lambda s: -2.0 * np.tanh(s / 0.3),
    "wave": lambda s: 1.5 * np.sin(2 * np.pi * s / 1.3 + 0.4),
    "ramp": lambda s: 2.5 * np.maximum(s - 0.5, 0.0),
}


def drawn(law, seed=0, noise=NOISE, refits=0, knots=None):
    """A regression of y on 1 and s, and a curve of s: samples, knots and sums.

    The sums are taken where no curve is, or where so many refits with it end; the knots
    lie as the samples do, unless they are given.
    """
    rng = np.random.default_rng(seed)
    s = rng.uniform(-2, 2, (WINDOWS, TICKS))
    y = 0.7 + 1.3 * s + law(s) + noise * rng.normal(size=s.shape)
    knots = knots_over(s.ravel(), COUNT) if knots is None else knots
    B = BSpline.design_matrix(np.clip(s.ravel(), knots[0], knots[-1]), knots, 3)
    B = B.toarray().reshape(*s.shape, COUNT)
    fitted = np.stack([np.ones_like(s), s], axis=-1)
    c, left = np.zeros(COUNT), y
    while True:
        # As the replay has them: minus the derivatives, then the residual.
        rows = np.concatenate([-fitted, -B, left[..., None]], axis=-1) / noise
        gram = np.einsum("wti,wtj->wij", rows, rows)
        projection = Projection(gram, [0, 1], np.zeros(COUNT + 2))
        columns = Columns.of(projection, list(range(2, COUNT + 2)), c)
        if not refits:
            return s.ravel(), y.ravel(), knots, columns
        refits, c = refits - 1, smoothed(columns, knots).c
        left = beside(s.ravel(), (y - B @ c).ravel()).reshape(y.shape)


def beside(s, y):
    """What of `y` a line over the samples `s` does not follow."""
    return y - np.polyval(np.polyfit(s, y, 1), s)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("noise", [1.0, NOISE, 0.03])
def test_a_curve_lies_in_its_band(name, noise):
    """Less the line that belongs to the fitted parameters; with little noise the
    splines' own error is what the band must hold.
    """
    law, rows = LAWS[name], WINDOWS * TICKS
    inside, width = [], []
    for seed in range(10):
        s, _, knots, columns = drawn(law, seed, noise, refits=2)
        smooth = smoothed(columns, knots)
        _, part = covariance(columns, smooth)
        B = BSpline.design_matrix(np.clip(s, knots[0], knots[-1]), knots, 3).toarray()
        above = max(columns.left - rows, 0) + np.sqrt(2 * rows * columns.inflation)
        std = band(columns, smooth, B, above)
        off = beside(s, B @ part @ smooth.c) - beside(s, law(s))
        inside.append(np.mean(np.abs(off) < 1.96 * std))
        width.append(np.mean(std) / (noise + np.std(off)))
        assert np.std(off) < 0.06 + 0.05 * noise
    assert np.mean(inside) > 0.9
    assert np.mean(width) < 1.0


def off_beside(law, seed, centre, lines):
    """Of a regression on 1 (and s) with a smooth curve beside: by how many standard
    deviations each is off, and its relative width.
    """
    rng = np.random.default_rng(seed)
    s = centre + rng.uniform(-2, 2, WINDOWS * TICKS)
    truth = np.array([0.7, 1.3])[:lines]
    X = np.vander(s, lines, increasing=True)
    y = X @ truth + law(s) + NOISE * rng.normal(size=s.size)
    knots = knots_over(s, COUNT)
    B = BSpline.design_matrix(np.clip(s, knots[0], knots[-1]), knots, 3).toarray()

    def curve_beside(c):
        left = y - B @ c
        left -= X @ np.linalg.lstsq(X, left, rcond=None)[0]
        rows = np.column_stack([-X, -B, left]).reshape(WINDOWS, TICKS, -1) / NOISE
        gram = np.einsum("wti,wtj->wij", rows, rows)
        projection = Projection(gram, range(lines), np.zeros(lines + COUNT))
        columns = Columns.of(projection, list(range(lines, lines + COUNT)), c)
        return columns, smoothed(columns, knots)

    columns, smooth = curve_beside(np.zeros(COUNT))
    for _ in range(2):
        columns, smooth = curve_beside(smooth.c)
    every = np.column_stack([X, B]) / NOISE
    H = every.T @ every
    own = slice(lines, None)
    A, spread = H.copy(), H.copy()
    A[own, own] += smooth.penalty
    found = np.linalg.solve(A, every.T @ y / NOISE)
    line = (knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3
    spread[own, own] += pull(columns, smooth, found[own], line)
    inverse = np.linalg.inv(A)
    std = np.sqrt(np.diag(inverse @ spread @ inverse))[:lines]
    return (found[:lines] - truth) / std, std


@pytest.mark.parametrize("name", [*LAWS, "rise", "nothing"])
def test_what_is_fitted_beside_a_curve_lies_in_its_interval(name):
    """What a law has of the fitted columns goes to them: the intervals count it, and
    are no wider than the law is large.
    """
    laws = {**LAWS, "rise": lambda s: 0.2 * s, "nothing": lambda s: 0 * s}
    # A level that rises with a pressure that is never near zero.
    centre, lines = (30.0, 1) if name == "rise" else (0.0, 2)
    found = [off_beside(laws[name], seed, centre, lines) for seed in range(10)]
    off = np.array([z for z, _ in found])
    # Of s abs(s) a line has most: it lies at the very end.
    assert np.mean(np.abs(off) < (2.1 if name == "drag" else 1.96)) > 0.93
    s = np.linspace(centre - 2, centre + 2, 99)
    most = 2 * np.max(np.abs(laws[name](s))) + NOISE
    assert np.max([std for _, std in found]) < most


def test_what_is_known_and_what_pulls_count_in_an_interval(monkeypatch):
    """Two fitted parameters and a coefficient that is known: by normal equations."""
    monkeypatch.setattr(uncertainty, "parameter_specs", lambda rig: {})
    rng = np.random.default_rng(5)
    X = rng.normal(size=(WINDOWS, TICKS, 3))
    left = rng.normal(size=(WINDOWS, TICKS)) + rng.normal(size=(WINDOWS, 1))
    rows = np.concatenate([-X, left[..., None]], axis=-1)
    gram = np.einsum("wti,wtj->wij", rows, rows)
    names, scale = ("a", "b", "c"), np.array([1.0, 10.0, 2.0])
    held = np.array([[700.0, 300.0], [300.0, 4000.0]])
    problem = Mock(spec=Problem, criteria=Criteria())
    problem.model = Mock(names=names, scale=scale)
    problem.free = {n: Free(0.5, -9.0, 9.0) for n in names}
    problem.known = Known(("c", "b"), np.zeros(2), held)
    problem.sums_at.return_value.gram = gram
    point = FitPoint(np.full(3, 0.5), np.ones(3), 0, True)
    pulled = np.diag([0.0, 5e4, 9e5])
    found = uncertainty.estimate_uncertainty(problem, point, names, pulled)
    A = np.einsum("wti,wtj->ij", X, X)
    A[1:, 1:] += held[::-1, ::-1]
    s = np.einsum("wti,wt->wi", X, left)
    spread = s.T @ s * WINDOWS / (WINDOWS - 3) + pulled
    want = np.linalg.inv(A) @ spread @ np.linalg.inv(A) * np.outer(scale, scale)
    np.testing.assert_allclose(found.covariance, want, rtol=1e-6)


def test_what_stands_above_the_noise():
    """By hand, of a channel at three times its noise, one that is not compared, and one
    at its noise that has earned half its weight.
    """
    state = Mock(spec=Tracing, noise=np.array([1.0, np.inf, 2.0]))
    state.check, state.problem = Mock(), Mock()
    state.point = Mock(weights=np.array([1.0, np.inf, 4.0]))
    state.check.rms.return_value = np.array([3.0, 5.0, 2.0])
    state.problem.batch.weight = np.array([1.0, 1.0, 0.0])
    state.problem.batch.windows.measured = np.zeros((3, 50, 3))
    chance = np.sqrt(2 * 100 * 1.5 * (1 + 1 / 16))
    assert above_noise(state, 1.5) == pytest.approx(100 * 8 + chance)


def test_what_is_fitted_keeps_its_part():
    """A straight law is the fitted parameters' own: no direction of the curve is."""
    *_, knots, columns = drawn(lambda s: 5.0 * s)
    assert directions(columns.H, columns.whole).shape[1] == COUNT - 2
    smooth = smoothed(columns, knots)
    assert smooth.gain < 40
    assert smooth.degrees < 4


def test_smoothing_follows_the_noise():
    def law(s):
        return np.sin(3 * s)

    quiet, loud = (smoothed(*drawn(law, noise=n)[:1:-1]) for n in (0.1, 30.0))
    assert quiet.degrees > 8
    assert loud.degrees < 4


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_named(name):
    s, _, knots, columns = drawn(LAWS[name])
    found = formula_of(columns, smoothed(columns, knots), knots, s, 1.0)
    assert found is not None
    assert found.form.name == name
    want = {"drag": 1.7, "bell": 3.0, "saturation": -2.0, "ramp": 2.5}
    if name in want:
        assert found.amplitudes[0] == pytest.approx(want[name], rel=0.1)
    if name in ("bell", "saturation", "ramp"):
        shape = {"bell": 0.4, "saturation": 0.3, "ramp": 0.5}[name]
        assert found.shape == pytest.approx(shape, rel=0.15)


def test_a_law_that_no_form_has_stays_a_curve():
    def law(s):
        return 3 * np.sin(2.1 * s) * np.exp(s) + 2 * np.cos(5 * s + 1)

    s, _, knots, columns = drawn(law)
    assert formula_of(columns, smoothed(columns, knots), knots, s, 1.0) is None


def test_forms_have_a_term_for_each_power():
    s = np.linspace(-1, 1, 7)
    for form in FORMS:
        assert len(form.of(s, 0.5)) == len(form.powers) == len(form.code)


# -- what has hysteresis --


def slid(x, slip):
    """The deflection of what slides at `slip`, after each position but the first."""
    w, out = 0.0, []
    for dx in np.diff(x):
        w = min(max(w + dx, -slip), slip)
        out.append(w)
    return np.array(out)


def test_deflections_are_those_of_a_stop():
    rng = np.random.default_rng(3)
    x = np.cumsum(rng.normal(size=(2, 801)) * 4e-5, axis=1)
    motion = Mock(dx=np.diff(x, axis=1).reshape(2, 200, 4))
    found = dict(deflections(motion))
    assert set(found) == {1e-4, 3e-4}  # beyond, the motion does not make it slide
    for slip, w in found.items():
        assert w.shape == (2, 201) and not np.any(w[:, 0])
        for own, way in zip(w[:, 1:], x, strict=True):
            np.testing.assert_allclose(own, slid(way, slip)[3::4], atol=1e-15)


def bent(x, z_ss=6e-5):
    """The bristle's deflection at the positions, step by step."""
    z, out = 0.0, [0.0]
    for dx in np.diff(x):
        end = z_ss * np.sign(dx)
        z = end + (z - end) * np.exp(-abs(dx) / z_ss)
        out.append(z)
    return np.array(out)[None]


def test_turns_are_seen():
    """At a swing's ends, but for the way by which it must have come back; a swing that
    does not bend the bristle to the other side, and noise of a fine encoder at rest,
    are no turns.
    """
    t = np.arange(4001) * 1e-3
    x = 2e-3 * np.sin(2 * np.pi * t) + 0.2e-6 * (np.arange(4001) % 2)
    dx = np.diff(x)[None]
    seen = run_turned(bent(x), dx, np.full(dx.shape, 1e-3))
    at = (t > 0.3) & (np.abs(t % 0.5 - 0.25) > 0.05)
    since = (t - 0.25) % 0.5
    np.testing.assert_allclose(np.asarray(seen.since)[0, at], since[at], atol=0.04)
    way = 2e-3 * (1 - np.cos(2 * np.pi * since))
    np.testing.assert_allclose(np.asarray(seen.way)[0, at], way[at], atol=1e-4)
    rest = 1e-3 + 4e-7 * (np.arange(300) % 2)
    back = 1e-3 - 2e-5 * np.sin(np.linspace(0, np.pi, 300))
    for y in (np.r_[np.linspace(0, 1e-3, 100), end] for end in (rest, back)):
        still = run_turned(bent(y), np.diff(y)[None], np.full((1, 399), 1e-3))
        after = np.asarray(still.since)[0, 20:]
        np.testing.assert_allclose(np.diff(after), 1e-3)


def test_contacts_age_at_rest_and_slide_anew():
    """At an even speed an age ends at the way over the speed, at rest it grows with
    time; and tick by tick as over the whole.
    """
    v = np.repeat([5e-3, 0.0, 2e-3], 1500)
    dx, h = v[None] * 1e-3, np.full((1, 4500), 1e-3)
    x = np.r_[0.0, np.cumsum(dx)]
    seen = run_turned(bent(x), dx, h)
    for D, age in zip(AGES[:2], seen.ages, strict=False):
        age = np.asarray(age)[0]
        assert age[1500] == pytest.approx(D / 5e-3, rel=2e-3)
        assert age[3000] == pytest.approx(D / 5e-3 + 1.5, rel=2e-3)
        left = np.exp(-0.1 * 2e-3 / D) * (age[3000] - D / 2e-3)
        assert age[3100] == pytest.approx(D / 2e-3 + left, rel=1e-9)
    own, each = at_rest(jnp.zeros(1)), []
    for i, z in enumerate(bent(x)[0, 1:200]):
        own = own.moved(jnp.asarray([z]), jnp.asarray(dx[:, i]), jnp.asarray(h[:, i]))
        each.append([float(y[0]) for y in jax.tree.leaves(own)])
    want = np.stack([np.asarray(y)[0, 1:200] for y in jax.tree.leaves(seen)], axis=1)
    np.testing.assert_allclose(np.array(each), want, atol=1e-12)


def test_what_the_command_did_is_sampled():
    """Of plays that the command crosses, and of lags: by a filter and by loops."""
    rng = np.random.default_rng(2)
    u = np.cumsum(rng.normal(size=(2, 900)) * 0.02, axis=1)
    motion = Mock(u=u, h=np.full((2, 899), 1e-3))
    found = {name: np.asarray(y) for name, y in commanded(motion)}
    assert {"back_10m", "back_100m", "behind_10ms"} <= set(found)
    for own, way in zip(found["back_100m"], u, strict=True):
        np.testing.assert_allclose(own, np.r_[0.0, slid(way, 0.1)], atol=1e-12)
    keep = np.exp(-1e-3 / 1e-2)
    for own, way in zip(found["behind_10ms"], u, strict=True):
        late = lfilter([0.0, 1 - keep], [1, -keep], way, zi=[way[0]])[0]
        np.testing.assert_allclose(own[1:], (late - way)[1:], atol=1e-9)


@pytest.mark.parametrize("tau", LAGS)
def test_a_lag_is_told_from_a_spool(tau):
    """The nearest spool leaves a twentieth of what a lag does, or more: else the curve
    over it would be `valve_lag` by another name.
    """
    rng, t, h = np.random.default_rng(4), np.arange(6000) * 1e-3, 1e-3
    f = rng.uniform(0.3, 20.0, (30, 1))
    u = np.sin(2 * np.pi * f * t + rng.uniform(0, 6.3, (30, 1))).sum(axis=0)
    keep = np.exp(-h / tau)
    ends = lfilter([0.0, 1 - keep], [1, -keep], u, zi=[u[0]])[0]
    late = (ends - u) * (1 - keep) * tau / h

    def spool(at):
        one, memory = ValveLag(tau=at[0], zeta=at[1]), (u[0], 0.0)
        return jax.lax.scan(lambda m, now: one.step(m, now, h), memory, u)[1]

    grid = np.stack(np.meshgrid(tau * np.geomspace(0.25, 1.5, 20), [0.5, 0.8, 0.99]))
    made = jax.vmap(spool)(grid.reshape(2, -1).T)
    left = np.std((np.asarray(made) - u - late)[:, 1000:], axis=1)
    assert np.min(left) > 0.05 * np.std(late[1000:])
    assert np.min(left) < 0.5 * np.std(late[1000:])


def test_knots_are_drawn_to_a_corner():
    """Of a dead band that is narrow against the range: the error falls with each turn,
    and where a curve does not bend the knots stay.
    """
    s = np.linspace(-5.0, 5.0, 4001)
    law = np.clip(s, -0.05, 0.05)
    knots, off = knots_over(s, COUNT), []
    for _ in range(4):
        B = BSpline.design_matrix(np.clip(s, -4.97, 4.97), knots, 3).toarray()
        c = np.linalg.lstsq(B, law, rcond=None)[0]
        off.append(np.std(law - B @ c))
        assert len(knots) == COUNT + 4 and np.all(np.diff(knots) >= 0)
        knots = drawn_knots(knots, c)
    assert np.all(np.diff(off) < 0) and off[-1] < 0.25 * off[0]
    even = knots_over(s, COUNT)
    np.testing.assert_allclose(drawn_knots(even, np.ones(COUNT)), even)


@pytest.mark.parametrize(
    ("law", "most"),
    [
        (lambda s: 3 * np.abs(s - 0.3), 0.03),
        (lambda s: 4 * np.exp(-np.abs(s + 2) / 0.3), 0.03),
    ],
    ids=["corner", "decay"],
)
def test_what_is_straight_beside_a_corner_is_smooth(law, most):
    """Knots that were drawn to a corner lie far apart where a law runs straight: it is
    followed there too, the better each time they are drawn.
    """
    knots, off = None, []
    for _ in range(4):
        s, _, knots, columns = drawn(law, knots=knots)
        c = smoothed(columns, knots).c
        B = BSpline.design_matrix(np.clip(s, knots[0], knots[-1]), knots, 3).toarray()
        off.append(np.std(beside(s, law(s) - B @ c)))
        knots = drawn_knots(knots, c)
    assert off[-1] < most
    s = np.linspace(knots[0], knots[-1], 999)
    B = BSpline.design_matrix(s, knots, 3).toarray()
    line = np.linalg.lstsq(B, s, rcond=None)[0]
    np.testing.assert_allclose(signal_in(knots), line, atol=1e-9)
    assert line @ roughness(knots) @ line < 1e-12


def test_a_tolerance_moves_a_rig_with_its_curves(recorded):
    """The area alone: every curve lies over the knots that it had."""
    folder = recorded(1)
    case = open_case(folder / "rig.toml", [folder / "fit_1.csv"])
    knots = knots_over(np.linspace(-0.05, 0.05, 301), COUNT)
    forms = [form(knots=jnp.asarray(knots)) for form in FREE_FORMS]
    problem = Problem.of(build_rig(case.spec, (), forms), {}, case.fit, case.criteria)
    moved = tolerance._with(case, problem, "area", 1e-5)
    assert moved.model.names == problem.model.names
    leaves = zip(jax.tree.leaves(problem.model.rig), jax.tree.leaves(moved.model.rig),
                 strict=True)  # fmt: skip
    differ = [(a, b) for a, b in leaves if not np.array_equal(a, b)]
    assert differ
    for a, b in differ:
        np.testing.assert_allclose(b - a, 1e-5, rtol=1e-9)


def test_a_search_holds_no_levels_equal(recorded, monkeypatch):
    """Though a fit without a curve ended where they are: that is where it starts."""
    monkeypatch.setattr(Problem, "started", lambda self, values: self.batch)
    monkeypatch.setattr(Problem, "errors_at", lambda self, values: np.ones((1, 3)))
    monkeypatch.setattr(Problem, "rms", lambda self, errors: np.ones(3))
    folder = recorded(1)
    logs = ([folder / "fit_1.csv"], [folder / "validate.csv"])
    case = open_case(folder / "rig.toml", *logs)
    ended = Mock(in_model=(), channels={}, values={"k_cp": 900.0, "k_cn": 900.0})
    state = begun(case, ended).state
    assert state.named["k_cp"] == state.named["k_cn"] == 900.0
    assert not state.problem.symmetric


@pytest.mark.slow
def test_a_hysteretic_tether_is_found_as_a_curve(recorded):
    """A hardening spring that slips, put into the logs by a loop of plain Python."""
    folder, slip, most = recorded(1), 1e-3, 25.0
    rig = hj.RigFile.load(folder / "rig.toml")

    def tethered(name):
        log = hj.Log.load(folder / name, rig.channels)
        w = np.r_[0.0, slid(log.signals["psi"] * rig.geometry["radius"], slip)]
        force = log.signals["F"] - most * (w / slip) ** 3
        return replace(log, signals=log.signals | {"F": force})

    logs = [tethered(f"fit_{i}.csv") for i in (1, 2)]
    result = hj.fit(rig, logs, validate=[tethered("validate.csv")])
    discovered = hj.discover(result)
    (curve,) = discovered.curves
    assert curve.name == "free_hysteresis_w_1000um"
    noise = result.outcome.channels["F"].noise
    assert curve.before["F"] > 1.3 * noise and curve.after["F"] < 1.05 * noise
    law = most * (curve.rug / slip) ** 3
    off = np.interp(curve.rug, curve.s, curve.y) - law
    assert np.std(off) < 0.04 * most
    assert "w**3" in curve.law
    truth = json.loads((folder / "truth.json").read_text())["rig"]
    told = discovered.beside[lambda rows: rows["identified"]]
    off = [abs(told.at[n, "value"] - truth[n]) / told.at[n, "std"] for n in told.index]
    assert len(off) > 10 and np.mean(np.array(off) < 1.96) > 0.85


@pytest.mark.slow
def test_friction_that_settles_after_a_turn_is_found(recorded):
    """A level that falls with the time since friction turned, put into the logs by
    plain NumPy where it slides.
    """
    folder, most, tau = recorded(1), 60.0, 0.5
    rig = hj.RigFile.load(folder / "rig.toml")
    z_ss = json.loads((folder / "truth.json").read_text())["rig"]["z_ss"]

    def settling(name):
        log = hj.Log.load(folder / name, rig.channels)
        x, t = log.signals["psi"] * rig.geometry["radius"], log.time
        since, z, speed = 0.0, 0.0, 0.0
        out = np.zeros(x.size)
        for i in range(1, x.size):
            h, dx = t[i] - t[i - 1], x[i] - x[i - 1]
            end, before = z_ss * np.sign(dx), z
            z = end + (z - end) * np.exp(-abs(dx) / z_ss)
            since = 0.0 if z * before < 0 else since + h
            speed += (abs(dx) / h - speed) * -np.expm1(-10.0 * h)
            slides = 1 - 1 / (1 + (300.0 * speed) ** 3)
            out[i] = slides * z / z_ss * most * np.exp(-since / tau)
        force = log.signals["F"] - out
        return replace(log, signals=log.signals | {"F": force})

    logs = [settling(f"fit_{i}.csv") for i in (1, 2)]
    result = hj.fit(rig, logs, validate=[settling("validate.csv")])
    (curve,) = hj.discover(result).curves
    # Where speeds differ little, time and way since then say the same.
    assert "free_level_since" in (curve.name, *curve.alike)
    noise = result.outcome.channels["F"].noise
    assert curve.before["F"] > 1.5 * noise and curve.after["F"] < 1.1 * noise
    assert "exp(-abs(" in curve.law
    assert float(curve.law.split()[0]) == pytest.approx(most, rel=0.05)
