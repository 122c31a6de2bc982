"""The picture of an effect: the residual over time, and against its axis."""

from __future__ import annotations

import io

import numpy as np
from jaxtyping import Float
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.lib.stride_tricks import sliding_window_view
from PIL import Image

from hydrojax.effects import EFFECTS
from hydrojax.identify.case import Case
from hydrojax.identify.preparation.noise import CHANNELS
from hydrojax.identify.report.figures import AFTER, BAND, BEFORE, STYLE, sheet
from hydrojax.identify.report.residuals import binned
from hydrojax.identify.results.parts import signals_of
from hydrojax.report.page import as_png
from hydrojax.report.text import engineering, signal_unit, symbol

STRETCH = 2.0
"""Seconds of the residual that are drawn."""

AXES = {"z_rate": "v", "P_s": "P_a1 - P_a2"}
"""What stands for an axis that a log has no signal of, or that does not move here."""

FLOWS = (
    "command",
    "orifice",
    "line",
    "supply",
    "flow",
    "volume",
    "compliance",
    "stretch",
)
"""Places whose effects change flows: the rate of a pressure's residual follows them."""


def draw(
    case: Case,
    name: str,
    held: Float[np.ndarray, "windows ticks 3"],
    left: Float[np.ndarray, "windows ticks 3"],
) -> bytes:
    """The residual of one effect over time and against its axis, as PNG."""
    noise, kind = case.fit.noise, EFFECTS[name]
    raw, fitted = held * noise, left * noise
    flows = kind.place in FLOWS
    size = np.sqrt(np.mean((raw / noise) ** 2, axis=(0, 1)))
    c = int(np.argmax(size[:2])) if flows or kind.place == "sensor_P" else 2
    signals = _signals(case, raw.shape[1])
    axis = AXES.get(kind.residual_axis, kind.residual_axis)
    h = float(np.median(case.fit.windows.h))
    with rc_context(STYLE):
        figure = sheet(2.5)
        time, against = figure.subplots(1, 2, width_ratios=(3, 2))
        shown, per = f"{symbol(CHANNELS[c])} residual", "N" if c == 2 else "Pa"
        factor, unit = engineering(float(np.percentile(np.abs(raw[..., c]), 99)), per)
        rows = _stretch(signals["t"], raw[..., c])
        for y, colour, wide in ((raw, BEFORE, 0.9), (fitted, AFTER, 1.3)):
            t, one = signals["t"][rows], y[rows][..., c] / factor
            gap = np.full((t.shape[0], 1), np.nan)
            time.plot(np.hstack([t, gap]).ravel(), np.hstack([one, gap]).ravel(),
                      color=colour, lw=wide)  # fmt: skip
            rate = _rate(y[..., c], h) if flows else y[..., c]
            _against(against, signals[axis], rate / factor, colour, axis)
        band = noise[c] / factor
        time.axhspan(-band, band, color=BAND, lw=0)
        if not flows:
            against.axhspan(-band, band, color=BAND, lw=0)
        time.set(xlabel="time [s]", ylabel=f"{shown} [{unit}]")
        against.set_ylabel(f"its rate [{unit}/s]" if flows else f"{shown} [{unit}]")
        time.margins(x=0.01)
        handles = [
            Line2D([], [], color=BEFORE, lw=1.5, label="declared parameters held"),
            Line2D([], [], color=AFTER, lw=1.8, label="declared parameters refitted"),
            Patch(color=BAND, label="noise, ±σ"),
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=3, fontsize=8)
        return _few_colours(as_png(figure, 150))


def _few_colours(picture: bytes) -> bytes:
    """A PNG of 48 colours: a quarter of the bytes."""
    out = io.BytesIO()
    Image.open(io.BytesIO(picture)).convert("RGB").quantize(48).save(
        out, "PNG", optimize=True
    )
    return out.getvalue()


def _signals(case: Case, scored: int) -> dict[str, Float[np.ndarray, "windows ticks"]]:
    """The signals that a residual may be drawn against."""
    w = case.fit.windows
    out = signals_of(case.fit, scored, case.spec.geometry["radius"])
    h = float(np.median(w.h))
    P = np.asarray(w.measured[..., 0])
    for name, y in (("F_rate", out["F"]), ("P_rate", P), ("u_rate", out["u"])):
        out[name] = _rate(y, h)
    return out


def _rate(y: np.ndarray, h: float) -> np.ndarray:
    """Rate of a signal along its windows, of means over nine ticks."""
    out = np.full(y.shape, np.nan)
    smooth = sliding_window_view(y, 9, axis=1).mean(axis=-1)
    out[:, 4:-4] = np.gradient(smooth, axis=1) / h
    return out


def _stretch(t: np.ndarray, y: np.ndarray) -> slice:
    """The windows next to each other in which the residual is largest."""
    count = max(1, round(STRETCH / float(np.ptp(t[0]) + 1e-3)))
    size = np.convolve(np.sum(y**2, axis=1), np.ones(count), "valid")
    first = int(np.argmax(size))
    return slice(first, first + count)


def _against(ax: Axes, x: np.ndarray, y: np.ndarray, colour: str, name: str) -> None:
    """Residual against a signal: a cloud, and its mean."""
    good = np.isfinite(x) & np.isfinite(y)
    factor, unit = engineering(
        float(np.percentile(np.abs(x[good]), 99)), signal_unit(name, "V")
    )
    x, y = x[good] / factor, y[good]
    some = slice(None, None, max(1, x.size // 1500))
    ax.plot(x[some], y[some], ".", color=colour, ms=1.8, mew=0, alpha=0.35)
    where, mean, spread = binned(x, y)
    ax.plot(where, mean, "-", color=colour, lw=1.4)
    if colour == BEFORE:  # drawn first, and the larger
        reach = float(np.max(np.abs(mean) + 2.5 * spread, initial=1e-9))
        ax.set_ylim(-reach, reach)
    ax.set_xlim(*np.percentile(x, [0.3, 99.7]))
    ax.set_xlabel(f"{symbol(name)} [{unit}]" if unit else symbol(name))
