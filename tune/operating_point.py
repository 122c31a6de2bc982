"""The operating point of a loop, with the adaptation stopped there.

At rest the point is the force F_0 on the output, the valve shut. Where the piston is
moved at a constant speed, a load has to settle, or a leak asks for flow, it is where a
slow loop that has brought the force to F_0 is after `SETTLE` seconds, at `x`: the
place goes on changing from there, so the point holds for motions that are short beside
the chambers. The slow loop has gains of its own, so that the point is the same for all
gains, those of an unstable loop too. A law without integral action that has a leak to
feed runs at a force of its own instead: there what is measured is beside this point.

The estimates that are adapted are the plant's own values, or the bound next to them
(`adapted`), or where the law starts them, midway between their bounds.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from hydrojax.control.adaptive import Law, truth
from hydrojax.control.base import Estimates, clamp
from hydrojax.control.loop import Loop, Scenario, start_loop, step_loop
from hydrojax.control.simulation import PARTS
from hydrojax.plant.load import Driven, EnvironmentMotion
from hydrojax.rigfile.quantities import Setting

SETTLE = 0.8
"""Seconds in which a point that has to be found is settled: five time constants of
the reference load, eight of L(t)'s filter."""

DRIFT = 1.0
"""Change of a pressure within a sample (Pa) below which a point is at rest."""

LEVEL = 10.0
"""Rate (1/s) at which the settling loop brings the force itself to F_0: leakage or a
bias would leave it elsewhere, at a force that depends on the gains."""

SLOW = 60.0
"""Bandwidth (rad/s) of the loop that settles."""


def estimates(loop: Loop, adapted: bool = True) -> Estimates:
    """The nine estimates of the paper's law at the operating point, SI."""
    law = _adaptive(loop)

    def one(true, lower, upper, rate):
        middle = (lower + upper) / 2
        return jnp.where(rate > 0, clamp(true, lower, upper), middle) if adapted else (
            middle
        )  # fmt: skip

    return jax.tree.map(one, truth(loop.rig), law.lower, law.upper, law.rate)


def frozen(loop: Loop) -> Loop:
    """The loop with its adaptation stopped; a controller without one as it is."""
    if not isinstance(loop.law, Law):
        return loop
    zero = jax.tree.map(jnp.zeros_like, loop.law.rate)
    return eqx.tree_at(lambda lo: lo.law.rate, loop, zero)


def scenario(
    setting: Setting,
    F_d: Float[Array, "n"],
    noise: Float[Array, "n 4"],
    t: Float[Array, "n"],
) -> Scenario:
    """A scenario at the setting's speed and supply that is at `x` at t = 0.

    Args:
        setting: the loop and its point.
        F_d: desired force, N.
        noise: standard normal numbers.
        t: s; supply and speed are constant, so any times are possible.
    """
    h = setting.loop.h
    halves = t[:, None, None] + h / PARTS * (
        jnp.arange(PARTS)[:, None] + jnp.array([0.0, 0.5, 1.0])
    )
    n = t.shape[0]
    v = jnp.broadcast_to(setting.v, (n, PARTS))
    environment = EnvironmentMotion(
        setting.x + setting.v * halves, v, jnp.zeros_like(v)
    )
    P_s, P_r = (jnp.broadcast_to(p, (n, 2)) for p in (setting.P_s, setting.P_r))
    return Scenario(t, F_d, noise, P_s, P_r, environment)


def moment(given: Scenario, k: int | Int[Array, ""]) -> Scenario:
    """One period of a scenario."""
    return jax.tree.map(lambda a: a[k], given)


def still(settings: Setting) -> bool:
    """Whether the points of some settings, stacked [m, ...], need no settling.

    At rest they need none if nothing moves from where `initial_state` puts it:
    leakage, a valve's bias or an estimate that is off make it move.
    """
    if bool(jnp.any(settings.v != 0)):
        return False
    if not isinstance(settings.loop.load, Driven) and bool(jnp.any(settings.F_0 != 0)):
        return False

    def drift(s: Setting) -> Array:
        carry = initial_state(s)
        one = scenario(s, s.F_0[None], jnp.zeros((1, 4)), jnp.zeros(1))
        after = step_loop(_slow(s.loop), carry, moment(one, 0))[0]
        off = [b - a for a, b in zip(carry.plant.P, after.plant.P, strict=True)]
        return jnp.max(jnp.abs(jnp.stack(off)))

    return bool(jnp.all(jax.jit(jax.vmap(drift))(settings) < DRIFT))


def _slow(loop: Loop) -> Loop:
    """The loop that settles: its adaptation stopped, its gains its own.

    Another controller than the paper's law settles with the gains it has.
    """
    if not isinstance(loop.law, Law):
        return loop
    slow = SLOW / loop.rig.chambers.beta / 2
    return eqx.tree_at(lambda lo: (lo.law.k_p, lo.law.k_f), frozen(loop), (slow, slow))


def _adaptive(loop: Loop) -> Law:
    """The loop's controller, which is the paper's law."""
    if not isinstance(loop.law, Law):
        raise TypeError(f"invalid controller {type(loop.law).__name__}: expected Law")
    return loop.law


def initial_state(setting: Setting, adapted: bool = True, settle: int = 0) -> Any:
    """The state of a loop at its operating point.

    Args:
        setting: the loop and its point.
        adapted: whether the adapted estimates are the plant's values.
        settle: samples in which a slow loop settles; 0 at rest, see `still`.
    """
    n = max(settle, 1)
    t = (jnp.arange(n) - settle) * setting.loop.h
    given = scenario(setting, jnp.broadcast_to(setting.F_0, (n,)), jnp.zeros((n, 4)), t)
    carry = start_loop(_slow(setting.loop), given)
    # The environment may be moving from the first sample on.
    plant = carry.plant._replace(
        speed=carry.plant.speed + jnp.abs(setting.v),
        motion=carry.plant.motion._replace(v=setting.v),
    )
    carry = carry._replace(plant=plant)
    if not isinstance(setting.loop.law, Law):
        return _settled(setting, carry, given) if settle else carry
    held = estimates(setting.loop, adapted)
    memory = _matched(setting, carry.law, held, given.F_d[0])
    memory = memory._replace(v=setting.v, speed=jnp.abs(setting.v))
    carry = carry._replace(law=memory)
    if not settle:
        return carry
    carry = _settled(setting, carry, given)
    memory = _matched(setting, carry.law, held, setting.F_0)
    return carry._replace(law=memory._replace(P_d_rate=jnp.zeros_like(memory.P_d)))


def matched(setting: Setting, carry: Any) -> Any:
    """The state with the estimates and the P_d that the setting's law has there.

    While the joint moves these are the adapted ones. At rest, where a small force
    teaches the law next to nothing, they are those with which it starts.
    """
    if not isinstance(setting.loop.law, Law):
        return carry
    both = (estimates(setting.loop, adapted) for adapted in (False, True))
    held = jax.tree.map(lambda a, b: jnp.where(setting.v == 0, a, b), *both)
    return carry._replace(law=_matched(setting, carry.law, held, setting.F_0))


def _matched(setting: Setting, memory: Any, held: Estimates, F_d: Array) -> Any:
    """The law's memory with other estimates, and the P_d that they make."""
    P_d = _adaptive(setting.loop).desired(held, memory.z, memory.v, memory.speed, F_d)[
        0
    ]
    return memory._replace(estimates=held, P_d=P_d)


def _settled(setting: Setting, carry: Any, given: Scenario) -> Any:
    """The state of the slow loop after the samples of `given`."""
    loop = _slow(setting.loop)

    def body(state, tick):
        c, off = state
        c = step_loop(loop, c, tick._replace(F_d=tick.F_d + off))[0]
        return (c, off + loop.h * LEVEL * (setting.F_0 - c.F)), None

    return jax.lax.scan(body, (carry, jnp.zeros_like(setting.F_0)), given)[0][0]
