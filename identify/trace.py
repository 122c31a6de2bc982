"""The loop: fit, residual, the effect behind it, refit, error before and after."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import stats

from ..params import Effect, specs
from ..rig import HYDRAULIC
from .fit import Point, fit_force, fit_jointly, fit_pressures, only
from .problem import PRESSURES, Problem
from .score import Projection, Score, family, score

AT_NOISE = 1.1
"""A channel is at its noise when its error is within this factor of it."""
SHARE = 0.2
"""An effect that leaves a channel above its noise is named only if it took at least
this share of the channel's excess (in squares): less is bending, not explaining."""
PROMISING = 0.02
"""Share of chi-square from which a candidate is refitted whatever its score's p-value:
under a second missing effect the windows' scores scatter, and the test is weak."""
TRIES = 4
"""Candidates that are refitted in a round, and as many more as score nearly as high."""
ROUNDS = 4
"""Effects that a stage may add."""
FRICTION = ("velocity", "level", "friction")
"""Places of effects that friction's own parameters stand in for."""
BEYOND_CHANCE = 3.0
"""Standard errors by which the validation error must fall."""


@dataclass(frozen=True)
class Added:
    """An effect that was added, and what it did to the validation error, [3], SI."""

    name: str
    p_value: float
    before: np.ndarray
    after: np.ndarray
    cannot_tell_from: tuple[str, ...]


@dataclass(frozen=True)
class Tracing:
    """The state of a trace.

    `problem` and `check` hold the logs that are fitted and those that are not;
    `effects` the candidates as they stand dormant in the model; `free` what is fitted
    now; `point` where the fit stands. `scores` and `tried` say what is known of each
    candidate, `added` what was found, in order.
    """

    problem: Problem
    check: Problem
    effects: Mapping[str, Effect]
    free: tuple[str, ...]
    point: Point
    matters: float
    level: float
    tell: Callable[[str], None]
    added: tuple[Added, ...] = ()
    scores: Mapping[str, Score] = field(default_factory=dict)
    tried: Mapping[str, str] = field(default_factory=dict)

    @property
    def noise(self) -> np.ndarray:
        """Each channel's noise, [3]."""
        return np.asarray(self.problem.batch.noise)

    @property
    def named(self) -> dict[str, float]:
        """Every parameter's value by name, SI."""
        return dict(
            zip(self.problem.model.names, self.point.values.tolist(), strict=True)
        )


def trace(state: Tracing) -> Tracing:
    """Look for effects until none is left that matters: pressures first, then all.

    Force stands downstream of pressure, so what the pressures lack is found on them
    alone; what is then left in the force cannot be the hydraulics' fault. `state` has
    its pressures fitted (`fit_pressures`).
    """
    if state.problem.sees_pressures:
        upstream = {
            n: e
            for n, e in state.effects.items()
            if e.place in HYDRAULIC or e.place == "sensor_P"
        }
        state = _stage(state, upstream, only(state.noise, PRESSURES))
    if np.isfinite(state.noise[2]):
        problem, point = fit_force(state.problem, state.point.values, state.free)
        state = replace(state, problem=problem, point=point)
        state = _stage(state, state.effects, state.noise)
    return _without_needless(state)


def _without_needless(state: Tracing) -> Tracing:
    """Let go of effects that the later ones made needless, the earliest first."""
    for name in [a.name for a in state.added[:-1]]:
        effect = state.effects[name]
        gone = set(free_names(effect))
        free = tuple(n for n in state.free if n not in gone)
        values = state.point.values.copy()
        for n in strengths(effect):
            values[state.problem.model.names.index(n)] = 0.0
        state.tell(f"refit without {name}")
        problem, point = fit_jointly(state.problem, values, free, state.point.weights)
        own, less = (
            state.check.rms(state.check.errors_at(p.values))
            for p in (state.point, point)
        )
        if np.all(less <= own + state.matters * state.noise):
            state.tell(f"let go of {name}")
            state = replace(
                state,
                problem=problem,
                point=point,
                free=free,
                added=tuple(a for a in state.added if a.name != name),
                tried={**state.tried, name: "needless"},
            )
    return state


def _stage(state: Tracing, effects: Mapping[str, Effect], noise: np.ndarray) -> Tracing:
    for _ in range(ROUNDS):
        known = {a.name for a in state.added}
        rest = {n: e for n, e in effects.items() if n not in known}
        scores = _scores(state, rest, noise)
        state = replace(state, scores={**state.scores, **scores})
        more = _round(state, rest, scores, noise)
        if len(more.added) == len(state.added):
            return more
        state = more
    return state


def strengths(effect: Effect) -> list[str]:
    """Names of an effect's strengths, as the model has them."""
    return [f"{effect.name}.{n}" for n, s in specs(effect).items() if s.strength]


def free_names(effect: Effect) -> list[str]:
    """Names of all parameters of an effect, as the model has them."""
    return [f"{effect.name}.{n}" for n in specs(effect)]


def _size_that_matters(state: Tracing, noise: np.ndarray) -> float:
    """Chi-square of an RMS error that grows by `matters` of one channel's noise.

    In the channels' present weights, and of the channel where it is least.
    """
    windows, ticks, _ = state.problem.batch.windows.measured.shape
    seen = np.isfinite(noise)
    grown = 1 + state.matters * noise[seen] / state.point.weights[seen]
    return float(np.min(grown**2 - 1)) * windows * ticks


def _scores(
    state: Tracing, effects: Mapping[str, Effect], noise: np.ndarray
) -> dict[str, Score]:
    """Every candidate's score at the present fit, each at its best shape."""
    names = list(state.problem.model.names)
    weights = np.where(np.isfinite(noise), state.point.weights, np.inf)
    matters = _size_that_matters(state, noise)
    free = [names.index(n) for n in state.free]
    prior = np.zeros(len(names))
    for i in free:
        known = state.problem.free[names[i]].prior
        prior[i] = state.problem.model.scale[i] / known if known else 0.0
    grids = [
        len(s.grid)
        for e in effects.values()
        for s in specs(e).values()
        if not s.strength
    ]
    best: dict[str, Score] = {}

    def projected(values: np.ndarray, fitted: Sequence[int]) -> Projection:
        gram = np.array(state.problem.sums_at(values, weights).gram)
        return Projection(gram, fitted, prior)

    for g in range(max([1, *grids])):
        values, shapes = _shaped(state, effects, g)
        projection = projected(values, free)
        for name, effect in effects.items():
            if g > 0 and name not in shapes:
                continue
            columns = [names.index(n) for n in strengths(effect)]
            ends = np.array(
                [
                    (s.lower / s.scale, s.upper / s.scale)
                    for s in specs(effect).values()
                    if s.strength
                ]
            )
            s = score(projection, name, columns, ends, matters, state.level)
            if name not in best or s.gain > best[name].gain:
                best[name] = replace(s, shape=shapes.get(name, {}))
    for name, strength, value in _afar(state, effects, noise):
        shape = {strength: value}
        own = [names.index(n) for n in free_names(effects[name])]
        there = projected(
            _placed(state.problem, state.point.values, shape), [*free, *own]
        )
        left = best[name].left
        if left - there.left > best[name].gain:
            gain = left - there.left
            best[name] = replace(best[name], gain=gain, shape=shape)
    return best


def _afar(
    state: Tracing, effects: Mapping[str, Effect], noise: np.ndarray
) -> list[tuple[str, str, float]]:
    """Effects and the strengths at which they are scored as they stand, where anything
    is left that they could explain.
    """
    far = [(n, *at) for n, effect in effects.items() for at in _far(effect)]
    seen = np.isfinite(noise)
    sse = state.problem.errors_at(state.point.values) if far else np.zeros((1, 3))
    above = state.problem.rms(sse) > (1 + state.matters) * noise
    return far if np.any(above & seen) else []


def _far(effect: Effect) -> list[tuple[str, float]]:
    """Values of strengths at which an effect is tried as it stands: what it does there
    is not foreseen by its derivative at zero.
    """
    return [
        (f"{effect.name}.{field}", value)
        for field, s in specs(effect).items()
        for value in s.grid
        if s.strength
    ]


def _shaped(
    state: Tracing, effects: Mapping[str, Effect], g: int
) -> tuple[np.ndarray, dict[str, dict[str, float]]]:
    """The present values with shapes at their g-th grid value, and those shapes."""
    values = state.point.values.copy()
    names = state.problem.model.names
    shapes: dict[str, dict[str, float]] = {}
    for name, effect in effects.items():
        for f, s in specs(effect).items():
            if not s.strength and g < len(s.grid):
                values[names.index(f"{name}.{f}")] = s.grid[g]
                shapes.setdefault(name, {})[f"{name}.{f}"] = s.grid[g]
    return values, shapes


def _round(
    state: Tracing,
    effects: Mapping[str, Effect],
    scores: Mapping[str, Score],
    noise: np.ndarray,
) -> Tracing:
    """Refit the best few candidates and add the one that helps most, if one does."""
    p = family(scores)
    least = 0.5 * _size_that_matters(state, noise)
    worth = [
        s
        for s in sorted(scores.values(), key=lambda s: -s.gain)
        if s.gain > least and (p[s.name] < state.level or s.share > PROMISING)
    ]
    before = state.check.errors_at(state.point.values)
    tried = dict(state.tried)
    helped: list[tuple[float, str, Problem, Point, np.ndarray]] = []
    for i, s in enumerate(worth):
        if i >= TRIES and s.gain < 0.9 * worth[0].gain:
            break
        state.tell(f"refit with {s.name}")
        problem, point = _refit(state, effects[s.name], s, noise)
        after = state.check.errors_at(point.values)
        tried[s.name] = judge(state, before, after, noise)
        if _negligible(problem, point, effects[s.name]):
            tried[s.name] = "too small"
        if tried[s.name] == "helps":
            helped.append((_cost(after, noise), s.name, problem, point, after))
    state = replace(state, tried=tried)
    if not helped:
        return state
    helped.sort(key=lambda h: h[0])
    _, name, problem, point, after = helped[0]
    p_value = min(p[name], len(scores) * chance(before, after, noise))
    alike = tuple(n for _, n, _, _, a in helped[1:] if not _worse(a, after, noise))
    rms = state.check.rms
    state.tell(f"added {name}")
    return replace(
        state,
        problem=problem,
        point=point,
        free=(*state.free, *free_names(effects[name])),
        added=(*state.added, Added(name, p_value, rms(before), rms(after), alike)),
    )


def _refit(
    state: Tracing, effect: Effect, s: Score, noise: np.ndarray
) -> tuple[Problem, Point]:
    """Fit again with the effect free, from half the step that its score foresees; and,
    as long as that leaves something, from where else it may lie.
    """
    problem = state.problem
    free = (*state.free, *free_names(effect))
    seen = np.isfinite(noise)

    def one(values: np.ndarray) -> tuple[Problem, Point, np.ndarray]:
        if not seen[2]:
            done, values = fit_pressures(problem, values, free)
            point = replace(state.point, values=values)
        else:
            done, point = fit_jointly(problem, values, free, state.point.weights)
        return done, point, done.errors_at(point.values)

    best = one(_stepped(problem, state.point.values, effect, s))
    starts = _elsewhere(state, effect, s, noise)
    while np.any((problem.rms(best[2]) > AT_NOISE * noise)[seen]):
        start = next(starts, None)
        if start is None:
            break
        best = min(best, one(start), key=lambda f: _cost(f[2], noise))
    return best[:2]


def _elsewhere(
    state: Tracing, effect: Effect, s: Score, noise: np.ndarray
) -> Iterator[np.ndarray]:
    """Other values from which to fit an effect, found as they are asked for."""
    problem, here = state.problem, state.point.values
    start = _placed(problem, here, {n: problem.free[n].start for n in state.free})
    for name, value in _far(effect):
        yield _placed(problem, start, {name: value})
        if s.shape.get(name) != value:
            yield _placed(problem, here, {name: value})
    if effect.place in ("sensor_P", "sensor_F"):
        return
    for back in _brought_back(problem, here, state.free, effect.place in FRICTION):
        # What the score foresees from there is another step, often of another sign.
        there = replace(state, point=replace(state.point, values=back))
        other = _scores(there, {effect.name: effect}, noise)[effect.name]
        yield _stepped(problem, back, effect, other)


def _stepped(
    problem: Problem, values: np.ndarray, effect: Effect, s: Score
) -> np.ndarray:
    """The values with half the step of an effect's score, at the shape scored."""
    names = problem.model.names
    steps = {
        n: 0.5 * step * problem.model.scale[names.index(n)]
        for n, step in zip(strengths(effect), s.step, strict=True)
    }
    return _placed(problem, values, {**steps, **s.shape})


def _placed(
    problem: Problem, values: np.ndarray, given: Mapping[str, float]
) -> np.ndarray:
    """The values with some of them as given, inside their ranges."""
    values = values.copy()
    for name, value in given.items():
        f = problem.free[name]
        values[problem.model.names.index(name)] = np.clip(value, f.lower, f.upper)
    return values


def _brought_back(
    problem: Problem, values: np.ndarray, free: tuple[str, ...], friction: bool
) -> Iterator[np.ndarray]:
    """The values with mechanical ones back at their start: those at an end of their
    range, if any are, and with `friction` all of them.

    A model that lacks an effect drives its own parameters far off to stand in for it,
    and from there a fit may not find back.
    """
    mechanical = problem.side(free, False)
    at = {n: values[problem.model.names.index(n)] for n in mechanical}
    stuck = []
    for name, f in ((n, problem.free[n]) for n in mechanical):
        slack = 1e-6 * (f.upper - f.lower)
        inside = f.lower + slack < f.start < f.upper - slack
        if inside and not f.lower + slack < at[name] < f.upper - slack:
            stuck.append(name)
    for names in filter(None, (stuck, mechanical if friction else ())):
        yield _placed(problem, values, {n: problem.free[n].start for n in names})


def judge(
    state: Tracing, before: np.ndarray, after: np.ndarray, noise: np.ndarray
) -> str:
    """Whether an effect helps, from validation errors [W, 3] before and after.

    It must lower some channel's error beyond chance (paired by window) by `matters`
    of its noise, and either bring that channel to its noise or take a fair share of
    what stood above it; the latter in the force only where the pressures are explained.
    """
    seen = np.isfinite(noise)
    sigma = noise[seen]
    a, b = state.check.rms(after)[seen], state.check.rms(before)[seen]
    sure = _falls(before[:, seen], after[:, seen]) > BEYOND_CHANCE
    helps = sure & (b - a > state.matters * sigma)
    if not helps.any():
        return "too small" if sure.any() else "does not help"
    share = (b**2 - a**2) / np.maximum(b**2 - sigma**2, 1e-300)
    fair = (a <= AT_NOISE * sigma) | (share > SHARE)
    upstream = seen & PRESSURES
    if np.any((state.check.rms(after) > AT_NOISE * noise) & upstream):
        # What the pressures lack runs on into the force: there only an effect that
        # explains all of it counts, or one that the pressures want themselves.
        fair &= (a <= AT_NOISE * sigma) | PRESSURES[seen]
    if not np.any(helps & fair):
        return "explains too little"
    return "helps"


def _negligible(problem: Problem, point: Point, effect: Effect) -> bool:
    """Whether all of an effect's strengths came out under the least that is it."""
    names = problem.model.names
    return all(
        abs(point.values[names.index(f"{effect.name}.{field}")]) < s.least
        for field, s in specs(effect).items()
        if s.strength
    )


def _falls(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """By how many standard errors squared errors [W, c] fell, by channel.

    Windows are paired. The fall itself is tested and its logarithm too, and the larger
    counts: an effect that acts in a few windows only (a reversal) makes a fall of few
    large terms, whose mean is uncertain though nearly every one of them is clear.
    """
    small = 1e-12 * np.max(before) + 1e-300
    both = (before - after, np.log((before + small) / (after + small)))
    return np.max(
        [
            d.mean(axis=0) * np.sqrt(len(d)) / np.maximum(d.std(axis=0, ddof=1), 1e-300)
            for d in both
        ],
        axis=0,
    )


def chance(before: np.ndarray, after: np.ndarray, noise: np.ndarray) -> float:
    """Chance that errors [W, 3] fell as clearly as they did in their best channel."""
    seen = np.isfinite(noise)
    best = float(np.max(_falls(before[:, seen], after[:, seen])))
    return float(min(2 * seen.sum() * stats.t.sf(best, len(before) - 1), 1.0))


def _cost(sse: np.ndarray, noise: np.ndarray) -> float:
    seen = np.isfinite(noise)
    return float(np.sum(sse[:, seen] / noise[seen] ** 2))


def _worse(a: np.ndarray, b: np.ndarray, noise: np.ndarray) -> bool:
    """Whether errors `a` are larger than `b` beyond chance, paired by window."""
    seen = np.isfinite(noise)
    d = np.sum((a - b)[:, seen] / noise[seen] ** 2, axis=1)
    return bool(d.mean() > 2.0 * d.std(ddof=1) / np.sqrt(len(d)))


def status(state: Tracing, name: str) -> str:
    """`added`, `rejected`, `absent` or `cannot tell`."""
    if any(a.name == name for a in state.added):
        return "added"
    if any(name in a.cannot_tell_from for a in state.added):
        return "cannot tell"
    s = state.scores.get(name)
    if s is None:
        return "cannot tell"
    p = family(state.scores)[name]
    if p < state.level:
        return "rejected"
    return "absent" if s.power >= 0.8 else "cannot tell"
