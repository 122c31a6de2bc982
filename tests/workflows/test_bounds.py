"""Friction bounds: the box's coverage, its refinement through the loop, the command."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hydrojax import cli
from hydrojax.control.simulation import make_scenario
from hydrojax.control.waveforms import sinusoidal_path
from hydrojax.identify.estimation.box import FrictionStretch, smallest_box
from hydrojax.paper.records import reference
from hydrojax.parameters import put
from hydrojax.rigfile.build import build_loop
from hydrojax.tune.refine import (
    Plants,
    refine,
    tracking_errors,
    under_model_error,
    with_bounds,
)

NAMES = ("k_cp", "k_cn", "k_0")
WIDE = [(-1e6, 1e6)] * 3


def fits(rng, count, mean, between, own):
    """Stretches of a friction that varies by `between` and is measured within `own`."""
    root, noise = np.linalg.cholesky(between), np.linalg.cholesky(own)
    for _ in range(count):
        theta = mean + root @ rng.normal(size=3) + noise @ rng.normal(size=3)
        yield FrictionStretch("log", 0.0, 2.0, theta, own)


def test_the_box_holds_the_next_stretch_as_often_as_it_says():
    """Coverage over 300 sets of ten stretches, of a truth that took no part."""
    rng = np.random.default_rng(3)
    mean = np.array([900.0, 700.0, 50.0])
    between = np.array([[1600.0, 900, 0], [900, 2500, -100], [0, -100, 400]])
    own = np.diag([100.0, 64.0, 36.0])
    inside = 0
    for _ in range(300):
        box = smallest_box(NAMES, list(fits(rng, 10, mean, between, own)), 0.9, WIDE)
        new = mean + np.linalg.cholesky(between) @ rng.normal(size=3)
        inside += bool(np.all((new >= box.lower) & (new <= box.upper)))
    # Three standard deviations of a share of 0.9 out of 300 are 0.052.
    assert 0.9 - 0.052 < inside / 300 < 0.9 + 0.052


def test_noise_alone_makes_no_wide_box():
    """What is only uncertainty of the single stretch shrinks with their number."""
    rng = np.random.default_rng(4)
    mean, own = np.array([900.0, 700.0, 50.0]), np.diag([400.0] * 3)
    still = list(fits(rng, 40, mean, 1e-6 * np.eye(3), own))
    box = smallest_box(NAMES, still, 0.95, WIDE)
    naive = [
        FrictionStretch(f.log, f.start, f.seconds, f.theta, 0 * own) for f in still
    ]
    whole = smallest_box(NAMES, naive, 0.95, WIDE)
    wide, taken = box.upper - box.lower, whole.upper - whole.lower
    assert np.all(wide < 0.8 * taken) and np.median(wide / taken) < 0.6
    assert np.all((mean > box.lower) & (mean < box.upper))


def test_the_box_keeps_inside_what_may_be():
    rng = np.random.default_rng(5)
    few = list(fits(rng, 3, np.zeros(3), 1e4 * np.eye(3), np.eye(3)))
    box = smallest_box(NAMES, few, 0.95, [(0.0, 50.0)] * 3)
    assert np.all(box.lower >= 0) and np.all(box.upper <= 50)


@pytest.fixture(scope="module")
def loop_and_courses():
    spec, rig = reference()
    loop = build_loop(spec, rig)
    t = np.arange(2000) * 1e-3
    F_d = 300 * np.sin(2 * np.pi * 0.7 * t)
    scenarios = [
        make_scenario(F_d, sinusoidal_path(0.03, period), 1e-3, **spec.supply, seed=1)
        for period in (1.0, 1.6)
    ]
    return loop, jax.tree.map(lambda *a: jnp.stack(a), *scenarios)


@pytest.mark.study
def test_refined_bounds_track_better_on_other_plants(loop_and_courses):
    """Bounds far off are mended on two plants; a third, unseen, gains too."""
    loop, scenarios = loop_and_courses
    theta = np.array([[1250.0, 850.0], [1150.0, 950.0]])
    plants = Plants(("k_cp", "k_cn"), theta)
    lower, upper = np.array([300.0, 1200.0]), np.array([700.0, 1600.0])
    limits = [(0.0, 3000.0)] * 2
    found = refine(loop, plants, scenarios, (lower, upper), limits, plants.names)
    assert np.all(found[0] <= lower) and np.all(found[1] >= upper)  # the box is held
    assert np.all(found[0] >= 0) and np.all(found[1] <= 3000)
    other = Plants(("k_cp", "k_cn"), np.array([[1200.0, 900.0]]))

    def error(ends):
        held = with_bounds(loop, other.names, *ends)
        return np.sqrt(np.mean(tracking_errors(held, other, scenarios) ** 2))

    assert error(found) < 0.5 * error((lower, upper))


def test_model_error_leaves_friction_and_stays_within_its_spread(loop_and_courses):
    loop, _ = loop_and_courses
    theta = np.linspace(500.0, 1500.0, 24).reshape(12, 2)
    off = under_model_error(Plants(("k_cp", "k_cn"), theta), loop, spread=0.1)
    assert off.names == ("k_cp", "k_cn", "beta", "c_p1", "c_n1", "c_p2", "c_n2")
    assert np.array_equal(off.values[:, :2], theta)
    own = np.array([8.5e8, 2.24e-9, 2.15e-9, 2.27e-9, 2.11e-9])
    factors = off.values[:, 2:] / own
    assert np.all((factors >= 1 / 1.1) & (factors <= 1.1))
    assert np.all(np.ptp(factors, axis=0) > 0.15)  # spread over all of it


@pytest.mark.slow
def test_tracking_of_a_plant_is_its_run(loop_and_courses):
    """Against the same plant run by itself, its error taken by hand."""
    from hydrojax.control.loop import run

    loop, scenarios = loop_and_courses
    other = put(loop.rig, ("k_cp",), jnp.array([1100.0]))
    import equinox as eqx

    alone = eqx.tree_at(lambda lo: lo.rig, loop, other)
    scenario = jax.tree.map(lambda a: a[1], scenarios)
    F = np.asarray(run(alone, scenario, ("true_F",)))[:, 0]
    off = (np.asarray(scenario.F_d) - F)[500:]
    got = tracking_errors(loop, Plants(("k_cp",), np.array([[1100.0]])), scenarios)
    assert got.shape == (1, 2)
    assert got[0, 1] == pytest.approx(np.sqrt(np.mean(off**2)), rel=1e-9)


def test_the_command_needs_a_range(tmp_path, capsys, monkeypatch):
    from importlib import resources

    rig = resources.files("hydrojax") / "paper" / "reference.toml"
    monkeypatch.chdir(tmp_path)
    main(f"simulate {rig} --seconds 4 --out a.csv", monkeypatch)
    with pytest.raises(SystemExit) as end:
        main(f"bounds {rig} a.csv --out out", monkeypatch)
    assert end.value.code == 2
    said = capsys.readouterr().err.strip()
    assert said.count("\n") == 0 and "range" in said
    assert not (tmp_path / "out").exists()


def main(words, monkeypatch):
    monkeypatch.setattr("sys.argv", ["hydrojax", *words.split()])
    try:
        cli.main()
    except SystemExit as end:
        if end.code not in (0, None):
            raise


@pytest.mark.slow
def test_the_command_writes_a_rig_with_bounds(tmp_path, capsys, monkeypatch):
    """Two logs of the reference rig: the rig written carries bounds that hold it."""
    from importlib import resources

    from hydrojax.rigfile.schema import RigFile

    text = (resources.files("hydrojax") / "paper" / "reference.toml").read_text()
    for name, start, low, high in (("k_cp", 1.1, 0, 3), ("k_cn", 1.0, 0, 3)):
        old = next(x for x in text.splitlines() if x.startswith(f"{name} ="))
        new = f'{name} = {{ start = "{start} kN", range = ["{low} kN", "{high} kN"] }}'
        text = text.replace(old, new, 1)
    (tmp_path / "rig.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    for seed in (1, 2):
        main(
            f"simulate rig.toml --seconds 5 --seed {seed} --out {seed}.csv", monkeypatch
        )
    own = text.replace('k_cp = ["0 kN", "2 kN"]', 'k_cp = ["0.4 kN", "2.9 kN"]', 1)
    (tmp_path / "own.toml").write_text(own)
    none = [x for x in text.splitlines() if not x.startswith(("k_cp = [", "k_cn = ["))]
    (tmp_path / "rig.toml").write_text("\n".join(none))
    main("bounds own.toml 1.csv --validate 2.csv --out own", monkeypatch)
    found = json.loads((tmp_path / "own" / "bounds.json").read_text())
    assert found["bounds"]["rig file"]["k_cp"] == [400.0, 2900.0]
    errors, way = found["tracking_rms_N"]["others"], found["proposed"]
    assert way != "box"
    assert errors[way] == min(errors[w] for w in ("paper", "refined", "rig file"))
    assert "rig file bounds" in capsys.readouterr().out
    main("bounds rig.toml 1.csv --validate 2.csv --out out", monkeypatch)
    new = RigFile.load(tmp_path / "out" / "rig.toml")
    assert len(new.controller["k_cp"]) == 2
    found = json.loads((tmp_path / "out" / "bounds.json").read_text())
    errors, way = found["tracking_rms_N"]["others"], found["proposed"]
    assert way in ("refined", "paper") and errors[way] <= errors["paper"]
    low, high = (
        np.array([v[i] for v in found["bounds"]["box"].values()]) for i in (0, 1)
    )
    wide = np.array(list(found["bounds"]["refined"].values()))
    assert np.all(wide[:, 0] <= low) and np.all(wide[:, 1] >= high)
    assert found["coverage"]["refined"] >= found["coverage"]["box"]
    box = found["bounds"]["box"]
    assert box["k_cp"][0] < 1100 < box["k_cp"][1]  # the logs' rig file says 1.1 kN
    errors = found["tracking_rms_N"]["others"]
    assert errors["refined"] < 1.2 * errors["box"]
    assert (tmp_path / "out" / "bounds.png").stat().st_size > 10_000
