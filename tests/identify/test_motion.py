"""Motion as an output: against cylinders and axes that scipy integrated."""

from __future__ import annotations

import json

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

import hydrojax as hj
from hydrojax.errors import InputError
from hydrojax.identify.case import open_case
from hydrojax.identify.estimation.known import Free
from hydrojax.identify.motion.course import course_of
from hydrojax.identify.motion.follow import MovingRig, follow
from hydrojax.identify.motion.linear import arx_errors
from hydrojax.identify.motion.mover import mover_of
from hydrojax.identify.motion.refine import refined
from hydrojax.parameters import put
from hydrojax.rigfile.build import build_rig, free_load
from hydrojax.rigfile.sections import LOAD

AREA, LENGTH, P_S, P_R = 1.18e-3, 0.2, 14e6, 0.25e6
TRUE = {
    "beta": 9e8, "c_p1": 2.4e-9, "c_n1": 2.1e-9, "c_p2": 2.2e-9, "c_n2": 2.5e-9,
    "payload_inertia.m": 160.0, "viscous_friction.b": 900.0,
}  # fmt: skip

MASS = "payload_inertia.m"

FRICTION = """
k_cp = "0 N"
k_cn = "0 N"
k_0 = "0 N"
k_vp = "0 N*s/m"
k_vn = "0 N*s/m"
k_fp = "0"
k_fn = "0"
"""

CYLINDER = """
name = "free cylinder"
layout = "pull-pull"
[geometry]
area = "1.18e-3 m^2"
chamber_length = "0.2 m"
[load]
F = "0 N"
predicts = "x"
[parameters]
beta = { start = "7e8 Pa", range = ["1e8 Pa", "3e9 Pa"] }
c_p1 = { start = "2.0e-9 m^3/(s*V*Pa^0.5)", range = ["2e-10 m^3/(s*V*Pa^0.5)", "2e-8 m^3/(s*V*Pa^0.5)"] }
c_n1 = { start = "2.0e-9 m^3/(s*V*Pa^0.5)", range = ["2e-10 m^3/(s*V*Pa^0.5)", "2e-8 m^3/(s*V*Pa^0.5)"] }
c_p2 = { start = "2.0e-9 m^3/(s*V*Pa^0.5)", range = ["2e-10 m^3/(s*V*Pa^0.5)", "2e-8 m^3/(s*V*Pa^0.5)"] }
c_n2 = { start = "2.0e-9 m^3/(s*V*Pa^0.5)", range = ["2e-10 m^3/(s*V*Pa^0.5)", "2e-8 m^3/(s*V*Pa^0.5)"] }
FRICTION
[effects.payload_inertia]
m = { start = "100 kg", range = ["1 kg", "1000 kg"] }
[effects.viscous_friction]
b = { start = "300 N*s/m", range = ["0 N*s/m", "5000 N*s/m"] }
""".replace("FRICTION\n", FRICTION.lstrip())  # noqa: E501

AXIS = """
name = "axis"
layout = "driven-axis"
[load]
F = "0 N"
predicts = "x"
[parameters]
FRICTION
[effects.payload_inertia]
m = { start = "60 kg", range = ["1 kg", "1000 kg"] }
[effects.viscous_friction]
b = { start = "100 N*s/m", range = ["0 N*s/m", "5000 N*s/m"] }
""".replace("FRICTION\n", FRICTION.lstrip())


def command(seed: int, seconds: float, size: float) -> np.ndarray:
    """Steps every 0.15 s through a low-pass, and back to the middle; 1 kHz."""
    rng = np.random.default_rng(seed)
    n = int(seconds * 1000)
    steps = np.repeat(rng.uniform(-1, 1, n // 150 + 1), 150)[:n]
    return np.asarray(lfilter([0.02], [1, -0.98], size * (steps - np.mean(steps))))


BOOM = {"mass": 90.0, "damping": 900.0, "second_mass": 70.0,
        "second_stiffness": 6e4, "second_damping": 300.0}  # fmt: skip


def cylinder(seed: int, seconds: float = 8.0, boom: bool = False) -> pd.DataFrame:
    """A log of two chambers, four edges and a mass that moves free, by Runge and Kutta;
    or of `BOOM`, with the net pressure force in place of both pressures.
    """
    u = command(seed, seconds, 3.0)
    t = np.arange(u.size) / 1000
    p = TRUE

    def rate(time, y):
        x, v, P_1, P_2, x_2, v_2 = y
        now = u[min(int(time * 1000 + 1e-9), u.size - 1)]
        up, down = max(now, 0.0), max(-now, 0.0)
        q_1 = p["c_p1"] * up * np.sqrt(max(P_S - P_1, 0.0))
        q_1 -= p["c_n1"] * down * np.sqrt(max(P_1 - P_R, 0.0))
        q_2 = p["c_p2"] * down * np.sqrt(max(P_S - P_2, 0.0))
        q_2 -= p["c_n2"] * up * np.sqrt(max(P_2 - P_R, 0.0))
        V_1, V_2 = AREA * (LENGTH / 2 - x), AREA * (LENGTH / 2 + x)
        force = AREA * (P_2 - P_1) - p["viscous_friction.b"] * v
        joint, m, m_2 = 0.0, p["payload_inertia.m"], 1.0
        if boom:
            m, m_2 = BOOM["mass"], BOOM["second_mass"]
            joint = BOOM["second_stiffness"] * (x - x_2)
            joint += BOOM["second_damping"] * (v - v_2)
        return [
            v,
            (force - joint) / m,
            p["beta"] / V_1 * (q_1 + AREA * v),
            p["beta"] / V_2 * (q_2 - AREA * v),
            v_2,
            joint / m_2,
        ]

    y = np.empty((u.size, 6))
    y[0] = 0.0, 0.0, 5e6, 5e6, 0.0, 0.0
    for k in range(u.size - 1):  # the command jumps at every tick
        span = (t[k], t[k + 1] - 1e-9)
        run = solve_ivp(rate, span, y[k], "RK45", rtol=1e-7,
                        atol=[1e-9, 1e-7, 1, 1, 1e-9, 1e-7])  # fmt: skip
        y[k + 1] = run.y[:, -1]
    rng = np.random.default_rng(100 + seed)
    noise = rng.standard_normal((u.size, 3)) * [1e-6, 9e3, 9e3]
    x, P_1, P_2 = (y[:, [0, 2, 3]] + noise).T
    columns = {"time [s]": t, "u [V]": u, "x [m]": x, "P_s [Pa]": P_S, "P_r [Pa]": P_R}
    if boom:
        F = AREA * (y[:, 3] - y[:, 2]) + rng.standard_normal(u.size)
        return pd.DataFrame(columns | {"F [N]": F})
    columns["P_a1 [Pa]"] = P_1
    return pd.DataFrame(columns | {"P_a2 [Pa]": P_2})


def axis(seed: int, m: float = 95.0, b: float = 210.0) -> pd.DataFrame:
    """A log of a mass on a viscous guide under a force that runs straight between
    ticks, by the exact solution of a tick.
    """
    P = command(seed, 6.0, 300.0)
    h, x, v = 1e-3, np.zeros(P.size), np.zeros(P.size)
    keep = np.exp(-b / m * h)
    for k in range(P.size - 1):
        slope = (P[k + 1] - P[k]) / h
        ahead = P[k] / b - slope * m / b**2  # v tends to this, plus slope t / b
        off = v[k] - ahead
        v[k + 1] = ahead + slope * h / b + off * keep
        x[k + 1] = x[k] + ahead * h + slope * h**2 / (2 * b) + off * m / b * (1 - keep)
    rng = np.random.default_rng(seed)
    t = np.arange(P.size) * h
    x = x + 1e-6 * rng.standard_normal(x.size)
    return pd.DataFrame({"time [s]": t, "x [m]": x, "P [N]": P})


@pytest.fixture(scope="module")
def moved_axis():
    """The fit of an axis, and the rig it was made with."""
    rig = hj.RigFile.from_text(AXIS)
    return hj.fit(rig, [axis(1)], validate=[axis(2)])


@pytest.mark.slow
def test_an_axis_is_predicted_to_its_noise(moved_axis):
    motion = moved_axis.outcome.motion
    whole = motion.channels["x"].horizons["free"]
    assert whole.before / whole.after > 20  # it began 40 % off
    assert whole.skill > 0.999999
    assert list(motion.channels["x"].horizons) == ["0.25", "1", "free"]
    assert motion.values["payload_inertia.m"].value == pytest.approx(95, rel=0.005)
    assert motion.values["viscous_friction.b"].value == pytest.approx(210, rel=0.005)


@pytest.mark.slow
def test_what_is_said_of_it(moved_axis):
    assert "Motion: the position is off by" in moved_axis.outcome.sentence
    assert "x" in moved_axis.channels.index
    assert moved_axis.horizons.loc[("x", "free"), "skill"] > 0.999
    rig = moved_axis.motion_rig
    own = moved_axis.outcome.motion.values["payload_inertia.m"].value
    assert rig.effects["payload_inertia"]["m"].start == pytest.approx(own, rel=1e-5)


@pytest.mark.slow
def test_it_is_in_the_report(moved_axis, tmp_path):
    moved_axis.save(tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["channels"]["x"]["unit"] == "m"
    assert report["channels"]["x"]["horizons"]["free"]["arx"] > 0
    values = report["motion"]["values"]["payload_inertia.m"]
    assert values["unit"] == "kg" and values["value"] == pytest.approx(95, rel=0.005)
    assert hj.RigFile.load(tmp_path / "rig_motion.toml").predicts == "x"
    page = (tmp_path / "report.html").read_text()
    assert "Motion as the model predicts it" in page
    assert (tmp_path / "report_motion.png").stat().st_size > 5000


@pytest.mark.slow
def test_a_cylinder_is_predicted_from_its_command_alone():
    rig = hj.RigFile.from_text(CYLINDER)
    found = hj.fit(rig, [cylinder(1)], validate=[cylinder(2)])
    motion = found.outcome.motion
    whole = motion.channels["x"].horizons["free"]
    assert whole.skill is not None and whole.skill > 0.999
    # The damper is 0.02 of critical: it shows in how an oscillation dies away alone.
    wide = {"viscous_friction.b": 0.5, "payload_inertia.m": 0.05}
    for name, true in TRUE.items():
        near = pytest.approx(true, rel=wide.get(name, 0.01))
        assert motion.values[name].value == near, name
    # The force of a free axis is judged in a band that the oscillation is above.
    windows = found.outcome.parameters["payload_inertia.m"].value
    assert abs(windows / 160 - 1) > 0.2


@pytest.mark.slow
def test_a_boom_that_bends_is_found_from_a_net_pressure(tmp_path):
    """A load of two masses behind an elastic joint, none of which is known: its own
    values, and both signals through a log that took no part.
    """
    text = CYLINDER[: CYLINDER.index("[effects")].replace('F = "0 N"\n', "")
    ranges = "".join(
        f'{key} = {{ start = "{0.5 * v} {LOAD[key]}", '
        f'range = ["{0.05 * v} {LOAD[key]}", "{20 * v} {LOAD[key]}"] }}\n'
        for key, v in BOOM.items()
    )
    rig = hj.RigFile.from_text(text.replace("predicts", ranges + "predicts"))
    logs = [cylinder(i, 3.0, boom=True) for i in (1, 2)]
    found = hj.fit(rig, logs[:1], validate=logs[1:])
    motion = found.outcome.motion
    assert list(motion.channels) == ["x", "F"]
    for channel in motion.channels.values():
        assert (channel.horizons["free"].skill or 0.0) > 0.99
    assert "and the force is off by" in found.outcome.sentence
    for name, true in BOOM.items():
        assert motion.values[f"load.{name}"].value == pytest.approx(true, rel=0.1)
    found.save(tmp_path)
    again = hj.RigFile.load(tmp_path / "rig_motion.toml")
    own = motion.values["load.second_mass"].value
    assert again.output_load["second_mass"] == pytest.approx(own, rel=1e-5)
    assert (tmp_path / "report_motion.png").stat().st_size > 20_000
    report = json.loads((tmp_path / "report.json").read_text())
    free = report["motion"]["channels"]["F"]["horizons"]["free"]
    assert free["after"] == motion.channels["F"].horizons["free"].after


@pytest.mark.slow
def test_what_is_known_beforehand_counts():
    """A mass that is known to a gram is not moved; one that is not is found."""
    case = open_case(hj.RigFile.from_text(AXIS), [axis(1)])
    mover = mover_of(case, {MASS: 60.0}, ())
    assert mover is not None
    course = course_of(case, case.fit_logs, mover.parts)
    start = {MASS: 60.0, "viscous_friction.b": 210.0}
    for prior, found in ((None, 95.0), (1e-3, 60.0)):
        free = {MASS: Free(60.0, 1.0, 1000.0, prior)}
        ends = refined(mover, [start], free, course)
        moved = [values[MASS] for values in ends if values is not start]
        assert min(abs(m - found) for m in moved) < 0.5
        assert prior is None or max(abs(m - 60.0) for m in moved) < 0.5


def test_the_head_of_a_log_is_what_comes_after_it_settled():
    """However few ticks are asked for; all of a log that has no more."""
    case = open_case(hj.RigFile.from_text(AXIS), [axis(1)])
    course = course_of(case, case.fit_logs, 1)
    settles = int(course.settling.sum())
    head = course.head(50)
    assert settles > 200 and head.t.shape[1] == settles + 50
    assert head.inputs.u.shape[1] == settles + 49 and head.there.sum() == 51
    assert course.head(10**6).t.shape == course.t.shape


@pytest.mark.slow
def test_a_run_is_that_of_scipy():
    """At the true values, in parts of a tick, within a micrometre and 0.2 %."""
    log = cylinder(3, 2.0)
    text = CYLINDER
    case = open_case(hj.RigFile.from_text(text), [log])
    moving = MovingRig(build_rig(case.spec), free_load(case.spec))
    moving = put(moving, tuple(TRUE), jnp.array(list(TRUE.values())))
    course = course_of(case, case.fit_logs, 4)
    fresh = jnp.asarray(course.settling)
    seen = np.asarray(jax.jit(follow)(moving, course, fresh))
    there = np.asarray(course.there)[0] > 0
    off = (seen - course.measured)[0, there]
    assert np.sqrt(np.mean(off[:, 0] ** 2)) < 0.01 * np.ptp(log["x [m]"])
    assert np.sqrt(np.mean(off[:, 1] ** 2)) < 0.02 * np.ptp(log["P_a1 [Pa]"])


@pytest.mark.slow
@pytest.mark.parametrize("parts", [1, 8])
def test_a_dead_time_of_many_ticks_is_run_whole(parts):
    """60 ms at 1 kHz: as the run of a log whose command was put back by hand."""
    log = cylinder(3, 1.0)
    late = log.assign(**{"u [V]": log["u [V]"].shift(60).bfill()})
    effect = '[effects.valve_delay]\ntau_u = "60 ms"\n'
    runs = []
    for text, given in ((CYLINDER + effect, log), (CYLINDER, late)):
        case = open_case(hj.RigFile.from_text(text), [given])
        mover = mover_of(case, TRUE, ())
        assert mover is not None
        course = course_of(case, case.fit_logs, parts)
        off = mover.run(TRUE, course, course.settling[None])[0, 0]
        runs.append(off[np.asarray(course.there)[0] > 0, :3])
    size = np.ptp(log[["x [m]", "P_a1 [Pa]", "P_a2 [Pa]"]].to_numpy(), axis=0)
    np.testing.assert_array_less(np.abs(runs[0] - runs[1]) / size, 1e-6)
    assert np.ptp(late["u [V]"]) > 1


def test_a_linear_model_is_judged_on_runs_of_its_own():
    """A system that is linear, of second order, is followed, and no better than that:
    least squares on noisy samples takes its lag for a decay.
    """
    case = open_case(hj.RigFile.from_text(AXIS), [axis(1)], [axis(2)])
    fit, check = (course_of(case, logs, 1) for logs in (case.fit_logs, case.check_logs))
    errors = arx_errors(fit, check, np.asarray(check.settling)[None])
    assert 0 < errors[0] < 0.5 * np.std(np.asarray(check.measured)[..., 0])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('predicts = "x"', 'predicts = "F"'), "[load] predicts: invalid"),
        (('predicts = "x"', "predicts = 1"), "[load] predicts: invalid"),
        (('F = "0 N"', 'F = "5 N"'), "F must be 0 N where predicts is given"),
    ],
)
def test_what_cannot_be_predicted_is_refused(change, said):
    with pytest.raises(InputError) as error:
        hj.RigFile.from_text(AXIS.replace(*change), "rig.toml")
    assert said in str(error.value) and "\n" not in str(error.value)


def test_a_drive_is_asked_for_before_the_fit():
    """Logged pressures alone drive no load; said before anything is fitted."""
    single = AXIS.replace('layout = "driven-axis"', 'layout = "single"')
    single = single.replace("[load]", '[geometry]\narea = "1e-3 m^2"\n[load]')
    log = axis(1).rename(columns={"P [N]": "P_a2 [Pa]"})
    log["P_a2 [Pa]"] = 2e6 + 1e3 * log["P_a2 [Pa]"]
    with pytest.raises(InputError, match="predicts needs a drive"):
        hj.fit(hj.RigFile.from_text(single), [log])


@pytest.mark.slow
def test_without_a_mass_it_is_said():
    text = AXIS.split("[effects.payload_inertia]")[0] + AXIS[AXIS.index("[effects.v") :]
    free = 'k_0 = { start = "0 N", range = ["-50 N", "50 N"] }'
    text = text.replace('k_0 = "0 N"', free)
    found = hj.fit(hj.RigFile.from_text(text), [axis(1)])
    assert found.outcome.motion is None and found.motion_rig is None
    assert any("nothing that moves has a mass" in line for line in found.outcome.limits)
