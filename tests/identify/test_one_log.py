"""A logger's filter in one log: where it acts, and how it is found."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

import hydrojax as hj
from hydrojax.effects import EFFECTS
from hydrojax.errors import InputError
from hydrojax.identify.case import open_case
from hydrojax.identify.one_log import _halves
from hydrojax.identify.preparation.data import prepare_logs
from hydrojax.identify.results.summary import _notes
from hydrojax.plant.replay import Windows, before_filters, sensed
from hydrojax.rigfile.build import build_loop
from tests import generator

OMEGA, ZETA = 60.0, 0.8

RIG = """
name = "rig"
layout = "pull-pull"
[geometry]
area = "1.18e-3 m^2"
chamber_length = "0.2 m"
[effects.signal_filter]
omega = "60 rad/s"
zeta = "0.8"
{logs}
"""


def filtered(t, y):
    """What a second-order low-pass makes of a signal that stood still before."""
    system = signal.TransferFunction([OMEGA**2], [1, 2 * ZETA * OMEGA, OMEGA**2])
    return y[0] + signal.lsim(system, y - y[0], t)[1]


def test_a_filter_acts_on_the_windows_of_its_logs_alone():
    """On one as SciPy's filter does, on the other not at all; nor is anything of that
    taken for what stands behind a filter.
    """
    t = 1e-3 * np.arange(400)
    y = 7e6 + 1e5 * np.sin(9 * t) ** 2 * np.array([[1.0], [2.0]])
    slope = np.gradient(y, t, axis=1)
    d = np.stack([slope, np.gradient(slope, t, axis=1)], axis=-1)
    empty = Windows(*[None] * len(Windows._fields))
    w = empty._replace(
        x=y,
        h=np.full(y.shape, 1e-3),
        measured=np.zeros((2, 400, 3)),
        P_a1=y,
        P_a2=y,
        P_s=y,
        dP=np.stack([d, d, d], axis=2),
        filtered=np.array([1.0, 0.0]),
    )
    channel = EFFECTS["signal_filter"](tau=1 / OMEGA, zeta=ZETA)
    rig = SimpleNamespace(sensor_P=(channel,), gauge=lambda i: (channel,), sensor_F=())
    read = np.asarray(sensed(rig, w, jnp.asarray(y), jnp.asarray(y), jnp.asarray(y)))
    np.testing.assert_allclose(read[0, :, 0], filtered(t, y[0]), atol=200.0)
    assert np.max(np.abs(read[0, :, 0] - y[0])) > 1e4
    np.testing.assert_array_equal(read[1, :, 0], y[1])
    ahead = before_filters(rig, w)
    np.testing.assert_array_equal(ahead.P_s[1], y[1])
    assert np.max(np.abs(ahead.P_s[0] - y[0])) > 1e4


def test_the_rig_file_names_the_logs_and_keeps_them():
    rig = hj.RigFile.from_text(RIG.format(logs='logs = ["runs/a.csv"]'))
    assert rig.passes_filter("a.csv") and rig.passes_filter("a.csv, first half")
    assert not rig.passes_filter("b.csv")
    assert hj.RigFile.from_text(RIG.format(logs="")).passes_filter("b.csv")
    again = rig.with_text(rig.text)
    assert again.filtered == ("a.csv",)


def test_no_loop_reads_by_a_filter_of_some_logs():
    named, of_all = (
        build_loop(hj.RigFile.from_text(RIG.format(logs=line))).rig.sensor_P
        for line in ('logs = ["runs/a.csv"]', "")
    )
    assert named == () and [c.name for c in of_all] == ["signal_filter"]


@pytest.mark.parametrize("logs", ["logs = 3", "logs = []", 'logs = ["a.csv", 3]'])
def test_what_is_no_list_of_logs_is_refused(logs):
    with pytest.raises(InputError, match=r'write logs = \["log_1.csv"\]'):
        hj.RigFile.from_text(RIG.format(logs=logs))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("case")
    generator.write_case(out, 3, seconds=8.0)
    return out


def test_windows_know_whether_their_log_was_filtered(folder):
    rig = hj.RigFile.load(folder / "rig.toml")
    logs = [hj.Log.load(folder / f"fit_{i}.csv") for i in (1, 2)]
    data = prepare_logs(logs, replace(rig, filtered=("fit_2.csv",)))
    np.testing.assert_array_equal(data.windows.filtered, data.log == 1)
    assert np.all(np.asarray(prepare_logs(logs, rig).windows.filtered) == 1)


def test_a_name_that_none_of_the_logs_has_is_called_out(folder):
    rig = hj.RigFile.load(folder / "rig.toml")
    names = ("fit_1.csv", "validate.csv", "old.csv")
    logs = [hj.Log.load(folder / f"{n}.csv") for n in ("fit_1", "validate")]
    case = open_case(replace(rig, filtered=names), logs[:1], logs[1:])
    assert [n for n in _notes(case) if "none of these logs" in n] == [
        "old.csv is none of these logs, so no filter acts there; see `logs` under "
        "[effects.signal_filter]"
    ]


def test_the_halves_of_a_log_are_all_of_it(folder):
    log = hj.Log.load(folder / "fit_1.csv")
    log = replace(log, segments=((0, 100), (150, len(log.time))))
    first, second = _halves(log)
    assert [first.name, second.name] == [
        "fit_1.csv, first half",
        "fit_1.csv, second half",
    ]
    assert first.time[-1] < second.time[0]
    for name, y in log.signals.items():
        both = np.concatenate([first.signals[name], second.signals[name]])
        np.testing.assert_array_equal(both, y)
    rows = sum(b - a for part in (first, second) for a, b in part.segments)
    assert rows == len(log.time) - 50
    assert first.segments[0] == (0, 100) and second.segments == ((0, len(second.time)),)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fit_2", "validate"])
def test_a_filter_in_one_log_is_found(name, folder, tmp_path):
    """With its size, and what the other logs say of the rig as it is; the rig file that
    is written says in which log it is, and a prediction of that goes by it.
    """
    logs = {n: hj.Log.load(folder / f"{n}.csv") for n in ("fit_1", "fit_2", "validate")}
    own = logs[name]
    P = {p: filtered(own.time, own.signals[p]) for p in ("P_a1", "P_a2")}
    logs[name] = replace(own, signals=own.signals | P)
    rig = hj.RigFile.load(folder / "rig.toml")
    found = hj.trace(rig, [logs["fit_1"], logs["fit_2"]], validate=[logs["validate"]])
    assert found.verdict == "explained", found.summary()
    (effect,) = found.effects
    assert effect.name == "signal_filter"
    for field, truth in (("omega", OMEGA), ("zeta", ZETA)):
        p = effect.parameters[field]
        assert abs(p.value - truth) < 4 * p.std
    assert effect.parameters["s"].value == pytest.approx(0.0, abs=0.1)
    (said, *_) = found.outcome.limits
    assert said.startswith(f"the pressures of {name}.csv passed a low-pass filter")
    assert found.rig.filtered == (f"{name}.csv",)
    truth = generator.draw_rig(3)
    for parameter in ("c_p1", "beta"):
        p = found.outcome.parameters[parameter]
        assert abs(p.value - truth[parameter]) < 4 * p.std
