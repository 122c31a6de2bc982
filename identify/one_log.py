"""A logger's filter that was on in one log and not in the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from hydrojax.errors import InputError
from hydrojax.identify.case import Case
from hydrojax.identify.estimation.columns import batch_of, thinned
from hydrojax.identify.estimation.fit import fit_pressures, in_short
from hydrojax.identify.estimation.problem import PRESSURES
from hydrojax.identify.estimation.starts import placed
from hydrojax.identify.tracing.score import Projection, score
from hydrojax.identify.tracing.state import Tracing, free_names
from hydrojax.logs.log import Log
from hydrojax.rigfile.schema import PART

FILTER = "signal_filter"

TAUS = (0.004, 0.012, 0.04, 0.12)
"""Time constants from which it is fitted, s: 40 to 1.3 Hz."""


MUCH = 0.25
"""Share of what stands above the noise that a linear step along the filter takes, from
which it is looked for by fits."""


def with_filter_of_one_log(
    case: Case, state: Tracing, progress: Callable[[str], None]
) -> tuple[Case, tuple[str, ...]]:
    """The case with the logger's filter in one of its logs alone, where that takes most
    of what the model that was found leaves above the noise of the pressures, and a
    remark; else the case itself, and none.

    Of a validation log that is it, the first half is fitted from there on: nothing else
    says what its filter is like. The other half stays what it was.

    Args:
        case: the rig and its logs.
        state: where the trace ended.
        progress: is called with a line of text.
    """
    own, noise = state.criteria, state.noise
    seen = np.isfinite(noise) & PRESSURES
    logs = (*case.as_read[0], *case.as_read[1])
    if FILTER not in state.effects or case.spec.filtered or len(logs) < 2:
        return case, ()
    ratio = [
        p.rms(p.errors_at(state.point.values)) / np.asarray(p.batch.noise)
        for p in (state.problem, state.check)
    ]
    if not np.any(np.array(ratio)[:, seen] > own.at_noise):
        return case, ()
    if not _may_be(case, state):
        return case, ()
    progress("see whether one log's pressures passed a filter")
    given = _left(case, state, logs, ())
    names = tuple(dict.fromkeys(log.name for log in logs))
    left = {name: _left(case, state, logs, (name,)) for name in names}
    best, floor = min(left, key=lambda name: left[name]), float(np.sum(seen))
    # What is late in all logs is the sensors', and takes as much in all of them.
    for other in (given, _left(case, state, logs, names)):
        if left[best] - floor > own.late_leaves * (other - floor):
            return case, ()
    fitted, others, test = case.as_read
    said = (
        f"the pressures of {best} passed a low-pass filter, and those of no other log"
    )
    if best in [log.name for log in others]:
        halves = [_halves(log) for log in others if log.name == best]
        fitted += tuple(first for first, _ in halves)
        others = tuple(_halves(log)[1] if log.name == best else log for log in others)
        said += ": its first half is fitted, and its second half validates"
    spec = replace(case.spec, filtered=(best,))
    with suppress(InputError):  # half of a short log may hold no window
        return case.again(spec, (fitted, others, test)), (said,)
    return case, ()


def _may_be(case: Case, state: Tracing) -> bool:
    """Whether in any log by itself a linear step along the filter takes much of what
    stands above the noise of the pressures, to either side: that asks for no fit.
    """
    values, names = state.point.values, state.problem.model.names
    fitted = [names.index(n) for n in state.problem.side(state.free, True)]
    at = [names.index(f"{FILTER}.tau")]
    fitted = [i for i in fitted if i not in at]
    ends = np.array([[-np.inf, np.inf]])
    for problem, data in ((state.problem, case.fit), (state.check, case.check)):
        noise = np.where(PRESSURES, np.asarray(problem.batch.noise), np.inf)
        gram = np.asarray(problem.sums_at(values, noise).gram)
        ticks = problem.batch.windows.measured.shape[1] * np.isfinite(noise).sum()
        for log in np.unique(data.log):
            own = gram[data.log == log]
            projection = Projection(own, fitted, np.zeros(len(names)))
            found = score(projection, FILTER, at, ends, 1.0, state.criteria.level)
            if found.gain > MUCH * (found.left - len(own) * ticks) > 0:
                return True
    return False


def _left(
    case: Case, state: Tracing, logs: Sequence[Log], filtered: tuple[str, ...]
) -> float:
    """The pressures' squared errors, over their noise, of a fit to all logs: with what
    is free where a trace ended, and a filter in some of the logs.
    """
    own, noise, start = state.criteria, state.noise, state.point.values
    spec = replace(case.spec, filtered=filtered)
    data = replace(case.preparation, spec=spec).data(logs)
    # As many windows as there were: the programs of the search serve them too.
    count = len(in_short(state.problem).batch.P_0)
    batch = thinned(batch_of(data), count)._replace(noise=noise)
    problem = replace(state.problem, batch=batch, known=None)
    seen, free = np.isfinite(noise) & PRESSURES, state.free

    def off(values: np.ndarray) -> float:
        return float(
            np.sum((problem.rms(problem.errors_at(values)) / noise)[seen] ** 2)
        )

    if filtered:
        names = free_names(state.effects[FILTER])
        free = tuple(dict.fromkeys((*free, *names)))
        starts = [placed(problem, start, {f"{FILTER}.tau": tau}) for tau in TAUS]
        start = min(starts, key=off)
    problem, values = fit_pressures(problem, start, free, own.enough_in_search)
    return off(values)


def _halves(log: Log) -> tuple[Log, Log]:
    """A log's two halves by its time, as logs of their own."""
    middle = int(np.searchsorted(log.time, (log.time[0] + log.time[-1]) / 2))
    first = _part(log, "first half", 0, middle)
    return first, _part(log, "second half", middle, len(log.time))


def _part(log: Log, which: str, begin: int, end: int) -> Log:
    """The rows of a log from `begin` to before `end`."""
    inside = (
        (max(a, begin) - begin, min(b, end) - begin)
        for a, b in log.segments
        if max(a, begin) < min(b, end)
    )
    return replace(
        log,
        name=f"{log.name}{PART}{which}",
        time=log.time[begin:end],
        signals={n: y[begin:end] for n, y in log.signals.items()},
        segments=tuple(inside),
    )
