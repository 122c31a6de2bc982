"""The controllers that the adaptive law is compared with, and its safeguards."""

from __future__ import annotations

from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from hydrojax import cli
from hydrojax.control.adaptive import Law, Safeguards
from hydrojax.control.base import RATES, Measured
from hydrojax.control.baselines import (
    BacksteppingController,
    LinearizingController,
    PIController,
)
from hydrojax.errors import InputError
from hydrojax.paper import experiments
from hydrojax.rigfile.build import build_loop
from hydrojax.rigfile.json_schema import rig_schema
from hydrojax.rigfile.other_controllers import with_controller
from hydrojax.rigfile.quantities import open_setting, quantities
from hydrojax.rigfile.schema import RigFile

RIG = Path(experiments.__file__).with_name("reference.toml")
H = jnp.asarray(1e-3)


@pytest.fixture(scope="module")
def file() -> RigFile:
    return RigFile.load(RIG)


@pytest.fixture(scope="module")
def law(file) -> Law:
    return build_loop(file).law


def seen(**other) -> Measured:
    at = {"P_a1": 6e6, "P_a2": 7e6, "P_s": 14e6, "F": 900.0, "x": 0.01} | other
    return Measured(**{k: jnp.asarray(v) for k, v in at.items()})


def walk(law, F_d, forces):
    """Memories and commands while the force reads as given, the piston moving."""
    now = seen()
    memory = law.init(now, jnp.asarray(F_d))
    out = []
    step = eqx.filter_jit(law.step)
    for i, F in enumerate(forces):
        now = seen(F=F, x=0.01 + 2e-5 * i)
        memory, u, _ = step(memory, now, jnp.asarray(F_d), H)
        out.append((memory, float(u)))
    return out


def guarded(law: Law, **values: float) -> Law:
    made = Safeguards(**{k: jnp.asarray(v) for k, v in values.items()})
    fields = {name: getattr(law, name) for name in Law.__dataclass_fields__}
    return Law(**{**fields, "safeguards": made})


FORCES = 900.0 + 150.0 * np.sin(np.arange(60) / 7)


def test_safeguards_do_nothing_at_their_defaults(law):
    plain, same = walk(law, 1000.0, FORCES), walk(guarded(law), 1000.0, FORCES)
    for (a, u), (b, w) in zip(plain, same, strict=True):
        assert u == pytest.approx(w, rel=1e-13)
        assert np.allclose(a.estimates, b.estimates, rtol=1e-13, atol=0)
    moved = np.array(plain[-1][0].estimates) != np.array(plain[0][0].estimates)
    assert moved.sum() >= 4  # else nothing was compared


def test_leakage_returns_the_estimates_midway_exponentially(law):
    law = guarded(law, leakage=3.0, dead_zone=1e9)  # nothing is learnt
    now = seen()
    memory = law.init(now, jnp.asarray(1000.0))
    middle = np.array(memory.estimates)
    off = np.array(law.upper) - middle
    memory = memory._replace(estimates=type(memory.estimates)(*(middle + off)))
    for _ in range(200):
        memory, _, _ = law.step(memory, now, jnp.asarray(1000.0), H)
    want = middle + off * np.exp(-3.0 * 0.2)
    assert np.allclose(memory.estimates, want, rtol=1e-10)


def test_a_dead_zone_takes_its_width_off_the_error():
    guard = Safeguards(dead_zone=jnp.asarray(20.0))
    errors = np.array([-50.0, -20.0, -3.0, 0.0, 19.0, 70.0])
    assert np.array_equal(guard.error(errors), [-30.0, 0.0, 0.0, 0.0, 0.0, 50.0])


@pytest.mark.parametrize("left", [0.0, 0.25])
def test_what_is_learnt_while_the_command_saturates(law, left):
    """With a saturated command, that share of what the paper's law learns."""
    tight = guarded(law, saturated=left)
    small = [
        type(law)(**{
            **{n: getattr(one, n) for n in Law.__dataclass_fields__},
            "u_max": jnp.asarray(1e-6),
        })
        for one in (law, tight)
    ]  # fmt: skip
    first, other = (walk(one, 1000.0, [700.0]) for one in small)
    start = np.array(law.init(seen(), jnp.asarray(1000.0)).estimates)
    gone = np.array(first[0][0].estimates) - start
    assert abs(first[0][1]) == 1e-6 and np.count_nonzero(gone) >= 1
    less = np.array(other[0][0].estimates) - start
    assert np.allclose(less, left * gone, rtol=1e-9, atol=1e-25)


def test_a_rig_file_gives_safeguards(file):
    text = file.text.replace("[controller]", '[controller]\nleakage = "0.5 1/s"')
    setting = open_setting(file.with_text(text))
    assert float(setting.loop.law.safeguards.leakage) == 0.5
    known = quantities(file, setting)
    other = known["leakage"].put(setting, 2.0)
    assert float(other.loop.law.safeguards.leakage) == 2.0
    assert open_setting(file).loop.law.safeguards is None


def flows(u, now, c, P_r):
    """The orifices by hand: into both chambers, m^3/s."""
    s, r = float(now.P_s), P_r
    p_1, p_2 = float(now.P_a1), float(now.P_a2)
    if u > 0:
        return u * c["c_p1"] * np.sqrt(s - p_1), -u * c["c_n2"] * np.sqrt(p_2 - r)
    return u * c["c_n1"] * np.sqrt(p_1 - r), -u * c["c_p2"] * np.sqrt(s - p_2)


@pytest.mark.parametrize("F", [700.0, 1300.0])
@pytest.mark.parametrize("v", [0.0, 0.02, -0.03])
def test_the_valves_inverse_makes_the_error_die_at_its_rate(file, F, v):
    """By hand: with this command `F' = k_e (F_d - F)`, whatever the piston does."""
    loop = build_loop(with_controller(file, "linearizing"))
    law, n = loop.law, loop.law.nominal
    assert isinstance(law, LinearizingController)
    before = seen(F=F)
    memory = (before.x - v * float(H), jnp.asarray(v))  # the filter has settled
    _, u, _ = law.step(memory, before, jnp.asarray(1000.0), H)
    c = {k: float(getattr(n.valve, k)) for k in ("c_p1", "c_n1", "c_p2", "c_n2")}
    q_1, q_2 = flows(float(u), before, c, float(law.P_r))
    A, beta = float(n.chambers.area_1), float(n.chambers.beta)
    x_1, x_2 = (float(x) for x in n.chambers.lengths(before.x))
    # The chamber of P_a1 shortens as x grows.
    P_1 = beta * (q_1 + A * v) / (A * x_1)
    P_2 = beta * (q_2 - A * v) / (A * x_2)
    assert pytest.approx(float(law.k_e) * (1000.0 - F), rel=1e-6) == A * (P_2 - P_1)


def test_backstepping_brings_a_spool_of_first_order_where_it_is_wanted(file):
    law = build_loop(with_controller(file, "backstepping")).law
    assert isinstance(law, BacksteppingController)
    k_x, tau, h = 80.0, 4e-3, 1e-4
    fields = {n: getattr(law, n) for n in type(law).__dataclass_fields__}
    law = type(law)(**{**fields, "k_x": jnp.asarray(k_x), "tau_s": jnp.asarray(tau)})
    now, F_d = seen(), jnp.asarray(950.0)
    memory = law.init(now, F_d)._replace(spool=jnp.asarray(0.0))
    step = eqx.filter_jit(law.step)
    spool, off = 0.0, []
    for _ in range(400):
        memory, u, signals = step(memory, now, F_d, jnp.asarray(h))
        off.append(float(signals["wanted"]) - spool)
        spool += (float(u) - spool) * (1 - np.exp(-h / tau))  # the plant's own
    t = h * np.arange(400)
    assert off[0] != 0
    assert np.allclose(off, off[0] * np.exp(-k_x * t), atol=0.02 * abs(off[0]))


def test_pi_feeds_the_velocity_forward(file):
    law = build_loop(with_controller(file, "pi")).law
    assert isinstance(law, PIController)
    still = walk(law, 900.0, [900.0])[0][1]
    memory = law.init(seen(), jnp.asarray(900.0))
    now = seen(x=0.01 + 2e-5)
    memory, u, signals = law.step(memory, now, jnp.asarray(900.0), H)
    v = 2e-5 / (float(law.tau_v) + 1e-3)
    assert still == 0.0 and float(signals["v"]) == pytest.approx(v)
    assert float(u) == pytest.approx(-float(law.k_v) * v)
    # Oil is taken out of the chamber that shortens: the valve passes about what the
    # piston sweeps, with the pressures midway.
    loop = build_loop(file)
    c = {k: float(getattr(loop.rig.valve, k)) for k in ("c_p1", "c_n1", "c_p2", "c_n2")}
    at = seen(P_a1=7.1e6, P_a2=7.1e6)
    swept = float(loop.rig.chambers.area_1) * 0.01
    q_1, q_2 = flows(-float(law.k_v) * 0.01, at, c, 0.2e6)
    assert q_1 == pytest.approx(-swept, rel=0.1) and q_2 == pytest.approx(
        swept, rel=0.1
    )


def test_a_rig_file_names_its_controller(file):
    pi = with_controller(file, "pi")
    assert pi.controller["kind"] == "pi" and "k_f" not in pi.controller
    assert pi.controller.get("rate") == file.controller.get("rate")
    assert with_controller(pi, "pi") is pi and with_controller(file, "") is file
    text = pi.text.replace('kind = "pi"', 'kind = "pi"\nk_p = "3e-4 V/N"')
    given = pi.with_text(text)
    assert float(build_loop(given).law.k_p) == 3e-4
    assert float(build_loop(given, None, {"k_p": "1 mV/N"}).law.k_p) == 1e-3
    fixed = build_loop(with_controller(file, "fixed")).law
    assert isinstance(fixed, Law) and all(float(r) == 0 for r in fixed.rate)
    assert len(fixed.rate) == len(RATES)
    with pytest.raises(InputError, match="unknown controller 'pid'; did you mean 'pi'"):
        with_controller(file, "pid")
    with pytest.raises(InputError, match="kind: unknown controller 'PI'"):
        build_loop(pi.with_text(pi.text.replace('"pi"', '"PI"')))
    with pytest.raises(InputError, match="unknown gain 'k_q'"):
        build_loop(pi.with_text(text.replace("k_p =", "k_q =")))
    schema = rig_schema()["properties"]["controller"]["properties"]
    assert "backstepping" in schema["kind"]["enum"] and "k_x" in schema


def test_a_rig_file_of_ones_own_stays(tmp_path, monkeypatch, capsys):
    (tmp_path / "pi").mkdir()
    (tmp_path / "pi" / "rig.toml").write_text("# mine\n")
    words = f"hydrojax tune {RIG} --controller fixed pi --out {tmp_path}"
    monkeypatch.setattr("sys.argv", words.split())
    with pytest.raises(SystemExit) as end:
        cli.main()
    said = capsys.readouterr().err.strip()
    assert end.value.code == 2 and said.count("\n") == 0 and "pi/rig.toml" in said
    assert (tmp_path / "pi" / "rig.toml").read_text() == "# mine\n"
    assert not (tmp_path / "fixed").exists()
