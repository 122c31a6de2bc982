"""Draws cases and writes their rig files and logs; the truth is returned.

A case's folder mNN holds rig.toml, fit_1.csv, fit_2.csv and validate.csv.
"""

import numpy as np
from scipy.signal import savgol_filter

from .effects import ALL, OUTSIDE, TABLE
from .plant import FIELDS
from .rigs import (
    RECORD_RATE,
    STEP_RATE,
    declared_parameters,
    draw_machine,
    plan,
    replay,
    rig_file,
    simulate,
    true_parameters,
)
from .sensors import DEFAULT, channels, measured

KINDS = ["nothing"] * 3 + ["one"] * 7 + ["several"] * 6 + ["outside"] * 4
WINDOW = 0.25  # s
SIZED = 30  # s of the validation log on which sizes are reckoned
SENSOR_EFFECTS = (
    "pressure_sensor_bias",
    "pressure_sensor_lag",
    "signal_filter",
    "channel_skew",
)
DECLARED_FIELDS = {
    "valve_deadband": ("o_p1", "o_p2"),
    "valve_delay": ("tau_u",),
    "valve_lag": ("omega_v", "zeta_v"),
    "entrained_air": ("alpha",),
}
LOGS = ("fit_1", "fit_2", "validate")


class Unusable(Exception):
    """The drawn machine leaves the range of what is realistic."""


def kind_of(case):
    """Kind of a case, and how many of that kind went before it."""
    block = [
        list(np.random.default_rng(7100 + b).permutation(KINDS))
        for b in range(case // 20 + 1)
    ]
    deck = [str(k) for row in block for k in row]
    return deck[case], deck[:case].count(deck[case])


def choose(case, rng):
    """Kind of a case and the effects that it leaves out."""
    kind, before = kind_of(case)
    order = np.random.default_rng(4242)
    single, outside = (
        order.permutation([e.name for e in TABLE]),
        order.permutation([e.name for e in OUTSIDE]),
    )
    if kind == "nothing":
        return kind, []
    if kind == "one":
        return kind, [ALL[single[before % len(single)]]]
    if kind == "outside":
        return kind, [ALL[outside[before % len(outside)]]]
    chosen = []
    count = int(rng.integers(2, 5))
    for name in rng.permutation([e.name for e in TABLE]):
        e = ALL[str(name)]
        clash = any(e.name in c.excludes or c.name in e.excludes for c in chosen)
        wanted = chosen + [e]
        contradict = any(c.needs_level for c in wanted) and any(
            c.needs_weight for c in wanted
        )
        if not clash and not contradict:
            chosen.append(e)
        if len(chosen) == count:
            return kind, chosen
    return kind, chosen


def run_logs(machine, plans):
    """Simulate the logs; raise Unusable where pressures or stroke leave the realistic
    range.
    """
    runs = []
    for command, x_ref, weight in reversed(plans):
        record, motion, u = simulate(machine, command, x_ref, True, weight=weight)
        stroke = machine.plant["stroke"]
        top = 1.7 * machine.plant["P_src"] + 1e7
        fine = (
            np.isfinite(record).all()
            and record[:, :2].min() > 1e5
            and record[:, :2].max() < top
        )
        if (
            not fine
            or np.abs(record[:, 3]).max() > 0.48 * stroke
            or np.ptp(record[:, 3]) < 0.075 * stroke
        ):
            raise Unusable
        runs.insert(0, (record, motion, u, weight))
    return runs


def noise_of(machine):
    """Standard deviation of each channel's noise, rounding included."""
    return {
        k: float(np.hypot(machine.noise[k], machine.resolution[k] / np.sqrt(12)))
        for k in machine.noise
    }


def predicted(machine):
    """Channels that a replay predicts."""
    return ["P_a1", "P_a2"] + (["F"] if machine.has_force else [])


def without(machine, drawn):
    """Plant fields and sensor settings with one effect taken out."""
    rig = ("c_p1", "c_n1", "c_p2", "c_n2", "delta_1", "delta_2")
    plant = {**machine.plant, **{k: FIELDS[k] for k in drawn.plant if k not in rig}}
    if "b" in drawn.plant:
        plant["b"] = 0.0
    return plant, {**machine.sensor, **{k: DEFAULT[k] for k in drawn.sensor}}


def restarts(record, machine, use_measured):
    """True, or noise-free measured, pressures at the start of each window."""
    if not use_measured:
        return record[:: int(WINDOW * RECORD_RATE), :2].copy()
    logged = channels(record, RECORD_RATE, 1, machine.sensor)
    step = int(WINDOW * RECORD_RATE)
    return np.column_stack([logged["P_a1"][::step], logged["P_a2"][::step]])


def logged_matrix(record, machine, sensor, names):
    """Noise-free logged channels, in units of their noise, as one row per channel."""
    every = RECORD_RATE // machine.rate
    noise = noise_of(machine)
    logged = channels(record, RECORD_RATE, every, sensor)
    return np.array([logged[n] / noise[n] for n in names])


def imposed_motion(machine, motion, sensor):
    """The motion as a replay gets it: skewed where the log's x is skewed."""
    if sensor["skew_channel"] != "x":
        return motion
    t = np.arange(len(motion)) / STEP_RATE
    return np.column_stack(
        [np.interp(t + sensor["skew_tau"], t, column) for column in motion.T[:3]]
        + [motion[:, 3]]
    )


def rounded(values):
    """Numbers to four digits."""
    return [float(f"{v:.4g}") for v in values]


def cropped(machine, run_):
    """The first SIZED seconds of a run."""
    record, motion, u, weight = run_
    return (
        record[: SIZED * RECORD_RATE + 1],
        motion[: SIZED * STEP_RATE + 1],
        u[: SIZED * machine.rate + 1],
        weight,
    )


def sizes(machine, run_, drawn, is_sensor, refit):
    """Size of an effect at each channel, in noise: as it stands, or what is left after
    the best linear refit.

    The replay without the effect has the same motion imposed, and starts anew every
    0.25 s from the true pressures (from the measured ones where the effect is in a
    sensor). The refit shifts the rig's parameters and those of the declared effects on
    this very log, to first order.
    """
    record, motion, u, weight = cropped(machine, run_)
    names = predicted(machine)
    plant, sensor = without(machine, drawn)
    truth = logged_matrix(record, machine, machine.sensor, names)
    start = restarts(record, machine, is_sensor)
    path = (
        imposed_motion(machine, motion, {**DEFAULT, **machine.sensor})
        if is_sensor
        else motion
    )

    def response(values):
        return logged_matrix(
            replay(values, machine, u, path, start, weight), machine, sensor, names
        )

    base = response(plant)
    error = truth - base
    if not refit:
        return dict(zip(names, rounded(np.sqrt((error**2).mean(1))), strict=True))
    keys = ["beta", "c_p1", "c_n1", "c_p2", "c_n2"]
    if "V_0" not in drawn.plant:
        keys += ["delta_1", "delta_2"]
    if machine.has_force:
        keys += ["k_c", "k_0"] + (["b"] if "b" not in drawn.plant else [])
    for name in machine.declared:
        keys += [k for k in DECLARED_FIELDS[name] if k not in drawn.plant]
    columns = []
    for key in keys:
        step = 0.02 * abs(plant[key]) if plant[key] else 1.0
        columns.append(
            (
                (response({**plant, key: plant[key] + step}) - base)
                / step
                * abs(plant[key] or 1.0)
            ).ravel()
        )
    a = np.array(columns).T
    left = (
        error.ravel() - a @ np.linalg.lstsq(a, error.ravel(), rcond=1e-9)[0]
    ).reshape(error.shape)
    return dict(zip(names, rounded(np.sqrt((left**2).mean(1))), strict=True))


def floor(machine, run_, log):
    """RMS of the true plant replayed from the log's own x and P_s against the log (SI),
    window means taken out.
    """
    record, _, u, weight = run_
    names = predicted(machine)
    rate = machine.rate
    t, fine = (
        np.arange(u.size) / rate,
        np.arange((u.size - 1) * (STEP_RATE // rate) + 1) / STEP_RATE,
    )
    width = max(int(0.06 * rate) // 2 * 2 + 1, 5)
    fits = [
        np.asarray(savgol_filter(log["x"], width, 3, deriv=d, delta=1 / rate))
        for d in (0, 1, 2)
    ]
    motion = np.column_stack(
        [np.interp(fine, t, f) for f in fits] + [np.interp(fine, t, log["P_s"])]
    )
    step = int(WINDOW * RECORD_RATE)
    out = replay(machine.plant, machine, u, motion, record[::step, :2].copy(), weight)
    logged = channels(out, RECORD_RATE, RECORD_RATE // rate, machine.sensor)
    span = int(WINDOW * rate)
    n = u.size // span * span
    values = {}
    for name in names:
        e = (log[name] - logged[name])[:n].reshape(-1, span)
        values[name] = float(
            f"{np.sqrt(((e - e.mean(1, keepdims=True)) ** 2).mean()):.4g}"
        )
    return values


def build(case):
    """Machine, runs, effects and their sizes of one case; draws again until the machine
    behaves.
    """
    for attempt in range(80):
        seed = 1000 * (case + 1) + attempt
        rng = np.random.default_rng([20250, seed])
        kind, effects = choose(case, np.random.default_rng([88, case]))
        force = any(e.needs_force for e in effects) or rng.random() < 0.25
        machine = draw_machine(
            rng,
            force,
            any(e.needs_weight for e in effects),
            any(e.needs_level for e in effects),
        )
        kinds = ["joystick", "joystick", "joystick"]
        if rng.random() < 0.4:
            kinds = list(
                rng.permutation(
                    ["joystick", str(rng.choice(["chirp", "multisine"])), "joystick"]
                )
            )
        plans = [
            (*plan(rng, machine, str(k)), w)
            for k, w in zip(kinds, (1.0, 1.0, rng.uniform(0.8, 1.15)), strict=True)
        ]
        numbers = [
            {**{i: rng.random() for i in range(4)}, "style": rng.random()}
            for _ in effects
        ]
        strengths = rng.random(len(effects)) * 0.8
        try:
            plain = run_logs(machine, plans[2:])
        except Unusable:
            continue
        machine.lowest_P1 = float(min(r[0][:, 0].min() for r in plain))
        machine.highest_P2 = float(max(r[0][:, 1].max() for r in plain))
        base, base_sensor = dict(machine.plant), dict(machine.sensor)
        for _ in range(4):
            machine.plant, machine.sensor = dict(base), dict(base_sensor)
            drawn = []
            for e, s, r in zip(effects, strengths, numbers, strict=True):
                drawn.append(e.draw(machine, min(s, 1.0), r))
                machine.plant.update(drawn[-1].plant)
                machine.sensor.update(drawn[-1].sensor)
            try:
                checked = run_logs(machine, plans[2:])
            except Unusable:
                break
            pairs = [
                (d, e.name in SENSOR_EFFECTS)
                for e, d in zip(effects, drawn, strict=True)
            ]
            size = [
                sizes(machine, checked[0], d, in_sensor, False)
                for d, in_sensor in pairs
            ]
            weak, left = [max(z.values()) < 2.0 for z in size], []
            if not any(weak):
                left = [
                    sizes(machine, checked[0], d, in_sensor, True)
                    for d, in_sensor in pairs
                ]
                weak = [
                    max(z.values()) < (0.6 if len(effects) == 1 else 0.3) for z in left
                ]
            if not any(weak):
                try:
                    runs = run_logs(machine, plans[:2]) + checked
                except Unusable:
                    break
                felt = zip(size, left, strict=True)
                held = zip(effects, drawn, strengths, felt, strict=True)
                return kind, seed, machine, plans, kinds, runs, list(held)
            if max(s for s, w in zip(strengths, weak, strict=True) if w) >= 1.0:
                break
            strengths = strengths + np.where(weak, 0.4, 0.0)
    raise RuntimeError(f"case {case}: no usable machine in 80 draws")


def write_log(path, machine, u, values):
    """Write one log as CSV with a `name [unit]` header."""
    unit = "V" if machine.plant["u_full"] != 1.0 else "1"
    names = ["x", "P_a1", "P_a2", "P_s"] + (["F"] if machine.has_force else [])
    units = {"x": "m", "P_a1": "bar", "P_a2": "bar", "P_s": "bar", "F": "kN"}
    scale = {"m": 1.0, "bar": 1e-5, "kN": 1e-3}
    header = ",".join(
        ["time [s]", f"u [{unit}]"] + [f"{n} [{units[n]}]" for n in names]
    )
    shown = {**values, "x": values["x"] + 0.5 * machine.plant["stroke"]}
    columns = [np.arange(u.size) / machine.rate, u] + [
        shown[n] * scale[units[n]] for n in names
    ]
    formats = ["%.4f", "%.6f"] + [
        {"x": "%.7f", "F": "%.5f"}.get(n, "%.4f") for n in names
    ]
    np.savetxt(
        path,
        np.column_stack(columns),
        fmt=formats,
        delimiter=",",
        header=header,
        comments="",
    )


def make_case(case, out):
    """Write one case and return its entry of the truth."""
    kind, seed, machine, plans, kinds, runs, effects = build(case)
    rng = np.random.default_rng([31, seed])
    name = f"m{case:02d}"
    folder = out / name
    folder.mkdir(parents=True, exist_ok=True)
    left_out = [e.name for e, *_ in effects]
    (folder / "rig.toml").write_text(rig_file(rng, machine, name, left_out))
    floors = {}
    for log, run_ in zip(LOGS, runs, strict=True):
        record, _, u, _ = run_
        logged = channels(
            record, RECORD_RATE, RECORD_RATE // machine.rate, machine.sensor
        )
        values = measured(logged, machine.noise, machine.resolution, rng)
        write_log(folder / f"{log}.csv", machine, u, values)
        if log == "validate":
            floors = floor(machine, run_, values)
    extremes = {
        log: {
            n: [float(r[0][:, i].min()), float(r[0][:, i].max())]
            for n, i in (("P_1", 0), ("P_2", 1), ("x", 3))
        }
        for log, r in zip(LOGS, runs, strict=True)
    }
    return {
        "case": name,
        "kind": kind,
        "seed": seed,
        "style": machine.style,
        "rate_Hz": machine.rate,
        "has_F": machine.has_force,
        "motions": dict(zip(LOGS, map(str, kinds), strict=True)),
        "payload_factor": dict(zip(LOGS, [float(p[2]) for p in plans], strict=True)),
        "effects": [
            {
                "name": e.name,
                "in_tables": e.known,
                "strength": float(min(s, 1.0)),
                "parameters": d.plant,
                "sensor": d.sensor,
                "size_in_noise": f[0],
                "size_in_noise_after_refit": f[1],
            }
            for e, d, s, f in effects
        ],
        "declared": declared_parameters(machine, left_out),
        "rig_parameters": true_parameters(machine),
        "noise": noise_of(machine),
        "resolution": machine.resolution,
        "floor_validate": floors,
        "extremes": extremes,
        "plant": machine.plant,
    }


def plain(value):
    """JSON-ready form of numpy scalars and infinite values."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return value
