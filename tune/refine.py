"""The law's friction bounds, refined so that it tracks best on identified plants."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import optimize

from hydrojax.control.loop import Loop, Scenario, run
from hydrojax.parameters import put
from hydrojax.tune.ensemble import Plants

SETTLE = 0.25
"""Share of a run that is not counted: the estimates settle."""

MAX_ITERATIONS = 25

FLOOR = 1e-9
"""Least half-width of a bound, of its scale: its derivative has to stay alive."""


def with_bounds(
    loop: Loop,
    names: Sequence[str],
    lower: Sequence[float] | Float[np.ndarray | Array, "n"],
    upper: Sequence[float] | Float[np.ndarray | Array, "n"],
) -> Loop:
    """The loop with other bounds of some of theta_f, SI."""
    law = loop.law
    new = {
        "lower": law.lower._replace(**dict(zip(names, lower, strict=True))),
        "upper": law.upper._replace(**dict(zip(names, upper, strict=True))),
    }
    return eqx.tree_at(
        lambda lo: (lo.law.lower, lo.law.upper), loop, (new["lower"], new["upper"])
    )


@eqx.filter_jit
def _errors(
    loop: Loop,
    names: tuple[str, ...],
    theta: Float[Array, "plants n"],
    scenarios: Scenario,
) -> Float[Array, "plants scenarios"]:
    """Tracking error of every plant in every scenario, RMS after SETTLE, N."""

    def one(values, scenario):
        plant = eqx.tree_at(lambda lo: lo.rig, loop, put(loop.rig, names, values))
        off = scenario.F_d - run(plant, scenario, ("true_F",))[:, 0]
        late = off[int(SETTLE * off.shape[0]) :]
        return jnp.sqrt(jnp.mean(late**2))

    over = jax.vmap(jax.vmap(one, in_axes=(None, 0)), in_axes=(0, None))
    return over(theta, scenarios)


def tracking_errors(
    loop: Loop, plants: Plants, scenarios: Scenario
) -> Float[np.ndarray, "plants scenarios"]:
    """Tracking error of every plant in every scenario, RMS, N.

    Args:
        loop: with the law's bounds, and a plant that lends all but `plants.names`.
        plants: that differ in friction.
        scenarios: of equal length, stacked along the first axis.
    """
    theta = jnp.asarray(plants.values)
    return np.asarray(_errors(loop, plants.names, theta, scenarios))


def refine(
    loop: Loop,
    plants: Plants,
    scenarios: Scenario,
    lower: Float[np.ndarray, "n"],
    upper: Float[np.ndarray, "n"],
    limits: Sequence[tuple[float, float]],
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Move the bounds of theta_f to where the plants are tracked best.

    Gradient descent (L-BFGS-B) through the closed loop on the mean squared error over
    plants and scenarios; the estimates begin midway between the bounds, so both where
    they start and where they may go is found.

    Args:
        loop: the loop whose law is refined.
        plants: the identified plants.
        scenarios: of equal length, stacked.
        lower: bounds to start from, SI, of `plants.names`.
        upper: likewise.
        limits: what each parameter may be at all, SI.
        progress: called with a line of text as the descent proceeds.

    Returns:
        The refined bounds, lower and upper.
    """
    low, high = np.array(limits, float).T
    scale = np.maximum(np.maximum(np.abs(lower), np.abs(upper)), 1e-12)
    bounds = partial(_bounds, scale=scale, low=low, high=high)
    both = _cost_and_slope(loop, plants, scenarios, bounds)
    start = np.concatenate([(lower + upper) / 2 / scale, (upper - lower) / 2 / scale])
    start[scale.size :] = np.maximum(start[scale.size :], FLOOR)

    def evaluate(at):
        value, slope = both(jnp.asarray(at))
        return float(value), np.asarray(slope)

    first, _ = evaluate(start)

    def step(at):
        progress(f"refine the bounds: {np.sqrt(evaluate(at)[0]):.3g} N RMS")

    reach = [*zip(low / scale, high / scale, strict=True)]
    reach += [(FLOOR, max(b - a, FLOOR)) for a, b in reach]
    found = optimize.minimize(
        lambda at: tuple(v / first for v in evaluate(at)),
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=reach,
        callback=step,
        options={"maxiter": MAX_ITERATIONS, "ftol": 1e-5},
    )
    ends = bounds(jnp.asarray(found.x))
    return np.asarray(ends[0]), np.asarray(ends[1])


def _bounds(
    at: Float[Array, "twice_n"], scale: Float[np.ndarray, "n"],
    low: Float[np.ndarray, "n"], high: Float[np.ndarray, "n"],
) -> tuple[Float[Array, "n"], Float[Array, "n"]]:  # fmt: skip
    """Both bounds from their middles and half-widths, which are in units of `scale`."""
    middle, half = at[: scale.size] * scale, at[scale.size :] * scale
    return jnp.clip(middle - half, low, high), jnp.clip(middle + half, low, high)


def _cost_and_slope(
    loop: Loop, plants: Plants, scenarios: Scenario, bounds: Callable[..., Any]
) -> Callable[..., Any]:
    """The mean squared error as a compiled function, with its gradient."""
    theta = jnp.asarray(plants.values)

    def cost(at):
        held = with_bounds(loop, plants.names, *bounds(at))
        return jnp.mean(_errors(held, plants.names, theta, scenarios) ** 2)

    # Forward mode: some dozen directions, and no run of thousands of steps to store.
    return jax.jit(lambda at: (cost(at), jax.jacfwd(cost)(at)))
