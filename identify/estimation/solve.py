"""Levenberg-Marquardt with ranges that hold: a descent for optimistix."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int, PyTree

from hydrojax.jax_setup import bucket

DAMPING = 1e-4
"""Damping at optimistix's first step size of 1, as a share of the curvature."""

FARTHEST = 0.2
"""Share of its range by which a coordinate moves in one step at most. What is linear
where a model is far off says little of the other end: where thirty parameters are off
by a fifth, steps without it lead into corners of the box and do not come back.
"""

ENOUGH = 1e-6
"""A fit ends when the next step is predicted to lower the cost by less than this share
of it (and by less than `ENOUGH_CHI2`, which is insignificant beside noise)."""
ENOUGH_CHI2 = 1e-3


class _Quadratic(NamedTuple):
    at: Array
    hessian: Array
    gradient: Array
    predicted: Array  # by how much an almost undamped step would lower the cost


class BoxedNewton(optx.AbstractDescent):
    """A damped Newton step inside a box: what would leave it is held at its bound, and
    what would cross more than `FARTHEST` of it goes that far.

    The damping is a share of each coordinate's own curvature (Marquardt), so it does
    not depend on units. A coordinate that the residual does not see stays put.
    """

    lower: Float[Array, "k"]
    upper: Float[Array, "k"]

    def init(self, y, f_info_struct):
        """Nothing known yet."""
        n = y.shape[0]
        return _Quadratic(y, jnp.eye(n), jnp.zeros(n), jnp.asarray(jnp.inf))

    def query(self, y, f_info, state):
        """Take in the quadratic at an accepted point."""
        J = f_info.jac.as_matrix()
        H, g = J.T @ J, J.T @ f_info.residual
        move = self._move(y, H, g, 1e-8, 1.0)
        return _Quadratic(y, H, g, -(g @ move + 0.5 * move @ H @ move))

    def step(self, step_size, state):
        """The step for a damping of `DAMPING / step_size`."""
        at, H, g, _ = state
        move = self._move(at, H, g, DAMPING / step_size, FARTHEST)
        return move, optx.RESULTS.successful

    def _move(self, at, H, g, damping, farthest):
        """Minimise the damped quadratic inside the box, by at most a share of each of
        its sides: an active set by its duals.
        """
        d = jnp.diagonal(H)
        dead = d <= 1e-12 * jnp.max(d)
        A = H + jnp.diag(jnp.where(dead, 1.0, d * damping))
        size = jnp.diagonal(A)
        far = farthest * (self.upper - self.lower)
        low = jnp.maximum(self.lower - at, -far)
        high = jnp.minimum(self.upper - at, far)

        def better(one, other):
            value = [m @ g + 0.5 * m @ A @ m for m in (one, other)]
            return jnp.where(value[0] < value[1], one, other)

        def turn(_, state):
            move, best = state
            # A bound holds a coordinate that is beyond it, or that would like to be,
            # and lets it go when its gradient points inside.
            wish = move - (g + A @ move) / size
            at_low, at_high = wish < low, wish > high
            held = dead | at_low | at_high
            fixed = jnp.where(at_low, low, jnp.where(at_high, high, 0.0))
            rows = jnp.where(held[:, None], jnp.eye(at.size), A)
            move = jnp.linalg.solve(rows, jnp.where(held, fixed, -g))
            return move, better(jnp.clip(move, low, high), best)

        none = jnp.zeros_like(at)
        free = jnp.linalg.solve(
            jnp.where(dead[:, None], jnp.eye(at.size), A), jnp.where(dead, 0.0, -g)
        )
        start = (free, better(jnp.clip(free, low, high), none))
        return jax.lax.fori_loop(0, 12, turn, start)[1]


def _quiet(**_: Any) -> None:
    """Optimistix asks for something to report each step to."""


BRAKED = 0.01
"""Step size after a failure at most, a damping of 1e-2: with less, a step is the one
that failed again."""

PATIENCE = 4
"""Evaluations over which a fit has to bring what each of its steps has to promise: in a
narrow bent valley a step promises much and keeps next to nothing of it."""

FAILURES, PROMISING = 3, 0.01
"""Failures one after the other that end a fit: the second has a damping of 1e-2, the
third of 1. One more, with a damping of 100, where an almost undamped step promises at
least the second of these as a share of the cost: no minimum, but where a valve shuts.
"""


class _Trust(optx.ClassicalTrustRegion):
    """Optimistix's rule, but that a failure counts however far trust has grown."""

    def step(self, first_step, y, y_eval, f_info, f_eval_info, state):
        """Whether to accept a step, and the size of the next."""
        size, accept, result, state = super().step(
            first_step, y, y_eval, f_info, f_eval_info, state
        )
        size = jnp.where(accept, size, jnp.minimum(size, BRAKED))
        state = eqx.tree_at(lambda s: s.step_size, state, size)
        return size, accept, result, state


class _BoxedLM(optx.AbstractGaussNewton):
    rtol: float
    atol: float
    descent: optx.AbstractDescent
    enough: Float[Array, ""]
    search: optx.AbstractSearch = _Trust(
        # Trust grows sooner than optimistix's own rule lets it: beta and the valve
        # constants are nearly one direction, which heavy damping crosses slowly.
        high_cutoff=0.7,
        low_cutoff=0.1,
        high_constant=10.0,
        low_constant=0.01,
    )
    norm: Callable = optx.max_norm
    verbose: Callable[..., None] = _quiet

    def terminate(self, fn, y, args, options, state, tags):
        """Stop on a small step, when none is predicted to pay, or after failures.

        Without the second rule a fit at its minimum goes on with steps that are
        rejected, and differ from it by rounding.
        """
        cost = 0.5 * jnp.sum(state.f_info.residual**2)
        least = jnp.maximum(self.enough * cost, ENOUGH_CHI2)
        little = state.descent_state.predicted < least
        promising = state.descent_state.predicted > PROMISING * cost
        stuck = state.num_steps_since_acceptance >= FAILURES + promising
        stop = little | stuck
        return state.terminate | (stop & ~state.first_step), state.result


class Fit(NamedTuple):
    """Where a fit ended; with starts ahead where several were run.

    Attributes:
        at: coordinates.
        cost: half the sum of squares there.
        steps: taken.
        converged: whether it did.
        also: what else the misfit gave there.
    """

    at: Float[Array | np.ndarray, "*starts k"]
    cost: Float[Array | np.ndarray, "*starts"]
    steps: Int[Array | np.ndarray, "*starts"]
    converged: Bool[Array | np.ndarray, "*starts"]
    also: PyTree


def minimise(
    gram: Callable,
    start: Float[Array, "k"],
    lower: Float[Array, "k"],
    upper: Float[Array, "k"],
    steps: int = 20,
    tol: float = 1e-5,
) -> Fit:
    """Minimise half a sum of squares inside a box.

    Args:
        gram: coordinates [k] -> Gram matrix [k+1, k+1] of [Jacobian, residual], and
            whatever else is wanted of the place where the fit ends.
        start: coordinates to begin from.
        lower: ends of the box.
        upper: ends of the box.
        steps: at most this many evaluations.
        tol: stop when a step changes every coordinate by less than this.

    The solver is given the Cholesky factor of the Gram matrix in place of Jacobian
    and residual: the same normal equations and cost, of size k+1 and not of the log.
    """
    # XLA's CPU compiler (jaxlib 0.10.2) aborts on this loop where several starts are
    # run side by side over a single coordinate: an idle one is set beside it.
    count, idle = start.size, int(start.size == 1)
    start, lower, upper = (jnp.pad(a, (0, idle)) for a in (start, lower, upper))

    def factor(y, _):
        here = jax.lax.stop_gradient(y)
        G, also = jax.lax.stop_gradient(gram(here[:count]))
        where = np.r_[:count, count + idle]
        G = jnp.zeros((y.size + 1,) * 2).at[np.ix_(where, where)].set(G)
        return _factored(y, (_root(G), here))[0], also

    descent, enough = BoxedNewton(lower, upper), jnp.asarray(ENOUGH)
    solver = _BoxedLM(rtol=tol, atol=tol, descent=descent, enough=enough)
    out = optx.least_squares(
        factor, solver, start, has_aux=True, max_steps=steps, throw=False
    )
    cost = 0.5 * jnp.sum(out.state.f_info.residual**2)
    done = (out.result == optx.RESULTS.successful) & jnp.isfinite(cost)
    return Fit(out.value[:count], cost, out.stats["num_steps"], done, out.aux)


def minimise_step_by_step(
    gram: Callable[[Float[np.ndarray, "k"]], tuple[Float[np.ndarray, "k_1 k_1"], Any]],
    lower: Float[np.ndarray, "k"],
    upper: Float[np.ndarray, "k"],
    steps: int = 20,
    tol: float = 1e-5,
    enough: float = ENOUGH,
) -> Fit:
    """`minimise` from 0, with the Gram matrices made outside of what is compiled: by
    programs that serve more than fits, on as many cores as there are.

    The arguments are those of `minimise`, in NumPy's arrays; `enough` is the share of
    the cost below which a step is not worth taking, by what it promises or by what the
    last ones (`PATIENCE`) brought.
    """
    count = len(lower)
    size = bucket(count)  # few programs serve fits of any size
    low, high = (jnp.pad(jnp.asarray(a), (0, size - count)) for a in (lower, upper))
    descent = BoxedNewton(low, high)
    solver = _BoxedLM(rtol=tol, atol=tol, descent=descent, enough=jnp.asarray(enough))
    where = np.ix_(*[np.r_[:count, size]] * 2)
    y, state, kept, done = jnp.zeros(size), _begun(size), None, False
    result, costs = optx.RESULTS.successful, []
    for _ in range(steps):
        found, also = gram(np.asarray(state.y_eval)[:count])
        G = np.zeros((size + 1, size + 1))
        G[where] = found
        accepted = int(state.num_accepted_steps)
        y, state, (done, result) = _advanced(solver, y, state, jnp.asarray(G))
        if kept is None or int(state.num_accepted_steps) > accepted:
            kept = also
        costs.append(0.5 * float(np.sum(np.asarray(state.f_info.residual) ** 2)))
        before = costs[-1 - PATIENCE] if len(costs) > PATIENCE else np.inf
        done = bool(done) or before - costs[-1] < PATIENCE * enough * costs[-1]
        if done:
            break
    cost = np.asarray(costs[-1])
    fine = done and bool(result == optx.RESULTS.successful)
    return Fit(
        np.asarray(y)[:count],
        cost,
        np.asarray(state.num_steps),
        np.asarray(fine and np.isfinite(cost)),
        kept,
    )


def _root(G: Float[Array, "k_1 k_1"]) -> Float[Array, "k_1 k_1"]:
    """The Cholesky factor of a Gram matrix, as Jacobian and residual."""
    tiny = 1e-13 * jnp.maximum(jnp.diagonal(G), 1e-20)
    return jnp.linalg.cholesky(G + jnp.diag(tiny)).T


def _factored(y: Array, given: tuple[Array, Array]) -> tuple[Array, None]:
    """The residual near where a factor was taken, in the factor's own coordinates."""
    R, here = given
    return R[:, -1] + R[:, :-1] @ (y - here), None


@functools.cache
def _begun(size: int) -> Any:
    """The solver's state ahead of a first step from 0: one for all fits of a size, for
    optimistix keeps in it what it traced, and steps of other states are compiled anew.
    """
    none = jnp.zeros(size)
    descent, enough = BoxedNewton(none, none), jnp.asarray(ENOUGH)
    solver = _BoxedLM(rtol=0.0, atol=0.0, descent=descent, enough=enough)
    shape = jax.ShapeDtypeStruct((size + 1,), none.dtype)
    given = (jnp.zeros((size + 1, size + 1)), none)
    return solver.init(_factored, none, given, {}, shape, None, frozenset())


@eqx.filter_jit
def _advanced(solver: _BoxedLM, y: Array, state: Any, G: Array) -> tuple[Any, ...]:
    """One step of the solver from the Gram matrix at `state.y_eval`; and whether it was
    the last one.
    """
    given = (_root(G), state.y_eval)
    y, state, _ = solver.step(_factored, y, given, {}, state, frozenset())
    return y, state, solver.terminate(_factored, y, given, {}, state, frozenset())


__all__ = ["BoxedNewton", "Fit", "minimise", "minimise_step_by_step"]
