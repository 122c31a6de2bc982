"""A curve said in one of the field's forms, where one does as well as the curve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar

from hydrojax.effects.splines import bspline
from hydrojax.identify.discovery.smooth import Columns, Smooth

Rows = Float[np.ndarray, "rows"]

ROWS = 400
"""Values of the signal at which a form is taken to its spline."""

GRID = 24
"""Values of a form's shape from which its best is sought."""


AS_GOOD = 2.0
"""Difference of information criteria that is no evidence, 1 (Kass and Raftery)."""


@dataclass(frozen=True)
class Form:
    """A law of one signal, linear in its amplitudes.

    Attributes:
        name: what it is called.
        of: its terms at a signal, given the shape; one amplitude multiplies each.
        code: the same in Python; `s` is the signal, `s_0` the shape.
        powers: of the signal's unit in each term, which the amplitude's divides.
        shape: whether there is a shape `s_0`, in the unit of the signal.
        said: the code as it is printed, where corners are rounded in it.
        signed: whether the shape may stand anywhere in the range, not above zero only.
    """

    name: str
    of: Callable[[Rows, float], tuple[Rows, ...]]
    code: tuple[str, ...]
    powers: tuple[int, ...] = (0,)
    shape: bool = True
    signed: bool = False
    said: tuple[str, ...] = ()


def _soft(s: Rows, s_0: float) -> Rows:
    return np.clip(s / s_0, -40.0, 40.0)


FORMS: tuple[Form, ...] = (
    Form("linear", lambda s, _: (s,), ("s",), (1,), False),
    Form(
        "line",
        lambda s, _: (np.ones_like(s), s),
        ("1.0 + 0.0 * s", "s"),
        (0, 1),
        False,
        said=("1", "s"),
    ),
    Form("quadratic", lambda s, _: (s, s**2), ("s", "s**2"), (1, 2), False),
    Form(
        "cubic",
        lambda s, _: (s, s**2, s**3),
        ("s", "s**2", "s**3"),
        (1, 2, 3),
        False,
    ),
    Form("square", lambda s, _: (s**2,), ("s**2",), (2,), False),
    Form("cube", lambda s, _: (s**3,), ("s**3",), (3,), False),
    Form("drag", lambda s, _: (np.abs(s) * s,), ("abs(s) * s",), (2,), False),
    Form("modulus", lambda s, _: (np.abs(s),), ("abs(s)",), (1,), False),
    Form(
        "bell",
        lambda s, s_0: (np.exp(-((s / s_0) ** 2)),),
        ("exp(-minimum((s / s_0) ** 2, {far}))",),
        said=("exp(-((s / s_0) ** 2))",),
    ),
    Form(
        "decay",
        lambda s, s_0: (np.exp(-np.abs(_soft(s, s_0))),),
        ("exp(-minimum(abs(s / s_0), {far}))",),
        said=("exp(-abs(s / s_0))",),
    ),
    Form("saturation", lambda s, s_0: (np.tanh(_soft(s, s_0)),), ("tanh(s / s_0)",)),
    Form(
        "wave",
        lambda s, s_0: (np.sin(2 * np.pi * s / s_0), np.cos(2 * np.pi * s / s_0)),
        ("sin(2 * pi * s / s_0)", "cos(2 * pi * s / s_0)"),
        (0, 0),
    ),
    Form(
        "step",
        lambda s, s_0: (np.tanh(50 * (s - s_0) / np.ptp(s)),),
        ("tanh((s - s_0) / {narrow})",),
        signed=True,
        said=("sign(s - s_0)",),
    ),
    Form(
        "ramp",
        lambda s, s_0: (np.maximum(s - s_0, 0.0),),
        ("{sharp} * logaddexp(maximum((s - s_0) / {sharp}, -{far}), 0.0)",),
        (1,),
        signed=True,
        said=("max(s - s_0, 0)",),
    ),
    Form(
        "ramp down",
        lambda s, s_0: (np.maximum(s_0 - s, 0.0),),
        ("{sharp} * logaddexp(maximum((s_0 - s) / {sharp}, -{far}), 0.0)",),
        (1,),
        signed=True,
        said=("max(s_0 - s, 0)",),
    ),
    Form(
        "dead zone",
        lambda s, s_0: (np.sign(s) * np.maximum(np.abs(s) - s_0, 0.0),),
        (
            "{sharp} * (logaddexp(maximum((s - s_0) / {sharp}, -{far}), 0.0)"
            " - logaddexp(maximum((-s - s_0) / {sharp}, -{farther}), 0.0))",
        ),
        (1,),
        said=("sign(s) * max(abs(s) - s_0, 0)",),
    ),
)
"""Lines and polynomials, |v|v, exponentials, tanh, sine, step, ramps and dead zone."""


@dataclass(frozen=True)
class Formula:
    """A form with its values.

    Attributes:
        form: which.
        amplitudes: of its terms, in units of the curve over the signal's.
        std: of the amplitudes.
        shape: value of `s_0` in the signal's unit, if it has one.
        criterion: Bayesian information criterion, less that of no curve at all;
            `spline` is that of the curve itself.
    """

    form: Form
    amplitudes: tuple[float, ...]
    std: tuple[float, ...]
    shape: float | None
    criterion: float
    spline: float

    def at(self, s: Rows) -> Rows:
        """The law at a signal, in the unit of the curve."""
        terms = self.form.of(s, self.shape or 1.0)
        return sum((a * y for a, y in zip(self.amplitudes, terms, strict=True)), 0 * s)


def onto_splines(
    knots: Float[np.ndarray, "n+4"], rug: Rows
) -> tuple[Rows, Float[np.ndarray, "n rows"]]:
    """Values of a signal spread as its samples are, and what takes a law there to the
    coefficients of its spline.
    """
    rows = np.quantile(rug, np.linspace(0.002, 0.998, ROWS))
    return rows, np.linalg.pinv(np.asarray(bspline(rows, knots)), rcond=1e-6)


def formula_of(
    columns: Columns,
    smooth: Smooth,
    knots: Float[np.ndarray, "n+4"],
    rug: Rows,
    size: float,
    matters: float = 0.0,
) -> Formula | None:
    """The form of the least information criterion, if it does as well as the curve: by
    the criterion, or because what it loses on the curve does not matter.

    Every form is judged by what its spline leaves of the residual, in the directions
    that are the curve's own, with all fitted parameters free to follow; windows count
    as the observations. `size` is the unit of the curve's coefficients, SI, `matters`
    the chi-square of a change that matters.
    """
    windows = len(columns.by_window)
    penalty = np.log(windows)
    c = smooth.c
    spline = _chi2(columns, c) + smooth.degrees * penalty
    # A form is judged by its spline, which follows a corner less well than the form.
    enough = max(spline, _chi2(columns, c) + matters / columns.inflation)
    rows, onto = onto_splines(knots, rug)
    tried = [_best(form, columns, onto, rows, size, penalty) for form in FORMS]
    least = min(f[0] for f in tried)
    if least > enough:
        return None
    # Two that differ by less are as good: the first of them is taken.
    criterion, form, a, std, shape = next(f for f in tried if f[0] < least + AS_GOOD)
    return Formula(form, tuple(a), tuple(std), shape, criterion, spline)


def _chi2(columns: Columns, c: Float[np.ndarray, "k"]) -> float:
    return float(2 * columns.g @ c + c @ columns.H @ c) / columns.inflation


def _best(form, columns, onto, rows, size, penalty):
    """Criterion, form, amplitudes, their standard deviations and shape."""

    def fitted(shape: float):
        terms = np.stack(form.of(rows, shape), axis=1)
        scale = np.maximum(np.max(np.abs(terms), axis=0), 1e-300)
        c = onto @ (terms / scale) / size
        H = c.T @ columns.H @ c
        inverse = np.linalg.pinv(H, rcond=1e-9, hermitian=True)
        a = -inverse @ (c.T @ columns.g)
        std = np.sqrt(np.maximum(columns.inflation * np.diag(inverse), 0.0))
        return _chi2(columns, c @ a), a / scale, std / scale

    count = len(form.powers) + form.shape
    if not form.shape:
        chi2, a, std = fitted(1.0)
        return chi2 + count * penalty, form, a, std, None
    low, high = rows[0], rows[-1]
    if form.signed:
        tried = np.linspace(low, high, GRID + 2)[1:-1]
    else:
        reach = np.ptp(rows) if form.name == "wave" else np.max(np.abs(rows))
        tried = np.geomspace(reach / 50, reach * 2, GRID)
    at = [fitted(s)[0] for s in tried]
    i = int(np.argmin(at))
    ends = tried[max(i - 1, 0)], tried[min(i + 1, GRID - 1)]
    found: Any = minimize_scalar(lambda s: fitted(s)[0], bounds=ends, method="bounded")
    shape = float(found.x) if found.fun < at[i] else float(tried[i])
    chi2, a, std = fitted(shape)
    return chi2 + count * penalty, form, a, std, shape
