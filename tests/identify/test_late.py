"""How late a position is, found by replays."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import hydrojax as hj
from benchmarks.machines import files, record
from hydrojax.effects import EFFECTS
from hydrojax.identify import api, late
from hydrojax.identify.case import open_case
from hydrojax.identify.checking.mended import mended, mended_case
from hydrojax.identify.checking.words import late_position
from hydrojax.identify.estimation.fit import fit_pressures
from hydrojax.identify.late import (
    _lowest,
    with_command_between,
    with_delay_replayed,
    with_late_position,
)
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.identify.tracing.state import Added, Tracing, free_names
from hydrojax.rigfile.schema import RigFile
from tests.pages import ROOT


@pytest.mark.parametrize("at", [-3.6, -0.3, 0.0, 2.45])
def test_the_lowest_point_is_the_parabolas(at):
    asked = []

    def error(i):
        asked.append(i)
        return 2.0 + 3.0 * (i - at) ** 2

    assert _lowest(error) == pytest.approx(at)
    assert len(asked) == len(set(asked))  # each is a fit


def test_no_lowest_point_is_made_up():
    """Where the error falls as far as it is followed."""
    assert _lowest(lambda i: -float(i)) is None


def opened(seed, seconds, folder):
    """A machine of 100 Hz whose position is logged so much later."""
    files.write(record.record([seed])[0], folder)
    rig = hj.RigFile.load(folder / "rig.toml")

    def late(path):
        log = hj.Log.load(path, rig.channels)
        x = CubicSpline(log.time, log.signals["x"])(log.time - seconds)
        first = log.time < log.time[0] + seconds
        x = np.where(first, log.signals["x"][0], x)
        return replace(log, signals=log.signals | {"x": x})

    fit, held = (
        [late(p) for p in sorted(folder.glob(kind))] for kind in ("fit*", "val*")
    )
    return open_case(rig, fit, held)


def ended(case):
    """Where a trace stands that found nothing."""
    problem, check, free, effects = api._problems(case, ())
    *_, problem, point = api._fit_base(problem, free, 1, print, "rig.toml")
    return Tracing(problem, check, effects, free, point, print)


@pytest.mark.slow
def test_a_position_that_no_balance_shows_to_be_late_is_brought_forward(tmp_path):
    """Behind a valve of dead time, lag and dead band, which are declared: to a tick
    first, and to a twentieth of it once that is mended.
    """
    case = opened(21, 0.030, tmp_path)
    state = ended(case)
    assert hj.check(case.spec, case.read_logs).found == ()
    (found,) = with_late_position(case, (), state, print)
    assert (found.input, found.finding) == ("x", "delay")
    near, (marked,) = mended_case(case, [found])
    assert near.spec.channels["x"].late == pytest.approx(0.030, abs=0.010)
    # From as far off as a balance finds it.
    rough = late_position(case.spec, "x", 0.034)
    near, (marked,) = mended_case(case, [rough])
    there = ended(near)
    late = with_delay_replayed(
        near, case.spec, (marked,), there.problem, there.point, there.free, print
    )
    true, _ = mended_case(case, late)
    assert true.spec.channels["x"].late == pytest.approx(0.030, abs=5e-4)
    assert "30" in late[0].says and "34" not in late[0].says


@pytest.mark.slow
@pytest.mark.parametrize("seed", [83, 92])
def test_what_a_model_lacks_is_not_a_late_position(seed, tmp_path):
    """83 lacks a dead band and air, 92 air, a dead time and a rate limit."""
    case = opened(seed, 0.0, tmp_path)
    state = ended(case)
    rms = state.check.rms(state.check.errors_at(state.point.values))
    assert np.max(rms[:2] / state.noise[:2]) > 2.0
    assert with_late_position(case, (), state, print) == ()


def operated(number, folder):
    """A machine of `benchmarks.blind`, whose command runs on between rows."""
    pytest.importorskip("numba")
    from benchmarks.blind.machines.make import make_case

    make_case(number, folder)
    (own,) = folder.iterdir()
    logs = [own / f"{name}.csv" for name in ("fit_1", "fit_2", "validate")]
    return open_case(own / "rig.toml", logs[:2], logs[2:])


@pytest.mark.slow
def test_a_command_that_runs_on_between_rows_is_seen(tmp_path):
    """An operator's, at 250 Hz, of a valve that is declared to act at once."""
    case = operated(24, tmp_path)
    state = ended(case)
    at = (state.problem, state.point, state.free, print)
    (found,) = with_command_between(case, (), *at)
    assert (found.input, found.finding) == ("u", "held")
    near, marked = mended_case(case, [found])
    assert not near.spec.channels["u"].held and marked[0].mended
    there = ended(near)
    off = [s.check.rms(s.check.errors_at(s.point.values)) for s in (state, there)]
    assert np.all(off[1][:2] < 0.8 * off[0][:2])
    assert with_command_between(near, marked, *at) is marked


@pytest.mark.slow
@pytest.mark.parametrize("seed", [83, 92])
def test_what_a_model_lacks_is_not_a_command_between_rows(seed, tmp_path):
    case = opened(seed, 0.0, tmp_path)
    state = ended(case)
    at = (state.problem, state.point, state.free, print)
    assert with_command_between(case, (), *at) == ()


def test_a_position_that_replays_have_early_is_not_called_late(monkeypatch):
    """The balances called it 0.3 ms late, and the model leaves least 0.7 ms before."""
    given = RigFile.load(ROOT / "hydrojax/demo/rig.toml")
    called = late_position(given, "psi", 0.3e-3)
    spec, found = mended(given, [called])
    case = SimpleNamespace(spec=spec, read_logs=[SimpleNamespace(time=[0.0, 1e-3])])
    problem, point = SimpleNamespace(sees_pressures=True), SimpleNamespace(weights=None)
    for moves, left in ((-5.0, 0), (-1.0, 1), (1.0, 1)):
        monkeypatch.setattr(late, "_lowest", lambda _, at=moves: at)
        out = late.with_delay_replayed(case, given, found, problem, point, (), print)
        assert len(out) == left


NONE = (None, None, ())
LAGS = ("pressure_sensor_lag", "channel_skew")


@pytest.mark.parametrize(
    ("names", "skew", "bottom", "called"),
    [
        (LAGS, -2e-3, 3.0, True),
        (LAGS, -2e-3, 3.3, False),  # the two leave less
        (LAGS, 2e-3, 3.0, False),  # the force is ahead
        (LAGS[:1], 0.0, 3.0, False),  # the force is in time
    ],
)
def test_late_pressures_and_a_late_force_are_one_early_position(
    names, skew, bottom, called, monkeypatch
):
    @dataclass(frozen=True)
    class Left:
        """What a fit leaves with the position moved: least 2 ms later."""

        case: object
        problem: object
        refitted: object
        name: str
        weights: object

        def __call__(self, seconds):
            if self.refitted(None) == "with both":
                return 3.0
            return bottom + (1e3 * seconds + 2.0) ** 2

    less = SimpleNamespace(values="without them", weights=None)
    state = SimpleNamespace(
        added=[Added(name, 0.0, *NONE) for name in names],
        effects=EFFECTS,
        named={"pressure_sensor_lag.tau_P": 2.4e-3, "channel_skew.tau_s": skew},
        criteria=Criteria(),
        point=SimpleNamespace(values="with both", weights=None),
        problem=None,
        noise=None,
        fitted_noise=lambda noise: noise,
        free=(),
    )
    given = RigFile.load(ROOT / "hydrojax/demo/rig.toml")
    log = SimpleNamespace(time=[0.0, 1e-3], motion="psi")
    case = SimpleNamespace(spec=given, read_logs=[log])
    monkeypatch.setattr(late, "_Error", Left)
    monkeypatch.setattr(
        late,
        "taken_out",
        lambda s, _: SimpleNamespace(point=less, free=(), effects=s.effects),
    )
    monkeypatch.setattr(late, "fit_jointly", lambda *_: (None, less))
    found = late.with_early_position(case, (), state, print)
    assert len(found) == called
    if called:
        assert (found[0].input, found[0].finding) == ("psi", "delay")
        assert "early" in found[0].says


@pytest.mark.slow
def test_a_command_between_rows_is_seen_that_balances_hardly_want(tmp_path):
    """At 500 Hz, of a stiff chamber."""
    case = operated(44, tmp_path)
    names = ("valve_deadband", "return_overlap")
    problem, _, free, effects = api._problems(case, names)
    free = (*free, *(n for e in effects.values() for n in free_names(e)))
    # Where a trace stands that has found both effects.
    near = {"u_dbp": 0.028, "u_dbn": 0.023, "o_n1": 0.0078, "o_n2": -0.0018}
    values = zip(problem.model.names, problem.initial_values(), strict=True)
    start = np.array([near.get(n.split(".")[-1], v) for n, v in values])
    enough = Criteria().enough_in_search
    problem, values = fit_pressures(problem, start, free, enough)
    at = (problem, SimpleNamespace(values=values), free, print)
    (found,) = with_command_between(case, (), *at)
    assert (found.input, found.finding) == ("u", "held")
