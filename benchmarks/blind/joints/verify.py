"""Proofs that the plant is right: `python -m benchmarks.blind.joints.verify`.

Prints one line per proof, exits 1 where one fails.
"""

import sys
from dataclasses import replace

import numpy as np

from . import rigs
from .effects import OUTSIDE, RIG_NEEDS, TABLE, at_size, draw_effect
from .make import CHANNELS, Absurd, check_sane, draw_run, plant_fields, run, tuned
from .plant import ABSENT, FINE, bulk_modulus, flows

NOT_TO_ZERO = ("hose_dynamics",)  # a hose of vanishing volume is stiff without end
LAGS = (
    "valve_lag",
    "valve_rate_limit",
    "loadcell_lag",
    "pressure_sensor_lag",
)  # taken to 2 %, then below the step
WORST_OF = 1.0 / 20.0  # of a channel's noise


def sane_rig(first, seconds=8.0, **needs):
    """A rig without faults, one log and its fine output; the first that is sensible
    from seed `first` on.
    """
    for seed in range(first, first + 40):
        rig = rigs.draw_rig(seed, **needs)
        if rig.layout == "single" or rig.rate < 500:
            continue
        log = draw_run(np.random.default_rng([seed, 2]), rig, seconds)
        fine, log["u"] = run(rig, rig.plant, log)
        log["closed"] = False
        try:
            check_sane(rig, fine)
        except Absurd:
            continue
        return rig, log, fine
    raise RuntimeError("no sensible rig")


def imposed(rig, log):
    """Time, x, v, a, supply and held command on the fine grid."""
    n = log["u"].size * FINE
    t = np.arange(n) / (rig.rate * FINE)
    i = np.minimum((t / rigs.DT).astype(int), log["knots"].shape[1] - 1)
    s = t - i * rigs.DT
    k = log["knots"][:, i]
    x = ((k[0] * s + k[1]) * s + k[2]) * s + k[3]
    v = (3.0 * k[0] * s + 2.0 * k[1]) * s + k[2]
    a = 6.0 * k[0] * s + 2.0 * k[1]
    return (
        t,
        x,
        v,
        a,
        np.interp(t, np.arange(log["P_s"].size) * rigs.DT, log["P_s"]),
        np.repeat(log["u"], FINE),
    )


def paper_flows(c, u, P_1, P_2, P_s):
    """(12)(13) as printed."""

    def root(p):
        return np.sqrt(np.maximum(p, 0.0))

    Q_1 = np.where(
        u > 0.0, c.c_p1 * root(P_s - P_1) * u, c.c_n1 * root(P_1 - c.P_r) * u
    )
    Q_2 = np.where(
        u > 0.0, -c.c_n2 * root(P_2 - c.P_r) * u, -c.c_p2 * root(P_s - P_2) * u
    )
    return Q_1, Q_2


def between_samples(y, per):
    """Trapezoid sums of `y` (left value, right value given as two columns) added up,
    starting at 0.
    """
    return np.concatenate([[0.0], np.cumsum(0.5 * (y[0] + y[1]) * per)])


def mass_balance(rig, log, fine):
    """Largest gap [noise of a pressure] between the fluid in a chamber and what flowed
    in by the paper's (12)(13).
    """
    c = rig.plant
    t, x, _, _, P_s, u = imposed(rig, log)
    P_1, P_2 = fine[:, 3], fine[:, 4]
    worst = 0.0
    left = paper_flows(c, u[:-1], P_1[:-1], P_2[:-1], P_s[:-1])
    right = paper_flows(c, u[:-1], P_1[1:], P_2[1:], P_s[1:])
    volumes = (
        c.area_1 * (0.5 * c.length + c.delta_1 - x),
        c.area_2 * (0.5 * c.length + c.delta_2 + x),
    )
    for P, V, q_0, q_1, channel in zip(
        (P_1, P_2), volumes, left, right, CHANNELS[:2], strict=True
    ):
        rho = np.exp(P / c.beta)
        entered = between_samples((rho[:-1] * q_0, rho[1:] * q_1), t[1])
        gap = (rho * V - (rho * V)[0] - entered) * c.beta / (rho * V)
        worst = max(
            worst,
            float(np.abs(gap[:: rig.rate * FINE // 4]).max())
            / rigs.total_noise(rig, channel),
        )
    return worst


def energy_balance(rig, log, fine):
    """Relative gap between the work of flows, of the piston, and what the fluid stores;
    least valve loss [W].
    """
    c = rig.plant
    t, x, v, _, P_s, u = imposed(rig, log)
    P = fine[:, 3:]
    V = np.column_stack(
        [
            c.area_1 * (0.5 * c.length + c.delta_1 - x),
            c.area_2 * (0.5 * c.length + c.delta_2 + x),
        ]
    )
    drive = c.area_2 * P[:, 1] - c.area_1 * P[:, 0]
    Q = np.column_stack(paper_flows(c, u, P[:, 0], P[:, 1], P_s))
    Q_end = np.column_stack(paper_flows(c, u[:-1], P[1:, 0], P[1:, 1], P_s[1:]))
    flow_work = np.sum(0.5 * ((P * Q)[:-1] + P[1:] * Q_end)) * t[1]
    piston_work = np.sum(0.5 * ((drive * v)[:-1] + (drive * v)[1:])) * t[1]
    stored = np.sum(0.5 * ((P * V)[:-1] + (P * V)[1:]) * np.diff(P, axis=0)) / c.beta
    gross = np.sum(np.abs(P * Q)) * t[1]
    inlet = np.where(Q > 0.0, P_s[:, None] - P, P - c.P_r)
    return abs(flow_work - piston_work - stored) / gross, float(
        np.min(inlet * np.abs(Q))
    )


def force_balance(rig, log, fine):
    """Largest gap [N] in (22): friction recomputed from (3)-(7) with the bristles in
    closed form.
    """
    c = rig.plant
    t, _, v, _, _, _ = imposed(rig, log)
    dt = t[1]
    z, speed = np.zeros(t.size), np.zeros(t.size)
    middle = 0.5 * (v[1:] + v[:-1])
    for i, w in enumerate(middle):
        decay = np.exp(-abs(w) * dt / c.z_ss)
        z[i + 1] = z[i] * decay + np.sign(w) * c.z_ss * (1.0 - decay)
        speed[i + 1] = speed[i] * np.exp(-10.0 * dt) + abs(w) * (
            1.0 - np.exp(-10.0 * dt)
        )
    gate = 1.0 / (1.0 + (300.0 * speed) ** 3)
    g = np.clip(z / c.z_ss, -1.0, 1.0)
    f_c = (
        np.where(g > 0.0, c.k_cp, c.k_cn) * g
        + c.k_0
        - np.where(v > 0.0, c.k_vp, c.k_vn) * v
    )
    F = fine[:, 2]
    f_s = np.where(F > 0.0, c.k_fp, c.k_fn) * F / (1.0 + c.delta * np.abs(F))
    P = c.area_2 * fine[:, 4] - c.area_1 * fine[:, 3]
    return float(np.abs(P - (1.0 - gate) * f_c - gate * f_s - F).max())


def halved_step(rig, log):
    """Largest change of a pressure, and RMS change of F, in their noise, when the step
    is halved: the whole log.
    """
    fine, _ = run(rig, rig.plant, log)
    finer, _ = run(rig, rig.plant, log, step=0.5 * rigs.STEP)
    noise = [rigs.total_noise(rig, channel) for channel in CHANNELS]
    off = np.abs(fine[::FINE, :3] - finer[::FINE, :3]) / noise
    return float(off[:, :2].max()), float(np.sqrt(np.mean(off[:, 2] ** 2)))


def effect_proofs(name):
    """Bitwise absence; change near absence over change at the largest, over the share;
    halved step [noise].
    """
    needs = {k: v for k, v in RIG_NEEDS.get(name, {}).items() if k != "two"}
    rig, log, fine = sane_rig(300, 4.0, layout="pull-pull", **needs)
    effect = draw_effect(np.random.default_rng(5), name, rig)
    fields = plant_fields(at_size(effect, 1.0, rig.plant))
    own = {k: ABSENT.get(k, getattr(rig.plant, k)) for k in fields}
    same, _ = run(rig, rig.plant._replace(**own), log)
    noise = np.array([rigs.total_noise(rig, channel) for channel in CHANNELS])
    hold = fine[::FINE, 3:]
    none, _ = run(rig, rig.plant, log, hold)

    def moved(share):
        there, _ = run(
            rig,
            rig.plant._replace(**plant_fields(at_size(effect, share, rig.plant))),
            log,
            hold,
        )
        return float(
            (np.sqrt(np.mean((there - none)[::FINE, :3] ** 2, axis=0)) / noise).max()
        )

    share = 0.02 if name in LAGS else 1e-3
    top = moved(1.0)
    steep = 0.0 if name in NOT_TO_ZERO or top == 0.0 else moved(share) / (share * top)
    rig = tuned(replace(rig, plant=rig.plant._replace(**fields)))
    own_log = {**log, "u": np.zeros_like(log["u"]), "closed": True}
    _, own_log["u"] = run(rig, rig.plant, own_log)
    own_log["closed"] = False
    return bool(np.array_equal(same, fine)), top, steep, halved_step(rig, own_log)


def main():
    """Run every proof."""
    bad = 0

    def say(proof, good, text):
        nonlocal bad
        bad += not good
        print(f"{'ok  ' if good else 'FAIL'} {proof}: {text}", flush=True)

    for first in (200, 220, 240):
        rig, log, fine = sane_rig(first)
        where = f"{rig.layout}, {rig.rate} Hz"
        gap = mass_balance(rig, log, fine)
        say(
            "mass balance",
            gap < WORST_OF,
            f"{gap:.4f} of the noise after 8 s ({where})",
        )
        energy, loss = energy_balance(rig, log, fine)
        good = energy < 1e-4 and loss > -1.0
        say(
            "energy",
            good,
            f"gap {energy:.1e} of the throughput, least valve loss {loss:.2g} W",
        )
        gap = force_balance(rig, log, fine)
        say(
            "force balance",
            gap < 1.0,
            f"largest gap {gap:.3f} N, noise {rig.noise['F']:.1f} N",
        )
        P, F = halved_step(rig, log)
        say(
            "half the step", P < WORST_OF, f"{P:.1e} of the pressures' noise, F {F:.1e}"
        )
        c = rig.plant
        odd = flows(c, 1.0, 0.4 * rig.P_s, 0.6 * rig.P_s, rig.P_s)
        exact = paper_flows(c, 1.0, 0.4 * rig.P_s, 0.6 * rig.P_s, rig.P_s)
        off = max(abs(a / b - 1.0) for a, b in zip(odd, exact, strict=True))
        say("paper's law", off < 1e-6, f"flows within {off:.1e} of (12)(13)")
        say("bulk modulus", bulk_modulus(c, 1e6, 3.0) == c.beta, "constant without air")
    for name in TABLE + OUTSIDE:
        same, top, steep, (P, F) = effect_proofs(name)
        say(
            name,
            same and steep < 10.0 and P < WORST_OF,
            f"absent {'bitwise' if same else 'NOT'}, {top:.3g} of the noise at its "
            "largest, slope at absence over "
            f"mean slope {steep:.2f}, half the step {P:.1e}, F {F:.1e}",
        )
    print("all proofs hold" if not bad else f"{bad} proofs fail")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
