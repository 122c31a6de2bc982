"""Tuning: live eigenvalues against runs, the result in a second simulator, the command.

The second simulator is `Second`, written here on NumPy and scipy with equations of its
own: chambers, valve with turbulent flow, second-order spool, a sample of delay,
presliding by its quadratic, the law at rest with matched estimates; Runge-Kutta of
fourth order at 0.1 ms over all plants at once. Spectra are `scipy.fft`'s.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import tomlkit
from scipy import fft

from hydrojax import cli
from hydrojax.errors import InputError
from hydrojax.paper.records import reference
from hydrojax.rigfile.quantities import open_setting, quantities
from hydrojax.rigfile.schema import RigFile
from hydrojax.tune import (
    api,
    display,
    limiting,
    linearize,
    measure,
    metrics,
    optimize,
    search,
    trials,
    verification,
)
from hydrojax.tune.aims import CONSTRAINTS, TOLERANCE, Limits
from hydrojax.tune.ensemble import (
    DELAY,
    SPOOL_HZ,
    ensemble,
    from_findings,
    with_unsaid,
)
from hydrojax.tune.findings import UNVALIDATED, Findings
from hydrojax.tune.free import default_free
from hydrojax.tune.limiting import what_limits
from hydrojax.tune.objective import Objective
from hydrojax.tune.programs import Rows
from hydrojax.tune.proposal import propose, try_before
from hydrojax.tune.search import Judged
from tests.tunings import tried, tuned

TRIED = tried(16.0, 2.0, (True,) * 3)
SPEC, _ = reference()
KNOWN = {*SPEC.effects, *SPEC.parameters}
MIDDLE = 0.7
"""Where the law's estimates of presliding start: midway between 0.3 and 1.1."""
PLANTS = 4
FIGURES = {
    "within_1dB_Hz", "lag_90_Hz", "follows_to_Hz", "peak_dB", "rms_N", "rms_moving_N",
    "largest_eigenvalue", "oscillates",
}  # fmt: skip


@pytest.fixture(scope="module")
def objective():
    setting = open_setting(SPEC)
    known = quantities(SPEC, setting)
    plants = with_unsaid(setting, ensemble(setting, PLANTS), KNOWN)
    free = [known[n] for n in default_free(setting)]
    return Objective(setting, free, plants, Limits())


@pytest.fixture(scope="module")
def found(objective):
    return optimize.optimize_gains(objective, starts=1, iterations=8)


@pytest.fixture(scope="module")
def proposal(objective, found):
    before = try_before(objective, 450.0)
    return propose(objective, found, before, 450.0, lambda _: None)


# -- a second simulator --


class Second:
    """The locked joint on many plants at once; `gains` k_p, k_f (V/kN), k_1 (V s/kN).

    `plants` [m] by name, SI; the law believes the rig file's constants, and holds its
    estimates of presliding: `believed`, or if None each plant's own.
    """

    H, PARTS = 1e-3, 10
    OMEGA, ZETA = 1257.0, 0.7
    AREA, P_S, P_R, KAPPA, U_MAX = 1.18e-3, 14e6, 0.25e6, 1.18e-4, 10.0
    X_1, X_2 = 0.1 + 12e-3, 0.1 + 18e-3
    C = {"c_p1": 2.24e-9, "c_n1": 2.15e-9, "c_p2": 2.27e-9, "c_n2": 2.11e-9}
    DELTA = 1.1111e-3

    def __init__(self, plants, gains, believed=None):
        self.p, self.m, self.believed = plants, plants["beta"].size, believed
        k_p, k_f, k_1 = gains[:3]
        volts = self.KAPPA * 1e-3
        self.k_p, self.k_f, self.k_1 = k_p * volts, k_f * volts, k_1 * volts

    def force(self, P):
        """Positive root of F + k F / (1 + delta F) = |P|."""
        k = np.where(P > 0, self.p["k_fp"], self.p["k_fn"])
        b = 1 + k - self.DELTA * np.abs(P)
        F = (-b + np.sqrt(b**2 + 4 * self.DELTA * np.abs(P))) / (2 * self.DELTA)
        return np.sign(P) * F

    def rates(self, y, u):
        P_1, P_2, s, w = y
        p, root = self.p, lambda d: np.sign(d) * np.sqrt(np.abs(d))
        up, down = np.maximum(s, 0), np.maximum(-s, 0)
        q_1 = up * p["c_p1"] * root(self.P_S - P_1) - down * p["c_n1"] * root(
            P_1 - self.P_R
        )
        q_2 = down * p["c_p2"] * root(self.P_S - P_2) - up * p["c_n2"] * root(
            P_2 - self.P_R
        )
        return np.stack([
            p["beta"] * q_1 / (self.AREA * self.X_1),
            p["beta"] * q_2 / (self.AREA * self.X_2),
            w,
            self.OMEGA**2 * (u - s) - 2 * self.ZETA * self.OMEGA * w,
        ])  # fmt: skip

    def volts(self, virtual, P_1, P_2):
        c = self.C
        up = c["c_p1"] * np.sqrt(self.P_S - P_1) / self.X_1
        up = up + c["c_n2"] * np.sqrt(P_2 - self.P_R) / self.X_2
        down = c["c_n1"] * np.sqrt(P_1 - self.P_R) / self.X_1
        down = down + c["c_p2"] * np.sqrt(self.P_S - P_2) / self.X_2
        u = -virtual / np.where(virtual < 0, up, down)
        return np.clip(u, -self.U_MAX, self.U_MAX)

    def run(self, F_d):
        """F at every sample, [n, m], N."""
        middle = np.full(self.m, (self.P_S + self.P_R) / 2)
        y = np.stack([middle, middle, 0 * middle, 0 * middle])
        out, before, P_d_old = [], 0 * middle, 0 * middle
        for wanted in F_d:
            P = self.AREA * (y[1] - y[0])
            F = self.force(P)
            out.append(F)
            k = self.p["k_fp"] if wanted > 0 else self.p["k_fn"]
            k = k if self.believed is None else self.believed
            P_d = wanted + k * wanted / (1 + self.DELTA * abs(wanted))
            rate, P_d_old = (P_d - P_d_old) / self.H, P_d
            virtual = self.k_1 * rate + self.k_p * (P_d - P) + self.k_f * (wanted - F)
            u, before = before, self.volts(virtual, y[0], y[1])
            h = self.H / self.PARTS
            for _ in range(self.PARTS):
                a = self.rates(y, u)
                b = self.rates(y + h / 2 * a, u)
                c = self.rates(y + h / 2 * b, u)
                d = self.rates(y + h * c, u)
                y = y + h / 6 * (a + 2 * b + 2 * c + d)
        return np.array(out)


def multisine(lines):
    """Of 30 N RMS over two periods of 1 s, [2000], N."""
    rng = np.random.default_rng(8)
    t = np.arange(2000) * 1e-3
    angle = 2 * np.pi * np.outer(t, lines) + rng.uniform(0, 2 * np.pi, lines.size)
    return 30 * np.sqrt(2 / lines.size) * np.cos(angle).sum(1)


def second(objective, gains, believed=None):
    plants = dict(zip(objective.names, objective.values.T, strict=True))
    return Second(plants, gains, believed)


def second_response(objective, gains, believed):
    """F/F_d at 1 to 120 Hz on every plant, [m, 120]."""
    lines = np.arange(1, 121)
    F_d = multisine(lines)
    F = second(objective, gains, believed).run(F_d)
    return lines, (
        fft.rfft(F[1000:], axis=0)[lines] / fft.rfft(F_d[1000:])[lines, None]
    ).T


# -- stability with the adaptation live --


def rows_of(objective, changes):
    """The rig itself at 3 cm/s with these gains, and a spool of so many Hz."""
    names = [q.name for q in objective.free]
    gains, plant = [], []
    for hertz, values in changes:
        g, p = objective.initial(), objective.values[0].copy()
        for name, value in values.items():
            g[names.index(name)] = value
        p[objective.names.index("valve_lag.tau")] = 1 / (2 * np.pi * hertz)
        gains.append(g)
        plant.append(p)
    return Rows(np.array(gains), np.array(plant), np.full(len(changes), 0.03))


def adapting(share, **gains):
    """Gains, and all rates of adaptation at a share of the paper's."""
    rates = {"rho_a": 700, "c_1": 100, "c_2": 100, "c_3": 20, "c_4": 1e3, "c_5": 1e3,
             "c_6": 20, "c_7": 20}  # fmt: skip
    return gains | {name: share * rate for name, rate in rates.items()}


@pytest.mark.slow
def test_live_eigenvalues_tell_which_runs_oscillate(objective):
    """Below the spool's reach all are stable frozen; adaptation makes some oscillate.

    The truth is the run: to and fro at up to 3 cm/s under 300 N.
    """
    low, middle = {"k_p": 0.24, "k_f": 0.48}, {"k_p": 0.48, "k_f": 0.96}
    cases = [
        (hertz, adapting(share, **gains))
        for hertz in (55.0, 100.0)
        for gains in (low, middle)
        for share in (1.0, 0.01, 0.0)
    ]
    rows = rows_of(objective, cases)
    setting, run = objective.setting, objective.programs
    systems = run.systems(setting, rows, run.settle(setting, rows))
    largest = linearize.largest_eigenvalue(systems)
    which = np.full(len(cases), trials.MOVING)
    F = run.runs(setting, rows, which, objective.trials.scenarios)[..., 0]
    swing = trials.oscillation(objective.trials, trials.MOVING, F, 1e-3)
    # On the 55 Hz spool both, on the 100 Hz one the slower loop, and only adapting.
    fast = np.array([True, False, False, True, False, False, True, *[False] * 5])
    assert np.all((largest >= 1) == fast)
    assert swing[fast].min() > 25 and swing[~fast].max() < 10
    # 500 N and more, as fast as the eigenvalue says.
    values = np.linalg.eigvals(systems.A[0])
    turn = np.abs(np.angle(values[np.argmax(np.abs(values))])) / 2 / np.pi * 1e3
    late = F[0, 2000:4000] - F[0, 2000:4000].mean()
    peak = np.argmax(np.abs(fft.rfft(late))[20:]) / 2 + 10
    assert swing[0] > 500 and 0.6 * turn < peak < 1.1 * turn


@pytest.mark.slow
def test_the_loop_frozen_says_otherwise(objective):
    """What a linearisation without the adaptation promises of the worst of these."""
    rows = rows_of(objective, [(55.0, {"k_p": 0.48, "k_f": 0.96})])
    frozen = rows_of(objective, [(55.0, adapting(0.0, k_p=0.48, k_f=0.96))])
    run = objective.programs
    carries = run.settle(objective.setting, rows)
    live, held = (run.systems(objective.setting, r, carries) for r in (rows, frozen))
    assert linearize.largest_eigenvalue(live)[0] > 1.02
    assert linearize.largest_eigenvalue(held)[0] < 1


# -- what is found and proposed --


@pytest.mark.slow
def test_the_proposal_holds_where_the_paper_s_gains_do_not(objective, proposal):
    """One of the plants limit-cycles with the paper's gains, joint moving."""
    was, now = proposal.before, proposal.after
    assert not was.sound and was.rms_moving.max() > 300
    assert proposal.found and now.sound
    assert now.rms_moving.max() < 50 and now.rms_moving[0] < 2 * was.rms_moving[0]
    assert np.all(now.late < 1) and now.peak.max() < was.peak.max()
    assert not now.oscillates.any() and not now.saturates.any()
    figures = now.figures(None)
    assert set(figures) == FIGURES and figures["oscillates"] is False
    assert was.figures(None)["oscillates"] is True


@pytest.mark.slow
def test_the_proposal_holds_in_a_second_simulator(objective, proposal):
    gains = proposal.after.gains
    lines, H = second_response(objective, gains, MIDDLE)
    linear = objective.evaluate(gains)["response"]
    for ours, theirs in zip(linear, H, strict=True):
        at = np.interp(lines, objective.hertz, ours.real) + 1j * np.interp(
            lines, objective.hertz, ours.imag
        )
        off = np.abs(theirs / at - 1)
        # A multisine about 0 N wiggles over the corner of presliding: 12 % at worst.
        assert np.median(off) < 0.15
    inside = np.abs(1 - H) <= TOLERANCE
    band = lines[np.argmin(inside, axis=1)]
    promised = np.asarray(proposal.after.follows_to)
    assert band[0] >= 0.85 * promised[0]
    # On the other plants a single line may leave the tolerance far below the band that
    # is promised, since the lines wiggle (docs/limits.md): together they do not.
    for own, most in zip(np.abs(1 - H), promised, strict=True):
        off = np.sqrt(np.mean(own[lines <= most] ** 2))
        assert off <= 1.15 * TOLERANCE


@pytest.mark.slow
def test_bad_gains_are_not_proposed(objective, proposal):
    """Four times the paper's feedback: unstable, and said so."""
    bad = objective.initial() * np.array([4, 4, *[1] * 9])
    tried = verification.run_trials(objective, [bad], 450.0)[0]
    said = " ".join(verification.against(objective, tried, proposal.before))
    for what in ("unstable with the adaptation live on 4 of 4", "oscillates", "satur"):
        assert what in said


@pytest.mark.slow
def test_of_gains_that_reach_as_much_those_that_track_best_are_proposed(proposal):
    after = proposal.after
    good = [j for j in proposal.tried if not j.faults and j.wanted <= 0]
    good = good or [j for j in proposal.tried if not j.faults]
    widest = max(j.tried.follows_to.min() for j in good)
    assert after.follows_to.min() >= 0.98 * widest
    for j in good:
        if np.max(j.over) <= 0 and j.tried.follows_to.min() >= 0.98 * widest:
            three = ("rms", "rms_moving", "small_moving")
            ratios = [
                getattr(j.tried, n).max() / getattr(after, n).max() for n in three
            ]
            assert np.prod(ratios) >= 1 - 1e-9


def test_a_search_finds_what_holds_far_from_where_it_begins():
    """What may be proposed is a small part of the range, and no descent ended in it."""
    free = [SimpleNamespace(name=n) for n in ("k_p", "k_f", "rho_a")]
    own = np.array([1.2, 2.4, 700.0])
    objective = SimpleNamespace(
        free=free, groups=np.arange(3), initial=lambda: own.copy()
    )
    holds, far = np.log([0.3, 0.2, 0.05]), []

    def judge(these):
        out = []
        for gains in these:
            far.append(np.log(gains / own))
            over = np.abs(far[-1] - holds) - 0.2
            faults = ("no",) if over.max() > 0 else ()
            tried = replace(TRIED, gains=gains)
            out.append(Judged(tried, faults, over, -1.0, gains[0], gains[0]))
        return out

    begin = judge([own, 0.9 * own])
    found = search.search(objective, begin, judge, lambda _: None)
    good = [j for j in found if not j.faults]
    assert found[:2] == begin and good
    best = max(good, key=lambda j: j.rank)
    # What is aimed at, k_p, is largest where the limits end.
    assert np.log(best.tried.gains[0] / own[0]) == pytest.approx(
        holds[0] + 0.2, abs=0.05
    )
    low, high = optimize.reach(objective)
    assert np.all(np.array(far) >= low - 1e-9) and np.all(np.array(far) <= high + 1e-9)


def test_a_search_leaves_a_region_that_holds_nothing():
    """Where it begins nothing is better near by, and all that keeps the limit lies
    elsewhere.
    """
    free = [SimpleNamespace(name=n) for n in ("k_p", "k_f", "k_1")]
    objective = SimpleNamespace(
        free=free, groups=np.arange(3), initial=lambda: np.ones(3)
    )
    wide, narrow = np.array([-0.5, -1.0, -2.0]), np.array([-1.0, -2.2, 0.3])

    def judge(these):
        out = []
        for gains in these:
            y = np.log(gains)
            none, some = np.linalg.norm(y - wide), np.linalg.norm(y - narrow)
            over = np.array([min(0.3 + 0.5 * none, some - 0.2)])
            faults = ("no",) if over[0] > 0 else ()
            tried = replace(TRIED, gains=gains)
            out.append(Judged(tried, faults, over, -1.0, gains[0], gains[0]))
        return out

    begin = judge([np.ones(3), np.exp(wide)])
    found = search.search(objective, begin, judge, lambda _: None)
    best = max(found, key=lambda j: j.rank)
    assert not best.faults
    # What is aimed at is largest at the edge of what holds.
    away = np.log(best.tried.gains) - narrow
    np.testing.assert_allclose(away, [0.2, 0.0, 0.0], atol=0.08)


def test_a_search_gets_off_gains_whose_runs_have_no_end():
    """None that was tried first follows at all: no model, and yet it goes on."""
    free = [SimpleNamespace(name=n) for n in ("k_p", "k_f")]
    objective = SimpleNamespace(
        free=free, groups=np.arange(2), initial=lambda: np.ones(2)
    )

    def judge(these):
        out = []
        for gains in these:
            dead = np.log(gains[0]) > -3.2
            over = np.array([np.inf if dead else -1.0])
            aim = -np.inf if dead else -float(gains[1])
            faults = ("no",) if dead else ()
            tried = replace(TRIED, gains=gains)
            out.append(Judged(tried, faults, over, over[0], aim, aim))
        return out

    found = search.search(objective, judge([np.ones(2)]), judge, lambda _: None)
    assert any(not j.faults for j in found)
    assert max(found, key=lambda j: j.rank).aim > -0.1


def test_a_point_that_is_never_reached_is_unstable():
    A = np.stack([0.5 * np.eye(2), np.full((2, 2), np.nan)])
    system = SimpleNamespace(A=A)
    np.testing.assert_array_equal(linearize.largest_eigenvalue(system), [0.5, np.inf])


def test_a_response_is_that_without_noise(objective):
    """At both amplitudes; noise as any other would show."""
    rows, t = objective.rows(objective.initial(), (0.0,)), objective.trials
    low = t.given.hertz < 40
    other = np.random.default_rng(1).normal(size=t.scenarios.noise.shape)
    for k in (trials.RESPONSE, trials.RESPONSE_SMALL):
        truth, own, white = (
            trials.response_of(
                t,
                k,
                objective.programs.runs(
                    objective.setting, rows, np.full(PLANTS, k),
                    t.scenarios._replace(noise=jnp.asarray(noise)),
                )[..., 0],
            )[0, low]
            for noise in (0 * other, t.scenarios.noise, other)
        )  # fmt: skip
        assert np.abs(own - truth).max() < 0.005
        assert np.abs(white - truth).max() > 0.01


def test_a_sound_plant_keeps_its_tracking_where_another_oscillated():
    objective = SimpleNamespace(
        limits=Limits(),
        trials=SimpleNamespace(names=tuple("abcdefg"), amplitude=np.full(7, 2000.0)),
    )
    swings = np.zeros((7, 3))
    swings[[trials.MOVING, trials.MOVING_SMALL], 1] = 2.0
    swings[trials.RESPONSE, 0] = 2.0  # in another run than those that are compared
    moving = np.array([8.0, 600.0, 9.0])
    was = replace(TRIED, rms_moving=moving, small_moving=moving, swings=swings)
    assert was.calm.tolist() == [False, False, True] and not was.sound

    def against(*now):
        rms = np.array(now)
        tried = replace(was, rms_moving=rms, small_moving=rms, swings=0 * swings)
        return verification.against(objective, tried, was)

    assert against(8.3, 590.0, 13.0) == ()
    for worse in ((8.3, 20.0, 14.5), (8.5, 20.0, 9.0)):  # the rig itself keeps its own
        (moves, small) = against(*worse)
        assert "tracks worse (moving) on 1 of 3" in moves and "small" in small


def test_what_speaks_against_gains_is_weighed():
    """Each limit by itself, just kept and just broken, and by how much."""
    names = tuple("abcdefg")
    objective = SimpleNamespace(
        limits=Limits(),
        trials=SimpleNamespace(names=names, amplitude=np.full(7, 200.0)),
    )
    three = np.ones(3)
    was = replace(TRIED, rms=2 * three, rms_moving=9 * three, small_moving=9 * three)
    second = np.zeros((7, 3))
    second[0, 1] = 1.0  # of the second plant in the first trial

    def over(**changed):
        now = replace(was, **changed)
        each = verification.checks(objective, now, was)
        said = verification.against(objective, now, was)
        assert [str(c) for c in each if c.over.max() > 0] == list(said)
        return max(float(c.over.max()) for c in each), said

    assert over()[0] <= 0 and over()[1] == ()
    for kept, broken, says in (
        ({"eigenvalue": 0.999 * three}, {"eigenvalue": 1.0 * three}, "unstable"),
        ({"late": 0.999 * three}, {"late": 1.001 * three}, "more delay"),
        ({"swings": 0.99 * second}, {"swings": np.e * second}, "oscillates in the run"),
        ({"full": 0.009 * second}, {"full": 0.01 * np.e * second}, "saturates"),
        ({"rms": 2.09 * three}, {"rms": 1.05 * np.e * 2 * three}, "tracks worse"),
        ({"peak": 3.9 * three}, {"peak": 10.0 * three}, "peak of 10.0 dB on 3 of 3"),
    ):
        assert over(**kept)[1] == ()
        how_far, said = over(**broken)
        assert len(said) == 1 and says in said[0]
        if says not in ("unstable", "more delay"):
            assert how_far == pytest.approx(1.0)
    assert over(swings=np.e * second)[1] == (
        "oscillates in the run 'a' on 1 of 3 plants",
    )
    # A run that is no longer finite is the worst of all.
    assert over(swings=np.inf * three * np.ones((7, 1)))[0] == np.inf


@pytest.mark.slow
def test_a_recorded_rig_gets_gains(recorded):
    """Its spool and delay are not said, and no descent ends where all plants hold."""
    made = api.tune_gains(recorded(1) / "rig.toml")
    assert made.proposal.found
    assert all(j.faults for j in made.proposal.tried[:9])  # the descents' own
    assert not made.proposal.before.sound and made.proposal.after.sound
    assert made.proposal.after.rms_moving.max() < 60


@pytest.mark.slow
def test_both_simulators_run_alike(objective, found):
    """Sample for sample, on the rig and on the others, with the adaptation held."""
    F_d = multisine(np.arange(1, 121))
    nothing = np.zeros((F_d.size, 4))
    given = measure.Excitation("", F_d / 30 * 2**0.5, nothing, 0, np.ones(1))
    for gains in (objective.initial(), found.gains):
        theirs = second(objective, gains).run(F_d)
        for plant in range(PLANTS):
            s = objective.at(gains, plant)
            s = eqx.tree_at(lambda s: s.amplitude, s, jnp.asarray(30.0))
            F = np.asarray(measure.run_excited(s, given, frozen=True))[:, 0]
            off = np.sqrt(np.mean((F - theirs[:, plant]) ** 2))
            assert off < 0.02 * np.std(F)


def test_slopes_are_differences(objective):
    here = objective.initial() * 0.7
    value, slope, stable = objective.scores(here)
    assert stable and value.size == 1 + len(CONSTRAINTS)
    for group in range(slope.shape[1]):
        step = np.where(objective.groups == group, 3e-3, 0.0)
        ends = [objective.scores(here * np.exp(s))[0] for s in (step, -step)]
        rise = (ends[0] - ends[1]) / 6e-3
        for i in (0, 1, 2, 3, 6):  # the run's is rough by the encoder's steps
            assert rise[i] == pytest.approx(slope[i, group], rel=0.03, abs=0.03)


def test_what_limits_it(objective, found, monkeypatch):
    monkeypatch.setattr(limiting, "ITERATIONS", 3)
    told = {r.what: r for r in what_limits(objective, found, lambda _: None)}
    for what in ("spool: ten times as fast", "computing delay: none"):
        assert told[what].gain > told["sensor noise: none"].gain
    ordered = [r.gain for r in told.values()]
    assert ordered == sorted(ordered, reverse=True)


def test_a_rig_file_keeps_its_comments(tmp_path):
    gains = {"k_p": 2.5, "A_a_lower": 5.0, "tau_d": 1e-3}
    units = {"k_p": "V/kN", "A_a_lower": "V*s", "tau_d": "s"}
    rig = replace(tuned(), file=SPEC, gains=gains, units=units).rig
    assert "# the spool" in rig.text and rig.name == SPEC.name
    made = tomlkit.parse(rig.text)["controller"]
    assert made["k_p"] == "2.5 V/kN" and made["tau_d"] == "0.001 s"
    assert list(made["A_a"]) == ["5 V*s", "15 V*s"]
    law = open_setting(rig).loop.law
    assert float(law.k_p) == pytest.approx(2.5e-3 * 1.18e-4)


@pytest.mark.parametrize("end", ["lower", "upper"])
def test_of_a_default_the_bound_that_was_not_tuned_stays(end):
    file = SPEC.with_text(SPEC.text.replace("A_a = [", "# A_a = ["))
    ends = {"lower": 7.0, "upper": 14.0}
    key = f"A_a_{end}"
    new = {"gains": {key: ends[end]}, "units": {key: "V*s"}, "start": {key: 1.0}}
    rig = replace(tuned(), file=file, **new).rig
    was, now = (open_setting(f) for f in (file, rig))
    for name in ("A_a_lower", "A_a_upper"):
        q = quantities(rig, now)[name]
        expected = ends[end] if name == key else float(q.get(was))
        assert float(q.get(now)) == pytest.approx(expected, rel=1e-5)


def test_the_unit_of_the_command_is_the_rig_file_s():
    one = tuned()
    (row,) = (r for r in display.metrics_table(one) if r[0].startswith("Command"))
    assert {cell.rpartition(" ")[2] for cell in row[1:]} == {"V", "–"}
    share = replace(one, file=replace(one.file, command_unit="1"))
    (row,) = (r for r in display.metrics_table(share) if r[0].startswith("Command"))
    assert not any("V" in cell or " " in cell for cell in row[1:])


def test_a_notebook_and_the_report_head_the_limits_alike(tmp_path):
    one = tuned()
    one.save(tmp_path)
    for page in (display.html(one), (tmp_path / "report.html").read_text()):
        assert "Band, worst plant" in page


def test_a_tuning_in_a_notebook(tmp_path):
    """A row a gain, the gist in one line, all of it as text, and a folder."""
    one = tuned()
    frame = one.to_frame()
    assert frame.index.tolist() == ["k_p", "k_f"]
    assert frame.loc["k_p"].tolist() == [1.2, 1.31, "V/kN"]
    assert repr(one) == (
        "<Tuned 'STVF joint 1': k_p=1.31, k_f=3.2; follows up to 14.0 Hz>"
    )
    text = one.summary()
    assert "up to 14.0 Hz on the worst of 3 plants" in text
    assert "At an end of the range that was searched: k_f." in text
    assert "The main limit is spool" in text
    rows = {line.split("  ")[0]: line.split() for line in text.splitlines()}
    assert rows["k_f"] == ["k_f", "2.4", "3.2", "V/kN"]
    assert rows["Peak"] == ["Peak", "4", "dB", "5", "dB", "2", "dB", "2.5", "dB"]
    one.save(tmp_path / "out")
    made = RigFile.load(tmp_path / "out" / "rig.toml")
    assert made.controller["k_f"] == "3.2 V/kN" == one.rig.controller["k_f"]


def test_gains_for_which_nothing_better_was_found_stand_alone(tmp_path):
    """Nowhere the same figures twice, as before and as after."""
    one = tuned()
    was = one.proposal.before
    same = replace(one.proposal, after=was, obstacles=("unstable on 3 of 3 plants",))
    kept = replace(one, gains=one.start, after=one.before, proposal=same)
    rows = {line.split("  ")[0]: line.split() for line in kept.summary().splitlines()}
    assert rows["k_f"] == ["k_f", "2.4", "V/kN"]
    assert rows["Peak"] == ["Peak", "4", "dB", "5", "dB"]
    kept.save(tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    assert "As it is" in page and "<th>After" not in page and ">Before" not in page
    assert page.count('<td class="n">2.4</td>') == 1
    (top, _) = kept.plot("bode").axes
    assert [line.get_label() for line in top.get_legend().get_lines()] == ["as it is"]


@pytest.mark.slow
def test_the_command_on_a_trace_s_folder(tmp_path, monkeypatch, capsys):
    """A leak that trace added: the promise without it, with it, and gains for it."""
    folder, out = tmp_path / "trace", tmp_path / "tune"
    folder.mkdir()
    text = Path(SPEC.path).read_text()
    leak = '[effects.internal_leakage]\nc_il = "2e-12 m^3/(s*Pa)"\n\n[controller]'
    (folder / "rig.toml").write_text(text.replace("[controller]", leak))
    content = {
        "format": "hydrojax-report/1",
        "parameters": {"beta": {"value": 8.3e8, "std": 8e6, "unit": "Pa"}},
        "effects": [{
            "name": "internal_leakage",
            "parameters": {
                "c_il": {"value": 2e-12, "std": 1e-14, "unit": "m^3/(s*Pa)"}
            },
        }],
    }  # fmt: skip
    (folder / "report.json").write_text(json.dumps(content))
    monkeypatch.setattr(optimize, "MAX_ITERATIONS", 3)
    words = ["hydrojax", "tune", str(folder), "--ensemble", "2", "--starts", "1",
             "--at", "amplitude=60", "--out", str(out)]  # fmt: skip
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as done:
        cli.main()
    made = json.loads((out / "tune.json").read_text())
    assert (done.value.code or 0) == (0 if made["proposed"] else 1)
    said = "F follows F_d" if made["proposed"] else "No gains are proposed"
    assert said in capsys.readouterr().out
    assert made["proposed"] == (not made["obstacles"])
    for part in ("before", "after", "worst_of_ensemble"):
        assert set(made[part]) == FIGURES
    page = (out / "report.html").read_text()
    for said in (
        "old model (without internal leakage), gains before",
        "new model, gains after",
        "What limits the bandwidth",
        "data:image",
    ):
        assert said in page
    new = RigFile.load(out / "rig.toml")
    assert new.effects
    assert (new.controller["k_p"] != "1.2 V/kN") == made["proposed"]


def test_bad_input_is_said(tmp_path, call):
    said = call("tune", tmp_path, "--out", tmp_path / "out")
    assert said.code == 2 and "no rig.toml" in said.err
    (tmp_path / "rig.toml").write_text((tmp_path / "x").name)
    with pytest.raises(InputError, match="rig.toml"):
        api.tune_gains(tmp_path / "rig.toml")
    with pytest.raises(InputError, match="no report.json there"):
        api.tune_gains(SPEC, findings=tmp_path)
    with pytest.raises(InputError, match="unknown quantity 'k_pp'"):
        api.tune_gains(SPEC, free=("k_pp",))
    with pytest.raises(InputError, match="invalid gain 'beta'"):
        api.tune_gains(SPEC, free=("beta",))
    with pytest.raises(InputError, match="k_0_lower: starts at -0.5 kN, and only"):
        api.tune_gains(SPEC, free=("k_0_lower",))
    said = call("tune", SPEC.path, "--rig", SPEC.path, "--out", tmp_path / "out")
    assert said.code == 2 and "--rig: only beside a folder" in said.err


def test_metrics_of_the_rig_and_the_worst():
    values = {"within_1dB": np.array([20.0, np.nan]), "peak": np.array([1.0, np.nan]),
              "rms": np.array([5.0, 7.0])}  # fmt: skip
    assert metrics.maximum(values["peak"]) is None
    want = {"within_1dB_Hz": 20, "peak_dB": 1, "rms_moving_N": 5}
    assert metrics.rig_metrics(values) == want


def test_what_the_file_does_not_say_is_assumed():
    """Spool, delay and presliding: of the rig itself, and spread over the others."""
    setting = open_setting(replace(SPEC, effects={}), extra=api.VALVE)
    plants = with_unsaid(setting, ensemble(setting, 6), {"beta"})
    column = dict(zip(plants.names, plants.values.T, strict=True))
    hertz = 1 / (2 * np.pi * column["valve_lag.tau"])
    assert hertz[0] == pytest.approx(SPOOL_HZ) and np.ptp(np.log(hertz)) > 0.3
    assert column["valve_delay.tau_u"][0] == pytest.approx(DELAY * 1e-3)
    assert np.ptp(column["k_fp"]) > 0.2
    for what in ("a spool of 50 to 200 Hz", "samples of delay", "presliding"):
        assert what in plants.description
    same = with_unsaid(setting, ensemble(setting, 6), KNOWN)
    known = dict(zip(same.names, same.values.T, strict=True))
    assert np.ptp(known["valve_lag.tau"]) == np.ptp(known["valve_delay.tau_u"]) == 0


def test_the_joint_moves_no_faster_than_the_valve_can_feed():
    """With equal edges and areas both chambers lose the same at them: of the supply
    2 (A v / (c u))^2, and what is left pushes against friction.
    """
    rig = replace(SPEC, effects={})
    setting = open_setting(rig)
    known = quantities(rig, setting)
    for name in ("c_p1", "c_p2", "c_n1", "c_n2"):
        setting = known[name].put(setting, 1.1e-9 / known[name].factor)
    for name in ("k_cp", "k_cn"):
        setting = known[name].put(setting, 700 / known[name].factor)
    drop = 14e6 - 0.25e6 - 700 / 1.18e-3
    expected = 1.1e-9 * 10 * np.sqrt(drop / 2) / 1.18e-3
    assert float(trials.top_speed(setting)) == pytest.approx(expected, rel=0.05)
    made = trials.make_trials(setting)
    assert made.speed == pytest.approx(0.75 * expected, rel=0.05) and made.speed < 0.03
    x = np.asarray(made.scenarios.environment.x[trials.MOVING])[:, 0, 0]
    assert np.abs(np.diff(x)).max() / 1e-3 == pytest.approx(made.speed, rel=0.01)


def test_what_is_assumed_is_taken_off_what_logs_gave():
    """Of a spool and a delay they may show the sum alone: at low frequencies a spool is
    late by 2 zeta / omega.
    """
    rig = replace(SPEC, effects={})
    setting = open_setting(rig, extra=api.VALVE)
    late_by = quantities(rig, setting)["valve_delay.tau_u"]
    setting = late_by.put(setting, 3e-3 / late_by.factor)
    known = {"valve_delay", "k_fp"}

    def late(plants):
        column = dict(zip(plants.names, plants.values.T, strict=True))
        tau, tau_u = column["valve_lag.tau"], column["valve_delay.tau_u"]
        return 2 * 0.7 * tau + tau_u, tau

    both, _ = late(with_unsaid(setting, ensemble(setting, 6), known))
    one, tau = late(with_unsaid(setting, ensemble(setting, 6), known, fitted=known))
    assert both.min() > 4e-3
    np.testing.assert_allclose(one, 3e-3)
    assert tau.min() > 5e-4 and np.ptp(tau) > 2e-4


def test_a_trace_s_ensemble_is_as_wide_as_its_residual(tmp_path):
    """A covariance of next to nothing, and 8 % of F left by the validation."""
    report = {
        "format": "hydrojax-report/1",
        "parameters": {"beta": {"value": 8.3e8, "std": 1e3, "unit": "Pa"}},
        "effects": [],
        "candidates": [{"name": "valve_lag", "status": "absent"}],
        "channels": {
            "F": {"unit": "N", "after": 9.0, "validate": {"after": 8.0, "held": 100.0}},
            "P_a1": {"unit": "Pa", "after": 1e4, "held": 1e6},
        },
    }
    (tmp_path / "report.json").write_text(json.dumps(report))
    found = Findings.load(tmp_path)
    assert found.residual == pytest.approx(0.08) and found.absent == ("valve_lag",)
    setting = open_setting(SPEC)
    plants = from_findings(setting, found, 40)
    wide = plants.values / plants.values[0] - 1
    assert 0.06 < np.abs(wide).max() <= 0.081
    del report["channels"]
    (tmp_path / "report.json").write_text(json.dumps(report))
    assert Findings.load(tmp_path).residual == UNVALIDATED
