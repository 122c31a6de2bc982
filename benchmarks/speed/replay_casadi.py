"""The replay over windows and its Jacobian in CasADi, interpreted.

One tick is an SX function; a window's pressures accumulate it, windows are mapped over
threads. The spool has no parameter among the sixteen: its openings are worked out once.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from types import SimpleNamespace

import casadi as ca
import numpy as np
from jaxtyping import ArrayLike

from hydrojax.plant.rig import PARTS
from hydrojax.plant.valve import LAMINAR_CORE

from .numbers import Numbers, worked_out
from .plain import spool_step
from .replays import NAMES, Replay, ahead, from_ticks, start


def _symbols(begun: Numbers) -> tuple[ca.SX, SimpleNamespace]:
    """The sixteen parameters, and the plant's numbers made of them."""
    params = ca.SX.sym("p", len(NAMES))
    n = {name: float(v) for name, v in begun.items()}
    n |= {name: params[i] for i, name in enumerate(NAMES)}
    n |= {f"half_{i}": n["half"] + n[f"delta_{i}"] for i in (1, 2)}
    return params, SimpleNamespace(**(n | worked_out(n)))


def _root_flow(drop: ca.SX) -> ca.SX:
    return drop / ca.sqrt(ca.sqrt(drop * drop + LAMINAR_CORE**2))


def _rates(n: SimpleNamespace, P: ca.SX, opening: ca.SX, line: ca.SX, x, v) -> ca.SX:
    q_1 = n.d_p1 * opening[0] * _root_flow(line[0] - P[0])
    q_1 -= n.d_n1 * opening[1] * _root_flow(P[0] - line[1])
    q_2 = n.d_p2 * opening[1] * _root_flow(line[0] - P[1])
    q_2 -= n.d_n2 * opening[0] * _root_flow(P[1] - line[1])
    rate_1, rate_2 = (q_1 + v) / (n.half_1 - x), (q_2 - v) / (n.half_2 + x)
    return n.beta * ca.vertcat(rate_1, rate_2)


def _root_slope(drop: ca.SX) -> ca.SX:
    a = drop * drop + LAMINAR_CORE**2
    return (0.5 + 0.5 * LAMINAR_CORE**2 / a) / ca.sqrt(ca.sqrt(a))


def _settling(n: SimpleNamespace, P: ca.SX, opening: ca.SX, line: ca.SX, x) -> ca.SX:
    """Twice the slopes by which the pressures settle, 1/s."""
    b_1 = n.d_p1 * opening[0] * _root_slope(line[0] - P[0])
    b_1 += n.d_n1 * opening[1] * _root_slope(P[0] - line[1])
    b_2 = n.d_p2 * opening[1] * _root_slope(line[0] - P[1])
    b_2 += n.d_n2 * opening[0] * _root_slope(P[1] - line[1])
    return 2 * n.beta * ca.vertcat(b_1 / (n.half_1 - x), b_2 / (n.half_2 + x))


def _relaxed(z: ca.SX) -> ca.SX:
    """(1 - e^-z) / z, of third order."""
    beyond = z * (1 / 2 + z / 6)
    return (1 + beyond) / (1 + z * (1 + beyond))


def _tick(begun: Numbers, substeps: int) -> ca.Function:
    """(P, given, params) -> P after a tick; `given` is (openings, h, lines, places)."""
    params, n = _symbols(begun)
    P = first = ca.SX.sym("P", 2)
    given = ca.SX.sym("given", 7 + 2 * substeps + 1)
    opening, h, x = given[:2], given[2] / substeps, given[7:]
    line, gone = given[3:5], given[5:7] - given[3:5]
    for k in range(0, 2 * substeps, 2):
        at, later = (line + (k + i) / (2 * substeps) * gone for i in (0, 1))
        v = (x[k + 2] - x[k]) / h
        settling = _settling(n, P, opening, at, x[k])
        moved = _rates(n, P, opening, at, x[k], v) * h / 2 * _relaxed(settling * h / 2)
        rate = _rates(n, P + moved, opening, later, x[k + 1], v)
        P = P + h * _relaxed(settling * h) * (rate + settling * moved)
    return ca.Function("tick", [first, given, params], [P])


def _bristle(begun: Numbers, quarters: int) -> ca.Function:
    """(z, dx, params) -> z after a tick."""
    params, n = _symbols(begun)
    z = first = ca.SX.sym("z")
    dx = ca.SX.sym("dx", quarters)
    for q in range(quarters):
        keep = ca.exp(-ca.fabs(dx[q]) * n.per_z_ss)
        z = keep * z + ca.sign(dx[q]) * n.z_ss * (1 - keep)
    return ca.Function("bristle", [first, dx, params], [z])


def _force(begun: Numbers) -> ca.Function:
    """(P, z, (v, L), params) -> F."""
    params, n = _symbols(begun)
    P, z, given = ca.SX.sym("P", 2), ca.SX.sym("z"), ca.SX.sym("given", 2)
    v, L = given[0], given[1]
    turn = ca.fmin(ca.fmax(z * n.per_z_ss, -1), 1)
    f_c = turn * ca.if_else(z > 0, n.k_cp, n.k_cn) + n.k_0
    f_c -= ca.if_else(v > 0, n.k_vp, n.k_vn) * v
    drive = n.act_2 * P[1] - n.act_1 * P[0] - (1 - L) * f_c
    size = ca.fabs(drive)
    b = 1 + L * ca.if_else(drive > 0, n.k_fp, n.k_fn) - n.delta * size
    disc = ca.sqrt(b * b + 4 * n.delta * size)
    F = ca.if_else(b > 0, 2 * size / (b + disc), (disc - b) / (2 * n.delta))
    return ca.Function("force", [P, z, given, params], [ca.sign(drive) * F])


def openings(given: Replay, begun: Numbers) -> np.ndarray:
    """The valve's mean openings toward either side, [W, ticks - 1, 2]."""
    u, before = np.asarray(given.windows.u), ahead(given)
    if not given.lag:
        return np.stack([np.maximum(u, 0), np.maximum(-u, 0)], axis=-1)[:, :-1]
    p, out = SimpleNamespace(**begun), []
    along = np.concatenate([before, u[:, :-1]], axis=1)
    y, rate = along[:, 0], np.zeros(len(along))
    for command in along.T:
        sums = np.zeros((len(along), 2))
        for _ in range(PARTS):
            y, rate, mean = spool_step(p, y, rate, command)
            sums += np.stack([np.maximum(mean, 0), np.maximum(-mean, 0)], axis=-1)
        out.append(sums / PARTS)
    return np.stack(out[before.shape[1] :], axis=1)


def switches(given: Replay, begun: Numbers) -> np.ndarray:
    """L(t) at all ticks of all segments, [S N]."""
    m, out = given.motion, []
    speed = np.asarray(m.speed0, float)
    out.append(speed)
    for i in range(m.h.shape[1]):
        quarter = m.h[:, i] / m.dx.shape[2]
        keep = np.exp(-begun["L_rate"] * quarter)
        for q in range(m.dx.shape[2]):
            speed = keep * speed + (1 - keep) * np.abs(m.dx[:, i, q]) / quarter
        out.append(speed)
    speeds = np.stack(out, axis=1).ravel()
    return 1 / (1 + (begun["L_slope"] * speeds) ** 3)


@dataclass(frozen=True)
class Compiled:
    """A log as CasADi's functions of the parameters."""

    shape: tuple[int, int, int]  # windows, ticks, ticks that are compared
    run: ca.Function
    derive: ca.Function

    def _scored(self, flat: np.ndarray) -> np.ndarray:
        windows, ticks, scored = self.shape
        return flat.reshape(windows, ticks, 3, -1)[:, ticks - scored :]

    def replay(self, params: ArrayLike) -> np.ndarray:
        """P_a1, P_a2, F, [W, T, 3], at `params` [16] (`NAMES`), SI."""
        return self._scored(np.asarray(self.run(np.asarray(params, float))))[..., 0]

    def jacobian(self, params: ArrayLike) -> np.ndarray:
        """Its exact derivative, [W, T, 3, 16], by forward sensitivities."""
        return self._scored(self.derive(np.asarray(params, float)).toarray())


def prepare(given: Replay, threads: int | None = None) -> Compiled:
    """A replay in CasADi, ready to be run; see `replay_c.prepare`."""
    begun, w, m = start(given), given.windows, given.motion
    (windows, ticks), workers = np.shape(w.u), threads or os.cpu_count() or 1
    where = from_ticks(given)[:, None] + np.arange(ticks)
    h = np.asarray(w.h)[:, :-1, None]
    lines = np.stack([w.P_s[:, :-1], w.P_r[:, :-1], w.P_s[:, 1:], w.P_r[:, 1:]], -1)
    along = np.concatenate([openings(given, begun), h, lines, w.x_fine], axis=-1)
    along = along.reshape(-1, along.shape[-1]).T
    beside = np.stack([np.asarray(w.v), switches(given, begun)[where]], -1)

    def mapped(one: ca.Function, count: int) -> ca.Function:
        return one.map(count, "thread", workers) if workers > 1 else one.map(count)

    params = ca.MX.sym("params", len(NAMES))
    scenario = _bristle(begun, m.dx.shape[2]).mapaccum("course", m.dx.shape[1])
    z = [
        ca.horzcat(0, scenario(0, dx.T, ca.repmat(params, 1, len(dx))))
        for dx in np.asarray(m.dx)
    ]
    window = _tick(begun, (w.x_fine.shape[-1] - 1) // 2).mapaccum("window", ticks - 1)
    many = ca.repmat(params, 1, windows * (ticks - 1))
    first = ca.DM(np.asarray(given.P_0).T)
    later = ca.horzsplit(mapped(window, windows)(first, along, many), ticks - 1)
    P = ca.horzcat(*(ca.horzcat(first[:, i], p) for i, p in enumerate(later)))
    z = ca.horzcat(*z)[0, where.ravel().tolist()]
    force = mapped(_force(begun), windows * ticks)
    every = ca.repmat(params, 1, windows * ticks)
    F = force(P, z, beside.reshape(-1, 2).T, every)
    out = ca.vec(ca.vertcat(P, F))
    run = ca.Function("replay", [params], [out])
    # Sixteen directions at once, dense: coloured Jacobians would first look for zeros.
    forward = run.forward(len(NAMES))(params, out, ca.DM.eye(len(NAMES)))
    derive = ca.Function("jacobian", [params], [forward])
    return Compiled((windows, ticks, w.scored), run, derive)
