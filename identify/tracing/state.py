"""Where a trace stands: the logs, the candidates, the fit, what was found."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from hydrojax.identify.estimation.fit import FitPoint, only
from hydrojax.identify.estimation.problem import Problem
from hydrojax.identify.tracing.criteria import Criteria
from hydrojax.identify.tracing.score import Score
from hydrojax.parameters import specs
from hydrojax.plant.effect import Effect


@dataclass(frozen=True)
class Added:
    """An effect that was added, with the validation error by channel, RMS, SI."""

    name: str
    p_value: float
    before: Float[np.ndarray, "3"]
    after: Float[np.ndarray, "3"]
    cannot_tell_from: tuple[str, ...]


@dataclass(frozen=True)
class Tracing:
    """The state of a trace.

    `problem` and `check` hold the logs that are fitted and those that are not;
    `effects` the candidates as they stand dormant in the model; `free` what is fitted
    now; `point` where the fit stands. `scores` and `tried` say what is known of each
    candidate, `added` what was found, in order. `question` is called with the state
    whenever something was added, or is to be: it may raise, where an input is at fault.
    """

    problem: Problem
    check: Problem
    effects: Mapping[str, Effect]
    free: tuple[str, ...]
    point: FitPoint
    progress: Callable[[str], None]
    added: tuple[Added, ...] = ()
    scores: Mapping[str, Score] = field(default_factory=dict)
    tried: Mapping[str, str] = field(default_factory=dict)
    question: Callable[[Tracing], None] = lambda _: None

    @property
    def criteria(self) -> Criteria:
        """The thresholds by which it is decided."""
        return self.problem.criteria

    @property
    def noise(self) -> Float[np.ndarray, "3"]:
        """Each channel's noise in the validation logs, SI; inf where not compared."""
        return np.asarray(self.check.batch.noise)

    def fitted_noise(self, noise: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """That in the logs that are fitted, of the channels that `noise` compares."""
        return only(np.asarray(self.problem.batch.noise), np.isfinite(noise))

    @property
    def errors(self) -> Float[np.ndarray, "windows 3"]:
        """Sums of squares that the fit leaves of the validation logs, by window, SI."""
        return self.check.errors_at(self.point.values)

    @property
    def named(self) -> dict[str, float]:
        """Every parameter's value by name, SI."""
        return dict(
            zip(self.problem.model.names, self.point.values.tolist(), strict=True)
        )


def strengths(effect: Effect) -> list[str]:
    """Names of an effect's strengths, as the model has them."""
    return [f"{effect.name}.{n}" for n, s in specs(effect).items() if s.strength]


def free_names(effect: Effect) -> list[str]:
    """Names of all parameters of an effect, as the model has them."""
    return [f"{effect.name}.{n}" for n in specs(effect)]
