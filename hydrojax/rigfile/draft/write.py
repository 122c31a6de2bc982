"""A rig file drafted from a log: every key with its unit, range and meaning."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hydrojax import units
from hydrojax.errors import InputError, check_known
from hydrojax.logs.columns import check_time, check_values, merged_rows
from hydrojax.logs.log import check_rows
from hydrojax.logs.tables import File, is_bag, read_table
from hydrojax.plant.layout import LAYOUTS
from hydrojax.rigfile.draft.columns import Guess, guess_signals
from hydrojax.rigfile.draft.sizes import (
    Read,
    Sizes,
    areas,
    command_unit,
    missing,
    ranges,
    rates_valve,
)
from hydrojax.rigfile.plain import text
from hydrojax.rigfile.sections import LANDS, SUPPLY, base_specs

FORCES = (("P", "driven-axis"), ("F", "tester"))
"""The layout of a log without command and pressures, by the force it has."""


def read_log(
    paths: Sequence[str | Path], columns: Mapping[str, str], layout: str, sizes: Sizes
) -> Read:
    """The first of some logs of one logger, as it is understood.

    Args:
        paths: the logs.
        columns: by signal, where they are not to be guessed.
        layout: one of `LAYOUTS`, or "" to guess.
        sizes: a rod of 0 means equal areas.

    Raises:
        InputError: no log, an unknown layout or column, no time, or a log that lacks
            a column of the first.
    """
    path = Path(paths[0])
    if is_bag(path):
        raise InputError(
            f"{path}: a bag has topics, not columns; write [channels] as "
            "docs/logs.md says, or export the run as a table"
        )
    if layout:
        check_known("--layout", [layout], LAYOUTS, "layout")
    file = read_table(path)
    two = layout == "differential" or (not layout and sizes.rod != 0)
    signals = _sound(file, guess_signals(file, columns, two))
    if not layout:
        one = ("P_a1" in signals) != ("P_a2" in signals)
        layout = "single" if one else "differential" if sizes.rod != 0 else "pull-pull"
        if not {"P_a1", "P_a2", "u"} & set(signals):
            layout = next((n for s, n in FORCES if s in signals), layout)
    if layout == "single" and "P_a2" not in signals and "P_a1" in signals:
        signals["P_a2"] = signals.pop("P_a1")  # the chamber that is under pressure
    labels = {g.column.label for g in signals.values()}
    for other in paths[1:]:
        lost = labels - {c.label for c in read_table(Path(other)).columns}
        if lost:
            raise InputError(
                f"{other}: no column {min(lost)!r}, which {path} has; draft a rig file "
                "from logs of one logger"
            )
    return Read(file, _turned(signals, LAYOUTS[layout].driven), layout, sizes)


def _sound(file: File, signals: dict[str, Guess]) -> dict[str, Guess]:
    """The signals, with rows of one stamp as one.

    Raises:
        InputError: no log could have these; see `Log.load`.
    """
    arrays = {name: g.values for name, g in signals.items()}
    labels = {name: g.column.label for name, g in signals.items()}
    check_rows(file, labels, arrays)
    coarse = check_time(file, labels["time"], arrays["time"])
    for name, values in arrays.items():
        check_values(file, name, labels[name], values)
    if coarse:
        arrays, _ = merged_rows(arrays)
    return {name: replace(g, values=arrays[name]) for name, g in signals.items()}


def _turned(signals: dict[str, Guess], driven: bool) -> dict[str, Guess]:
    """Signals with the sign that the others ask of the command and the force.

    Chamber 1 shrinks as x grows, so that a positive command moves the piston back. The
    pressures push the load the way that they push the piston. Where nothing drives,
    friction pulls the load back.
    """
    out = dict(signals)
    motion = signals.get("x") or signals.get("psi")
    if motion and "u" in signals:
        speed = np.gradient(motion.values)
        out["u"] = _with_sign(signals["u"], -_likeness(signals["u"].values, speed))
    if {"P_a1", "P_a2", "F"} <= set(signals):
        push = signals["P_a2"].values - signals["P_a1"].values
        like = _likeness(signals["F"].values, push)
        out["F"] = _with_sign(signals["F"], like)
        if "F_d" in signals:
            out["F_d"] = _with_sign(signals["F_d"], like)
    if motion and not driven and "F" in signals:
        back = -np.gradient(motion.values)
        out["F"] = _with_sign(signals["F"], _likeness(signals["F"].values, back))
    return out


def _likeness(a: np.ndarray, b: np.ndarray) -> float:
    """Their correlation, 0 where one does not move."""
    whole = np.isfinite(a) & np.isfinite(b)
    a, b = a[whole] - a[whole].mean(), b[whole] - b[whole].mean()
    size = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / size if size else 0.0


def _with_sign(guess: Guess, likeness: float) -> Guess:
    """A guess, turned where its likeness is negative; a weak one is doubtful."""
    said = f"sign by correlation {likeness:+.2f}"
    doubts = (*guess.doubts, said) if abs(likeness) < 0.5 else guess.doubts
    invert = likeness < 0
    return Guess(
        guess.column, guess.unit, -guess.values if invert else guess.values,
        guess.named and not invert, invert, doubts,
    )  # fmt: skip


def drafted(log: Read, name: str = "") -> tuple[str, str]:
    """The rig's name, and the text of its rig file, with comments.

    Args:
        log: as `read_log` gives it.
        name: the rig's; the log's without one.

    Raises:
        InputError: sizes are missing.
    """
    for size in missing(log):
        raise InputError(f"{log.file.path}: {size} is missing: give it with its unit")
    time = log.signals["time"].values
    rate = 1 / np.median(np.diff(time))
    own = (name or log.file.path.name.split(".")[0]).replace("\\", "").replace('"', "")
    lines = [
        f"# Drafted from {log.file.path.name}: {time.size} rows at {rate:.4g} Hz.",
        "# Lines with CHECK are guesses: read them, then run hydrojax check RIG LOG...",
        f'name = "{own}"',
        _line("layout", f'"{log.layout}"', "of " + ", ".join(LAYOUTS)),
        *_geometry(log),
        *_supply(log),
        *_sensors(log),
        *_channels(log),
        *_parameters(log),
        *_more(),
    ]
    return own, "\n".join(lines) + "\n"


def _line(key: str, value: str, said: str) -> str:
    return f"{key} = {value}".ljust(30) + f" # {said}"


def _geometry(log: Read) -> Iterator[str]:
    """The section [geometry]."""
    layout, signals, sizes = log.layout, log.signals, log.sizes
    area_1, area_2 = (f'"{text(a, "m^2")}"' for a in areas(log))
    yield from ("", "[geometry]")
    if layout == "differential":
        yield _line("area_1", area_1, "rod side; chamber 1 shrinks as x grows")
        yield _line("area_2", area_2, "bore side; pushes toward positive x")
    elif layout == "single":
        yield _line("area", area_1, "CHECK: of the chamber under pressure; the bore's")
    elif LAYOUTS[layout].has_valve:
        yield _line("area", area_1, "of each chamber, without the rod")
    if sizes.stroke is not None:
        yield _line(
            "chamber_length", f'"{text(sizes.stroke, "m")}"', "stroke between the stops"
        )
    if sizes.radius is not None and "psi" in signals:
        yield _line("radius", f'"{text(sizes.radius, "m")}"', "x = radius * psi")
    x = signals.get("x")
    if x is not None and sizes.stroke is not None:
        low, high = float(np.nanmin(x.values)), float(np.nanmax(x.values))
        outside = max(abs(low), abs(high)) > sizes.stroke / 2
        mid = sizes.stroke / 2 if outside else 0.0
        seen = f"the log goes from {low:.4g} to {high:.4g} m"
        yield _line("x_mid", f'"{text(mid, "m")}"', f"CHECK: x at mid-stroke; {seen}")


def _supply(log: Read) -> Iterator[str]:
    """The section [supply]."""
    signals, sizes = log.signals, log.sizes
    if not LAYOUTS[log.layout].has_valve:
        return
    yield from (
        "",
        "[supply]                       # where the log has no such channel",
    )
    for key, said in (("P_s", "supply pressure"), ("P_r", "return pressure")):
        if key in signals:
            yield f"# {key}: from the log"
            continue
        known = key == "P_s" and sizes.supply is not None
        value = sizes.supply if known else SUPPLY[key]
        assert value is not None
        said = said if known else f"CHECK: {said}"
        yield _line(key, f'"{text(value, "Pa")}"', said)


def _sensors(log: Read) -> Iterator[str]:
    """The section [sensors], which only a data sheet can fill."""
    yield from (
        "",
        "# Standard deviation of the noise, from data sheets or a run at rest.",
    )
    yield "# Verdicts are surer with it than with an estimate from the log."
    yield "# [sensors]"
    for name, example in (("P_a1", "9 kPa"), ("P_a2", "9 kPa"), ("F", "2.5 N")):
        if name in log.signals:
            yield f'# {name} = "{example}"'


def _channels(log: Read) -> Iterator[str]:
    """The section [channels]."""
    yield from ("", "[channels]                     # signal = column of the log")
    for name, guess in log.signals.items():
        label = guess.column.label.replace("\\", "\\\\").replace('"', '\\"')
        inside = [f'column = "{label}"', f'unit = "{guess.unit}"']
        inside += ["invert = true"] if guess.invert else []
        doubt = f" # CHECK: {'; '.join(guess.doubts)}" if guess.doubts else ""
        line = f"{name} = {{ {', '.join(inside)} }}"
        yield f"# {line}" if guess.named and not doubt else line + doubt
    used = {id(g.column) for g in log.signals.values()}
    rest = [c.label for c in log.file.columns if id(c) not in used]
    if rest:
        yield f"# not used: {', '.join(rest)}"


def _parameters(log: Read) -> Iterator[str]:
    """The section [parameters]: every one, with its unit, range and meaning."""
    yield from (
        "",
        "# To be found: where the search starts, and the range that it may take.",
    )
    yield '# NAME = "VALUE UNIT" holds a parameter instead.'
    yield "[parameters]"
    command, usual = command_unit(log), ranges(log)
    drives = rates_valve(log)
    force = "F" in log.signals
    for name, spec in base_specs().items():
        oil = name in LANDS or name in ("beta", "delta_1", "delta_2")
        if oil and not LAYOUTS[log.layout].has_valve:
            continue
        unit = units.with_command(spec.unit, command)
        said = f"# {spec.description}; within {spec.lower:.3g} to {spec.upper:.3g}"
        said += "" if unit == "1" else f" {unit}"
        if name not in usual:
            shown = text(spec.default, unit)
            yield from (f"{said}; rarely changed", f'# {name} = "{shown}"')
            continue
        if name in LANDS and drives and log.sizes.rated_flow is None:
            said += "; CHECK: a guess; give --rated-flow if you know it"
        start, low, high = (text(float(f"{v:.3g}"), unit) for v in usual[name])
        line = f'{name} = {{ start = "{start}", range = ["{low}", "{high}"] }}'
        if drives if oil else force:
            yield from (said, line)
        else:
            lost = "valve command" if oil else "force"
            yield from (f"{said}; the log has no {lost}", f"# {line}")


def _more() -> Sequence[str]:
    """What else a rig file may hold, as an example."""
    return (
        "",
        "# [effects.valve_lag]          # an effect you know of; trace finds the",
        '# omega = "1257 rad/s"         # others; docs/reference/effects.md',
        '# zeta = "0.7"',
    )
