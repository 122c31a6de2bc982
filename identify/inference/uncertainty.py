"""Uncertainty of a fit: covariance, limits reached, unidentifiable parameters."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from hydrojax.identify.estimation.fit import FitPoint
from hydrojax.identify.estimation.known import Free, is_of_shapes
from hydrojax.identify.estimation.problem import Problem
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.parameters import Spec, parameter_specs

Interval = tuple[float | None, float | None]


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of the free parameters.

    Attributes:
        std: standard deviations by name, SI; None at an end of the range.
        ends: the parameters at an end of their range.
        unidentifiable: those that the logs do not determine.
        limits: sentences on what is at a range's end, and on which combination of the
            unidentifiable ones the logs do determine.
        inside: the parameters inside their range.
        covariance: of those, SI.
        profiles: 95 % intervals by profile likelihood, where they were computed.
    """

    std: dict[str, float | None]
    ends: frozenset[str]
    unidentifiable: tuple[str, ...]
    limits: tuple[str, ...]
    inside: tuple[str, ...]
    covariance: Float[np.ndarray, "inside inside"]
    profiles: Mapping[str, Interval] = field(default_factory=dict)

    def widened(self, by: Float[np.ndarray, "inside causes"]) -> Uncertainty:
        """The same with what further causes move each parameter inside by, SI, counted
        as one standard deviation; what the logs do not see they do not move.
        """
        seen = np.array([self.std[n] is not None for n in self.inside], dtype=bool)
        by = np.where(seen[:, None], by, 0.0)
        covariance = self.covariance + by @ by.T
        found = np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist()
        std = {
            n: s
            for n, s, is_seen in zip(self.inside, found, seen, strict=True)
            if is_seen
        }
        return replace(self, covariance=covariance, std={**self.std, **std})


def estimate_uncertainty(
    problem: Problem,
    point: FitPoint,
    free: Sequence[str],
    pull: Float[np.ndarray, "free free"] | None = None,
) -> Uncertainty:
    """What the logs say of the free parameters at a fit.

    The covariance is `H^-1 (sum of s s^T) H^-1` over windows as clusters (s a window's
    score), so it holds when residuals are correlated inside a window or above the
    noise; times W/(W - k) for the fitted parameters. Priors count in H and in what is
    summed, as measurements. `pull` is the covariance of gradients, in units of the
    scales, that draw all windows alike, and has that of `problem.known`, if any.
    """
    names = problem.model.names
    gram = np.asarray(problem.sums_at(point.values, point.weights).gram)
    inside, ends, unseen = _sorted(problem, point, free, gram)
    columns = np.array([names.index(n) for n in inside], dtype=int)
    at = [list(free).index(n) for n in inside]
    pull = np.zeros((len(at), len(at))) if pull is None else pull[np.ix_(at, at)]
    covariance, H = _covariance(problem, gram, inside, columns, pull)
    scale = problem.model.scale[columns]
    std: dict[str, float | None] = {name: None for name in free}
    unidentifiable: list[str] = []
    for i, name in enumerate(inside):
        s = float(np.sqrt(max(covariance[i, i], 0.0))) * scale[i]
        std[name] = s
        size = max(abs(point.values[columns[i]]), 0.1 * scale[i])
        wide = not s <= problem.criteria.unidentifiable * size
        if wide or name in unseen:
            unidentifiable.append(name)
        if s > 0.01 * problem.criteria.unseen_std * scale[i]:
            std[name] = None
    specs = parameter_specs(problem.model.rig)
    limits = [
        _at_end(name, end, problem.free[name], specs[name])
        for name, end in ends.items()
        if not is_of_shapes(problem.free[name], specs[name])
    ]
    if unidentifiable:
        limits += _in_words(unidentifiable, unseen, inside, H, problem.criteria)
    return Uncertainty(
        std,
        frozenset(ends),
        tuple(unidentifiable),
        tuple(limits),
        tuple(inside),
        covariance * np.outer(scale, scale),
    )


def _sorted(
    problem: Problem,
    point: FitPoint,
    free: Sequence[str],
    gram: Float[np.ndarray, "windows rows rows"],
) -> tuple[list[str], dict[str, str], set[str]]:
    """Parameters inside their ranges; those at an end, with which; and those that the
    logs hardly show, which are inside wherever they stand.
    """
    names, own = problem.model.names, problem.criteria
    inside: list[str] = []
    ends: dict[str, str] = {}
    index = [names.index(n) for n in free]
    shown = np.sqrt(np.sum(gram, axis=0).diagonal()[index])
    reach = np.array([problem.free[n].upper - problem.free[n].lower for n in free])
    across = shown * reach / problem.model.scale[index]
    shown = shown >= own.hardly_shown * np.max(shown, initial=0.0)
    shown |= across >= own.seen_across
    unseen = {n for n, seen in zip(free, shown, strict=True) if not seen}
    for name in free:
        value, f = point.values[names.index(name)], problem.free[name]
        slack = slack_of(f)
        if name in unseen:  # where nothing holds it says nothing, an end or not
            inside.append(name)
        elif value <= f.lower + slack:
            ends[name] = "lower"
        elif value >= f.upper - slack:
            ends[name] = "upper"
        else:
            inside.append(name)
    return inside, ends, unseen


def curvature(
    problem: Problem, point: FitPoint, free: Sequence[str]
) -> tuple[Float[np.ndarray, "k k"], list[str]]:
    """Curvature of the fit in units of the scales, priors counted, and names."""
    names = problem.model.names
    gram = np.asarray(problem.sums_at(point.values, point.weights).gram)
    columns = np.array([names.index(n) for n in free], dtype=int)
    return _covariance(problem, gram, list(free), columns)[1], list(free)


def slack_of(own: Free) -> float:
    """Distance from an end of its range within which a parameter is at that end, SI."""
    return 1e-9 * max(abs(own.lower), abs(own.upper))


def is_whole(own: Free, spec: Spec) -> bool:
    """Whether the upper end of a parameter's range is all there can be."""
    return spec.whole and own.upper >= spec.upper


def _covariance(
    problem, gram, inside, columns, pull: np.ndarray | float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Covariance and curvature, [k, k], in units of the scales.

    A prior is one more measurement, with a scatter of its own: what no log depends on
    is as sure as its prior.
    """
    r = gram.shape[1] - 1
    told = np.zeros(len(inside))
    H = gram.sum(axis=0)[np.ix_(columns, columns)]
    known = problem.known
    if known is None:
        for i, name in enumerate(inside):
            prior = problem.free[name].prior
            if prior:
                told[i] = (problem.model.scale[columns[i]] / prior) ** 2
        H += np.diag(told)
    else:  # it has the priors in it
        own = [i for i, name in enumerate(known.names) if name in inside]
        at = [inside.index(known.names[i]) for i in own]
        H[np.ix_(at, at)] += known.curvature[np.ix_(own, own)]
    size = np.sqrt(np.maximum(np.diag(H), 1e-300))
    values, vectors = np.linalg.eigh(H / np.outer(size, size))
    seen = values > problem.criteria.unseen_direction
    strong = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T
    strong /= np.outer(size, size)
    s = gram[:, columns, r]
    windows = int(np.count_nonzero(np.any(s != 0, axis=1)))
    few = windows / max(windows - len(columns), 1)
    # A direction that no residual sees has no scores either.
    unseen = vectors[:, ~seen]
    nothing = unseen @ unseen.T * problem.criteria.unseen_std**2
    return strong @ (few * s.T @ s + np.diag(told) + pull) @ strong + nothing, H


def _at_end(name: str, end: str, own: Free, spec: Spec) -> str:
    if end == "lower" and own.lower == 0.0:
        return f"{name} ended at 0: the fit finds none of it in these logs"
    if end == "upper" and is_whole(own, spec) and spec.upper == 1.0:
        return f"{name} ended at 1: these logs show all of it"
    widest = own.upper >= spec.upper if end == "upper" else own.lower <= spec.lower
    mend = ", the widest that its model is meant for" if widest else "; widen the range"
    return (
        f"{name} hit the {end} limit of its range{mend}. No standard deviation is "
        "given there"
    )


def _in_words(
    unidentifiable: list[str],
    unseen: Container[str],
    inside: list[str],
    H: np.ndarray,
    criteria: Criteria,
) -> list[str]:
    """Which parameters the logs do not determine, and with which they trade."""
    size = np.sqrt(np.maximum(np.diag(H), 1e-300))
    values, vectors = np.linalg.eigh(H / np.outer(size, size))
    out = []
    for name in unidentifiable:
        i = inside.index(name)
        if name in unseen:
            out.append(f"{name} is not identified: these logs hardly depend on it")
            continue
        weak = vectors[:, 0]
        partners: list[str] = [
            inside[j]
            for j in np.argsort(-np.abs(weak))[:3]
            if abs(weak[j]) > criteria.partner
        ]
        others = [p for p in partners if p != name]
        singular = values[0] < criteria.nearly_singular
        if singular and others and abs(weak[i]) > criteria.partner:
            out.append(
                f"{name} is not identified by itself: the logs determine only a "
                f"combination of it with {' and '.join(others)}"
            )
        else:
            out.append(
                f"{name} is not identified: its standard deviation exceeds "
                "half its size"
            )
    return out
