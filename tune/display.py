"""A tuning in words, tables and pictures: for its report, and for notebooks."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hydrojax.report import markup
from hydrojax.report.text import in_picture
from hydrojax.tune.optimize import TIGHT
from hydrojax.tune.tuning import Tuning
from hydrojax.tune.verification import Tried
from hydrojax.units import with_command

PLAYS = ("valve_hysteresis", "backlash")
"""Effects that hold back a small signal whole, so that a loop is open at rest."""

_BEFORE, _AFTER = "#b2382e", "#1f4e9c"

MEASURED = (
    ("Follows", "follows_to", "Hz", min),
    ("Within 1 dB", "within_1dB", "Hz", min),
    ("Lag of 90°", "lag_90", "Hz", min),
    ("Peak", "peak", "dB", max),
    ("Error locked, RMS", "rms", "N", max),
    ("Error moving, RMS", "rms_moving", "N", max),
    ("Largest eigenvalue", "eigenvalue", "", max),
)
"""What runs show: title, field of `Tried`, unit, which plant is the worst."""

ROWS = (
    ("Gain margin", "gain_margin", "dB", 1.0, min),
    ("Phase margin", "phase_margin", "°", 1.0, min),
    ("Delay margin", "delay_margin", "ms", 1e3, min),
    ("Sensitivity while moving", "sensitivity_moving", "dB", 1.0, max),
    ("Force due to sensor noise, RMS", "noise_F", "N", 1.0, max),
    ("Command due to sensor noise, RMS", "noise_u", "{u}", 1.0, max),
)
"""What the linearised loop shows; {u} is the unit of the command."""


def show(value: Any, unit: str) -> str:
    """A number with its unit, which "1" is without; a dash for none."""
    if value is None or not np.isfinite(value):
        return "–"
    digits = ".5g" if not unit else ".3g"
    unit = "" if unit == "1" else unit
    return f"{value:{digits}} {unit}".replace("-", "−").rstrip()


def states(t: Tuning) -> tuple[tuple[str, Tried, dict[str, Any]], ...]:
    """What a tuning compares: a word, its runs, its metrics. Gains for which nothing
    better was found stand alone.
    """
    if t.obstacles:
        return (("as it is", t.proposal.before, t.before),)
    return (
        ("before", t.proposal.before, t.before),
        ("after", t.proposal.after, t.after),
    )


def gains_table(t: Tuning) -> list[tuple[str, ...]]:
    """The gains in each of the states, under their heads."""
    words = [word for word, *_ in states(t)]
    values = (t.start, t.gains)[: len(words)]
    rows = [
        (name, *(f"{v[name]:.4g}" for v in values), t.units[name]) for name in t.gains
    ]
    return [("gain", *words, "unit"), *rows]


def metrics_table(t: Tuning) -> list[tuple[str, ...]]:
    """Figures of the rig itself and of the worst plant in each of the states, under
    their heads.
    """
    out = [("", *(head for word, *_ in states(t) for head in (word, "worst plant")))]
    for title, name, unit, worst in MEASURED:
        cells = []
        for _, tried, _ in states(t):
            values = getattr(tried, name)
            cells += [show(values[0], unit), show(worst(values), unit)]
        out.append((title, *cells))
    for title, name, unit, factor, worst in ROWS:
        unit, cells = with_command(unit, t.file.command_unit), []
        for *_, found in states(t):
            values = np.asarray(found[name]) * factor
            cells.append(show(values[0], unit))
            cells.append(
                show(worst(values) if np.all(np.isfinite(values)) else None, unit)
            )
        out.append((title, *cells))
    return out


def sentence(t: Tuning) -> str:
    """The result in a few sentences: band, peak, phase, tracking, the worst plant."""
    was, now = t.proposal.before, t.proposal.after
    count = now.follows_to.size
    if t.obstacles:
        return (
            f"No gains are proposed: of {len(t.proposal.tried)} tried, none holds in "
            f"the runs on all {count} plants. In the way of the best: "
            f"{'; '.join(t.obstacles)}.{_also_before(t)}"
        )
    small, size = t.amplitudes
    said = (
        f"At amplitudes of {small:.3g} and {size:.3g} N, F follows F_d "
        f"(|1 − F/F_d| at most {t.tolerance:g}) up to {now.follows_to.min():.1f} Hz "
        f"on the worst of {count} plants, {was.follows_to.min():.1f} before: within "
        f"1 dB up to {now.within_1dB.min():.1f} Hz ({was.within_1dB.min():.1f}), lag "
        f"of 90° at {now.lag_90.min():.1f} Hz ({was.lag_90.min():.1f}), peak "
        f"{now.peak.max():.1f} dB ({was.peak.max():.1f}). With the joint moving at up "
        f"to {1e3 * t.speed:.3g} mm/s it tracks to {now.rms_moving[0]:.3g} N RMS on "
        f"the rig itself ({was.rms_moving[0]:.3g} before) and "
        f"{now.rms_moving.max():.3g} N on the worst plant "
        f"({was.rms_moving.max():.3g})."
    )
    if now.peak.max() >= t.limits.peak_dB + 0.05:
        said += f" The limit of {t.limits.peak_dB:g} dB on the peak is not kept."
    if not was.sound:
        said += f" Before, {_oscillating(t)} of {count} plants oscillate."
    if t.edges:
        said += f" At an end of the range that was searched: {', '.join(t.edges)}."
    return said.replace("-", "−")


def headline(t: Tuning) -> str:
    """The result in one short sentence."""
    was, now = t.proposal.before, t.proposal.after
    count = now.follows_to.size
    if t.obstacles:
        return (
            f"No gains are proposed: none that were tried hold on all {count} plants."
        )
    before = f"{was.follows_to.min():.1f} Hz before."
    if not was.sound:
        before = f"before, {_oscillating(t)} of them oscillate."
    return (
        f"F follows F_d up to {now.follows_to.min():.1f} Hz on the worst of {count} "
        f"plants; {before}"
    )


def _also_before(t: Tuning) -> str:
    """Of a refusal: that the present gains oscillate, too, and in what play."""
    if t.proposal.before.sound:
        return ""
    count = t.proposal.before.follows_to.size
    play = [name for name in PLAYS if name in t.file.effects]
    why = f": small commands are lost in {' and '.join(play)}" if play else ""
    many = f"{_oscillating(t)} of {count} plants"
    return f" The present gains oscillate, too, on {many}{why}."


def _oscillating(t: Tuning) -> int:
    """How many plants oscillate with the gains before."""
    return int(np.sum(~t.proposal.before.calm))


def summary(t: Tuning) -> str:
    """Gains, metrics before and after, and what limits the loop, as plain text."""
    parts = [
        f"{t.name}: {sentence(t)}",
        _columns(gains_table(t)),
        _columns(metrics_table(t)),
        limit(t),
    ]
    return "\n\n".join((*parts, *t.notes))


def _columns(table: list[tuple[str, ...]]) -> str:
    """Rows under their heads, the first column to the left, the others to the right."""
    wide = [max(map(len, column)) for column in zip(*table, strict=True)]
    return "\n".join(
        "  ".join(
            cell.rjust(n) if i else cell.ljust(n)
            for i, (cell, n) in enumerate(zip(row, wide, strict=True))
        ).rstrip()
        for row in table
    )


def limit(t: Tuning) -> str:
    """What limits the loop most, in words."""
    if t.obstacles and any(name in t.file.effects for name in PLAYS):
        return (
            "Which limit holds the loop back cannot be said: at rest it is open, its "
            "command lost in a play."
        )
    gains = [r for r in t.relaxed if r.gain > 0.03]
    if not t.relaxed:
        return "No limit was examined."
    if not gains:
        return "Relaxing any single limit widens the band by at most 3 %."
    top = gains[0]
    return (
        f"The main limit is {top.what.partition(':')[0]}: relaxed, the linearised "
        f"loop's band on the worst plant goes from {top.band / (1 + top.gain):.1f} to "
        f"{top.band:.1f} Hz."
    )


def ends(t: Tuning) -> list[str]:
    """Names of the limits that the tuned loop reaches."""
    return [name for name, left in t.optimum.slack.items() if abs(left) < TIGHT]


def bode_figure(t: Tuning) -> Figure:
    """Gain and phase in each of the states, with the ensemble's range."""
    fig = Figure(figsize=(8.0, 6.2), layout="constrained")
    top, bottom = fig.subplots(2, 1, sharex=True)
    for (label, _, found), colour in zip(states(t), (_BEFORE, _AFTER), strict=False):
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
    top.set_title(f"{in_picture(t.name)}: linearised, adaptation live", fontsize=10)
    return fig


def limits_figure(t: Tuning) -> Figure:
    """What each limit costs, as bars."""
    fig = Figure(figsize=(8.0, 0.42 * len(t.relaxed) + 1.3), layout="constrained")
    ax = fig.subplots()
    names = [r.what for r in t.relaxed][::-1]
    ax.barh(names, [r.band for r in t.relaxed][::-1], color=_AFTER, alpha=0.75)
    first = t.relaxed[0]
    now = first.band / (1 + first.gain)
    ax.axvline(now, color="black", lw=1.2, label=f"now {now:.1f} Hz")
    ax.set_xlabel("smooth band of the worst plant, linearised (Hz)")
    ax.legend(loc="lower right", fontsize=8)
    ax.grid(alpha=0.3, axis="x")
    return fig


def front_figure(t: Tuning) -> Figure:
    """The aim against tracking, peak and noise of all gains that were run."""
    fig = Figure(figsize=(9.6, 3.7), layout="constrained")
    tried = t.proposal.tried
    reached = np.abs([t.aim.measured(j.tried.figures(None)) for j in tried])
    holds = np.array([not j.faults for j in tried])
    panels = (
        ("rms_moving", "error, joint moving (N RMS)", "log"),
        ("peak", "peak (dB)", "linear"),
        ("noise", "force by the sensors' noise (N RMS)", "log"),
    )
    now, was = t.proposal.after, t.proposal.before
    marks = [(was, "s", _BEFORE, states(t)[0][0])]
    if not t.obstacles:
        marks.append((now, "o", _AFTER, "chosen"))
    for ax, (name, says, scale) in zip(fig.subplots(1, 3), panels, strict=True):
        worst = np.array([getattr(j.tried, name).max() for j in tried])
        for which, colour, label in (
            (~holds, "0.7", "something speaks against"),
            (holds, _AFTER, "holds on all plants"),
        ):
            ax.plot(reached[which], worst[which], ".", color=colour, ms=5, label=label)
        # No noise comes through a loop that a play leaves open.
        if scale == "log" and not np.any(worst > 0):
            scale = "linear"
        ax.set_yscale(scale)
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_formatter("{x:g}" if scale == "log" else "")
        # What is far from any use would press the rest into a corner.
        good = worst[holds] if holds.any() else np.array([getattr(was, name).max()])
        span = np.ptp(good) + 6.0
        ends = (good.min() / 2, 4 * good.max()) if scale == "log" else (
            min(good.min() - 1.0, 0.0), good.max() + span)  # fmt: skip
        if np.all(np.isfinite(ends)) and (scale == "linear" or ends[0] > 0):
            ax.set_ylim(*ends)
        if not np.any(reached > 0):
            ax.set_xlim(-0.1, 1.0)
            ax.text(
                0.97, 0.95, "0 for all gains\nthat were tried", ha="right", va="top",
                transform=ax.transAxes, fontsize=8,
            )  # fmt: skip
        for one, mark, colour, label in marks:
            _marked(
                ax, abs(t.aim.measured(one.figures(None))), getattr(one, name).max(),
                marker=mark, color=colour, mec="black", ms=8, ls="", label=label,
            )  # fmt: skip
        ax.set_ylabel(says, fontsize=9)
        ax.set_xlabel(t.aim.reached, fontsize=9)
        ax.grid(alpha=0.3)
    lines, names = fig.axes[0].get_legend_handles_labels()
    fig.legend(lines, names, loc="outside lower center", ncols=4, fontsize=8)
    return fig


def _marked(ax: Axes, x: float, y: float, **style: Any) -> None:
    """A mark; at the edge of the picture, with its value, where it lies above."""
    top = ax.get_ylim()[1]
    if y <= top:
        ax.plot(x, y, **style)
        return
    ax.plot(x, top, clip_on=False, zorder=5, **style)
    text = f"{y:.3g} ↑" if np.isfinite(y) else "not finite ↑"
    side = 1 if x < np.mean(ax.get_xlim()) else -1
    ax.annotate(
        text, (x, top), (8 * side, -4), textcoords="offset points",
        ha="left" if side > 0 else "right", va="top", fontsize=8,
    )  # fmt: skip


def html(t: Tuning) -> str:
    """Gains, metrics before and after, and what limits it: what a notebook shows."""
    limits = [
        (r.what, show(r.band, "Hz"), f"{100 * r.gain:+.0f} %".replace("-", "−"))
        for r in t.relaxed
    ]
    return markup.block(
        markup.paragraph(sentence(t), f"{t.name}:"),
        *(
            markup.table(head, rows)
            for head, *rows in (gains_table(t), metrics_table(t))
        ),
        markup.paragraph(limit(t)),
        markup.table(("without", "Band, worst plant", ""), limits),
    )
