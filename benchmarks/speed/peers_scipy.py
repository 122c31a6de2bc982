"""The closed loop by `scipy.integrate.solve_ivp`, from sample to sample.

The plant is an ordinary differential equation in continuous time: two pressures, the
bristle, the filtered speed, the spool and its rate. The law is called at each sample.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
from scipy.integrate import solve_ivp

from hydrojax.control.loop import Loop, Scenario
from hydrojax.control.simulation import PARTS

from .numbers import columns, delay
from .plain import begin, decide, force, pressure_rates, record

RTOL = 1e-6
ATOL = np.array([10.0, 10.0, 1e-9, 1e-6, 1e-4, 1e-4])
"""Pa, Pa, m, m/s, and the spool's place and its rate times tau, V."""


def plant_rates(t, y, p, u, P_s, P_r, x):
    """What the plant does `t` seconds into a sample; `P_s`, `P_r`, `x` lead it."""
    P_1, P_2, z, speed, place, rate = y
    part = min(int(t / p.h * PARTS), PARTS - 1)
    # The motion over a part is the parabola through its start, middle and end.
    a, b, c = x[part]
    s = t / p.h * PARTS - part
    place_x = a + s * (4 * b - 3 * a - c + s * 2 * (a - 2 * b + c))
    v = (4 * b - 3 * a - c + 4 * s * (a - 2 * b + c)) * PARTS / p.h
    line = P_s[0] + t / p.h * (P_s[1] - P_s[0]), P_r[0] + t / p.h * (P_r[1] - P_r[0])
    open_p, open_n = max(place, 0.0), max(-place, 0.0)
    return (
        *pressure_rates(p, open_p, open_n, (P_1, P_2), line, place_x, v),
        v - abs(v) / p.z_ss * z,
        p.L_rate * (abs(v) - speed),
        rate / p.tau,
        (u - place - 2 * p.zeta * rate) / p.tau,
    )


def _sample(p: SimpleNamespace, y, spans, commands, given):
    """The plant over one sample, in as many calls as commands act in it."""
    for (start, end), u in zip(spans, commands, strict=True):
        done = solve_ivp(
            plant_rates, (start, end), y, "RK45", rtol=RTOL, atol=ATOL,
            args=(p, u, *given),
        )  # fmt: skip
        y = done.y[:, -1]
    return y


def prepare(loop: Loop, scenario: Scenario) -> Callable[[], np.ndarray]:
    """A closed loop in scipy; what it returns runs it and gives the true F [N], N.

    Raises:
        ValueError: more than one instance, or no valve_lag.
    """
    p = record(loop)
    if not p.tau > 0:
        raise ValueError("this peer wants a valve_lag")
    whole, share = delay(loop.rig, p.h / PARTS)
    late = (whole + share) * p.h / PARTS
    back = math.floor(late / p.h)
    cut = late - back * p.h
    F_d, noise, supply, returned, x, v = (a.tolist() for a in columns(scenario))
    spans = [(0.0, p.h)] if cut == 0 else [(0.0, cut), (cut, p.h)]

    def call() -> np.ndarray:
        e, row, out = np.empty(9), np.empty(7), np.empty(len(F_d))
        first = (x[0][0][1] - x[0][0][0]) / (p.h / PARTS / 2)
        P_1, P_2, F, memory = begin(p, F_d[0], x[0][0][0], first, e, row)
        y = np.array([P_1, P_2, 0.0, 0.0, 0.0, 0.0])
        commands = [0.0] * (back + 2)  # the oldest first
        for i in range(len(F_d)):
            out[i] = F
            truth = y[0], y[1], supply[i][0], F, x[i][0][0]
            memory, u = decide(p, memory, e, row, truth, F_d[i], noise[i], p.h)
            commands = [*commands[1:], u]
            acting = [commands[1]] if cut == 0 else commands[:2]
            y = _sample(p, y, spans, acting, (supply[i], returned[i], x[i]))
            F = force(p, y[0], y[1], y[2], y[3], v[i][-1])
        return out

    return call
