"""The benchmark's own plant, its bookkeeping and its table."""

import json
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks.trace import (
    cases,
    excitation,
    measures,
    plant,
    record,
    score,
    table,
    tracing,
)
from benchmarks.trace.baselines import regressors, sparse, whiteness
from benchmarks.trace.catalogue import ALL, NAMED, OUTSIDE, UNNAMED
from benchmarks.trace.hidden import Hidden
from benchmarks.trace.truths import laws
from benchmarks.trace.unnamed import Unnamed
from benchmarks.trace.valve import Valve

STEP = 5e-5
RIG = cases.draw_rig(5)


def lane(effects=None, style="fit_1", seed=5, **more):
    return plant.Lane(RIG, RIG, effects or {}, seed, style, **more)


# -- the plant --


@pytest.mark.parametrize("layout", ["pull-pull", "differential"])
def test_plant_agrees_with_a_stiff_solver(layout):
    """One lane, the valve held open, against the equations written out again."""
    r, opening, seconds, line = cases.draw_rig(5, layout), 1.3, 0.05, 14e6
    x_0, P_0 = 2e-3, np.array([6.5e6, 7e6])
    one = plant.Plant([plant.Lane(r, r)], STEP)
    one.start(np.array([x_0]), np.array([0.0]), P_0[:, None])
    K, D, M = one.K, one.D, plant.MASS
    one.z, one.slow = np.array([2e-5]), np.array([1e-3])
    edges = np.array([[[opening], [0.0]], [[0.0], [opening]]])
    g = one.conductances(0.0, edges)
    cell, a, a_p = one.forces(0.0, 0.0, K * x_0 + 200.0)
    for k in range(round(seconds / STEP)):
        push = K * x_0 + 200.0 * math.cos(60 * (k + 1) * STEP)
        one.advance(a, a_p, line, g)
        cell, a, a_p = one.forces(0.0, 0.0, np.array([push]))

    def force(x, v, z, slow, p_1, p_2):
        level = r["k_cp"] if z > 0 else r["k_cn"]
        f_c = level * z / r["z_ss"] + r["k_0"] - (r["k_vp"] if v > 0 else r["k_vn"]) * v
        ell = 1 / (1 + (300 * slow) ** 3)
        net = r["area_2"] * p_2 - r["area_1"] * p_1 - (1 - ell) * f_c
        k_f, F = (r["k_fp"] if net > 0 else r["k_fn"]) * ell, net
        for _ in range(200):  # the implicit law itself, not its closed root
            F = net / (1 + k_f / (1 + r["delta"] * abs(F)))
        return F

    def slopes(t, y):
        x, v, p_1, p_2, z, slow = y
        F = force(x, v, z, slow, p_1, p_2)
        servo = K * (x_0 - x) + 200.0 * math.cos(60 * t) - D * v
        x_1 = 0.1 + r["delta_1"] - x
        x_2 = 0.1 + r["delta_2"] + x
        q_1 = r["c_p1"] * opening * math.sqrt(line - p_1)
        q_2 = -r["c_n2"] * opening * math.sqrt(p_2 - r["P_r"])
        return [
            v,
            (F + servo) / M,
            r["beta"] * (q_1 / r["area_1"] + v) / x_1,
            r["beta"] * (q_2 / r["area_2"] - v) / x_2,
            v - abs(v) * z / r["z_ss"],
            10 * (abs(v) - slow),
        ]

    start = [x_0, 0.0, *P_0, 2e-5, 1e-3]
    done = solve_ivp(slopes, (0, seconds), start, "LSODA", rtol=1e-9, atol=1e-12)
    x, v, p_1, p_2, z, slow = done.y[:, -1]
    assert one.x[0] == pytest.approx(x, abs=3e-9)
    assert one.v[0] == pytest.approx(v, abs=2e-7)
    assert one.P[:, 0] == pytest.approx([p_1, p_2], abs=200.0)
    assert one.z[0] == pytest.approx(z, abs=2e-9)
    assert cell[0] == pytest.approx(force(x, v, z, slow, p_1, p_2), abs=0.3)


def test_flow_laws_have_their_closed_forms():
    P, line = np.array([[4e6], [9e6]]), np.array([14e6])
    u = 0.8

    def rates(effects, edges):
        one = plant.Plant([lane(effects)], STEP)
        g = one.conductances(0.0, np.asarray(edges, float)[..., None])
        return one.pressure_rates(P, line, np.zeros(1), np.zeros(1), g)[:, 0]

    areas = np.array([RIG["area_1"], RIG["area_2"]])
    volume = areas * (0.1 + np.array([RIG["delta_1"], RIG["delta_2"]]))
    stiff = RIG["beta"] / volume
    shut, up = np.zeros((2, 2)), [[u, 0], [0, u]]
    leak = rates({"internal_leakage": {"c_il": 1e-12}}, shut)
    assert leak == pytest.approx(stiff * 1e-12 * np.array([5e6, -5e6]))
    out = rates({"external_leakage": {"c_el": 1e-12}}, shut)
    assert out == pytest.approx(-stiff * 1e-12 * np.array([3.75e6, 8.75e6]))
    relief = {"g_1": 1e-12, "g_2": 2e-12, "P_set1": 4e6, "P_set2": 4e6}
    out = rates({"port_relief": relief}, shut)
    assert out == pytest.approx(-stiff * 2e-12 * np.array([0, 4.75e6]))
    spare = rates({"dead_volume": {"V_0": 1e-5}}, up)
    assert spare == pytest.approx(rates({}, up) * volume / (volume + 1e-5))
    loss, c = 1e14, RIG["c_p1"] * u
    drawn = rates({"supply_line_drop": {"k_s": loss}}, up)[0] / stiff[0]
    assert drawn == pytest.approx(c * math.sqrt(10e6 - loss * drawn**2), rel=1e-6)
    gone = -rates({"return_line_drop": {"k_r": loss}}, up)[1] / stiff[1]
    c = RIG["c_n2"] * u
    assert gone == pytest.approx(c * math.sqrt(8.75e6 - loss * gone**2), rel=1e-6)
    scored = rates({"scored_bore": {"c_il": 1e-12, "width": 4e-3}}, shut)
    assert scored == pytest.approx(leak)  # in the middle


def test_friction_that_depends_on_speed_follows_the_film():
    peak, width, film, v = 90.0, 4e-3, np.array([3e-3]), np.array([8e-3])
    own = {
        "stribeck": {"k_st": peak, "v_s": width},
        "frictional_lag": {"tau_h": 0.1},
    }
    one = plant.Plant([lane(own)], STEP)
    one.z, one.film = np.array([RIG["z_ss"]]), film
    got = one.sliding(0.0, np.zeros(1), v, np.full((2, 1), 5e6))
    level = RIG["k_cp"] + peak * np.exp(-((film / width) ** 2))
    assert got == pytest.approx(level + RIG["k_0"] - RIG["k_vp"] * film)


def test_what_nothing_names_has_its_closed_form():
    """Flows, levels, forces and readings, one law a lane, against curves of their own;
    what remembers is moved there by steps.
    """
    names = [n for n in UNNAMED if n not in ("tapered_bore", "swollen_land")]
    odd = Unnamed(Hidden([{n: ALL[n].scaled(1.0)} for n in names]), STEP)
    lane, e, ones = names.index, ALL, np.ones(len(names))
    P = np.array([9e6, 4e6])[:, None] * ones
    q = odd.flow(0.0, P, 2.5e5 * ones, 6e-3 * ones, -0.01 * ones)
    c = e["one_way_seal"].at_1["c"] * 5e6
    assert q[:, lane("one_way_seal")] == pytest.approx([-c, c])
    k = e["cracked_piston"].at_1["k"] * math.sqrt(5e6)
    assert q[:, lane("cracked_piston")] == pytest.approx([-k, k])
    k = e["weeping_rod"].at_1["k"] * math.sqrt(8.75e6)
    assert q[:, lane("weeping_rod")] == pytest.approx([-k, 0.0])
    assert q[:, lane("dragged_oil")] == pytest.approx(
        [-1e-2 * ALL["dragged_oil"].at_1["k"]] * 2
    )
    for _ in range(4000):  # 0.2 s at 5 mm/s, the bristle on one side
        odd.follow(4e-3 * ones, 5e-3 * ones, 6e-5 * ones, P)
    level = odd.level(4e-3 * ones, 5e-3 * ones, P)
    force = odd.force(1.0, 4e-3 * ones, 5e-3 * ones)
    drag = odd.friction(1.0, 5e-3 * ones)
    seen = {"x": 4e-3, "v": 5e-3, "P_net": -5e6, "since": 0.2, "t": 1.0,
            "age_1000um": 1e-3 / 5e-3 * (1 - math.exp(-0.2 * 5e-3 / 1e-3)),
            "w_300um": 3e-4}  # fmt: skip
    read = odd.read(1.0, np.zeros((3, len(names))), 1e-3)
    law = laws("warming_cell", e["warming_cell"].at_1, RIG)["free_force_t"]
    assert read[2, lane("warming_cell")] == pytest.approx(law(np.float64(1.0)))
    checked = []
    for name in set(names) - {"warming_cell"}:
        for term, law in laws(name, e[name].at_1, RIG).items():
            place, signal = term.removeprefix("free_").split("_", 1)
            times = 5e-3 if "per_v" in term else 1.0
            signal = signal.removeprefix("per_v_")
            if place in ("level", "friction", "force", "hysteresis") and signal in seen:
                got = {"level": level, "friction": drag, "force": force}
                own = -force if place == "hysteresis" else got[place]
                want = times * law(np.float64(seen[signal]))
                assert own[lane(name)] == pytest.approx(want, rel=2e-3), name
                checked.append(name)
    assert len(checked) > 10
    soft = odd.soft(0.0, P, 1e-9)
    for name in ("softening_hose", "gas_pocket"):
        law = laws(name, e[name].at_1, RIG)["free_compliance_P"]
        assert soft[:, lane(name)] - 1e-9 == pytest.approx(law(P[:, 0]))


def test_spool_follows_its_step_response():
    w, zeta, ticks = 900.0, 0.6, 8
    effects = [{"valve_lag": {"omega": w, "zeta": zeta}}, {}]
    valve = Valve(Hidden(effects), ticks, 20, STEP)
    seen = np.concatenate(
        [valve.openings(k, np.array([2.0, 2.0])) for k in range(ticks)]
    )
    assert np.all(seen[:, 1] == 2.0)
    t = np.arange(1, ticks * 20 + 1) * STEP
    free = w * math.sqrt(1 - zeta**2)
    fade = np.exp(-zeta * w * t)
    at_ends = 2 - 2 * fade * (np.cos(free * t) + zeta * w / free * np.sin(free * t))
    means = (at_ends + np.concatenate([[0.0], at_ends[:-1]])) / 2
    assert seen[:, 0] == pytest.approx(means, abs=1e-9)


def test_delay_play_and_rate_limit_act_on_the_command():
    effects = [
        {"valve_delay": {"tau_u": 1.52e-3}},
        {"valve_hysteresis": {"u_h": 0.1}},
        {"valve_rate_limit": {"r_v": 100.0}},
    ]
    valve = Valve(Hidden(effects), 4, 20, STEP)
    u = [0.0, 1.0, 1.05, 0.5]
    seen = np.stack([valve.openings(k, np.full(3, value)) for k, value in enumerate(u)])
    assert seen[2, 9, 0] == 0.0 and seen[2, 11, 0] == 1.0
    assert seen[2, 10, 0] == pytest.approx(0.6)  # 0.4 of a substep is still before it
    assert seen[:, 0, 1] == pytest.approx([0.0, 0.9, 0.95, 0.6])
    assert seen[1, :, 2] == pytest.approx(100 * STEP * (np.arange(20) + 0.5))


def test_lanes_side_by_side_equal_lanes_alone():
    """Whatever stands beside it, a lane is recorded as if alone."""
    names = ["valve_delay", "rod_compliance", "stribeck", "channel_skew", "mains_hum"]
    lanes = [lane({n: ALL[n].scaled(1.0)}, noise="quantised", seed=2) for n in names]
    lanes += [lane(style="validate")]
    together = record.record(lanes, 0.1, ahead=20)
    for one, log in zip(lanes, together, strict=True):
        (alone,) = record.record([one], 0.1, ahead=20)
        for name, y in alone.items():
            assert log[name] == pytest.approx(y, rel=1e-9, abs=1e-9), name


def test_every_effect_shows_and_vanishes():
    """Size 3 changes the log; as good as none does not."""
    # What needs a mass of its own, or rings, has no vanishing size.
    vanish = [n for n, kind in ALL.items() if kind.strengths and n != "backlash"]
    lanes = [lane()]
    lanes += [lane({n: kind.scaled(3.0)}) for n, kind in ALL.items()]
    lanes += [lane({n: ALL[n].scaled(1e-9)}) for n in vanish]
    bare, *logs = record.record(lanes, 0.45, ahead=0)
    assert all(np.isfinite(y).all() for log in logs for y in log.values())
    apart = [
        sum(
            np.std(log[c] - bare[c]) / excitation.NOISE[c]
            for c in ("P_a1", "P_a2", "F")
        )
        for log in logs
    ]
    shown = dict(zip(ALL, apart, strict=False))
    assert {n for n, d in shown.items() if d < 0.01} <= {"end_cushion"}
    gone = dict(zip(vanish, apart[len(ALL) :], strict=True))
    assert max(gone.values()) < 0.01, gone


def test_finer_substeps_change_little():
    coarse, fine = (record.record([lane()], 0.3, n, ahead=0)[0] for n in (20, 40))
    for name, part in (("P_a1", 0.15), ("P_a2", 0.15), ("F", 0.15)):
        assert np.std(coarse[name] - fine[name]) < part * excitation.NOISE[name]


@pytest.mark.parametrize("kind", excitation.NOISES)
def test_noise_has_the_declared_size(kind):
    """Rounding, of a signal that crosses many steps, is part of it."""
    rng = np.random.default_rng(0)
    error = excitation.noise(rng, 200_000, kind)[:, 3]
    if kind == "quantised":
        lsb, true = excitation.LSB["F"], rng.uniform(-500, 500, error.size)
        error = np.round((true + error) / lsb) * lsb - true
    assert np.std(error) == pytest.approx(2.5, rel=0.02)


# -- cases --


def test_plan_is_mixed_and_repeats():
    first, longer = cases.plan(24), cases.plan(60)
    assert first == longer[:24]
    assert {s.kind for s in first} == set(cases.MIXED)
    assert len({s.name for s in longer}) == 60
    assert all(s.kind == "pair" for s in cases.plan(0, {"pair": 5}))
    more = cases.plan(24, {"nothing": 10, "large": 2})
    assert more[:24] == first
    assert [s.kind for s in more].count("nothing") == 10
    assert [s.kind for s in more].count("large") == 2
    with pytest.raises(KeyError, match="no such kind"):
        cases.plan(3, {"all": 1})


def test_catalogue_holds_what_is_promised():
    assert len(NAMED) == 29 and len(OUTSIDE) >= 8
    assert not set(NAMED) & set(OUTSIDE)


def test_case_on_disk_is_readable(tmp_path):
    from hydrojax.logs.log import Log
    from hydrojax.rigfile.schema import RigFile

    spec = cases.CaseSpec("effect-valve_lag-1-0", "effect", {"valve_lag": 1.0})
    cases.write_cases([spec], tmp_path, tracing.declare, seconds=0.6)
    folder = tmp_path / spec.name
    declared, oracle = (RigFile.load(folder / f"{n}.toml") for n in ("rig", "oracle"))
    assert set(oracle.effects) == {"valve_lag"} and not declared.effects
    log = Log.load(folder / "fit_1.csv")
    assert len(log.time) == 600 and {"u", "psi", "P_a1", "P_s", "F"} <= set(log.signals)
    truth = json.loads((folder / "truth.json").read_text())
    start, true = declared.parameters["beta"].start, truth["rig"]["beta"]
    assert 0 < abs(start / true - 1) <= 0.1


@pytest.mark.slow
def test_a_differential_cylinder_reads_back(tmp_path):
    from hydrojax.logs.log import Log
    from hydrojax.rigfile.schema import RigFile

    (spec,) = cases.plan(0, {"differential": 1})
    cases.write_cases([spec], tmp_path, seconds=0.6)
    rig = RigFile.load(tmp_path / spec.name / "rig.toml")
    assert rig.layout.name == "differential"
    assert 0.55 < rig.geometry["area_1"] / rig.geometry["area_2"] < 0.85
    s = Log.load(tmp_path / spec.name / "fit_1.csv").signals
    assert "x" in s and "psi" not in s
    # In balance but for friction and noise: the areas are the plant's own.
    drive = rig.geometry["area_2"] * s["P_a2"] - rig.geometry["area_1"] * s["P_a1"]
    assert np.median(np.abs(drive - s["F"])) < 2000.0


# -- bookkeeping --


def stub(folder):
    if "bad" in folder.name:
        raise ValueError("no\nluck")
    (folder / "traced").write_text("once")
    return {"kind": "nothing", "sizes": {}}


def record_nothing(specs, folder):
    bad = {s.name: "ran away" for s in specs if s.name == "burst"}
    for spec in specs:
        (folder / spec.name).mkdir(parents=True)
        (folder / spec.name / "truth.json").write_text("{}")
    return bad


def test_resume_repeats_nothing_and_failures_stop_nothing(tmp_path):
    names = ["a", "bad", "b", "burst", "c"]
    specs = [cases.CaseSpec(n, "nothing") for n in names]
    score.score(specs[:2], tmp_path, stub, record_nothing)
    with (tmp_path / "results.jsonl").open("a") as file:
        file.write('{"case": "b", "ok"')  # a kill in the middle of a line
    heard = []
    rows = score.score(
        specs, tmp_path, stub, record_nothing, progress=lambda *what: heard.append(what)
    )
    assert [r["case"] for r in rows] == ["a", "bad", "burst", "b", "c"]
    assert "a" not in [what for what, *_ in heard]
    reasons = {r["case"]: r.get("reason") for r in rows}
    assert reasons["bad"] == "ValueError: no luck"
    assert reasons["burst"] == "ran away"
    assert heard[-1][1:] == (5, 5)
    text = (tmp_path / "results.jsonl").read_text()
    assert score.score(specs, tmp_path, stub, record_nothing) == rows
    assert (tmp_path / "results.jsonl").read_text() == text


# -- table --


@pytest.mark.parametrize(
    ("hits", "of", "low", "high"),
    [(0, 10, 0.0, 0.27753), (5, 10, 0.23659, 0.76341), (10, 10, 0.72247, 1.0)],
)
def test_wilson(hits, of, low, high):
    assert measures.wilson(hits, of) == pytest.approx((low, high), abs=1e-5)


def row(case, kind, sizes, names, verdict="explained", power=0.9, **more):
    channel = {"noise": 2.0, "before": 6.0, "after": 2.0}
    return {
        "case": case,
        "ok": True,
        "kind": kind,
        "sizes": sizes,
        "noise": "white",
        "shifted": False,
        "effects": {n: ALL[n].scaled(s) for n, s in sizes.items()},
        "verdict": verdict,
        "named": [
            {"name": n, "parameters": p, "gain": g, "cannot_tell_from": alike}
            for n, p, g, alike in names
        ],
        "candidates": {n: {"power": power, "status": "", "p": 0.1} for n in sizes},
        "channels": {"F": channel},
        "parameters": {"beta": {"truth": 1.0, "value": 1.1, "interval": [0.9, 1.3]}},
        "seconds": {"run": 4.0, "compile": 9.0},
        "oracle": {"F": 2.1},
    } | more


def test_table_counts():
    bias, delay = {"valve_bias": 1.0}, {"valve_delay": 1.0}
    u_0 = ALL["valve_bias"].at_1["u_0"]
    rows = [
        row("n0", "nothing", {}, [], "nothing missing"),
        row("n1", "nothing", {}, [], "unknown"),
        row("e0", "effect", bias, [("valve_bias", {"u_0": 1.1 * u_0}, 5, [])]),
        row("e1", "effect", delay, [("valve_lag", {"omega": 1}, 5, ["valve_delay"])]),
        row("e2", "effect", bias, [], "nothing missing", power=0.2),
        row("o0", "outside", {"side_load": 1.0}, [], "unknown", oracle=None),
        {"case": "x", "kind": "effect", "sizes": bias, "ok": False, "reason": "why"},
    ]
    text = table.report(rows)
    assert "| something said though nothing is missing | 1/2 = 50%" in text
    assert "| effect of size 1 seen | 2/3 = 67%" in text
    assert "| effect seen where it matters (2 % of noise) | 2/3 = 67%" in text
    assert "| top-1, all sizes | 1/3 = 33%" in text
    assert "| top-1 where reported power >= 0.8 | 1/2 = 50%" in text
    assert "| named or among `cannot_tell_from` | 2/3 = 67%" in text
    assert "| outside the vocabulary: `unknown` | 1/1 = 100%" in text
    assert "| size of the effect, median error | 0.1 (1) |" in text
    assert "| valve_delay | 1 | 1 | 0.90 | 3.00 | 1.00 | valve_lag |" in text
    assert "| x | why |" in text and "1 failed" in text


# -- baselines --


def test_sparse_regression_names_what_it_is_shown():
    rng = np.random.default_rng(0)
    shape = (40, 250)
    s = {n: np.cumsum(rng.normal(size=shape), axis=1) for n in ("u", "v", "a", "F")}
    s["v"] *= 1e-3
    s["F"] *= 30
    s["time"] = np.arange(np.prod(shape)).reshape(shape) * 1e-3
    s["x"] = 0.01 * np.sin(s["time"])
    s["P_a1 + P_a2"] = 14e6 + 1e5 * s["u"]
    s["P_a1 - P_a2"] = 2e5 * s["a"]
    columns = regressors(s)
    noise = np.array([9e3, 9e3, 2.5])
    residual = rng.normal(size=(3, *shape))
    assert sparse(residual, columns, noise)["named"] == []
    assert not whiteness(residual)["flag"]
    (column,) = columns["payload_inertia"]
    shown = residual + np.stack(column) / np.std(column[2])
    assert sparse(shown, columns, noise)["named"] == ["payload_inertia"]
    assert whiteness(shown)["flag"]
