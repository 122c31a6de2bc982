"""Figs. 2 to 5 of the paper drawn as it lays them out, and W of (31)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from hydrojax.control import theory
from hydrojax.paper.experiments import within
from hydrojax.paper.records import Experiments, Response, Track

SHOWN = 6.0
"""Seconds of each run that a picture shows: two times to and fro."""

TITLES = {
    "fig2": (
        "Fig. 2  Pressure tracking",
        {
            "a": "(a) ρ_a = 700 V·s/kN",
            "b": "(b) ρ_a = 7 V·s/kN",
            "c": "(c) fixed Â_a = 10 V·s",
            "d": "(d) Â_a = 0",
        },
    ),
    "fig3": (
        "Fig. 3  Force tracking, k̂_0 active",
        {
            "a": "(a) c_1 = c_2 = 100 1/s",
            "b": "(b) c_1 = c_2 = 1 1/s",
            "c": "(c) fixed k̂_cp = k̂_cn = 1 kN",
            "d": "(d) k̂_cp = k̂_cn = 0",
        },
    ),
}
TITLES["fig4"] = ("Fig. 4  Force tracking, k̂_0 = 0", TITLES["fig3"][1])

_GREY, _BLUE, _RED = "0.45", "#1f4e9c", "#b2382e"


def _newton(value: float) -> str:
    return f"{value:.0f} N" if value >= 100 else f"{value:.3g} N"


def tracking_figure(figure: str, cases: dict[str, Track]) -> Figure:
    """Four panels: desired dashed, measured solid, as in Figs. 2 to 4."""
    title, names = TITLES[figure]
    what = "P" if figure == "fig2" else "F"
    fig = Figure(figsize=(8.0, 6.0), layout="constrained")
    fig.suptitle(title)
    for ax, (case, track) in zip(fig.subplots(2, 2).flat, cases.items(), strict=True):
        last = track.t >= track.t[-1] - SHOWN
        t = track.t[last] - track.t[last][0]
        ax.plot(t, track.actual[last] / 1e3, color=_BLUE, lw=1.2, label=f"${what}$")
        ax.plot(
            t, track.desired[last] / 1e3, "--", color="black", lw=1.0,
            label=f"${what}_d$",
        )  # fmt: skip
        ax.set_title(f"{names[case]}   RMS {_newton(track.rms)}", fontsize=10)
        ax.set_xlabel("time (s)")
        ax.set_ylabel(f"{'pressure force' if what == 'P' else 'output force'} (kN)")
        ax.grid(alpha=0.3)
        if case == "a":
            ax.legend(loc="upper right", fontsize=9, ncols=2)
            low, high = ax.get_ylim()
            ax.set_ylim(low, high + 0.18 * (high - low))
    return fig


def response_figure(r: Response) -> Figure:
    """|F/F_d| in dB over frequency: line by white noise, stars by sines (Fig. 5)."""
    fig = Figure(figsize=(8.0, 6.0), layout="constrained")
    top, bottom = fig.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    top.axhspan(-1, 1, color="0.92", zorder=0)
    top.text(1.03, 0.82, "±1 dB", fontsize=9, color=_GREY, va="center")
    top.semilogx(r.noise_hertz, r.noise_dB, color=_BLUE, lw=1.3, label="white noise")
    top.plot(
        r.hertz, r.sines_dB, "*", color=_RED, ms=8, label="sines added to the noise"
    )
    top.plot(
        r.hertz, r.alone_dB, "o", color=_GREY, ms=4, mfc="none", label="sines alone"
    )
    shown = np.concatenate([r.sines_dB, r.alone_dB])
    span = (float(np.min(shown)) - 1.0, float(np.max(shown)) + 1.0)
    edge = within(r.noise_hertz, r.noise_dB)
    top.axvline(edge, color=_GREY, lw=0.8, ls=":")
    top.text(
        edge * 0.98,
        span[0] + 0.6,
        f"{edge:.1f} Hz",
        ha="right",
        fontsize=9,
        color=_GREY,
    )
    top.plot(r.hertz, r.alone_dB, color=_GREY, lw=0.6)
    top.set(ylabel="20 log₁₀|F/F_d| (dB)", ylim=span)
    top.set_title("Fig. 5  Transfer function of output force tracking, joint locked")
    top.legend(loc="upper left", fontsize=9)
    bottom.semilogx(r.noise_hertz, r.coherence, color=_BLUE, lw=1.3)
    bottom.set(xlabel="frequency (Hz)", ylabel="coherence", ylim=(0.9, 1.005))
    ticks = [1, 2, 5, 10, 20, 50, 100, 200]
    bottom.set_xticks(ticks, [str(k) for k in ticks])
    bottom.set_xticks([], minor=True)
    bottom.set_xlim(1, 200)
    for ax in (top, bottom):
        ax.grid(alpha=0.3)
    return fig


def descent_figure(found: Experiments) -> Figure:
    """W of (31) over time, and how much it rises, by sampling rate."""
    fig = Figure(figsize=(8.0, 3.6), layout="constrained")
    left, right = fig.subplots(1, 2)
    rate = min(found.descent)
    fall = found.descent[rate]
    left.plot(fall.t, fall.W / fall.W[0], color=_BLUE, lw=1.3)
    left.set(xlabel="time (s)", ylabel="W / W(0)", ylim=(0, None))
    left.set_title(f"W of (31), matched plant, {rate:.0f} Hz", fontsize=10)
    rates = sorted(found.descent)
    rises = [theory.largest_rise(found.descent[k].W) for k in rates]
    right.loglog(rates, rises, "o-", color=_RED, lw=1.2)
    right.set(xlabel="sampling rate (Hz)", ylabel="largest rise / W(0)")
    right.set_xticks(rates, [f"{k:.0f}" for k in rates])
    right.set_xticks([], minor=True)
    right.set_title("its rise goes to 0 with the step", fontsize=10)
    for ax in (left, right):
        ax.grid(alpha=0.3)
    return fig


def ablation_figure(found: Experiments) -> Figure:
    """The full law beside velocity feedforward and force error alone."""
    full = found.tracks["fig3"]["a"]
    fig = Figure(figsize=(8.0, 3.6), layout="constrained")
    for ax, (name, track) in zip(
        fig.subplots(1, 2, sharey=True),
        {"the full law": full, "without friction model": found.ablation}.items(),
        strict=True,
    ):
        last = track.t >= track.t[-1] - SHOWN
        t = track.t[last] - track.t[last][0]
        ax.plot(t, (track.desired - track.actual)[last], color=_BLUE, lw=1.0)
        ax.set_title(f"{name}   RMS {_newton(track.rms)}", fontsize=10)
        ax.set(xlabel="time (s)", ylabel="F_d − F (N)")
        ax.grid(alpha=0.3)
    return fig


def paper_figures(found: Experiments) -> dict[str, Figure]:
    """Every picture of `hydrojax paper`, by its file's stem."""
    tracks = {
        name.replace("fig", "figure_"): tracking_figure(name, cases)
        for name, cases in found.tracks.items()
    }
    return {
        **tracks,
        "figure_5": response_figure(found.response),
        "lyapunov": descent_figure(found),
        "ablation": ablation_figure(found),
    }
