"""Runs the plant: Heun's method at a fixed step, a command held over each tick.

With Numba a machine's three minutes take a few seconds. Without it all lanes go
together, and take some ten minutes whether they are three or thirty.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from . import laws
from .laws import Parameters, State

try:
    import numba
except ImportError:
    numba = None

TICK = 0.01
"""Time between two samples of a log, s."""

STEPS = 200
"""Steps a tick."""

EVERY = 10
"""Steps between two of the samples that a logger's filter sees."""

DT = TICK / STEPS


@laws.register_jitable
def _moved(s, slope, dt, p):
    """State after a straight step; a spool never leaves its stroke or its slew rate."""
    rate = s.spool_rate + dt * slope.spool_rate
    return State(
        np.minimum(np.maximum(s.spool + dt * slope.spool, -1.0), 1.0),
        np.minimum(np.maximum(rate, -p.r_v), p.r_v),
        s.P_1 + dt * slope.P_1,
        s.P_2 + dt * slope.P_2,
        s.P_line + dt * slope.P_line,
        s.P_s + dt * slope.P_s,
        s.P_pilot + dt * slope.P_pilot,
        s.x + dt * slope.x,
        s.v + dt * slope.v,
    )


@laws.register_jitable
def _mean(a, b):
    return State(
        0.5 * (a.spool + b.spool),
        0.5 * (a.spool_rate + b.spool_rate),
        0.5 * (a.P_1 + b.P_1),
        0.5 * (a.P_2 + b.P_2),
        0.5 * (a.P_line + b.P_line),
        0.5 * (a.P_s + b.P_s),
        0.5 * (a.P_pilot + b.P_pilot),
        0.5 * (a.x + b.x),
        0.5 * (a.v + b.v),
    )


def tick(s, p, before, after, switch, out):
    """Integrate one tick.

    Args:
        s: state as it begins.
        p: parameters.
        before: command that has arrived when it begins.
        after: command that arrives during it.
        switch: steps until it arrives: dead time need not be whole ticks.
        out: receives x, P_1, P_2, P_s every `EVERY` steps, [STEPS // EVERY, 4] or
            [STEPS // EVERY, 4, lanes].

    Returns:
        State as it ends.
    """
    for i in range(STEPS):
        if i % EVERY == 0:
            out[i // EVERY, 0] = s.x
            out[i // EVERY, 1] = s.P_1
            out[i // EVERY, 2] = s.P_2
            out[i // EVERY, 3] = s.P_s
        u = laws.choose(i < switch, before, after)
        first = laws.rates(s, p, u)
        last = laws.rates(_moved(s, first, DT, p), p, u)
        s = _moved(s, _mean(first, last), DT, p)
    return s


def compiled():
    """`tick` for one lane of floats, or None without Numba."""
    return None if numba is None else numba.njit(tick)


def run(parameters, states, operators, delays, ticks: int, fast: Any = None):
    """Run lanes under their operators.

    Args:
        parameters: of each lane, floats.
        states: of each lane as it begins, floats.
        operators: of each lane; `operators[i](x)` is its next command, from the
            stroke as it stands.
        delays: dead time of each lane, s; to the nearest step.
        ticks: how many to run.
        fast: what `compiled` returned; None runs the lanes together in NumPy.

    Returns:
        Commands [lanes, ticks], and x, P_1, P_2, P_s [lanes, ticks, STEPS // EVERY, 4].
    """
    lanes = len(states)
    commands = np.zeros((lanes, ticks))
    samples = np.empty((lanes, ticks, STEPS // EVERY, 4))
    steps = np.round(np.asarray(delays) / DT).astype(int)
    late, switch = steps // STEPS, steps % STEPS

    def arriving(n):
        """Command arriving at tick n after whole ticks of delay, [lanes]."""
        at = n - late
        return np.where(at >= 0, commands[np.arange(lanes), np.maximum(at, 0)], 0.0)

    together = Parameters(*np.array(parameters, float).T)
    state = State(*np.array(states, float).T)
    states = [State(*map(float, s)) for s in states]
    for n in range(ticks):
        stroke = state.x if fast is None else [s.x for s in states]
        commands[:, n] = [o(x) for o, x in zip(operators, stroke, strict=True)]
        before, after = arriving(n - 1), arriving(n)
        if fast is None:
            out = np.empty((STEPS // EVERY, 4, lanes))
            state = tick(state, together, before, after, switch, out)
            samples[:, n] = np.moveaxis(out, -1, 0)
            continue
        for i in range(lanes):
            states[i] = fast(
                states[i], parameters[i], before[i], after[i], switch[i], samples[i, n]
            )
    return commands, samples
