"""Rates and bounds of the adaptation, by descent through the simulated run."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy import optimize

from hydrojax.rigfile.quantities import Quantity
from hydrojax.tune.objective import Objective


def tune_adaptation(
    objective: Objective,
    free: list[Quantity],
    gains: Float[np.ndarray, "gains"],
    progress: Callable[[str], None],
) -> tuple[Float[np.ndarray, "free"], Float[np.ndarray, "plants"]]:
    """Rates and bounds of the adaptation that track best.

    Args:
        objective: whose run, plants and gains' quantities are used.
        free: rates and bounds above 0.
        gains: of the objective, kept as they are.
        progress: called with a line of text at each stage.

    Returns:
        Their values, in their units (those they had if nothing better was found), and
        the RMS of F_d - F that they give on each plant, N.
    """
    progress("adaptation: descent through the run")
    inner = objective.over(free, objective.at(gains))
    here = inner.initial()
    run, slope = inner.compiled_run()

    def score(y):
        g = jnp.asarray(here * np.exp(y))
        rms = np.asarray(run(g))
        steep = np.asarray(slope(g)) * np.asarray(g)
        if not (np.all(np.isfinite(rms)) and np.all(np.isfinite(steep))):
            return 1e3, np.zeros(y.size)
        mean = np.mean(rms**2)
        return 0.5 * np.log(mean), (rms @ steep) / rms.size / mean

    done = optimize.minimize(
        score, np.zeros(here.size), jac=True, method="L-BFGS-B",
        bounds=[(-np.log(10), np.log(10))] * here.size,
        options={"maxiter": 12},
    )  # fmt: skip
    better = done.fun < score(np.zeros(here.size))[0] - 1e-3
    values = here * np.exp(done.x) if better else here
    return values, inner.run(values)
