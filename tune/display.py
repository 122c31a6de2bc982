"""A tuning in words, tables and pictures: for its report, and for notebooks."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hydrojax.report import markup
from hydrojax.report.text import in_picture
from hydrojax.tune.metrics import maximum, minimum
from hydrojax.tune.optimize import TIGHT
from hydrojax.tune.tuning import Tuning

_BEFORE, _AFTER = "#b2382e", "#1f4e9c"

ROWS = (
    ("Within 1 dB", "within_1dB", "Hz", 1.0, min),
    ("Down by 3 dB", "minus_3dB", "Hz", 1.0, min),
    ("Lag of 90°", "lag_90", "Hz", 1.0, min),
    ("Peak", "peak", "dB", 1.0, max),
    ("Gain margin", "gain_margin", "dB", 1.0, min),
    ("Phase margin", "phase_margin", "°", 1.0, min),
    ("Delay margin", "delay_margin", "ms", 1e3, min),
    ("Tracking, RMS", "rms", "N", 1.0, max),
    ("Force due to sensor noise, RMS", "noise_F", "N", 1.0, max),
    ("Command due to sensor noise, RMS", "noise_u", "V", 1.0, max),
)


def show(value: Any, unit: str) -> str:
    """A number with its unit; a dash for none."""
    if value is None or not np.isfinite(value):
        return "–"
    return f"{value:.3g} {unit}".replace("-", "−")


def metrics_table(t: Tuning) -> list[tuple[str, ...]]:
    """Before and after, the rig's and the worst plant's."""
    out = []
    for title, name, unit, factor, worst in ROWS:
        cells = []
        for found in (t.before, t.after):
            values = np.asarray(found[name]) * factor
            cells.append(show(values[0], unit))
            cells.append(
                show(worst(values) if np.all(np.isfinite(values)) else None, unit)
            )
        out.append((title, *cells))
    return out


def sentence(t: Tuning) -> str:
    """The result in one line."""
    was, now = (minimum(f["within_1dB"]) for f in (t.before, t.after))
    if not now:
        return "No gains were found at which every plant of the ensemble is stable."
    peaks = [maximum(f["peak"]) for f in (t.before, t.after)]
    said = f"Within 1 dB up to {now:.1f} Hz for every plant"
    if was:
        said += f", {now / was:.2f} times the {was:.1f} Hz before"
    said += f"; peak at most {peaks[1]:.1f} dB"
    if peaks[0] is not None:
        said += f", {peaks[0]:.1f} before"
    broken = [n for n, s in t.optimum.slack.items() if s < -0.02]
    return said + (f". Not kept: {', '.join(broken)}." if broken else ".")


def summary(t: Tuning) -> str:
    """Gains, metrics before and after, and what limits the loop, as plain text."""
    gains = [
        (name, f"{t.start[name]:.4g}", f"{value:.4g}", t.units[name])
        for name, value in t.gains.items()
    ]
    heads = ("", "before", "worst plant", "after", "worst plant")
    parts = [
        f"{t.name}: {sentence(t)}",
        _columns(("gain", "before", "after", "unit"), gains),
        _columns(heads, metrics_table(t)),
        limit(t),
    ]
    return "\n\n".join((*parts, *t.notes))


def _columns(heads: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Rows under their heads, the first column to the left, the others to the right."""
    wide = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    return "\n".join(
        "  ".join(
            cell.rjust(n) if i else cell.ljust(n)
            for i, (cell, n) in enumerate(zip(row, wide, strict=True))
        ).rstrip()
        for row in (heads, *rows)
    )


def limit(t: Tuning) -> str:
    """What limits the loop most, in words."""
    gains = [r for r in t.relaxed if r.gain > 0.03]
    if not gains:
        return "Relaxing any single limit widens the band by at most 3 %."
    top = gains[0]
    return (
        f"The main limit is {top.what.partition(':')[0]}: relaxed, the worst plant "
        f"reaches {top.band:.1f} Hz, {100 * top.gain:+.0f} %."
    )


def ends(t: Tuning) -> list[str]:
    """Names of the limits that the tuned loop reaches."""
    return [name for name, left in t.optimum.slack.items() if abs(left) < TIGHT]


def bode_figure(t: Tuning) -> Figure:
    """Gain and phase before and after, with the ensemble's range."""
    fig = Figure(figsize=(8.0, 6.2), layout="constrained")
    top, bottom = fig.subplots(2, 1, sharex=True)
    for found, colour, label in (
        (t.before, _BEFORE, "before"),
        (t.after, _AFTER, "after"),
    ):
        stable = np.asarray(found["radius"]) < 1
        H = np.asarray(found["response"])
        dB = 20 * np.log10(np.maximum(np.abs(H), 1e-9))
        angle = np.rad2deg(np.unwrap(np.angle(H), axis=-1))
        for ax, y in ((top, dB), (bottom, angle)):
            if stable.sum() > 1:
                y_s = y[stable]
                ends = y_s.min(0), y_s.max(0)
                ax.fill_between(t.hertz, *ends, color=colour, alpha=0.18, lw=0)
            ax.plot(t.hertz, y[0], color=colour, label=label)
        if stable[0]:
            top.axvline(float(found["within_1dB"][0]), color=colour, lw=0.8, ls="--")
    top.axhspan(-1, 1, color="0.9", zorder=0)
    top.set_ylim(-15, 15)
    bottom.set_ylim(-270, 30)
    top.set_ylabel("|F/F_d| (dB)")
    bottom.set_ylabel("phase (deg)")
    bottom.set_xlabel("frequency (Hz)")
    for ax in (top, bottom):
        ax.set_xscale("log")
        ax.set_xlim(0.5, 200)
        ax.grid(alpha=0.3)
    top.legend()
    top.set_title(f"{in_picture(t.name)}: linearised, adaptation frozen", fontsize=10)
    return fig


def limits_figure(t: Tuning) -> Figure:
    """What each limit costs, as bars."""
    fig = Figure(figsize=(8.0, 0.42 * len(t.relaxed) + 1.3), layout="constrained")
    ax = fig.subplots()
    names = [r.what for r in t.relaxed][::-1]
    ax.barh(names, [r.band for r in t.relaxed][::-1], color=_AFTER, alpha=0.75)
    now = minimum(t.after["within_1dB"])
    ax.axvline(now, color="black", lw=1.2, label=f"now {now:.1f} Hz")
    was = minimum(t.before["within_1dB"])
    ax.axvline(was, color=_BEFORE, lw=1.2, ls="--", label=f"before {was:.1f} Hz")
    ax.set_xlabel("within 1 dB up to, worst plant (Hz)")
    ax.legend(loc="lower right", fontsize=8)
    ax.grid(alpha=0.3, axis="x")
    return fig


def html(t: Tuning) -> str:
    """Gains, metrics before and after, and what limits it: what a notebook shows."""
    gains = [
        (name, f"{t.start[name]:.4g}", f"{value:.4g}", t.units[name])
        for name, value in t.gains.items()
    ]
    limits = [
        (r.what, show(r.band, "Hz"), f"{100 * r.gain:+.0f} %".replace("-", "−"))
        for r in t.relaxed
    ]
    return markup.block(
        markup.paragraph(sentence(t), f"{t.name}:"),
        markup.table(("gain", "before", "after", "unit"), gains),
        markup.table(
            ("", "before", "worst plant", "after", "worst plant"), metrics_table(t)
        ),
        markup.paragraph(limit(t)),
        markup.table(("without", "within 1 dB, worst plant", ""), limits),
    )
