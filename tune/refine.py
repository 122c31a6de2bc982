"""The law's friction bounds, refined so that it tracks best on identified plants."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import optimize
from scipy.stats import qmc

from hydrojax.control.loop import Loop, Scenario, run
from hydrojax.parameters import get, parameter_specs, put
from hydrojax.tune.ensemble import Plants

SETTLE = 0.25
"""Share of a run that is not counted: the estimates settle."""

MAX_ITERATIONS = 25

FLOOR = 1e-9
"""Least width of a bound, of its scale: its derivative has to stay alive."""

SPREAD = 0.1
"""How far the valve's constants and the bulk modulus are from what the law takes them
to be, relative, where bounds are refined and compared."""

HYDRAULIC = ("beta", "c_p1", "c_n1", "c_p2", "c_n2")
"""What is off then, where a rig has it."""

Ends = tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]
"""Lower and upper bounds."""


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


def under_model_error(
    plants: Plants, loop: Loop, spread: float = SPREAD, seed: int = 0
) -> Plants:
    """The plants, each with other valve constants and bulk modulus, within `spread`.

    A law that tracks best on one valve is tuned to that valve: bounds have to serve
    where what the law takes for the plant is off.
    """
    known = parameter_specs(loop.rig)
    names = tuple(n for n in HYDRAULIC if n in known and n not in plants.names)
    drawn = qmc.LatinHypercube(len(names), rng=seed).random(len(plants.values))
    factors = np.exp(np.log1p(spread) * (2 * drawn - 1))
    values = np.asarray(get(loop.rig, names)) * factors
    both = np.concatenate([np.asarray(plants.values), values], axis=1)
    return Plants((*plants.names, *names), both)


def refine(
    loop: Loop,
    plants: Plants,
    scenarios: Scenario,
    box: Ends,
    limits: Sequence[tuple[float, float]],
    names: tuple[str, ...],
    start: Ends | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Ends:
    """Widen a box of theta_f to where the plants are tracked best.

    Gradient descent (L-BFGS-B) through the closed loop on the mean squared error over
    plants and scenarios; the estimates begin midway between the bounds, so both where
    they start and where they may go is found. The box stays inside: what the next
    stretch is expected to be, the bounds hold.

    Args:
        loop: the loop whose law is refined.
        plants: the identified plants.
        scenarios: of equal length, stacked.
        box: lower and upper bounds that stay inside, SI, of `names`.
        limits: what each parameter may be at all, SI.
        names: what is bounded.
        start: bounds to begin from; the box if None.
        progress: called with a line of text as the descent proceeds.

    Returns:
        The refined bounds, lower and upper.
    """
    low, high = np.array(limits, float).T
    lower, upper = box
    scale = np.maximum(np.maximum(np.abs(lower), np.abs(upper)), 1e-12)
    first = box if start is None else start
    away = np.concatenate([(lower - first[0]) / scale, (first[1] - upper) / scale])

    def bounds(at):
        below, above = at[: scale.size] * scale, at[scale.size :] * scale
        ends = jnp.clip(lower - below, low, high), jnp.clip(upper + above, low, high)
        return ends[0], jnp.maximum(ends[1], ends[0] + FLOOR * scale)

    both = _cost_and_slope(loop, plants, scenarios, names, bounds)
    begin = np.maximum(away, FLOOR)

    most = np.concatenate([(lower - low) / scale, (high - upper) / scale])
    ends = bounds(jnp.asarray(_lowest(both, begin, np.maximum(most, FLOOR), progress)))
    return np.asarray(ends[0]), np.asarray(ends[1])


def _lowest(
    both: Callable[..., Any],
    begin: np.ndarray,
    most: np.ndarray,
    progress: Callable[[str], None],
) -> np.ndarray:
    """Where a cost is lowest between 0 and `most`; `both` gives it, and its slope."""

    def evaluate(at):
        value, slope = both(jnp.asarray(at))
        return float(value), np.asarray(slope)

    whole, _ = evaluate(begin)

    def step(at):
        progress(f"refine the bounds: {np.sqrt(evaluate(at)[0]):.3g} N RMS")

    return optimize.minimize(
        lambda at: tuple(v / whole for v in evaluate(at)),
        np.minimum(begin, most),
        jac=True,
        method="L-BFGS-B",
        bounds=[(0.0, m) for m in most],
        callback=step,
        options={"maxiter": MAX_ITERATIONS, "ftol": 1e-5},
    ).x


def _cost_and_slope(
    loop: Loop,
    plants: Plants,
    scenarios: Scenario,
    names: tuple[str, ...],
    bounds: Callable[..., Any],
) -> Callable[..., Any]:
    """The mean squared error as a compiled function, with its gradient."""
    theta = jnp.asarray(plants.values)

    def cost(at):
        held = with_bounds(loop, names, *bounds(at))
        return jnp.mean(_errors(held, plants.names, theta, scenarios) ** 2)

    # Forward mode: some dozen directions, and no run of thousands of steps to store.
    return jax.jit(lambda at: (cost(at), jax.jacfwd(cost)(at)))
