"""Tunings and sweeps on disk: pictures, and one self-contained page."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from hydrojax.report import page
from hydrojax.report.files import digest, write_all
from hydrojax.tune.accessor import axis_row, sentences
from hydrojax.tune.display import (
    bode_figure,
    ends,
    front_figure,
    gains_table,
    headline,
    limit,
    limits_figure,
    metrics_table,
    sentence,
    show,
)
from hydrojax.tune.plots import sweep_figures
from hydrojax.tune.selection import axes_of, methods_of, nominal
from hydrojax.tune.tuning import Tuning


def tuning_pictures(t: Tuning) -> dict[str, tuple[Figure, str, str]]:
    """Figures with their alternative text and caption, by the name of their file."""
    out = {
        "tune_bode": (
            bode_figure(t), f"Bode plot before and after. {sentence(t)}",
            "Output force over desired force. Lines: the rig itself; shades: the "
            "ensemble's stable plants; dashed: where it leaves 1 dB.",
        )
    }  # fmt: skip
    if t.proposal.tried:
        out["tune_front"] = (
            front_figure(t), "What is aimed at against tracking, peak and noise.",
            "All gains that were run, each at its worst plant. Gains that are worse "
            "than all that hold by far lie outside.",
        )  # fmt: skip
    if t.relaxed:
        out["tune_limits"] = (
            limits_figure(t), f"Bandwidth with each limit taken away. {limit(t)}",
            "The loop tuned again without one of its limits at a time.",
        )  # fmt: skip
    return out


def sweep_pictures(data: xr.Dataset) -> list[page.Picture]:
    """The pictures of a sweep, what matters most first."""
    out = []
    for name, figure in sweep_figures(data).items():
        kind = next(k for k in CAPTIONS if name.startswith(k))
        alt = f"{name.replace('_', ' ')}. {'; '.join(sentences(data))}."
        out.append(page.Picture(name, page.as_png(figure, 120), alt, CAPTIONS[kind]))
    return out


CAPTIONS = {
    "map_within_1dB_95": "What 95 % of the plants reach, in Hz.",
    "map_within_1dB": "Frequency up to which the force follows within 1 dB, in Hz. "
    "Steps of the colours grow where a few cells stand far above all others. A corner "
    "that is wide because it only feeds the desired force forward rejects no "
    "disturbance: look at the peak and the Bode plot of a cell before you take it.",
    "map_peak": "Largest gain from desired to output force, in dB.",
    "map_rms_error": "Tracking error measured in simulation, in N.",
    "map_": "Widest band over the remaining two axes, in Hz.",
    "lines": "Bandwidth, peak and error over the axis; dashed: the rig file's value.",
    "bode": "Output force over desired force of the rig file's gains (of the cell "
    "nearest to them), of the widest cell, and of the one next to instability.",
}
"""By what a picture of a sweep is called."""


NOTES = {
    "adaptation": "Adaptation",
    "amplitude": "Amplitude, N",
    "F_0": "Mean force, N",
    "v": "Speed of the joint, m/s",
    "multisine_runs": "Runs under a multisine",
    "noise_runs": "Runs under noise",
}
"""What a sweep says of itself beside its axes."""


def write_sweep(data: xr.Dataset, out: Path, command_line: str) -> None:
    """Write the pictures and report.html of a sweep into its folder."""
    shown = sweep_pictures(data)
    made = page.made_by(command_line)
    said = page.page(
        Path(__file__).parent / "sweep.html",
        (),
        title=data.attrs["title"],
        said=sentences(data),
        axes=[axis_row(data[name]) for name in axes_of(data)],
        best={method: best_cells(data, method) for method in methods_of(data)},
        names=axes_of(data),
        notes={said: data.attrs[n] for n, said in NOTES.items() if n in data.attrs},
        pictures=shown,
        made=made,
    )  # fmt: skip
    files = {f"{p.name}.png": p.png for p in shown}
    write_all(out, files | {"report.html": said.encode()})


def best_cells(data: xr.Dataset, method: str, most: int = 8) -> list[dict[str, float]]:
    """The widest cells by a method, with what they cost; the widest first."""
    flat = nominal(data)
    band = flat[f"{method}_within_1dB"]
    order = np.argsort(-np.nan_to_num(band.values.ravel(), nan=-1.0), kind="stable")
    out = []
    for i in order[:most]:
        at = np.unravel_index(i, band.shape)
        cell = flat.isel(dict(zip(band.dims, at, strict=True)))
        if not np.isfinite(float(cell[band.name])):
            break
        shown = ("within_1dB", "peak", "gain_margin", "phase_margin", "rms_error")
        row = {name: float(cell[name]) for name in axes_of(data)}
        row |= {
            k: float(cell[f"{method}_{k}"]) for k in shown if f"{method}_{k}" in cell
        }
        out.append(row)
    return out


def write(t: Tuning, out: Path, command_line: str = "") -> None:
    """Write tune.json, rig.toml, the pictures and report.html into a folder."""
    shown = []
    for name, (figure, alt, caption) in tuning_pictures(t).items():
        shown.append(page.Picture(name, page.as_png(figure, 110), alt, caption))
    files = {f"{p.name}.png": p.png for p in shown}
    files["rig.toml"] = t.rig.text.encode()
    record = t.json() | {"rig_toml_sha256": digest(files["rig.toml"])}
    text = json.dumps(record, indent=1, allow_nan=False)
    files["tune.json"] = (text + "\n").encode()
    said = page.page(
        Path(__file__).parent / "report.html",
        (show,),
        t=t,
        gains=gains_table(t),
        rows=metrics_table(t),
        pictures=shown,
        headline=headline(t),
        sentence=sentence(t),
        limit=limit(t),
        ends=ends(t),
        made=page.made_by(command_line),
    )
    files["report.html"] = said.encode()
    write_all(out, files)
