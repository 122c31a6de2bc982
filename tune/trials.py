"""The runs in which a proposal is tried: locked, moving, steps, two amplitudes."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float, Int

from hydrojax.control.loop import Scenario
from hydrojax.control.simulation import hold, make_scenario
from hydrojax.control.waveforms import random_sines, sinusoidal_path
from hydrojax.parameters import get
from hydrojax.plant.chambers import Point
from hydrojax.programs.compiled import program
from hydrojax.rigfile.quantities import Setting
from hydrojax.tune import measure

SPEED, PERIOD = 0.03, 3.0
"""The joint's motion in the runs that move: peak m/s, s; the paper's. Of a rig that
cannot go so fast, less (`moving_speed`)."""

FED, ROOM = 0.75, 0.25
"""Shares of the speed at which the valve, wide open, holds no force any more, and of
the chambers' length, that these runs go up to: beyond, no gain is of any help."""

FORCE, FORCE_HZ = 300.0, 0.5
"""The desired force of the run in which tracking is judged: N, Hz; the paper's."""

SECONDS, SKIP = 4.0, 1.0
"""Length of a run, and what of it is not counted, s."""

SMALL = 0.3
"""The smaller amplitude, of the stated one."""

WINDOW = 0.25
"""Length of the windows in which an oscillation is looked for, s."""

EVENT = (0.1, 0.4)
"""How long before and after a step of F_d, or a reversal of the joint, no oscillation
is looked for, s: the answer to it is over by then."""

SLOW = 5.0
"""What varies more slowly than this (Hz) is no oscillation of the loop."""

SUSTAINED = 0.25
"""An oscillation fills at least this share of the windows: the joint may oscillate in
one direction alone."""

SHARE, NOISES = 0.05, 4.0
"""An oscillation's RMS exceeds both this share of the desired force's RMS, and so many
times what the sensors' noise makes of F."""

FULL, SATURATED = 0.999, 0.01
"""A command is at its end from this share of u_max on; it saturates where that is so in
more than this share of the samples."""


class Trials(NamedTuple):
    """The runs of a setting.

    Attributes:
        names: of each.
        scenarios: stacked.
        F_d: of each, N.
        skip: samples that are not counted.
        stepped: whether its desired force steps, so that the command may saturate.
        amplitude: of the desired force, RMS, N.
        begin: first samples of the windows in which an oscillation is looked for.
        given: of the two that measure a response, what makes it of their signals.
        speed: the joint's peak in those that move, m/s.
    """

    names: tuple[str, ...]
    scenarios: Scenario
    F_d: Float[np.ndarray, "trials N"]
    skip: int
    stepped: Bool[np.ndarray, "trials"]
    amplitude: Float[np.ndarray, "trials"]
    begin: tuple[Int[np.ndarray, "windows"], ...]
    given: measure.Excitation
    speed: float


RESPONSE, RESPONSE_SMALL, FORCE_LOCKED, MOVING, MOVING_SMALL = range(5)
"""Places of those that give figures; the others are for the checks alone."""


def make_trials(setting: Setting) -> Trials:
    """All runs, at the setting's amplitude and at `SMALL` of it."""
    h, A = float(setting.loop.h), float(setting.amplitude)
    sines = measure.multisine(1 / h, period=SECONDS / 2)
    t = np.arange(sines.shape.size) * h
    rng = np.random.default_rng(41)
    slow = np.sin(2 * np.pi * FORCE_HZ * t)
    square = np.sign(np.sin(2 * np.pi * FORCE_HZ * t + 1e-9))
    steps = tuple(np.arange(0, SECONDS, 0.5 / FORCE_HZ))
    turns = tuple(np.arange(0, SECONDS, PERIOD / 2))
    speed = moving_speed(setting)
    still, moves = hold(float(setting.x)), sinusoidal_path(speed, PERIOD)
    table = (
        ("locked", A / np.sqrt(2) * sines.shape, still, ()),
        ("locked, small", SMALL * A / np.sqrt(2) * sines.shape, still, ()),
        ("locked, 0.1 to 20 Hz", random_sines(rng, t, A / np.sqrt(2)), still, ()),
        ("moving", FORCE * slow, moves, turns),
        ("moving, small", SMALL * FORCE * slow, moves, turns),
        ("steps", A * square, still, steps),
        ("steps, moving", A * square, moves, (*steps, *turns)),
    )
    P_s, P_r, F_0 = (float(p) for p in (setting.P_s, setting.P_r, setting.F_0))
    runs = [
        make_scenario(F_0 + F_d, path, h, P_s, P_r, seed=i)
        for i, (_, F_d, path, _) in enumerate(table)
    ]
    for k in (RESPONSE, RESPONSE_SMALL):
        runs[k] = runs[k]._replace(noise=jnp.asarray(sines.noise))
    return Trials(
        tuple(row[0] for row in table),
        jax.tree.map(lambda *a: jnp.stack(a), *runs),
        np.stack([np.asarray(r.F_d) for r in runs]),
        round(SKIP / h),
        np.array([set(steps) <= set(row[3]) for row in table]),
        np.array([np.sqrt(np.mean(np.asarray(row[1]) ** 2)) for row in table]),
        tuple(_quiet(row[3], h, t.size) for row in table),
        sines,
        speed,
    )


def moving_speed(setting: Setting) -> float:
    """The joint's peak speed in the runs that move, m/s: `SPEED`, or what valve and
    chambers of the rig leave room for.
    """
    room = 2 * np.pi / PERIOD * ROOM * float(setting.loop.rig.chambers.length)
    fed = FED * float(top_speed(setting)) or SPEED  # one that holds nothing shows so
    return min(SPEED, room, fed)


@program
def top_speed(setting: Setting) -> Float[Array, ""]:
    """The piston's speed up to which the valve, wide open, holds F_0 against Coulomb
    friction, m/s; that of the slower direction.

    The pressures are those at which they rest, found by bisection: that of a chamber
    falls the faster the higher it is.
    """
    law, rig = setting.loop.law, setting.loop.rig
    rig = eqx.tree_at(lambda r: r.line, rig, ())
    speeds = SPEED * jnp.logspace(-3, 2, 251)

    def pushes(u: Array, v: Array) -> Array:
        """The drive force at rest of a piston that is moved at `v`."""
        u, v = jnp.broadcast_arrays(u, v)
        held = setting.loop.h * jnp.ones_like(u)
        _, opening = rig.command_step(rig.command_init(u), u, held)
        P_s, P_r, x = (
            jnp.full_like(v, a) for a in (setting.P_s, setting.P_r, setting.x)
        )

        def halved(_: int, ends: tuple) -> tuple:
            low, high = ends
            P = (low + high) / 2
            at = Point(P[0], P[1], P_s, P_r, opening, x, v)
            rates = rig.pressure_rates(at)
            rises = jnp.stack(rates) > 0
            return jnp.where(rises, P, low), jnp.where(rises, high, P)

        ends = jnp.zeros((2, *v.shape)), jnp.stack([P_s, P_s])
        low, high = jax.lax.fori_loop(0, 40, halved, ends)
        P_1, P_2 = (low + high) / 2
        return rig.drive_force(P_1, P_2)

    top = []
    for way, friction in ((1.0, "k_cp"), (-1.0, "k_cn")):
        (rubs,) = get(rig, (friction,))
        needs = way * setting.F_0 + jnp.abs(rubs)
        either = jnp.stack([way * pushes(s * law.u_max, way * speeds) for s in (1, -1)])
        holds = jnp.max(either, axis=0) >= needs
        top.append(jnp.max(jnp.where(holds, speeds, 0.0)))
    return jnp.minimum(*top)


def _quiet(
    events: tuple[float, ...], h: float, count: int
) -> Int[np.ndarray, "windows"]:
    """First samples of half-overlapping windows that are away from all events."""
    n, width = round(WINDOW / h), round(1 / SLOW / h)
    begin = np.arange(round(SKIP / h), count - n - width, n // 2)
    early, late = EVENT
    away = [
        (begin * h > at + late) | ((begin + n) * h < at - early) for at in events
    ]  # fmt: skip
    return begin[np.all(away, axis=0)] if away else begin


def rms_error(
    trials: Trials, k: int, F: Float[np.ndarray, "rows N"]
) -> Float[np.ndarray, "rows"]:
    """RMS of F_d - F in trial `k`, N; inf where the run is not finite."""
    off = (trials.F_d[k] - F)[:, trials.skip :]
    with np.errstate(over="ignore", invalid="ignore"):
        rms = np.sqrt(np.mean(off**2, axis=-1))
    return np.where(np.isfinite(rms), rms, np.inf)


def response_of(
    trials: Trials, k: int, F: Float[np.ndarray, "rows N"]
) -> Complex[np.ndarray, "rows lines"]:
    """F/F_d of the runs of a trial with many sines, at `trials.given.hertz`."""
    weights, skip = trials.given.weights, trials.given.skip
    assert weights is not None
    desired = weights @ trials.F_d[k, skip:]
    return (F[:, skip:] @ weights.T) / desired


def oscillation(
    trials: Trials, k: int, F: Float[np.ndarray, "rows N"], h: float
) -> Float[np.ndarray, "rows"]:
    """RMS of what oscillates faster than `SLOW` in trial `k`, N.

    The RMS that `SUSTAINED` of the windows exceed: of F_d - F without its mean over
    1/SLOW, well after each step; in the trials with many sines, of the part of F that
    does not repeat with their period.
    Of a force of 0.1 to 20 Hz 0: what a slow loop misses of it is no oscillation, and
    the other trials show one.
    """
    if k == FORCE_LOCKED:
        return np.where(np.isfinite(F).all(-1), 0.0, np.inf)
    n, width = round(WINDOW / h), round(1 / SLOW / h)
    half = F.shape[1] // 2
    with np.errstate(over="ignore", invalid="ignore"):
        if k in (RESPONSE, RESPONSE_SMALL):
            off = (F - np.roll(F, half, axis=-1)) / np.sqrt(2)
            begin = np.arange(half, 2 * half - n + 1, n)
        else:
            off = trials.F_d[k] - F
            off, begin = off - _smooth(off, width), trials.begin[k]
        cut = off[:, begin[:, None] + np.arange(n)]
        each = np.sqrt(np.mean(cut**2, axis=-1))
    each = np.where(np.isfinite(each), each, np.inf)
    place = int(np.ceil((1 - SUSTAINED) * begin.size)) - 1
    return np.sort(each, axis=-1)[:, place]


def _smooth(x: Float[np.ndarray, "rows N"], width: int) -> Float[np.ndarray, "rows N"]:
    """The moving mean over about `width` samples, the ends held."""
    side = width // 2
    with np.errstate(over="ignore", invalid="ignore"):
        total = np.cumsum(np.pad(x, ((0, 0), (side + 1, side)), mode="edge"), axis=-1)
        return (total[:, 2 * side + 1 :] - total[:, : -2 * side - 1]) / (2 * side + 1)
