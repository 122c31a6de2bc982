"""Tuned gains on an independent plant: `python -m benchmarks.gains FOLDER`.

FOLDER is one of `hydrojax tune` on the reference rig. The plant is the one of
`benchmarks.trace`, in NumPy, its piston led by a stiff servo along the motion; the law
is the package's own. Printed are, for the gains before and after, the rig itself and
the worst of the plants: what runs in the package give, and what the other plant gives.
Then, by their largest live eigenvalue, loops that the adaptation makes oscillate.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.trace.excitation import NOISE, TICK
from benchmarks.trace.plant import Lane, Plant
from benchmarks.trace.sensors import Sensors
from benchmarks.trace.valve import Valve
from hydrojax.control.base import Measured
from hydrojax.jax_setup import LOOPS, set_up_jax, user_cache
from hydrojax.paper.records import reference
from hydrojax.rigfile.quantities import open_setting, quantities
from hydrojax.tune import linearize, trials, verification
from hydrojax.tune.aims import TOLERANCE, Limits
from hydrojax.tune.ensemble import ensemble, with_unsaid
from hydrojax.tune.free import default_free
from hydrojax.tune.objective import Objective
from hydrojax.tune.programs import Rows, setting_at

SUBSTEPS, PLANTS = 20, 8
STIFF = 5000.0
"""Of the servo that leads the piston, rad/s: a hundred times as stiff as the oil."""


def objective() -> Objective:
    """The reference rig and its ensemble, as `tune` has them by default."""
    spec, _ = reference()
    setting = open_setting(spec)
    known = quantities(spec, setting)
    given = {*spec.effects, *spec.parameters}
    plants = with_unsaid(setting, ensemble(setting, PLANTS), given)
    free = [known[n] for n in default_free(setting)]
    return Objective(setting, free, plants, Limits())


def _lane(o: Objective, row: np.ndarray) -> Lane:
    """The plant of a row of parameters in the other plant's words."""
    spec, _ = reference()
    rig = {n: e.start for n, e in spec.parameters.items()}
    rig |= {n: float(v) for n, v in zip(o.names, row, strict=True) if "." not in n}
    area = spec.geometry["area"]
    rig |= {"area_1": area, "area_2": area, "P_r": spec.supply["P_r"]}
    rig |= {n: spec.geometry[n] for n in ("chamber_length", "radius")}
    own = dict(zip(o.names, row, strict=True))
    effects = {
        "valve_lag": {"omega": 1 / own["valve_lag.tau"], "zeta": 0.7},
        "valve_delay": {"tau_u": own["valve_delay.tau_u"]},
    }
    return Lane(rig, rig, effects)


def simulate(
    o: Objective, rows: Rows, which: np.ndarray, lanes: list[Lane]
) -> np.ndarray:
    """The other plant's force [L, N] in the objective's trials, on these lanes."""
    h, n, count = TICK / SUBSTEPS, o.trials.F_d.shape[1], len(lanes)
    laws = [
        setting_at(o.setting, o.free, o.names, g, p, 0.0).loop.law
        for g, p in zip(rows.gains, rows.plant, strict=True)
    ]
    law = jax.tree.map(lambda *a: jnp.stack(a), *laws)
    step = jax.jit(jax.vmap(lambda c, m, y, F: c.step(m, y, F, TICK)[:2]))
    wanted = o.trials.F_d[which].T
    e = o.trials.scenarios.environment
    x = np.asarray(e.x)[which][:, :, 0, 0].T
    plant = Plant(lanes, h)
    plant.K, plant.D = plant.mass * STIFF**2, 1.4 * plant.mass * STIFF
    valve = Valve(plant.e, n, SUBSTEPS, h)
    sensors = Sensors(plant.e, h, np.zeros((4, count)))
    v = np.gradient(x, TICK, axis=0)
    servo = plant.K * x + plant.D * v + plant.mass * np.gradient(v, TICK, axis=0)
    P_s = float(o.setting.P_s)
    first = wanted[0] * (1 + 0.7 / (1 + plant.r["delta"] * np.abs(wanted[0])))
    half = np.full(count, P_s / 2)
    plant.start(x[0], v[0], np.stack([half, first / plant.area[1] + half]))
    cell, a, a_p = plant.forces(0.0, np.zeros(count), servo[0])
    sensors.start(np.stack([*plant.P, cell]))
    noise = np.moveaxis(np.asarray(o.trials.scenarios.noise)[which], 0, -1)
    noise = noise * np.array(list(NOISE.values()))[:, None]
    mark, radius = 2 * np.pi / 2**23, plant.r["radius"]
    memory, out = None, np.empty((n, count))
    for k in range(n):
        P_1, P_2, F = sensors.reading(k * TICK)
        out[k] = cell
        psi = np.round(plant.encoder / radius / mark) * mark
        p = np.stack([P_1, P_2, np.full(count, P_s), F]) + noise[k]
        read = Measured(*map(jnp.asarray, p), x=jnp.asarray(radius * psi))
        F_d = jnp.asarray(wanted[k])
        if memory is None:
            memory = jax.vmap(lambda c, y, F: c.init(y, F))(law, read, F_d)
        memory, u = step(law, memory, read, F_d)
        g = plant.conductances(k * TICK, valve.edges(valve.openings(k, np.asarray(u))))
        after = servo[min(k + 1, n - 1)]
        for j in range(SUBSTEPS):
            plant.advance(a, a_p, np.full(count, P_s), g[j])
            push = servo[k] + (j + 1) / SUBSTEPS * (after - servo[k])
            cell, a, a_p = plant.forces(k * TICK, np.zeros(count), push)
            sensors.follow(np.stack([*plant.P, cell]))
    return out.T


def bands(o: Objective, F: np.ndarray) -> np.ndarray:
    """Bands within 1 dB, to a lag of 90 degrees and of following, Hz, [3, L].

    Of the forces of all trials [trials, L, N]; the worse of both amplitudes.
    """
    found = []
    for k in (trials.RESPONSE, trials.RESPONSE_SMALL):
        H = trials.response_of(o.trials, k, F[k])
        found.append(verification.bands(o.trials.given.hertz, H, TOLERANCE)[:3])
    return np.min(found, axis=0)


def promises(o: Objective, folder: Path) -> None:
    """Promised and measured, before and after."""
    made = json.loads((folder / "tune.json").read_text())["gains"]
    after = np.array([made[q.name] for q in o.free])
    runs = range(trials.MOVING + 1)
    heads = ("rig", "other", "worst", "other")
    print(f"{'gains':8}{'figure':26}" + "".join(f"{head:>10}" for head in heads))
    for title, gains in (("before", o.initial()), ("after", after)):
        ours = verification.run_trials(o, [gains], 450.0)[0]
        rows = o.rows(gains, (0.0,) * len(runs))
        lanes = [_lane(o, row) for row in rows.plant]
        F = simulate(o, rows, np.repeat(runs, PLANTS), lanes)
        F = F.reshape(len(runs), PLANTS, -1)
        within, lag, follows = bands(o, F)
        moving = trials.rms_error(o.trials, trials.MOVING, F[trials.MOVING])
        for name, mine, his, worst in (
            ("follows to, Hz", ours.follows_to, follows, np.min),
            ("within 1 dB, Hz", ours.within_1dB, within, np.min),
            ("lag of 90 degrees, Hz", ours.lag_90, lag, np.min),
            ("error moving, N RMS", ours.rms_moving, moving, np.max),
        ):
            figures = (mine[0], his[0], worst(mine), worst(his))
            print(f"{title:8}{name:26}" + "".join(f"{f:10.2f}" for f in figures))


def oscillations(o: Objective) -> None:
    """Live eigenvalues beside runs of both plants: 3 cm/s, 300 N."""
    names, cases = [q.name for q in o.free], []
    rates = np.array([n.startswith(("rho", "c_")) for n in names])
    for hertz in (55.0, 100.0):
        for share in (0.2, 0.4, 0.7):
            for speed in (1.0, 0.01, 0.0):
                g, p = o.initial(), o.values[0].copy()
                g[:2] *= share
                g[rates] *= speed
                p[o.names.index("valve_lag.tau")] = 1 / (2 * np.pi * hertz)
                cases.append(((hertz, share, speed), g, p))
    gains, plant = (np.array([c[i] for c in cases]) for i in (1, 2))
    rows = Rows(gains, plant, np.full(len(cases), trials.SPEED))
    systems = o.programs.systems(o.setting, rows, o.programs.settle(o.setting, rows))
    largest = linearize.largest_eigenvalue(systems)
    which = np.full(len(cases), trials.MOVING)
    F = o.programs.runs(o.setting, rows, which, o.trials.scenarios)[..., 0]
    mine, theirs = (
        trials.oscillation(o.trials, trials.MOVING, each, TICK)
        for each in (F, simulate(o, rows, which, [_lane(o, p) for p in plant]))
    )
    print(
        "\nspool, Hz  gains  rates  eigenvalue  oscillation, N RMS: package     other"
    )
    for (label, _, _), value, a, b in zip(cases, largest, mine, theirs, strict=True):
        hertz, share, speed = label
        print(f"{hertz:9g}{share:7g}{speed:7g}{value:12.4f}{a:28.1f}{b:10.1f}")


def main(folder: str) -> None:
    """Both tables."""
    set_up_jax(user_cache(), LOOPS)
    o = objective()
    with np.errstate(all="ignore"):
        promises(o, Path(folder))
        oscillations(o)


if __name__ == "__main__":
    main(sys.argv[1])
