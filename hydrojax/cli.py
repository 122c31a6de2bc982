"""The command line: the roof over the whole house."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from . import __version__
from .backend import set_up_jax, user_cache
from .errors import InputError

if TYPE_CHECKING:
    from .identify.outcome import Outcome

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Find the effect behind the residual of a hydraulic force-control model.",
)
console = Console()
errors = Console(stderr=True)

RigFile = Annotated[Path, typer.Argument(help="Rig file (TOML).", show_default=False)]
Logs = Annotated[
    list[Path],
    typer.Argument(help="Logs to fit: CSV(.gz), Parquet or MAT.", show_default=False),
]
Horizon = Annotated[float, typer.Option(help="Length of a replay window, s.", min=0.01)]
Out = Annotated[Path, typer.Option(help="Folder for the report and its figures.")]
Effects = Annotated[
    list[Path] | None,
    typer.Option(help="Python file with effects of your own; may be repeated."),
]


Gains = Annotated[
    list[str] | None,
    typer.Option(
        help="Keys of [controller] to replace, as k_p=1.5 or 'A_a=6 V*s,15 V*s': "
        "all words that follow.",
        show_default=False,
    ),
]
At = Annotated[
    list[str] | None,
    typer.Option(
        help="Operating point and other quantities, as v=0.01 or amplitude=200: "
        "all words that follow.",
        show_default=False,
    ),
]

Profile = Annotated[
    bool,
    typer.Option("--profile", help="Intervals by profile likelihood too: many refits."),
]


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """A line that says what is being done, and for how long it has been."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    quiet = not errors.is_terminal  # else a log file gets an empty line
    with Progress(*columns, console=errors, transient=True, disable=quiet) as bar:
        task = bar.add_task("read the logs")
        yield lambda what: bar.update(task, description=what)


@contextmanager
def _counted(what: str) -> Iterator[Callable[[int, int], None]]:
    """A bar of so many done out of so many, with the time that is left."""
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
        TimeRemainingColumn(),
    )  # fmt: skip
    quiet = not errors.is_terminal
    with Progress(*columns, console=errors, transient=True, disable=quiet) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _check_out(out: Path) -> None:
    for path in (out, *out.parents):
        if path.exists() and not path.is_dir():
            raise InputError(f"{path}: is a file: name a folder with --out")
    there = next(path for path in (out, *out.absolute().parents) if path.exists())
    if not os.access(there, os.W_OK):
        raise InputError(f"{out}: cannot be written to: name another folder with --out")


def _check_file(out: Path) -> None:
    """Refuse a file that cannot be written, before any work."""
    if out.is_dir():
        raise InputError(f"{out}: is a folder: name a file with --out")
    _check_out(out.parent)


@app.command()
def identify(
    rig: RigFile,
    logs: Logs,
    validate: Annotated[
        list[Path] | None,
        typer.Option(help="Logs that take no part in the fit: all words that follow."),
    ] = None,
    out: Out = Path("hydrojax-identify"),
    horizon: Horizon = 0.25,
    starts: Annotated[int, typer.Option(help="Fits from so many starts.", min=1)] = 4,
    profile: Profile = False,
    effects: Effects = None,
) -> None:
    """Fit the declared model to logs; say how well it does and can be believed."""
    _check_out(out)
    set_up_jax(user_cache())
    _load_effects(effects)
    from .identify import run

    with _progress() as tell:
        case = run.open_case(rig, logs, validate or (), horizon)
        outcome = run.identify(case, starts, tell, profile)
    _finish(outcome, out)


@app.command()
def trace(
    rig: RigFile,
    logs: Logs,
    validate: Annotated[
        list[Path],
        typer.Option(help="Logs that take no part in the fit: all words that follow."),
    ],
    out: Out = Path("hydrojax-trace"),
    horizon: Horizon = 0.25,
    starts: Annotated[int, typer.Option(help="Fits from so many starts.", min=1)] = 1,
    matters: Annotated[
        float,
        typer.Option(help="Least fall of the error, as a share of the noise.", min=0.0),
    ] = 0.02,
    level: Annotated[
        float, typer.Option(help="Family-wise significance.", min=1e-12, max=0.5)
    ] = 0.01,
    profile: Profile = False,
    effects: Effects = None,
) -> None:
    """Close the loop: fit, residual, the effect behind it, refit, before and after."""
    _trace(rig, logs, validate, out, horizon, starts, matters, level, profile, effects)


@app.command()
def demo(out: Out = Path("hydrojax-demo")) -> None:
    """Run `trace` on a rig and logs that come with the package."""
    folder = resources.files("hydrojax") / "demo"
    with resources.as_file(folder) as here:
        console.print("trace of the demo rig: two logs to fit, one to check\n")
        logs = [here / "fit_1.csv.gz", here / "fit_2.csv.gz"]
        _trace(here / "rig.toml", logs, [here / "validate.csv.gz"], out)


@app.command()
def simulate(
    rig: RigFile,
    gains: Annotated[
        list[str] | None,
        typer.Option(
            help="Keys of [controller] to replace, as k_p=1.5 or 'A_a=6 V*s,15 V*s': "
            "all words that follow.",
            show_default=False,
        ),
    ] = None,
    reference: Annotated[
        str,
        typer.Option(
            help="Desired force: sines:400 N, sine:300 N,0.5 Hz, noise:200 N,50 Hz, or "
            "a log with F_d."
        ),
    ] = "sines",
    motion: Annotated[
        str,
        typer.Option(
            help="Of the piston, or of what its load hangs on: wander:25 mm/s, "
            "to-and-fro:3 cm/s,3 s, locked, or a log."
        ),
    ] = "wander",
    seconds: Annotated[float, typer.Option(help="Length of the run, s.")] = 12.0,
    seed: Annotated[int, typer.Option(help="Of noise and random course.", min=0)] = 0,
    out: Annotated[
        Path, typer.Option(help="The log: CSV(.gz), Parquet or MAT.")
    ] = Path("hydrojax-simulate.csv"),
    effects: Effects = None,
) -> None:
    """Run a rig in closed loop; write the log that it would have given."""
    _check_file(out)
    set_up_jax(user_cache())
    _load_effects(effects)
    import warnings

    import numpy as np

    from . import record, simulation
    from .build import load_rig, make_effects, make_rig
    from .controller import make_loop

    record.check_kind(out)
    spec = load_rig(rig)
    with _progress() as tell:
        tell("run the closed loop")
        loop = make_loop(spec, None, _given(gains or []))
        course = record.read_course(spec, loop, reference, motion, seconds, seed)
        x = course.road.x
        own = make_effects(spec.effects, spec, (float(x.min()), float(x.max())))
        loop = make_loop(spec, make_rig(spec, own), _given(gains or []))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # said below, in one line
            run = simulation.simulate(loop, course)
    if run.diverged:
        raise InputError(f"{rig}: {run.warning()}")
    record.write_log(out, record.columns(run, spec))
    still = (
        ""
        if np.ptp(run["x"])
        else "the position does not move: identify and trace do not take such a log"
    )
    for line in (run.warning(), still, _noiseless(spec.sensors)):
        if line:
            console.print(f"warning: {line}", markup=False)
    later = run.t >= run.t[-1] / 4
    off = np.sqrt(np.mean((run.F_d - run["true_F"])[later] ** 2))
    pushed = np.mean(np.abs(run["u"]) >= 0.999 * float(loop.law.u_max))
    console.print(
        f"{run.t.size} samples in {out}; F_d - F {off:.3g} N RMS after the first "
        f"quarter; command saturated in {100 * pushed:.1f} % of them",
        markup=False,
    )


def _noiseless(sensors: dict[str, float]) -> str:
    if {"P_a1", "P_a2", "F"} & set(sensors):
        return ""
    return (
        "the rig file gives no noise under [sensors], so the log has none: identify "
        "and trace will take every small misfit for real"
    )


def _given(words: list[str]) -> dict[str, object]:
    """`name=value` or `name=lower,upper` words as keys of [controller]."""
    out: dict[str, object] = {}
    for word in words:
        name, sign, text = word.partition("=")
        if not sign or not text.strip():
            raise InputError(f"--gains {word!r}: write NAME=VALUE, such as k_p=1.5")
        values = [_number(part) for part in text.split(",")]
        out[name.strip()] = values[0] if len(values) == 1 else values
    return out


def _number(text: str) -> str | float:
    try:
        return float(text)
    except ValueError:
        return text


@app.command()
def excite(
    rig: RigFile,
    separate: Annotated[
        list[str] | None,
        typer.Option(help="Two effects to be told apart: both words that follow."),
    ] = None,
    force: Annotated[str, typer.Option(help="Most of the desired force.")] = "800 N",
    speed: Annotated[str, typer.Option(help="Most of the speed.")] = "25 mm/s",
    travel: Annotated[str, typer.Option(help="Most from mid-stroke.")] = "20 mm",
    seconds: Annotated[float, typer.Option(help="Length.", min=1.0, max=60.0)] = 8.0,
    out: Annotated[
        Path, typer.Option(help="The course: CSV(.gz), Parquet or MAT.")
    ] = Path("hydrojax-excite.csv"),
    effects: Effects = None,
) -> None:
    """Find the reference and motion that tell most of what is not identified."""
    _check_file(out)
    set_up_jax(user_cache())
    _load_effects(effects)
    from . import record, units
    from .build import load_rig
    from .identify.excite import Limits, design
    from .identify.naming import quantity

    record.check_kind(out)
    spec = load_rig(rig)
    both = [name for word in separate or [] for name in word.split(",")]
    if both and len(both) != 2:
        raise InputError(f"--separate {' '.join(both)}: name two effects")
    most = [
        units.quantity(text, unit, f"--{name}")
        for name, text, unit in (
            ("force", force, "N"), ("speed", speed, "m/s"), ("travel", travel, "m"),
        )
    ]  # fmt: skip
    if min(most) <= 0:
        raise InputError("--force, --speed and --travel must be above 0")
    with _progress() as tell:
        found = design(spec, Limits(*most, seconds=seconds), both, tell=tell)
    record.write_log(out, record.course_columns(found.t, found.F_d, found.x, spec))
    what = "least size shown" if both else "standard deviation"
    table = Table(what, "undesigned", "designed", "times better")
    for name, before in found.before.items():
        unit = found.units[name]
        after = found.after[name]
        table.add_row(
            name, quantity(before, unit), quantity(after, unit), f"{before / after:.2g}"
        )
    console.print(table)
    console.print(f"reference and motion in {out}: simulate --reference and --motion")


@app.command()
def bounds(
    rig: RigFile,
    logs: Logs,
    validate: Annotated[
        list[Path] | None,
        typer.Option(help="Logs whose plants take no part: all words that follow."),
    ] = None,
    out: Out = Path("hydrojax-bounds"),
    confidence: Annotated[
        float, typer.Option(help="That the box holds.", min=0.5, max=0.999)
    ] = 0.95,
    stretch: Annotated[float, typer.Option(help="Length of a fit, s.", min=0.5)] = 2.0,
    effects: Effects = None,
) -> None:
    """Find the adaptive law's friction bounds from many fits, and refine them."""
    _check_out(out)
    set_up_jax(user_cache())
    _load_effects(effects)
    import json

    from . import roof
    from .identify import run

    with _progress() as tell:
        case = run.open_case(rig, logs, validate or ())
        found = roof.friction_bounds(case, confidence, stretch, tell)
        figure = roof.bounds_figure(found)
    out.mkdir(parents=True, exist_ok=True)
    (out / "rig.toml").write_text(found.rig_file, encoding="utf-8")
    (out / "bounds.json").write_text(json.dumps(roof.json_of(found), indent=1) + "\n")
    figure.savefig(out / "bounds.png", dpi=120)
    table = Table("F_d - F, N RMS", "plants fitted", "plants that took no part")
    for way, error in found.fitted.items():
        other = f"{found.others[way]:.3g}" if found.others else "-"
        table.add_row(f"{way} bounds", f"{error:.3g}", other)
    console.print(table)
    console.print(
        f"{len(found.fits)} stretches of {found.fits[0].seconds:.3g} s; rig.toml with "
        f"the refined bounds, bounds.json and bounds.png in {out}"
    )


@app.command()
def paper(out: Out = Path("hydrojax-paper")) -> None:
    """Repeat the paper's experiments on the reference rig: Figs. 2 to 5."""
    _check_out(out)
    set_up_jax(user_cache())
    import json

    from . import paper as experiments
    from .paper_figures import figures

    with _progress() as tell:
        found = experiments.experiments(tell)
        tell("draw")
        drawn = figures(found)
        content = experiments.json_of(found)
    out.mkdir(parents=True, exist_ok=True)
    for name, figure in drawn.items():
        figure.savefig(out / f"{name}.png", dpi=120)
    (out / "paper.json").write_text(json.dumps(content, indent=1) + "\n")
    table = Table("RMS, N", "a", "b", "c", "d")
    for name in ("fig2", "fig3", "fig4"):
        table.add_row(name, *(f"{v:.3g}" for v in content[name].values()))
    console.print(table)
    edge = content["fig5"]
    console.print(
        f"fig5: within 1 dB to {edge['within_1dB_to_Hz_noise']:.1f} Hz by noise, "
        f"{edge['within_1dB_to_Hz_sines']:.1f} Hz by sines\n"
        f"W (31) rises by at most {content['lyapunov']['largest_rise']:.2g} of its "
        "start\n"
        f"least supply {content['supply']['least_P_s_Pa'] / 1e6:.2f} MPa; (42) asks "
        f"for {content['supply']['condition_42_Pa'] / 1e6:.1f} MPa\n"
        f"without friction model {content['ablation']['rms_N']:.3g} N, full law "
        f"{content['ablation']['full_law_rms_N']:.3g} N\n"
        f"pictures and paper.json in {out}"
    )


@app.command()
def sweep(
    rig: RigFile,
    over: Annotated[
        list[str],
        typer.Option(
            help="An axis, 1 to 4: k_p=0.2:4:48, load.mass=50 kg:300 kg:16, "
            "beta=5e8:1e9:9:log, v=0,0.01,0.02. All words that follow."
        ),
    ],
    by: Annotated[
        list[str] | None,
        typer.Option(
            help="linear, multisine or noise: all words that follow.",
            show_default="linear",
        ),
    ] = None,
    gains: Gains = None,
    at: At = None,
    ensemble: Annotated[
        int, typer.Option(help="Plants to sweep over, the rig among them.", min=1)
    ] = 1,
    spread: Annotated[
        float, typer.Option(help="Relative half-width of the ensemble.", min=0.0)
    ] = 0.2,
    report: Annotated[
        Path | None,
        typer.Option(
            "--from", help="Folder of identify or trace: the ensemble is drawn from it."
        ),
    ] = None,
    frozen: Annotated[
        bool, typer.Option("--frozen", help="Measure with the adaptation frozen.")
    ] = False,
    effects: Effects = None,
    out: Out = Path("hydrojax-sweep"),
) -> None:
    """Map bandwidth over gains, bounds, plant, load, signal path, operating point.

    Run again, a sweep that was stopped goes on where it was, and one that is done does
    nothing.
    """
    _check_out(out)
    set_up_jax(user_cache())
    _load_effects(effects)
    from .tune import maps, run

    with _counted("sweep") as tell:
        data = run.sweep_rig(
            rig, over, by or ("linear",), _given(gains or []), at or (), ensemble,
            spread, report, frozen, out, tell,
        )  # fmt: skip
    for name, figure in maps.figures(data).items():
        figure.savefig(out / f"{name}.png", dpi=120)
    for line in run.sentences(data):
        console.print(line)
    console.print(f"sweep.nc and pictures in {out}")


@app.command()
def tune(
    source: Annotated[
        Path,
        typer.Argument(
            help="Rig file, or the folder of a trace or identify.", show_default=False
        ),
    ],
    rig: Annotated[
        Path | None,
        typer.Option(help="Rig file of a folder that holds none."),
    ] = None,
    free: Annotated[
        list[str] | None,
        typer.Option(
            help="What is tuned: k_p, k_f, k_1, tau_d …: all words that follow.",
            show_default="k_p k_f k_1, and A_a where a load moves",
        ),
    ] = None,
    at: At = None,
    adaptation: Annotated[
        bool, typer.Option("--adaptation", help="Tune its rates and bounds after.")
    ] = False,
    ensemble: Annotated[
        int, typer.Option(help="Plants to tune for, the rig among them.", min=1)
    ] = 8,
    spread: Annotated[
        float, typer.Option(help="Relative half-width of the ensemble.", min=0.0)
    ] = 0.2,
    peak: Annotated[float, typer.Option(help="Largest resonance, dB.", min=0.1)] = 3.0,
    margin: Annotated[
        float, typer.Option(help="Largest sensitivity at the command, dB.", min=1.0)
    ] = 6.0,
    noise: Annotated[
        float,
        typer.Option(help="Command by noise, RMS, share of its range.", min=1e-6),
    ] = 0.01,
    tracking: Annotated[
        float,
        typer.Option(help="Tracking error, joint moving, relative to before.", min=0.1),
    ] = 3.0,
    starts: Annotated[int, typer.Option(help="Descents.", min=1)] = 3,
    effects: Effects = None,
    out: Out = Path("hydrojax-tune"),
) -> None:
    """Find the gains that give the widest bandwidth, and say what limits it."""
    _check_out(out)
    set_up_jax(user_cache())
    _load_effects(effects)
    from .tune import goal, report, tuning

    limits = goal.Limits(peak=peak, sensitivity=margin, noise=noise, tracking=tracking)
    with _progress() as tell:
        tuned, path = tuning.tune(
            source, rig, free or (), at or (), adaptation, ensemble, spread,
            limits, starts, tell,
        )  # fmt: skip
        tell("draw")
        report.write(tuned, path, out)
    console.print(report.sentence(tuned))
    table = Table("gain", "before", "after", "unit")
    for name, value in tuned.gains.items():
        table.add_row(
            name, f"{tuned.start[name]:.4g}", f"{value:.4g}", tuned.units[name]
        )
    console.print(table)
    console.print(report.limit(tuned))
    for line in tuned.notes:
        console.print(f"- {line}")
    console.print(f"tune.json, rig.toml and report.html in {out}")


def _load_effects(files: list[Path] | None) -> None:
    from .effects import load_effects

    for path in files or ():
        load_effects(path)


def _trace(
    rig: Path,
    logs: list[Path],
    validate: list[Path],
    out: Path,
    horizon: float = 0.25,
    starts: int = 1,
    matters: float = 0.02,
    level: float = 0.01,
    profile: bool = False,
    effects: list[Path] | None = None,
) -> None:
    _check_out(out)
    set_up_jax(user_cache())
    _load_effects(effects)
    from .identify import run

    with _progress() as tell:
        case = run.open_case(rig, logs, validate, horizon)
        outcome = run.trace_case(case, starts, matters, level, tell, profile)
    _finish(outcome, out)


def _finish(outcome: Outcome, out: Path) -> None:
    """Write the report and show the gist of it."""
    from .identify.naming import quantity
    from .identify.report import write_report

    write_report(outcome, out)
    console.print(outcome.verdict, style="bold", end="  ")
    console.print(f"{outcome.sentence}\n", markup=False)
    table = Table("channel", "noise", "before", "after", "after / noise")
    for name, c in outcome.channels.items():
        table.add_row(
            name,
            *(quantity(v, c.unit) for v in (c.noise, c.before, c.after)),
            f"{c.after / c.noise:.3f}",
        )
    console.print(table)
    for effect in outcome.effects:
        found = ", ".join(
            f"{n} = {quantity(p.value, p.unit, p.std)}"
            for n, p in effect.parameters.items()
        )
        alike = (
            f"; cannot be told from {', '.join(effect.cannot_tell_from)}"
            if effect.cannot_tell_from
            else ""
        )
        console.print(f"{effect.name}: {found}{alike}", markup=False)
    for line in (*outcome.limits, *outcome.notes):
        console.print(f"- {line}", markup=False)
    spent = outcome.seconds
    console.print(
        f"\ncompile {spent['compile']:.1f} s, run {spent['run']:.1f} s; "
        f"report in {out / 'report.html'}",
        markup=False,
    )


def _version(wanted: bool) -> None:
    if wanted:
        console.print(f"hydrojax {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Say it."),
    ] = False,
) -> None:
    """What holds for every command."""


SEVERAL = ("--validate", "--gains", "--separate", "--over", "--by", "--at", "--free")
"""Options that take all words that follow."""


def _spread(words: list[str]) -> list[str]:
    """Let some options take several words: repeat them before each that follows."""
    out, open_ = [], ""
    for word in words:
        name, sign, _ = word.partition("=")
        if name in SEVERAL:
            open_ = name
            if sign:
                out.append(word)
        elif open_ and not word.startswith("-"):
            out += [open_, word]
        else:
            open_ = ""
            out.append(word)
    return out


def _refuse(error: Exception) -> NoReturn:
    errors.print(f"hydrojax: {error}", style=None, markup=False, soft_wrap=True)
    sys.exit(2)


def main() -> None:
    """Run the command line: 0 when it did its work, 2 on bad input."""
    try:
        app(_spread(sys.argv[1:]))
    except InputError as error:
        _refuse(error)
    except OSError as error:  # a disk that is full, a folder that went away
        _refuse(error)


if __name__ == "__main__":
    main()
