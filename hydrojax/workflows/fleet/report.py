"""fleet.html: one self-contained page over all jobs, and its pictures."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from hydrojax import units
from hydrojax.identify.report.figures import png
from hydrojax.report.files import write_all
from hydrojax.report.page import Picture, made_by, page
from hydrojax.report.text import p_text, quantity_text, words
from hydrojax.rigfile import controller
from hydrojax.rigfile.edit import text
from hydrojax.workflows.fleet import friction, pictures, summary
from hydrojax.workflows.fleet.friction import BOXED, FleetBounds
from hydrojax.workflows.fleet.merged import Fleet
from hydrojax.workflows.fleet.pictures import CROWD, ROW_NUMBER
from hydrojax.workflows.fleet.store import Store
from hydrojax.workflows.fleet.summary import FAR
from hydrojax.workflows.fleet.work import Options

USUAL = Options()
"""How jobs are done where nothing else is said."""

LISTED = 100
"""Lines of a list on the page; the table has all."""
LABELS = 6
"""Labels that have a picture."""


REPORTS = "reports"
"""Folder of the pages of single jobs."""


class Named(NamedTuple):
    """A job that needs a look: its name, what is to be said of it, and its key."""

    job: str
    why: str
    key: str


@dataclass(frozen=True)
class Contents:
    """The content of the page."""

    jobs: int
    verdicts: list[tuple[str, int]]
    failures: list[Named]
    reasons: int
    unknown: list[Named]
    unknowns: int
    found: list[summary.Found]
    outliers: dict[str, list[summary.Outlier]]
    drifts: list[summary.Drift]
    parameters: list[tuple[str, str, int, float, float, float]]
    bounds: FleetBounds | None
    labels: list[str]


def look(store: Store, keys: Sequence[str]) -> Contents:
    """The content of the page from the merged table; outliers by job."""
    fleet = Fleet(store.folder / "fleet.parquet")
    whole = fleet.columns("job", "verdict", "sentence", "failed")
    verdicts = Counter(whole["verdict"].dropna())
    failed = whole[whole["failed"].notna()]
    unknown = whole[whole["verdict"] == "unknown"]
    some = list(_records(store, keys))
    apart: dict[str, list[summary.Outlier]] = {}
    for outlier in summary.outliers(fleet):
        apart.setdefault(outlier.job, []).append(outlier)
    return Contents(
        len(whole),
        sorted(verdicts.items(), key=lambda v: -v[1]),
        _named(failed, "failed", keys),
        len(failed),
        _named(unknown, "sentence", keys),
        len(unknown),
        summary.effects(fleet, some),
        apart,
        summary.drifts(fleet),
        [_spread(fleet, name) for name in fleet.parameters],
        friction.friction_box(some),
        fleet.labels,
    )


def _named(rows: Any, column: str, keys: Sequence[str]) -> list[Named]:
    """The first rows with what is said of them."""
    told: Any = rows[:LISTED]
    at = zip(told.index, told["job"], told[column], strict=True)
    return [Named(job, why, keys[int(i)]) for i, job, why in at]


def job_pages(
    store: Store,
    named: Sequence[Named],
    title: str,
    options: Options,
    made: Mapping[str, str],
) -> dict[str, str]:
    """A page for each job that needs a look, by the name of its file.

    It has what the store keeps of the job, and the command for its full report.
    """
    table = Fleet(store.folder / "fleet.parquet").columns(
        "job", "rig", "fit", "validate"
    )
    rows, more = table.set_index("job"), _as_given(options)
    out = {}
    for job, why, key in named:
        own = rows.loc[job].fillna("")
        fit, checks = (str(own[n]).split(";") if own[n] else [] for n in OWN_LOGS)
        call = [options.command, str(own["rig"]), *fit]
        call += ["--validate", *checks] if checks else []
        call += more
        line = shlex.join(["hydrojax", *call, "--out", "report"])
        out[f"{key}.html"] = page(
            Path(__file__).parent / "job.html",
            (quantity_text, words),
            job=job, why=why, title=title, command=line, rig=own["rig"], fit=fit,
            validate=checks, made=made, record=NOTHING | (store.load(key) or {}),
        )  # fmt: skip
    return out


def _as_given(options: Options) -> list[str]:
    """The words with which one job is done as the fleet was."""
    names = ["horizon", "starts"]
    names += ["matters", "level"] if options.command == "trace" else []
    out: list[str] = []
    for name in names:
        if (value := getattr(options, name)) != getattr(USUAL, name):
            out += [f"--{name}", f"{value!r}"]
    out += ["--profile"] if options.profile else []
    return out + (["--effects", *options.effects] if options.effects else [])


OWN_LOGS = ("fit", "validate")
NOTHING: dict[str, Any] = {"channels": {}, "effects": [], "parameters": {}}
"""What the store keeps of a job that failed."""


def _records(store: Store, keys: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Results that did not fail; of a very long table, some drawn at random."""
    order: Any = range(len(keys))
    if len(keys) > BOXED:
        order = np.sort(np.random.default_rng(0).permutation(len(keys))[:BOXED])
    for i in order:
        record = store.load(keys[int(i)])
        if record and not record["failed"]:
            yield record


def _spread(fleet: Fleet, name: str) -> tuple[str, str, int, float, float, float]:
    """Name, unit, number of fits that identify it, and its 5, 50, 95 % quantiles."""
    own = fleet.identified(name)["value"].to_numpy(float)
    at = np.quantile(own, [0.05, 0.5, 0.95]) if len(own) else np.full(3, np.nan)
    low, middle, high = at.tolist()
    return name, fleet.unit(f"parameter.{name}"), len(own), low, middle, high


def controller_lines(bounds: FleetBounds) -> list[str]:
    """The box as lines for [controller], in the paper's units."""
    out = []
    for name, *ends in zip(
        bounds.box.names, bounds.box.lower, bounds.box.upper, strict=True
    ):
        unit = controller.written_unit(name)
        factor = units.to_si(1.0, unit, controller.si(unit), name)
        low, high = (text(float(f"{e / factor:.4g}"), unit) for e in ends)
        out.append(f'{name} = ["{low}", "{high}"]')
    return out


def draw_fleet(store: Store, seen: Contents) -> list[Picture]:
    """The pictures for which there is data."""
    fleet = Fleet(store.folder / "fleet.parquet")
    out = []

    def show(name: str, figure: Figure | None, alt: str, caption: str) -> None:
        if figure is not None:
            out.append(Picture(name, png(figure), alt, caption))

    said = (
        "Every fit that identifies the parameter, with its 95 % interval; orange: a "
        f"robust z score beyond {FAR:g}."
    )
    if seen.jobs > CROWD:
        said = (
            "Median of the fits, and the range of 90 % of them, in parts of the axis "
            f"with equally many; orange: a robust z score beyond {FAR:g}."
        )
    for i, name in enumerate(seen.labels[:LABELS] or [""]):
        what = name or ROW_NUMBER
        figure = pictures.label_figure(fleet, name)
        show(f"fleet_label_{i + 1}", figure, f"Parameters against {what}.", said)
    rows = ", ".join(f"{words(f.name)} {f.jobs}" for f in seen.found)
    ran = seen.jobs - seen.reasons
    show(
        "fleet_effects",
        pictures.effect_figure(seen.found, ran),
        f"Effects found: {rows}.",
        "How many fits found each effect.",
    )
    if seen.bounds:
        show(
            "fleet_friction",
            pictures.friction_figure(seen.bounds),
            "Friction parameters of the fits, and the bounds around them.",
            "Friction of every fit about as certain as most (spread vertically for "
            "legibility), their mean, and the box that contains all friction "
            "parameters of the next run with 95 % confidence. The fits' own "
            "uncertainty is removed, so fits may lie outside the box while friction "
            "does not.",
        )
    return out


def fleet_page(
    seen: Contents, shown: Sequence[Picture], title: str, made: Mapping[str, str]
) -> str:
    """fleet.html, with its pictures inside."""
    lines = controller_lines(seen.bounds) if seen.bounds else []
    return page(
        Path(__file__).parent / "fleet.html",
        (quantity_text, p_text, words),
        s=seen,
        pictures=shown,
        title=title,
        lines=lines,
        far=FAR,
        listed=LISTED,
        reports=REPORTS,
        made=made,
    )


def write_fleet_report(
    store: Store,
    keys: Sequence[str],
    title: str,
    options: Options = USUAL,
    command_line: str = "",
) -> Contents:
    """Write fleet.html and its pictures beside the table.

    Args:
        store: where the table and the results are.
        keys: of the jobs, in order.
        title: what the fleet is called.
        options: how every job was done.
        command_line: by which the results came about.
    """
    seen = look(store, keys)
    shown = draw_fleet(store, seen)
    made = made_by(command_line)
    single = job_pages(store, [*seen.failures, *seen.unknown], title, options, made)
    folder = store.folder / REPORTS
    old = [p.name for p in folder.glob("*.html")]
    if single or old:
        write_all(folder, {n: text.encode() for n, text in single.items()}, old)
    files = {f"{p.name}.png": p.png for p in shown}
    files["fleet.html"] = fleet_page(seen, shown, title, made).encode()
    write_all(store.folder, files, [p.name for p in store.folder.glob("fleet_*.png")])
    return seen
