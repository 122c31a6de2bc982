"""Proofs that the plant is right: `python -m benchmarks.blind.machines.verify`.

Prints one line per proof; exits 1 if one fails.
"""

import sys

import numpy as np
from scipy.integrate import cumulative_trapezoid, solve_ivp

from .effects import OUTSIDE, TABLE
from .make import SENSOR_EFFECTS, noise_of
from .plant import FIELDS, P_ATM, POLYTROPIC, load_force, parameters, run
from .rigs import STEP_RATE, draw_machine, joystick, simulate
from .sensors import DEFAULT, channels

SECONDS = 12
# what alone turns each effect off
SWITCH = {
    "valve_deadband": ("o_p1", "o_n1", "o_p2", "o_n2"),
    "flow_curve": ("e_flow",),
    "pressure_compensation": ("s_comp",),
    "counterbalance": ("cb_c",),
    "valve_delay": ("tau_u",),
    "valve_lag": ("omega_v",),
    "valve_rate_limit": ("r_v",),
    "valve_hysteresis": ("u_h",),
    "valve_bias": ("u_0",),
    "internal_leakage": ("c_il",),
    "external_leakage": ("c_el",),
    "dead_volume": ("V_0",),
    "entrained_air": ("alpha",),
    "supply_line_drop": ("k_s",),
    "signal_filter": ("filter_channels",),
    "stribeck": ("k_st",),
    "viscous_friction": ("b",),
    "pressure_friction": ("kappa",),
    "position_friction": ("pos_a",),
    "payload_inertia": ("m",),
    "gravity_load": ("w",),
    "pressure_sensor_bias": ("bias_1", "bias_2"),
    "pressure_sensor_lag": ("tau_P",),
    "channel_skew": ("skew_channel",),
    "backlash": ("gap",),
    "rod_compliance": ("compliance",),
    "relief_valve": ("rv_G",),
    "regenerative_valve": ("regen_c",),
    "accumulator_at_port": ("acc_c",),
    "hose_wave": ("hose_V",),
    "makeup_check_valve": ("makeup_c",),
    "one_way_leak": ("c_dl",),
    "boom_pad_friction": ("pad",),
    "oil_warming": ("therm_a",),
    "pump_ripple": ("ripple_P",),
    "other_consumer": ("other_P",),
    "flow_force": ("flow_force",),
}
# these reach their absent value at infinity, or through a limit that is itself stiff
NO_LIMIT = (
    "counterbalance",
    "valve_lag",
    "valve_rate_limit",
    "hose_wave",
    "backlash",
    "rod_compliance",
)


def example(seed, effect=None, strength=0.5):
    """A machine with at most one effect, and a short joystick run's plan and wanted
    positions.
    """
    rng = np.random.default_rng(seed)
    needs = (effect.needs_weight, effect.needs_level) if effect else (False, False)
    machine = draw_machine(rng, True, *needs)
    n = SECONDS * machine.rate + 1
    x_ref, v = joystick(rng, machine, n)
    command = -machine.plant["u_full"] * v / machine.speed
    if effect:
        record = simulate(machine, command, x_ref, True)[0]
        machine.lowest_P1, machine.highest_P2 = record[:, 0].min(), record[:, 1].max()
        drawn = effect.draw(
            machine, strength, {**{i: 0.3 + 0.1 * i for i in range(4)}, "style": 0.5}
        )
        machine.plant.update(drawn.plant)
        machine.sensor.update(drawn.sensor)
    return machine, command, x_ref


def dense(machine, command, x_ref, u=None, step_rate=STEP_RATE):
    """A run recorded at each step; with u given, that command and no operator."""
    p = machine.plant
    start = np.array([[machine.rest_P1, machine.rest_P2]])
    if u is None:
        u = simulate(machine, command, x_ref, True)[2]
    return run(
        parameters(**p),
        u,
        float(machine.rate),
        step_rate // machine.rate,
        1,
        np.zeros(7),
        x_ref,
        np.empty((0, 4)),
        start,
        0,
    )[0], u


def mass_balance(seed):
    """Largest mismatch (share of the oil moved) between the oil held in a chamber and
    what flowed in.
    """
    machine, command, x_ref = example(seed)
    machine.plant.update(alpha=0.0, c_il=1e-12, c_el=5e-13)
    p = machine.plant
    rec, _ = dense(machine, command, x_ref)
    worst = 0.0
    for i, (area, sign) in enumerate(((p["area_1"], -1.0), (p["area_2"], 1.0))):
        volume = area * (0.5 * p["stroke"] + p[f"delta_{i + 1}"] + sign * rec[:, 3])
        density = np.exp(rec[:, i] / p["beta"])
        moved = cumulative_trapezoid(
            density * rec[:, 8 + i], dx=1 / STEP_RATE, initial=0.0
        )
        held = density * volume
        worst = max(worst, np.abs(held - held[0] - moved).max() / np.ptp(moved))
    return worst


def force_balance(seed):
    """Largest mismatch (share of the largest force) of mass times acceleration, and
    largest friction over its level.
    """
    machine, command, x_ref = example(seed)
    machine.plant.update(m=0.02 * machine.plant["mass"], w=500.0, w_psi=0.2)
    p = machine.plant
    record = parameters(**p)[0]
    rec, _ = dense(machine, command, x_ref)
    load = np.array(
        [load_force(x, v, record) for x, v in zip(rec[:, 3], rec[:, 4], strict=True)]
    )
    newton = rec[:, 6] - load - p["mass"] * rec[:, 5]
    drive = p["area_2"] * rec[:, 1] - p["area_1"] * rec[:, 0]
    inside = (
        drive
        - rec[:, 6]
        - p["m"] * rec[:, 5]
        - p["w"] * np.sin(rec[:, 3] / p["w_radius"] + p["w_psi"])
    )
    dry = inside - p["k_0"] - p["b"] * rec[:, 4]
    drift = (
        np.abs(np.gradient(rec[:, 3], 1 / STEP_RATE) - rec[:, 4])[1:-1].max()
        / np.abs(rec[:, 4]).max()
    )
    return (
        np.abs(newton).max() / np.abs(rec[:, 6]).max(),
        np.abs(dry).max() / p["k_c"],
        drift,
    )


def second_code(seed):
    """RMS difference (in noise) to a plain model written again and solved by an
    adaptive stiff method.
    """
    machine, command, x_ref = example(seed)
    p = machine.plant
    rec, u = dense(machine, command, x_ref)
    t_u = np.arange(u.size) / machine.rate
    end = 4.0

    def root(g, dp):
        return g * dp / (dp**2 + 1e8) ** 0.25

    def beta(q):
        q = q + P_ATM
        return 1 / (
            1 / p["beta"]
            + p["alpha"] * (P_ATM / q) ** (1 / POLYTROPIC) / (POLYTROPIC * q)
        )

    def rates(t, s):
        p1, p2, x, v, z, y, yd, ps = s
        cmd = np.interp(t - p["tau_u"], t_u, u)
        if np.isfinite(p["omega_v"]):
            ydd = p["omega_v"] ** 2 * (cmd - y) - 2 * p["zeta_v"] * p["omega_v"] * yd
        else:
            y, yd, ydd = cmd, 0.0, 0.0
        q1i = root(p["c_p1"] * max(y - p["o_p1"], 0), ps - p1)
        q2o = root(p["c_n2"] * max(y - p["o_n2"], 0), p2 - p["P_r"])
        q2i = root(p["c_p2"] * max(-y - p["o_p2"], 0), ps - p2)
        q1o = root(p["c_n1"] * max(-y - p["o_n1"], 0), p1 - p["P_r"])
        force = (
            p["area_2"] * p2
            - p["area_1"] * p1
            - p["k_c"] * z / p["z_ss"]
            - p["k_0"]
            - p["b"] * v
        )
        load = (
            p["W"] * (1 + p["W_slope"] * x / p["stroke"])
            + p["load_b"] * v
            + p["load_c"] * np.tanh(v / 5e-3)
        )
        load += p["press_k"] * max(x - p["press_x"], 0)
        v1 = p["area_1"] * (p["stroke"] / 2 + p["delta_1"] - x)
        v2 = p["area_2"] * (p["stroke"] / 2 + p["delta_2"] + x)
        return [
            beta(p1) / v1 * (q1i - q1o + p["area_1"] * v),
            beta(p2) / v2 * (q2i - q2o - p["area_2"] * v),
            v,
            (force - load) / p["mass"],
            v - abs(v) * z / p["z_ss"],
            yd,
            ydd,
            (p["P_src"] - p["R_src"] * (q1i + q2i) - ps) / p["tau_src"],
        ]

    start = [machine.rest_P1, machine.rest_P2, x_ref[0], 0, 0, u[0], 0, p["P_src"]]
    atol = [1, 1, 1e-9, 1e-8, 1e-10, 1e-8, 1e-6, 1]
    grid = np.arange(int(end * 500)) / 500
    s = solve_ivp(
        rates,
        (0, end),
        start,
        "LSODA",
        grid,
        rtol=1e-7,
        atol=atol,
        max_step=1 / machine.rate,
    )
    ours = rec[:: STEP_RATE // 500][: grid.size]
    return max(
        np.sqrt(np.mean((s.y[i] - ours[:, i]) ** 2)) / noise_of(machine)["P_a1"]
        for i in (0, 1)
    )


def step_halving(seed, effect):
    """RMS change (in noise) of pressures and force when the step is halved, the command
    kept.
    """
    machine, command, x_ref = example(seed, effect)
    coarse, u = dense(machine, command, x_ref)
    fine, _ = dense(machine, command, x_ref, u, 2 * STEP_RATE)
    noise = noise_of(machine)
    rms = np.sqrt(np.mean((fine[::2] - coarse) ** 2, axis=0))
    return max(rms[0] / noise["P_a1"], rms[1] / noise["P_a2"], rms[6] / noise["F"])


def absent(seed, effect):
    """Largest change (Pa, N) of any channel that the effect leaves at its absent value,
    its other fields kept.
    """
    machine, command, x_ref = example(seed, effect)
    drawn = effect.draw(
        machine, 0.5, {**{i: 0.3 + 0.1 * i for i in range(4)}, "style": 0.5}
    )
    u = simulate(machine, command, x_ref, True)[2]
    if drawn.sensor:
        record, _ = dense(machine, command, x_ref, u)
        plain = channels(record, STEP_RATE, 10, {})
        off = channels(
            record,
            STEP_RATE,
            10,
            {**drawn.sensor, **{k: DEFAULT[k] for k in SWITCH[effect.name]}},
        )
        return max(np.abs(plain[k] - off[k]).max() for k in plain)
    rig = ("c_p1", "c_p2", "delta_1", "delta_2")
    kept = dict(machine.plant)
    machine.plant = {**kept, **{k: FIELDS[k] for k in drawn.plant if k not in rig}}
    plain, _ = dense(machine, command, x_ref, u)
    machine.plant = {**kept, **{k: FIELDS[k] for k in SWITCH[effect.name]}}
    off, _ = dense(machine, command, x_ref, u)
    return np.abs(plain - off).max()


def near(seed, effect):
    """RMS change (in noise) of the pressures at 1e-5 of the drawn effect: no jump at
    its absent value.
    """
    machine, command, x_ref = example(seed, effect)
    u = simulate(machine, command, x_ref, True)[2]
    kept = dict(machine.plant)
    off = {k: FIELDS[k] for k in SWITCH[effect.name]}
    machine.plant = {**kept, **off}
    plain, _ = dense(machine, command, x_ref, u)
    machine.plant.update(
        {k: absent_at + 1e-5 * (kept[k] - absent_at) for k, absent_at in off.items()}
    )
    faint, _ = dense(machine, command, x_ref, u)
    return np.sqrt(np.mean((faint - plain)[:, :2] ** 2)) / noise_of(machine)["P_a1"]


def main():
    """Run every proof."""
    failed = False

    def tell(name, value, bound):
        nonlocal failed
        failed |= not value <= bound
        print(
            f"{'ok  ' if value <= bound else 'FAIL'} {name}: {value:.3g} "
            f"(bound {bound:g})",
            flush=True,
        )

    for seed in range(3):
        tell(f"mass balance, machine {seed}", mass_balance(seed), 1e-5)
        newton, dry, drift = force_balance(seed)
        tell(f"force balance at the load, machine {seed}", newton, 1e-9)
        tell(f"dry friction over its level, machine {seed}", dry, 1.0 + 1e-6)
        tell(f"dx/dt against v, machine {seed}", drift, 1e-3)
        tell(f"second code, machine {seed}, in noise", second_code(seed), 0.05)
    for i, effect in enumerate(TABLE + OUTSIDE):
        tell(
            f"step halving, {effect.name}, in noise", step_halving(10 + i, effect), 0.05
        )
        tell(f"absent value, {effect.name}", absent(10 + i, effect), 0.0)
        if effect.name not in NO_LIMIT and effect.name not in SENSOR_EFFECTS:
            tell(f"fades out, {effect.name}, in noise", near(10 + i, effect), 0.05)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
