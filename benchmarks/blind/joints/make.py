"""Draws cases and writes their rig files and logs; the truth is returned."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import bilinear, lfilter

from . import rigs
from .effects import ABSORBED, OUTSIDE, RIG_NEEDS, TABLE, at_size, draw_effect
from .plant import FINE, simulate

KINDS = ["nothing"] * 4 + ["one"] * 7 + ["several"] * 4 + ["outside"] * 3 + ["lie"] * 2
LIES = ("area", "sign", "swapped", "unit", "P_s", "noise", "offset", "shift")
WINDOW = 0.25  # s
CHANNELS = ("P_a1", "P_a2", "F")
SCALE = {
    "bar": 1e5,
    "MPa": 1e6,
    "kPa": 1e3,
    "Pa": 1.0,
    "N": 1.0,
    "kN": 1e3,
    "s": 1.0,
    "ms": 1e-3,
    "rad": 1.0,
    "deg": np.pi / 180.0,
    "m": 1.0,
    "mm": 1e-3,
    "cm": 1e-2,
    "V": 1.0,
}


class Absurd(Exception):
    """The drawn rig cannot be run as drawn; another is to be drawn."""


def draw_task(case):
    """Kind of a case, and the effects or the lie that it holds. A block of 20 cases
    holds each kind in its share.
    """
    block, at = divmod(case, len(KINDS))
    kind = str(np.random.default_rng([77, block]).permutation(KINDS)[at])
    before = sum(
        str(k) == kind
        for b in range(block + 1)
        for i, k in enumerate(np.random.default_rng([77, b]).permutation(KINDS))
        if b < block or i < at
    )
    rng = np.random.default_rng([78, case])
    if kind == "one":
        return kind, [
            str(np.random.default_rng(79).permutation(TABLE)[before % len(TABLE)])
        ]
    if kind == "several":
        n = int(rng.choice([2, 3, 4], p=[0.5, 0.3, 0.2]))
        names = list(map(str, rng.permutation(TABLE)))
        clash = {"underlap", "valve_deadband"}
        if clash <= set(names[:n]):
            names.remove("underlap")
        return kind, names[:n]
    if kind == "outside":
        return kind, [
            str(np.random.default_rng(80).permutation(OUTSIDE)[before % len(OUTSIDE)])
        ]
    if kind == "lie":
        return kind, [
            str(np.random.default_rng(81).permutation(LIES)[before % len(LIES)])
        ]
    return kind, []


def needs_of(kind, names):
    """What the rig must be for the effects or the lie to be seen at all."""
    needs = {}
    for name in names:
        needs |= RIG_NEEDS.get(name, {})
    if kind == "lie":
        needs |= {
            "P_s": {"constant_supply": True},
            "swapped": {"two": True},
            "offset": {"holds_offsets": True},
        }.get(names[0], {})
    return needs


def tuned(rig):
    """The rig with its loop slowed to its valve, and a preview of the motion to match
    (as its operator would).
    """
    c, k = rig.plant, rig.control
    lag = (
        c.tau_u
        + (2.0 * c.zeta_v / c.omega_v if c.omega_v < 1e9 else 0.0)
        + c.tau_F
        + c.tau_P
    )
    K = min(k.K, 0.3 / (lag + 1.5 / rig.rate))
    return replace(
        rig,
        control=k._replace(K=K, K_i=k.K_i * min(1.0, K / k.K), preview=k.preview + lag),
    )


def draw_run(rng, rig, seconds):
    """All that is imposed on one log, and the noise of its sensors."""
    knots = rigs.draw_motion(rng, rig, seconds)
    F_d, P_s, u = (
        draw(rng, rig, seconds)
        for draw in (rigs.draw_force, rigs.draw_supply, rigs.draw_dither)
    )
    noise = rng.normal(size=(u.size, 4)) * [
        rig.noise[name] for name in ("P_a1", "P_a2", "F", "P_s")
    ]
    return {
        "knots": knots,
        "F_d": F_d,
        "P_s": P_s,
        "u": u,
        "noise": noise,
        "seconds": seconds,
        "closed": True,
    }


def run(rig, plant, log, hold=None, step=rigs.STEP):
    """Simulate one log. `hold`: pressures (n, 2) to restart from every WINDOW. Returns
    fine output; fills log["u"].
    """
    T = 1.0 / rig.rate
    n_sub = FINE * max(int(round(T / step / FINE)), 1)
    u = log["u"].copy()
    start = rigs.start_pressures(rig, log["F_d"][0], log["P_s"][0])
    every = int(WINDOW * rig.rate) if hold is not None else 0
    held = np.zeros((1, 2)) if hold is None else hold
    fine = simulate(
        plant,
        rig.control,
        log["closed"],
        T,
        n_sub,
        log["knots"],
        log["P_s"],
        rigs.DT,
        log["F_d"],
        u,
        log["noise"][:, :3],
        start,
        held,
        every,
    )
    return fine, u


def recorded(rig, fine, logger, name):
    """Noise-free P_a1, P_a2, F at the log's samples, (n, 3), through the recorder's own
    faults.
    """
    fine = fine[:, :3].copy()
    if "logger.omega" in logger and logger["logger.log"] == name:
        w, zeta = logger["logger.omega"], logger["logger.zeta"]
        b, a = bilinear([w * w], [1.0, 2.0 * zeta * w, w * w], rig.rate * FINE)
        for channel in logger["logger.channels"]:
            i = CHANNELS.index(channel)
            fine[:, i] = fine[0, i] + lfilter(b, a, fine[:, i] - fine[0, i])
    out = fine[::FINE].copy()
    if "logger.skew" in logger:
        i = CHANNELS.index(logger["logger.skew_channel"])
        t = np.arange(fine.shape[0]) / (rig.rate * FINE)
        out[:, i] = np.interp(t[::FINE] + logger["logger.skew"], t, fine[:, i])
    return out


def size_on(rig, plant, fields, without, log, name, hold):
    """RMS that an effect moves each channel by, in units of its noise, windows of 0.25
    s restarted at true pressures.

    plant: with the effect. fields: the effect's. without: values of these fields that
    take it away.
    """
    logger = {k: v for k, v in fields.items() if k.startswith("logger.")}
    here, _ = run(rig, plant, log, hold)
    there, _ = run(rig, plant._replace(**without), log, hold)
    off = recorded(rig, here, logger, name) - recorded(rig, there, {}, name)
    noise = np.array([rigs.total_noise(rig, channel) for channel in CHANNELS])
    size = np.sqrt(np.mean(off**2, axis=0)) / noise
    sizes = {channel: float(s) for channel, s in zip(CHANNELS, size, strict=True)}
    if rig.plant.area_1 == 0.0:
        del sizes["P_a1"]
    return sizes


def plant_fields(fields):
    """The fields that are the plant's."""
    return {k: v for k, v in fields.items() if not k.startswith("logger.")}


def check_sane(rig, fine):
    """Raise Absurd where a log holds what no rig would."""
    P = fine[:, 4:] if rig.plant.area_1 == 0.0 else fine[:, 3:]
    if not np.isfinite(fine).all():
        raise Absurd("not finite")
    if P.min() < 0.0 or P.max() > 1.08 * rig.P_s:
        raise Absurd("pressures outside of the supply")
    if np.ptp(P, axis=0).min() < 0.1 * rig.P_s:
        raise Absurd("pressures hardly move")
    if rig.plant.area_1 and not fine[:, 2].min() < -20.0 < 20.0 < fine[:, 2].max():
        raise Absurd("force of one sign")


def build(case, attempt):
    """One case: rig, logs and truth. Raises Absurd if what was drawn makes no sensible
    logs.
    """
    kind, names = draw_task(case)
    seed = 1000 * case + attempt
    rng = np.random.default_rng([seed, 2])
    needs = needs_of(kind, names)
    two = needs.pop("two", False)
    rig = rigs.draw_rig(seed, **needs)
    if two and rig.layout == "single":
        rig = rigs.draw_rig(seed, layout="differential", **needs)
    files = [f"fit_{i + 1}" for i in range(rig.n_fit)] + ["validate"]
    logs = {
        name: draw_run(rng, rig, seconds)
        for name, seconds in zip(files, rig.seconds, strict=True)
    }
    base = rig.plant
    effects = {}
    if kind != "lie" and names:
        fine, u = run(rig, base, logs["validate"])
        check_sane(rig, fine)
        replay = {**logs["validate"], "u": u, "closed": False}
        hold = fine[::FINE, 3:]
        for name in names:
            effect = draw_effect(rng, name, rig)

            def largest(s, effect=effect):
                fields = at_size(effect, s, base)
                own = {k: getattr(base, k) for k in plant_fields(fields)}
                on = fields.get("logger.log", "validate")
                return max(
                    size_on(
                        rig,
                        base._replace(**plant_fields(fields)),
                        fields,
                        own,
                        replay,
                        on,
                        hold,
                    ).values()
                )

            top = largest(1.0)
            if top < 1.5:
                raise Absurd(f"{name} cannot be seen")
            low = 1.5 / top
            while largest(low) < 1.3 and low < 1.0:
                low = min(1.5 * low, 1.0)
            low = max(low, 0.2 if name == "hose_dynamics" else 0.0)
            s = float(np.exp(rng.uniform(np.log(low), 0.0)))
            effects[name] = {"share_of_largest": s, "fields": at_size(effect, s, base)}
    plant = base
    for effect in effects.values():
        plant = plant._replace(**plant_fields(effect["fields"]))
    rig = tuned(replace(rig, plant=plant))
    for name in rigs.PARAMETERS:
        if getattr(plant, name) != getattr(base, name):
            rig.starts[name] *= getattr(plant, name) / getattr(base, name)
    logger = {
        k: v
        for e in effects.values()
        for k, v in e["fields"].items()
        if k.startswith("logger.")
    }
    for name, log in logs.items():
        log["fine"], log["u"] = run(rig, plant, log)
        log["closed"] = False
        check_sane(rig, log["fine"])
        log["recorded"] = recorded(rig, log["fine"], logger, name)
    for name, effect in effects.items():
        without = {k: getattr(base, k) for k in plant_fields(effect["fields"])}
        effect["size"] = {
            log: size_on(
                rig,
                plant,
                effect["fields"],
                without,
                logs[log],
                log,
                logs[log]["fine"][::FINE, 3:],
            )
            for log in ("fit_1", "validate")
        }
        if name in ABSORBED:
            effect["near_to"] = ABSORBED[name]
    lie = draw_lie(rng, rig, names[0]) if kind == "lie" else {}
    truth = {
        "case": f"c{case:02d}",
        "kind": kind,
        "seed": seed,
        "expect": {
            "nothing": "nothing missing",
            "one": "explained",
            "several": "explained",
            "outside": "unknown",
            "lie": "the lie called by its name",
        }[kind],
        "effects": [{"name": name, **effect} for name, effect in effects.items()],
        "lie": lie,
        "layout": rig.layout,
        "rate_Hz": rig.rate,
        "held": rig.holds_offsets * ["delta_1", "delta_2"]
        + rig.holds_k_v * ["k_vp", "k_vn"],
        "noise": {name: rigs.total_noise(rig, name) for name in rig.noise},
        "size_is": "RMS of with - without, in the channel's noise, same motion and "
        "command, pressures restarted at "
        "their true values every 0.25 s; parameters not refitted",
        "P_s": rig.P_s,
        "plant": {k: v for k, v in plant._asdict().items() if np.isfinite(v)},
        "control": rig.control._asdict(),
    }
    return rig, logs, lie, truth


def draw_lie(rng, rig, name):
    """What the user has wrong: entries of the rig file, or of the logs' columns."""
    side = rng.choice([-1.0, 1.0])
    motion = "psi" if rig.by_angle else "x"
    pressures = ["P_a2"] if rig.plant.area_1 == 0.0 else ["P_a1", "P_a2"]
    if name == "area":
        return {"area": float(1.0 + side * 0.05)}
    if name == "sign":
        return {"sign": str(rng.choice(["u", "F", motion]))}
    if name == "swapped":
        return {"swapped": ["P_a1", "P_a2"]}
    if name == "unit":
        channel = str(rng.choice([motion, "F", "P"]))
        true = rig.units[channel]
        said = {
            "rad": "deg",
            "deg": "rad",
            "m": "mm",
            "mm": "cm",
            "N": "kN",
            "kN": "N",
            "bar": "MPa",
            "MPa": "bar",
            "kPa": "bar",
            "Pa": "kPa",
        }[true]
        return {"unit": {"channel": channel, "true": true, "said": said}}
    if name == "P_s":
        return {"P_s": float(1.0 + side * rng.uniform(0.06, 0.12))}
    if name == "noise":
        return {"noise": float(10.0**side)}
    if name == "offset":
        return {"offset": float(side * rng.uniform(0.01, 0.02))}
    channel = str(rng.choice([*pressures, "F", motion]))
    return {
        "shift": {
            "channel": channel,
            "seconds": float(side * max(rng.uniform(4e-3, 1.2e-2), 2.0 / rig.rate)),
        }
    }


def table_of(rig, log, lie, rng):
    """Columns of a log as its user has them: {header: (values, format)}."""
    n = log["u"].size
    t = np.arange(n) / rig.rate
    spline = CubicSpline(
        np.arange(log["knots"].shape[1] + 1) * rigs.DT, _positions(log["knots"])
    )
    shift = lie.get("shift", {"channel": None, "seconds": 0.0})
    motion = "psi" if rig.by_angle else "x"
    when = t + shift["seconds"] * (shift["channel"] == motion)
    x = spline(np.clip(when, 0.0, t[-1])) + lie.get("offset", 0.0)
    x = x / rig.plant.radius if rig.by_angle else x + rig.x_mid
    values = {
        "time": t,
        "u": log["u"],
        motion: np.round(x / rig.resolution) * rig.resolution,
    }
    fine_t = np.arange(n * FINE) / (rig.rate * FINE)
    for i, channel in enumerate(CHANNELS):
        if channel == "P_a1" and rig.plant.area_1 == 0.0:
            continue
        y = log["recorded"][:, i]
        if shift["channel"] == channel:
            y = np.interp(t + shift["seconds"], fine_t, log["fine"][:, i])
        values[channel] = _rounded(y + log["noise"][:, i], rig.lsb[channel])
    if rig.logs_supply:
        P_s = np.interp(t, np.arange(log["P_s"].size) * rigs.DT, log["P_s"])
        values["P_s"] = _rounded(P_s + log["noise"][:, 3], rig.lsb["P_s"])
    if rig.logs_F_d:
        values["F_d"] = np.interp(t, np.arange(log["F_d"].size) * rigs.DT, log["F_d"])
    if "sign" in lie:
        values[lie["sign"]] = -values[lie["sign"]]
    if "swapped" in lie:
        values["P_a1"], values["P_a2"] = values["P_a2"], values["P_a1"]
    table = {}
    for name, y in values.items():
        kind = "V" if name == "u" else rig.units[name[0] if name[0] in "PF" else name]
        said = kind
        if "unit" in lie and lie["unit"]["channel"] in (name, name[0]):
            said = lie["unit"]["said"]
        table[f"{name} [{said}]"] = (
            y / SCALE[kind],
            "%.10g" if name in ("psi", "x") else "%.7g",
        )
    order = ["time", *rng.permutation([name for name in values if name != "time"])]
    return {
        header: table[header]
        for name in order
        for header in table
        if header.split(" ")[0] == name
    }


def _positions(knots):
    """Values at the knots of a piecewise cubic, the last one included."""
    s = rigs.DT
    last = ((knots[0, -1] * s + knots[1, -1]) * s + knots[2, -1]) * s + knots[3, -1]
    return np.append(knots[3], last)


def _rounded(y, lsb):
    return np.round(y / lsb) * lsb


def write_case(out, case):
    """Write one case, drawing anew until its logs are sensible. Returns its truth."""
    why = []
    for attempt in range(40):
        try:
            rig, logs, lie, truth = build(case, attempt)
            break
        except Absurd as absurd:
            why.append(str(absurd))
    else:
        raise RuntimeError(
            f"case {case}: no sensible rig in 40 draws: {sorted(set(why))}"
        )
    folder = Path(out) / f"c{case:02d}"
    folder.mkdir(parents=True, exist_ok=True)
    file_lie = {k: v for k, v in lie.items() if k in ("area", "P_s", "noise")}
    (folder / "rig.toml").write_text(
        rigs.rig_file(rig, f"cylinder {case:02d}", file_lie)
    )
    for name, log in logs.items():
        table = table_of(rig, log, lie, np.random.default_rng([truth["seed"], 3]))
        np.savetxt(
            folder / f"{name}.csv",
            np.column_stack([y for y, _ in table.values()]),
            delimiter=",",
            header=",".join(table),
            comments="",
            fmt=[form for _, form in table.values()],
        )
    truth["redrawn_because"] = why
    return truth
