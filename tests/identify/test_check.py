"""Inputs that lie, on logs of the independent plant: called by name."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from scipy import constants

import hydrojax as hj
from benchmarks.machines import files, record
from benchmarks.trace.lies import Traced, lies_of, named
from hydrojax.identify.case import open_case
from hydrojax.identify.checking import factors
from hydrojax.identify.checking.balances import EDGES, FLOW, OFFSETS
from hydrojax.identify.checking.factors import Zero
from hydrojax.identify.checking.inputs import inputs_of
from hydrojax.identify.checking.lines import applied, columns, resized, turned
from hydrojax.identify.checking.mended import mended, read_again
from hydrojax.identify.checking.regression import Fitted
from hydrojax.identify.checking.sensors import channel_table
from hydrojax.identify.checking.words import (
    Finding,
    late_position,
    of_zero,
    with_delay,
)
from hydrojax.identify.late import _later

TRIED = (
    "area -2%", "P_s -10%", "psi turned round", "P_a1 turned round",
    "pressures exchanged", "degrees for radians", "MPa for bar", "kN for N",
    "noise of F x10", "noise of P_a1 x0.1", "valve left out", "friction left out",
    "psi 1 ms late", "psi 20 ms late",
)  # fmt: skip
"""Of all that `benchmarks.trace.lies` tells: each kind once."""


def slowly(names, *slow):
    """Parameters of which some take the suite too long."""
    marks = {name: [pytest.mark.slow] for name in slow}
    return [pytest.param(name, marks=marks.get(name, ())) for name in names]


TOLD = {lie.name: lie for lie in lies_of("pull-pull", "psi")}


def machine(seed, folder):
    """A machine of `benchmarks.machines`: its rig file and the logs to fit."""
    files.write(record.record([seed])[0], folder)
    rig = hj.RigFile.load(folder / "rig.toml")
    return rig, [hj.Log.load(p, rig.channels) for p in sorted(folder.glob("fit*.csv"))]


def times(log, name, factor):
    """The log with a signal multiplied."""
    return replace(log, signals=log.signals | {name: factor * log.signals[name]})


@pytest.fixture(scope="module")
def honest(recorded):
    folder = recorded(1)
    rig = hj.RigFile.load(folder / "rig.toml")
    logs = [hj.Log.load(folder / f"fit_{i}.csv", rig.channels) for i in (1, 2)]
    return rig, logs


def test_an_honest_rig_is_left_alone(honest):
    found = hj.check(*honest)
    assert found.found == ()
    assert set(found.inputs.verdict) == {"plausible"}
    assert "No input looks wrong" in found.summary()


@pytest.mark.parametrize(
    "name",
    slowly(
        TRIED,
        "P_s -10%",
        "psi turned round",
        "P_a1 turned round",
        "psi 1 ms late",
        "psi 20 ms late",
    ),
)
def test_a_lie_is_called_by_its_name(honest, name):
    rig, logs = honest
    text, lied = TOLD[name].told(rig.text, logs)
    found = hj.check(hj.RigFile.from_text(text), lied)
    assert named(found.found, TOLD[name]), found.summary()


@pytest.mark.parametrize("name", ["area +2%", "P_s +10%", "F turned round"])
def test_the_mend_is_the_lie_undone(honest, name):
    """The factor that is said takes the lie back."""
    rig, logs = honest
    text, lied = TOLD[name].told(rig.text, logs)
    first = hj.check(hj.RigFile.from_text(text), lied).found[0]
    true = {"area +2%": 1 / 1.02, "P_s +10%": 1 / 1.1, "F turned round": -1.0}[name]
    assert first.factor == pytest.approx(true, rel=5e-3)
    assert first.error is not None and first.error_if_mended is not None
    assert first.error_if_mended < 0.8 * first.error


def declared_volumes(rig, folder, both=1.0):
    """The rig file with both volumes at their true values, times a factor."""
    truth = json.loads((folder / "truth.json").read_text())["rig"]
    lines = {n: f"{both * truth[n]:.6g} m" for n in OFFSETS}
    return applied(rig, {"parameters": lines})


@pytest.mark.parametrize("off", [-8e-3, 4e-3])
def test_a_position_whose_zero_is_off_is_moved_back(honest, recorded, off):
    rig, logs = honest
    rig, radius = declared_volumes(rig, recorded(1)), rig.geometry["radius"]
    lied = [
        replace(log, signals=log.signals | {"psi": log.signals["psi"] + off / radius})
        for log in logs
    ]
    (found,) = hj.check(rig, lied).found
    assert (found.input, found.finding) == ("psi", "zero")
    spec, (marked,) = mended(rig, [found])
    assert marked.mended
    moved = [spec.parameters[n].start - rig.parameters[n].start for n in OFFSETS]
    assert moved == pytest.approx([off, -off], abs=0.05 * abs(off))
    assert hj.check(spec, lied).found == ()


@pytest.mark.parametrize("both", [1.0, 0.7])
def test_volumes_that_are_smaller_both_are_no_zero(honest, recorded, both):
    """Dead volume makes each chamber larger than it is declared."""
    rig, logs = honest
    assert hj.check(declared_volumes(rig, recorded(1), both), logs).found == ()


@pytest.mark.parametrize("x_mid", [0.0, 0.15])
def test_the_zero_of_a_position_is_written_where_the_rig_file_has_it(honest, x_mid):
    rig, logs = honest
    rig = applied(rig, {"geometry": {"x_mid": f"{x_mid} m"}})
    at = inputs_of(rig, logs)
    at = replace(at, logged=at.logged - {"psi"} | {"x"})
    found = of_zero(Zero(6e-3, 2.0, 1.0), at)
    assert (found.input, found.finding) == ("x", "zero")
    assert found.lines == {"geometry": {"x_mid": f"{x_mid + 6e-3:g} m"}}


@pytest.mark.parametrize(
    ("name", "ms"),
    [
        ("P_a1", 8.0),
        ("P_a2", -8.0),
        pytest.param("P_a1", -2.0, marks=pytest.mark.slow),
        pytest.param("P_a2", 2.0, marks=pytest.mark.slow),
    ],
)
def test_one_gauge_that_is_late_or_early_is_brought_to_the_others(honest, name, ms):
    rig, logs = honest

    def moved(log: hj.Log) -> hj.Log:
        P = np.interp(log.time - 1e-3 * ms, log.time, log.signals[name])
        return replace(log, signals=log.signals | {name: P})

    lied = [moved(log) for log in logs]
    new, found = mended(rig, hj.check(rig, lied).found)
    assert [(f.input, f.finding, f.mended) for f in found] == [(name, "delay", True)]
    assert new.channels[name].late == pytest.approx(1e-3 * ms, abs=2e-4)
    assert ("early" if ms < 0 else "late") in found[0].says
    assert hj.check(new, [read_again(log, found, new) for log in lied]).found == ()


@pytest.mark.slow
@pytest.mark.parametrize("ms", (1, 5, 20))
def test_a_late_position_is_brought_forward(honest, tmp_path, ms):
    """By as much as it is late, in the logs as read and in the files."""
    rig, logs = honest
    text, lied = TOLD[f"psi {ms} ms late"].told(rig.text, logs)
    spec = hj.RigFile.from_text(text)
    checked = hj.check(spec, lied).found
    new, found = mended(spec, checked)
    assert [(f.input, f.finding, f.mended) for f in found] == [("psi", "delay", True)]
    assert new.channels["psi"].late == pytest.approx(1e-3 * ms, abs=1e-4)
    given, left = found[0].error, found[0].error_if_mended
    assert given is not None and left is not None and left < 0.8 * given
    own = read_again(lied[0], found, new)
    assert hj.check(new, [read_again(log, found, new) for log in lied]).found == ()
    ((start, stop),) = own.segments
    assert start == 0 and ms <= len(own.time) - stop <= ms + 1
    true, late = logs[0].signals["psi"], lied[0].signals["psi"]
    off = np.abs(own.signals["psi"] - true)[50 : stop - 50]
    assert np.max(off) < 0.1 * np.max(np.abs(late - true))
    frame = lied[0].to_frame()
    units = frame.attrs["units"]
    frame.columns = [f"{n} [{units[n]}]" for n in frame.columns]
    frame.to_csv(tmp_path / "log.csv", index=False)
    read = hj.Log.load(tmp_path / "log.csv", new.channels)
    assert read.segments == own.segments
    assert read.signals["psi"][:stop] == pytest.approx(own.signals["psi"][:stop])


@pytest.mark.slow
@pytest.mark.parametrize("seed", (42, 75, 81))
def test_a_long_dead_time_is_not_a_late_position(seed, tmp_path):
    """Valves of 72 ms and 10 Hz, and of 118 ms and 6 Hz: later than a position can be,
    and between two of the steps that are tried. In 42 it is 78 ms, and a filter of 4 Hz
    makes both pressures late.
    """
    files.write(record.record([seed])[0], tmp_path)
    logs = sorted(tmp_path.glob("*.csv"))
    found = hj.check(tmp_path / "rig.toml", logs).found
    assert len(logs) == 3 and not any(f.finding == "delay" for f in found)


@pytest.mark.slow
def test_a_slow_valve_does_not_hide_exchanged_pressures(tmp_path):
    """At 100 Hz, with dead time, lag and dead band between command and flow."""
    rig, logs = machine(21, tmp_path)
    assert hj.check(rig, logs).found == ()

    def exchanged(log):
        P_1, P_2 = log.signals["P_a1"], log.signals["P_a2"]
        return replace(log, signals=log.signals | {"P_a1": P_2, "P_a2": P_1})

    (found,) = hj.check(rig, [exchanged(log) for log in logs]).found
    assert (found.input, found.finding) == ("P_a1, P_a2", "exchanged")


@pytest.mark.slow
def test_a_flow_that_is_compensated_is_no_supply_in_another_unit(tmp_path):
    """It hangs little on the supply, as through an orifice under one too high."""
    rig, logs = machine(118, tmp_path)
    assert hj.check(rig, logs).found == ()

    low = [times(log, "P_s", 1e3 / constants.psi) for log in logs]
    found = hj.check(rig, low).found[0]
    assert (found.input, found.finding) == ("P_s", "unit")


@pytest.mark.slow
@pytest.mark.parametrize("seed", (116, 118, 126))
def test_units_of_a_supply_are_told_apart(tmp_path, seed):
    """Behind a slow valve the flow goes as well with two or three of them: by what is
    declared, or where the pump follows the load (118 and 126) by that.
    """
    rig, logs = machine(seed, tmp_path)
    assert hj.check(rig, logs).found == ()
    psi = 1e-5 * constants.psi
    for factor in (10.0, 100 * psi, 1 / psi, 0.1, 0.01 / psi):
        (found,) = hj.check(rig, [times(g, "P_s", 1 / factor) for g in logs]).found
        assert (found.input, found.finding) == ("P_s", "unit")
        assert found.factor == pytest.approx(factor, rel=1e-3)


def test_a_late_command_is_not_a_late_position(honest):
    """A dead time of the valve is an effect of the rig."""
    rig, logs = honest

    def late(log):
        u = np.interp(log.time - 4e-3, log.time, log.signals["u"])
        return replace(log, signals=log.signals | {"u": u})

    assert not any(
        f.finding == "delay" for f in hj.check(rig, list(map(late, logs))).found
    )


@pytest.mark.parametrize(
    ("blamed", "verdict", "effects", "aliased", "fooled"),
    [
        (False, "explained", ("stribeck",), False, True),
        (True, "explained", ("stribeck",), False, False),
        (False, "explained", ("loadcell_gain",), True, False),
        (False, "unknown", ("stribeck",), False, False),
        (False, "refused: u [V]", (), False, False),
    ],
)
def test_a_trace_is_fooled_that_ends_well_without_a_word(
    blamed, verdict, effects, aliased, fooled
):
    row = Traced("nothing-0", "P_s +10%", blamed, verdict, effects, aliased)
    assert row.fooled == fooled


def test_an_area_is_named_with_its_alias(honest):
    rig, logs = honest
    text, lied = TOLD["area +2%"].told(rig.text, logs)
    says = hj.check(hj.RigFile.from_text(text), lied).found[0].says
    assert "loadcell_gain" in says and "[geometry] area = " in says


def test_the_line_that_is_said_mends_the_rig_file(honest):
    rig, logs = honest
    text = rig.text + '\n[channels]\nF = { column = "F", invert = true }\n'
    turned = hj.RigFile.from_text(text)
    lied = [replace(g, signals=g.signals | {"F": -g.signals["F"]}) for g in logs]
    lied = [replace(g, channels=dict(turned.channels)) for g in lied]
    says = hj.check(turned, lied).found[0].says
    assert 'F = { column = "F", invert = false }' in says


MENDED = (
    "u turned round", "psi turned round", "pressures exchanged", "kN for N",
    "degrees for radians", "MPa for bar", "bar for Pa", "P_s -10%",
    "pressures turned round", "valve left out", "friction left out",
)  # fmt: skip
"""Lies that a trace undoes by the lines it says."""


@pytest.mark.parametrize(
    "name",
    slowly(
        MENDED, "P_s -10%", "u turned round", "psi turned round", "pressures exchanged",
        "pressures turned round", "MPa for bar", "bar for Pa",
    ),
)  # fmt: skip
def test_what_is_mended_is_the_honest_input(honest, name):
    """The logs are the honest ones again, and the rig file's check finds nothing."""
    rig, logs = honest
    text, lied = TOLD[name].told(rig.text, logs)
    spec = hj.RigFile.from_text(text)
    new, found = mended(spec, hj.check(spec, lied).found)
    assert [f.mended for f in found] == [True] * len(found)
    fit = [read_again(log, found, new) for log in lied]
    for own, log in zip(fit, logs, strict=True):
        for signal, y in log.signals.items():
            close = 0.02 if (name, signal) == ("P_s -10%", "P_s") else 1e-3
            assert own.signals[signal] == pytest.approx(y, rel=close), signal
    assert hj.check(new, fit).found == ()


@pytest.mark.slow
def test_the_lines_mend_the_files_as_well(honest, tmp_path):
    """Read from disk by the mended rig file, a log is what the trace made of it."""
    rig, logs = honest
    text, lied = TOLD["P_s +10%"].told(rig.text, logs)
    u, P = lied[0].signals["u"], lied[0].signals["P_a1"]
    one = replace(lied[0], signals=lied[0].signals | {"u": -u, "P_a1": P / 10})
    spec = hj.RigFile.from_text(text)
    new, found = mended(spec, hj.check(spec, [one]).found)
    own = read_again(one, found, new)
    frame = one.to_frame()
    units = frame.attrs["units"]
    frame.columns = [f"{n} [{units[n]}]" for n in frame.columns]
    frame.to_csv(tmp_path / "log.csv", index=False)
    read = hj.Log.load(tmp_path / "log.csv", new.channels)
    for signal, y in own.signals.items():
        assert read.signals[signal] == pytest.approx(y, rel=1e-9), signal
    assert own.signals["u"] == pytest.approx(u)


def test_a_gain_that_is_an_effect_s_too_is_left_as_it_is(honest):
    rig, logs = honest
    text, lied = TOLD["area +2%"].told(rig.text, logs)
    spec = hj.RigFile.from_text(text)
    found = hj.check(spec, lied).found
    assert [f.input for f in found] == ["area"]
    assert mended(spec, found) == (spec, found)


DIFFERENTIAL = """
layout = "differential"
[geometry]
area_1 = "20 mm^2 +- 2 %"
area_2 = "35 mm^2"
chamber_length = "0.6 m"
x_mid = "0.3 m"
[supply]
P_s = "2.1 bar"
[parameters]
beta = { start = "8e8 Pa", range = ["4e8 Pa", "2e9 Pa"] }
"""


def test_every_size_that_is_off_is_written_with_its_tolerance():
    spec = hj.RigFile.from_text(DIFFERENTIAL)
    new = applied(spec, resized(spec, ["area_1", "area_2", "P_s"], 100.0))
    assert new.geometry["area_1"] == pytest.approx(20e-4)
    assert new.geometry["area_2"] == pytest.approx(35e-4)
    assert new.line["P_s"] == pytest.approx(210e5)
    assert new.tolerances == {"area_1": pytest.approx(0.4e-4)}
    assert "+- 2 %" in new.text


def test_a_second_mend_goes_on_from_the_first():
    spec = hj.RigFile.from_text(DIFFERENTIAL)
    spec = applied(spec, resized(spec, ["P_s"], 100.0))
    assert spec.with_text(spec.text).line["P_s"] == pytest.approx(210e5)
    spec = applied(spec, resized(spec, ["P_s"], 0.9))
    assert spec.line["P_s"] == pytest.approx(189e5)
    turned_round = applied(spec, turned(spec, ["x"]))
    assert turned_round.geometry["x_mid"] == pytest.approx(-0.3)
    assert turned_round.channels["x"].invert


def test_a_line_that_no_rig_can_have_is_left_out():
    spec = hj.RigFile.from_text(DIFFERENTIAL)
    says = ("area_1", "unit", 1e4, None, None, "Pa", "area_1 is off")
    odd = Finding(*says, {"geometry": {"area_1": "-1 m^2"}})
    assert mended(spec, [odd]) == (spec, (odd,))


def test_a_mend_that_can_no_more_be_made_is_none():
    """A position that balances called late, and replays by more than any may be."""
    spec = hj.RigFile.from_text(DIFFERENTIAL)
    late = late_position(spec, "x", 0.3e-3)
    new, (found,) = mended(spec, [late])
    assert found.mended and new.channels["x"].late == pytest.approx(0.3e-3)
    later = with_delay(found, spec, new, 1.2)
    unmended, (none,) = mended(spec, [later])
    assert unmended is spec and not none.mended


def test_each_channel_is_turned_from_how_it_was():
    spec = hj.RigFile.from_text(
        f"{DIFFERENTIAL}[channels]\nP_a1 = {{ column = 'P_a1', invert = true }}"
    )
    new = applied(spec, turned(spec, ["P_a1", "P_a2"]))
    assert not new.channels["P_a1"].invert and new.channels["P_a2"].invert


@pytest.mark.parametrize(("soft", "named"), [(-8e-12, False), (1e-9, True)])
def test_oil_too_stiff_to_be_seen_is_not_named(monkeypatch, soft, named):
    """Its modulus would be that of the softest oil there may be."""
    values = dict.fromkeys(FLOW, 3e-8) | {"beta": soft} | dict.fromkeys(OFFSETS, 1e-10)
    fits = iter([1.0, 2.0])

    def solved(table, names):
        std = dict.fromkeys(names, 4e-11)
        return Fitted({n: values[n] for n in names}, std, next(fits), np.zeros(1))

    monkeypatch.setattr(factors, "solved", solved)
    defaults = dict.fromkeys(FLOW, 1e-8) | {"beta": 7e8} | dict.fromkeys(OFFSETS, 0.0)
    rig = SimpleNamespace(parameters=EDGES[:1])
    of = SimpleNamespace(defaults=defaults, spec=rig, flow=Mock())
    found = factors.flow_left_out(of)
    assert found is not None and set(found.values) >= set(EDGES[1:])
    assert ("beta" in found.values) == named == (OFFSETS[0] in found.values)


@pytest.mark.slow
def test_a_trace_mends_the_input_and_goes_on(honest, recorded):
    """No effect is named for a sign that is wrong."""
    rig, logs = honest
    folder = recorded(1)
    check = hj.Log.load(folder / "validate.csv", rig.channels)
    text, lied = TOLD["psi turned round"].told(rig.text, logs)
    _, (turned,) = TOLD["psi turned round"].told(rig.text, [check])
    result = hj.trace(hj.RigFile.from_text(text), lied, validate=[turned])
    out = result.outcome
    assert (out.verdict, out.effects) == ("nothing missing", ())
    assert out.sentence.startswith("An input looks wrong: psi runs against")
    assert "With it mended: Nothing is missing" in out.sentence
    assert [f.mended for f in out.inputs] == [True]
    for own, log in zip(result.case.fit_logs, logs, strict=True):
        assert own.signals["psi"] == pytest.approx(log.signals["psi"])
    assert hj.RigFile.from_text(out.rig_file).channels["psi"].invert


def test_a_sensor_that_stands_and_one_that_clips(honest):
    rig, (log, other) = honest
    F, P = log.signals["F"].copy(), log.signals["P_a1"].copy()
    F[3000:3300] = F[3000]
    P = np.minimum(P, np.quantile(P, 0.98))
    bad = replace(log, signals=log.signals | {"F": F, "P_a1": P})
    found = hj.check(rig, [bad, other]).findings
    said = set(zip(found.input, found.finding, strict=True))
    assert {("F", "stuck"), ("P_a1", "clipped")} <= said


@pytest.mark.parametrize(
    ("rows", "value"), [(slice(5000, 5100), 0.0), (slice(700, 701), 1e9)]
)
def test_one_bad_sensor_has_no_other_rescaled(honest, rows, value):
    """A loose plug for a tenth of a second, and one bad cell: the force was said to be
    4 and 100 times too small, and a trace went on with it multiplied.
    """
    rig, (log, other) = honest
    P = log.signals["P_a1"].copy()
    P[rows] = value
    bad = replace(log, signals=log.signals | {"P_a1": P})
    (found,) = hj.check(rig, [bad, other]).found
    assert (found.input, found.finding, found.mended) == ("P_a1", "stray", True)
    assert mended(rig, [found])[1] == (found,) and not found.lines
    assert hj.check(rig, [log, other]).found == ()


def test_what_else_lies_is_found_beside_stray_readings(honest):
    rig, (log, other) = honest
    P = log.signals["P_a1"].copy()
    P[5000:5100] = 0.0
    bad = replace(log, signals=log.signals | {"P_a1": P})
    both = [
        replace(g, signals=g.signals | {"F": -g.signals["F"]}) for g in (bad, other)
    ]
    stray, turned = hj.check(rig, both).found
    assert (stray.input, stray.finding) == ("P_a1", "stray")
    assert (turned.input, turned.finding) == ("F", "sign")


def test_a_case_is_without_stray_readings(honest):
    """A stretch of them cuts the log, a lone one makes one tick as long as two."""
    rig, (log, other) = honest
    P, x = log.signals["P_a1"].copy(), log.signals["psi"].copy()
    P[5000:5100], x[8000] = 0.0, x[8000] + 1.0
    bad = replace(log, signals=log.signals | {"P_a1": P, "psi": x})
    case = open_case(rig, [bad], [other])
    (cut,) = case.fit_logs
    assert cut.segments == ((0, 5000), (5100, len(log.time) - 1))
    assert log.time[8000] not in cut.time and len(cut.time) == len(log.time) - 1
    whole = np.concatenate([cut.signals["P_a1"][:5000], cut.signals["P_a1"][5100:]])
    assert whole == pytest.approx(
        np.delete(log.signals["P_a1"], [*range(5000, 5100), 8000])
    )
    assert case.check_logs[0] is other and case.read_logs[0] is bad
    left_out = "rows left out, as P_a1 jumps away and back: 100"
    assert f"{bad.name}: {left_out}" in case.fit.notes


def test_a_channel_brought_forward_does_not_spread_stray_readings(honest):
    rig, (log, _) = honest
    psi = log.signals["psi"].copy()
    psi[8000] += 1.0
    bad = replace(log, signals=log.signals | {"psi": psi})
    late = Finding("psi", "delay", None, None, None, "", "", mended=True)
    spec = applied(rig, columns(rig, ["psi"], delay="5.5 ms"))
    own, sound = (read_again(g, [late], spec).signals["psi"] for g in (bad, log))
    assert np.max(np.abs(own)) < np.max(np.abs(sound)) + 0.01
    spread = _later(bad, "psi", 0.0055).signals["psi"]
    assert np.max(np.abs(spread)) < np.max(np.abs(sound)) + 0.01


def test_a_log_of_which_stray_readings_leave_too_little_stays(honest):
    rig, (log, other) = honest
    P = log.signals["P_a1"].copy()
    rows = np.arange(len(P))
    P[(rows % 400) < 3] = 0.0
    bad = replace(log, signals=log.signals | {"P_a1": P})
    (found,) = hj.check(rig, [bad, other]).found
    assert (found.input, found.finding, found.mended) == ("P_a1", "stray", False)


def test_a_coarse_sensor_that_flickers_does_not_jump(honest):
    _, (log, other) = honest
    P = np.full(len(log.time), 14e6)
    P[::3000] += 8.5e3
    logs = [replace(g, signals=g.signals | {"P_s": P}) for g in (log, other)]
    assert channel_table(logs).strays["P_s"] == 0
    P[1234] += 30 * 8.5e3
    assert channel_table(logs).strays["P_s"] > 0


@pytest.mark.parametrize(("zero", "noise"), [(0.0, 0.0), (5e4, 9e3), (-2e4, 2e3)])
def test_a_supply_of_zero_is_no_supply(honest, zero, noise):
    """All pressures were said to be 100 times too large, and were mended."""
    rig, logs = honest
    chance = np.random.default_rng(0)
    dead = [
        replace(log, signals=log.signals | {"P_s": zero + chance.normal(0, noise, n)})
        for log in logs
        for n in (len(log.time),)
    ]
    (found,) = hj.check(rig, dead).found
    assert (found.input, found.finding) == ("P_s", "stuck")
    assert "give [supply] P_s" in found.says


def test_a_coarse_sensor_at_rest_is_not_stuck(honest):
    """It reads one value for a second and goes on by one step; one that is stuck comes
    back elsewhere.
    """
    _, (log, other) = honest
    steps = np.resize([1.0, 1.0, -1.0], len(log.time))
    steps[len(steps) // 2 :] *= -1.0
    steps[1000:2000] = 0.0
    coarse = 5e6 + 2e3 * np.cumsum(steps)
    stuck = coarse.copy()
    stuck[300:600] = stuck[300]
    coarse[1000:2000] = coarse[1000]
    coarse[2000:2020] += 3.5e3 * np.arange(1, 21) ** 2  # off from rest, ever faster
    rest = coarse[np.arange(len(other.time)) % 900]
    for P, held in ((coarse, 0.001), (stuck, 0.3)):
        logs = [
            replace(g, signals=g.signals | {"P_a1": own})
            for g, own in ((log, P), (other, rest))
        ]
        assert channel_table(logs).stuck["P_a1"] == pytest.approx(held, rel=1e-6)


def test_pressures_that_no_oil_has_are_said_first(honest):
    """Some -5 MPa of gauge pressure: no answer comes without a word on it."""
    rig, (log, other) = honest
    bad = replace(log, signals=log.signals | {"P_a1": log.signals["P_a1"] - 12e6})
    found = hj.check(rig, [bad, other])
    assert bad.signals["P_a1"].max() < -1e6
    assert found.sentence.startswith("P_a1 ")


def test_what_is_written(honest, tmp_path):
    rig, logs = honest
    text, lied = TOLD["u turned round"].told(rig.text, logs)
    found = hj.check(hj.RigFile.from_text(text), lied)
    found.save(tmp_path)
    own = json.loads((tmp_path / "check.json").read_text())
    (first, *_) = own["inputs"]
    assert (first["input"], first["finding"], first["factor"]) == ("u", "sign", -1.0)
    assert {"error_if_mended", "says"} <= set(first)
    assert own["channels"]["P_a1"]["noise"] == pytest.approx(9e3, rel=0.15)
    assert own["logs"]["fit_1.csv"]["rate"] == pytest.approx(1e3)
    page = (tmp_path / "check.html").read_text()
    assert "u runs against" in page and "data:image/png" in page


def test_the_command(recorded, call, tmp_path):
    folder = recorded(1)
    ran = call("check", folder / "rig.toml", folder / "fit_1.csv", "--out", tmp_path)
    assert ran.code == 0 and "No input looks wrong" in ran.out
    assert (tmp_path / "check.html").exists()
    missing = call("check", folder / "rig.toml", folder / "none.csv")
    assert missing.code == 2 and missing.err.count("\n") == 1
