"""What the paper proves, checked on a run: W (31), its bound (35), the supply (42)."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hydrojax.control.adaptive import adaptive_law, truth
from hydrojax.control.base import Estimates
from hydrojax.control.inverting import mean_area
from hydrojax.control.loop import Loop, Scenario, run
from hydrojax.control.simulation import Run
from hydrojax.plant.valve import metering_edges

ROUNDS, LANES = 4, 12
"""Rounds of the search for the minimum supply pressure, and runs in each."""


def _drive_force(loop: Loop, run: Run) -> Float[np.ndarray, "samples"]:
    """The true drive force at every sample, [N], N."""
    P_1, P_2 = (jnp.asarray(run[name]) for name in ("true_P_a1", "true_P_a2"))
    return np.asarray(loop.rig.drive_force(P_1, P_2))


def lyapunov(loop: Loop, run: Run) -> Float[np.ndarray, "samples"]:
    """W of (31) at every sample, [N], N^2/Pa.

    The plant's own parameters are the truth it measures from. An estimate that is not
    adapted has no term: its error is constant, and (31) divides by its rate.

    Raises:
        TypeError: another controller than the paper's law.
    """
    own, law = truth(loop.rig), adaptive_law(loop.law)
    W = 2 * tracking_part(loop, run)
    for name in Estimates._fields:
        rate = float(getattr(law.rate, name))
        if rate:
            weight = 1.0 if name in ("k_1", "A_a") else float(law.k_f)
            off = float(getattr(own, name)) - run[name]
            W = W + weight / rate * off**2
    return W / 2


def tracking_part(loop: Loop, run: Run) -> Float[np.ndarray, "samples"]:
    """What the error of P adds to W of (31) at every sample, [N], N^2/Pa."""
    P = _drive_force(loop, run)
    return (run["P_d"] - P) ** 2 * float(truth(loop.rig).k_1) / 2


def lyapunov_bound(loop: Loop, run: Run) -> Float[np.ndarray, "samples"]:
    """The bound (35) on the rate of W at every sample, [N], N^2/(Pa s); never > 0."""
    P, law = _drive_force(loop, run), adaptive_law(loop.law)
    return (
        -float(law.k_p) * (run["P_d"] - P) ** 2
        - float(law.k_f) * (run.F_d - run["true_F"]) ** 2
    )


def largest_fall(part: Float[np.ndarray, "samples"]) -> float:
    """The largest fall below a running maximum, in the unit of what is given."""
    return float(np.max(np.maximum.accumulate(part) - part))


def largest_rise(W: Float[np.ndarray, "samples"]) -> float:
    """The largest rise of W [N^2/Pa] above its running minimum, per its first value."""
    return float(np.max(W - np.minimum.accumulate(W)) / W[0])


class Supply(NamedTuple):
    """The minimum supply pressure of a run, Pa.

    Attributes:
        minimum: found by running the loop: with less, a pressure leaves (P_r, P_s).
        condition: the right-hand side of (42), met at the samples with a command of
            at least a tenth of its largest: as the command goes to zero, so do the
            epsilons, and the printed bound has no finite value.
    """

    minimum: float
    condition: float


def supply_condition(loop: Loop, scenario: Scenario, out: Run) -> float:
    """The right-hand side of (42) along a run, Pa; see `Supply`. For equal areas."""
    u = out["u"]
    busy = np.abs(u) >= np.max(np.abs(u)) / 10
    c, beta = (
        metering_edges(adaptive_law(loop.law).nominal.valve),
        float(loop.rig.chambers.beta),
    )
    area = float(mean_area(loop.rig))
    P_s, P_r = (np.asarray(p[:, 0]) for p in (scenario.P_s, scenario.P_r))
    P_1, P_2 = out["true_P_a1"], out["true_P_a2"]
    up = u > 0
    into = np.where(up, c.c_p1, c.c_p2)  # the land that draws on the supply
    back = np.where(up, c.c_n2, c.c_n1)  # the land that drains
    filled, drained = np.where(up, P_1, P_2), np.where(up, P_2, P_1)
    psi = into * np.sqrt(np.maximum(P_s - filled, 0)) + back * np.sqrt(
        np.maximum(drained - P_r, 0)
    )
    ours, other = (beta * np.abs(u) * e**2 / psi for e in (into, back))
    # epsilon_1 goes with the supply, 2 with P_a1, 3 with P_a2; (41).
    e_1, e_2, e_3 = ours, np.where(up, ours, other), np.where(up, other, ours)
    P = _drive_force(loop, out)
    rate = np.gradient(P, np.asarray(scenario.t))
    lengths = np.stack(loop.rig.chambers.lengths(jnp.asarray(out["true_x"])))
    top = area * np.max(np.abs(rate)) * lengths.max(0) + np.max(np.abs(P)) * np.maximum(
        e_2, e_3
    )
    bound = top / (area * np.minimum(e_1, e_2 + e_3 - e_1))
    return float(np.max(bound[busy]))


@eqx.filter_jit
def _stays(loop: Loop, scenario: Scenario, P_s: jax.Array) -> jax.Array:
    """Whether both pressures stay in (P_r, P_s) under each supply pressure, [n]."""

    def one(supply):
        given = scenario._replace(P_s=jnp.full_like(scenario.P_s, supply))
        # Chamber 1 starts where it is, or midway where that is above half of less.
        start = jnp.minimum(loop.P_start, (supply + scenario.P_r[0, 0]) / 2)
        lower = eqx.tree_at(lambda lo: lo.P_start, loop, start)
        P = run(lower, given, ("true_P_a1", "true_P_a2"))
        shut = jnp.stack([loop.rig.force_area_1, loop.rig.force_area_2]) > 0
        above, below = scenario.P_r[:, :1] < P, supply > P
        return jnp.all((above & below) | ~shut)

    return jax.vmap(one)(P_s)


def minimum_supply(loop: Loop, scenario: Scenario) -> float:
    """The minimum supply pressure, Pa, that keeps (20)(21) along a run, within 0.1 %.

    Returns inf if even four times the scenario's own does not.
    """
    low, high = float(scenario.P_r[0, 0]), 4 * float(scenario.P_s[0, 0])
    for _ in range(ROUNDS):
        tried = np.linspace(low, high, LANES + 1)[1:]
        stays = np.asarray(_stays(loop, scenario, jnp.asarray(tried)))
        if not stays[-1]:
            return float("inf")
        # Above the highest that fails, not at the first that holds: a run may pass by
        # luck under a pressure below one that fails.
        first = 0 if stays.all() else int(np.flatnonzero(~stays)[-1]) + 1
        low, high = (low if first == 0 else tried[first - 1]), tried[first]
    return float(high)


def supply(loop: Loop, scenario: Scenario, out: Run) -> Supply:
    """The minimum supply pressure of a run, found and as (42) bounds it."""
    return Supply(minimum_supply(loop, scenario), supply_condition(loop, scenario, out))
