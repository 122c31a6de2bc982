"""Models that know no physics: fitted to runs, simulated through others.

Each is given inputs and output in standard deviations, chooses its size by its free run
through the last fifth of every run it is fitted to, and is then fitted to all of them.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from benchmarks.measured.sets import Run

Simulate = Callable[[Run], Float[np.ndarray, "ticks"]]
"""The output of a run by its inputs, and by what is measured at its very beginning."""

Fit = Callable[[Sequence[Run], int], Simulate]
"""A model of a size."""

HELD_BACK = 0.2
"""Of each run, to choose a size by."""

DIVERGED = 1e3
"""Standard deviations beyond which a free run is no prediction."""


def predicted(
    name: str, fit: Sequence[Run], judged: Sequence[Run]
) -> tuple[float, int] | None:
    """Free-run RMS error of a model over the judged runs, in the output's unit, and
    its size; None where every size diverges.
    """
    build, sizes = PEERS[name]
    mean, size = _scales(fit)
    fit = [_standard(run, mean, size) for run in fit]
    judged = [_standard(run, mean, size) for run in judged]
    early = [_cut(run, 0, 1 - HELD_BACK) for run in fit]
    late = [_cut(run, 1 - HELD_BACK, 1) for run in fit]
    scored = [(_rms(build(early, n), late), n) for n in sizes]
    best, n = min(scored)
    if not np.isfinite(best):
        return None
    error = _rms(build(fit, n), judged)
    return (error * size[-1], n) if np.isfinite(error) else None


def _rms(simulate: Simulate, runs: Sequence[Run]) -> float:
    """RMS error over the counted ticks of all runs; inf where a run diverges."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # of overflow in a free run that diverges
        off = np.concatenate([(simulate(r) - r.y)[r.first :] for r in runs])
    if not np.all(np.isfinite(off)) or np.max(np.abs(off)) > DIVERGED:
        return np.inf
    return float(np.sqrt(np.mean(off**2)))


def _scales(runs: Sequence[Run]) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of the inputs and, last, the output."""
    table = np.concatenate([np.column_stack([r.u, r.y]) for r in runs])
    return table.mean(axis=0), table.std(axis=0)


def _standard(run: Run, mean: np.ndarray, size: np.ndarray) -> Run:
    u, y = (run.u - mean[:-1]) / size[:-1], (run.y - mean[-1]) / size[-1]
    return Run(run.t, u, y, run.first)


def _cut(run: Run, start: float, stop: float) -> Run:
    """A part of a run, of which the first `first` ticks do not count either."""
    part = slice(int(start * run.t.size), int(stop * run.t.size))
    return Run(run.t[part], run.u[part], run.y[part])


# -- linear, with past outputs --


def _rows(run: Run, order: int) -> np.ndarray:
    """Past outputs, past and present inputs and 1, from tick `order` on."""
    seen = np.lib.stride_tricks.sliding_window_view
    y = seen(run.y, order)[:-1]
    u = seen(run.u, order + 1, axis=0).reshape(y.shape[0], -1)
    return np.column_stack([y, u, np.ones(y.shape[0])])


def arx(runs: Sequence[Run], order: int) -> Simulate:
    """A linear model in past outputs and inputs, by least squares."""
    rows = np.concatenate([_rows(r, order) for r in runs])
    wanted = np.concatenate([r.y[order:] for r in runs])
    weights = np.linalg.lstsq(rows, wanted, rcond=None)[0]

    def simulate(run: Run) -> np.ndarray:
        push = _rows(run, order)[:, order:] @ weights[order:]
        y = list(run.y[:order])
        for drive in push:
            y.append(drive + float(np.dot(weights[:order], y[-order:])))
        return np.array(y)

    return simulate


def subspace(runs: Sequence[Run], rank: int) -> Simulate:
    """A linear state-space model by N4SID (nfoursid), of the runs end to end.

    A run begins in the state that its first ticks bear out best.
    """
    import pandas as pd
    from nfoursid.nfoursid import NFourSID

    u = np.concatenate([r.u for r in runs])
    table = pd.DataFrame(u, columns=[f"u{i}" for i in range(u.shape[1])])
    table["y"] = np.concatenate([r.y for r in runs])
    inputs = list(table.columns[:-1])
    found = NFourSID(table, ["y"], inputs, num_block_rows=2 * rank)
    found.subspace_identification()
    model, _ = found.system_identification(rank=rank)
    A, B, C, D = (np.asarray(m, float) for m in (model.a, model.b, model.c, model.d))

    def response(u: np.ndarray, x: np.ndarray) -> np.ndarray:
        y = np.empty(len(u))
        for k, now in enumerate(u):
            y[k] = float((C @ x + D @ now)[0])
            x = A @ x + B @ now
        return y

    def simulate(run: Run) -> np.ndarray:
        few = slice(0, 10 * rank)
        still = response(run.u[few], np.zeros(rank))
        by_state = [response(0 * run.u[few], e) for e in np.eye(rank)]
        x = np.linalg.lstsq(np.array(by_state).T, run.y[few] - still, rcond=None)[0]
        return response(run.u, x)

    return simulate


# -- friction by itself --


def friction(runs: Sequence[Run], reach: int) -> Simulate:
    """A regression by itself for each run, of motion, speed and pressure: a gain, an
    offset, and friction to either side, Coulomb's behind a stop of `reach` thousandths
    of the position's standard deviation, and viscous.

    A run is predicted by the regression of that whose mean pressure is nearest.
    """
    level = [float(run.u[:, 2].mean()) for run in runs]
    weights = [
        np.linalg.lstsq(_rubbing(run, reach), run.y, rcond=None)[0] for run in runs
    ]

    def simulate(run: Run) -> np.ndarray:
        nearest = int(np.argmin(np.abs(np.array(level) - run.u[:, 2].mean())))
        return _rubbing(run, reach) @ weights[nearest]

    return simulate


def _rubbing(run: Run, reach: int) -> np.ndarray:
    x, v, P = run.u.T
    most, stop = reach / 1000, np.zeros_like(x)
    for i, moved in enumerate(np.diff(x), start=1):
        stop[i] = np.clip(stop[i - 1] + moved, -most, most)
    each = [part for a in (stop, v) for part in (np.maximum(a, 0), np.minimum(a, 0))]
    return np.column_stack([*each, P, np.ones_like(P)])


# -- not linear --


def narx(runs: Sequence[Run], order: int) -> Simulate:
    """Products of two past outputs or inputs, chosen by SysIdentPy's FROLS."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    u = np.concatenate([r.u for r in runs])
    lags = list(range(1, order + 1))
    model = FROLS(
        ylag=order,
        xlag=lags if u.shape[1] == 1 else [lags] * u.shape[1],
        n_info_values=25,
        estimator=LeastSquares(),
        basis_function=Polynomial(degree=2),
        model_type="NARMAX",
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of terms it tries and drops
        model.fit(X=u, y=np.concatenate([r.y for r in runs])[:, None])

    def simulate(run: Run) -> np.ndarray:
        y = model.predict(X=run.u, y=run.y[: model.max_lag, None])
        return np.asarray(y)[: run.y.size, 0]

    return simulate


def gru(runs: Sequence[Run], width: int, steps: int = 1500, seed: int = 0) -> Simulate:
    """A gated recurrent unit of so many states, by Adam on stretches of 200 ticks.

    It begins at rest: the first 50 ticks of a stretch do not count, as those of a run.
    """
    import equinox as eqx
    import jax
    import jax.numpy as jnp
    import optax

    count = runs[0].u.shape[1]
    one, two = jax.random.split(jax.random.key(seed))
    model = (
        eqx.nn.GRUCell(count, width, key=one),
        eqx.nn.Linear(width + count, 1, key=two),
    )

    def simulated(model, u):
        cell, out = model

        def tick(state, now):
            state = cell(now, state)
            return state, out(jnp.concatenate([state, now]))[0]

        return jax.lax.scan(tick, jnp.zeros(width), u)[1]

    def loss(model, u, y):
        off = jax.vmap(lambda u: simulated(model, u))(u) - y
        return jnp.mean(off[:, 50:] ** 2)

    rule = optax.adam(optax.cosine_decay_schedule(5e-3, steps))

    @eqx.filter_jit
    def learn(model, state, u, y):
        slope = eqx.filter_grad(loss)(model, u, y)
        change, state = rule.update(slope, state)
        return eqx.apply_updates(model, change), state

    length = min(200, *(r.t.size - 1 for r in runs))
    rng = np.random.default_rng(seed)
    state = rule.init(eqx.filter(model, eqx.is_array))
    for _ in range(steps):
        of = rng.choice(len(runs), 32, p=_shares(runs))
        at = [rng.integers(0, runs[i].t.size - length) for i in of]
        cuts = [(i, slice(k, k + length)) for i, k in zip(of, at, strict=True)]
        u = np.stack([runs[i].u[cut] for i, cut in cuts])
        y = np.stack([runs[i].y[cut] for i, cut in cuts])
        model, state = learn(model, state, u, y)
    whole = jax.jit(simulated)
    return lambda run: np.asarray(whole(model, jnp.asarray(run.u)))


def _shares(runs: Sequence[Run]) -> np.ndarray:
    sizes = np.array([r.t.size for r in runs], float)
    return sizes / sizes.sum()


PEERS: Mapping[str, tuple[Fit, tuple[int, ...]]] = MappingProxyType(
    {
        "ARX": (arx, (1, 2, 4, 8, 16)),
        "subspace (N4SID)": (subspace, (2, 4, 8)),
        "NARX (SysIdentPy)": (narx, (2, 4)),
        "GRU": (gru, (8, 24)),
        "regression of each run": (friction, (5, 10, 20, 30, 50, 100)),
    }
)
"""How each is fitted, and the sizes it chooses from."""
