"""Draws rigs, motions, wanted forces and supplies; writes a rig file as its user would
have it.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from .plant import Control, Plant

DT = 1e-3  # s, grid of motion, supply and wanted force
TAIL = 0.5  # s that the grid reaches beyond a log
STEP = 25e-6  # s, integration step


@dataclass
class Rig:
    """A rig as it is, and how its user logs it."""

    layout: str
    plant: Plant
    control: Control
    P_s: float  # Pa
    pulled: bool  # the supply is pulled by other consumers
    logs_supply: bool
    rate: int  # Hz
    by_angle: bool  # logs psi, else x
    x_mid: float  # m
    resolution: float  # rad or m of the position sensor
    noise: dict  # standard deviation of P_a1, P_a2, P_s, F (SI)
    lsb: dict  # quantisation of P_a1, P_a2, P_s, F (SI)
    units: dict
    v_max: float  # m/s
    n_fit: int
    seconds: list
    logs_F_d: bool
    states_noise: bool
    holds_offsets: bool  # delta_1 and delta_2 are measured and held
    holds_k_v: bool  # k_vp and k_vn are known and held
    starts: dict = field(default_factory=dict)


def draw_rig(
    seed,
    layout=None,
    by_angle=None,
    holds_offsets=None,
    holds_k_v=None,
    constant_supply=False,
):
    """A rig by seed; arguments that are given overrule the draw without changing what
    else is drawn.
    """
    rng = np.random.default_rng([seed, 1])
    drawn = rng.choice(["pull-pull", "differential", "single"], p=[0.45, 0.45, 0.1])
    layout = layout or str(drawn)
    u = rng.uniform
    P_s = float(np.round(u(7e6, 21e6), -5))
    area = float(np.float64(f"{np.pi / 4 * u(0.028, 0.06) ** 2:.4g}"))
    ratio = u(0.55, 0.85)
    small = float(f"{area * ratio:.4g}")
    area_1, area_2 = {"pull-pull": (area, area), "single": (0.0, area)}.get(
        layout, (small, area) if u() < 0.6 else (area, small)
    )
    length = float(np.round(u(0.16, 0.4), 3))
    v_max = u(0.02, 0.08)
    u_max = 10.0
    c = area * v_max * u(1.8, 4.0) / (u_max * np.sqrt(0.5 * P_s))
    lands = c * u(0.9, 1.1, 4)
    k_c = np.exp(u(np.log(100.0), np.log(min(2000.0, 0.1 * area * P_s))))
    both = k_c * u(0.8, 1.2, 2)
    bends = u(0.1, 0.5, 2) * k_c / v_max
    if u() < 0.25:
        bends = -bends
    beta = u(6e8, 1.3e9)
    plant = Plant(
        area_1=area_1,
        area_2=area_2,
        length=length,
        delta_1=u(0.005, 0.03),
        delta_2=u(0.005, 0.03),
        radius=float(np.round(u(0.06, 0.15), 3)),
        P_r=float(np.round(u(1.5e5, 5e5), -4)),
        u_max=u_max,
        beta=beta,
        c_p1=lands[0],
        c_n1=lands[1],
        c_p2=lands[2],
        c_n2=lands[3],
        k_cp=both[0],
        k_cn=both[1],
        k_0=u(-0.15, 0.15) * k_c,
        k_vp=bends[0],
        k_vn=bends[1],
        k_fp=u(0.4, 1.1),
        k_fn=u(0.4, 1.1),
        z_ss=np.exp(u(np.log(2e-5), np.log(1.5e-4))),
        delta=1.0 / (k_c * u(0.7, 1.5)),
    )
    rate = int(rng.choice([200, 500, 1000, 2000], p=[0.1, 0.15, 0.6, 0.15]))
    control = Control(
        K=min(u(40.0, 110.0), 0.3 * rate / 1.5),
        K_i=u(50.0, 400.0),
        preview=0.5 / rate,
        k_c=u(0.5, 1.0) * k_c,
        beta=beta * u(0.85, 1.2),
        c=c * u(0.9, 1.1),
    )
    by_angle_drawn = layout == "pull-pull" or u() < 0.35
    by_angle = bool(by_angle_drawn) if by_angle is None else by_angle
    bits = int(rng.integers(20, 24))
    resolution = (
        2.0 * np.pi / 2**bits if by_angle else float(rng.choice([2e-7, 5e-7, 1e-6]))
    )
    x_mid = 0.0 if by_angle or u() < 0.4 else float(np.round(u(0.4, 0.7) * length, 3))
    p_bits, f_bits = int(rng.choice([12, 14, 16])), int(rng.choice([14, 16]))
    p_lsb, f_lsb = 1.6 * P_s / 2**p_bits, 2.4 * area * P_s / 2**f_bits
    noise = {
        "P_a1": u(2.5e-4, 9e-4) * P_s,
        "P_a2": u(2.5e-4, 9e-4) * P_s,
        "P_s": u(2e-4, 6e-4) * P_s,
        "F": u(1.0, 5.0),
    }
    lsb = {"P_a1": p_lsb, "P_a2": p_lsb, "P_s": p_lsb, "F": f_lsb}
    pressure = str(rng.choice(["bar", "MPa", "kPa", "Pa"], p=[0.5, 0.25, 0.15, 0.1]))
    units = {
        "P": pressure,
        "F": str(rng.choice(["N", "kN"])),
        "time": str(rng.choice(["s", "ms"], p=[0.8, 0.2])),
        "psi": str(rng.choice(["rad", "deg"])),
        "x": str(rng.choice(["m", "mm"])),
    }
    pulled = bool(u() < 0.5)
    logs_supply = bool(u() < 0.4) or pulled
    n_fit = int(rng.choice([2, 3], p=[0.7, 0.3]))
    seconds = [float(s) for s in np.round(u(10.0, 22.0, n_fit + 1))]
    logs_F_d, states_noise = bool(u() < 0.6), bool(u() < 0.8)
    offsets_known, k_v_known = bool(u() < 0.35), bool(u() < 0.2)
    if constant_supply:
        pulled, logs_supply = False, False
    rig = Rig(
        layout,
        plant,
        control,
        P_s,
        pulled,
        logs_supply,
        rate,
        by_angle,
        x_mid,
        resolution,
        noise,
        lsb,
        units,
        v_max,
        n_fit,
        seconds,
        logs_F_d,
        states_noise,
        offsets_known if holds_offsets is None else holds_offsets,
        k_v_known if holds_k_v is None else holds_k_v,
    )
    for name in PARAMETERS:
        value = getattr(plant, name)
        off = float(np.exp(rng.choice([-1, 1]) * np.log(u(1.1, 1.6))))
        rig.starts[name] = 0.0 if name == "k_0" else value * off
    return rig


# name: unit, range as a function of the plant
PARAMETERS = {
    "beta": ("Pa", lambda c: (1e8, 3e9)),
    "c_p1": ("m^3/(s*V*Pa^0.5)", lambda c: (0.1 * c.c_p2, 10.0 * c.c_p2)),
    "c_n1": ("m^3/(s*V*Pa^0.5)", lambda c: (0.1 * c.c_p2, 10.0 * c.c_p2)),
    "c_p2": ("m^3/(s*V*Pa^0.5)", lambda c: (0.1 * c.c_p2, 10.0 * c.c_p2)),
    "c_n2": ("m^3/(s*V*Pa^0.5)", lambda c: (0.1 * c.c_p2, 10.0 * c.c_p2)),
    "delta_1": ("m", lambda c: (0.0, 0.06)),
    "delta_2": ("m", lambda c: (0.0, 0.06)),
    "k_cp": ("N", lambda c: (0.0, 4000.0)),
    "k_cn": ("N", lambda c: (0.0, 4000.0)),
    "k_0": ("N", lambda c: (-800.0, 800.0)),
    "k_vp": ("N*s/m", lambda c: (-3e4, 3e4)),
    "k_vn": ("N*s/m", lambda c: (-3e4, 3e4)),
    "k_fp": ("1", lambda c: (0.0, 3.0)),
    "k_fn": ("1", lambda c: (0.0, 3.0)),
    "z_ss": ("m", lambda c: (2e-6, 5e-4)),
    "delta": ("1/N", lambda c: (5e-5, 5e-2)),
}


def draw_motion(rng, rig, seconds):
    """Coefficients of a cubic on the grid `DT` for r psi or x [m]: holds, ramps, sines,
    steps; inside the stroke.
    """
    n = int(round((seconds + TAIL) / DT)) + 1
    reach = 0.34 * rig.plant.length
    v = np.zeros(n)
    x, i, kinds = 0.0, int(rng.uniform(0.1, 0.4) / DT), []
    while i < n:
        if not kinds:
            kinds = list(
                rng.permutation(
                    ["hold", "ramp", "sine", "beat", "step", "ramp", "crawl"]
                )
            )
        kind = kinds.pop()
        side = -np.sign(x) if abs(x) > 0.4 * reach else rng.choice([-1.0, 1.0])
        room = reach + (abs(x) if side * x < 0 else -abs(x))
        if kind == "hold":
            piece = np.zeros(int(rng.uniform(0.4, 1.5) / DT))
        elif kind in ("ramp", "crawl", "step"):
            low, high = {
                "ramp": (0.25, 0.9),
                "crawl": (0.02, 0.12),
                "step": (0.8, 1.0),
            }[kind]
            speed = rig.v_max * rng.uniform(low, high)
            longest = {"ramp": 2.5, "crawl": 2.0, "step": 0.35}[kind]
            piece = np.full(
                int(min(longest * rng.uniform(0.5, 1.0), room / speed) / DT),
                side * speed,
            )
        else:
            length = rng.uniform(1.5, 3.5)
            t = np.arange(int(length / DT)) * DT
            piece = np.zeros(t.size)
            for _ in range(1 if kind == "sine" else 3):
                f = max(round(rng.uniform(0.3, 3.0) * length), 1) / length
                top = min(
                    rig.v_max, 2.0 * np.pi * f * 0.5 * max(reach - abs(x), 0.1 * reach)
                )
                top *= rng.uniform(0.5, 1.0) / (1 if kind == "sine" else 2)
                piece += (
                    top * np.sin(2.0 * np.pi * f * t) * side
                    if abs(x) < 0.3 * reach
                    else top * np.cos(2.0 * np.pi * f * t)
                )
        piece = piece[: n - i]
        v[i : i + piece.size] = piece
        x += piece.sum() * DT
        i += piece.size
    v = gaussian_filter1d(v, rng.uniform(0.012, 0.03) / DT, mode="nearest")
    x = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * DT)])
    x -= 0.5 * (x.max() + x.min()) * rng.uniform(0.6, 1.0)
    x *= min(1.0, reach / np.abs(x).max())
    return np.ascontiguousarray(CubicSpline(np.arange(n) * DT, x).c)


def draw_force(rng, rig, seconds):
    """Wanted force [N] on the grid `DT`: steps, slow and fast sines; both signs, but
    for a single chamber.
    """
    n = int(round((seconds + TAIL) / DT)) + 1
    t = np.arange(n) * DT
    c = rig.plant
    stall = rig.P_s * (min(c.area_1, c.area_2) or c.area_2)
    size = stall * rng.uniform(0.1, 0.25)
    steps = np.zeros(n)
    i = 0
    while i < n:
        j = i + int(rng.uniform(0.6, 2.5) / DT)
        steps[i:j] = rng.uniform(-1.0, 1.0)
        i = j
    F = 0.6 * gaussian_filter1d(steps, rng.uniform(0.015, 0.05) / DT)
    for low, high, top in (
        (0.1, 0.5, 0.5),
        (0.7, 2.0, 0.25),
        (2.0, 4.0, 0.12),
        (4.0, 9.0, 0.06),
    ):
        F += top * np.sin(2.0 * np.pi * (rng.uniform(low, high) * t + rng.uniform()))
    F -= F.mean() * rng.uniform(0.5, 1.0)
    return 0.4 * stall + size * F if c.area_1 == 0.0 else size * F


def draw_supply(rng, rig, seconds):
    """Supply pressure [Pa] on the grid `DT`: constant, or pulled down now and then,
    with a pump's slow ripple.
    """
    n = int(round((seconds + TAIL) / DT)) + 1
    if not rig.pulled:
        return np.full(n, rig.P_s)
    t = np.arange(n) * DT
    pull = np.zeros(n)
    for _ in range(int(seconds / 2.5)):
        i = rng.integers(0, n)
        pull[i : i + int(rng.uniform(0.3, 2.0) / DT)] = rng.uniform(0.05, 0.18)
    pull = gaussian_filter1d(pull, rng.uniform(0.05, 0.2) / DT)
    ripple = 0.008 * np.sin(2.0 * np.pi * (rng.uniform(0.5, 3.0) * t + rng.uniform()))
    return rig.P_s * (1.0 - pull + ripple)


def draw_dither(rng, rig, seconds):
    """Voltage [V] added to the command at the log's samples: a multisine that comes and
    goes.
    """
    n = int(round(seconds * rig.rate))
    t = np.arange(n) / rig.rate
    top = rng.uniform(0.01, 0.04) * rig.plant.u_max
    u = sum(
        np.sin(2.0 * np.pi * (f * t + rng.uniform()))
        for f in np.exp(rng.uniform(np.log(1.0), np.log(25.0), 5))
    )
    on = 0.5 * (
        1.0
        + np.sign(np.sin(2.0 * np.pi * (rng.uniform(0.1, 0.25) * t + rng.uniform())))
    )
    return top / np.sqrt(2.5) * u * gaussian_filter1d(on, 0.05 * rig.rate)


def start_pressures(rig, F, P_s):
    """Chamber pressures [Pa] at rest that hold the force `F` [N]."""
    c = rig.plant
    if c.area_1 == 0.0:
        return np.array([0.0, F / c.area_2])
    sum_ = P_s + c.P_r
    P_2 = (F + c.area_1 * sum_) / (c.area_1 + c.area_2)
    return np.array([sum_ - P_2, P_2])


def rig_file(rig, name, lie=None):
    """Text of the rig file. `lie`: factors on what the user has wrong, of "area",
    "P_s", "noise".
    """
    lie = lie or {}
    c = rig.plant

    def quoted(value, unit):
        return f'"{value:.6g}"' if unit == "1" else f'"{value:.6g} {unit}"'

    wrong = lie.get("area", 1.0)
    lines = [f'name = "{name}"', f'layout = "{rig.layout}"', "", "[geometry]"]
    if rig.layout == "differential":
        lines += [
            f"area_1 = {quoted(c.area_1 * wrong, 'm^2')}",
            f"area_2 = {quoted(c.area_2 * wrong, 'm^2')}",
        ]
    else:
        lines += [f"area = {quoted(c.area_2 * wrong, 'm^2')}"]
    lines += [f"chamber_length = {quoted(c.length, 'm')}"]
    if rig.by_angle:
        lines += [f"radius = {quoted(c.radius, 'm')}"]
    elif rig.x_mid + lie.get("x_mid", 0.0):
        lines += [f"x_mid = {quoted(rig.x_mid + lie.get('x_mid', 0.0), 'm')}"]
    lines += [
        "",
        "[supply]",
        f"P_s = {quoted(rig.P_s * lie.get('P_s', 1.0), 'Pa')}",
        f"P_r = {quoted(c.P_r, 'Pa')}",
    ]
    if rig.states_noise or "noise" in lie:
        lines += ["", "[sensors]"]
        for channel in ("P_a1", "P_a2", "F"):
            if channel == "P_a1" and c.area_1 == 0.0:
                continue
            unit = "N" if channel == "F" else "Pa"
            lines += [
                f"{channel} = "
                f"{quoted(total_noise(rig, channel) * lie.get('noise', 1.0), unit)}"
            ]
    lines += ["", "[parameters]"]
    for parameter, (unit, span) in PARAMETERS.items():
        if c.area_1 == 0.0 and parameter in ("c_p1", "c_n1", "delta_1"):
            continue
        held = rig.holds_offsets and parameter in ("delta_1", "delta_2")
        held = held or (rig.holds_k_v and parameter in ("k_vp", "k_vn"))
        if held:
            lines += [f"{parameter} = {quoted(getattr(c, parameter), unit)}"]
            continue
        low, high = span(c)
        start = rig.starts[parameter]
        lines += [
            f"{parameter} = {{ start = {quoted(start, unit)}, "
            f"range = [{quoted(low, unit)}, {quoted(high, unit)}] }}"
        ]
    return "\n".join(lines) + "\n"


def total_noise(rig, channel):
    """Standard deviation of a channel's noise, its quantisation included (SI)."""
    return float(np.hypot(rig.noise[channel], rig.lsb[channel] / np.sqrt(12.0)))
