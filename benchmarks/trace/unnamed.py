"""Laws that no vocabulary names, at every place of the signal path, in plain NumPy.

Each is what an engineer meets on a rig and no list of effects has; absent, it adds
nothing. Arrays are [L] over lanes, pressures and flows [2, L]; SI, commands in V.
"""

from __future__ import annotations

import numpy as np

from .hidden import Hidden


def _stop(w: np.ndarray, moved: np.ndarray, reach: np.ndarray) -> np.ndarray:
    return np.clip(w + moved, -reach, reach)


class Unnamed:
    """What these laws remember, and what they add; `step` (s) is a substep's length."""

    def __init__(self, hidden: Hidden, step: float):
        self.e, self.step = hidden, step
        n = hidden.lanes
        self.z_side, self.since, self.travel, self.age, self.roll = np.zeros((5, n))
        self.x_slow, self.force_seen, self.cell_slow, self.cell_stop = np.zeros((4, n))
        self.P_slow: np.ndarray | None = None
        self.lagged, self.spring, self.stuck, self.before = np.zeros((4, n))

    # -- on the command's way --

    def command(self, t: float, P_s: np.ndarray, spool: np.ndarray) -> np.ndarray:
        """The spool [substeps, L] over a tick that begins at `t` under a supply."""
        e = self.e
        if e.has("drifting_null"):
            fade = -np.expm1(-max(t, 0.0) / e("drifting_null", "tau"))
            spool = spool + e("drifting_null", "u_0") * fade
        if e.has("pressure_null"):
            spool = spool + e("pressure_null", "u_0") * (P_s / 14e6 - 1)
        if e.has("notched_spool"):
            near = np.exp(-np.abs(spool) / e("notched_spool", "width"))
            spool = spool - e("notched_spool", "k") * spool * near
        if e.has("coarse_converter"):
            lsb = e("coarse_converter", "lsb")
            safe = np.where(lsb > 0, lsb, 1.0)
            spool = np.where(lsb > 0, np.round(spool / safe) * safe, spool)
        if e.has("sticking_spool", "sprung_linkage", "simple_spool"):
            spool = np.stack([self._through(u) for u in spool])
        return spool

    def _through(self, u: np.ndarray) -> np.ndarray:
        """One substep of what remembers the command."""
        e = self.e
        moves = np.abs(u - self.stuck) > e("sticking_spool", "u_s")
        self.stuck = u = np.where(moves, u, self.stuck)
        reach = e("sprung_linkage", "reach")
        self.spring = _stop(self.spring, u - self.before, reach)
        self.before = u
        u = u - e("sprung_linkage", "k") * (self.spring / reach) ** 3
        tau = e("simple_spool", "tau")
        fade = -np.expm1(-self.step / np.maximum(tau, 1e-9))
        self.lagged = self.lagged + fade * (u - self.lagged)
        return self.lagged

    # -- in the chambers --

    def flow(self, t: float, P, P_r, x, v) -> np.ndarray:
        """Flows [2, L] into the chambers, m^3/s."""
        e, apart = self.e, P[0] - P[1]
        cross = e("one_way_seal", "c") * np.maximum(apart, 0.0)
        cross = cross + e("cracked_piston", "k") * np.sign(apart) * np.sqrt(abs(apart))
        reach = np.maximum(x - e("bell_mouthed_bore", "x_from"), 0.0)
        cross = cross + e("bell_mouthed_bore", "c") * reach * apart
        warm = -np.expm1(-max(t, 0.0) / e("warming_seal", "tau"))
        cross = cross + e("warming_seal", "c") * warm * apart
        out = e("dragged_oil", "k") * np.abs(v) * np.ones((2, 1))
        hole = np.sqrt(np.maximum(P[0] - P_r, 0.0))
        first = out[0] + e("weeping_rod", "k") * hole + cross
        q = -np.array([first, out[1] - cross])
        if e.has("creeping_hose") and self.P_slow is not None:
            gap = (P - self.P_slow) / e("creeping_hose", "tau")
            q = q - e("creeping_hose", "C") * gap
        return q

    def soft(self, t: float, P, soft) -> np.ndarray:
        """Compliance [2, L] with what is added to `soft`, 1/Pa."""
        e = self.e
        cold = np.expm1(-max(t, 0.0) / e("warming_oil", "tau"))
        soft = soft * (1 - e("warming_oil", "a") * cold)
        soft = soft + e("softening_hose", "k") * P
        full = e("gas_pocket", "P_0")
        pocket = np.where(full < P, (full / np.maximum(P, 1.0)) ** 2, 0.0)
        return soft + e("gas_pocket", "c") * pocket

    # -- in friction and force --

    def level(self, x, v, P) -> np.ndarray:
        """What is added to the Coulomb level, N."""
        e = self.e
        out = e("lip_seal", "kappa") * P[0]
        out = out + e("wiper_pressure", "kappa") * np.abs(P[0] - P[1])
        over = np.tanh((x - e("rusty_patch", "x_from")) / 3e-4)
        out = out + e("rusty_patch", "f") * (1 + over) / 2
        bell = np.exp(-((v / e("one_way_stribeck", "v_s")) ** 2))
        out = out + e("one_way_stribeck", "f") * bell * (v > 0)
        rest = np.exp(-self.since / e("relaxing_seal", "tau"))
        out = out + e("relaxing_seal", "f") * rest
        worn = -np.expm1(-self.travel / e("polished_bore", "way"))
        out = out - e("polished_bore", "f") * worn
        old = np.log1p(self.age / e("rate_and_state", "theta"))
        out = out + e("rate_and_state", "f") * old
        return out + e("loaded_bearing", "mu") * np.abs(self.force_seen)

    def friction(self, t: float, v) -> np.ndarray:
        """What is added to the friction force, N."""
        e = self.e
        cold = np.exp(-max(t, 0.0) / e("thick_oil", "tau"))
        drag = e("quadratic_drag", "c") * np.abs(v)
        return (drag + e("thick_oil", "b") * cold) * v

    def force(self, t: float, x, v) -> np.ndarray:
        """What is added to the force between piston and load cell, N."""
        e = self.e
        angle = 2 * np.pi * x / e("rack_cogging", "pitch")
        out = -e("rack_cogging", "f") * np.sin(angle)
        out = out - e("hardening_spring", "k") * x**3
        out = out - e("tether_drag", "c") * np.abs(v) * v
        shake = np.sin(2 * np.pi * e("pump_shake", "hertz") * t)
        out = out + e("pump_shake", "f") * shake
        out = (
            out - e("rolling_seal", "f") * (self.roll / e("rolling_seal", "reach")) ** 3
        )
        return out - e("soft_hose", "k") * (x - self.x_slow)

    # -- in what is read --

    def read(self, t: float, y: np.ndarray, tick: float) -> np.ndarray:
        """Readings [3, L] of P_a1, P_a2 and F at a tick."""
        e = self.e
        p_1, p_2, F = y
        late = max(t, 0.0)
        warm = -np.expm1(-late / e("warming_gauge", "tau"))
        p_1 = p_1 + e("warming_gauge", "b") * warm + e("bent_gauge", "c") * p_1**2
        warm = -np.expm1(-late / e("warming_cell", "tau"))
        shown = (
            F + e("warming_cell", "b") * warm + e("bent_bridge", "c") * F * np.abs(F)
        )
        reach = e("sticky_cell", "reach")
        self.cell_stop = _stop(self.cell_stop, F - self.force_seen, reach)
        share = tick / e("creeping_cell", "tau")
        self.cell_slow = self.cell_slow + share * (F - self.cell_slow)
        shown = shown - e("sticky_cell", "a") * self.cell_stop
        self.force_seen = F
        return np.array([p_1, p_2, shown + e("creeping_cell", "a") * self.cell_slow])

    # -- what is remembered --

    def follow(self, x, v, z, P) -> None:
        """One substep, over which the piston goes on at `v` and ends at `x`."""
        e, h = self.e, self.step
        turned = z * self.z_side < 0
        self.z_side = np.where(z == 0, self.z_side, z)
        self.since = np.where(turned, 0.0, self.since + h)
        self.travel = self.travel + h * np.abs(v)
        self.age = self.age + h * (1 - np.abs(v) * self.age / e("rate_and_state", "D"))
        self.roll = _stop(self.roll, h * v, e("rolling_seal", "reach"))
        self.x_slow = self.x_slow + h / e("soft_hose", "tau") * (x - self.x_slow)
        slow = P if self.P_slow is None else self.P_slow
        self.P_slow = slow + h / e("creeping_hose", "tau") * (P - slow)
