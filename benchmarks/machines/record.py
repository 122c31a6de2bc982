"""Records machines: three logs each, drawn again where a recording is no good."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import signal

from . import run
from .laws import Parameters, State, lever
from .operators import LSB, SCRIPTS, Operator
from .sizes import BAR, Machine, draw

SECONDS = 60.0
LOGS = tuple(SCRIPTS)
LOWEST, HIGHEST = 2 * BAR, 350 * BAR
LEAST_MOTION = 0.3
"""Least share of the stroke that each log must pass over."""

AT_END = 0.05
"""Largest share of a log's time within a thousandth of the stroke's ends."""

IDLE = 10 * BAR
"""Pressure in the chamber that bears no load, as a log begins."""

X_BITS = 2**16
ATTEMPTS = 60
HEADER = "time [s],u [1],x [m],P_a1 [bar],P_a2 [bar],P_s [bar]"
FORMATS = ("%.4f", "%.5f", "%.6f", "%.3f", "%.3f", "%.3f")


@dataclass(frozen=True)
class Recording:
    """A machine's logs.

    Attributes:
        machine: that was recorded.
        logs: name of each to [ticks, 6]: s, share of full command, m, bar, bar, bar.
        clean: the same without filter, noise and steps of resolution; Pa.
    """

    machine: Machine
    logs: dict[str, np.ndarray]
    clean: dict[str, np.ndarray]


def record(seeds: Sequence[int], seconds: float = SECONDS) -> list[Recording]:
    """Record each seed's machine.

    A machine that fails `fault` is drawn again, so a seed alone decides what comes.

    Raises:
        RuntimeError: a seed gave no good machine in `ATTEMPTS`.
    """
    fast, done = run.compiled(), {}
    attempts = dict.fromkeys(seeds, 0)
    while pending := [s for s in seeds if s not in done]:
        machines = []
        for seed in pending:
            while unfit(machine := draw(seed, attempts[seed])):
                attempts[seed] += 1
            if attempts[seed] >= ATTEMPTS:
                raise RuntimeError(f"no machine of seed {seed} is any good")
            machines.append(machine)
            attempts[seed] += 1
        for recording in record_machines(machines, seconds, fast):
            if fault(recording) is None:
                done[recording.machine.seed] = recording
    return [done[s] for s in seeds]


def unfit(machine: Machine) -> str | None:
    """Why a machine cannot work at all, before it is run; None where it can."""
    p, (low, high) = machine.parameters, machine.P_static
    if low < 15 * BAR or high > 130 * BAR:
        return "load"
    if p.P_max < high + 40 * BAR:
        return "supply"
    if p.has_line and machine.truth.get("internal_leakage") is not None:
        return "a held load would push itself past the over-centre valve"
    if p.c_il and high / (1 - min(p.A_1 / p.A_2, 0.999)) > 0.9 * HIGHEST:
        return "leakage would raise the pressures of a held load too far"
    return None


def settled(p: Parameters, x: float) -> State:
    """State at rest at a stroke x, the valve closed."""
    weight = float(lever(x, p)[1])
    if p.holding:
        P_1, P_2 = IDLE, (weight + p.A_1 * IDLE) / p.A_2
        bears, other = P_2, P_1
    else:
        P_1, P_2 = (p.A_2 * IDLE - weight) / p.A_1, IDLE
        bears, other = P_1, P_2
    P_s = max(p.P_least, p.P_r + p.margin) if p.senses else p.P_max
    return State(0.0, 0.0, P_1, P_2, bears, P_s, other, x, 0.0)


def record_machines(
    machines: Sequence[Machine], seconds: float = SECONDS, fast=None
) -> list[Recording]:
    """Record machines as they are; `fast` is as in `run.run`."""
    lanes = [(m, i) for m in machines for i in range(len(LOGS))]
    parameters, states, operators = [], [], []
    for m, i in lanes:
        seed = [m.seed, m.attempt, i]
        p = m.loaded(m.load if LOGS[i] == "validate" else 1.0)
        parameters.append(Parameters(*map(float, p)))
        start = np.random.default_rng([*seed, 1]).uniform(0.35, 0.65) * p.stroke
        states.append(settled(p, float(start)))
        operators.append(Operator([*seed, 2], LOGS[i], p.stroke, m.speed))
    delays = [m.delay for m, _ in lanes]
    ticks = round(seconds / run.TICK)
    u, samples = run.run(parameters, states, operators, delays, ticks, fast)
    recordings = []
    for j, m in enumerate(machines):
        clean, logs = {}, {}
        for i, name in enumerate(LOGS):
            lane = j * len(LOGS) + i
            clean[name] = _columns(u[lane], samples[lane][:, 0])
            rng = np.random.default_rng([m.seed, m.attempt, i, 3])
            logs[name] = logged(m, u[lane], samples[lane], rng)
        recordings.append(Recording(m, logs, clean))
    return recordings


def _columns(u: np.ndarray, sampled: np.ndarray) -> np.ndarray:
    """Time, command and samples [ticks, 4] side by side, [ticks, 6]."""
    return np.column_stack([np.arange(len(u)) * run.TICK, u, sampled])


def logged(m: Machine, u, samples, rng) -> np.ndarray:
    """What the logger writes, in the log's units: [ticks, 6].

    Args:
        m: the machine.
        u: commands, [ticks].
        samples: x, P_1, P_2, P_s, [ticks, run.STEPS // run.EVERY, 4].
        rng: for the noise.
    """
    sampled = samples[:, 0].copy()
    if m.filter is not None:
        sampled[:, 1:] = filtered(samples[:, :, 1:], *m.filter)
    sampled[:, 1:] += m.noise * rng.standard_normal(sampled[:, 1:].shape)
    x_lsb = m.parameters.stroke / X_BITS
    sampled[:, 0] += 0.5 * x_lsb * rng.standard_normal(len(u))
    lsb = np.array([x_lsb, m.lsb, m.lsb, m.lsb])
    sampled = np.round(sampled / lsb) * lsb
    sampled[:, 1:] /= BAR
    return _columns(np.round(u / LSB) * LSB, sampled)


def filtered(samples: np.ndarray, frequency: float, zeta: float) -> np.ndarray:
    """Second-order low-pass of [ticks, n, channels], at the ticks: [ticks, channels].

    Exact for signals that are straight between samples.
    """
    ticks, n, channels = samples.shape
    omega = 2 * np.pi * frequency
    system = ([omega**2], [1.0, 2 * zeta * omega, omega**2])
    held: Any = signal.cont2discrete(system, run.TICK / n, "foh")
    top, bottom = np.ravel(held[0]), np.ravel(held[1])
    rows = samples.reshape(ticks * n, channels)
    rest = signal.lfilter_zi(top, bottom)[:, None] * rows[0]
    return signal.lfilter(top, bottom, rows, axis=0, zi=rest)[0][::n]


def fault(recording: Recording) -> str | None:
    """Why a recording is no good, or None."""
    stroke = recording.machine.parameters.stroke
    for name, log in recording.clean.items():
        x, pressures = log[:, 2], log[:, 3:5]
        if not np.all(np.isfinite(log)):
            return f"{name}: not finite"
        if pressures.min() < LOWEST or pressures.max() > HIGHEST:
            low, high = pressures.min() / BAR, pressures.max() / BAR
            return f"{name}: pressures of {low:.1f} to {high:.0f} bar"
        if np.ptp(x) < LEAST_MOTION * stroke:
            return f"{name}: moves over {np.ptp(x) / stroke:.0%} of the stroke"
        ends = np.mean((x < 1e-3 * stroke) | (x > (1 - 1e-3) * stroke))
        if ends > AT_END:
            return f"{name}: at an end {ends:.0%} of the time"
    return None
