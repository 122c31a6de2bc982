"""Standard deviations of parameters, and which of them the logs show."""

from types import SimpleNamespace

import numpy as np
import pytest

from hydrojax.effects import EFFECTS
from hydrojax.identify.estimation.known import Free
from hydrojax.identify.inference.uncertainty import (
    Uncertainty,
    _at_end,
    _covariance,
    _sorted,
)
from hydrojax.identify.results.summary import _at_ends
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.parameters import parameter_specs
from hydrojax.plant.rig import add


def covariance(columns, residual, priors, scale):
    """Of a linear fit: columns [windows, rows, k], residual [windows, rows]."""
    rows = np.concatenate([columns, residual[..., None]], axis=-1)
    names = [f"p_{i}" for i in range(columns.shape[-1])]
    problem = SimpleNamespace(
        free={n: Free(0.0, -1.0, 1.0, p) for n, p in zip(names, priors, strict=True)},
        model=SimpleNamespace(scale=scale),
        known=None,
        criteria=Criteria(),
    )
    gram = np.einsum("wti,wtj->wij", rows, rows)
    return _covariance(problem, gram, names, np.arange(len(names)))[0]


def test_what_no_log_depends_on_is_as_sure_as_its_prior():
    """Beside a parameter that the logs determine, which keeps its own variance."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(200, 20, 2)) * [1.0, 0.0]
    scale, prior = np.array([1.0, 4.0]), 0.5
    C = covariance(X, rng.normal(size=(200, 20)), (None, prior), scale)
    assert np.sqrt(C[1, 1]) * scale[1] == pytest.approx(prior, rel=1e-9)
    assert C[0, 0] == pytest.approx(1 / np.sum(X[..., 0] ** 2), rel=0.25)


def test_a_prior_about_the_truth_gives_the_scatter_of_estimates():
    """Truth drawn from the prior, noise drawn anew: the mean variance that is given is
    that of the estimates about the truth.
    """
    rng, prior = np.random.default_rng(1), 0.05
    given, found = [], []
    for _ in range(400):
        x = rng.normal(size=(40, 5))
        truth = prior * rng.normal()
        y = x * truth + rng.normal(size=x.shape)
        H = np.sum(x * x) + prior**-2
        at = np.sum(x * y) / H
        C = covariance(x[..., None], y - x * at, (prior,), np.ones(1))
        given.append(C[0, 0])
        found.append(at - truth)
    assert np.mean(given) == pytest.approx(np.var(found), rel=0.15)


def test_one_steep_parameter_does_not_hide_what_logs_show_of_others():
    """The second moves what is compared by 20 standard deviations of its noise across
    its range, a ten-millionth of the first; the third by what rounding leaves.
    """
    slopes = np.array([1e8, 10.0, 1e-4])  # per scale
    names = ["steep", "plain", "dead"]
    problem = SimpleNamespace(
        free={n: Free(0.0, -1.0, 1.0) for n in names},
        model=SimpleNamespace(scale=np.ones(3), names=names),
        criteria=Criteria(),
    )
    point = SimpleNamespace(values=np.array([0.2, 0.3, 1.0]))
    gram = np.diag([*slopes**2, 1.0])[None]
    inside, ends, unseen = _sorted(problem, point, names, gram)
    assert unseen == {"dead"}
    assert inside == names and not ends


def test_what_no_log_shows_gets_no_deviation_from_what_moves_the_rest():
    """Its variance is what rounding leaves, beyond 1e100, and it has no deviation."""
    C = np.diag([4.0, 1e280, 9.0])
    std = {"end": None, "a": 2.0, "dead": None, "b": 3.0}
    own = Uncertainty(std, frozenset(("end",)), ("dead",), (), ("a", "dead", "b"), C)
    by = np.array([[1.0, 0.0], [1e50, 1.0], [0.0, 4.0]])
    wide = own.widened(by)
    assert wide.std == {"a": 5**0.5, "b": 5.0, "end": None, "dead": None}
    rest = np.ix_([0, 2], [0, 2])
    assert np.allclose(wide.covariance[rest], (C + by @ by.T)[rest])
    assert wide.covariance[1, 1] == C[1, 1] and wide.limits == own.limits


def ended(rig, name, value, lower):
    """What a parameter of an added effect may be, and whether its end is called out."""
    effect = name.partition(".")[0]
    dressed = add(rig, [EFFECTS[effect]()])
    specs = parameter_specs(dressed)
    spec = specs[name]
    own = Free(spec.default, lower, spec.upper)
    free = {n: Free(s.default, s.lower, s.upper) for n, s in specs.items()}
    values = dict.fromkeys(specs, 0.01) | {"flow_curve.k": 1.0, name: value}
    state = SimpleNamespace(
        problem=SimpleNamespace(
            model=SimpleNamespace(rig=dressed), free=free | {name: own}
        ),
        effects={effect: EFFECTS[effect]()},
        added=(SimpleNamespace(name=effect),),
        free=(name,),
        named=values,
    )
    ends = Uncertainty({name: None}, frozenset((name,)), (), (), (), np.zeros((0, 0)))
    return spec, own, _at_ends(state, ends)


def test_a_strength_that_is_absent_is_not_called_out(rig):
    """A counterbalance valve in one line alone: a billionth of its range is nothing."""
    upper = parameter_specs(add(rig, [EFFECTS["counterbalance"]()]))
    upper = upper["counterbalance.k_1"].upper
    for value, said in ((0.0, False), (0.9e-9 * upper, False), (upper, True)):
        assert bool(ended(rig, "counterbalance.k_1", value, 0.0)[2]) is said


@pytest.mark.parametrize(
    ("name", "value", "lower", "said", "words"),
    [
        (
            "entrained_air.n",
            1.4 - 1e-13,
            1.0,
            False,
            "the widest that its model is meant for",
        ),
        ("entrained_air.n", 1.1, 1.1, True, "widen the range"),
        ("flow_curve.k", 1.0, -1.0, False, "these logs show all of it"),
        ("flow_curve.p", 5.0, 1.02, True, "the widest that its model is meant for"),
    ],
)
def test_what_can_be_no_more_is_not_called_out(rig, name, value, lower, said, words):
    """Air that is adiabatic, and a valve that opens by its curve alone."""
    spec, own, at_ends = ended(rig, name, value, lower)
    assert at_ends == ((name,) if said else ())
    end = "upper" if value > spec.default else "lower"
    assert words in _at_end(name, end, own, spec)
