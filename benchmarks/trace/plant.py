"""The truth: cylinders with a real mass, many side by side in plain NumPy.

Chambers, bristle friction with presliding that depends on the output force, and a load
beyond the load cell that a position servo drives along a path. Positions and pressures
stand at a substep's ends, speeds and rates at its middle, which makes the scheme of
second order. The piston and the load move as one, except where a rod gives or a pin has
play: then the piston has a mass of its own.

Conventions where a law leaves room: pressures are gauge; Stribeck and damping stand
inside the sliding friction and fade with it in presliding, of `viscous_friction` all
but the share s; presliding sees the piston's force, before gravity and inertia of what
lies ahead of the load cell;
P_s is logged ahead of the supply line; the film of `frictional_lag` follows the speed,
whatever its sign, friction keeps the bristle's sign, and both its viscous part and
Stribeck's follow the film.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .catalogue import Effects
from .hidden import Hidden
from .unnamed import Unnamed

OMEGA, DAMPING = 320.0, 0.6  # of the motion drive with the nominal mass
MASS = 80.0  # kg, load beyond the load cell
L_SLOPE, L_RATE = 300.0, 10.0  # s/m, 1/s
P_0 = 101_325.0  # Pa

Rig = Mapping[str, float]


@dataclass(frozen=True)
class Lane:
    """One log to record; SI.

    Attributes:
        rig: true values; `nominal`: what the controller knows.
        effects: hidden effects and their parameters.
        style: how it is excited; see `excitation.STYLES`.
        noise: the sensors' kind of noise; see `excitation.NOISES`.
        mass: kg, of the load beyond the load cell.
        supply: Pa, mean supply pressure.
        bits: of the joint's encoder, on a turn.
    """

    rig: Rig
    nominal: Rig
    effects: Effects = field(default_factory=dict)
    seed: int = 0
    style: str = "fit_1"
    noise: str = "white"
    mass: float = MASS
    supply: float = 14e6
    bits: int = 23


class Plant:
    """All lanes' states and laws; arrays are [L], pressures and flows [2, L]."""

    def __init__(self, lanes: Sequence[Lane], step: float):
        self.e = e = Hidden([lane.effects for lane in lanes])
        self.odd = Unnamed(e, step)
        self.step = step
        self.r = {n: np.array([la.rig[n] for la in lanes]) for n in lanes[0].rig}
        r = self.r
        self.mass = np.array([la.mass for la in lanes]) + e("payload_inertia", "m")
        self.K, self.D = MASS * OMEGA**2, 2 * DAMPING * MASS * OMEGA
        self.c = np.array([[r["c_p1"], r["c_p2"]], [r["c_n1"], r["c_n2"]]])
        offsets = np.array([r["delta_1"], r["delta_2"]])
        spare = e("dead_volume", "V_0")
        self.area = np.array([r["area_1"], r["area_2"]])
        self.volume = self.area * (r["chamber_length"] / 2 + offsets) + spare
        self.toward = self.area * np.array([[-1.0], [1.0]])  # dV/dx
        self.core = np.maximum(e("orifice_transition", "dP_t"), 1.0) ** 2
        losses = e("supply_line_drop", "k_s"), e("return_line_drop", "k_r")
        self.loss = np.array(losses)[:, None]
        k, gap = e("rod_compliance", "k"), e("backlash", "b")
        self.two = np.isfinite(k) | (gap > 0)
        # A pin with play is otherwise stiff; the piston's mass is as small as the step
        # allows, for what it hides from the load cell is no part of the effect.
        self.rod = np.where(np.isfinite(k), k, 2e8)
        # Where only play is hidden the encoder stands ahead of the pin's own give.
        self.sees_give, self.squeeze = ~np.isfinite(k) & (gap > 0), np.zeros(len(lanes))
        self.gap, self.own = gap / 2, np.where(gap > 0, 2.0, 1.0)  # m, kg
        # Friction that falls with speed (k_v) would make a light piston chatter, and so
        # would a dry pin: the oil in its play is squeezed.
        self.damp = np.where(gap > 0, 1.4e4, 8e3)  # N s/m
        n = len(lanes)
        self.z, self.slow, self.film, self.rest, self.way = np.zeros((5, n))
        self.x = self.v = self.x_p = self.v_p = np.zeros(n)
        self.P = self.rates = np.zeros((2, n))

    def start(self, x, v, P) -> None:
        """Load and piston at `x` with speed `v`, chambers at `P`."""
        self.x, self.v, self.P = x, v, P
        self.x_p, self.v_p = x, v

    @property
    def encoder(self) -> np.ndarray:
        """Position that the joint's encoder stands for, m."""
        e, x = self.e, self.x + np.where(self.sees_give, self.squeeze, 0.0)
        angle = 2 * np.pi * x / e("eccentric_joint", "wavelength")
        return x + e("eccentric_joint", "e") * np.sin(angle)

    # -- hydraulics --

    def conductances(self, t: float, edges: np.ndarray) -> np.ndarray:
        """Of the four edges in each substep of a tick, m^3/(s Pa^0.5)."""
        e, g = self.e, self.c * edges
        if e.has("warming_valve"):
            tau, a = e("warming_valve", "tau"), e("warming_valve", "a")
            g = g * (1 - a * np.expm1(-t / tau))
        if e.has("supply_line_drop", "return_line_drop"):
            g = g / np.sqrt(1 + self.loss * g * g)
        return g

    def pressure_rates(self, P, P_s, x, v, g, t=0.0) -> np.ndarray:
        """Pressure rates [2, L] (12)-(15) at one instant `t`, Pa/s."""
        e, P_r = self.e, self.r["P_r"]
        drop = np.array([P_s - P, P - P_r])
        flow = g * drop / np.sqrt(np.sqrt(drop * drop + self.core))
        if e.has("spool_flow_force"):
            flow = flow / (1 + e("spool_flow_force", "k_q") * np.abs(drop))
        q = flow[0] - flow[1] - self.toward * v + self.odd.flow(t, P, P_r, x, v)
        if e.has("internal_leakage", "external_leakage", "scored_bore"):
            score = np.exp(-((x / e("scored_bore", "width")) ** 2))
            leak = e("internal_leakage", "c_il") + e("scored_bore", "c_il") * score
            cross = leak * (P[0] - P[1])
            q = q - e("external_leakage", "c_el") * (P - P_r)
            q = q + np.array([-cross, cross])
        if e.has("port_relief"):
            g, setting = (
                np.array([e("port_relief", f"{name}{port}") for port in (1, 2)])
                for name in ("g_", "P_set")
            )
            q = q - g * np.maximum(P - P_r - setting, 0)
        soft = 1 / self.r["beta"]
        if e.has("entrained_air"):
            n, p = e("entrained_air", "n"), np.maximum(P, 0.0) + P_0
            soft = soft + e("entrained_air", "alpha") * (P_0 / p) ** (1 / n) / (n * p)
        soft = self.odd.soft(t, P, soft)
        return q / (soft * (self.volume + self.toward * x))

    # -- friction and force --

    def sliding(self, t: float, x, v, P) -> np.ndarray:
        """Sliding friction (3) with what the effects add, N."""
        e, r, z = self.e, self.r, self.z
        turn = np.clip(z / r["z_ss"], -1, 1)
        level = np.where(z > 0, r["k_cp"], r["k_cn"])
        if e.has("stribeck"):
            width, speed = e("stribeck", "v_s"), v
            if e.has("frictional_lag"):
                speed = np.where(e("frictional_lag", "tau_h") > 0, self.film, v)
            level = level + e("stribeck", "k_st") * np.exp(-((speed / width) ** 2))
        if e.has("position_friction"):
            angle = 2 * np.pi * x / e("position_friction", "wavelength")
            level = level * (1 + e("position_friction", "a") * np.sin(angle))
        if e.has("friction_drift"):
            fade = np.expm1(-t / e("friction_drift", "tau"))
            level = level * (1 + e("friction_drift", "a") * fade)
        if e.has("dwell_friction"):
            level = level * (1 + e("dwell_friction", "a") * self.rest)
        if e.has("side_load"):
            swing = np.abs(np.sin(2 * np.pi * e("side_load", "hertz") * t))
            level = level * (1 + e("side_load", "a") * swing)
        if e.has("pressure_friction"):
            viscous = e("pressure_friction", "kappa_v") * np.abs(v)
            level = level + (e("pressure_friction", "kappa") + viscous) * P.mean(0)
        if e.has("settling_friction"):
            left = np.exp(-self.way / e("settling_friction", "way"))
            level = level * (1 + e("settling_friction", "a") * left)
        if e.has("swollen_land"):
            swollen = np.exp(-((x / e("swollen_land", "width")) ** 2))
            level = level + e("swollen_land", "kappa") * swollen * P.mean(0)
        level = level + self.odd.level(x, v, P)
        fall = np.where(v > 0, r["k_vp"], r["k_vn"])
        out = turn * level + r["k_0"] - fall * v + e("viscous_friction", "b") * v
        out = out + self.odd.friction(t, v)
        if e.has("tapered_bore"):
            out = out + e("tapered_bore", "b") * x * v
        if e.has("film_friction"):
            by_pressure = e("film_friction", "kappa_h") * P.mean(0)
            power = (np.abs(v) / 0.01) ** e("film_friction", "n")
            out = out + np.sign(v) * (e("film_friction", "k_h") + by_pressure) * power
        if e.has("frictional_lag"):
            # Speed acts through the film, whose thickness follows it late.
            behind = np.where(e("frictional_lag", "tau_h") > 0, self.film - abs(v), 0)
            out = out - turn * fall * behind
        if e.has("bristle_damping"):
            rate = v - np.abs(v) * z / r["z_ss"]
            out = out + e("bristle_damping", "sigma_1") * rate
        return out

    def forces(self, t: float, other, servo) -> tuple[np.ndarray, ...]:
        """Load cell's force and the accelerations of load and piston, N, m/s^2.

        `servo` is what the motion drive would push with at x = v = 0, `other` an
        unlogged force of unit RMS. Speeds are those at the substep's end.
        """
        e, r = self.e, self.r
        f_c = self.sliding(t, self.x_p, self.v_p, self.P)
        ell = 1 / (1 + (L_SLOPE * self.slow) ** 3)
        ell = (1 - e("friction_at_rest", "s")) * ell
        viscous = e("viscous_friction", "s") * e("viscous_friction", "b") * self.v_p
        net = (self.toward * self.P).sum(0) - (1 - ell) * f_c - ell * viscous
        push = np.where(net > 0, r["k_fp"], r["k_fn"]) * ell
        size = np.abs(net)
        half = 1 + push - r["delta"] * size
        root = half + np.sqrt(half * half + 4 * r["delta"] * size)
        piston = np.copysign(2 * size / root, net)
        a_p = np.zeros_like(net)
        if self.two.any():
            apart = self.x_p - self.x
            self.squeeze = apart - np.clip(apart, -self.gap, self.gap)
            rod = self.rod * self.squeeze + self.damp * (self.v_p - self.v)
            k_f = np.where(rod > 0, r["k_fp"], r["k_fn"])
            held = ell * k_f * rod / (1 + r["delta"] * np.abs(rod))
            a_p = np.where(self.two, (net - held - rod) / self.own, 0.0)
            piston = np.where(self.two, rod, piston)
        if e.has("gravity_load"):
            angle = self.x / r["radius"] + e("gravity_load", "psi_0")
            piston = piston + e("gravity_load", "w") * np.sin(angle)
        if e.has("end_cushion"):
            into = np.maximum(self.x - e("end_cushion", "x_from"), 0.0)
            piston = piston - e("end_cushion", "k") * into
        piston = piston + self.odd.force(t, self.x, self.v)
        push_back = servo - self.K * self.x - self.D * self.v
        a = (piston + push_back) / self.mass
        cell = piston - e("payload_inertia", "m") * a
        return cell + e("loadcell_crosstalk", "force") * other, a, a_p

    def advance(self, a, a_p, P_s, g, t=0.0) -> None:
        """Everything but the valve over one substep; `P_s`, `g`, `t` at its middle."""
        h, r, e = self.step, self.r, self.e
        v = self._half(self.v, self._a, a)
        v_p = np.where(self.two, self._half(self.v_p, self._a_p, a_p), v)
        middle = self.P + h / 2 * self.rates
        x = self.x_p + h / 2 * v_p
        self.rates = self.pressure_rates(middle, P_s, x, v_p, g, t)
        self.P = self.P + h * self.rates
        keep, speed = np.exp(-np.abs(h * v_p) / r["z_ss"]), np.abs(v_p)
        z = keep * self.z + np.sign(v_p) * r["z_ss"] * (1 - keep)
        self.way = np.where(z * self.z > 0, self.way + h * speed, 0.0)
        self.z = z
        self.slow = self.slow + h * L_RATE * (speed - self.slow)
        if e.has("frictional_lag"):
            tau = np.maximum(e("frictional_lag", "tau_h"), h)
            self.film = self.film + h / tau * (speed - self.film)
        if e.has("dwell_friction"):
            still = 1 / (1 + (speed / e("dwell_friction", "v_d")) ** 2)
            tau = e("dwell_friction", "tau")
            self.rest = self.rest + h / tau * (still - self.rest)
        self.x = self.x + h * v
        self.x_p = np.where(self.two, self.x_p + h * v_p, self.x)
        self.odd.follow(self.x_p, v_p, self.z, self.P)
        self._a, self._a_p = a, a_p
        self.v = v + h / 2 * a
        self.v_p = np.where(self.two, v_p + h / 2 * a_p, self.v)

    _a: np.ndarray | None = None
    _a_p: np.ndarray | None = None

    def _half(self, v, before, now) -> np.ndarray:
        """Speed at the next half step, from its forecast at this whole one."""
        if before is None:  # the first step starts from a speed that is known
            before = now
        return v - self.step / 2 * before + self.step * now
