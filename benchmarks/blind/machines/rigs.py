"""Machines drawn by seed, what an operator does with them, and the rig file that a user
would write.
"""

from dataclasses import dataclass, field

import numpy as np

from .plant import FIELDS, parameters, run

RECORD_RATE = 2000  # Hz
STEP_RATE = 10000  # Hz
DECLARED = ("valve_deadband", "valve_delay", "valve_lag", "entrained_air")


def draw_log(rng, low, high):
    """A number drawn evenly in its logarithm."""
    return float(low * (high / low) ** rng.random())


@dataclass
class Machine:
    """A machine and its instruments; plant holds the fields of plant.FIELDS in SI."""

    style: str
    rate: int  # Hz, of the log
    speed: float  # m/s at full opening
    has_force: bool
    declared: tuple  # effects that the machine has and the rig file names
    rest_P1: float
    plant: dict
    noise: dict
    resolution: dict
    quantum: float  # of the command
    sensor: dict = field(default_factory=dict)
    lowest_P1: float = 0.0
    highest_P2: float = 0.0

    @property
    def rest_P2(self):
        """Pressure in chamber 2 at rest (Pa)."""
        p = self.plant
        return (p["W"] + p["area_1"] * self.rest_P1) / p["area_2"]


def draw_machine(rng, has_force, needs_weight, needs_level):
    """Draw a crane, an excavator, a press or a test axis."""
    styles = ["crane", "excavator", "crane", "excavator", "press", "axis"]
    style = (
        "axis" if needs_level else styles[int(rng.integers(4 if needs_weight else 6))]
    )
    mobile = style in ("crane", "excavator")
    bore = draw_log(rng, 0.05, 0.125) if mobile else draw_log(rng, 0.04, 0.1)
    rod = bore * rng.uniform(0.45, 0.7)
    area_2 = np.pi / 4 * bore**2
    area_1 = area_2 - np.pi / 4 * rod**2
    stroke = draw_log(rng, 0.4, 1.5) if mobile else draw_log(rng, 0.2, 0.7)
    p = {k: FIELDS[k] for k in FIELDS}
    p.update(
        area_1=area_1, area_2=area_2, stroke=stroke, beta=draw_log(rng, 7e8, 1.6e9)
    )
    p.update(
        delta_1=rng.uniform(0.05, 0.4) * stroke, delta_2=rng.uniform(0.05, 0.3) * stroke
    )
    p.update(P_src=rng.uniform(1.2e7, 2.8e7), P_r=rng.uniform(1e5, 8e5))
    stall = p["P_src"] * area_2
    weight = {
        "crane": rng.uniform(0.2, 0.4),
        "excavator": rng.uniform(0.12, 0.35),
        "press": 0.04,
        "axis": 0.0,
    }[style]
    p.update(W=weight * stall, W_slope=rng.uniform(-0.3, 0.3) if mobile else 0.0)
    speed = draw_log(rng, 0.12, 0.45) * min(1.0, stroke / 0.5)
    p["R_src"] = rng.choice([0.0, 0.03, 0.1]) * p["P_src"] / (area_2 * speed)
    p.update(
        k_c=stall * rng.uniform(0.01, 0.035), k_0=stall * rng.uniform(-0.003, 0.003)
    )
    p.update(b=stall * rng.uniform(0.005, 0.02) / speed, z_ss=draw_log(rng, 1e-4, 4e-4))
    p["load_c"] = stall * (
        rng.uniform(0.03, 0.08) if style == "axis" else rng.uniform(0.005, 0.02)
    )
    if style == "press":
        p.update(press_x=0.1 * stroke, press_k=0.4 * stall / (0.4 * stroke))

    length_1, length_2 = 0.5 * stroke + p["delta_1"], 0.5 * stroke + p["delta_2"]
    stiffness = p["beta"] * (area_1 / length_1 + area_2 / length_2)
    mass = stiffness / (2 * np.pi * draw_log(rng, 2.5, 20.0)) ** 2
    p["mass"] = float(np.clip(mass, 50.0, 2e4))
    p["load_b"] = 2 * rng.uniform(0.03, 0.1) * np.sqrt(stiffness * p["mass"])

    # metering edges for a chosen speed and chosen counter pressures
    full = 10.0 if style in ("press", "axis") and rng.random() < 0.6 else 1.0
    supply, drag = (
        0.95 * p["P_src"],
        p["k_c"] + p["load_c"] + (p["b"] + p["load_b"]) * speed,
    )
    back = rng.uniform(8e5, 3e6)
    up = min((p["W"] * 1.1 + drag + (p["P_r"] + back) * area_1) / area_2, 0.85 * supply)
    down_speed = speed * rng.uniform(0.7, 1.2)
    pilot = (
        rng.uniform(2e6, 5e6)
        if mobile
        else 0.3 * supply + (drag / area_1 if style == "axis" else 0.0)
    )
    pilot = min(pilot, 0.7 * supply)
    down = max((p["W"] - drag + pilot * area_1) / area_2, p["P_r"] + 8e5)
    p.update(
        u_full=full,
        c_n1=area_1 * speed / (full * np.sqrt(back)),
        c_p2=area_2 * speed / (full * np.sqrt(supply - up)),
        c_n2=area_2 * down_speed / (full * np.sqrt(down - p["P_r"])),
        c_p1=area_1 * down_speed / (full * np.sqrt(supply - pilot)),
    )

    declared = ()
    if mobile:
        declared = DECLARED if rng.random() < 0.6 else DECLARED[:3]
    elif rng.random() < 0.5:
        declared = ("valve_lag",)
    if "valve_deadband" in declared:
        plus, minus = rng.uniform(0.04, 0.18, 2) * full
        p.update(o_p1=plus, o_n2=plus, o_p2=minus, o_n1=minus)
    if "valve_delay" in declared:
        p["tau_u"] = rng.uniform(0.01, 0.07)
    if "valve_lag" in declared:
        frequency = draw_log(rng, 4, 12) if mobile else draw_log(rng, 20, 60)
        p.update(omega_v=2 * np.pi * frequency, zeta_v=rng.uniform(0.6, 1.0))
    if "entrained_air" in declared:
        p["alpha"] = draw_log(rng, 1e-3, 8e-3)

    noise_P = draw_log(rng, 3e3, 3e4)
    pressure_range = 4e7 if p["P_src"] > 2.2e7 or rng.random() < 0.5 else 2.5e7
    bits = int(rng.integers(12, 17))
    fine = 2 * noise_P * np.sqrt(12) * min(length_1, length_2) / p["beta"]
    step_x = float(np.clip(min(draw_log(rng, 5e-6, 1e-4), fine), 5e-6, 1e-4))
    cell = 1.2 * stall
    noise = {
        "x": 0.3 * step_x,
        "P_a1": noise_P,
        "P_a2": noise_P,
        "P_s": noise_P,
        "F": cell * draw_log(rng, 1e-4, 4e-4),
    }
    step_P = pressure_range / 2**bits
    resolution = {
        "x": step_x,
        "P_a1": step_P,
        "P_a2": step_P,
        "P_s": step_P,
        "F": 2 * cell / 2**16,
    }
    return Machine(
        style=style,
        rate=int(rng.choice([100, 200, 250, 500])),
        speed=float(speed),
        has_force=has_force,
        declared=declared,
        rest_P1=float(rng.uniform(1e6, 3e6)),
        plant={k: float(v) for k, v in p.items()},
        noise=noise,
        resolution=resolution,
        quantum=float(full / 2 ** int(rng.integers(11, 16))),
    )


def joystick(rng, machine, n):
    """Wanted positions (m from mid-stroke) and speeds (m/s): moves of all speeds with
    smooth ends, and holds.
    """
    rate, stroke = machine.rate, machine.plant["stroke"]
    v = np.zeros(n)
    at, x = int(0.8 * rate), rng.uniform(-0.15, 0.15) * stroke
    start = x
    while at < n:
        low, high = [(0.04, 0.15), (0.15, 0.45), (0.45, 0.85)][
            int(rng.choice(3, p=[0.25, 0.4, 0.35]))
        ]
        target = rng.uniform(-0.36, 0.36) * stroke
        pace = rng.uniform(low, high) * machine.speed
        ramp = rng.uniform(0.15, 0.8)
        span = min(max(abs(target - x) / pace, ramp), 6.0)
        m, k = int((span + ramp) * rate), max(int(ramp * rate), 1)
        profile = np.interp(np.arange(m), [0, k, m - k, m], [0, 1, 1, 0])
        profile = 0.5 - 0.5 * np.cos(np.pi * profile)
        if span * pace > abs(target - x):
            pace = abs(target - x) / span
        part = np.sign(target - x) * pace * profile
        stop = min(at + m, n)
        v[at:stop] += part[: stop - at]
        x += part.sum() / rate
        at += m + int(rng.choice([0.1, 0.6, 2.5]) * rng.uniform(0.5, 1.3) * rate)
    return start + np.cumsum(v) / rate, v


def sweep(rng, machine, n, kind):
    """Wanted positions, and speeds (m/s) of a chirp or multisine about a slow sway."""
    t = np.arange(n) / machine.rate
    stroke = machine.plant["stroke"]
    sway = (
        0.15 * stroke * np.sin(2 * np.pi * t / rng.uniform(18, 30) + rng.uniform(0, 6))
    )
    if kind == "chirp":
        top = rng.uniform(1.5, 5.0)
        cycle = t[-1] / 2
        tau = np.where(t < cycle, t, 2 * cycle - t) / cycle
        phase = 2 * np.pi * np.cumsum(0.1 * (top / 0.1) ** tau) / machine.rate
        frequency = 0.1 * (top / 0.1) ** tau
        amplitude = np.minimum(
            rng.uniform(0.25, 0.5) * machine.speed, 0.2 * stroke * 2 * np.pi * frequency
        )
        wave = amplitude * np.sin(phase)
    else:
        frequencies = np.geomspace(0.08, rng.uniform(1.5, 5.0), 14)
        wave = sum(
            min(0.22 * machine.speed, 0.06 * stroke * 2 * np.pi * f)
            * np.sin(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi))
            for f in frequencies
        )
        wave *= min(1.0, 0.7 * machine.speed / np.abs(wave).max())
    fade = np.clip(t / 1.0, 0, 1)
    wave = wave * fade
    return sway, wave + np.gradient(sway, t) * fade


def plan(rng, machine, kind):
    """Planned command and wanted position of one run of 30 to 100 s."""
    n = int(rng.uniform(30, 100 if machine.rate <= 250 else 50) * machine.rate)
    x, v = (
        joystick(rng, machine, n)
        if kind == "joystick"
        else sweep(rng, machine, n, kind)
    )
    return -machine.plant["u_full"] * v / machine.speed, x


def loaded(plant, weight):
    """The plant's parameters with `weight` times its load."""
    return plant | {name: plant[name] * weight for name in ("W", "mass")}


def simulate(machine, command, x_ref, operator_on, step_rate=STEP_RATE, weight=1.0):
    """One run of the machine: record, motion and command. weight scales the payload of
    this run.
    """
    values = loaded(machine.plant, weight)
    overlap = max(0.0, 0.25 * sum(values[k] for k in ("o_p1", "o_n1", "o_p2", "o_n2")))
    operator = np.array(
        [
            float(operator_on),
            0.8 * values["u_full"] / machine.speed,
            overlap,
            2 * np.pi * 4.0,
            0.85 * values["u_full"],
            machine.quantum,
            1.0,
        ]
    )
    at_rest = (values["W"] + values["area_1"] * machine.rest_P1) / values["area_2"]
    start = np.array([[machine.rest_P1, at_rest]])
    return run(
        parameters(**values),
        command,
        float(machine.rate),
        step_rate // machine.rate,
        step_rate // RECORD_RATE,
        operator,
        x_ref,
        np.empty((0, 4)),
        start,
        0,
    )


def replay(plant, machine, command, motion, restart, weight=1.0, step_rate=STEP_RATE):
    """The record with the motion and P_s imposed and the pressures set to restart's
    rows every 0.25 s.
    """
    return run(
        parameters(**loaded(plant, weight)),
        command,
        float(machine.rate),
        step_rate // machine.rate,
        step_rate // RECORD_RATE,
        np.zeros(7),
        np.zeros(1),
        motion,
        restart,
        step_rate // 4,
    )[0]


def true_parameters(machine):
    """The rig's parameters in the names of a rig file (SI)."""
    p = machine.plant
    names = ("beta", "c_p1", "c_n1", "c_p2", "c_n2", "delta_1", "delta_2")
    values = {n: p[n] for n in names}
    if machine.has_force:
        values.update(
            k_cp=p["k_c"],
            k_cn=p["k_c"],
            k_0=p["k_0"],
            k_vp=-p["b"],
            k_vn=-p["b"],
            k_fp=0.0,
            k_fn=0.0,
            z_ss=p["z_ss"],
        )
    return values


def declared_parameters(machine, left_out):
    """The effects that the rig file names, with their true parameters."""
    p = machine.plant
    true = {
        "valve_deadband": {"u_dbp": p["o_p1"], "u_dbn": p["o_p2"]},
        "valve_delay": {"tau_u": p["tau_u"]},
        "valve_lag": {"omega": p["omega_v"], "zeta": p["zeta_v"]},
        "entrained_air": {"alpha": p["alpha"]},
    }
    return {name: true[name] for name in machine.declared if name not in left_out}


def rig_file(rng, machine, name, left_out):
    """The text of rig.toml: constants exact, starts off by 10 to 60 %, wide ranges."""
    p = machine.plant
    volt = p["u_full"] != 1.0
    gain = "m^3/(s*V*Pa^0.5)" if volt else "m^3/(s*Pa^0.5)"
    command = " V" if volt else ""

    def off():
        """A factor that is off by 10 to 60 %."""
        factor = 1.0 + rng.uniform(0.1, 0.6)
        return factor if rng.random() < 0.5 else 1.0 / factor

    def line(key, true, unit, low, high):
        tail = f" {unit}" if unit else ""
        start = float(np.clip(true * off(), low, high))
        ends = f'["{low:.4g}{tail}", "{high:.4g}{tail}"]'
        return f'{key} = {{ start = "{start:.4g}{tail}", range = {ends} }}'

    rows = [
        f'name = "{name}"',
        'layout = "differential"',
        "",
        "[geometry]",
        f'area_1 = "{p["area_1"]:.7g} m^2"',
        f'area_2 = "{p["area_2"]:.7g} m^2"',
        f'chamber_length = "{p["stroke"]:.7g} m"',
        f'x_mid = "{0.5 * p["stroke"]:.7g} m"',
        "",
        "[supply]",
        f'P_s = "{p["P_src"]:.4g} Pa"',
        f'P_r = "{p["P_r"]:.7g} Pa"',
        "",
        "[parameters]",
        line("beta", p["beta"], "Pa", 3e8, 2.5e9),
    ]
    rows += [
        line(k, p[k], gain, p[k] / 8, p[k] * 8)
        for k in ("c_p1", "c_n1", "c_p2", "c_n2")
    ]
    for k in ("delta_1", "delta_2"):
        if "dead_volume" in left_out:
            rows.append(f'{k} = "{p[k]:.7g} m"')
        else:
            rows.append(line(k, p[k], "m", 0.005, 1.0 * p["stroke"]))
    if machine.has_force:
        top = 6 * p["k_c"]
        rows += [line(k, p["k_c"], "N", 0.0, top) for k in ("k_cp", "k_cn")]
        rows.append(
            f'k_0 = {{ start = "0 N", range = ["{-0.5 * p["k_c"]:.4g} N", '
            f'"{0.5 * p["k_c"]:.4g} N"] }}'
        )
        for k in ("k_vp", "k_vn"):
            if "viscous_friction" in left_out:
                rows.append(f'{k} = "0 N*s/m"')
            else:
                rows.append(line(k, -p["b"], "N*s/m", -5 * p["b"], 5 * p["b"]))
        rows += [
            'k_fp = "0"',
            'k_fn = "0"',
            line("z_ss", p["z_ss"], "m", 1e-5, 2e-3),
            'delta = "0.001 1/N"',
        ]
    limits = {
        "u_dbp": (command.strip(), 0.0, 0.3 * p["u_full"]),
        "u_dbn": (command.strip(), 0.0, 0.3 * p["u_full"]),
        "tau_u": ("s", 0.0, 0.15),
        "omega": ("rad/s", 10.0, 600.0),
        "zeta": ("", 0.3, 1.3),
        "alpha": ("", 0.0, 0.05),
    }
    for effect, values in declared_parameters(machine, left_out).items():
        rows += ["", f"[effects.{effect}]"]
        rows += [line(k, true, *limits[k]) for k, true in values.items()]
    return "\n".join(rows) + "\n"
