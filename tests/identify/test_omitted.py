"""What omitted effects add to the intervals: linear models, solved by least squares."""

from types import SimpleNamespace

import numpy as np

from hydrojax.effects import EFFECTS
from hydrojax.identify.estimation.known import Free
from hydrojax.identify.inference.omitted import with_omitted
from hydrojax.identify.inference.uncertainty import Uncertainty
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.identify.tracing.score import Projection, score
from hydrojax.identify.tracing.screen import strength_columns
from hydrojax.identify.tracing.state import Added
from hydrojax.parameters import specs

WINDOWS, TICKS, TRUTH = 80, 25, np.array([2.0, -1.0])
NAMES = ("a", "b", "loadcell_gain.eps", "loadcell_bias.b")
EPS, BIAS = (
    specs(EFFECTS[e])[f].scale
    for e, f in (("loadcell_gain", "eps"), ("loadcell_bias", "b"))
)
SCALE = np.array([1.0, 1.0, EPS, BIAS])


def fitted(seed, gain=0.0, alike=0.95, added=()):
    """A fit of a and b to white noise of 1, a candidate `alike` a in place: the state,
    its uncertainty, and by how much a and b are off.
    """
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(WINDOWS, TICKS, 4))
    X[..., 2] = alike * X[..., 0] + np.sqrt(1 - alike**2) * X[..., 2]
    at = np.array([*TRUTH, gain, 0.0])
    y = X @ at + rng.normal(size=(WINDOWS, TICKS))
    flat = X[..., :2].reshape(-1, 2)
    theta = np.linalg.lstsq(flat, y.ravel(), rcond=None)[0]
    left = y - X[..., :2] @ theta
    # The columns are of one scale's step: of a fortieth, and of N.
    rows = np.concatenate([-X, left[..., None]], axis=-1)
    gram = np.einsum("wti,wtj->wij", rows, rows)
    covariance = np.linalg.inv(flat.T @ flat)
    std = dict(zip("ab", np.sqrt(np.diag(covariance)).tolist(), strict=True))
    state = state_of(gram, theta, added)
    own = Uncertainty(std, frozenset(), (), ("said before",), ("a", "b"), covariance)
    return state, own, theta - TRUTH


def state_of(gram, theta, added):
    effects = {n: EFFECTS[n] for n in ("loadcell_gain", "loadcell_bias")}
    free = {n: Free(0.0, -9.0, 9.0) for n in NAMES}
    problem = SimpleNamespace(
        model=SimpleNamespace(names=list(NAMES), scale=SCALE),
        free=free,
        batch=SimpleNamespace(
            windows=SimpleNamespace(measured=np.zeros((WINDOWS, TICKS, 3)))
        ),
        fits_alike=lambda *_: False,
        sums_at=lambda *_: SimpleNamespace(gram=gram),
    )
    projection = Projection(gram, [0, 1], np.zeros(4))
    scores = {
        n: score(projection, n, *strength_columns(NAMES, e), 1.0, 0.01)
        for n, e in effects.items()
    }
    return SimpleNamespace(
        problem=problem,
        criteria=Criteria(),
        noise=np.array([np.inf, np.inf, 1.0]),
        fitted_noise=lambda noise: noise,
        point=SimpleNamespace(values=np.array([*theta, 0.0, 0.0]), weights=np.ones(3)),
        effects=effects,
        free=("a", "b"),
        added=tuple(Added(n, 0.0, np.ones(3), np.ones(3), ()) for n in added),
        scores=scores,
    )


def test_an_omitted_effect_that_parameters_follow_is_in_their_intervals():
    """It moves a by ten standard deviations and more; b, which has none of it, keeps
    its own.
    """
    off, before, wide, names = [], [], [], []
    for seed in range(20):
        state, own, by = fitted(seed, gain=0.4)
        found = with_omitted(own, state)
        off.append(by / [found.std[n] for n in "ab"])
        before.append(by / [own.std[n] for n in "ab"])
        wide.append([found.std[n] / own.std[n] for n in "ab"])
        names.append(found.limits[-1])
    off, before, wide = map(np.array, (off, before, wide))
    assert np.min(np.abs(before[:, 0])) > 10
    assert np.mean(np.abs(off) < 1.96) > 0.93
    assert np.max(wide[:, 1]) < 2
    assert np.max(wide[:, 0]) < 40  # what it moves a by, and no more
    assert all("loadcell_gain shows in these logs" in n for n in names)
    assert all("would move a by is" in n for n in names)


def test_where_nothing_is_omitted_intervals_stay():
    """In 40 fits of noise alone, but for a false alarm or two in a hundred."""
    same = 0
    for seed in range(40):
        state, own, _ = fitted(seed)
        same += with_omitted(own, state) is own
    assert same >= 38


def test_what_is_in_the_model_is_not_counted():
    state, own, _ = fitted(3, gain=0.4, added=("loadcell_gain",))
    assert with_omitted(own, state) is own
