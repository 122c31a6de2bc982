"""Curves that were found, as plain data: values, bands, formulas, files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from hydrojax.effects import EFFECTS
from hydrojax.effects.splines import bspline
from hydrojax.identify.case import Case
from hydrojax.identify.discovery.effect_file import FoundLaw, effect_source
from hydrojax.identify.discovery.formula import formula_of, onto_splines
from hydrojax.identify.discovery.free_form import coefficients
from hydrojax.identify.discovery.laid import Samples, with_laid
from hydrojax.identify.discovery.search import above_noise
from hydrojax.identify.discovery.smooth import band, covariance
from hydrojax.identify.discovery.with_curves import Curve, Search
from hydrojax.identify.estimation.columns import batch_of
from hydrojax.identify.preparation.noise import CHANNELS
from hydrojax.identify.results.curve import FoundCurve, gaps_in
from hydrojax.identify.results.outcome import excess_of
from hydrojax.identify.tracing.screen import size_that_matters

POINTS, RUG = 121, 400
"""Values of the signal at which a curve is given, and samples that are kept of it."""


def found_curves(
    at: Search, start: Search, case: Case, fit: Samples, check: Samples
) -> tuple[FoundCurve, ...]:
    """All curves of a search that began at `start`, in the order they were found.

    `fit` and `check` are what the fitted and the other logs hold of every signal.
    """
    tested = _tested(at, start, case)
    out = []
    for curve in at.curves:
        columns = at.columns[curve.laid.term.name]
        one = _shown(at, curve, columns, case, fit, check)
        out.append(replace(one, test_before=tested[0], test_after=tested[1]))
    return tuple(out)


def _shown(at, curve: Curve, columns, case: Case, fit, check) -> FoundCurve:
    state, term = at.state, curve.laid.term
    names = state.problem.model.names
    own = [names.index(n) for n in coefficients(curve.laid.effect)]
    c, knots = state.point.values[own], np.asarray(curve.laid.effect.knots)
    rug, rest = fit[term.sampled], check[term.sampled]
    seen = (float(knots[0]), float(knots[-1]))
    ends = min(seen[0], float(rest.min())), max(seen[1], float(rest.max()))
    s = np.linspace(*ends, POINTS)
    B = np.asarray(bspline(s, knots))
    _, part = covariance(columns, curve.smooth)
    std = band(columns, curve.smooth, B, above_noise(state, columns.inflation))
    smooth = replace(curve.smooth, c=c)
    matters = size_that_matters(state, state.noise)
    formula = formula_of(columns, smooth, knots, rug, term.size, matters)
    kept = np.quantile(rug, np.linspace(0.0, 1.0, RUG))
    gaps, unit = gaps_in(seen, kept), case.spec.command_unit
    law = FoundLaw(term, knots, c * term.size, seen, formula, unit, gaps)
    law_y = None
    if formula is not None:
        rows, onto = onto_splines(knots, rug)
        law_y = B @ part @ (onto @ formula.at(rows))
    before, after = (state.check.rms(e) for e in (curve.before, curve.after))
    noise = state.noise
    seen_channels = [i for i in range(3) if np.isfinite(noise[i])]
    excess = sum(excess_of(before[i], noise[i]) for i in seen_channels)
    left = sum(excess_of(after[i], noise[i]) for i in seen_channels)
    return FoundCurve(
        name=_untaken(term.name),
        place=term.place,
        signal=term.signal,
        signal_unit=law.signal_unit,
        factor=term.factor,
        unit=law.unit,
        s=s,
        y=B @ part @ c * term.size,
        std=std * term.size,
        seen=seen,
        rug=kept,
        p_value=curve.p_value,
        before=_by_channel(before, seen_channels),
        after=_by_channel(after, seen_channels),
        share=min(max(1 - left / excess, 0.0), 1.0) if excess else 0.0,
        alike=curve.alike,
        law=law.says(),
        law_y=law_y,
        source=effect_source(law, _untaken(term.name)),
    )


def _by_channel(rms: Float[np.ndarray, "3"], seen: list[int]) -> dict[str, float]:
    return {CHANNELS[i]: float(rms[i]) for i in seen}


def _untaken(name: str) -> str:
    """A name that the vocabulary does not have yet."""
    number, out = 2, name
    while out in EFFECTS:
        out, number = f"{name}_{number}", number + 1
    return out


def _tested(at: Search, start: Search, case: Case) -> tuple[dict[str, float], ...]:
    """Errors on the test logs without any curve and with all of them."""
    if case.test is None:
        return {}, {}
    batch = batch_of(case.test)._replace(noise=at.state.noise)
    problem = replace(at.state.check, batch=batch, least=(0, 0, 0))
    problem = with_laid(problem, [c.laid.effect for c in at.curves])
    ends = (start.state.point.values, at.state.point.values)
    seen = [i for i in range(3) if np.isfinite(at.state.noise[i])]
    return tuple(_by_channel(problem.rms(problem.errors_at(v)), seen) for v in ends)
