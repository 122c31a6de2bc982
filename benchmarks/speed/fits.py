"""Identifications of one log by hydrojax and by others, each as a program.

The others are given what hydrojax finds besides the parameters: the pressures that
each window starts from. All minimise the same cost, half the sum of squares of what is
measured minus replayed, in units of the noise, over coordinates p / |start of p|.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from .logs import opened, predict, problem, replayed
from .loop import Build
from .replay import peer

ENOUGH = 1e-6
"""A fit ends when a step lowers the cost by less than this share of it."""
STEPS = 60

Vector = np.ndarray


def _found(problem_: Any, values: Any) -> list[float]:
    """The sixteen of a model's values."""
    from .replays import NAMES

    return [float(values[problem_.model.names.index(n)]) for n in NAMES]


def own(folder: str) -> Build:
    """hydrojax, from the rig file's starts, windows' pressures and weights unknown.

    Answers `params` [16] and `P_0` [W, 2].
    """
    from hydrojax.identify.api import fit_case

    case = opened(folder)

    def build():
        def call():
            state = fit_case(case, starts=1)
            P_0 = np.asarray(state.problem.batch.P_0)
            return {"params": _found(state.problem, state.point.values), "P_0": P_0}

        return call

    return build


def own_once(folder: str) -> Build:
    """The product's solver once over all channels, windows' pressures known."""
    made = problem(folder)
    values, free = made.initial_values(), tuple(made.free)

    def build():
        return lambda: {"params": _found(made, made.solve(values, free)[0])}

    return build


def cold(folder: str) -> dict[str, Any]:
    """The product in a process that is new; seconds of reading and of the fit."""
    began = time.perf_counter()
    run = own(folder)()
    read = time.perf_counter()
    found = run()
    return {
        "read_s": read - began,
        "fit_s": time.perf_counter() - read,
        "params": found["params"],
        "P_0": found["P_0"].tolist(),
    }


def _functions(
    folder: str, **which: Any
) -> tuple[Callable[[Vector], Vector], Callable[[Vector], Vector], Vector, Vector]:
    """Whitened residual [n] and its Jacobian [n, 16] of coordinates [16] in a peer; the
    coordinates' scale, and where they start.
    """
    made, start = peer(folder, **which)
    b = problem(folder).batch
    measured, noise = np.asarray(b.windows.measured), np.asarray(b.noise)
    scale = np.abs(start)

    def residual(q: Vector) -> Vector:
        return ((measured - made.replay(scale * q)) / noise).ravel()

    def derivative(q: Vector) -> Vector:
        J = made.jacobian(scale * q) * (-scale / noise[:, None])
        return J.reshape(-1, scale.size)

    return residual, derivative, scale, np.sign(start)


def by_scipy(folder: str, **which: Any) -> Build:
    """`scipy.optimize.least_squares` (MINPACK) with a peer's residual and Jacobian."""
    from scipy.optimize import least_squares

    problem(folder)

    def build():
        residual, derivative, scale, start = _functions(folder, **which)

        def call():
            out = least_squares(
                residual, start, derivative, method="lm", x_scale="jac",
                ftol=ENOUGH, xtol=ENOUGH, gtol=1e-12, max_nfev=200,
            )  # fmt: skip
            return {"params": scale * out.x}

        return call

    return build


def marquardt(
    residual: Callable[[Vector], Vector],
    derivative: Callable[[Vector], Vector],
    start: Vector,
) -> Vector:
    """Gauss-Newton with Marquardt's damping on the normal equations; the minimum."""
    q, r, damping = start, residual(start), 1e-4
    cost = r @ r
    for _ in range(STEPS):
        J = derivative(q)
        H, g = J.T @ J, J.T @ r
        size = np.maximum(np.diagonal(H), 1e-12 * np.max(np.diagonal(H)))
        for _ in range(12):
            move = np.linalg.solve(H + damping * np.diag(size), -g)
            new = residual(q + move)
            lower = new @ new
            if lower < cost:
                break
            damping *= 10
        else:
            return q
        gain, q, r, cost = cost - lower, q + move, new, lower
        damping = max(damping / 10, 1e-9)
        if gain < ENOUGH * cost:
            return q
    return q


def by_marquardt(folder: str, **which: Any) -> Build:
    """Our own Levenberg-Marquardt in NumPy around a peer's residual and Jacobian."""
    problem(folder)

    def build():
        residual, derivative, scale, start = _functions(folder, **which)
        return lambda: {"params": scale * marquardt(residual, derivative, start)}

    return build


def by_optimistix(folder: str, normal: bool) -> Build:
    """`optimistix.LevenbergMarquardt` on the residuals of hydrojax's replay.

    As it comes it factors the Jacobian (QR); with `normal` the normal equations. Its
    damping knows no scale, and from p / |start of p| it ends far from the minimum: its
    coordinates are such that each column of the Jacobian has length 1 at the start.
    """
    import jax
    import jax.numpy as jnp
    import lineax as lx
    import optimistix as optx

    from hydrojax.parameters import put

    from .replays import NAMES

    made, (_, begin) = problem(folder), replayed(folder)
    begin, given = jnp.asarray(begin), jax.tree.map(jnp.asarray, made.batch)
    linear = lx.Normal(lx.Cholesky()) if normal else lx.QR()

    def residual(params, batch):
        y = predict(put(made.model.rig, NAMES, params), batch)
        return (batch.windows.measured - y) / batch.noise

    J = jax.jit(jax.jacfwd(residual))(begin, given)
    scale = 1 / jnp.sqrt(jnp.sum(J**2, axis=(0, 1, 2)))

    def build():
        @jax.jit
        def solve(params, batch):
            solver = optx.LevenbergMarquardt(ENOUGH, ENOUGH, linear_solver=linear)
            out = optx.least_squares(
                lambda q, batch: residual(scale * q, batch), solver, params / scale,
                batch, max_steps=STEPS, throw=False,
            )  # fmt: skip
            return scale * out.value

        return lambda: {"params": np.asarray(solve(begin, given))}

    return build


def cost(folder: str, params: list[float]) -> Build:
    """What all minimise, at `params` [16], by hydrojax's replay from known starts."""
    import jax
    import jax.numpy as jnp

    from hydrojax.parameters import put

    from .replays import NAMES

    made = problem(folder)
    rig = put(made.model.rig, NAMES, jnp.asarray(params))
    batch = jax.tree.map(jnp.asarray, made.batch)

    def build():
        def call():
            y = predict(rig, batch)
            r = (made.batch.windows.measured - y) / made.batch.noise
            return 0.5 * float(jnp.sum(r**2))

        return call

    return build
